"""The rigs of four papers, with effects withheld: the flexible link (002) and the tracker (003)
under the steps that the papers drive them by, the UR10 (001) and the space manipulator (000) by
torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxid.benchmark import rig_sets
from jaxid.benchmark.arm_sets import by_torque, TorqueArm
from jaxid.benchmark.case import BlindCase, Draft
from jaxid.study.papers.twins import space_arm


#: Friction of the UR10 in Table VI of paper 001, with the exponents left out: dry (the second one
#: is no level there, so that it has the mean of its neighbours) and viscous.
UR10_DRY = (10.0, 7.6, 5.18, 2.78, 2.01, 1.75)
UR10_VISCOUS = (21.6, 26.4, 15.1, 2.77, 3.46, 3.53)
#: Rigs of the set, one after another.
RIGS = ("flexible_link", "tracker", "ur10", "space_manipulator")


def drafts(name: str, seed: int, numbers: Sequence[int]) -> list[Draft]:
    """Cases of the papers' rigs."""
    return [_draft(name, seed, number) for number in numbers]


def _draft(name: str, seed: int, number: int) -> Draft:
    rig = RIGS[number % len(RIGS)]
    if rig in ARMS:
        return Draft(name, seed, number, f"{name} {rig}", _arms, {"rig": rig})
    draft = rig_sets.draft_of(rig, name, seed, number)
    return replace(draft, group=f"{name} {draft.group}")


def _arms(group: Sequence[Draft]) -> list[BlindCase]:
    return [by_torque(ARMS[draft.plan["rig"]](), draft.rng()) for draft in group]


def ur10() -> TorqueArm:
    """Kinematics of Table III of paper 001, bodies that are physically consistent."""
    from jaxid.models import UR10

    arm = UR10()
    bodies = np.asarray(arm.inertia(), float)
    return TorqueArm(
        alpha=np.asarray(arm.alpha, float),
        a=np.asarray(arm.a, float),
        d=np.asarray(arm.d, float),
        bodies=bodies,
        drives=np.asarray(arm.Ia, float),
        viscous=np.array(UR10_VISCOUS),
        dry=np.array(UR10_DRY),
    )


def space_manipulator() -> TorqueArm:
    """The arm of paper 000 on a base that stands still: both axes upright, so that gravity, which
    it has none of, does no work. The friction is that of its sliding joints.
    """
    link, body = space_arm.LINK, space_arm.BODY
    return TorqueArm(
        alpha=np.zeros(2),
        a=np.array([0.0, link["l1"]]),
        d=np.zeros(2),
        bodies=np.array(
            [
                _flat(link["m1"], link["m1"] * link["c1"], 0.0, link["I1"]),
                _flat(body["m2"], body["hx"], body["hy"], body["I2"]),
            ]
        ),
        drives=np.full(2, 1e-3),
        viscous=np.array(space_arm.FRICTION["F_v"]),
        dry=np.array(space_arm.FRICTION["F_c"]),
    )


def _flat(mass: float, hx: float, hy: float, about: float) -> np.ndarray:
    """A body [10] that turns in its plane: mass, first moments and inertia about the joint. The
    inertia about the axes in the plane, which never turn, is that of a rod and a disc between.
    """
    own = about - (hx**2 + hy**2) / mass
    across = 0.6 * own
    return np.array(
        [across + hy**2 / mass, -hx * hy / mass, 0.0, across + hx**2 / mass, 0.0, about]
        + [hx, hy, 0.0, mass]
    )


#: Rigs by torque.
ARMS = {"ur10": ur10, "space_manipulator": space_manipulator}
