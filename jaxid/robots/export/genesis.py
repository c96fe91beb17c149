"""Genesis: calls on an entity after the scene is built."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.robots.export.config import written
from jaxid.robots.export.outcome import ExportOutcome
from jaxid.robots.export.sheet import LinkInertia, Sheet
from jaxid.robots.export.target import Field, Written


NAME, VERSION, FILES = "genesis", "Genesis 0.3", ()
FIELDS = {
    "damping": Field("set_dofs_damping"), "armature": Field("set_dofs_armature"), "stiffness": Field("set_dofs_stiffness"),
    "frictionloss": Field("set_dofs_frictionloss", "approximate", "a soft constraint, as in MuJoCo"),
    "kp": Field("set_dofs_kp"), "kd": Field("set_dofs_kv"), "force": Field("set_dofs_force_range"),
    "highest": Field("set_dofs_force_range"), "lowest": Field("set_dofs_force_range"),
}  # fmt: skip
ELSEWHERE = {
    "inertial": "set_mass_shift and set_COM_shift of the link, or its numbers in the file (jaxid export --to mjcf, or urdf)",
    "gravity": "SimOptions(gravity=...) of the scene", "bias": "subtract it from the targets, add it to what is read",
    "torque": "control_dofs_force, added each step", "delay": "keep the targets of the last steps and send an old one",
    "lag": "filter the targets", "drive": "multiply what control_dofs_force gets",
    "offset": "control_dofs_force, added each step",
    "springref": "a spring at zero is all there is: control_dofs_force, added each step",
    "ki": "control_dofs_force, added each step",
    **dict.fromkeys(("quadratic", "cubic"), "control_dofs_force, added each step"),
}  # fmt: skip


def write(sheet: Sheet, _found: ExportOutcome, _path: Path | None) -> Written:
    """`genesis_apply.py`."""
    return written(sheet, FIELDS, ELSEWHERE, "genesis_apply.py", _text, VERSION, "torch")


def _text(
    sheet: Sheet, numbers: Mapping[str, dict[str, Any]], _bodies: Mapping[str, LinkInertia]
) -> str:
    lines = [
        (
            f'"""What was found, on an entity of a built scene; written for {VERSION}, not run. SI'
            ' units."""'
        ),
        "",
        "",
        "def apply(robot):",
        '    """After scene.build()."""',
    ]
    calls = {
        "damping": "damping",
        "armature": "armature",
        "stiffness": "stiffness",
        "frictionloss": "frictionloss",
        "kp": "kp",
        "kd": "kv",
    }
    for joint, own in numbers.items():
        now = sheet.after[joint]
        lines.append(f"    d = robot.get_joint({joint!r}).dofs_idx_local")
        lines += [
            f"    robot.set_dofs_{calls[k]}([{float(getattr(now, k))!r}], d)"
            for k in calls
            if k in own
        ]
        if {"force", "lowest", "highest"} & own.keys():
            low, high = (
                float(v) for v in np.nan_to_num([now.lowest, now.highest], posinf=1e9, neginf=-1e9)
            )
            lines.append(f"    robot.set_dofs_force_range([{low!r}], [{high!r}], d)")
    return "\n".join([*lines, "    return robot", ""])
