"""Recursive differential evolution of the space-manipulator study, with the Gauss-Newton metric.

The study describes in words how the best vector of rand-to-best/1/bin is replaced by one improved
by a recursive least-squares step. With r the residual and Psi = -dr/dz at z, in coordinates of the
unit box,

    s(z) = (Psi' Psi + mu I)^-1 Psi' r,    mu = 1e-8 trace(Psi' Psi) / dim,    rho ~ U(0, 1)

- target: v = x + K (clip(best + rho s(best)) - x) + F (b - c)
- shift:  v = x + rho s(best) + F (b - c), the literal wording; it does not converge where target does
- self:   rand-to-best for all, and a tenth of the members take rho times their own step

`jaxid.fitting.sequential.follow` runs it (and any other population) over growing or sliding data.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import UsageError
from jaxid.fitters.de import binomial, dithered, donors, extent
from jaxid.fitting.fitter import Log
from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.settings import option
from jaxid.problem.gauss_newton import gauss_newton_model
from jaxid.problem.objective import AbstractProblem


VARIANTS = ("self", "target", "shift")


class RdeState(NamedTuple):
    population: Float[Array, "pop dim"]
    losses: Float[Array, " pop"]
    key: Any
    where: Any  # [looks] members whose step is known
    steps: Any  # [looks dim]


class RecursiveDE(AbstractPopulation):
    """Recursive differential evolution: rand-to-best/1/bin that knows Gauss-Newton steps; `variant`
    is self, target or shift.

    self is the most robust, target the fastest. A step costs 1 + dim evaluations, counted in the
    budget.
    """

    name: ClassVar[str] = "rde"
    source: ClassVar[str] = (
        "Int. J. Advanced Robotic Systems, 2016, doi 10.5772/63935; metric and settings: this"
        " library"
    )
    guided: ClassVar[bool] = True

    popsize: int = option(60, "members of the population", 4)
    generations: int = option(200, "most generations", 1)
    F: tuple[float, float] = option(
        (0.4, 0.9), "range that a difference's weight is drawn from; one number: always that", 0
    )
    K: float = option(0.5, "weight of the way towards the best member", 0)
    CR: float = option(0.9, "probability that a coordinate comes from the mutant", 0, 1)
    looks: float = option(
        0.1,
        "share of the members that look along a Gauss-Newton step in a generation (variant self)",
        0,
        1,
    )
    variant: str = option("self", "self, target or shift", static=True)

    def __check_init__(self):
        if self.variant not in VARIANTS:
            raise UsageError(f"rde has no variant {self.variant!r}; there is {', '.join(VARIANTS)}")

    @property
    def count(self) -> int:
        """Steps computed in a generation."""
        return max(1, round(self.looks * self.popsize)) if self.variant == "self" else 1

    def cost(self, problem):
        return self.popsize + self.count * (1 + problem.size)

    def init(self, key, population, losses):
        where = jnp.zeros(self.count, jnp.int32)
        return RdeState(
            population, losses, key, where, jnp.zeros((self.count, population.shape[1]))
        )

    def informed(self, problem: AbstractProblem, state: Any, log: Log) -> RdeState:
        """State with the Gauss-Newton step of the best member, or of some drawn at random."""
        x, losses = np.asarray(state.population), np.asarray(state.losses)
        if self.variant == "self":
            key = np.asarray(jax.random.key_data(state.key)).ravel()
            where = np.random.default_rng(key).choice(len(x), self.count, replace=False)
        else:
            where = np.array([int(np.argmin(losses))])
        width = problem.upper - problem.lower
        steps = np.zeros((len(where), x.shape[1]))
        for k, at in enumerate(gauss_newton_model([(problem, x[i]) for i in where])):
            A, pull = at.hessian * width * width[:, None], at.gradient * width
            if np.isfinite(A).all() and np.isfinite(pull).all() and np.trace(A) > 0:
                A = A + 1e-8 * np.trace(A) / len(A) * np.eye(len(A))
                steps[k] = -width * np.linalg.solve(A, pull)
        log.add(len(where) * (1 + problem.size), np.inf)
        return state._replace(where=where.astype(np.int32), steps=steps)

    def ask(self, key, state, lower, upper):
        x, dim = state.population, state.population.shape[1]
        k_donors, k_member = jax.random.split(key)
        b, c = donors(k_donors, x, 2)
        u = jax.random.uniform(k_member, (3, x.shape[0], 1), jnp.float32)
        best = x[jnp.argmin(state.losses)]
        difference = dithered(self.F, u[0]) * (b - c)
        if self.variant == "target":
            aim = jnp.clip(best + u[2] * state.steps[0], lower, upper)
            v = x + self.K * (aim - x) + difference
        elif self.variant == "shift":
            v = x + u[2] * state.steps[0] + difference
        else:
            v = x + self.K * (best - x) + difference
            v = v.at[state.where].set(x[state.where] + u[2][state.where] * state.steps)
        v = jnp.where((v < lower) | (v > upper), (x + jnp.clip(v, lower, upper)) / 2, v)
        own = jnp.zeros((x.shape[0], 1), bool).at[state.where].set(self.variant == "self")
        return jnp.where(binomial(k_member, (x.shape[0], dim), self.CR, u[1]) | own, v, x)

    def tell(self, state, candidates, losses):
        better = losses <= state.losses
        return state._replace(
            population=jnp.where(better[:, None], candidates, state.population),
            losses=jnp.where(better, losses, state.losses),
            key=jax.random.split(state.key, 1)[0],
        )

    def spread(self, state):
        return extent(state.population)
