"""How far runs that touch are known at all.

A touch that comes one step of the simulator later moves all that follows. Where a change that the
data cannot tell brings that about, the run is not known better than by so much.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.diagnosis.hypothesis import Hypothesis
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.fitting.secant import simulated
from jaxid.fitting.wide_slopes import principal_directions
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import OutputError


def left_open(bench: ProblemBuilder, h: Hypothesis) -> dict[str, float]:
    """Mean square over the noise by which the fit and validation runs move where the numbers and
    the starts of a fit move by what is within its noise.
    """
    p, z = h.path.problem, h.path.z
    points = [z, *_within_noise(h)]
    thetas, starts = [p.theta(x) for x in points], [p.starts(x) for x in points]
    out = {"fit": _apart(p, thetas, starts)}
    if bench.binding.experiments("validation"):
        out["validation"] = left_open_in(bench, h, "validation")
    return out


def left_open_in(bench: ProblemBuilder, h: Hypothesis, split: str) -> float:
    """The same of the runs of a split that are not fitted, where the numbers move."""
    p, z = h.path.problem, h.path.z
    points = [z, *_within_noise(h)]
    (starts,) = estimate_starts(bench, split, [h.theta])
    held = bench.problem(OutputError(), split, [], h.theta)
    return _apart(held, [p.theta(point) for point in points], [starts] * len(points))


def _within_noise(h: Hypothesis) -> list[np.ndarray]:
    """Where a fit may as well have ended, along principal directions to both sides."""
    p, z = h.path.problem, h.path.z
    if h.path.hessian is None or not p.size:
        return []
    directions = principal_directions(p, h.path.hessian)
    aside = np.concatenate([directions.T, -directions.T])
    return [np.clip(z + step, p.lower, p.upper) for step in aside]


def _apart(
    problem: FitProblem, thetas: Sequence[np.ndarray], starts: Sequence[np.ndarray]
) -> float:
    """Mean square by which runs of models are away from those of the first."""
    first, *others = simulated(problem, thetas, starts)
    with np.errstate(all="ignore"):
        apart = np.array([np.mean((r - first) ** 2) for r in others])
    ended = apart[np.isfinite(apart)]
    return float(np.mean(ended)) if ended.size else 0.0
