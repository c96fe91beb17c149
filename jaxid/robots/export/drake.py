"""Drake: calls on a `MultibodyPlant` before it is finalised."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxid.robots.export.config import written
from jaxid.robots.export.outcome import ExportOutcome
from jaxid.robots.export.sheet import LinkInertia, Sheet
from jaxid.robots.export.target import Field, limit, Written


NAME, VERSION, FILES = "drake", "Drake 1.58", ()
FIELDS = {
    "damping": Field("Joint.set_default_damping({joint})"),
    "armature": Field("JointActuator.set_default_rotor_inertia, set_default_gear_ratio({joint})",
                      note="rotor inertia times the square of the gear ratio, which is 1 here"),
    "kp": Field("JointActuator.set_controller_gains({joint})", note="PdControllerGains.p"),
    "kd": Field("JointActuator.set_controller_gains({joint})", note="PdControllerGains.d"),
    "force": Field("AddJointActuator(effort_limit)", note="given where the actuator is made", one=True),
    "highest": Field("AddJointActuator(effort_limit)", note="given where the actuator is made", one=True),
    "inertial": Field("SpatialInertia of {link}", note="set it in the model file, or by a context"),
    "gravity": Field("plant.mutable_gravity_field().set_gravity_vector"),
}  # fmt: skip
ELSEWHERE = {
    "frictionloss": "Drake has no dry friction at joints (18932): a LeafSystem that takes it times tanh(qd / 0.01) off",
    "delay": "a DiscreteTimeDelay system before the plant", "lag": "a FirstOrderLowPassFilter system before the plant",
    "stiffness": "a ForceElement: RevoluteSpring(joint, springref, stiffness)",
    "springref": "the nominal angle of that RevoluteSpring",
    "bias": "Joint.set_default_positions and the frame of the joint, turned back by as much",
    "torque": "a constant added to the actuation input", "drive": "a Gain system before the actuation input",
    "offset": "a constant added to the actuation input",
    "ki": "a PidController system in place of the gains", "lowest": "AddJointActuator has one limit for both directions",
    **dict.fromkeys(("quadratic", "cubic"), "a LeafSystem as actuation: -(b qd |qd| + c qd^3)"),
}  # fmt: skip


def write(sheet: Sheet, _found: ExportOutcome, _path: Path | None) -> Written:
    """`drake_apply.py`."""
    return written(sheet, FIELDS, ELSEWHERE, "drake_apply.py", _text, VERSION, "numpy")


def _text(
    sheet: Sheet, numbers: Mapping[str, dict[str, Any]], bodies: Mapping[str, LinkInertia]
) -> str:
    lines = [
        f'"""What was found, on a MultibodyPlant; written for {VERSION}, not run."""',
        "",
        "import numpy as np",
        "from pydrake.multibody.tree import PdControllerGains, RotationalInertia, SpatialInertia",
        "",
        "",
        "def actuator_of(plant, joint):",
        '    """The actuator of a joint."""',
        "    every = [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices()]",
        "    return next(a for a in every if a.joint().name() == joint)",
        "",
        "",
        "def apply(plant):",
        '    """Before plant.Finalize()."""',
    ]
    for joint, own in numbers.items():
        now = sheet.after[joint]
        if "damping" in own:
            lines.append(
                f"    plant.GetJointByName({joint!r}).set_default_damping({now.damping!r})"
            )
        if "armature" in own:
            lines += [
                f"    a = actuator_of(plant, {joint!r})",
                f"    a.set_default_rotor_inertia({now.armature!r})",
                "    a.set_default_gear_ratio(1.0)",
            ]
        if sheet.driven and {"kp", "kd"} & own.keys():
            lines.append(
                "    actuator_of(plant,"
                f" {joint!r}).set_controller_gains(PdControllerGains(p={now.kp!r}, d={now.kd!r}))"
            )
        effort = limit([now.lowest, now.highest])
        if effort is not None and {"force", "highest"} & own.keys():
            lines.append(
                f"    # plant.AddJointActuator(..., plant.GetJointByName({joint!r}),"
                f" effort_limit={effort!r})"
            )
    if sheet.gravity is not None and any(c.quantity == "gravity" for c in sheet.changes):
        lines.append(
            f"    plant.mutable_gravity_field().set_gravity_vector({[float(v) for v in sheet.gravity[1]]!r})"
        )
    lines += [
        "    return plant",
        "",
        "",
        "#: link -> its spatial inertia, for AddRigidBody.",
        "INERTIA = {",
    ]
    for link, body in bodies.items():
        com = [float(v) for v in body.com]
        I = body.inertia
        six = [float(I[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        lines.append(
            f"    {link!r}: SpatialInertia.MakeFromCentralInertia({body.mass!r}, np.array({com!r}),"
            f" RotationalInertia(*{six!r})),"
        )
    return "\n".join([*lines, "}", ""])
