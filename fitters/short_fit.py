"""Simulations that only compare: what a model leaves of some data, and how it moves by itself."""

from __future__ import annotations

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Dataset
from jaxid.fitting.problem_builder import default_residual, estimate_starts, ProblemBuilder
from jaxid.fitting.run import fit_binding
from jaxid.fitting.scores import free_runs
from jaxid.problem.binding import bind, Binding

from .lm import LevenbergMarquardt


SHORT = 400  # evaluations


def left_by_short_fit(
    binding: Binding, data: Dataset, effects: tuple[str, ...] = ()
) -> float | None:
    """What a model, with more effects, leaves of a dataset after a short fit, times the noise; None
    without a simulation.
    """
    try:
        own = bind(binding.chain, data, effects=effects)
        residual = default_residual(own)
        if residual.torques:
            return None
        found = fit_binding(
            own, LevenbergMarquardt(restarts=0), residual, "sum_of_squares", 0, SHORT, None
        )
    except UsageError:
        return None
    return float(np.sqrt(found.loss)) if np.isfinite(found.loss) and found.loss < 1e30 else None


def free_motion(binding: Binding) -> list[np.ndarray]:
    """Outputs [time ny] of each run to fit, as the model moves with the numbers that it was given.

    Raises `UsageError` where no free run is made of it.
    """
    bench = ProblemBuilder(binding)
    starts = estimate_starts(bench, "fit", [binding.theta])
    return list(free_runs(bench, "fit", [binding.theta], starts)[0])
