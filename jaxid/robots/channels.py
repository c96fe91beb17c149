"""Channels of a robot: joints by name, their goals and torques, and the motion of a base that is
carried along.
"""

from __future__ import annotations

from itertools import product

from jaxid.dynamics.mechanism import Signature
from jaxid.robots.tree import Tree


PLACE = ("x", "y", "z", "roll", "pitch", "yaw")


GRAVITY = ("gravity_x", "gravity_y", "gravity_z")


def goal(joint: str) -> str:
    return f"{joint}_cmd"


def torque(joint: str) -> str:
    return f"{joint}_tau"


#: How a base that is measured moves: its angles, their rates and accelerations.
_OF_ANGLES = {"": "rad", "_qd": "rad/s", "_qdd": "rad/s^2"}
RIDE = tuple(
    (f"base_{angle}{end}", unit) for (end, unit), angle in product(_OF_ANGLES.items(), PLACE[3:])
)


def signature_of(
    tree: Tree, driven: bool, rates: tuple[str, ...] = (), rides: bool = False
) -> Signature:
    """Channels of a robot: goals or torques in, then the goals' rates and the motion of the base,
    joint positions out, by the joints' names.
    """
    joints = tree.leading
    slides = tuple(tree.slides[tree.joints.index(j)] for j in joints)
    units, forces = [], []
    for slide in slides:
        units.append("m" if slide else "rad")
        forces.append("N" if slide else "N m")
    if driven:
        inputs = [(goal(j), unit) for j, unit in zip(tree.driven, units, strict=False)]
    else:
        inputs = [(torque(j), unit) for j, unit in zip(tree.driven, forces, strict=False)]
    beside = [(name, f"{unit}/s") for name, unit in zip(rates, units, strict=False)]
    if rides:
        beside += RIDE
    return Signature(
        (*inputs, *beside),
        tuple(zip(joints, units, strict=True)),
        joints,
        prismatic=slides if any(slides) else (),
        beside=len(beside),
        rates=len(rates),
    )
