"""What the fit data leave open stays where the user put it.

A descent drags along what its data do not determine: two factors whose product alone is seen end
anywhere on a curve, often where a poorer model has left them. Held-out runs that do tell them apart
would then refuse a right model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.least_squares import levenberg_marquardt, Path
from jaxid.problem.problem import FitProblem


#: This many numbers are put back at most, of those that are further away than this (in typical
#: changes).
TRIED, SHORT = 3, 0.1


def put_back(
    path: Path,
    theta: np.ndarray,
    index: Sequence[int],
    problem: Callable[[list[int], np.ndarray], FitProblem],
) -> Path:
    """The path with numbers at `index` put back to those of `theta` one after the other, the least
    certain first, where the rest, refitted, follows the data as well without; `problem(free,
    theta)` is the same with other numbers free (of coarser steps, perhaps: what it finds is looked
    at again with the path's own).

    What a model leaves open may have gone as far as the data let it, to where it looks determined
    (a drive that no longer reaches its limit): no step along an open direction leads back from
    there.
    """
    p = path.problem
    if path.hessian is None or not np.isfinite(path.cost):
        return path
    n = p.free.size
    home = p.theta(path.z).copy()
    home[list(index)] = theta[list(index)]
    away = np.abs(p.z(home)[:n] - path.z[:n])
    variance = np.diag(np.linalg.pinv(path.hessian, rcond=1e-14, hermitian=True))[:n]
    price = away**2 / np.maximum(variance, 1e-300)  # of each way as far as it can be seen from here
    free, now, starts = [int(i) for i in p.free], p.theta(path.z), p.starts(path.z)
    rest = [int(p.free[k]) for k in np.argsort(price) if away[k] > SHORT * p.scale[k]][:TRIED]
    as_it_is = problem(free, now)
    most = (
        levenberg_marquardt([(as_it_is, as_it_is.z(now, starts))], 0, 1e-6)[0].cost
        + LIMITS.pull_cost
        if rest
        else 0.0
    )
    moved = False
    # All that are left at once: the first that may go back goes, and those behind it are tried
    # without it.
    while rest:
        jobs = []
        for i in rest:
            tried = now.copy()
            tried[i] = theta[i]
            less = problem([f for f in free if f != i], tried)
            jobs.append((less, less.z(tried, starts)))
        ends = levenberg_marquardt(jobs, 12, 1e-6)
        k = next((k for k, end in enumerate(ends) if end.cost <= most), None)
        if k is None:
            break
        less, end = jobs[k][0], ends[k]
        free, now, starts, moved = (
            [f for f in free if f != rest[k]],
            less.theta(end.z),
            less.starts(end.z),
            True,
        )
        rest = rest[k + 1 :]
    if not moved:
        return path
    end = levenberg_marquardt([(p, p.z(now, starts))], 1, 1e-6)[0]
    return end if end.cost <= path.cost + LIMITS.pull_cost else path


def moved_to(path: Path, theta: np.ndarray) -> Path:
    """The path with all its free numbers as in `theta`, if its data are followed as well there but
    for what noise may do.
    """
    p = path.problem
    lower, upper, scale = p.whole
    still = FitProblem(
        runs=p.runs,
        base=theta,
        free=[],
        lower=lower,
        upper=upper,
        records=p.records,
        loss=p.loss_name,
        scale=scale,
        differences=p.differences,
    ).with_targets(p.targets)
    starts = still.starts(
        levenberg_marquardt([(still, still.z(theta, p.starts(path.z)))], 8, 1e-6)[0].z
    )
    end = levenberg_marquardt([(p, p.z(theta, starts))], 0, 1e-6)[0]
    return end if end.cost <= path.cost + LIMITS.pull_cost + p.free.size else path
