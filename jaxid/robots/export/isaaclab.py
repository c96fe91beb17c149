"""Isaac Lab: actuator settings of an articulation."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxid.models.effects import StribeckFriction
from jaxid.robots.export.config import written
from jaxid.robots.export.outcome import ExportOutcome
from jaxid.robots.export.sheet import LinkInertia, Sheet
from jaxid.robots.export.target import Field, limit, Written


NAME, VERSION, FILES = "isaaclab", "Isaac Lab 3.0", ()
FIELDS = {
    "damping": Field("ActuatorCfg.viscous_friction", note="not `damping`, which is kd; a stub of zeros on early Newton backends"),
    "frictionloss": Field("ActuatorCfg.friction = dynamic_friction", note="N m since Isaac Sim 5.0; Newton creeps"),
    "armature": Field("ActuatorCfg.armature"),
    "kp": Field("ActuatorCfg.stiffness"), "kd": Field("ActuatorCfg.damping"),
    "force": Field("ActuatorCfg.actuator_effort_limit, joint_effort_limit", note="effort_limit before 3.0", one=True),
    "highest": Field("ActuatorCfg.actuator_effort_limit, joint_effort_limit", one=True),
    "delay": Field("DelayedPDActuatorCfg.min_delay = max_delay", "approximate", "whole physics steps, rounded; explicit PD only"),
    StribeckFriction.name: Field("ActuatorCfg.friction > dynamic_friction", "approximate", "two levels alone; PhysX only"),
}  # fmt: skip
ELSEWHERE = {
    "inertial": "mass, center of mass and inertia of the link's prim in USD (UsdPhysics.MassAPI)",
    "gravity": "sim.gravity, or the pose of the root",
    "bias": "subtract it from the joint's targets and add it to its observed positions",
    "torque": "an effort target added each step: set_joint_effort_target",
    **dict.fromkeys(("quadratic", "cubic", "stiffness", "springref", "offset", "drive", "lag", "ki", "lowest"),
                    "no setting: an actuator class of your own computes it (effects.py has such laws)"),
}  # fmt: skip


def write(sheet: Sheet, _found: ExportOutcome, _path: Path | None) -> Written:
    """`isaaclab_actuators.py`: a function of the physics step, for delays are counted in those."""
    return written(
        sheet=sheet,
        fields=FIELDS,
        elsewhere=ELSEWHERE,
        file="isaaclab_actuators.py",
        writer=_text,
        version=VERSION,
        library="torch",
        tail=_TAIL,
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
        "from isaaclab.actuators import DelayedPDActuatorCfg, IdealPDActuatorCfg",
        "",
        "",
        "def actuators(physics_dt):",
        '    """`ArticulationCfg(actuators=actuators(0.005), …)`; physics_dt in s."""',
        "    return {",
    ]
    extra = {
        c.place: c.value.get("extra", 0.0)
        for c in sheet.changes
        if c.quantity == StribeckFriction.name
    }
    for joint in dict.fromkeys([*numbers, *filter(None, extra)]):
        lines += _actuator(sheet, joint, numbers.get(joint, {}), extra.get(joint))
    return "\n".join([*lines, "    }", ""])


def _actuator(sheet: Sheet, joint: str, own: Mapping[str, Any], extra: float | None) -> list[str]:
    """The lines of one joint; `extra`: what dry friction has more at rest than in motion."""
    now = sheet.after[joint]
    kind = "DelayedPDActuatorCfg" if now.delay else "IdealPDActuatorCfg"
    given: dict[str, Any] = {}
    if sheet.driven:
        given |= {"stiffness": now.kp, "damping": now.kd}
    if "armature" in own:
        given["armature"] = now.armature
    if "damping" in own:
        given["viscous_friction"] = now.damping
    if "frictionloss" in own or extra is not None:
        given["friction"] = now.frictionloss + (extra or 0.0)
        given["dynamic_friction"] = now.frictionloss
    effort = limit([now.lowest, now.highest])
    if effort is not None and ("force" in own or "highest" in own or sheet.driven):
        given |= {"actuator_effort_limit": effort, "joint_effort_limit": effort}
    lines = [
        f"        {joint!r}: {kind}(",
        f"            joint_names_expr=[{re.escape(joint)!r}],",
    ]
    lines += [f"            {k}={float(v)!r}," for k, v in given.items()]
    if not sheet.driven:
        lines.append(
            "            stiffness=..., damping=...,  # your gains: the recording was driven by"
            " torques"
        )
    if now.delay:
        for end in ("min", "max"):
            lines.append(f"            {end}_delay=round({now.delay!r} / physics_dt),")
    return [*lines, "        ),"]


_TAIL = """
# In a subclass of IdealPDActuator, `compute` of the joints named above:
#     effort = super().compute(control_action, joint_pos, joint_vel)
#     effort.joint_efforts[:, k] -= law(joint_pos[:, k], joint_vel[:, k], effort.joint_efforts[:, k], physics_dt)   # FORCE
#     ... -= law(...) * torch.tanh(joint_vel[:, k] / 0.01)   # DRY, smoothed
"""
