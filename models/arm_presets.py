"""Arms by name: kinematics from the makers' tables; inertial parameters are jaxid's own fits or
plain estimates.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import ClassVar

import numpy as np

from jaxid.dynamics.kinematics import ArmTable, modified_dh, standard_dh
from jaxid.dynamics.mechanism import Signature

from .effects import ConstantTorque, CoulombFriction, PowerLawFriction
from .serial_arm import AbstractArm, DriveGain, signatures_of


_SIX = signatures_of((False,) * 6)
_SEVEN = signatures_of((False,) * 7)
_90 = np.pi / 2


def _ur10() -> ArmTable:
    """Table III of paper 001: modified table, theta_j = q_j; the same chain as the maker's standard
    table, turned by pi about the first and last z. Inertial parameters: physically consistent and
    closest in torque to the paper's Table VI, whose own drive inertias are partly negative and
    cannot be simulated.
    """
    content = json.loads(
        (Path(__file__).parent / "ur10_consistent.json").read_text(encoding="utf-8")
    )
    phi = np.array(content["phi"]).reshape(6, 11)
    return modified_dh(
        a=[0, 0, 0.6120, 0.5723, 0, 0],
        alpha=[0, -_90, 0, 0, -_90, _90],
        d=[0.1273, 0, 0, 0.163941, 0.1157, 0.0922],
        inertia=phi[:, :10],
        drive_inertia=phi[:, 10],
    )


class UR10(AbstractArm):
    """Universal Robots UR10 (CB3) as identified in paper 001, with its friction law; q as the
    controller's `actual_q`.
    """

    name: ClassVar[str] = "ur10"
    signatures: ClassVar[tuple[Signature, ...]] = _SIX
    source: ClassVar[str] = (
        "doi 10.1017/S026357472400105X: Tables III and VI (F_c2 := 0; made physically consistent"
        " with the maker's masses)"
    )

    def __init__(self):
        self._set(_ur10())

    def nominal_effects(self):
        return [
            DriveGain(),
            CoulombFriction(level=np.array([10.0037, 0.0, 5.1803, 2.7800, 2.0115, 1.7533])),  # pyright: ignore[reportArgumentType]
            PowerLawFriction(
                coefficient=np.array([21.6084, 26.4096, 15.1400, 2.7746, 3.4578, 3.5335]),  # pyright: ignore[reportArgumentType]
                exponent=np.array([0.5758, 0.2723, 0.6093, 0.9995, 0.8031, 0.7209]),  # pyright: ignore[reportArgumentType]
            ),
            ConstantTorque(torque=np.array([-0.3426, 0.0582, 0.1780, 0.6453, 0.6725, 0.5685])),  # pyright: ignore[reportArgumentType]
        ]


class UR10e(AbstractArm):
    """Universal Robots UR10e; q as the controller's `actual_q`. Links start as slender rods: fit
    them.
    """

    name: ClassVar[str] = "ur10e"
    signatures: ClassVar[tuple[Signature, ...]] = _SIX
    source: ClassVar[str] = (
        "Universal Robots, DH parameters for calculations of kinematics and dynamics (standard"
        " table)"
    )

    def __init__(self):
        table = standard_dh(
            a=[0, -0.6127, -0.57155, 0, 0, 0],
            alpha=[_90, 0, 0, _90, -_90, 0],
            d=[0.1807, 0, 0, 0.17415, 0.11985, 0.11655],
        )
        self._set(table)


class Panda(AbstractArm):
    """Franka Emika Panda, torques measured behind the gears (no drive inertia shows). Links start
    as slender rods: fit them.
    """

    name: ClassVar[str] = "panda"
    signatures: ClassVar[tuple[Signature, ...]] = _SEVEN
    source: ClassVar[str] = (
        "Franka Control Interface documentation, robot and interface specifications (modified table)"
    )
    motor_side: ClassVar[bool] = False

    def __init__(self):
        tool = np.eye(4)
        tool[2, 3] = 0.107
        table = modified_dh(
            a=[0, 0, 0, 0.0825, -0.0825, 0, 0.088],
            alpha=[0, -_90, _90, _90, -_90, _90, _90],
            d=[0.333, 0, 0.316, 0, 0.384, 0, 0],
            tool=tool,
        )
        self._set(table)
