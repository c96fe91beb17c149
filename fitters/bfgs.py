"""Quasi-Newton for losses that are no sum of squares: bounded BFGS in a trust region, all starts as
one batch.

Gradients come from forward tangents through the simulation and the chain rule from the residual to
the loss. The first matrix is the curvature of the reweighted least-squares problem at the start,
which gives every parameter its scale.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from jaxid.fitting.fitter import AbstractFitter, Log
from jaxid.fitting.least_squares import guesses, levenberg_marquardt, Path
from jaxid.fitting.settings import option
from jaxid.problem.gauss_newton import gauss_newton_model
from jaxid.problem.objective import Linear


class BFGS(AbstractFitter):
    """Bounded BFGS with multistart, for every loss: sum of squares, of norms, of absolute
    values.
    """

    name: ClassVar[str] = "bfgs"
    source: ClassVar[str] = (
        "Nocedal and Wright, Numerical Optimization, 2006, chapters 4 and 6; damping by Powell 1978"
    )

    restarts: int = option(4, "random starts beside the given ones", 0)
    iterations: int = option(150, "most steps of a descent", 1)
    tolerance: float = option(1e-9, "relative gain of the loss below which a descent ends", 0)

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        log = Log(problem, self.name, budget, seconds, progress)
        jobs = [(problem, z) for z in guesses(problem, starts, self.restarts, key)]
        paths = levenberg_marquardt(
            jobs, self.iterations, self.tolerance, 1.0, log, gauss_newton_model, updated
        )
        best = min(paths, key=lambda p: p.cost)
        return log.minimum(best.z, best.converged, log.exhausted or best.stopped)


def updated(path: Path, trial: np.ndarray, new: Linear) -> np.ndarray:
    """BFGS update of the path's matrix by the step to `trial`, damped so that it stays positive
    definite.
    """
    assert path.hessian is not None and path.gradient is not None
    B, step, bend = path.hessian, trial - path.z, new.gradient - path.gradient
    along = B @ step
    size = float(step @ along)
    if size <= 0:
        return B
    gain = float(step @ bend)
    if gain < 0.2 * size:
        share = 0.8 * size / (size - gain)
        bend = share * bend + (1 - share) * along
        gain = 0.2 * size
    return B - np.outer(along, along) / size + np.outer(bend, bend) / gain
