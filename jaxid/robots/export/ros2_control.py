"""ros2_control: gains of a controller. A controller has no friction and no inertia: those belong
into the model.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxid.robots.export.config import written
from jaxid.robots.export.outcome import ExportOutcome
from jaxid.robots.export.sheet import LinkInertia, Sheet
from jaxid.robots.export.target import Field, limit, Written


NAME, VERSION, FILES = "ros2_control", "ros2_controllers 4 (Jazzy)", ()
FIELDS = {
    "kp": Field("gains.{joint}.p", note="with the effort command interface only"),
    "kd": Field("gains.{joint}.d", note="with the effort command interface only; its derivative is of the error"),
    "ki": Field("gains.{joint}.i", note="with the effort command interface only"),
    "damping": Field("gains.{joint}.ff_velocity_scale", "approximate", "it makes up for damping, it does not simulate it"),
    "force": Field("gains.{joint}.u_clamp_max, u_clamp_min", "approximate", "the controller's own clamp", one=True),
    "highest": Field("gains.{joint}.u_clamp_max, u_clamp_min", "approximate", "the controller's own clamp", one=True),
}  # fmt: skip
MODEL = "a controller has no field for it: put it into the model (jaxid export --to urdf, or mjcf)"
ELSEWHERE: dict[str, str] = {}


def write(sheet: Sheet, _found: ExportOutcome, _path: Path | None) -> Written:
    """`controllers.yaml`."""
    out = written(sheet, FIELDS, ELSEWHERE, "controllers.yaml", _text, VERSION, "c")
    out.notes.append(
        MODEL.replace(
            "a controller has no field for it",
            "what has no row with a field here is of the robot, not of its controller",
        )
    )
    return out


def _text(
    sheet: Sheet, numbers: Mapping[str, dict[str, Any]], _bodies: Mapping[str, LinkInertia]
) -> str:
    lines = [
        f"# Gains as they were found; written for {VERSION}, not run.",
        "joint_trajectory_controller:",
        "  ros__parameters:",
        "    gains:",
    ]
    for joint, own in numbers.items():
        now = sheet.after[joint]
        lines.append(f"      {json.dumps(joint)}:")
        given = (
            {"p": now.kp, "i": now.ki, "d": now.kd}
            if sheet.driven and {"kp", "kd", "ki"} & own.keys()
            else {}
        )
        given |= {"ff_velocity_scale": now.damping} if "damping" in own else {}
        effort = limit([now.lowest, now.highest])
        if effort is not None and {"force", "highest"} & own.keys():
            given |= {"u_clamp_max": effort, "u_clamp_min": -effort}
        lines += [f"        {k}: {float(v)!r}" for k, v in given.items()]
    return "\n".join([*lines, ""])
