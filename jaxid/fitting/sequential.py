"""Fitting while data arrive: a population is carried from one stretch of the data to the next.

    for step in follow(RecursiveDE(), stretches(problem, window=3), start, key):
        print(step.z)

Data come in pieces: the records of a problem (an experiment each, or a window each under
`multiple_shooting`) in their order. The problem of step k holds the pieces up to k: all of them
(growing), the last `window` (sliding), or all of them weighted by `forgetting` to the power of
their age. Growing data cannot follow a change of the system; the other two can.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import PRNGKeyArray

from jaxid.base.errors import UsageError
from jaxid.fitting.ask_tell import answered
from jaxid.fitting.fitter import Log, Minimum
from jaxid.fitting.population import AbstractPopulation, SearchState
from jaxid.problem.objective import AbstractProblem


def stretches(
    problem: AbstractProblem, first: int = 1, window: int | None = None, forgetting: float = 1.0
) -> Iterator[AbstractProblem]:
    """The problems of a recursion over the pieces of a problem; the first holds `first` of them.

    Raises `UsageError` where a window or factor makes no sense.
    """
    if window is not None and window < 1:
        raise UsageError(
            f"a window of {window} pieces holds nothing; give at least 1, or None for growing data"
        )
    if not 0 < forgetting <= 1:
        raise UsageError(
            f"forgetting is {forgetting}; it is a factor above 0, and at most 1 (nothing is"
            " forgotten)"
        )
    if not 1 <= first <= problem.pieces:
        raise UsageError(f"the first step holds {first} pieces; there are 1 to {problem.pieces}")
    for end in range(first, problem.pieces + 1):
        begin = 0 if window is None else max(0, end - max(window, 1))
        pieces = list(range(begin, end))
        yield problem.part(pieces, [forgetting ** (end - 1 - k) for k in pieces])


def follow(
    fitter: AbstractPopulation,
    problems: Iterable[AbstractProblem],
    starts: Sequence[np.ndarray],
    key: PRNGKeyArray,
    generations: int = 5,
    budget: int | None = None,
) -> Iterator[Minimum]:
    """The best of each problem in turn: a whole search for the first, of at most `budget`
    evaluations, then `generations` from the population at hand.

    The population is evaluated anew on each problem, which counts. Entries of z are carried over by
    name; one that is new (the start of another run) begins at its guess.
    """
    course: SearchState | None = None
    names: list[str] = []
    online = replace(fitter, stall=0)
    for number, problem in enumerate(problems):
        own = jax.random.fold_in(key, number)
        log = Log(problem, fitter.name, None if number else budget)
        if course is None:
            ended = answered(fitter.searching(problem, starts, own, log), problem)
        else:
            points = carried(np.asarray(course.points), names, problem)
            losses = problem.losses(points)
            log.add(len(points), float(losses.min()))
            course = online.course(problem, jax.random.fold_in(own, 1), points, losses)
            ended = answered(
                online.searching(problem, starts, own, log, course, generations), problem
            )
        course, names = ended.course, problem.names
        yield log.minimum(course.best[0], ended.converged, ended.stopped, ended.stalled)


def carried(points: np.ndarray, names: Sequence[str], problem: AbstractProblem) -> np.ndarray:
    """A population of one problem as one of another: entries of the same name, else the middle of
    the bounds.
    """
    middle = (problem.lower + problem.upper) / 2
    moved = np.tile(middle, (len(points), 1))
    for k, name in enumerate(problem.names):
        if name in names:
            moved[:, k] = points[:, names.index(name)]
    return np.clip(moved, problem.lower, problem.upper)
