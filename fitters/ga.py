"""Genetic algorithm with real numbers as genes, in the two forms that the studies behind this
library used.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.fitters.de import extent
from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.settings import option


#: Directions tried for a child that has to stay within the bounds.
TRIED = 8


class GaState(NamedTuple):
    population: Float[Array, "pop dim"]
    losses: Float[Array, " pop"]
    generation: Array
    step: Array  # of the feasible mutation, as a share of the bounds


class GeneticAlgorithm(AbstractPopulation):
    """Genetic algorithm; `scheme` is blend or scattered.

    blend: the better `keep` of the population stays, pairs of it are drawn by rank and mixed gene
    by gene (with probability `crossover`), and a share `mutation` of the genes of the children is
    drawn anew. These defaults are the settings of the flexible-link study with its population of
    100.

    scattered: one member stays, parents are drawn by stochastic uniform selection, `crossover` of
    the children take each gene from either parent, the others are mutated by steps that shrink over
    the generations. The settings of the sun-tracker study: `GeneticAlgorithm(scheme="scattered",
    popsize=20, stall=50, tolerance=1e-6)`.
    """

    name: ClassVar[str] = "ga"
    source: ClassVar[str] = (
        "Haupt and Haupt, Practical Genetic Algorithms, 2004 (blend); defaults of MATLAB ga as used"
        " by the sun-tracker study (scattered)"
    )

    popsize: int = option(100, "members of the population", 4)
    generations: int = option(400, "most generations", 1)
    keep: float = option(0.5, "share of the population that stays and is parent (blend)", 0, 1)
    crossover: float = option(
        0.8,
        "probability that a gene is mixed (blend), or share of children by crossover (scattered)",
        0,
        1,
    )
    mutation: float = option(0.2, "share of the genes drawn anew (blend)", 0, 1)
    scheme: str = option("blend", "blend or scattered", static=True)
    mutate: str = option("shrinking", "shrinking or feasible (scattered)", static=True)

    def __check_init__(self):
        if self.scheme not in ("blend", "scattered"):
            raise ValueError(f"scheme {self.scheme!r}: there is blend, scattered")
        if self.mutate not in ("shrinking", "feasible"):
            raise ValueError(f"mutate {self.mutate!r}: there is shrinking, feasible")
        if not 0 < self.keep < 1 or self.popsize < 4:
            raise ValueError("`keep` is a share of a population of at least 4")

    def init(self, key, population, losses):
        order = jnp.argsort(losses)
        return GaState(population[order], losses[order], jnp.zeros((), jnp.int32), jnp.ones(()))

    @property
    def survivors(self) -> int:
        """Members that stay unchanged."""
        return (
            1
            if self.scheme == "scattered"
            else min(self.popsize - 1, max(2, round(self.keep * self.popsize)))
        )

    @property
    def offspring(self):
        return self.popsize - self.survivors

    def ask(self, key, state, lower, upper):
        return (self._blend if self.scheme == "blend" else self._scattered)(
            key, state, lower, upper
        )

    def _blend(self, key, state, lower, upper):
        keep, dim = self.survivors, state.population.shape[1]
        count = self.offspring
        pairs = -(-count // 2)
        k_mates, k_mix, k_which, k_mutate, k_new = jax.random.split(key, 5)
        weight = np.cumsum(np.arange(keep, 0, -1.0)) / (keep * (keep + 1) / 2)
        mates = jnp.searchsorted(weight, jax.random.uniform(k_mates, (2, pairs)))
        a, b = state.population[jnp.minimum(mates, keep - 1)]
        mix = jax.random.uniform(k_mix, (pairs, dim)) * (
            jax.random.uniform(k_which, (pairs, 1)) < self.crossover
        )
        children = jnp.concatenate([a + mix * (b - a), b + mix * (a - b)])[:count]
        new = lower + (upper - lower) * jax.random.uniform(k_new, children.shape)
        return jnp.where(
            jax.random.uniform(k_mutate, children.shape) < self.mutation, new, children
        )

    def _scattered(self, key, state, lower, upper):
        pop, dim = state.population.shape
        count = pop - 1
        k_wheel, k_shuffle, k_gene, k_step = jax.random.split(key, 4)
        weight = 1 / np.sqrt(1 + np.arange(pop))
        wheel = np.cumsum(weight) / weight.sum()
        marks = (jnp.arange(2 * count) + jax.random.uniform(k_wheel)) / (2 * count)
        parents = jax.random.permutation(
            k_shuffle, jnp.minimum(jnp.searchsorted(wheel, marks), pop - 1)
        )
        a, b = state.population[parents[:count]], state.population[parents[count:]]
        crossed = jnp.where(jax.random.bernoulli(k_gene, 0.5, (count, dim)), a, b)
        if self.mutate == "feasible":
            mutated = _feasible(k_step, a, state.step, lower, upper)
        else:
            size = 0.3 * jnp.maximum(1 - state.generation / self.generations, 0.0)
            mutated = jnp.clip(
                a + size * (upper - lower) * jax.random.normal(k_step, (count, dim)), lower, upper
            )
        first = (jnp.arange(count) < round(self.crossover * count))[:, None]
        return jnp.where(first, crossed, mutated)

    def tell(self, state, candidates, losses):
        population = jnp.concatenate([state.population[: self.survivors], candidates])
        losses = jnp.concatenate([state.losses[: self.survivors], losses])
        order = jnp.argsort(losses)
        gained = losses[order[0]] < state.losses[0]
        step = jnp.where(
            gained, jnp.minimum(4 * state.step, 1.0), jnp.maximum(state.step / 4, 1e-6)
        )
        return GaState(population[order], losses[order], state.generation + 1, step)

    def spread(self, state):
        return extent(state.population)


def _feasible(
    key: Array, x: Array, step: Array, lower: Array, upper: Array
) -> Float[Array, "count dim"]:
    """Each x moved by `step` along the first of some random directions that stays within the
    bounds; where none does, x.
    """
    d = jax.random.normal(key, (TRIED, *x.shape))
    moved = x + step * (upper - lower) * d / jnp.sqrt(jnp.sum(d * d, -1, keepdims=True))
    inside = jnp.all((moved >= lower) & (moved <= upper), -1)
    chosen = jnp.take_along_axis(moved, jnp.argmax(inside, 0)[None, :, None], 0)[0]
    return jnp.where(jnp.any(inside, 0)[:, None], chosen, x)
