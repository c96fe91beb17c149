"""Torque equations that hold no scale: drive and load are made of free numbers alone, so that all
of them at zero fit perfectly.

With drive(u) = gain u and M qdd + friction both made of numbers that are sought, the residual is
homogeneous of degree one in these (Euler): halved numbers halve it, whatever was recorded. A search
then ends at zero, or at the lower bounds on its way there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.problem.problem import FitProblem, rows


#: Euler's relation holds to this share of the residual; of a recording that holds noise it does by
#: no accident.
EXACT = 1e-6


def shrinking(problem: FitProblem, z: np.ndarray) -> tuple[str, ...]:
    """The numbers that shrink the residual in proportion as they shrink together; none where a
    scale is held.
    """
    r, J = _whole(problem, z)
    size = float(np.linalg.norm(r))
    if not np.isfinite(J).all() or not 0 < size < np.inf or not r.size > problem.size:
        return ()
    # What a factor of e does to each number: its share of the search scale.
    along = np.where(problem.log, 1.0, problem.theta(z)[problem.free])
    columns = J[:, : problem.free.size] * along
    length = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    found = np.linalg.lstsq(columns / length, r, rcond=1e-10)[0] / length
    for members in (
        found > 0.5,
        length > 1e-300,
    ):  # numbers that act alike share what least squares finds
        if (
            not np.any(problem.known.R[:, members] != 0)
            and np.linalg.norm(columns[:, members].sum(1) - r) <= EXACT * size
        ):
            return tuple(problem.names[i] for i in np.flatnonzero(members))
    return ()


def refuse_scale_free(problem: FitProblem, z: np.ndarray) -> None:
    """Raises `UsageError` where the torque equation holds no scale."""
    if names := shrinking(problem, z):
        raise UsageError(no_scale(names))


def no_scale(names: Sequence[str]) -> str:
    """What is said of numbers of which the torque equation tells only the ratios."""
    return (
        f"the torque equation tells only the ratios of {', '.join(names)}: halved together they"
        " halve both of its sides, and zero fits best. State one of them under"
        f" [model.constants], as in `{names[0]} = 1.0`, or give it a `prior`"
    )


def _whole(problem: FitProblem, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual [n] and Jacobian [n size] of all records."""
    residual, jacobian = [np.zeros(0)], [np.zeros((0, problem.size))]
    for part in rows([(problem, z)]):
        J = np.zeros((part.r.size, problem.size))
        J[:, part.z_columns] = part.J.reshape(part.r.size, -1)
        residual.append(part.r.ravel())
        jacobian.append(J)
    return np.concatenate(residual), np.concatenate(jacobian)
