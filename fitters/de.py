"""Differential evolution (Storn and Price, J. Global Optimization 11, 1997)."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.fitter import AbstractPopulation


class State(NamedTuple):
    population: Float[Array, "pop dim"]
    losses: Float[Array, " pop"]


class DifferentialEvolution(AbstractPopulation):
    """DE with binomial crossover; `strategy` is rand/1 or best/1 or current-to-best/1. F is drawn anew for every generation
    within `F`, which keeps the population from stalling."""

    name: ClassVar[str] = "de"
    source: ClassVar[str] = "Storn and Price 1997; dither of F: Das and Suganthan, IEEE Trans. Evol. Comp. 15, 2011"

    popsize: int = 60
    generations: int = 400
    F: tuple[float, float] = (0.5, 0.9)
    CR: float = 0.9
    strategy: str = eqx.field(static=True, default="rand/1")

    def __check_init__(self):
        if self.strategy not in ("rand/1", "best/1", "current-to-best/1"):
            raise ValueError(f"strategy {self.strategy!r}: there is rand/1, best/1, current-to-best/1")
        if self.popsize < 4:
            raise ValueError("differential evolution needs a population of at least 4")

    def init(self, key, population, losses):
        return State(population, losses)

    def ask(self, key, state, lower, upper):
        x, losses = state
        pop, dim = x.shape
        k_pick, k_F, k_cross, k_forced = jax.random.split(key, 4)
        # Three different members, none of them the target: shifts of the index by distinct random amounts.
        shift = jax.random.choice(k_pick, pop - 1, (3,), replace=False) + 1
        a, b, c = (x[(jnp.arange(pop) + s) % pop] for s in shift)
        F = self.F[0] + (self.F[1] - self.F[0]) * jax.random.uniform(k_F, (pop, 1))
        best = x[jnp.argmin(losses)]
        if self.strategy == "rand/1":
            mutant = a + F * (b - c)
        elif self.strategy == "best/1":
            mutant = best + F * (b - c)
        else:
            mutant = x + F * (best - x) + F * (b - c)
        cross = jax.random.uniform(k_cross, (pop, dim)) < self.CR
        cross |= jnp.arange(dim) == jax.random.randint(k_forced, (pop, 1), 0, dim)
        return jnp.where(cross, mutant, x)

    def tell(self, state, candidates, losses):
        better = losses <= state.losses
        return State(jnp.where(better[:, None], candidates, state.population), jnp.where(better, losses, state.losses))

    def best(self, state):
        i = jnp.argmin(state.losses)
        return state.population[i], state.losses[i]

    def spread(self, state):
        return jnp.max(jnp.max(state.population, 0) - jnp.min(state.population, 0))
