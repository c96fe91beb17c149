"""Channels of a robot: joints by name, their goals and torques, and the motion of a base that is
carried along.
"""

from __future__ import annotations

from jaxid.dynamics.mechanism import Signature
from jaxid.robots.tree import Tree


PLACE = ("x", "y", "z", "roll", "pitch", "yaw")


GRAVITY = ("gravity_x", "gravity_y", "gravity_z")


def goal(joint: str) -> str:
    return f"{joint}_cmd"


def torque(joint: str) -> str:
    return f"{joint}_tau"


#: How a base that is measured moves: its angles, their rates and accelerations.
RIDE = tuple(
    (f"base_{k}{end}", unit)
    for end, unit in (("", "rad"), ("_qd", "rad/s"), ("_qdd", "rad/s^2"))
    for k in PLACE[3:]
)


def signature_of(
    tree: Tree, driven: bool, rates: tuple[str, ...] = (), rides: bool = False
) -> Signature:
    """Channels of a robot: goals or torques in, then the goals' rates and the motion of the base,
    joint positions out, by the joints' names.
    """
    joints = tree.leading
    driven_joints = tree.driven
    slides = tuple(tree.slides[tree.joints.index(j)] for j in joints)
    outputs = tuple((j, "m" if s else "rad") for j, s in zip(joints, slides, strict=True))
    goals = tuple((goal(j), unit) for j, (_, unit) in zip(driven_joints, outputs, strict=False))
    torques = tuple(
        (torque(j), "N" if s else "N m") for j, s in zip(driven_joints, slides, strict=False)
    )
    beside = (
        *((n, f"{unit}/s") for n, (_, unit) in zip(rates, outputs, strict=False)),
        *(RIDE if rides else ()),
    )
    return Signature(
        (*(goals if driven else torques), *beside),
        outputs,
        joints,
        prismatic=slides if any(slides) else (),
        beside=len(beside),
        rates=len(rates),
    )
