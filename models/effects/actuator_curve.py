"""A drive whose static curve is not the straight line that the model has."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.dynamics.effect import InputEffect
from jaxid.dynamics.parameter import param, Quantity, TORQUE


class ActuatorCurve(InputEffect):
    """A monotone curve of three straight pieces, odd in the command: any static law of a drive, to
    that accuracy.

    It comprises a wrong scale, a dead zone and a limit as far as three pieces can, and is asked
    last: a diagnosis tries it where the simpler laws do not explain the gap.
    """

    name: ClassVar[str] = "actuator_curve"
    equation: ClassVar[str] = (
        "u -> u + sign(u) (low min(|u|, k) + middle clip(|u| - k, 0, k) + high max(|u| - 2 k, 0)), "
        " k = reach / 3"
    )
    signature: ClassVar[str] = (
        "missing torque that is a function of the command alone and bends where the drive's curve"
        " does"
    )
    source: ClassVar[str] = (
        "piecewise linear interpolation; paper 003, Table 1 against its equation (6)"
    )
    excitation: ClassVar[str] = (
        "a staircase of command amplitudes, held until the speed is steady, from zero to the"
        " largest, both signs"
    )
    axis: ClassVar[str] = "command"
    seen: ClassVar[str] = (
        "with the command, by a law of its own below and above a third and two thirds of {reach}"
    )
    plain: ClassVar[str] = (
        "The drive does not give what is commanded in proportion: its curve bends (slope off by"
        " {low:%}, {middle:%}, {high:%})."
    )
    check: ClassVar[str] = (
        "Measure the torque or the steady speed at a staircase of commands, and put that curve into"
        " the simulator."
    )
    last_resort: ClassVar[bool] = True
    resembles: ClassVar[tuple[str, ...]] = ("torque_scale", "dead_zone", "saturation")
    low: Array = param(
        0.0,
        -1.0,
        4.0,
        scale=0.05,
        unit="1",
        meaning="share by which the slope differs up to a third of the reach",
    )
    middle: Array = param(
        0.0, -1.0, 4.0, scale=0.05, unit="1", meaning="the same in the second third"
    )
    high: Array = param(0.0, -1.0, 4.0, scale=0.05, unit="1", meaning="the same beyond")
    reach: Array = param(
        1.0,
        0.1 * TORQUE,
        3 * TORQUE,
        scale=0.05 * TORQUE,
        unit="{u}",
        meaning="command whose thirds are the kinks",
        log=True,
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"high": -0.5, "reach": 1.0 * TORQUE},
        {"middle": 0.3, "high": -0.5, "reach": 1.0 * TORQUE},
        {"middle": 0.3, "high": -0.8, "reach": 1.0 * TORQUE},
        {"low": -0.5, "reach": 1.0 * TORQUE},
        {"middle": -0.3, "reach": 1.0 * TORQUE},
        {"high": -0.5, "reach": 1.5 * TORQUE},
    )

    def start(self, u):
        return ()

    def __call__(self, u, s, z):
        return self.bent(u), z

    def bent(self, u: Float[Array, " nu"]) -> Float[Array, " nu"]:
        """What the drive makes of a command."""
        k, size = self.reach / 3, jnp.abs(u)
        more = (
            self.low * jnp.minimum(size, k)
            + self.middle * jnp.clip(size - k, 0.0, k)
            + self.high * jnp.maximum(size - 2 * k, 0.0)
        )
        return u + jnp.sign(u) * more
