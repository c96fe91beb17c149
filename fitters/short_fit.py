"""A short fit that only compares: what a model leaves of some data."""

from __future__ import annotations

import numpy as np

from jaxid.data.dataset import Dataset
from jaxid.errors import UsageError
from jaxid.fitting.problem_builder import default_residual
from jaxid.fitting.run import fit_binding
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
