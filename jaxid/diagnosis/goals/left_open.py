"""How far runs that touch are known at all.

A touch that comes one step of the simulator later moves all that follows. Where a change that the
data cannot tell brings that about, the run is not known better than by so much.
"""

from __future__ import annotations

import numpy as np

from jaxid.diagnosis.hypothesis import Hypothesis
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.fitting.secant import simulated
from jaxid.fitting.wide_slopes import principal_directions
from jaxid.problem.residual import OutputError


def left_open(bench: ProblemBuilder, h: Hypothesis) -> dict[str, float]:
    """Mean square over the noise by which the runs of each split move where the numbers and the
    starts of a fit move by what is within its noise.
    """
    p, z = h.path.problem, h.path.z
    if h.path.hessian is None or not p.size:
        return {}
    directions = principal_directions(p, h.path.hessian)
    aside = np.concatenate([directions.T, -directions.T])
    near = [np.clip(z + step, p.lower, p.upper) for step in aside]
    thetas = [p.theta(point) for point in near]
    moved = {"fit": (p, thetas, [p.starts(point) for point in near], p.starts(z))}
    if bench.binding.experiments("validation"):
        starts = estimate_starts(bench, "validation", [h.theta])[0]
        held = bench.problem(OutputError(), "validation", [], h.theta)
        moved["validation"] = held, thetas, [starts] * len(near), starts
    out = {}
    for split, (problem, numbers, begun, start) in moved.items():
        every = simulated(problem, [h.theta, *numbers], [start, *begun])
        apart = np.array([np.mean((r - every[0]) ** 2) for r in every[1:]])
        ended = apart[np.isfinite(apart)]
        out[split] = float(np.mean(ended)) if ended.size else 0.0
    return out
