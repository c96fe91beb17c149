"""Effects between the command and the joint torque. Where an effect needs a joint's motion, input i
drives joint i.
"""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxid.dynamics.effect import drives, InputEffect, JointEffect
from jaxid.dynamics.export_law import ExportLaw, StandsFor
from jaxid.dynamics.parameter import ANGLE, param, Quantity, SPEED, TORQUE
from jaxid.numerics.fast_math import sincos


#: Once a step of `dt` s, in a simulator.
LAG = '''class Lag:
    """First order, exact for a value that is held over the step."""

    def __init__(self, lag):
        self.lag, self.z = lag, None

    def __call__(self, value, dt):
        share = 1 - 2.718281828459045 ** (-dt / self.lag)
        self.z = value if self.z is None else self.z + (value - self.z) * share
        return self.z
'''


def _limited(joint: Any, limit: float, driven: bool) -> dict[str, float]:
    return {"lowest": max(joint.lowest, -limit), "highest": min(joint.highest, limit)}


def _scaled(joint: Any, gain: float, driven: bool) -> dict[str, float]:
    """(1 + gain) clip(law, lowest, highest) is the law with all its numbers so much larger."""
    if not driven:
        return {"drive": (1 + gain) * joint.drive}
    law = ("kp", "kd", "ki", "offset", "lowest", "highest")
    return {name: (1 + gain) * getattr(joint, name) for name in law}


def _damped(joint: Any, constant: float, driven: bool) -> dict[str, float]:
    return {"damping": joint.damping + constant}


class DeadZone(InputEffect):
    """A drive that gives nothing below a threshold and lacks the threshold above it."""

    name: ClassVar[str] = "dead_zone"
    span: ClassVar = staticmethod(lambda p: (-p["width"], p["width"]))
    equation: ClassVar[str] = "u -> u - clip(u, -width, width)"
    signature: ClassVar[str] = (
        "low commands do nothing; above the threshold a constant torque is lost in the sign of u"
    )
    source: ClassVar[str] = "paper 003, equation (6)"
    excitation: ClassVar[str] = (
        "slow ramps of the command through zero with a load or gravity bias, and stops from speed "
        "(braking has command and motion of opposite sign)"
    )
    axis: ClassVar[str] = "command"
    seen: ClassVar[str] = (
        "whenever something is commanded: all of a command below {width} is lost, and {width} of a"
        " larger one"
    )
    plain: ClassVar[str] = "Small commands do nothing: the drive needs {width} before it answers."
    check: ClassVar[str] = (
        "Raise the command slowly from zero and note where it begins to act; look for a dead band"
        " in the drive's settings."
    )
    export_law: ClassVar = ExportLaw("command", "u - clip(u, -width, width)")
    width: Array = param(
        0.0, 0.0, TORQUE, scale=0.05 * TORQUE, unit="{u}", meaning="half width of the dead zone"
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"width": 0.03 * TORQUE},
        {"width": 0.1 * TORQUE},
        {"width": 0.3 * TORQUE},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"width": 0.05 * TORQUE},
        {"width": 0.2 * TORQUE},
        {"width": 0.5 * TORQUE},
    )

    def start(self, u):
        return ()

    def __call__(self, u, s, z):
        return u - jnp.clip(u, -self.width, self.width), z


