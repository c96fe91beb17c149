"""What one step of a chain hands to the next, and how the first begins."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.dynamics.effect import (
    Command,
    Effect,
    InputEffect,
    JointEffect,
    OutputEffect,
)


def first_state(e: Effect, q: Array, u: Array, y: Array, rate: Array) -> Any:
    """State of an effect at the beginning of a run: `InputEffect.start` and the like; () for one
    that has none.
    """
    if isinstance(e, InputEffect):
        return e.start(u)
    if isinstance(e, JointEffect):
        return e.start(q)
    return e.start(y, rate) if isinstance(e, OutputEffect) else ()


def first_command(command: Command, n: int) -> Command:
    """The first n inputs of a command."""

    def delayed(delay: Array) -> Array:
        return command.delayed(jnp.concatenate([delay, jnp.zeros(command.u.shape[0] - n)]))[:n]

    return command._replace(u=command.u[:n], other=command.other[:n], delayed=delayed)


class Carry(NamedTuple):
    """State of a simulation between steps: mechanism, effects, and predictors: dry torque,
    acceleration, and where an effect asks for what is transmitted the net joint torque.
    """

    x: Any
    z: tuple[Any, ...]
    lam: Float[Array, " nq"]
    acc: Float[Array, " nq"]
    net: Any = ()
