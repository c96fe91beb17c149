"""mjlab: actuator settings of `EntityArticulationInfoCfg`; what they lack goes into the MJCF or the
spec.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxid.robots.export.config import written
from jaxid.robots.export.outcome import ExportOutcome
from jaxid.robots.export.sheet import LinkInertia, Sheet
from jaxid.robots.export.target import Field, limit, NONE, Written


NAME, VERSION, FILES = "mjlab", "mjlab 1.6", ()
SOFT = (
    "a soft constraint: set solreffriction and solimpfriction in the MJCF, where friction has to"
    " hold"
)
FIELDS = {
    "damping": Field("BuiltinPositionActuatorCfg.viscous_damping", note="not `damping`, which is kd"),
    "frictionloss": Field("BuiltinPositionActuatorCfg.frictionloss", "approximate", SOFT),
    "armature": Field("BuiltinPositionActuatorCfg.armature"),
    "kp": Field("BuiltinPositionActuatorCfg.stiffness"), "kd": Field("BuiltinPositionActuatorCfg.damping"),
    "force": Field("BuiltinPositionActuatorCfg.effort_limit", one=True),
    "highest": Field("BuiltinPositionActuatorCfg.effort_limit", one=True),
    "delay": Field("delay_min_lag = delay_max_lag", "approximate", "whole physics steps of the command: rounded"),
}  # fmt: skip
XML = "no setting of an actuator: patch the MJCF (jaxid export --to mjcf) and load that"
ELSEWHERE: dict[str, str] = dict.fromkeys(
    (
        "quadratic",
        "cubic",
        "stiffness",
        "springref",
        "bias",
        "torque",
        "offset",
        "drive",
        "lag",
        "inertial",
        "gravity",
        "lowest",
    ),
    XML,
)


def write(sheet: Sheet, _found: ExportOutcome, _path: Path | None) -> Written:
    """`mjlab_actuators.py`: a function of the physics step, for delays are counted in those."""
    return written(
        sheet, FIELDS, ELSEWHERE, "mjlab_actuators.py", _text, VERSION, "torch", how=NONE
    )


def _text(
    sheet: Sheet, numbers: Mapping[str, dict[str, Any]], _bodies: Mapping[str, LinkInertia]
) -> str:
    lines = [
        (
            f'"""Actuators as they were found; written for {VERSION}, not run. Joints keep what is'
            ' not named here."""'
        ),
        "",
        "from mjlab.actuator import BuiltinPositionActuatorCfg",
        "",
        "",
        "def actuators(physics_dt):",
        '    """`EntityArticulationInfoCfg(actuators=actuators(0.005))`; physics_dt in s."""',
        "    return (",
    ]
    names = {"damping": "viscous_damping", "frictionloss": "frictionloss", "armature": "armature"}
    for joint, own in numbers.items():
        now = sheet.after[joint]
        given = {"stiffness": now.kp, "damping": now.kd} if sheet.driven else {}
        given |= {names[k]: float(own[k]) for k in names if k in own}
        effort = limit([now.lowest, now.highest])
        given |= (
            {"effort_limit": effort}
            if effort is not None and ("force" in own or "highest" in own or sheet.driven)
            else {}
        )
        lines += [
            "        BuiltinPositionActuatorCfg(",
            f"            target_names_expr=({re.escape(joint)!r},),",
        ]
        lines += [f"            {k}={v!r}," for k, v in given.items()]
        if not sheet.driven:
            lines.append(
                "            stiffness=..., damping=...,  # your gains: the recording was driven by"
                " torques"
            )
        if "delay" in own:
            lines += [
                f"            delay_{end}_lag=round({now.delay!r} / physics_dt),"
                for end in ("min", "max")
            ]
        lines.append("        ),")
    return "\n".join([*lines, "    )", ""])
