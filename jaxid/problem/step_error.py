"""What the length of the step does to a simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import Runs


#: Halving the step must not move the simulation by more than this share of what separates it from
#: the data, or by more than this share of the noise.
STEP_SHARE = 0.02


def finer_predictions(problem: FitProblem, z: np.ndarray, finer: Runs) -> list[np.ndarray]:
    """Predictions at z by runs with finer steps: per record of the problem [samples columns]."""
    lanes = np.array(problem.records)
    fine = finer.engine.outputs(
        np.tile(problem.theta(z), (lanes.size, 1)), problem.starts(z), lanes
    )
    return [finer.sample_prediction(r, row) for r, row in zip(lanes, fine, strict=True)]


def defects(problem: FitProblem, z: np.ndarray, finer: Runs) -> np.ndarray:
    """What finer steps would add to the simulation at z, at the samples [samples columns]; 0 for
    what is no number.
    """
    out = np.zeros_like(problem.targets)
    both = zip(
        problem.records, finer_predictions(problem, z, finer), problem.predictions(z), strict=True
    )
    for number, halved, coarse in both:
        out[problem.runs.record(number).samples] = halved - coarse
    return np.nan_to_num(out)


def _counted(runs: Runs, records: Sequence[int], values: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Of values [samples columns] of each record those that have weight: one array a column."""
    weighs = np.concatenate([runs.weights[runs.record(r).samples] > 0 for r in records])
    together = np.concatenate(list(values))
    return [together[weighs[:, c], c] for c in range(together.shape[1])]


def step_error(problem: FitProblem, z: np.ndarray, finer: Runs) -> float:
    """How much the simulation at z moves with finer steps, over the larger of noise and gap (rms,
    worst column).
    """
    records = problem.records
    # Column by column: lines of a response and samples in time share a record, and other rows of it
    # where the step is finer.
    coarse = _counted(problem.runs, records, problem.predictions(z))
    halved = _counted(finer, records, finer_predictions(problem, z, finer))
    target = _counted(
        problem.runs, records, [problem.targets[problem.runs.record(r).samples] for r in records]
    )
    worst = 0.0
    for c, h, y, noise in zip(coarse, halved, target, problem.runs.noise, strict=True):
        if c.size:
            worst = max(
                worst,
                float(np.sqrt(np.mean((h - c) ** 2)) / max(np.sqrt(np.mean((c - y) ** 2)), noise)),
            )
    return worst if np.isfinite(worst) else 0.0
