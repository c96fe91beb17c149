"""The motion of a model under the controller of the recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.data.dataset import Dataset, Experiment
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.problem.closed_loop import ClosedLoopOutputError
from jaxid.problem.problem import FitProblem


def simulate_closed_loop(
    dataset: Dataset,
    experiments: Sequence[Experiment],
    layout: ParameterVector,
    theta: np.ndarray,
    noise: np.ndarray,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Positions [time nq] and inputs [time nq] of the model with numbers `theta` under the
    dataset's controller, per run.

    `noise` [ny]. Starts that nobody states are fitted to the first tenth of each run.
    """
    runs = ClosedLoopOutputError("both").runs(dataset, experiments, layout, noise, None)
    problem = FitProblem(runs, theta, [], theta, theta)
    z = problem.z(theta)
    if problem.size:
        z = levenberg_marquardt([(problem, z)], 8, 1e-6, 0.1)[0].z
    n = layout.chain.nq
    return [(both[:, :n], both[:, n:]) for both in problem.predictions(z)]
