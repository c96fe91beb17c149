"""Success-history adaptive differential evolution (Tanabe and Fukunaga, CEC 2013)."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.fitters.de import binomial, extent
from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.settings import option


class ShadeState(NamedTuple):
    population: Float[Array, "pop dim"]
    losses: Float[Array, " pop"]
    archive: Float[Array, "pop dim"]  # members that were replaced
    F_memory: Float[Array, " memory"]
    CR_memory: Float[Array, " memory"]
    slot: Array
    F: Float[Array, " pop"]  # drawn for the next candidates
    CR: Float[Array, " pop"]
    key: Array


class Shade(AbstractPopulation):
    """Differential evolution that learns its own F and CR from the candidates that were better:
    current-to-pbest/1/bin with an archive of replaced members. Nothing to tune: the population to
    take where the others need their settings looked after.
    """

    name: ClassVar[str] = "shade"
    source: ClassVar[str] = (
        "Tanabe and Fukunaga, Success-history based parameter adaptation for DE, CEC 2013"
    )

    popsize: int = option(60, "members of the population", 4)
    generations: int = option(400, "most generations", 1)
    memory: int = option(20, "settings that were successful and are remembered", 1)
    pbest: float = option(0.11, "share of the best members that attract", 0, 1)

    def init(self, key, population, losses):
        half = jnp.full(self.memory, 0.5)
        blank = ShadeState(
            population=population,
            losses=losses,
            archive=population,
            F_memory=half,
            CR_memory=half,
            slot=jnp.zeros((), jnp.int32),
            F=jnp.zeros(self.popsize),
            CR=jnp.zeros(self.popsize),
            key=key,
        )
        return self._drawn(blank)

    def _drawn(self, state: ShadeState) -> ShadeState:
        """The state with F (Cauchy) and CR (normal) of the next generation, each around a
        remembered success.
        """
        key, k_slot, k_F, k_CR = jax.random.split(state.key, 4)
        slot = jax.random.randint(k_slot, (self.popsize,), 0, self.memory)
        F = state.F_memory[slot] + 0.1 * jax.random.cauchy(k_F, (self.popsize,))
        F = jnp.where(F > 0, jnp.minimum(F, 1.0), 0.5 * state.F_memory[slot])
        CR = jnp.clip(
            state.CR_memory[slot] + 0.1 * jax.random.normal(k_CR, (self.popsize,)), 0.0, 1.0
        )
        return state._replace(F=F, CR=CR, key=key)

    def ask(self, key, state, lower, upper):
        x = state.population
        pop, dim = x.shape
        k_best, k_a, k_b, k_cross, k_forced = jax.random.split(key, 5)
        leaders = jax.lax.top_k(-state.losses, max(2, round(self.pbest * pop)))[1]
        best = x[leaders[jax.random.randint(k_best, (pop,), 0, len(leaders))]]
        own = jnp.arange(pop)
        a = (own + jax.random.randint(k_a, (pop,), 1, pop)) % pop
        both = jnp.concatenate([x, state.archive])
        b = (own + jax.random.randint(k_b, (pop,), 1, 2 * pop)) % (2 * pop)
        F = state.F[:, None]
        v = x + F * (best - x) + F * (x[a] - both[b])
        v = jnp.where(v < lower, (x + lower) / 2, jnp.where(v > upper, (x + upper) / 2, v))
        forced = jax.random.uniform(k_forced, (pop, 1), jnp.float32)
        return jnp.where(binomial(k_cross, (pop, dim), state.CR[:, None], forced), v, x)

    def tell(self, state, candidates, losses):
        better, gain = losses <= state.losses, state.losses - losses
        won = (losses < state.losses) * jnp.where(jnp.isfinite(gain), gain, 0.0)
        any_won, total = jnp.sum(won) > 0, jnp.maximum(jnp.sum(won), 1e-300)
        lehmer = jnp.sum(won * state.F**2) / jnp.maximum(jnp.sum(won * state.F), 1e-300)

        def keep(memory, value):
            return memory.at[state.slot].set(jnp.where(any_won, value, memory[state.slot]))

        return self._drawn(
            state._replace(
                population=jnp.where(better[:, None], candidates, state.population),
                losses=jnp.where(better, losses, state.losses),
                archive=jnp.where(better[:, None], state.population, state.archive),
                F_memory=keep(state.F_memory, lehmer),
                CR_memory=keep(state.CR_memory, jnp.sum(won * state.CR) / total),
                slot=(state.slot + any_won) % self.memory,
            )
        )

    def spread(self, state):
        return extent(state.population)
