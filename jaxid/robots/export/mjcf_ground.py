"""The friction of a shape on the ground, in an MJCF."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from jaxid.robots.export.mjcf_code import Op
from jaxid.robots.export.mjcf_file import MjcfFile
from jaxid.robots.export.sheet import RobotChange
from jaxid.robots.export.target import APPROXIMATE, EXACT, Field
from jaxid.robots.export.xml_text import numbers
from jaxid.robots.mjcf_spec import compilable, compiled, library
from jaxid.robots.mjcf_text import expanded


QUANTITY = "sliding_friction"
MIXED = (
    "of two shapes MuJoCo takes the larger friction: its priority is raised, and what it says of"
    " the contact holds alone"
)


def on_the_ground(
    changes: Iterable[RobotChange], file: MjcfFile
) -> tuple[dict[tuple[str, str], Field | None], list[Op]]:
    """Writes the friction of shapes into a file: fields by quantity and place, and the changes."""
    fields: dict[tuple[str, str], Field | None] = {}
    ops: list[Op] = []
    for change in changes:
        if change.quantity != QUANTITY:
            continue
        made = _sliding_friction(file, change.place, change.value)
        if made is not None:
            fields[change.quantity, change.place], attributes = made
            ops.append(Op("geom", change.place, attributes))
    return fields, ops


def _sliding_friction(
    file: MjcfFile, shape: str, value: float
) -> tuple[Field, dict[str, Any]] | None:
    """The field of a shape that carries its friction on planes, and its attributes; None for a
    shape without a name of its own. Torsional and rolling friction stay.
    """
    found = file.geom(shape)
    if found is None:
        return None
    text, element = found
    mujoco = library()
    spec, _ = compilable(file.path, expanded(file.path), contacts=True)
    model = compiled(file.path, spec)
    own = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, shape)
    planes = np.flatnonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE))
    friction = [value, *model.geom_friction[own][1:].tolist()]
    attributes: dict[str, Any] = {"friction": friction}
    how, note = EXACT, ""
    over = [p for p in planes if model.geom_priority[p] >= model.geom_priority[own]]
    if any(model.geom_friction[p, 0] > value for p in over):
        attributes["priority"] = int(model.geom_priority[over].max()) + 1
        alike = all(_alike(model, own, int(p)) for p in over)
        how, note = (EXACT if alike else APPROXIMATE), MIXED
    shown = {"friction": numbers(friction)}
    if "priority" in attributes:
        shown["priority"] = str(attributes["priority"])
    text.set(element, shown)
    return Field(f"geom[{shape}]@friction", how, note), attributes


def _alike(model: Any, shape: int, plane: int) -> bool:
    """Whether a shape says of a contact what a plane says, beside friction."""
    return bool(
        model.geom_condim[shape] == model.geom_condim[plane]
        and np.array_equal(model.geom_solref[shape], model.geom_solref[plane])
        and np.array_equal(model.geom_solimp[shape], model.geom_solimp[plane])
    )
