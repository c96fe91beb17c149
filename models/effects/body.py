"""Forces and inertias of the mechanism that a nominal model may lack."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.dynamics.compliance import with_inertia
from jaxid.dynamics.effect import BodyEffect, JointEffect
from jaxid.dynamics.export_law import ExportLaw, StandsFor
from jaxid.dynamics.mechanism import Mechanism
from jaxid.dynamics.parameter import ANGLE, DURATION, param, Quantity, SPEED, STEP, TORQUE
from jaxid.numerics.fast_math import sincos
from jaxid.robots.bodies import one_joint_of_each_body


#: Inertia that the drive's torque would swing over the travel at the speed seen.
INERTIA = TORQUE * ANGLE / (SPEED * SPEED)
#: Damping ratio from which on a mode has no resonance: 1 / sqrt(2).
RINGS = 0.7071


@runtime_checkable
class Loadable(Protocol):
    """A mechanism that knows where a payload sits."""

    def loaded(self, mass: Float[Array, " nq"]) -> Mechanism:
        """The same with a point mass at the far end of each joint's link."""
        ...


@runtime_checkable
class Tiltable(Protocol):
    """A mechanism in gravity whose base may stand askew."""

    def tilted(self, angle: Float[Array, " nq"]) -> Mechanism:
        """The same on a base turned by angle[0] about the first joint's axis; an arm in space,
        which has two `tilts`, by angle[0] about the world's x and by angle[1] about its y.
        """
        ...


@runtime_checkable
class Stiffenable(Protocol):
    """A turning beam whose centrifugal tension may stiffen it."""

    nonlinear: bool

    def stiffened(self, share: Float[Array, " nq"]) -> Mechanism:
        """The same with more of the geometric stiffening."""
        ...


@runtime_checkable
class Loosenable(Protocol):
    """An arm on a base that may move."""

    floating: bool

    def loosened(self, share: Float[Array, " nq"]) -> Mechanism:
        """The same on a base that gives way."""
        ...


def _where_stiffenable(mechanism, signature):
    return (
        signature.joints[:1] if isinstance(mechanism, Stiffenable) and mechanism.nonlinear else ()
    )


def _where_loosenable(mechanism, signature):
    return (
        signature.joints[:1] if isinstance(mechanism, Loosenable) and not mechanism.floating else ()
    )


def _where_loadable(mechanism, signature):
    if not isinstance(mechanism, Loadable):
        return ()
    if hasattr(mechanism, "carriers"):  # a robot's bodies may have several joints each
        return one_joint_of_each_body(mechanism)
    return signature.joints


def _where_tiltable(mechanism, signature):
    return (
        signature.joints[: getattr(mechanism, "tilts", 1)]
        if isinstance(mechanism, Tiltable)
        else ()
    )


def _pushed(joint: Any, torque: float, driven: bool) -> dict[str, float]:
    return {"torque": joint.torque - torque}


def _one_spring(joint: Any, stiffness: float, driven: bool) -> dict[str, float]:
    """k1 (q - r1) + k2 q is one spring."""
    total = joint.stiffness + stiffness
    if not total:
        return {"stiffness": 0.0, "springref": 0.0}
    return {"stiffness": total, "springref": joint.stiffness * joint.springref / total}


def _heavier(joint: Any, inertia: float, driven: bool) -> dict[str, float]:
    return {"armature": joint.armature + inertia}


class ConstantTorque(JointEffect):
    """A constant torque: cable, unbalanced load, amplifier offset."""

    name: ClassVar[str] = "constant_torque"
    equation: ClassVar[str] = "f = torque, always"
    signature: ClassVar[str] = "mean of the missing torque, also at rest"
    source: ClassVar[str] = "offset of the EMPS and UR10 models"
    excitation: ClassVar[str] = "a standstill with the drive released, and slow motion both ways"
    axis: ClassVar[str] = "time"
    seen: ClassVar[str] = "always, at rest too"
    plain: ClassVar[str] = "A constant torque of {torque} acts that the model does not have."
    check: ClassVar[str] = (
        "Look for a weight, a counterbalance, an offset of the drive or of its current sensor."
    )
    stands_for: ClassVar = StandsFor("torque", "torque", after=_pushed)
    export_law: ClassVar = ExportLaw("force", "torque + 0 * q")
    torque: Array = param(
        0.0,
        -TORQUE,
        TORQUE,
        scale=0.03 * TORQUE,
        unit="{F}",
        meaning="constant torque against positive motion",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"torque": 0.03 * TORQUE},
        {"torque": -0.03 * TORQUE},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"torque": -0.2 * TORQUE},
        {"torque": 0.03 * TORQUE},
        {"torque": 0.1 * TORQUE},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        return self.torque + 0 * s.q, 0.0, 0.0, z