class Saturation(InputEffect):
    """A drive that gives no more than its limit."""

    name: ClassVar[str] = "saturation"
    span: ClassVar = staticmethod(lambda p: (p["limit"], None))
    equation: ClassVar[str] = "u -> clip(u, -limit, limit)"
    signature: ClassVar[str] = (
        "missing torque at high commands only, in proportion to what exceeds the limit"
    )
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = (
        "a staircase of command amplitudes up to the largest that is allowed"
    )
    axis: ClassVar[str] = "command"
    seen: ClassVar[str] = "where the command is beyond {limit}"
    plain: ClassVar[str] = "The drive gives no more than {limit}, whatever is commanded."
    check: ClassVar[str] = "Look up the current or torque limit of the drive and its settings."
    acts_on: ClassVar[str] = "drive"
    stands_for: ClassVar = StandsFor("force", "limit", after=_limited)
    export_law: ClassVar = ExportLaw("torque", "clip(u, -limit, limit)")
    limit: Array = param(
        1e12,
        0.02 * TORQUE,
        2 * TORQUE,
        scale=0.05 * TORQUE,
        unit="{u}",
        meaning="largest magnitude that passes",
        log=True,
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"limit": 0.95 * TORQUE},
        {"limit": 0.8 * TORQUE},
        {"limit": 0.5 * TORQUE},
        # A servo that hardly follows is re-tuned to one that stands still, which milder limits move
        # no more.
        {"limit": 0.2 * TORQUE},
        {"limit": 0.07 * TORQUE},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"limit": 0.3 * TORQUE},
        {"limit": 0.6 * TORQUE},
        {"limit": 1.0 * TORQUE},
    )

    def start(self, u):
        return ()

    def __call__(self, u, s, z):
        return jnp.clip(u, -self.limit, self.limit), z


class ActuatorLag(InputEffect):
    """A drive of first order, followed exactly while the command is held."""

    name: ClassVar[str] = "actuator_lag"
    equation: ClassVar[str] = "lag du'/dt = u - u'"
    signature: ClassVar[str] = (
        "phase lag and loss of gain towards high frequency, alike in all that the drive moves; "
        "with one reading, that of a filter in the sensor"
    )
    source: ClassVar[str] = "textbook; exact solution for a held input, mean over the step"
    excitation: ClassVar[str] = (
        "one multisine with energy up to ten times the bandwidth: a lag bends the phase, a delay "
        "does not; with the drive's own current or a second sensor, for a sensor lags alike"
    )
    axis: ClassVar[str] = "command"
    seen: ClassVar[str] = "wherever the command changes faster than in {lag}"
    plain: ClassVar[str] = (
        "The drive answers late: it follows its command with a time constant of {lag}."
    )
    check: ClassVar[str] = (
        "Look at the step response of the current; the bandwidth of the current loop or a valve; "
        "a filter in the sensor looks alike."
    )
    stands_for: ClassVar = StandsFor("lag", "lag", fitted="timeconst")
    export_law: ClassVar = ExportLaw("command", memory=LAG)
    lag: Array = param(0.0, 0.0, 0.3, scale=0.003, unit="s", meaning="time constant of the drive")
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"lag": 0.001},
        {"lag": 0.006},
        {"lag": 0.03},
        {"lag": 0.12},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"lag": 0.002},
        {"lag": 0.01},
        {"lag": 0.05},
    )

    def start(self, u):
        return u

    def __call__(self, u, s, z):
        present = self.lag > 0
        lag = jnp.where(present, self.lag, 1.0)
        share = jnp.exp(-s.h / lag)
        mean = u + (z - u) * lag / s.h * -jnp.expm1(-s.h / lag)
        return jnp.where(present, mean, u), jnp.where(present, u + (z - u) * share, u)

    def transfer(self, omega):
        x = omega[:, None] * self.lag
        return 1 / (1 + x * x), -x / (1 + x * x)


class TorqueScale(InputEffect):
    """A wrong torque constant, gear ratio or amplifier gain."""

    name: ClassVar[str] = "torque_scale"
    equation: ClassVar[str] = "u -> (1 + gain) u"
    signature: ClassVar[str] = "missing torque in proportion to the command"
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = (
        "motion against a known load: a payload or an inertia that was weighed"
    )
    axis: ClassVar[str] = "command"
    seen: ClassVar[str] = "in proportion to the command"
    plain: ClassVar[str] = (
        "The drive gives {gain:%} of the command more than stated (less, if negative)."
    )
    check: ClassVar[str] = (
        "Check the torque constant, the gear ratio and the amplifier's current scale."
    )
    acts_on: ClassVar[str] = "drive"
    stands_for: ClassVar = StandsFor("drive", "gain", after=_scaled)
    export_law: ClassVar = ExportLaw("torque", "(1 + gain) * u")
    by_torque: ClassVar[bool] = True
    column: ClassVar = staticmethod(lambda torque, step: -torque)
    gain: Array = param(
        0.0,
        -0.9,
        5.0,
        scale=0.03,
        unit="1",
        meaning="share by which the drive gives more than commanded",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ({"gain": 0.1},)
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"gain": -0.2},
        {"gain": 0.05},
        {"gain": 0.5},
    )

    def start(self, u):
        return ()

    def __call__(self, u, s, z):
        return (1 + self.gain) * u, z

    def transfer(self, omega):
        return 1 + self.gain + 0 * omega[:, None], 0 * self.gain * omega[:, None]


