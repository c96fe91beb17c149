"""`jaxid.make_problem`: what `jaxid.fit` would minimise, as pure functions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.data.dataset import Dataset
from jaxid.dynamics.effect import Effect
from jaxid.fitting.problem_builder import default_residual, ProblemBuilder, start_values
from jaxid.problem.binding import bind
from jaxid.problem.objective import LOSSES
from jaxid.problem.pure_problem import Problem, pure
from jaxid.problem.residual import Residual, resolve_residual
from jaxid.problem.solver import with_solver


def make_problem(
    model: object,
    dataset: Dataset,
    *,
    residual: Residual | str | None = None,
    effects: Iterable[str | Effect | type[Effect]] = (),
    without: Iterable[str] = (),
    split: str = "fit",
    loss: str = "sum_of_squares",
    solver: Any = None,
) -> Problem:
    """The problem that `jaxid.fit` would solve, as pure functions for any optimiser or sampler.

    `split` says which runs it looks at, `solver` (a solver of diffrax, or `Diffrax`) simulates in
    place of jaxid's own stepping. Raises `UsageError` for arguments that do not fit.
    """

    if loss not in LOSSES:
        raise UsageError(f"there is no loss {loss!r}{nearest(loss, LOSSES)}")
    if split not in ("fit", "validation", "report"):
        raise UsageError(
            f"there is no split {split!r}{nearest(split, ('fit', 'validation', 'report'))}"
        )
    binding = bind(model, dataset, effects=effects, without=without)
    chosen = resolve_residual(residual) or default_residual(binding)
    bench = ProblemBuilder(with_solver(binding, solver, chosen))
    if not chosen.select(binding.dataset, split):
        raise UsageError(f"the dataset has no run in the split {split!r}")
    theta = start_values(ProblemBuilder(binding), binding.free, 0)[0]
    problem = bench.problem(chosen, split, binding.free, theta, loss=loss)
    priors = [binding.priors.get(int(i), (np.nan, np.nan)) for i in problem.free]
    return pure(problem, problem.z(theta), np.array(priors, float).reshape(-1, 2))
