"""The drive of a position-controlled joint: from its goal to its torque, by the law that the
recording or the file states.
"""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxid.dynamics.effect import InputEffect
from jaxid.dynamics.parameter import constant, param, Quantity

from .effects.actuator import ActuatorLag


KINDS = ("pd", "pid", "cascade")
VELOCITIES = ("measured", "difference", "averaged_difference")


class PositionLaw(InputEffect):
    """Goal -> torque. Continuous (`period` 0, as in MuJoCo and Isaac), or sampled every `period` s
    and held in between.

    `kind` pd: v = kp (goal - q) - kd qd; pid: the same + ki times the integral of the error, which
    stands still while the output is saturated and the error drives it further; cascade: v = kd (kp
    (goal - q) - qd). The goal's own rate is taken off qd where it is `recorded`, or with `rate`,
    which takes the difference to the last sample (sampled laws alone). Torque = gain clip(v +
    offset, lowest, highest).
    """

    name: ClassVar[str] = "position_law"
    stage: ClassVar[int] = 5
    reads_encoders: ClassVar[bool] = True
    equation: ClassVar[str] = (
        "tau = gain clip(kp (goal - q) + kd (rate - qd) + ki integral + offset, lowest, highest)"
    )
    signature: ClassVar[str] = "none: it is stated with the recording or by the robot's file"
    source: ClassVar[str] = "textbook; MuJoCo's position actuator"
    excitation: ClassVar[str] = "the same motion under two gains"
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ()
    contains: ClassVar[tuple[str, ...]] = ()

    kp: Array = param(
        0.0, 0.0, np.inf, scale=1.0, unit="{F}/{X}", meaning="torque per position error"
    )
    kd: Array = param(
        0.0, 0.0, np.inf, scale=0.1, unit="{F} s/{X}", meaning="torque per speed error"
    )
    ki: Array = param(
        0.0,
        0.0,
        np.inf,
        scale=1.0,
        unit="{F}/({X} s)",
        meaning="torque per integral of the position error",
    )
    gain: Array = constant(1.0, unit="1", meaning="joint torque per unit of the law's output")
    lowest: Array = param(
        -np.inf, -np.inf, 0.0, scale=0.1, unit="{F}", meaning="lower limit of the law's output"
    )
    highest: Array = param(
        np.inf, 0.0, np.inf, scale=0.1, unit="{F}", meaning="upper limit of the law's output"
    )
    offset: Array = constant(0.0, unit="{F}", meaning="added to the law's output")

    kind: str = eqx.field(static=True, default="pd")
    velocity: str = eqx.field(static=True, default="measured")
    rate: bool = eqx.field(static=True, default=False)
    recorded: bool = eqx.field(static=True, default=False)
    period: float = eqx.field(static=True, default=0.0)
    control: tuple[tuple[float, float], ...] = eqx.field(static=True, default=())

    def stiffness(self):
        if self.period > 0:
            return None
        return jnp.abs(self.gain * self.kp * (self.kd if self.kind == "cascade" else 1.0))

    def start(self, u):
        if self.period <= 0:
            return jnp.zeros_like(u) if self.kind == "pid" else ()
        # time since the start, ticks so far, held torque, last two positions, last goal, integral
        return jnp.zeros(()), jnp.full((), -1.0), jnp.zeros((5, *u.shape))

    def settled(self, z, u, q, hold):
        """The integral of a pid begins where the joint is held."""
        if self.kind != "pid":
            return z
        u = jnp.clip(u, *np.array(self.control).T) if self.control else u
        n = u.shape[0]
        integral = jnp.where(
            self.ki > 0, hold()[:n] / self.gain - self._output(u - q[:n], 0.0), 0.0
        )
        return integral if self.period <= 0 else (*z[:2], z[2].at[4].set(integral))

    def __call__(self, u, s, z):
        if self.control:
            u = jnp.clip(u, *np.array(self.control).T)
        if self.period > 0:
            return self._sampled(u, s, z)
        n = u.shape[0]  # the angles of a base that floats stand behind the joints
        error = u - s.q[:n]
        output = self._output(error, (s.beside[:n] if self.recorded else 0.0) - s.qd[:n])
        if self.kind == "pid":
            return self._limited(output + z), self._integrated(z, output + z, error, s.h)
        return self._limited(output), z

    def _output(self, error, rate_error):
        if self.kind == "cascade":
            return self.kd * (self.kp * error + rate_error) + self.offset
        return self.kp * error + self.kd * rate_error + self.offset

    def _limited(self, output):
        return self.gain * jnp.clip(output, self.lowest, self.highest)

    def _integrated(self, integral, output, error, h):
        winds_up = ((output > self.highest) | (output < self.lowest)) & (output * error > 0)
        return integral + jnp.where(winds_up, 0.0, self.ki * h * error)

    def _sampled(self, u, s, z):
        elapsed, ticks, (held, last, before, goal, integral) = z
        n = u.shape[0]
        began = s.q - s.h / 2 * s.qd0 if s.q0 is None else s.q0
        T, q, qd = self.period, began[:n], s.qd0[:n]  # at the step's beginning
        first = ticks < 0
        last, before = jnp.where(first, q - T * qd, last), jnp.where(first, q - 2 * T * qd, before)
        goal = jnp.where(first, u, goal)
        count = jnp.floor(elapsed / T + 0.5 * jnp.minimum(1.0, s.h / T))
        now = count > ticks
        measured = {
            "measured": qd,
            "difference": (q - last) / T,
            "averaged_difference": (q - before) / (2 * T),
        }[self.velocity]
        wanted = s.beside[: u.shape[0]] if self.recorded else (u - goal) / T if self.rate else 0.0
        output = self._output(u - q, wanted - measured) + integral
        new = jnp.stack(
            [self._limited(output), q, last, u, self._integrated(integral, output, u - q, T)]
        )
        kept = jnp.where(now, new, jnp.stack([held, last, before, goal, integral]))
        return kept[0], (elapsed + s.h, jnp.maximum(count, ticks), kept)


class SampledLag(ActuatorLag):
    """The same where MuJoCo steps: what the drive has come to by a step's beginning acts in it."""

    source: ClassVar[str] = "MuJoCo's actuator of dyntype filterexact"

    def __call__(self, u, s, z):
        present = self.lag > 0
        left = jnp.exp(-s.h / jnp.where(present, self.lag, 1.0))
        return jnp.where(present, z, u), jnp.where(present, u + (z - u) * left, u)