class SupplyDroop(InputEffect):
    """A supply (or a motor constant) that sags as the command grows."""

    name: ClassVar[str] = "supply_droop"
    equation: ClassVar[str] = "u -> u (1 - droop |u|)"
    signature: ClassVar[str] = "missing torque that grows with the square of the command"
    source: ClassVar[str] = (
        "voltage drop at the inner resistance of the supply, to first order in the current drawn"
    )
    excitation: ClassVar[str] = (
        "a staircase of command amplitudes: half of the largest command loses a quarter of what the"
        " largest loses"
    )
    axis: ClassVar[str] = "command"
    seen: ClassVar[str] = "at large commands, with their square"
    plain: ClassVar[str] = (
        "The drive weakens under large commands: it loses {droop} of the command per unit of it."
    )
    check: ClassVar[str] = "Measure the supply voltage under full load: supply, cables, battery."
    acts_on: ClassVar[str] = "drive"
    export_law: ClassVar = ExportLaw("torque", "u * (1 - droop * abs(u))")
    droop: Array = param(
        0.0,
        0.0,
        0.5 / TORQUE,
        scale=0.02 / TORQUE,
        unit="1/({u})",
        meaning="relative loss per unit of the command",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"droop": 0.03 / TORQUE},
        {"droop": 0.3 / TORQUE},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"droop": 0.02 / TORQUE},
        {"droop": 0.1 / TORQUE},
        {"droop": 0.25 / TORQUE},
    )

    def start(self, u):
        return ()

    def __call__(self, u, s, z):
        return u * (1 - self.droop * jnp.abs(u)), z


def _one_a_joint(mechanism, signature):
    return drives(mechanism, signature) if len(signature.commands) == len(signature.joints) else ()


class BackEmf(InputEffect):
    """A drive that loses with the speed of its motor, in units of the command."""

    name: ClassVar[str] = "back_emf"
    offered: ClassVar = staticmethod(_one_a_joint)
    equation: ClassVar[str] = "u -> u - constant qd"
    signature: ClassVar[str] = (
        "missing torque proportional to velocity, and none where the command is inside a dead zone"
        " or limit"
    )
    source: ClassVar[str] = "textbook: induced voltage of a motor"
    excitation: ClassVar[str] = (
        "coasting from speed with the drive switched off against the same speed under command"
    )
    axis: ClassVar[str] = "speed"
    seen: ClassVar[str] = "in proportion to speed, through the drive"
    plain: ClassVar[str] = (
        "The drive loses {constant} of its command per unit of speed: the motor's back EMF."
    )
    check: ClassVar[str] = (
        "Spin the motor by hand with open leads and measure its voltage against speed."
    )
    acts_on: ClassVar[str] = "drive"
    stands_for: ClassVar = StandsFor(
        "damping", "constant", after=_damped, note="exact while the torque is not at its limit"
    )
    export_law: ClassVar = ExportLaw("force", "constant * qd")
    constant: Array = param(
        0.0,
        0.0,
        100 * TORQUE / SPEED,
        scale=0.1 * TORQUE / SPEED,
        unit="{u} s/{X}",
        meaning="command lost per speed",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"constant": 0.03 * TORQUE / SPEED},
        {"constant": 0.3 * TORQUE / SPEED},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"constant": 0.02 * TORQUE / SPEED},
        {"constant": 0.2 * TORQUE / SPEED},
        {"constant": 1.0 * TORQUE / SPEED},
    )

    def start(self, u):
        return ()

    def __call__(self, u, s, z):
        n = s.qd.shape[0]  # what is behind the commands of the joints has no speed
        return (u.at[:n].add(-self.constant[:n] * s.qd) if u.shape[0] >= n else u), z


