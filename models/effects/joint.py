"""Effects at the joint: friction, drag, offsets. Each returns (smooth opposing torque, dry level minus, plus, state)."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.chain import JointEffect
from jaxid.parameter import param, Quantity, SPEED, TORQUE


class ViscousFriction(JointEffect):
    """Friction in proportion to speed."""

    name: ClassVar[str] = "viscous_friction"
    equation: ClassVar[str] = "f = coefficient qd"
    signature: ClassVar[str] = "missing torque proportional to velocity, no jump at reversal"
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = "constant speeds in both directions, at least three of them"
    coefficient: Array = param(
        0.0, 0.0, 100 * TORQUE / SPEED, scale=0.1 * TORQUE / SPEED, unit="{F} s/{X}", meaning="viscous coefficient"
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"coefficient": 0.03 * TORQUE / SPEED},
        {"coefficient": 0.3 * TORQUE / SPEED},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        return self.coefficient * s.qd, 0.0, 0.0, z


class CoulombFriction(JointEffect):
    """Dry friction of constant level, with true sticking."""

    name: ClassVar[str] = "coulomb_friction"
    equation: ClassVar[str] = "f = level sign(qd);  |f| <= level while sticking"
    signature: ClassVar[str] = "a step of the missing torque at every reversal, standstill"
    source: ClassVar[str] = "Moreau's time-stepping; seed systems of papers 001 to 003"
    excitation: ClassVar[str] = "slow reversals with rests between them"
    level: Array = param(0.0, 0.0, 2 * TORQUE, scale=0.05 * TORQUE, unit="{F}", meaning="dry friction level")
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"level": 0.01 * TORQUE},
        {"level": 0.05 * TORQUE},
        {"level": 0.2 * TORQUE},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        return 0.0, self.level, self.level, z


class AsymmetricFriction(JointEffect):
    """Viscous and dry friction that differ by direction; the means of both directions stay with the symmetric laws."""

    name: ClassVar[str] = "asymmetric_friction"
    equation: ClassVar[str] = "f = viscous |qd| + dry |sign(qd)|: added forwards, taken away backwards"
    signature: ClassVar[str] = "missing torque with the same sign in both directions of motion, zero at rest"
    source: ClassVar[str] = "direction-dependent friction of linear drives (EMPS benchmark's own variant)"
    excitation: ClassVar[str] = "the same constant speeds forwards and backwards, and a standstill"
    dry: Array = param(0.0, -TORQUE, TORQUE, scale=0.05 * TORQUE, unit="{F}", meaning="half the difference of the dry levels")
    viscous: Array = param(
        0.0,
        -20 * TORQUE / SPEED,
        20 * TORQUE / SPEED,
        scale=0.05 * TORQUE / SPEED,
        unit="{F} s/{X}",
        meaning="half the difference of the viscous coefficients",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"dry": 0.03 * TORQUE},
        {"dry": -0.03 * TORQUE},
        {"viscous": 0.1 * TORQUE / SPEED},
        {"viscous": -0.1 * TORQUE / SPEED},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        return self.viscous * jnp.abs(s.qd), -self.dry, self.dry, z


class StribeckFriction(JointEffect):
    """Additional dry friction at low speed that fades as the surfaces separate."""

    name: ClassVar[str] = "stribeck_friction"
    refines: ClassVar[str] = "coulomb_friction"
    equation: ClassVar[str] = "f = extra exp(-(qd / speed)^2) sign(qd)"
    signature: ClassVar[str] = "a bump of the missing torque at low speed only; breakaway above the sliding level"
    source: ClassVar[str] = "paper 000 (Stribeck terms of both joints)"
    excitation: ClassVar[str] = "slow ramps through zero speed and micro-reversals of a few milliradians"
    extra: Array = param(0.0, 0.0, 2 * TORQUE, scale=0.05 * TORQUE, unit="{F}", meaning="breakaway level above the sliding level")
    speed: Array = param(0.1, 0.002 * SPEED, SPEED, scale=0.05 * SPEED, unit="{X}/s", meaning="Stribeck velocity", log=True)
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"extra": 0.1 * TORQUE, "speed": 0.02 * SPEED},
        {"extra": 0.1 * TORQUE, "speed": 0.1 * SPEED},
        {"extra": 0.1 * TORQUE, "speed": 0.4 * SPEED},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        level = self.extra * jnp.exp(-((s.qd / self.speed) ** 2))
        return 0.0, level, level, z


class LoadDependentFriction(JointEffect):
    """Dry friction that grows with the torque that passes the gear."""

    name: ClassVar[str] = "load_dependent_friction"
    equation: ClassVar[str] = "f = mu |load| sign(qd), load the drive torque at the joint"
    signature: ClassVar[str] = "a step at reversal whose height follows the load"
    source: ClassVar[str] = "load-dependent models of geared servos (Duclusaud et al., arXiv 2410.08650)"
    excitation: ClassVar[str] = "the same motion under two or three payloads or poses"
    mu: Array = param(0.0, 0.0, 0.9, scale=0.03, unit="1", meaning="dry friction per torque transmitted")
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ({"mu": 0.02}, {"mu": 0.1}, {"mu": 0.3})

    def start(self, q):
        return ()

    def __call__(self, s, z):
        level = self.mu * jnp.abs(s.load)
        return 0.0, level, level, z


class QuadraticDrag(JointEffect):
    """Drag of the surrounding air or fluid."""

    name: ClassVar[str] = "quadratic_drag"
    equation: ClassVar[str] = "f = coefficient |qd| qd"
    signature: ClassVar[str] = "missing torque at high speed, in proportion to the square of speed"
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = "runs at half and at full top speed"
    coefficient: Array = param(
        0.0,
        0.0,
        20 * TORQUE / (SPEED * SPEED),
        scale=0.1 * TORQUE / (SPEED * SPEED),
        unit="{F} s^2/{X}^2",
        meaning="drag coefficient",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"coefficient": 0.02 * TORQUE / (SPEED * SPEED)},
        {"coefficient": 0.2 * TORQUE / (SPEED * SPEED)},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        return self.coefficient * jnp.abs(s.qd) * s.qd, 0.0, 0.0, z


class ConstantTorque(JointEffect):
    """A constant torque: cable, unbalanced load, amplifier offset."""

    name: ClassVar[str] = "constant_torque"
    equation: ClassVar[str] = "f = torque, always"
    signature: ClassVar[str] = "mean of the missing torque, also at rest"
    source: ClassVar[str] = "offset of the EMPS and UR10 models"
    excitation: ClassVar[str] = "a standstill with the drive released, and slow motion both ways"
    torque: Array = param(
        0.0, -TORQUE, TORQUE, scale=0.03 * TORQUE, unit="{F}", meaning="constant torque against positive motion"
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ({"torque": 0.03 * TORQUE}, {"torque": -0.03 * TORQUE})

    def start(self, q):
        return ()

    def __call__(self, s, z):
        return self.torque + 0 * s.q, 0.0, 0.0, z
