"""Numbers of a chain that change during a run, and the chain as it is at a time of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.dynamics.effect import Applied, NumberEffect


if TYPE_CHECKING:
    from jaxid.dynamics.chain import Chain


#: Structure of a chain -> its numbers that may change in time.
_NUMBERS: dict[Any, tuple[Any, ...]] = {}
#: Least share that a change leaves of a number which is positive by its nature.
LEAST = 0.02


def numbers_of(chain: Chain) -> tuple[Any, ...]:
    """Entries (`parameter_vector.Entry`) of the mechanism's and its built-in effects' own numbers
    that may change during a run; none where its states are coordinates that such a change would
    turn.
    """
    if chain.mechanism.hidden_states:
        return ()
    key = jax.tree.structure(chain)
    if (
        key not in _NUMBERS
    ):  # asked for the first time by a `ParameterVector`, of a chain that is not traced
        from jaxid.dynamics.parameter_vector import own_entries

        _NUMBERS[key] = tuple(e for e in own_entries(chain) if not e.spec.fixed)
    return _NUMBERS[key]


def at_time(chain: Chain, t: Float[Array, ""], h: Float[Array, ""]) -> Chain:
    """The chain with its numbers as they are in a step of length `h` from `t`. A number that is
    searched by its logarithm stays above 0.
    """
    numbers = chain.numbers

    def owner(chain, i):
        return chain.mechanism if i < 0 else chain.effects[i]

    before = jnp.stack(
        [jnp.ravel(getattr(owner(chain, e.owner), e.field))[e.place] for e in numbers]
    )
    after = before
    for _, e in chain.at(NumberEffect):
        after = e(after, t, h)
    positive = np.array([e.spec.log for e in numbers])
    after = jnp.where(positive & (before > 0), jnp.maximum(after, LEAST * before), after)
    changed: dict[tuple[int, str], dict[int, Any]] = {}
    for k, e in enumerate(numbers):
        changed.setdefault((e.owner, e.field), {})[e.place] = after[k]
    value: dict[tuple[int, str], Any] = {}
    for (i, field), new in changed.items():
        old = jnp.asarray(getattr(owner(chain, i), field))
        value[i, field] = _changed(old, new)
    effects = tuple(Applied() if isinstance(e, NumberEffect) else e for e in chain.effects)
    now = eqx.tree_at(lambda c: c.effects, chain, effects)
    return eqx.tree_at(
        lambda c: [getattr(owner(c, i), f) for i, f in value], now, list(value.values())
    )


def _changed(old: Array, new: Mapping[int, Array]) -> Array:
    """A field with new values at some places; a single number is at place 0."""
    if old.ndim == 0:
        return new[0]
    return jnp.stack([new.get(k, old[k]) for k in range(old.shape[0])])
