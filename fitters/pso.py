"""Particle swarm (Kennedy and Eberhart 1995) with the best of the whole swarm as its attractor."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.fitters.de import extent
from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.settings import option


class PsoState(NamedTuple):
    position: Float[Array, "pop dim"]
    velocity: Float[Array, "pop dim"]
    best: Float[Array, "pop dim"]  # of each particle
    losses: Float[Array, " pop"]


class ParticleSwarm(AbstractPopulation):
    """v <- w v + c1 u1 (own best - x) + c2 u2 (swarm's best - x); a particle at a bound stops
    there.

    The default is the constricted swarm. `ParticleSwarm(w=1.4, c1=1.5, c2=2.5)` are the settings of
    the flexible-link study: w > 1 lies outside the region of convergence, the swarm ends at the
    bounds.
    """

    name: ClassVar[str] = "pso"
    source: ClassVar[str] = (
        "Kennedy and Eberhart 1995; constriction: Clerc and Kennedy, IEEE Trans. Evol. Comp. 6, 2002"
    )

    popsize: int = option(60, "members of the swarm", 2)
    generations: int = option(400, "most generations", 1)
    w: float = option(0.7298, "share of its velocity that a particle keeps")
    c1: float = option(1.49618, "pull of its own best place")
    c2: float = option(1.49618, "pull of the swarm's best place")

    def init(self, key, population, losses):
        return PsoState(population, jnp.zeros_like(population), population, losses)

    def ask(self, key, state, lower, upper):
        return jnp.clip(state.position + self._velocity(key, state), lower, upper)

    def _velocity(self, key, state):
        own, swarm = jax.random.uniform(key, (2, *state.position.shape), jnp.float32)
        leader = state.best[jnp.argmin(state.losses)]
        pull = self.c1 * own * (state.best - state.position) + self.c2 * swarm * (
            leader - state.position
        )
        return self.w * state.velocity + pull

    def tell(self, state, candidates, losses):
        better = losses < state.losses
        # The way that was really gone: what the bounds cut off is gone from the velocity too.
        return PsoState(
            candidates,
            candidates - state.position,
            jnp.where(better[:, None], candidates, state.best),
            jnp.where(better, losses, state.losses),
        )

    def spread(self, state):
        return extent(state.position)
