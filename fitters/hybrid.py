"""Global, then local: a population finds the basins, Levenberg-Marquardt descends from the best of them in one batch."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import jax
import numpy as np

from jaxid.fitter import AbstractFitter, AbstractPopulation, Course, Log
from jaxid.fitters.de import DifferentialEvolution
from jaxid.fitters.lm import descend, problem_clip
from jaxid.objective import AbstractProblem


class Hybrid(AbstractFitter):
    """A population, then bounded Levenberg-Marquardt on its `descents` best distinct points and on the start values, all as one
    batch; recommended where nothing is known of the start. Works on every loss.

    The population takes at most `share` of the budget. If the descents gain on it, the search goes on from their points for
    another of `rounds`.
    """

    name: ClassVar[str] = "hybrid"
    source: ClassVar[str] = "this library; population and descent as their own fitters"

    population: AbstractPopulation = DifferentialEvolution(popsize=40, generations=40)
    descents: int = 6
    iterations: int = 60
    tolerance: float = 1e-10
    share: float = 0.6
    rounds: int = 2

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        log = Log(problem, self.name, budget, seconds, progress)
        course, best, converged, stopped = None, problem_clip(problem, starts[0]), False, ""
        for number in range(self.rounds):
            if number and (log.exhausted or log.left < 2 * self.population.popsize):
                break
            allowed = self.population.generations
            if budget is not None:
                allowed = max(1, min(allowed, int(self.share * log.left / self.population.popsize)))
            explorer = replace(self.population, generations=allowed)
            course, _, stopped = explorer.search(problem, starts, jax.random.fold_in(key, number), log, course)
            found, lowest = course.best
            if log.exhausted:
                return log.minimum(found, False, log.exhausted)
            points = basins(problem, course, self.descents) + [problem_clip(problem, z) for z in starts if number == 0]
            paths = descend([(problem, z) for z in points], self.iterations, self.tolerance, 1.0, log)
            path = min(paths, key=lambda p: p.cost)
            losses = problem.losses(np.array([path.z, found]))
            gained = losses[0] < losses[1]
            best, converged, stopped = (path.z, path.converged, path.stopped) if gained else (found, False, stopped)
            agree = sum(p.cost <= path.cost * (1 + 1e-6) + 1e-300 for p in paths)
            if agree >= min(3, len(paths)):  # descents from different places end in the same one
                break
            points, losses = np.array(course.points), np.array(course.losses)
            worst = np.argsort(-losses)[: len(paths)]
            points[worst] = [p.z for p in paths[: len(worst)]]
            losses[worst] = problem.losses(points[worst])
            course = self.population.course(problem, jax.random.fold_in(key, 1000 + number), points, losses)
        return log.minimum(best, converged, log.exhausted or stopped)


def basins(problem: AbstractProblem, course: Course, count: int) -> list[np.ndarray]:
    """The best points of a course, none within a twentieth of its extent of a better one in every direction."""
    points, losses = np.asarray(course.points), np.asarray(course.losses)
    extent = np.maximum(np.ptp(points, axis=0), 1e-12 * (problem.upper - problem.lower))
    kept: list[np.ndarray] = []
    for i in np.argsort(losses, kind="stable"):
        if all(np.max(np.abs(points[i] - k) / extent) > 0.05 for k in kept):
            kept.append(points[i])
        if len(kept) == count:
            break
    return kept
