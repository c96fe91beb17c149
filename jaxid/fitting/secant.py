"""Levenberg and Marquardt on secants: a few simulations a step, where slopes by all numbers are
many.

Slopes that are known at the start, of the same numbers in another model, are corrected by what
every trial shows (Broyden 1965, in the metric of the columns; Madsen, Nielsen and Tingleff 2004,
section 3.5). What one block of lanes has room for beside the trials takes the oldest slopes anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxid.fitting.least_squares import accept, next_trial, Path, problem_clip
from jaxid.problem.objective import Linear
from jaxid.problem.problem import FitProblem, rows
from jaxid.simulation.batch import LANES


#: Shares of the radius that are tried side by side.
TRIED = (1.0, 0.25, 0.0625)
#: Points that are simulated side by side, at least.
LEAST = 12
#: An age that slopes have which nobody has taken.
NEVER = 10**6


@dataclass(frozen=True, eq=False)
class Slopes:
    """Residuals over the noise at z [samples], their slopes [samples size], and how many steps ago
    each of these was taken. `own`: of this model; those of another one are a guess.
    """

    names: list[str]
    z: np.ndarray
    r: np.ndarray
    J: np.ndarray
    age: np.ndarray
    own: bool = True

    @classmethod
    def taken(cls, p: FitProblem, z: np.ndarray) -> Slopes:
        """All of them anew."""
        residual, slope = [], []
        for part in rows([(p, z)]):
            own = np.zeros((part.r.size, p.size))
            own[:, part.z_columns] = part.J.reshape(part.r.size, -1)
            residual.append(part.r.ravel())
            slope.append(own)
        return cls(
            p.names, z, np.concatenate(residual), np.concatenate(slope), np.zeros(p.size, int)
        )

    def of(self, p: FitProblem, z: np.ndarray, r: np.ndarray) -> Slopes:
        """The same of a problem on the same records at z, where its residuals are r; those of
        numbers that are not here are to be taken.
        """
        own = {name: k for k, name in enumerate(self.names)}
        here = [k for k, name in enumerate(p.names) if name in own]
        there = [own[p.names[k]] for k in here]
        J, age = np.zeros((len(r), p.size)), np.full(p.size, NEVER)
        J[:, here], age[here] = self.J[:, there], self.age[there] + 1
        return Slopes(p.names, z, r, J, age, own=self.own and self.names == p.names)

    def renewed(self, columns: Sequence[int], ahead: Sequence[np.ndarray], h: np.ndarray) -> Slopes:
        """With the slopes of some numbers by the residuals of steps `h` [size] ahead; where one
        diverges they stay.
        """
        J, age = self.J.copy(), self.age.copy()
        age[list(columns)] = 0
        for c, r in zip(columns, ahead, strict=True):
            if np.isfinite(r).all():
                J[:, c] = (r - self.r) / h[c]
        return replace(self, J=J, age=age)

    def told(self, z: np.ndarray, r: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """Slopes that also have residuals r at z; `scale` [size] is the metric."""
        dz = z - self.z
        far = float((scale**2 * dz) @ dz)
        if not far > 0:
            return self.J
        return self.J + np.outer(r - self.r - self.J @ dz, scale**2 * dz / far)


def residuals(p: FitProblem, points: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Residuals over the noise [samples] of all records at each of several z."""
    return simulated(p, [p.theta(z) for z in points], [p.starts(z) for z in points])


