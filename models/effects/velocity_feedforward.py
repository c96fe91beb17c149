"""A drive that follows the rate of its goal, where the model's law follows the goal alone."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.effect import InputEffect
from jaxid.dynamics.export_law import ExportLaw
from jaxid.dynamics.mechanism import Mechanism, Signature
from jaxid.dynamics.parameter import param, Quantity


#: Once a step of `dt` s, in a simulator.
CODE = '''class VelocityFeedforward:
    """goal + lead d(goal)/dt, the rate a change of the goal by the shortest time between two."""

    def __init__(self, lead):
        self.lead, self.goal, self.rate = lead, None, 0.0
        self.since, self.period = 0.0, float("inf")

    def __call__(self, value, dt):
        if self.goal is None:
            self.goal = value
            return value
        self.since += dt
        if value != self.goal:
            self.period = min(self.period, self.since)
            self.rate = (value - self.goal) / self.period
            self.goal, self.since = value, 0.0
        elif self.since > 0.999 * self.period:
            self.rate = 0.0
        return value + self.lead * self.rate
'''


def _goals(mechanism: Mechanism, signature: Signature) -> tuple[str, ...]:
    """Commands in the unit of a position."""
    return tuple(name for name, unit in signature.commands if unit in ("rad", "m"))


class VelocityFeedforward(InputEffect):
    """The goal's rate beside the goal: velocity feed-forward, or a law whose kd acts on the goal's
    rate less the joint's (lead = kd / kp).
    """

    name: ClassVar[str] = "velocity_feedforward"
    offered: ClassVar = staticmethod(_goals)
    equation: ClassVar[str] = (
        "u -> u + lead du/dt,  du/dt = (u(t) - u(t - period)) / period, a goal's samples apart"
    )
    signature: ClassVar[str] = (
        "the machine lags its goal less than the model, the more so the faster"
    )
    source: ClassVar[str] = "textbook: two degrees of freedom of a position servo"
    excitation: ClassVar[str] = "goals that move at several speeds, and that stand in between"
    axis: ClassVar[str] = "command"
    seen: ClassVar[str] = "in proportion to the rate of the goal"
    plain: ClassVar[str] = (
        "The drive follows its goal's rate too, as if the goal were {lead} ahead along its rate: the"
        " law's kd acts on the goal's rate less the joint's, or there is a velocity feed-forward."
    )
    check: ClassVar[str] = (
        "Look in the drive's settings for a velocity feed-forward, and on which rate kd acts"
        " (lead = kd / kp where it acts on the goal's less the joint's)."
    )
    acts_on: ClassVar[str] = "timing"
    export_law: ClassVar = ExportLaw("command", memory=CODE)
    lead: Array = param(
        0.0, 0.0, 0.5, scale=0.005, unit="s", meaning="time by which the goal's rate leads it"
    )
    #: s between samples of the goal; 0: a step of the simulation.
    period: float = eqx.field(static=True, default=0.0)
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"lead": 0.002},
        {"lead": 0.01},
        {"lead": 0.04},
        {"lead": 0.15},
    )

    @classmethod
    def sampled(cls, period):
        return cls(period=period)

    def start(self, u):
        return ()

    def __call__(self, u, s, z):
        period = self.period if self.period > 0 else s.h
        rate = (s.command.u - s.command.delayed(period + jnp.zeros_like(u))) / period
        return jnp.where(self.lead > 0, u + self.lead * rate, u), z

    def transfer(self, omega):
        angle = omega[:, None] * self.lead
        return jnp.ones_like(angle), angle
