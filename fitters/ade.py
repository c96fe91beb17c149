"""The differential evolution of the space-manipulator study: rand-to-best/1/bin."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from jaxid.fitters.de import binomial, DeState, dithered, donors, extent, select
from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.settings import option


class RandToBestDE(AbstractPopulation):
    """DE/rand-to-best/1/bin: v = x + K (best - x) + F (b - c).

    Faster than rand/1 and easier to trap: with F = 0.5 for every member (`F=(0.5, 0.5)`) it
    converges prematurely; F drawn for each member, the default, keeps it alive.
    """

    name: ClassVar[str] = "ade"
    source: ClassVar[str] = (
        "Int. J. Advanced Robotic Systems, 2016, doi 10.5772/63935 (ADE); F, K, CR are not given"
        " there"
    )

    popsize: int = option(60, "members of the population", 4)
    generations: int = option(400, "most generations", 1)
    F: tuple[float, float] = option(
        (0.4, 0.9), "range that a difference's weight is drawn from; one number: always that", 0
    )
    K: float = option(0.5, "weight of the way towards the best member", 0)
    CR: float = option(0.9, "probability that a coordinate comes from the mutant", 0, 1)

    def init(self, key, population, losses):
        return DeState(population, losses)

    def ask(self, key, state, lower, upper):
        x = state.population
        k_donors, k_member = jax.random.split(key)
        b, c = donors(k_donors, x, 2)
        u = jax.random.uniform(k_member, (2, x.shape[0], 1), jnp.float32)
        mutant = x + self.K * (x[jnp.argmin(state.losses)] - x) + dithered(self.F, u[0]) * (b - c)
        return jnp.where(binomial(k_member, x.shape, self.CR, u[1]), mutant, x)

    def tell(self, state, candidates, losses):
        return select(state, candidates, losses)

    def spread(self, state):
        return extent(state.population)