class SpringTorque(JointEffect):
    """A spring at the joint: cable, hose, gas spring, counterbalance."""

    name: ClassVar[str] = "spring_torque"
    equation: ClassVar[str] = "f = stiffness q"
    signature: ClassVar[str] = "missing torque in proportion to position"
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = "slow motion over the whole travel, both ways"
    axis: ClassVar[str] = "position"
    seen: ClassVar[str] = "in proportion to position"
    plain: ClassVar[str] = "A spring of {stiffness} acts at the joint."
    check: ClassVar[str] = "Look for cables, hoses, gas springs, return springs."
    stands_for: ClassVar = StandsFor("stiffness", "stiffness", after=_one_spring)
    export_law: ClassVar = ExportLaw("force", "stiffness * q")
    stiffness: Array = param(
        0.0,
        -5 * TORQUE / ANGLE,
        20 * TORQUE / ANGLE,
        scale=0.05 * TORQUE / ANGLE,
        unit="{F}/{X}",
        meaning="stiffness of the spring; below zero it pushes away, as a counterbalance does",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"stiffness": 0.02 * TORQUE / ANGLE},
        {"stiffness": 0.2 * TORQUE / ANGLE},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"stiffness": -0.1 * TORQUE},
        {"stiffness": 0.5 * TORQUE},
        {"stiffness": 2.0 * TORQUE},
    )

    def start(self, q):
        return ()

    def __call__(self, s, z):
        return self.stiffness * s.q, 0.0, 0.0, z


class FlexibleMode(JointEffect):
    """A mass that swings on the joint by a spring: a flexible link or frame, seen from the
    motor.
    """

    name: ClassVar[str] = "flexible_mode"
    resembles: ClassVar[tuple[str, ...]] = ("joint_elasticity",)
    equation: ClassVar[str] = (
        "f = inertia p'';  p'' = w^2 (q - p) + 2 damping_ratio w (qd - p'),  p the mass's position,"
        " w = 2 pi frequency"
    )
    signature: ClassVar[str] = "a residual in a narrow band of frequencies that rings after steps"
    source: ClassVar[str] = "textbook; exact solution while the joint keeps its speed over the step"
    excitation: ClassVar[str] = "steps or a chirp through the resonance, with a free decay after it"
    axis: ClassVar[str] = "time"
    seen: ClassVar[str] = "around {frequency}, after steps and knocks"
    plain: ClassVar[str] = "Something swings along at {frequency}."
    check: ClassVar[str] = "Knock at tool, cables, table and base, and look for that frequency."
    export_law: ClassVar = (
        "needs a second body: its inertia on a hinge with a spring of inertia (2 pi frequency)^2"
    )
    inertia: Array = param(
        0.0, 0.0, 20 * INERTIA, scale=0.02 * INERTIA, unit="{I}", meaning="inertia that swings"
    )
    frequency: Array = param(
        5.0,
        2 / DURATION,
        0.4 / STEP,
        scale=1 / DURATION,
        unit="Hz",
        meaning="natural frequency with the joint held",
        log=True,
    )
    damping_ratio: Array = param(
        0.03,
        1e-3,
        RINGS,
        scale=0.01,
        unit="1",
        meaning="damping ratio with the joint held; with more nothing resounds",
        log=True,
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = tuple(
        {"inertia": 0.1 * INERTIA, "frequency": ratio * SPEED / ANGLE, "damping_ratio": 0.05}
        for ratio in (1.0, 2.0, 4.0, 8.0, 16.0)
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"inertia": 0.1 * INERTIA, "frequency": 3.0, "damping_ratio": 0.02},
        {"inertia": 0.3 * INERTIA, "frequency": 6.0, "damping_ratio": 0.1},
        {"inertia": 0.5 * INERTIA, "frequency": 12.0, "damping_ratio": 0.3},
    )

    def start(self, q):
        # q - p, the mass's speed, and whether there was a step yet.
        return jnp.zeros_like(q), jnp.zeros_like(q), jnp.zeros_like(q)

    def __call__(self, s, z):
        e0, p0, begun = z
        p0 = jnp.where(begun > 0, p0, s.qd0)  # the mass moves with the joint at first
        w = 2 * jnp.pi * self.frequency
        decay = self.damping_ratio * w
        wd = w * jnp.sqrt(jnp.maximum(1 - self.damping_ratio**2, 1e-6))
        fall = jnp.exp(-decay * s.h)
        turn_s, turn_c = sincos(wd * s.h)
        # The mass under a joint at constant speed qd: e'' + 2 decay e' + w^2 e = 0 with e' = qd -
        # p'.
        r0 = s.qd - p0
        e1 = fall * (e0 * turn_c + (r0 + decay * e0) / wd * turn_s)
        r1 = fall * (r0 * turn_c - (decay * r0 + w * w * e0) / wd * turn_s)
        p1 = s.qd - r1
        # What the mass gains in momentum over the step, the joint has given.
        return self.inertia * (p1 - p0) / s.h, 0.0, 0.0, (e1, p1, jnp.ones_like(e1))


