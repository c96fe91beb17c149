"""What a residual simulates itself, where that is not the free run: windows, or the loop that was
closed when it was recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import Residual


if TYPE_CHECKING:
    from jaxid.data.dataset import Experiment
    from jaxid.fitting.problem_builder import ProblemBuilder
    from jaxid.fitting.result import Score


def own_simulation(
    bench: ProblemBuilder, residual: Residual, split: str, problem: FitProblem, z: np.ndarray
) -> tuple[FitProblem, np.ndarray]:
    """A split as the residual simulates it, at the numbers of `problem` at z, and its own z; starts
    that nobody states are fitted to each window, or to the first tenth of each run.
    """
    if split == "fit":
        return problem, z
    own = bench.problem(residual, split, [], problem.theta(z))
    at = own.z(own.base)
    if own.size:
        share = 1.0 if residual.windows else 0.1
        path = levenberg_marquardt([(own, at)], 8, 1e-8, share)[0]
        at = path.z if np.isfinite(path.cost) else at
    return own, at


def by_run(
    problem: FitProblem, z: np.ndarray, experiments: Sequence[Experiment]
) -> list[np.ndarray] | None:
    """What a problem simulates of each of the runs [samples outputs], windows one after the other;
    None where it does not cover them sample by sample.
    """
    out: list[list[np.ndarray]] = [[] for _ in experiments]
    for number, prediction in zip(problem.records, problem.predictions(z), strict=True):
        at = problem.runs.record(number).experiment
        if at >= len(out):
            return None
        out[at].append(prediction)
    whole = []
    for own, e in zip(out, experiments, strict=True):
        if sum(map(len, own)) != len(e.t):
            return None
        whole.append(np.concatenate(own))
    return whole


def simulated_scores(problem: FitProblem, z: np.ndarray) -> dict[str, Score]:
    """Scores of what a problem simulates, by channel."""
    from jaxid.fitting.scores import score

    predictions = np.concatenate(problem.predictions(z))
    at = np.concatenate([problem.runs.record(r).samples for r in problem.records])
    y = problem.runs.targets[at]
    return {
        name: score(y[:, c], predictions[:, c] - y[:, c], unit)
        for c, (name, unit) in enumerate(problem.runs.channels)
    }