def simulated(
    p: FitProblem, thetas: Sequence[np.ndarray], starts: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """The same of several models, each with starts [records 2 nq] of its own."""
    many = len(p.records)
    theta = np.repeat(np.array(thetas), many, 0)
    records = np.tile(np.array(p.records), len(thetas))
    y = p.runs.engine.outputs(theta, np.concatenate(starts), records)
    out = []
    for k in range(len(thetas)):
        own = []
        for record, row in zip(p.records, y[k * many : (k + 1) * many], strict=True):
            at = p.runs.record(record).samples
            own.append(
                (p.weights[at] * (p.runs.sample_prediction(record, row) - p.targets[at])).ravel()
            )
        out.append(np.concatenate(own))
    return out


def linear(p: FitProblem, z: np.ndarray, r: np.ndarray, J: np.ndarray) -> Linear:
    """Sum of squares with gradient and curvature, of residuals with these slopes and of what is
    known without the data.
    """
    with np.errstate(all="ignore"):
        known, K = p.known_before(z)
        return Linear(
            float(r @ r + known @ known), J.T @ r + K.T @ known, J.T @ J + K.T @ K, r.size
        )


def descend_on_secants(
    p: FitProblem,
    starts: Sequence[np.ndarray],
    known: Slopes | None,
    iterations: int,
    tolerance: float,
) -> tuple[Path, Slopes, int]:
    """A descent from the best of some z, its slopes at the end, and how many free runs were
    simulated. `known`: slopes of some of the numbers on the same records; without them those at the
    first z are taken.
    """
    points = [problem_clip(p, z) for z in starts]
    if known is None:
        at = Slopes.taken(p, points[0])
        spent = 1 + p.size
    else:
        found = residuals(p, points)
        best = _least(p, points, found)
        at, spent = known.of(p, points[best], found[best]), len(points)
    path = Path(p, at.z, history=[])
    room = -(-LEAST * len(p.records) // LANES) * LANES // len(p.records)
    while np.isfinite(at.r).all() and np.any(
        at.age >= NEVER
    ):  # slopes that nobody has taken come before any step
        at, _ = _renewed(p, at, room)
        spent += room
    accept(path, at.z, linear(p, at.z, at.r, at.J), tolerance, _new)
    for _ in range(iterations):
        if path.converged:
            break
        radius = path.radius
        trials = []
        for share in TRIED:
            path.radius = share * radius
            trials.append((next_trial(path), path.radius))
        left = max(0, room - len(trials))
        at, tried = _renewed(p, at, left, [z for z, _ in trials])
        spent += len(trials) + left
        best = _least(p, [z for z, _ in trials], tried)
        (z, path.radius), r = trials[best], tried[best]
        assert path.scale is not None
        J = at.told(z, r, path.scale) if np.isfinite(r).all() else at.J
        accept(path, z, linear(p, z, r, J), tolerance, _new)
        if path.z is z:
            at = replace(at, z=z, r=r, J=J, age=at.age + 1)
        else:
            at = replace(at, J=J)
            here = linear(p, at.z, at.r, J)
            path.gradient, path.hessian = here.gradient, here.hessian
    return path, at, spent


def _least(p: FitProblem, points: Sequence[np.ndarray], found: Sequence[np.ndarray]) -> int:
    """Which of some z leaves least, by its residuals."""
    with np.errstate(all="ignore"):
        cost = [
            float(r @ r + np.sum(p.known_before(z)[0] ** 2))
            for z, r in zip(points, found, strict=True)
        ]
    return int(np.argmin(np.where(np.isfinite(cost), cost, np.inf)))


def _new(path: Path, trial: np.ndarray, new: Linear) -> np.ndarray:
    return new.hessian


def _renewed(
    p: FitProblem, at: Slopes, room: int, beside: Sequence[np.ndarray] = ()
) -> tuple[Slopes, list[np.ndarray]]:
    """Slopes with the `room` oldest taken anew, and the residuals at other points, all in one
    batch.
    """
    order = np.argsort(-at.age, kind="stable")[:room]
    columns = [int(c) for c in order if at.age[c] > 0]
    side = p.steps(at.z)
    h = side[1]
    moved = [at.z + h * (np.arange(p.size) == c) for c in columns]
    found = residuals(p, [*beside, *moved]) if beside or moved else []
    return at.renewed(columns, found[len(beside) :], h), found[: len(beside)]