class ReflectedInertia(BodyEffect):
    """Inertia of rotor and gear at the joint, which moves with that joint alone."""

    name: ClassVar[str] = "reflected_inertia"
    stage: ClassVar[int] = 0
    equation: ClassVar[str] = "M_jj -> M_jj + inertia"
    signature: ClassVar[str] = (
        "missing torque in proportion to the joint's own acceleration, whatever the other joints do"
    )
    source: ClassVar[str] = "textbook: gear ratio squared times the rotor's inertia"
    excitation: ClassVar[str] = (
        "accelerations of one joint while another one accelerates the same and the opposite way"
    )
    axis: ClassVar[str] = "acceleration"
    seen: ClassVar[str] = "in proportion to the joint's own acceleration"
    plain: ClassVar[str] = (
        "The joint is heavier to accelerate by {inertia}: the rotor behind its gear."
    )
    check: ClassVar[str] = (
        "Look up the rotor inertia and multiply it by the square of the gear ratio."
    )
    stands_for: ClassVar = StandsFor("armature", "inertia", after=_heavier)
    inertia: Array = param(
        0.0, 0.0, 20 * INERTIA, scale=0.02 * INERTIA, unit="{I}", meaning="inertia at the joint"
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"inertia": 0.02 * INERTIA},
        {"inertia": 0.2 * INERTIA},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"inertia": 0.05 * INERTIA},
        {"inertia": 0.3 * INERTIA},
        {"inertia": 1.0 * INERTIA},
    )

    def __call__(self, mechanism):
        return with_inertia(mechanism, self.inertia)


class Payload(BodyEffect):
    """An additional mass at the far end of a link; on models that know where that is."""

    name: ClassVar[str] = "payload"
    stage: ClassVar[int] = -2
    offered: ClassVar = staticmethod(_where_loadable)
    equation: ClassVar[str] = (
        "a point mass at the end of the joint's link: inertia, coupling and gravity together"
    )
    signature: ClassVar[str] = (
        "gravity and acceleration together, at this joint and those before it"
    )
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = (
        "two poses at rest and one fast motion, without the load and with it"
    )
    axis: ClassVar[str] = "acceleration"
    seen: ClassVar[str] = "wherever the link is lifted or accelerated"
    plain: ClassVar[str] = "The link carries {mass} more than the model has."
    check: ClassVar[str] = "Weigh what is mounted: tool, cables, workpiece."
    stands_for: ClassVar = StandsFor("inertial", "mass")
    mass: Array = param(
        0.0, -20.0, 200.0, scale=0.02, unit="kg", meaning="mass beyond what the model has"
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"mass": 0.02},
        {"mass": 0.3},
        {"mass": 3.0},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"mass": 0.2},
        {"mass": 1.0},
        {"mass": 3.0},
    )

    def __call__(self, mechanism):
        return mechanism.loaded(self.mass) if isinstance(mechanism, Loadable) else mechanism


class PlacedPayload(Payload):
    """The same on a robot of a file, which does not say where a link ends: where the mass sits is a
    number as well.
    """

    equation: ClassVar[str] = (
        "a point mass (dx, dy, dz) beyond the end of the joint's link: inertia and gravity together"
    )
    dx: Array = param(
        0.0,
        -1.0,
        1.0,
        scale=0.02,
        unit="m",
        meaning="beyond the next joint, or the link's centre of mass, x",
    )
    dy: Array = param(
        0.0, -1.0, 1.0, scale=0.02, unit="m", meaning="the same in y of the link's frame"
    )
    dz: Array = param(
        0.0, -1.0, 1.0, scale=0.02, unit="m", meaning="the same in z of the link's frame"
    )
    #: Numbers whose products with the mass the motion shows, to first order.
    moments: ClassVar[tuple[str, ...]] = ("dx", "dy", "dz")

    def __call__(self, mechanism):
        return mechanism.loaded(self.mass, jnp.stack([self.dx, self.dy, self.dz], -1))


