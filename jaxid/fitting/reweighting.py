"""Several channels of very different resolution: weighed by what the model leaves of each, not by
its sensor's noise.

An encoder's step is not the model's error. Where a model error far above all noises exists, the
fine channel would pin every number and the coarse one say nothing. With a standard deviation of its
own for each channel, never below its noise, the likelihood is greatest where sum of n_c log s_c is
least, s_c the root mean square that the model leaves; least squares with the weights 1 / s_c of the
last round, again and again, goes there (iteratively reweighted; Seber and Wild, Nonlinear
Regression, 1989, ch. 11).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxid.fitting.fitter import AbstractFitter, Minimum, Progress
from jaxid.problem.problem import FitProblem


#: A descent to the end is begun with at least this many linearisations.
LEAST = 4
#: Channels whose errors, in their own noise, differ by less than this weigh alike; torques, of
#: whose noise that of the motion is no part, where their errors are that small.
UNEVEN = 3.0
#: Rounds at most; they end where no channel's weight moves by more than this share. The loss of a
#: round is found to within ROUGH of it, which moves no weight by as much: only the last weights are
#: worth a minimum.
ROUNDS, SETTLED, ROUGH = 6, 0.03, 1e-4


class Reweighed(NamedTuple):
    """A problem whose channels are weighed by what the model leaves, its minimum, and a
    sentence.
    """

    problem: FitProblem
    found: Minimum
    note: str


def reweighed(
    problem: FitProblem,
    found: Minimum,
    starts: Sequence[np.ndarray],
    key,
    fitter: AbstractFitter,
    budget: int | None = None,
    progress: Progress | None = None,
) -> Reweighed | None:
    """The fit with channels weighed by what it leaves of them; None where they weigh alike by their
    noise already, or where that ends no better. `starts` are guesses beside the end of the first
    fit. Evaluations count in the budget.
    """
    noise = problem.runs.noise
    if found.failed or noise.size < 2 or problem.loss_name != "sum_of_squares":
        return None
    first, counts = _errors(problem, found.z)
    if first.max() < UNEVEN * (first.min() if problem.runs.setting is None else 1.0):
        return None
    spent = found.evaluations

    def left() -> int | None:
        return None if budget is None else budget - spent

    def covers(evaluations: float) -> bool:
        return budget is None or budget - spent >= evaluations

    # at first all channels by the size of their signals
    level = np.maximum(1.0, _sizes(problem))
    begin, end = [found.z, *starts], found
    for number in range(ROUNDS):
        if not covers(2 * (1 + problem.size)):
            return None
        weighed = weighed_by(problem, 1 / level)
        end = fitter.nearby(ROUGH).minimise_each([(weighed, begin, key)], left(), progress)[0]
        spent += end.evaluations
        if end.failed:
            return None
        old, (level, _) = level, _errors(problem, end.z)
        begin = [end.z]
        if number and np.all(np.abs(np.log(level / old)) < SETTLED):
            break
    if counts @ np.log(level) >= counts @ np.log(first):
        return None
    weighed = weighed_by(problem, 1 / level)
    if covers(LEAST * (1 + problem.size)):
        last = fitter.nearby().minimise_each([(weighed, begin, key)], left(), progress)[0]
        spent += last.evaluations
        end = end if last.failed else last
    found = replace(end, loss=weighed.loss(end.z), evaluations=spent)
    return Reweighed(weighed, found, _note(problem, level))


def _note(problem: FitProblem, level: np.ndarray) -> str:
    channels = zip(problem.runs.channels, level, strict=True)
    named = ", ".join(f"{name} {x:.3g}" for (name, _), x in channels)
    return f"channels are weighed by what the model leaves of them, in times their noise: {named}"


def weighed_by(problem: FitProblem, factors: np.ndarray) -> FitProblem:
    """The same problem with every residual column [columns] multiplied by a factor; its loss counts
    samples by it.
    """
    twin = problem.part(range(problem.pieces), [1.0] * problem.pieces)
    twin.weights = problem.runs.weights * factors
    return twin


def _errors(problem: FitProblem, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square of each channel's residual in its noise, at least 1, and its number of
    samples.
    """
    r = np.concatenate(problem.residuals(z))
    w = (
        np.concatenate([problem.weights[problem.runs.record(k).samples] for k in problem.records])
        > 0
    )
    counts = np.maximum(1, w.sum(0))
    return np.maximum(1.0, np.sqrt(np.sum(np.where(w, r, 0.0) ** 2, 0) / counts)), counts.astype(
        float
    )


def _sizes(problem: FitProblem) -> np.ndarray:
    """Standard deviation of each measured channel in its noise."""
    at = np.concatenate([np.asarray(problem.runs.record(k).samples) for k in problem.records])
    y, w = problem.targets[at], problem.weights[at]
    sizes = np.ones(y.shape[1])
    for c in range(y.shape[1]):
        seen = w[:, c] > 0
        if seen.any():
            sizes[c] = np.std((y[:, c] * w[:, c])[seen])
    return sizes
