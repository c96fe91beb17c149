"""The links of a `serial_arm` as a dataset states them."""

from __future__ import annotations

from typing import Any

from jaxid.data.dataset import Geometry


def arm_table(geometry: Geometry) -> Any:
    """The `ArmTable`. Raises `UsageError` for a URDF that holds no chain."""
    from jaxid.dynamics import kinematics

    if geometry.urdf:
        from jaxid.robots.urdf_tree import read_urdf

        return read_urdf(geometry.file, geometry.tip, geometry.root, text=geometry.urdf)
    make: Any = (
        kinematics.modified_dh if geometry.convention == "modified" else kinematics.standard_dh
    )
    return make(**geometry.columns)
