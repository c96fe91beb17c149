"""Global, then local: a population finds the basins, Levenberg-Marquardt descends from the best of
them in one batch.
"""

from __future__ import annotations

from typing import ClassVar

import jax
import numpy as np

from jaxid.fitters.shade import Shade
from jaxid.fitting.ask_tell import answered
from jaxid.fitting.fitter import AbstractFitter, Log
from jaxid.fitting.least_squares import problem_clip
from jaxid.fitting.many_starts import search
from jaxid.fitting.population import AbstractPopulation, same, SearchState
from jaxid.fitting.settings import option
from jaxid.problem.objective import AbstractProblem


class Hybrid(AbstractFitter):
    """A population, then bounded Levenberg-Marquardt on its `descents` best distinct points and on
    the start values, all as one batch; recommended where nothing is known of the start. Works on
    every loss.

    The population takes at most `share` of what is left of budget and time; the rest is for the
    descents. Every round starts anew, until one ends in the lowest minimum so far once more, or
    after `rounds`.
    """

    name: ClassVar[str] = "hybrid"
    source: ClassVar[str] = "this library; population and descent as their own fitters"

    population: AbstractPopulation = option(
        Shade(popsize=32, generations=40), "the population, as a text like 'de(popsize=20)'"
    )
    descents: int = option(6, "best points of the population from which descents begin", 1)
    iterations: int = option(60, "most steps of a descent", 1)
    tolerance: float = option(1e-10, "relative gain of the loss below which a descent ends", 0)
    share: float = option(
        0.6, "most of what is left of the budget that the population takes in a round", 0, 1
    )
    rounds: int = option(8, "most rounds, each with a new population", 1)

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        log = Log(problem, self.name, budget, seconds, progress)
        given = [problem_clip(problem, z) for z in starts]
        best, lowest, converged, stopped, stalled = given[0], np.inf, False, "", False
        for number in range(self.rounds):
            if number and log.left < 2 * self.population.popsize:
                break
            with log.shared(self.share):
                course, _, why, stuck = answered(
                    self.population.searching(problem, given, jax.random.fold_in(key, number), log),
                    problem,
                )
            ends = [(course.best[0], False, why, stuck)]
            if not log.exhausted:
                points = basins(problem, course, self.descents) + given
                (path,), _ = search(
                    [[(problem, z) for z in points]], self.iterations, self.tolerance, [log]
                )
                ends.append((path.z, path.converged, path.stopped, False))
            losses = problem.losses(np.array([z for z, *_ in ends]))
            k = int(np.argmin(losses))
            again = number > 0 and same(float(losses[k]), lowest)
            if losses[k] < lowest:
                lowest, (best, converged, stopped, stalled) = float(losses[k]), ends[k]
            if again or log.exhausted:
                break
        return log.minimum(best, converged, log.exhausted or stopped, stalled and not log.exhausted)


def basins(problem: AbstractProblem, course: SearchState, count: int) -> list[np.ndarray]:
    """The best points of a course, none within a twentieth of its extent of a better one in every
    direction.
    """
    points, losses = np.asarray(course.points), np.asarray(course.losses)
    extent = np.maximum(np.ptp(points, axis=0), 1e-12 * (problem.upper - problem.lower))
    kept: list[np.ndarray] = []
    for i in np.argsort(losses, kind="stable"):
        if all(np.max(np.abs(points[i] - k) / extent) > 0.05 for k in kept):
            kept.append(points[i])
        if len(kept) == count:
            break
    return kept
