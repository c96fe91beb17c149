"""Bounded Levenberg-Marquardt, all starts as one batch.

Minimise |r(z)|^2 / 2 with lower <= z <= upper: solve (H + mu D^2) dz = -g on the variables that are
not held at a bound, with H = J'J, g = J'r, D^2 the largest diag H so far, and mu such that |D dz|
is at most the radius of a trust region (More, The Levenberg-Marquardt Algorithm: Implementation and
Theory, 1978). Sums of norms or of absolute values are the same with H of the reweighted
least-squares problem (Lawson 1961).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from jaxid.fitting.fitter import AbstractFitter, Log, Minimum, Progress
from jaxid.fitting.least_squares import guesses, Path
from jaxid.fitting.many_starts import search
from jaxid.fitting.settings import option
from jaxid.problem.objective import AbstractProblem


class LevenbergMarquardt(AbstractFitter):
    """Bounded Levenberg-Marquardt with multistart.

    `restarts` random starts join the given ones; all run on growing shares of the records (a long
    oscillation has one basin per cycle that is gained or lost; a short look finds the right one),
    the best go on to the end.
    """

    name: ClassVar[str] = "lm"
    source: ClassVar[str] = (
        "Levenberg 1944, Marquardt 1963, More 1978; bounds by an active set; reweighting of Lawson"
        " 1961"
    )
    linearises: ClassVar[bool] = True

    restarts: int = option(4, "random starts beside the given ones", 0)
    iterations: int = option(60, "most steps of the last descent", 1)
    tolerance: float = option(1e-10, "relative gain of the loss below which a descent ends", 0)

    def nearby(self, tolerance: float = 0.0) -> LevenbergMarquardt:
        return replace(self, restarts=0, tolerance=max(self.tolerance, tolerance))

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        log = Log(problem, self.name, budget, seconds, progress)
        return self._search([(problem, starts, key)], [log])[0]

    def minimise_each(self, jobs, budget=None, progress=None):
        """`minimise` of several (problem, starts, key) on the same runs, each with the budget: the
        same bits as one by one, with all linearisations in the same batches.
        """
        return self._search(
            jobs, [Log(problem, self.name, budget, None, progress) for problem, _, _ in jobs]
        )

    def path(
        self,
        problem: AbstractProblem,
        starts: Sequence[np.ndarray],
        key: Any,
        progress: Progress | None = None,
    ) -> tuple[Path, Log]:
        """The best descent itself and its course, for who goes on from there."""
        log = Log(problem, self.name, progress=progress)
        return self._paths([(problem, starts, key)], [log])[0], log

    def _paths(
        self, jobs: Sequence[tuple[AbstractProblem, Sequence[np.ndarray], Any]], logs: Sequence[Log]
    ) -> list[Path]:
        groups = [
            [(problem, z) for z in guesses(problem, starts, self.restarts, key)]
            for problem, starts, key in jobs
        ]
        return search(groups, self.iterations, self.tolerance, logs)[0]

    def _search(
        self, jobs: Sequence[tuple[AbstractProblem, Sequence[np.ndarray], Any]], logs: Sequence[Log]
    ) -> list[Minimum]:
        compiled = jobs[0][0].compile_losses()
        best = self._paths(jobs, logs)
        compiled()
        return [_minimum(p, log) for p, log in zip(best, logs, strict=True)]


def _minimum(path: Path, log: Log) -> Minimum:
    """The end of a path; one without a finite gradient anywhere has not been searched from."""
    if path.gradient is None and path.converged:
        return replace(log.minimum(path.z, False, NO_GRADIENT), loss=np.inf)
    return log.minimum(path.z, path.converged, log.exhausted or path.stopped)


NO_GRADIENT = "no start has a finite gradient; give other start values or narrower bounds"
