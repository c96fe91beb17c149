"""Differential evolution (Storn and Price, J. Global Optimization 11, 1997)."""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, UInt32

from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.settings import option


#: The largest 32-bit word that a 32-bit float holds.
LARGEST = 2.0**32 - 256
STRATEGIES = ("rand/1", "best/1", "current-to-best/1")


class DeState(NamedTuple):
    population: Float[Array, "pop dim"]
    losses: Float[Array, " pop"]


class DifferentialEvolution(AbstractPopulation):
    """Differential evolution; `strategy` is rand/1, best/1 or current-to-best/1, `crossover` bin or
    exp.

    F is drawn for every member within `F`, which keeps the population from stalling. The three
    donors of a member are its neighbours at three random distances that a generation shares: shifts
    of the whole array, which cost a copy where an index for every member costs a gather.
    """

    name: ClassVar[str] = "de"
    source: ClassVar[str] = (
        "Storn and Price 1997; dither of F: Das and Suganthan, IEEE Trans. Evol. Comp. 15, 2011"
    )

    popsize: int = option(60, "members of the population", 4)
    generations: int = option(400, "most generations", 1)
    F: tuple[float, float] = option(
        (0.5, 0.9), "range that a difference's weight is drawn from; one number: always that", 0
    )
    CR: float = option(0.9, "probability that a coordinate comes from the mutant", 0, 1)
    strategy: str = option("rand/1", "rand/1, best/1 or current-to-best/1", static=True)
    crossover: str = option("bin", "bin or exp", static=True)

    def __check_init__(self):
        if self.strategy not in STRATEGIES:
            raise ValueError(f"strategy {self.strategy!r}: there is {', '.join(STRATEGIES)}")
        if self.crossover not in ("bin", "exp"):
            raise ValueError(f"crossover {self.crossover!r}: there is bin, exp")
        if self.popsize < 4:
            raise ValueError("differential evolution needs a population of at least 4")

    def init(self, key, population, losses):
        return DeState(population, losses)

    def ask(self, key, state, lower, upper):
        x = state.population
        k_donors, k_member = jax.random.split(key)
        a, b, c = donors(k_donors, x)
        u = jax.random.uniform(k_member, (3, x.shape[0], 1), jnp.float32)
        difference = dithered(self.F, u[0]) * (b - c)
        best = x[jnp.argmin(state.losses)]
        mutant = {
            "rand/1": lambda: a + difference,
            "best/1": lambda: best + difference,
            "current-to-best/1": lambda: x + dithered(self.F, u[0]) * (best - x) + difference,
        }[self.strategy]()
        cross = (
            binomial(k_member, x.shape, self.CR, u[1])
            if self.crossover == "bin"
            else exponential(x.shape, self.CR, u[1], u[2])
        )
        return jnp.where(cross, mutant, x)

    def tell(self, state, candidates, losses):
        return select(state, candidates, losses)

    def spread(self, state):
        return extent(state.population)


def donors(
    key: PRNGKeyArray, x: Float[Array, "pop dim"], count: int = 3
) -> list[Float[Array, "pop dim"]]:
    """For each member `count` others, all different: the population rolled by distinct random
    distances.
    """
    pop = x.shape[0]
    draw = jax.random.uniform(key, (count,), jnp.float32)
    shifts: list[Array] = []
    ordered: list[Array] = []
    for k in range(count):
        shift = 1 + jnp.minimum(jnp.floor(draw[k] * (pop - 1 - k)), pop - 2 - k).astype(jnp.int32)
        for taken in ordered:  # the draw counts only the distances that are left
            shift = jnp.where(shift >= taken, shift + 1, shift)
        shifts.append(shift)
        for i in range(len(ordered)):
            ordered[i], shift = jnp.minimum(ordered[i], shift), jnp.maximum(ordered[i], shift)
        ordered.append(shift)
    twice = jnp.concatenate([x, x])
    return [jax.lax.dynamic_slice_in_dim(twice, shift, pop) for shift in shifts]


def dithered(F: tuple[float, float], u: Array) -> Array:
    return F[0] + (F[1] - F[0]) * u


def binomial(
    key: PRNGKeyArray, shape: tuple[int, int], CR: float | Array, forced: Float[Array, "pop 1"]
) -> Array:
    """Crossover mask: every coordinate with probability CR (a number, or one a member [pop 1]), and
    one for sure; `forced` uniform draws for that.
    """
    level = (jnp.asarray(CR) * LARGEST).astype(jnp.uint32)
    return (words(key, shape) < level) | (jnp.arange(shape[1]) == jnp.floor(forced * shape[1]))


def words(key: PRNGKeyArray, shape: tuple[int, ...]) -> UInt32[Array, ...]:
    """Random words, in an eighth of the time of `jax.random.bits`: the counters hashed with one
    half of the key, then with the other. Good enough for the coin tosses of a crossover, not for
    cryptography (hash of two multiplications with the constants of Wellons, Hash Function
    Prospector, 2018).
    """
    half = jnp.ravel(jax.random.key_data(key)).astype(jnp.uint32)
    count = jax.lax.iota(jnp.uint32, math.prod(shape)).reshape(shape)
    return _hash(_hash(count + half[0]) + half[-1])


def _hash(x: Array) -> Array:
    x = (x ^ (x >> 16)) * np.uint32(0x21F0AAAD)
    x = (x ^ (x >> 15)) * np.uint32(0xD35A2D97)
    return x ^ (x >> 15)


def exponential(
    shape: tuple[int, int], CR: float, start: Float[Array, "pop 1"], length: Float[Array, "pop 1"]
) -> Array:
    """Crossover mask: a cyclic run of coordinates that begins anywhere and goes on with probability
    CR.
    """
    _, dim = shape
    run = 1 + jnp.floor(jnp.log(jnp.maximum(length, 1e-30)) / np.log(min(max(CR, 1e-9), 1 - 1e-9)))
    after = jnp.arange(dim) - jnp.floor(start * dim)
    return jnp.where(after < 0, after + dim, after) < jnp.minimum(run, dim)


def select(
    state: DeState, candidates: Float[Array, "pop dim"], losses: Float[Array, " pop"]
) -> DeState:
    """Every member is replaced by its candidate unless that is worse."""
    better = losses <= state.losses
    return DeState(
        jnp.where(better[:, None], candidates, state.population),
        jnp.where(better, losses, state.losses),
    )


def extent(population: Float[Array, "pop dim"]) -> Float[Array, ""]:
    return jnp.max(jnp.max(population, 0) - jnp.min(population, 0))
