"""Fitters: one interface for gradient methods and populations, on the same loss of a `Problem`.

A least-squares method writes `minimise`. A population writes `init`, `ask`, `tell`; the loop, the bounds, candidates that
diverge, best-so-far, history and the stopping rules live here once.
"""

from __future__ import annotations

import abc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxid.precision import float64
from jaxid.problem import PENALTY, Problem


Progress = Callable[[str, int, int, str], None]


@dataclass(frozen=True)
class Minimum:
    """What a fitter returns: a failure is a value with a sentence, never an exception."""

    z: np.ndarray
    loss: float
    converged: bool
    stopped_because: str
    evaluations: int
    history: list[tuple[int, float]] = field(default_factory=list)  # (evaluations, best loss so far)

    @property
    def failed(self) -> bool:
        return not np.isfinite(self.loss) or self.loss >= PENALTY


class AbstractFitter(eqx.Module):
    """Abstract: `minimise` a problem from some starts. Class attributes of a final class: `name`, `source`."""

    name: eqx.AbstractClassVar[str]
    source: eqx.AbstractClassVar[str]

    @abc.abstractmethod
    def minimise(
        self,
        problem: Problem,
        starts: Sequence[np.ndarray],
        key: PRNGKeyArray,
        budget: int | None = None,
        progress: Progress | None = None,
    ) -> Minimum:
        """The best z found. `starts` are guesses, best first; `budget` bounds the number of loss evaluations."""


def sampling_box(problem: Problem, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where random starts and first populations are drawn: the bounds, narrowed to a plausible neighbourhood of the guess
    where they span more than two decades (or, for a linear scale, more than 20 times the guess or a typical change)."""
    lower, upper = problem.lower.copy(), problem.upper.copy()
    log = np.zeros(problem.size, bool)
    log[: problem.free.size] = problem.log
    decade = np.log(10.0)
    wide = log & (upper - lower > 2 * decade)
    lower[wide], upper[wide] = np.maximum(lower, guess - decade)[wide], np.minimum(upper, guess + decade)[wide]
    size = np.maximum(np.abs(guess), 2 * problem.scale)
    wide = ~log & (upper - lower > 20 * size)
    wide[problem.free.size :] = False
    lower[wide], upper[wide] = np.maximum(lower, guess - 5 * size)[wide], np.minimum(upper, guess + 5 * size)[wide]
    return lower, upper


class AbstractPopulation(AbstractFitter):
    """Abstract: a population method in three pure functions over the unit of search z, bounds kept by the base.

    `popsize` and `generations` are fields of every final class.
    """

    popsize: eqx.AbstractVar[int]
    generations: eqx.AbstractVar[int]

    @abc.abstractmethod
    def init(self, key: PRNGKeyArray, population: Float[Array, "pop dim"], losses: Float[Array, " pop"]) -> Any:
        """State from a first, evaluated population."""

    @abc.abstractmethod
    def ask(
        self, key: PRNGKeyArray, state: Any, lower: Float[Array, " dim"], upper: Float[Array, " dim"]
    ) -> Float[Array, "pop dim"]:
        """Candidates of the next generation; what leaves the bounds is brought back by the base."""

    @abc.abstractmethod
    def tell(self, state: Any, candidates: Float[Array, "pop dim"], losses: Float[Array, " pop"]) -> Any:
        """State after the candidates have been evaluated."""

    @abc.abstractmethod
    def best(self, state: Any) -> tuple[Float[Array, " dim"], Float[Array, ""]]:
        """Best candidate so far and its loss."""

    @abc.abstractmethod
    def spread(self, state: Any) -> Float[Array, ""]:
        """Largest extent of the population; zero once it has collapsed."""

    def minimise(self, problem, starts, key, budget=None, progress=None):
        generations = self.generations
        if budget is not None:
            generations = max(1, min(generations, budget // self.popsize - 1))
        lower, upper = problem.lower, problem.upper
        box = sampling_box(problem, starts[0])
        data = problem.data

        def begin(key, low, high, guesses, data):
            k0, k1 = jax.random.split(key)
            population = low + (high - low) * jax.random.uniform(k0, (self.popsize, low.shape[0]))
            population = population.at[: guesses.shape[0]].set(guesses)
            return self.init(k1, population, problem.pure_losses(population, data))

        def advance(state, key, first, count, lower, upper, data):
            def generation(i, state):
                k0, k1 = jax.random.split(jax.random.fold_in(key, first + i))
                candidates = reflected(k1, self.ask(k0, state, lower, upper), lower, upper)
                return self.tell(state, candidates, problem.pure_losses(candidates, data))

            return jax.lax.fori_loop(0, count, generation, state)

        with float64():
            key = jnp.asarray(key)
            guesses = np.clip(np.array(starts[: max(1, self.popsize // 4)]), lower, upper)
            state = jax.jit(begin)(jax.random.fold_in(key, 0), *box, guesses, data)
            step = jax.jit(advance)
            done, chunk, history = 0, 1, [(self.popsize, float(self.best(state)[1]))]
            stopped, converged = "all generations done", False
            while done < generations:
                began = time.perf_counter()
                count = min(chunk, generations - done)
                state = step(state, key, np.int32(done + 1), np.int32(count), lower, upper, data)
                z, loss = (np.asarray(a) for a in self.best(state))
                spent = time.perf_counter() - began
                if done:  # the first call compiles
                    chunk = int(np.clip(chunk * min(8.0, 0.7 / max(spent, 1e-3)), 1, 1000))
                done += count
                history.append(((done + 1) * self.popsize, float(loss)))
                if progress:
                    progress(self.name, done, generations, f"loss {float(loss):.6g}")
                if float(self.spread(state)) <= 1e-9 * float(np.max(upper - lower)):
                    stopped, converged = "the population has collapsed to one point", True
                    break
            z = np.asarray(self.best(state)[0])
        loss = problem.loss(z)
        if loss >= PENALTY:
            return Minimum(z, loss, False, "every candidate diverged", (done + 1) * self.popsize, history)
        return Minimum(z, loss, converged, stopped, (done + 1) * self.popsize, history)


def reflected(key: PRNGKeyArray, z: Array, lower: Array, upper: Array) -> Array:
    """What lies outside the bounds goes to a random place inside; nan too."""
    inside = (z >= lower) & (z <= upper)
    return jnp.where(inside, z, lower + (upper - lower) * jax.random.uniform(key, z.shape))
