"""How far fitted numbers would move if the simulator of a robot's file took no steps.

A machine takes none, or those of another simulator. What the steps of the file alone do to a number
is therefore not known of the machine: it counts in the number's uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxid.fitting.covariance import CovarianceEstimate, widened_by
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.problem import FitProblem, rows
from jaxid.problem.residual import Residual
from jaxid.problem.step_error import defects


#: Room for a number that stands at its bound up to rounding.
ROUNDING = 1e-12
#: Halved steps show half of what steps do, where they are of first order.
HALF = 2


def with_steps(
    bench: ProblemBuilder,
    problem: FitProblem,
    residual: Residual,
    z: Float[np.ndarray, " numbers"],
    known: CovarianceEstimate,
) -> CovarianceEstimate:
    """The covariance of z with what the file's steps do to it, by a step of Gauss and Newton
    towards the runs that finer steps extrapolate to. Steps of another kind move each direction that
    the data tell in their own way, so directions count one by one. As it is where free runs are not
    what was fitted.
    """
    from scipy.optimize import lsq_linear  # its import sets filters of warnings

    split = bench.split_of(problem.runs)
    if split is None or not residual.free_run:
        return known
    slope = _slope(problem, z, left_by_steps(bench, problem, residual, split, z))
    assert known.precision is not None
    values, directions = np.linalg.eigh(known.precision * np.outer(problem.scale, problem.scale))
    roots = np.sqrt(np.maximum(values, values[-1] * np.finfo(float).eps))
    moved = lsq_linear(
        roots[:, None] * directions.T / problem.scale,
        -(directions.T @ (slope * problem.scale)) / roots,
        bounds=(problem.lower - z - ROUNDING, problem.upper - z + ROUNDING),
    ).x
    along = problem.scale[:, None] * directions * (directions.T @ (moved / problem.scale))
    return widened_by(known, along @ along.T)


def left_by_steps(
    bench: ProblemBuilder,
    problem: FitProblem,
    residual: Residual,
    split: str,
    z: Float[np.ndarray, " numbers"],
) -> Float[np.ndarray, "samples columns"]:
    """What predictions at z would be more without steps, by those of half the length."""
    finer = replace(bench, finer=HALF, defects={}).runs(residual, split)
    return HALF * defects(problem, z, finer)


def _slope(
    problem: FitProblem,
    z: Float[np.ndarray, " numbers"],
    moved: Float[np.ndarray, "samples columns"],
) -> Float[np.ndarray, " numbers"]:
    """Slope of the loss (half the sum of squares) where predictions are `moved` by so much."""
    slope = np.zeros(problem.size)
    for part in rows([(problem.precise(), z)]):
        at = problem.runs.record(part.record).samples
        slope[part.z_columns] += np.einsum("tc,tck->k", part.w * moved[at], np.nan_to_num(part.J))
    return slope
