"""Friction that changes as a joint warms up."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.effect import JointEffect
from jaxid.dynamics.export_law import ExportLaw
from jaxid.dynamics.parameter import DURATION, param, Quantity, SPEED, TORQUE


#: Once a step of `dt` s, in a simulator.
CODE = '''class Warmth:
    """change warmth qd, time d(warmth)/dt = qd^2 - warmth; cold at the start."""

    def __init__(self, change, time):
        self.change, self.time, self.warmth = change, time, 0.0

    def __call__(self, q, qd, load, dt):
        self.warmth = self.warmth + (qd ** 2 - self.warmth) * min(1.0, dt / self.time)
        return self.change * self.warmth * qd
'''


class TemperatureDependentFriction(JointEffect):
    """Viscous friction that changes with the work of the last seconds to minutes, as a joint warms
    up; a run starts cold.

    No recorded temperature is read: the warmth is a state of the joint, the mean of qd^2 (what
    viscous friction turns into heat) over its time constant. What follows the speed within a second
    warms nothing: it is another law of the speed, a cubic one.
    """

    name: ClassVar[str] = "temperature_dependent_friction"
    equation: ClassVar[str] = (
        "f = change warmth qd;  time d(warmth)/dt = qd^2 - warmth,  warmth = 0 at the start of a run"
    )
    signature: ClassVar[str] = (
        "friction that differs between early and late in a run, and after rests"
    )
    source: ClassVar[str] = "first-order heat balance of a joint"
    excitation: ClassVar[str] = (
        "the same motion for many minutes from a cold start, with a long rest before it is repeated"
    )
    axis: ClassVar[str] = "time"
    seen: ClassVar[str] = "otherwise late in a run than early, and after rests"
    plain: ClassVar[str] = (
        "Friction changes by {change} with the work of the last {time}, as when a joint warms up."
    )
    check: ClassVar[str] = "Repeat a run cold and warm; measure the temperature of motor and gear."
    export_law: ClassVar = ExportLaw("force", memory=CODE)
    change: Array = param(
        0.0,
        -20 * TORQUE / (SPEED * SPEED * SPEED),
        20 * TORQUE / (SPEED * SPEED * SPEED),
        scale=0.1 * TORQUE / (SPEED * SPEED * SPEED),
        unit="{F} s^3/{X}^3",
        meaning="viscous coefficient gained (lost where negative) per squared speed",
    )
    time: Array = param(
        10.0,
        1.0,
        (5 * DURATION).no_less_than(2.0),
        scale=0.1 * DURATION,
        unit="s",
        meaning="time constant of warming",
        log=True,
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = tuple(
        {"change": -0.1 * TORQUE / (SPEED * SPEED * SPEED), "time": time * DURATION}
        for time in (0.15, 0.3, 2.0)
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"change": -0.1 * TORQUE / SPEED**3, "time": 0.1},
        {"change": 0.3 * TORQUE / SPEED**3, "time": 0.3},
        {"change": 1.0 * TORQUE / SPEED**3, "time": 2.0},
    )

    def start(self, q):
        return jnp.zeros_like(q)

    def __call__(self, s, z):
        gain = -jnp.expm1(-s.h / self.time)
        heat = s.qd**2 - z
        return self.change * (z + heat * gain / 2) * s.qd, 0.0, 0.0, z + heat * gain
