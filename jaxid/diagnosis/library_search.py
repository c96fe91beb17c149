"""The nominal fit by simulation, and from it the search over all of the library."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxid.diagnosis.hypothesis import candidates, SearchResult
from jaxid.diagnosis.question import SearchRequest
from jaxid.diagnosis.refits import Refits
from jaxid.diagnosis.search import Searcher
from jaxid.diagnosis.verdict import check_followed, Diverged
from jaxid.fitters import LevenbergMarquardt
from jaxid.fitting.assemble import assemble
from jaxid.fitting.fitter import Log, Minimum
from jaxid.fitting.least_squares import levenberg_marquardt, Path
from jaxid.fitting.lost_runs import AN_ARM, by_torque, DIVERGES
from jaxid.fitting.problem_builder import ProblemBuilder, start_values
from jaxid.fitting.result import Fit
from jaxid.problem.problem import FitProblem


NO_FIT = (
    "the nominal model cannot be fitted: the simulation diverges at every candidate; give other"
    " start values or bounds"
)

#: Makes of a bench, the nominal fit and what was searched so far what is known by now.
Tell = Callable[[ProblemBuilder, Fit, SearchResult], Any]


def search_library(
    request: SearchRequest, tell: Tell
) -> tuple[ProblemBuilder, Fit, SearchResult, float]:
    """The bench whose steps no longer matter, the nominal fit, what was found, and the seconds that
    compiling took. Raises `Diverged` where the nominal model cannot be fitted.
    """
    began = time.perf_counter()
    # Hundreds of models are simulated a few times each: tangents would compile longer.
    bench = ProblemBuilder(request.binding, differences=1)
    nominal = _NominalFit(request, bench, began)
    fits = Refits(bench, request.residual, nominal.path)
    searcher = Searcher(fits, request.question.progress)

    def offer(search: SearchResult) -> None:
        request.question.known.offer(lambda: tell(bench, nominal.fit(), search))

    offer(SearchResult(fits.nominal, fits.nominal))
    if "validation" in request.still:  # nothing to choose by
        search = searcher.run([], 0, offer)
    else:
        pool = candidates(bench, request.allowed)
        search = searcher.run(pool, request.question.max_effects, offer)
    compile_time = sum(b.compile_time() for b in fits.benches)
    fit = nominal.fit(fits.bench, search.nominal.path, compile_time)
    return fits.bench, fit, search, compile_time


class _NominalFit:
    """The model without effects, fitted from several starts."""

    def __init__(self, request: SearchRequest, bench: ProblemBuilder, began: float):
        self.request, self.bench, self.began = request, bench, began
        self.fitter = LevenbergMarquardt()
        self.problem, found, self.log = self._from_all_starts()
        self._check(found)
        self.converged, self.stopped_because = found.converged, found.stopped
        (self.path,) = levenberg_marquardt([(self.problem, found.z)], 3, 1e-9)

    def _from_all_starts(self) -> tuple[FitProblem, Path, Log]:
        binding, residual = self.request.binding, self.request.residual
        question = self.request.question
        engine = self.bench.runs(residual, "fit").engine
        engine.compile_ahead("outputs", binding.theta, binding.free)
        guesses = start_values(self.bench, binding.free, question.seed)
        engine.read_ahead()  # while the nominal model is fitted
        problem = self.bench.problem(residual, "fit", binding.free, guesses[0])
        starts = [problem.z(guess) for guess in guesses]
        key = jax.random.key(question.seed)
        path, log = self.fitter.path(problem, starts, key, question.progress)
        return problem, path, log

    def _check(self, found: Path) -> None:
        """Raises `Diverged` where nothing can be learned beside this fit."""
        binding = self.request.binding
        if not np.isfinite(found.cost):
            raise Diverged(NO_FIT, by_torque(binding), DIVERGES)
        an_arm = by_torque(binding) and binding.chain.nq >= AN_ARM
        if self.request.residual.free_run and not found.converged and an_arm:
            theta, starts = self.problem.theta(found.z), self.problem.starts(found.z)
            check_followed(self.bench, theta, starts)

    def fit(
        self,
        bench: ProblemBuilder | None = None,
        path: Path | None = None,
        compile_time: float = 0.0,
    ) -> Fit:
        """As a fit; or with what the search made of it, on its bench."""
        path = self.path if path is None else path
        minimum = Minimum(
            z=path.z,
            loss=path.loss,
            converged=self.converged,
            stopped_because=self.stopped_because,
            evaluations=self.log.evaluations,
            history=self.log.history,
        )
        return assemble(
            bench=self.bench if bench is None else bench,
            problem=path.problem,
            result=minimum,
            residual=self.request.residual,
            fitter=self.fitter.name,
            seed=self.request.question.seed,
            compile_time=compile_time,
            wall_time=time.perf_counter() - self.began,
        )