class TorqueRipple(JointEffect):
    """Torque that repeats with position, at least once within the travel: cogging, torque ripple,
    gear eccentricity.
    """

    name: ClassVar[str] = "torque_ripple"
    equation: ClassVar[str] = "f = sine sin(order q) + cosine cos(order q)"
    signature: ClassVar[str] = (
        "missing torque periodic in position, the same in both directions and at any speed"
    )
    source: ClassVar[str] = (
        "textbook; the order is the number of poles, slots or teeth per turn, or found from the data"
    )
    excitation: ClassVar[str] = "slow constant speed over the whole travel, both ways"
    axis: ClassVar[str] = "position"
    seen: ClassVar[str] = "over and over with position, once every {order:period}"
    plain: ClassVar[str] = (
        "The torque repeats with position: cogging of the motor or an eccentric gear."
    )
    check: ClassVar[str] = (
        "Turn slowly over a whole revolution and compare the period with poles and teeth."
    )
    on_slide: ClassVar = {
        "plain": "The force repeats with position: cogging of the motor, a belt's teeth or a screw.",
        "check": "Move slowly and compare the period with pole pitch, belt teeth and screw lead.",
    }
    export_law: ClassVar = ExportLaw("force", "sine * sin(order * q) + cosine * cos(order * q)")
    sine: Array = param(
        0.0, -TORQUE, TORQUE, scale=0.02 * TORQUE, unit="{F}", meaning="amplitude of the sine"
    )
    cosine: Array = param(
        0.0, -TORQUE, TORQUE, scale=0.02 * TORQUE, unit="{F}", meaning="amplitude of the cosine"
    )
    order: Array = param(
        10.0,
        6.2832 / ANGLE,
        400 / ANGLE,
        scale=0.5 / ANGLE,
        unit="rad/{X}",
        meaning="periods per turn (a wave number where linear)",
        log=True,
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = tuple(
        {amplitude: 0.02 * TORQUE, "order": 6.2832 * periods / ANGLE}
        for periods in (1.0, 1.4, 2.0, 2.8, 4.0, 5.5, 8.0, 11.0, 16.0, 23.0)
        for amplitude in ("sine", "cosine")
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"sine": 0.05 * TORQUE, "cosine": 0.0 * TORQUE, "order": 4.0},
        {"sine": 0.0 * TORQUE, "cosine": 0.1 * TORQUE, "order": 12.0},
        {"sine": -0.1 * TORQUE, "cosine": 0.05 * TORQUE, "order": 30.0},
    )

    @staticmethod
    def read_off(q, qd, force):
        """The order whose sine and cosine explain most of the missing force, up to 64 periods on
        the travel.
        """
        travel = float(np.ptp(q))
        if travel <= 0:
            return {}
        places = q - q.min()
        orders = 2 * np.pi / travel * np.arange(1.0, 64.0, 0.25)
        best, found = 0.0, {}
        for order in orders:
            X = np.stack([np.sin(order * places), np.cos(order * places), np.ones_like(places)], 1)
            amplitudes = np.linalg.lstsq(X, force - force.mean(), rcond=None)[0]
            explained = float(np.sum((X @ amplitudes) ** 2))
            if explained > best:
                turned = amplitudes[0] + 1j * amplitudes[1]
                turned *= np.exp(-1j * order * q.min())
                best, found = (
                    explained,
                    {"sine": turned.real, "cosine": turned.imag, "order": float(order)},
                )
        return found

    def start(self, q):
        return ()

    def __call__(self, s, z):
        sine, cosine = sincos(self.order * s.q)
        return self.sine * sine + self.cosine * cosine, 0.0, 0.0, z
