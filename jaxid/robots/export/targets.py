"""The frameworks that a result can be carried into. One line of registration each."""

from __future__ import annotations

from typing import Any

from jaxid.robots.export import drake, genesis, isaaclab, mjcf, mjlab, ros2_control, sdf, urdf


TARGETS: dict[str, Any] = {
    t.NAME: t for t in (mjcf, mjlab, isaaclab, urdf, sdf, drake, ros2_control, genesis)
}
