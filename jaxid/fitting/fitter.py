"""Fitters: one interface for gradient methods and populations, on the same loss of a problem.

A least-squares method writes `minimise`. A population writes `init`, `ask`, `tell`, `spread`; the
loop, the bounds, candidates that diverge, best-so-far, history, restarts and the stopping rules
live here once.
"""

from __future__ import annotations

import abc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import PRNGKeyArray

from jaxid.problem.objective import AbstractProblem
from jaxid.problem.problem import PENALTY


Progress = Callable[[str, int, int, str], None]


@dataclass(frozen=True)
class Minimum:
    """What a fitter returns: a failure is a value with a sentence, never an exception.

    An evaluation is one loss; a residual with its Jacobian counts as 1 + size of them. `seconds`
    goes with `history`, without the time that compiling took.
    """

    z: np.ndarray
    loss: float
    converged: bool
    stopped_because: str
    evaluations: int
    history: list[tuple[int, float]] = field(
        default_factory=list
    )  # (evaluations, best loss so far)
    seconds: list[float] = field(default_factory=list)
    stalled: bool = (
        False  # ended by a rule of its own and not by a limit, yet without having converged
    )

    @property
    def failed(self) -> bool:
        return not np.isfinite(self.loss) or self.loss >= PENALTY


class AbstractFitter(eqx.Module):
    """Abstract: `minimise` a problem from some starts. Class attributes of a final class: `name`,
    `source`.
    """

    name: eqx.AbstractClassVar[str]
    source: eqx.AbstractClassVar[str]
    linearises: ClassVar[bool] = False  # works on weighted residuals and their Jacobians

    def nearby(self, tolerance: float = 0.0) -> AbstractFitter:
        """The same for who begins next to a minimum, without what looks for another one; which is
        found to within `tolerance` of the loss where that is more than the fitter's own.
        """
        return self

    @abc.abstractmethod
    def minimise(
        self,
        problem: AbstractProblem,
        starts: Sequence[np.ndarray],
        key: PRNGKeyArray,
        budget: int | None = None,
        progress: Progress | None = None,
        seconds: float | None = None,
    ) -> Minimum:
        """The best z found. `starts` are guesses, best first; `budget` bounds the number of loss
        evaluations, `seconds` the time without compiling. A fitter that knows no limit of time
        leaves the last argument out.
        """

    def minimise_each(
        self,
        jobs: Sequence[tuple[Any, Sequence[np.ndarray], PRNGKeyArray]],
        budget: int | None = None,
        progress: Progress | None = None,
    ) -> list[Minimum]:
        """`minimise` of each (problem, starts, key), with the same results. A fitter that can take
        several side by side does.
        """
        return [
            self.minimise(problem, starts, key, budget, progress) for problem, starts, key in jobs
        ]


class Log:
    """Course of one search: evaluations, best loss so far, and the clock, which stands still while
    programs are compiled.
    """

    def __init__(
        self,
        problem: AbstractProblem,
        name: str,
        budget: int | None = None,
        seconds: float | None = None,
        progress: Progress | None = None,
    ):
        self.problem, self.name, self.budget, self.limit, self.progress = (
            problem,
            name,
            budget,
            seconds,
            progress,
        )
        self.evaluations, self.best = 0, float("inf")
        self.history: list[tuple[int, float]] = []
        self.seconds: list[float] = []
        self._began, self._compiled = time.perf_counter(), problem.compile_time_s

    @property
    def elapsed(self) -> float:
        return time.perf_counter() - self._began - (self.problem.compile_time_s - self._compiled)

    @property
    def left(self) -> float:
        """Evaluations that the budget still allows."""
        return float("inf") if self.budget is None else self.budget - self.evaluations

    @property
    def exhausted(self) -> str:
        """Why the search may not go on, or nothing."""
        if self.left <= 0:
            return "the budget of evaluations is used up"
        return "the time is up" if self.limit is not None and self.elapsed >= self.limit else ""

    @contextmanager
    def shared(self, share: float) -> Iterator[None]:
        """Leaves a part of the search this share of what is left of budget and time, and what comes
        after it the rest.
        """
        whole = self.budget, self.limit
        if self.budget is not None:
            self.budget = self.evaluations + int(share * self.left)
        if self.limit is not None:
            self.limit = self.elapsed + share * (self.limit - self.elapsed)
        try:
            yield
        finally:
            self.budget, self.limit = whole

    def add(self, evaluations: int, loss: float, at: float | None = None) -> None:
        """`loss` is the best of this many more evaluations, finished at `at` seconds (default:
        now).
        """
        self.evaluations += evaluations
        self.best = min(self.best, loss) if np.isfinite(loss) else self.best
        self.history.append((self.evaluations, self.best if np.isfinite(self.best) else PENALTY))
        self.seconds.append(self.elapsed if at is None else at)

    def show(self, done: int, total: int) -> None:
        if self.progress:
            self.progress(
                self.name,
                done,
                total,
                f"loss {self.best:.6g}" if np.isfinite(self.best) else "no finite loss yet",
            )

    def minimum(
        self, z: np.ndarray, converged: bool, stopped: str, stalled: bool = False
    ) -> Minimum:
        """The result; its loss is computed by the one program that all fitters share."""
        loss = self.problem.loss(z)
        if loss >= PENALTY:
            converged = stalled = False
            stopped = (
                "the simulation diverges at every candidate; give other start values or narrower"
                " bounds"
            )
        return Minimum(
            z=z,
            loss=loss,
            converged=converged,
            stopped_because=stopped,
            evaluations=self.evaluations,
            history=self.history,
            seconds=self.seconds,
            stalled=stalled,
        )


def sampling_box(problem: AbstractProblem, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where random starts and first populations are drawn: the bounds, narrowed to a plausible
    neighbourhood of the guess where they span more than two decades (or, for a linear scale, more
    than 20 times the guess or a typical change).
    """
    lower, upper = problem.lower.copy(), problem.upper.copy()
    log = np.zeros(problem.size, bool)
    log[: problem.free.size] = problem.log
    decade = np.log(10.0)
    wide = log & (upper - lower > 2 * decade)
    lower[wide], upper[wide] = (
        np.maximum(lower, guess - decade)[wide],
        np.minimum(upper, guess + decade)[wide],
    )
    size = np.maximum(np.abs(guess), 2 * problem.scale)
    wide = ~log & (upper - lower > 20 * size)
    wide[problem.free.size :] = False
    lower[wide], upper[wide] = (
        np.maximum(lower, guess - 5 * size)[wide],
        np.minimum(upper, guess + 5 * size)[wide],
    )
    return lower, upper
