"""Effects between motor and joint. Drive, friction and the joint encoder are on the motor's side of
a spring or play.
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.compliance import Compliant, compliant
from jaxid.dynamics.effect import BodyEffect, JointEffect
from jaxid.dynamics.export_law import ExportLaw
from jaxid.dynamics.parameter import ANGLE, param, Quantity, TORQUE


#: Once a step of `dt` s, in a simulator.
HYSTERESIS = '''class Hysteresis:
    """level z, dz/dq = (1 - |z|) / width where |z| grows, 1 / width where it falls."""

    def __init__(self, level, width):
        self.level, self.width, self.z = level, width, 0.0

    def __call__(self, q, qd, load, dt):
        x = qd * dt / self.width
        grows = (xp.sign(x) * self.z > 0) * 1.0
        before = self.z
        self.z = xp.clip(before + x * (1 - grows * abs(before)), -1, 1) + 0 * x
        return self.level * (before + self.z) / 2
'''


class JointElasticity(BodyEffect):
    """A motor that drives its joint through a spring; the encoder sees the motor.

    The motor's inertia is a share of the inertia that the drive sees (at q = 0), taken from the
    mechanism: without compliance the joint is rigid again and nothing has changed.
    """

    name: ClassVar[str] = "joint_elasticity"
    resembles: ClassVar[tuple[str, ...]] = ("flexible_mode",)
    stage: ClassVar[int] = 2
    equation: ClassVar[str] = (
        "t = gap / compliance + damping d(gap)/dt,  gap = q_motor - q_link,  motor_share J"
        " qdd_motor = u - f - t"
    )
    signature: ClassVar[str] = (
        "a residual in a narrow band of frequencies that rings after steps; the load sags"
    )
    source: ClassVar[str] = "Spong, ASME J. Dyn. Syst. 109(4), 1987"
    excitation: ClassVar[str] = (
        "steps or a chirp through the resonance, with a free decay after it; a second encoder at"
        " the link"
    )
    axis: ClassVar[str] = "time"
    seen: ClassVar[str] = "around the resonance of motor and link, after steps and knocks"
    plain: ClassVar[str] = "The gear gives like a spring: {compliance} between motor and link."
    check: ClassVar[str] = (
        "Block the motor, load the link and measure how far it gives; look at belts, harmonic"
        " drives, couplings."
    )
    export_law: ClassVar = (
        "needs a second joint: the motor's body, and behind it a hinge with a spring"
    )
    compliance: Array = param(
        0.0,
        0.0,
        0.5 * ANGLE / TORQUE,
        scale=0.001 * ANGLE / TORQUE,
        unit="{X}/({F})",
        meaning="deflection per torque",
    )
    motor_share: Array = param(
        0.3, 0.02, 0.95, scale=0.1, unit="1", meaning="share of the inertia on the motor's side"
    )
    damping_ratio: Array = param(
        0.05,
        1e-3,
        2.0,
        scale=0.02,
        unit="1",
        meaning="damping ratio of motor against link",
        log=True,
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = tuple(
        {"compliance": c * ANGLE / TORQUE, "motor_share": share, "damping_ratio": 0.05}
        for c in (3e-4, 3e-3, 2e-2)
        for share in (0.15, 0.6)
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"compliance": 0.01 / TORQUE, "motor_share": 0.2, "damping_ratio": 0.02},
        {"compliance": 0.03 / TORQUE, "motor_share": 0.5, "damping_ratio": 0.1},
        {"compliance": 0.1 / TORQUE, "motor_share": 0.7, "damping_ratio": 0.5},
    )

    def __call__(self, mechanism):
        m = compliant(mechanism)
        here = self.compliance > 0
        return Compliant(
            m.base,
            jnp.where(here, self.motor_share, m.share),
            m.compliance + self.compliance,
            jnp.where(here, self.damping_ratio, m.damping_ratio),
            m.play,
        )


class Backlash(BodyEffect):
    """Play between motor and joint; the encoder sees the motor.

    In the gap the motor turns alone. Contact is a spring of `contact_compliance`, damped (half the
    critical damping once pressed by a twentieth of the play), which pushes and never pulls.
    """

    name: ClassVar[str] = "backlash"
    stage: ClassVar[int] = 2
    equation: ClassVar[str] = (
        "t = soft(gap, play / 2) / contact_compliance + damping;  motor_share J qdd_motor = u -"
        " f - t"
    )
    signature: ClassVar[str] = (
        "light motion of the motor alone after each change of sign of the load, then a knock"
    )
    source: ClassVar[str] = (
        "Nordin, Gutman, Automatica 38(10), 2002 (dead-zone model with compliance)"
    )
    excitation: ClassVar[str] = (
        "small slow reversals around an unloaded position, and a second encoder at the link"
    )
    axis: ClassVar[str] = "load"
    seen: ClassVar[str] = "after each change of the load's sign, over {play}"
    plain: ClassVar[str] = "There is play of {play} between motor and link."
    check: ClassVar[str] = (
        "Block the motor and move the link by hand; look at gears, keys, couplings and belts."
    )
    export_law: ClassVar = (
        "needs a second joint: the motor's body, and behind it a hinge with limits of half the play"
        " to either side"
    )
    play: Array = param(
        0.0, 0.0, 0.5 * ANGLE, scale=0.005 * ANGLE, unit="{X}", meaning="full width of the gap"
    )
    motor_share: Array = param(
        0.3, 0.02, 0.95, scale=0.1, unit="1", meaning="share of the inertia on the motor's side"
    )
    contact_compliance: Array = param(
        1e-3,
        1e-5 * ANGLE / TORQUE,
        0.05 * ANGLE / TORQUE,
        scale=1e-4 * ANGLE / TORQUE,
        unit="{X}/({F})",
        meaning="deflection of the contact per torque",
        log=True,
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = tuple(
        {"play": play * ANGLE, "motor_share": share, "contact_compliance": 0.003 * ANGLE / TORQUE}
        for play in (0.003, 0.02, 0.08)
        for share in (0.15, 0.6)
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"play": 0.005, "motor_share": 0.2, "contact_compliance": 0.02 / TORQUE},
        {"play": 0.02, "motor_share": 0.5, "contact_compliance": 0.03 / TORQUE},
        {"play": 0.05, "motor_share": 0.7, "contact_compliance": 0.05 / TORQUE},
    )

    def __call__(self, mechanism):
        m = compliant(mechanism)
        here = self.play > 0
        return Compliant(
            m.base,
            jnp.where(here & (m.compliance == 0), self.motor_share, m.share),
            m.compliance + jnp.where(here, self.contact_compliance, 0.0),
            m.damping_ratio,
            m.play + self.play,
        )


class Hysteresis(JointEffect):
    """A torque that remembers the way: belts, cables, harmonic drives. It gives way elastically
    when the motion turns back.
    """

    name: ClassVar[str] = "hysteresis"
    equation: ClassVar[str] = (
        "f = level z;  dz/dq = (1 - |z|) / width where |z| grows, 1 / width where it falls"
    )
    signature: ClassVar[str] = (
        "loops of the missing torque against position, at any speed, with soft corners"
    )
    source: ClassVar[str] = (
        "Bouc-Wen model with n = 1, beta = gamma = A / 2 (Wen, ASCE J. Eng. Mech. 102(2), 1976)"
    )
    excitation: ClassVar[str] = (
        "slow strokes of several sizes around one position, from a tenth of the travel to all of it"
    )
    axis: ClassVar[str] = "position"
    seen: ClassVar[str] = "after every reversal, over about {width}"
    plain: ClassVar[str] = (
        "The joint winds up: {level} builds up over {width} after each reversal and stays, at any"
        " speed."
    )
    check: ClassVar[str] = (
        "Load and unload slowly and draw torque against angle; look at cables, belts, harmonic"
        " drives."
    )
    export_law: ClassVar = ExportLaw("force", memory=HYSTERESIS)
    level: Array = param(
        0.0,
        0.0,
        2 * TORQUE,
        scale=0.05 * TORQUE,
        unit="{F}",
        meaning="torque at the end of a long stroke",
    )
    width: Array = param(
        0.1,
        1e-4 * ANGLE,
        ANGLE,
        scale=0.01 * ANGLE,
        unit="{X}",
        meaning="distance over which the torque turns",
        log=True,
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"level": 0.05 * TORQUE, "width": 3e-3 * ANGLE},
        {"level": 0.05 * TORQUE, "width": 0.03 * ANGLE},
        {"level": 0.05 * TORQUE, "width": 0.2 * ANGLE},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"level": 0.05 * TORQUE, "width": 0.2},
        {"level": 0.1 * TORQUE, "width": 0.05},
        {"level": 0.2 * TORQUE, "width": 0.03},
    )

    def start(self, q):
        return jnp.zeros_like(q)

    def __call__(self, s, z):
        x = s.qd * s.h / self.width
        way = jnp.where(x >= 0, 1.0, -1.0)
        ahead = way * z  # in the direction of motion: below zero it falls, above it grows
        path = jnp.abs(x)
        left = jnp.maximum(path - jnp.maximum(-ahead, 0.0), 0.0)  # of the path, once zero is passed
        grown = 1 - (1 - jnp.maximum(ahead, 0.0)) * jnp.exp(-left)
        end = way * jnp.where(path < -ahead, ahead + path, grown)
        small = jnp.where(ahead < 0, z + x, z + x * (1 - jnp.abs(z)))
        end = jnp.where(path < 1e-8, small, end)  # the slope at rest
        return self.level * (z + end) / 2, 0.0, 0.0, end
