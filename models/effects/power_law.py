"""Friction that grows with a power of speed: the law of paper 001 for harmonic drives."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.effect import JointEffect
from jaxid.dynamics.export_law import ExportLaw
from jaxid.dynamics.parameter import param, Quantity, SPEED, TORQUE


#: Below this speed (rad/s or m/s) the power is rounded off, so that its slope at rest is finite.
REST = 1e-3


def power_law(qd, exponent):
    """|qd|^exponent sign(qd), rounded off below `REST`; exactly qd at exponent 1, every derivative finite everywhere."""
    # log of the squared speed: NaN-free at rest for any exponent, and its derivative by the
    # exponent too
    return qd * jnp.exp((exponent - 1) / 2 * jnp.log(qd * qd + REST * REST))


class PowerLawFriction(JointEffect):
    """Viscous friction with an exponent: below 1, lubricant that thins with speed."""

    name: ClassVar[str] = "power_law_friction"
    equation: ClassVar[str] = (
        "f = coefficient (qd^2 + rest^2)^((exponent - 1) / 2) qd, rest = 0.001 rad/s (m/s)"
    )
    signature: ClassVar[str] = (
        "missing torque that rises steeply at low speed and flattens at high speed (exponent"
        " below 1)"
    )
    source: ClassVar[str] = "paper 001, equation (2): F_v |qd|^alpha sign(qd)"
    excitation: ClassVar[str] = "constant speeds over two decades in both directions"
    axis: ClassVar[str] = "speed"
    seen: ClassVar[str] = "with speed to the power {exponent}"
    plain: ClassVar[str] = "Friction grows with speed to the power {exponent}, not in proportion."
    check: ClassVar[str] = "Compare constant speeds, slow and fast; look at the grease."
    export_law: ClassVar = ExportLaw(
        "force", "coefficient * (qd ** 2 + 1e-6) ** ((exponent - 1) / 2) * qd"
    )
    coefficient: Array = param(
        0.0,
        0.0,
        100 * TORQUE / SPEED,
        scale=0.1 * TORQUE / SPEED,
        unit="{F} (s/{X})^exponent",
        meaning="friction at 1 rad/s (m/s)",
    )
    exponent: Array = param(
        1.0,
        0.1,
        2.0,
        log=True,
        scale=0.1,
        unit="1",
        meaning="power of the speed; 1 is viscous friction",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"coefficient": 0.1 * TORQUE, "exponent": 0.3},
        {"coefficient": 0.1 * TORQUE, "exponent": 0.6},
        {"coefficient": 0.1 * TORQUE / SPEED, "exponent": 1.5},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"coefficient": 0.1 * TORQUE / SPEED, "exponent": 0.5},
        {"coefficient": 0.3 * TORQUE / SPEED, "exponent": 0.7},
        {"coefficient": 0.1 * TORQUE / SPEED, "exponent": 1.6},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        return self.coefficient * power_law(s.qd, self.exponent), 0.0, 0.0, z
