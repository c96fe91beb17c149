"""What a residual simulates itself, where that is not the free run: windows, or the loop that was closed when it was recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jaxid.fitting.least_squares import descend
from jaxid.problem.problem import Problem
from jaxid.problem.residual import MultipleShooting, Residual


if TYPE_CHECKING:
    from jaxid.fitting.problem_builder import Bench
    from jaxid.fitting.result import Score


#: What each residual simulates, where that is not the free run.
SIMULATIONS = {
    "multiple_shooting": "windows",
    "closed_loop": "closed_loop",
    "inverse_dynamics": "inverse_dynamics",
    "frequency_response": "frequency_response",
    "momentum": "momentum",
}


def own_simulation(bench: Bench, residual: Residual, split: str, problem: Problem, z: np.ndarray) -> tuple[Problem, np.ndarray]:
    """A split as the residual simulates it, at the numbers of `problem` at z, and its own z; starts that nobody states are fitted
    to each window, or to the first tenth of each run."""
    if split == "fit":
        return problem, z
    own = bench.problem(residual, split, [], problem.theta(z))
    at = own.z(own.base)
    if own.size:
        share = 1.0 if isinstance(residual, MultipleShooting) else 0.1
        path = descend([(own, at)], 8, 1e-8, share)[0]
        at = path.z if np.isfinite(path.cost) else at
    return own, at


def simulated_scores(problem: Problem, z: np.ndarray) -> dict[str, Score]:
    """Scores of what a problem simulates, by channel."""
    from jaxid.fitting.scores import score

    predictions = np.concatenate(problem.predictions(z))
    at = np.concatenate([problem.runs.record(r).samples for r in problem.records])
    y = problem.runs.targets[at]
    return {name: score(y[:, c], predictions[:, c] - y[:, c], unit) for c, (name, unit) in enumerate(problem.runs.channels)}
