"""Friction at the joint. Each effect returns (smooth opposing torque, dry level minus, plus,
state).
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.effect import JointEffect
from jaxid.dynamics.export_law import ExportLaw, StandsFor
from jaxid.dynamics.parameter import ANGLE, param, Quantity, setting, SPEED, TORQUE
from jaxid.numerics.fast_math import sincos


class ViscousFriction(JointEffect):
    """Friction in proportion to speed."""

    name: ClassVar[str] = "viscous_friction"
    equation: ClassVar[str] = "f = coefficient qd"
    signature: ClassVar[str] = "missing torque proportional to velocity, no jump at reversal"
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = "constant speeds in both directions, at least three of them"
    axis: ClassVar[str] = "speed"
    seen: ClassVar[str] = "in proportion to speed"
    plain: ClassVar[str] = "Friction grows with speed by {coefficient} more than stated."
    check: ClassVar[str] = "Look at bearings, seals and the viscosity of the grease."
    stands_for: ClassVar = StandsFor("damping", "coefficient", fitted="damping")
    export_law: ClassVar = ExportLaw("force", "coefficient * qd")
    coefficient: Array = param(
        0.0,
        0.0,
        100 * TORQUE / SPEED,
        scale=0.1 * TORQUE / SPEED,
        unit="{F} s/{X}",
        meaning="viscous coefficient",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"coefficient": 0.03 * TORQUE / SPEED},
        {"coefficient": 0.3 * TORQUE / SPEED},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"coefficient": 0.02 * TORQUE / SPEED},
        {"coefficient": 0.2 * TORQUE / SPEED},
        {"coefficient": 1.0 * TORQUE / SPEED},
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
    axis: ClassVar[str] = "speed"
    seen: ClassVar[str] = "whenever it moves, against the motion, and at standstill"
    plain: ClassVar[str] = (
        "Dry friction of {level} opposes every motion and holds the joint at standstill."
    )
    check: ClassVar[str] = (
        "Find the smallest torque that starts the motion, both ways; look at bearings, seals,"
        " brakes that drag."
    )
    stands_for: ClassVar = StandsFor("frictionloss", "level", fitted="frictionloss")
    export_law: ClassVar = ExportLaw("dry", "level + 0 * q")
    level: Array = param(
        0.0, 0.0, 2 * TORQUE, scale=0.05 * TORQUE, unit="{F}", meaning="dry friction level"
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"level": 0.01 * TORQUE},
        {"level": 0.05 * TORQUE},
        {"level": 0.2 * TORQUE},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"level": 0.03 * TORQUE},
        {"level": 0.1 * TORQUE},
        {"level": 0.3 * TORQUE},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        return 0.0, self.level, self.level, z


class AsymmetricFriction(JointEffect):
    """Viscous and dry friction that differ by direction; the means of both directions stay with the
    symmetric laws.
    """

    name: ClassVar[str] = "asymmetric_friction"
    equation: ClassVar[str] = (
        "f = viscous |qd| + dry |sign(qd)|: added forwards, taken away backwards"
    )
    signature: ClassVar[str] = (
        "missing torque with the same sign in both directions of motion, zero at rest"
    )
    source: ClassVar[str] = (
        "direction-dependent friction of linear drives (EMPS benchmark's own variant)"
    )
    excitation: ClassVar[str] = "the same constant speeds forwards and backwards, and a standstill"
    axis: ClassVar[str] = "speed"
    seen: ClassVar[str] = "otherwise forwards than backwards"
    plain: ClassVar[str] = (
        "Friction differs between forwards and backwards (half the difference: {dry} dry, {viscous}"
        " viscous)."
    )
    check: ClassVar[str] = (
        "Run the same speed both ways; look at preload, screws, belts, gears that bind one way."
    )
    export_law: ClassVar = ExportLaw("force", "viscous * abs(qd) + dry * abs(sign(qd))")
    dry: Array = param(
        0.0,
        -TORQUE,
        TORQUE,
        scale=0.05 * TORQUE,
        unit="{F}",
        meaning="half the difference of the dry levels",
    )
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
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"dry": 0.05 * TORQUE, "viscous": 0.0 * TORQUE / SPEED},
        {"dry": 0.0 * TORQUE, "viscous": -0.1 * TORQUE / SPEED},
        {"dry": -0.03 * TORQUE, "viscous": 0.05 * TORQUE / SPEED},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        return self.viscous * jnp.abs(s.qd), -self.dry, self.dry, z


class StribeckFriction(JointEffect):
    """Additional dry friction at low speed that fades as the surfaces separate."""

    name: ClassVar[str] = "stribeck_friction"
    span: ClassVar = staticmethod(lambda p: (-2 * p["speed"], 2 * p["speed"]))
    refines: ClassVar[str] = "coulomb_friction"
    equation: ClassVar[str] = "f = extra exp(-(qd / speed)^2) sign(qd)"
    signature: ClassVar[str] = (
        "a bump of the missing torque at low speed only; breakaway above the sliding level"
    )
    source: ClassVar[str] = "paper 000 (Stribeck terms of both joints)"
    excitation: ClassVar[str] = (
        "slow ramps through zero speed and micro-reversals of a few milliradians"
    )
    axis: ClassVar[str] = "speed"
    seen: ClassVar[str] = "at speeds below about {speed}"
    plain: ClassVar[str] = (
        "Friction is higher when it moves slowly: {extra} more at the start, gone at a few times"
        " {speed}."
    )
    check: ClassVar[str] = "Look at lubrication; expect stick-slip in slow motion."
    export_law: ClassVar = ExportLaw("dry", "extra * exp(-(qd / speed) ** 2)")
    extra: Array = param(
        0.0,
        0.0,
        2 * TORQUE,
        scale=0.05 * TORQUE,
        unit="{F}",
        meaning="breakaway level above the sliding level",
    )
    speed: Array = param(
        0.1,
        0.002 * SPEED,
        SPEED,
        scale=0.05 * SPEED,
        unit="{X}/s",
        meaning="Stribeck velocity",
        log=True,
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"extra": 0.1 * TORQUE, "speed": 0.02 * SPEED},
        {"extra": 0.1 * TORQUE, "speed": 0.1 * SPEED},
        {"extra": 0.1 * TORQUE, "speed": 0.4 * SPEED},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"extra": 0.05 * TORQUE, "speed": 0.3 * SPEED},
        {"extra": 0.1 * TORQUE, "speed": 0.6 * SPEED},
        {"extra": 0.2 * TORQUE, "speed": 1.0 * SPEED},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        level = self.extra * jnp.exp(-((s.qd / self.speed) ** 2))
        return 0.0, level, level, z


class LoadDependentFriction(JointEffect):
    """Dry friction that grows with the torque that passes the gear: the drive's, that which goes on
    to what hangs on the joint (gravity and inertia forces, without friction and rotor), or both, in
    a proportion that the data tell.

    While it holds a load both are the same; they part with friction, and with what the rotor takes.
    """

    name: ClassVar[str] = "load_dependent_friction"
    transmits: ClassVar[bool] = True
    by_torque: ClassVar[bool] = True
    equation: ClassVar[str] = (
        "f = mu |load| sign(qd); load = drive: the drive torque at the joint; transmitted: M qdd +"
        " bias without the rotor; combined: drive_share drive + (1 - drive_share) transmitted"
    )
    signature: ClassVar[str] = "a step at reversal whose height follows the load"
    source: ClassVar[str] = (
        "load-dependent models of geared servos (Duclusaud et al., arXiv 2410.08650; combined:"
        " their directional model, |K_m tau_m - K_e tau_e| with K_m = mu drive_share, K_e = mu (1 -"
        " drive_share))"
    )
    excitation: ClassVar[str] = "the same motion under two or three payloads or poses"
    axis: ClassVar[str] = "load"
    seen: ClassVar[str] = "whenever it moves under load"
    plain: ClassVar[str] = (
        "Friction grows with the load: {mu:%} of the torque that passes the gear."
    )
    check: ClassVar[str] = (
        "Compare the same motion with and without load; look at the efficiency of the gear (worm"
        " and screw drives)."
    )
    export_law: ClassVar = ExportLaw("dry", "mu * abs(load)")
    mu: Array = param(
        0.0, 0.0, 0.9, scale=0.03, unit="1", meaning="dry friction per torque that passes the gear"
    )
    drive_share: Array = param(
        1.0,
        0.0,
        1.0,
        scale=0.3,
        unit="1",
        meaning="share of the drive's torque in the load, the rest being what is transmitted",
        only=("load", "combined"),
    )
    load: str = setting(
        "combined",
        words=("drive", "transmitted", "combined"),
        meaning="the torque that friction grows with",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = tuple(
        {"mu": mu, "drive_share": share}
        for mu, share in ((0.02, 1.0), (0.1, 1.0), (0.3, 1.0), (0.02, 0.0), (0.1, 0.0), (0.3, 0.0))
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"mu": 0.03},
        {"mu": 0.1},
        {"mu": 0.3},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        both = self.drive_share * s.load + (1 - self.drive_share) * s.transmitted
        level = self.mu * jnp.abs(
            {"drive": s.load, "transmitted": s.transmitted, "combined": both}[self.load]
        )
        return 0.0, level, level, z


class QuadraticDrag(JointEffect):
    """Drag of the surrounding air or fluid."""

    name: ClassVar[str] = "quadratic_drag"
    equation: ClassVar[str] = "f = coefficient |qd| qd"
    signature: ClassVar[str] = "missing torque at high speed, in proportion to the square of speed"
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = "runs at half and at full top speed"
    axis: ClassVar[str] = "speed"
    seen: ClassVar[str] = "at high speed, with its square"
    plain: ClassVar[str] = "A drag that grows with the square of speed is missing: {coefficient}."
    check: ClassVar[str] = "Look for fans, blades, air or oil that is churned."
    resembles: ClassVar[tuple[str, ...]] = ("power_law_friction",)
    stands_for: ClassVar = StandsFor("quadratic", "coefficient", fitted="quadratic_damping")
    export_law: ClassVar = ExportLaw("force", "coefficient * qd * abs(qd)")
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
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"coefficient": 0.02 * TORQUE / SPEED**2},
        {"coefficient": 0.2 * TORQUE / SPEED**2},
        {"coefficient": 1.0 * TORQUE / SPEED**2},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        return self.coefficient * jnp.abs(s.qd) * s.qd, 0.0, 0.0, z


class PositionDependentFriction(JointEffect):
    """Dry friction that varies with position: eccentric gears, preload, seals."""

    name: ClassVar[str] = "position_dependent_friction"
    refines: ClassVar[str] = "coulomb_friction"
    equation: ClassVar[str] = (
        "f = (sine sin(order q) + cosine cos(order q)) sign(qd), beside the dry level, never below"
        " zero in all"
    )
    signature: ClassVar[str] = (
        "a step of the missing torque at reversal whose height repeats with position"
    )
    source: ClassVar[str] = "textbook: first harmonic of a gear's friction"
    excitation: ClassVar[str] = "slow constant speed over the whole travel, both ways"
    axis: ClassVar[str] = "position"
    seen: ClassVar[str] = "with position, against the motion"
    plain: ClassVar[str] = (
        "Friction repeats with position: a gear or bearing that runs out of true."
    )
    check: ClassVar[str] = "Turn slowly through the whole travel and mark where it runs heavily."
    on_slide: ClassVar = {
        "plain": "Friction repeats with position: a rail, belt or screw that is not even.",
        "check": "Move slowly along the whole travel and mark where it runs heavily.",
    }
    export_law: ClassVar = ExportLaw("dry", "sine * sin(order * q) + cosine * cos(order * q)")
    sine: Array = param(
        0.0, -TORQUE, TORQUE, scale=0.02 * TORQUE, unit="{F}", meaning="amplitude of the sine"
    )
    cosine: Array = param(
        0.0, -TORQUE, TORQUE, scale=0.02 * TORQUE, unit="{F}", meaning="amplitude of the cosine"
    )
    order: Array = param(
        1.0,
        1 / ANGLE,
        100 / ANGLE,
        scale=0.3 / ANGLE,
        unit="rad/{X}",
        meaning="periods per turn (a wave number where linear)",
        log=True,
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = tuple(
        {amplitude: 0.03 * TORQUE, "order": 6.2832 * periods / ANGLE}
        for periods in (0.4, 1.0, 2.0, 4.0, 8.0)
        for amplitude in ("sine", "cosine")
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"sine": 0.03 * TORQUE, "cosine": 0.0 * TORQUE, "order": 1.0},
        {"sine": 0.0 * TORQUE, "cosine": 0.05 * TORQUE, "order": 3.0},
        {"sine": -0.05 * TORQUE, "cosine": 0.02 * TORQUE, "order": 8.0},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        sine, cosine = sincos(self.order * s.q)
        level = self.sine * sine + self.cosine * cosine
        return 0.0, level, level, z


def _but_the_last(mechanism, signature):
    return signature.joints[:-1]


class CoupledFriction(JointEffect):
    """Friction in a gear that two joints share: it opposes the sum of their speeds and acts on both
    alike.

    It belongs to a joint and the next one. Its dry part is smoothed over `speed`, since between
    joints none can stick alone.
    """

    name: ClassVar[str] = "coupled_friction"
    couples: ClassVar[bool] = True
    offered: ClassVar = staticmethod(_but_the_last)
    equation: ClassVar[str] = "f_j = f_j+1 = viscous w + dry tanh(w / speed),  w = qd_j + qd_j+1"
    signature: ClassVar[str] = (
        "missing torque at a joint that follows the speed of its neighbour, the same at both"
    )
    source: ClassVar[str] = (
        "wrists with coupled motors (Staubli TX series), e.g. Gautier, Janot, Vandanjon, IEEE TCST"
        " 21(2), 2013"
    )
    excitation: ClassVar[str] = (
        "one joint moving while the other rests, then both with equal and with opposite speeds"
    )
    axis: ClassVar[str] = "speed"
    seen: ClassVar[str] = "with the sum of the speeds of this joint and the next"
    plain: ClassVar[str] = "Two joints share a gear: its friction follows the sum of their speeds."
    check: ClassVar[str] = "Look at the drawing of the wrist for a shared gear or shaft."
    viscous: Array = param(
        0.0,
        0.0,
        50 * TORQUE / SPEED,
        scale=0.05 * TORQUE / SPEED,
        unit="{F} s/{X}",
        meaning="viscous coefficient of the shared gear",
    )
    dry: Array = param(
        0.0,
        0.0,
        2 * TORQUE,
        scale=0.05 * TORQUE,
        unit="{F}",
        meaning="dry level of the shared gear",
    )
    speed: Array = param(
        0.1,
        0.002 * SPEED,
        0.5 * SPEED,
        scale=0.02 * SPEED,
        unit="{X}/s",
        meaning="speed over which the dry part turns",
        log=True,
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"viscous": 0.1 * TORQUE / SPEED, "speed": 0.02 * SPEED},
        {"dry": 0.05 * TORQUE, "speed": 0.02 * SPEED},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"viscous": 0.1 * TORQUE / SPEED, "dry": 0.0 * TORQUE, "speed": 0.1 * SPEED},
        {"viscous": 0.0 * TORQUE / SPEED, "dry": 0.05 * TORQUE, "speed": 0.2 * SPEED},
        {"viscous": 0.3 * TORQUE / SPEED, "dry": 0.03 * TORQUE, "speed": 0.3 * SPEED},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        w = s.qd[:-1] + s.qd[1:]
        shared = self.viscous[:-1] * w + self.dry[:-1] * jnp.tanh(w / self.speed[:-1])
        none = jnp.zeros((1,))
        return jnp.concatenate([shared, none]) + jnp.concatenate([none, shared]), 0.0, 0.0, z