class GravityOffset(BodyEffect):
    """A base that stands askew: gravity turned about the first joint's axis."""

    name: ClassVar[str] = "gravity_offset"
    stage: ClassVar[int] = -1
    offered: ClassVar = staticmethod(_where_tiltable)
    equation: ClassVar[str] = (
        "gravity(q) -> gravity with the base turned by tilt about the first joint's axis"
    )
    signature: ClassVar[str] = (
        "missing torque that follows the derivative of the gravity torque by position"
    )
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = (
        "rests all around the travel, with the joint's zero checked by a level"
    )
    axis: ClassVar[str] = "position"
    seen: ClassVar[str] = "with the posture, where gravity acts"
    plain: ClassVar[str] = "Gravity acts as if the base were tilted by {tilt}."
    check: ClassVar[str] = "Put a level on the base; check how the zero of the joint was set."
    stands_for: ClassVar = StandsFor("gravity", "tilt")
    by_torque: ClassVar[bool] = True
    tilt: Array = param(0.0, -0.5, 0.5, scale=0.01, unit="rad", meaning="angle of the base")
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ({"tilt": 0.03},)
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"tilt": 0.02},
        {"tilt": 0.1},
        {"tilt": -0.3},
    )

    def __call__(self, mechanism):
        return mechanism.tilted(self.tilt) if isinstance(mechanism, Tiltable) else mechanism


class GeometricStiffening(BodyEffect):
    """A turning beam that its own centrifugal tension stiffens; on a flexible link with its
    nonlinear terms.
    """

    name: ClassVar[str] = "geometric_stiffening"
    stage: ClassVar[int] = -1
    offered: ClassVar = staticmethod(_where_stiffenable)
    equation: ClassVar[str] = (
        "K_psi -> K_psi + share phid^2 K_G,  K_G = int (m_p L + rho A (L^2 - x^2) / 2) N' N'^T dx"
    )
    signature: ClassVar[str] = (
        "the beam's frequency rises with the hub's speed where the model lets it fall"
    )
    source: ClassVar[str] = (
        "foreshortening of a rotating beam; the linear strain of paper 002 has softening only"
    )
    excitation: ClassVar[str] = "the same pulse at rest and during a fast turn (7 rad/s and more)"
    axis: ClassVar[str] = "speed"
    seen: ClassVar[str] = "at high speed of the hub"
    plain: ClassVar[str] = "The beam stiffens as it turns; the model leaves that out."
    check: ClassVar[str] = "Nothing is wrong with the machine: add the term to the simulator."
    export_law: ClassVar = "a property of a flexible link, which this format does not have"
    share: Array = param(0.0, 0.0, 1.5, scale=0.1, unit="1", meaning="1: all of the tension counts")
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ({"share": 1.0},)

    def __call__(self, mechanism):
        return (
            mechanism.stiffened(self.share)
            if isinstance(mechanism, Stiffenable) and mechanism.nonlinear
            else mechanism
        )


class BaseMotion(BodyEffect):
    """A base that gives way under an arm which the model bolts to the ground; on a space
    manipulator.
    """

    name: ClassVar[str] = "base_motion"
    stage: ClassVar[int] = -1
    offered: ClassVar = staticmethod(_where_loosenable)
    equation: ClassVar[str] = (
        "M -> M_mm - M_mb M_bb^-1 M_bm, the base's mass and inertia counted 1 / share times"
    )
    signature: ClassVar[str] = (
        "all inertias seem smaller, and the more so the more posture changes; hardly any residual"
    )
    source: ClassVar[str] = (
        "exact reduced dynamics at zero momentum (paper 000 assumes a base that stands still)"
    )
    excitation: ClassVar[str] = "two sets of postures far apart, and the base's own rate"
    axis: ClassVar[str] = "acceleration"
    seen: ClassVar[str] = "wherever the arm accelerates"
    plain: ClassVar[str] = "The base moves under the arm; the simulator holds it still."
    check: ClassVar[str] = "Watch the base: fixing, table, floating body."
    export_law: ClassVar = "needs a base that floats: a free joint with the base's mass and inertia"
    share: Array = param(
        0.0,
        0.0,
        20.0,
        scale=0.1,
        unit="1",
        meaning="1: the base floats with its known mass and inertia",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ({"share": 0.1}, {"share": 1.0})

    def __call__(self, mechanism):
        return (
            mechanism.loosened(self.share)
            if isinstance(mechanism, Loosenable) and not mechanism.floating
            else mechanism
        )
