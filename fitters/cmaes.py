"""Covariance matrix adaptation (Hansen, The CMA Evolution Strategy: A Tutorial, arXiv
1604.00772).
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.fitters.de import extent
from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.settings import option


class CmaesState(NamedTuple):
    mean: Float[Array, " dim"]
    sigma: Float[Array, ""]
    C: Float[Array, "dim dim"]
    basis: Float[Array, "dim dim"]  # eigenvectors of C
    lengths: Float[Array, " dim"]  # square roots of its eigenvalues
    path_sigma: Float[Array, " dim"]
    path_C: Float[Array, " dim"]
    scale: Float[Array, " dim"]  # search variables are counted in this
    generation: Array
    last: Float[Array, "pop dim"]


class CMAES(AbstractPopulation):
    """CMA-ES with bounds by reflection, restarted with twice the population when it stalls (IPOP).

    It learns the metric of the problem, so that correlated parameters and parameters of different
    weight cost it little: the quickest population on smooth problems of few parameters. With a
    dozen parameters, some of them near bounds, `shade` reaches the minimum more reliably.
    """

    name: ClassVar[str] = "cmaes"
    source: ClassVar[str] = "Hansen 2016; restarts: Auger and Hansen, CEC 2005"

    popsize: int = option(24, "candidates of a generation, twice as many after each restart", 4)
    generations: int = option(1000, "most generations", 1)
    restarts: int = option(4, "most new beginnings after a stall", 0)
    stall: int = option(40, "generations without gain after which a search ends; 0: never", 0)

    def again(self):
        return replace(self, popsize=2 * self.popsize)

    def _constants(self, dim: int):
        mu = self.popsize // 2
        w = np.log((self.popsize + 1) / 2) - np.log(np.arange(1, mu + 1))
        w /= w.sum()
        mu_eff = 1 / np.sum(w**2)
        c_sigma = (mu_eff + 2) / (dim + mu_eff + 5)
        d_sigma = 1 + 2 * max(0.0, np.sqrt((mu_eff - 1) / (dim + 1)) - 1) + c_sigma
        c_C = (4 + mu_eff / dim) / (dim + 4 + 2 * mu_eff / dim)
        c_1 = 2 / ((dim + 1.3) ** 2 + mu_eff)
        c_mu = min(1 - c_1, 2 * (mu_eff - 2 + 1 / mu_eff) / ((dim + 2) ** 2 + mu_eff))
        return w, mu_eff, c_sigma, d_sigma, c_C, c_1, c_mu

    def init(self, key, population, losses):
        dim = population.shape[1]
        scale = jnp.maximum(jnp.std(population, 0), 1e-300)
        eye, zero = jnp.eye(dim), jnp.zeros(dim)
        start = population[jnp.argmin(losses)]
        return CmaesState(
            mean=start,
            sigma=jnp.asarray(0.8),
            C=eye,
            basis=eye,
            lengths=jnp.ones(dim),
            path_sigma=zero,
            path_C=zero,
            scale=scale,
            generation=jnp.zeros((), jnp.int32),
            last=population,
        )

    def ask(self, key, state, lower, upper):
        normal = jax.random.normal(key, (self.popsize, state.mean.shape[0]))
        z = state.mean + state.scale * state.sigma * (normal * state.lengths) @ state.basis.T
        # Folded at the bounds like a sheet of paper: every point of the box keeps a neighbourhood.
        width = upper - lower
        turn = jnp.mod(z - lower, 2 * width)
        return jnp.clip(lower + jnp.where(turn > width, 2 * width - turn, turn), lower, upper)

    def tell(self, state, candidates, losses):
        dim = candidates.shape[1]
        w, mu_eff, c_sigma, d_sigma, c_C, c_1, c_mu = self._constants(dim)
        best = candidates[jax.lax.top_k(-losses, len(w))[1]]
        steps = (best - state.mean) / state.scale / state.sigma
        step = w @ steps
        mean = state.mean + state.scale * state.sigma * step
        white = state.basis @ ((state.basis.T @ step) / state.lengths)
        path_sigma = (1 - c_sigma) * state.path_sigma + np.sqrt(
            c_sigma * (2 - c_sigma) * mu_eff
        ) * white
        length, expected = (
            jnp.linalg.norm(path_sigma),
            np.sqrt(dim) * (1 - 1 / (4 * dim) + 1 / (21 * dim**2)),
        )
        grown = 1 - (1 - c_sigma) ** (2.0 * (state.generation + 1))
        calm = length / jnp.sqrt(grown) < (1.4 + 2 / (dim + 1)) * expected
        path_C = (1 - c_C) * state.path_C + calm * np.sqrt(c_C * (2 - c_C) * mu_eff) * step
        C = (1 - c_1 - c_mu) * state.C + c_1 * (
            jnp.outer(path_C, path_C) + (1 - calm) * c_C * (2 - c_C) * state.C
        )
        C = C + c_mu * (steps * w[:, None]).T @ steps
        sigma = state.sigma * jnp.exp(
            jnp.clip(c_sigma / d_sigma * (length / expected - 1), -1.0, 1.0)
        )
        sigma = jnp.clip(sigma, 1e-15, 1e3)
        generation = state.generation + 1
        period = max(1, int(1 / (10 * dim * (c_1 + c_mu))))

        def decomposed(_):
            values, vectors = jnp.linalg.eigh((C + C.T) / 2)
            return vectors, jnp.sqrt(jnp.clip(values, 1e-16 * values[-1], None))

        basis, lengths = jax.lax.cond(
            generation % period == 0, decomposed, lambda _: (state.basis, state.lengths), None
        )
        return CmaesState(
            mean=mean,
            sigma=sigma,
            C=C,
            basis=basis,
            lengths=lengths,
            path_sigma=path_sigma,
            path_C=path_C,
            scale=state.scale,
            generation=generation,
            last=candidates,
        )

    def spread(self, state):
        return extent(state.last)
