"""The residual of each record of many problems and its derivatives, from one batch of lanes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np

from jaxid.problem.objective import ResidualRows
from jaxid.problem.residual import Runs


if TYPE_CHECKING:
    from jaxid.problem.problem import FitProblem


#: By differences (none: tangents; forward; central) the points that are simulated for a column: at
#: it, ahead, behind.
SIDES = ((0,), (1,), (1, -1))


class _Part(NamedTuple):
    """What the lanes of a job and record say: the prediction, its derivative along each column of z
    (weighted), the columns.
    """

    base: np.ndarray
    J: np.ndarray  # [columns samples outputs], each in one piece of memory
    columns: list[int]
    weights: np.ndarray
    at: slice | np.ndarray
    inside: slice | np.ndarray


class Lanes(NamedTuple):
    """The lanes of some jobs: whose each is, and what it starts from and along."""

    of: list[
        tuple[int, int, int, int, int]
    ]  # job, row of its record, column of z and its place (-1: none), side of z
    theta: np.ndarray
    start: np.ndarray
    dtheta: np.ndarray
    dstart: np.ndarray
    record: np.ndarray
    steps: list[dict[int, np.ndarray]]  # of each job, by side

    def only(self, some: Sequence[int]) -> Lanes:
        """Some of the lanes."""
        at = np.asarray(some, int)
        theta, start, dtheta, dstart, record = (a[at] for a in self[1:6])
        return Lanes([self.of[k] for k in some], theta, start, dtheta, dstart, record, self.steps)


def lanes_of(jobs: Sequence[tuple[FitProblem, np.ndarray]]) -> Lanes:
    """The lanes of a record: with tangents one for each column of z, else the point itself and one
    or two beside it for each column.
    """
    runs, differences = jobs[0][0].runs, jobs[0][0].differences
    size, nx = len(runs.layout), 2 * runs.layout.chain.nq
    lanes: list[tuple[int, int, int, int, int]] = []
    for j, (p, _) in enumerate(jobs):
        for row in range(len(p.records)):
            columns = p.columns(row)
            if differences or not len(columns):
                lanes.append((j, row, -1, -1, 0))
            for k, c in enumerate(columns):
                lanes += [(j, row, c, k, side) for side in SIDES[differences]]
    n = len(lanes)
    theta, start = np.empty((n, size)), np.empty((n, nx))
    dtheta, dstart = np.zeros((n, size)), np.zeros((n, nx))
    record = np.empty(n, int)
    steps = [p.steps(z) for p, z in jobs]
    points = [(p.theta(z), p.starts(z), p.dtheta(z)) for p, z in jobs]
    for n, (j, row, c, _, side) in enumerate(lanes):
        p, z = jobs[j]
        theta[n], start[n], record[n] = points[j][0], points[j][1][row], p.records[row]
        if 0 <= c < p.free.size:
            i = p.free[c]
            dtheta[n, i] = points[j][2][c]
            if side:
                moved = z[c] + steps[j][side][c]
                theta[n, i] = np.exp(moved) if p.log[c] else moved
        elif c >= 0:
            i = p.start_columns[c - p.free.size]
            dstart[n, i] = 1.0
            start[n, i] += steps[j][side][c] if side else 0.0
    return Lanes(lanes, theta, start, dtheta, dstart, record, steps)


def rows_of_records(
    jobs: Sequence[tuple[FitProblem, np.ndarray]], given: Lanes, share: float
) -> Iterator[ResidualRows]:
    """Rows of each job and record, from whole records."""
    runs, differences = jobs[0][0].runs, jobs[0][0].differences
    lanes, theta, start, dtheta, dstart, record, steps = given
    used: set[int] = set()
    for p, _ in jobs:
        used |= set(p.records)
    seen = {r: _seen(runs, r, share) for r in used}
    rest = Counter((j, row) for j, row, *_ in lanes)
    order = list(rest)  # the rows of a job come in the order of its records
    found: dict[tuple[int, int], _Part] = {}
    if differences:
        blocks = (
            (part, y, y) for part, y in runs.engine.output_blocks(theta, start, record, share)
        )
    else:
        blocks = runs.engine.tangent_blocks(theta, start, dtheta, dstart, record, share)
    for part, y, dy in blocks:
        for n, lane in enumerate(part):
            j, row, c, k, side = lanes[lane]
            own = found.get((j, row))
            if own is None:
                p = jobs[j][0]
                own = _empty(p, row, seen[p.records[row]])
                found[j, row] = own
                if not differences:
                    own.base[:] = y[n][own.inside]
            if c < 0:
                own.base[:] = y[n][own.inside]
            elif differences:
                own.J[k] += side * y[n][own.inside]
            else:
                np.multiply(own.weights, dy[n][own.inside], out=own.J[k])
            rest[j, row] -= 1
        while order and not rest[order[0]]:
            j, row = order.pop(0)
            yield _finished(j, row, jobs[j][0], found.pop((j, row)), steps[j], differences)


def _empty(p: FitProblem, row: int, seen: tuple[Any, Any]) -> _Part:
    at, inside = seen
    w, columns = p.weights[at], p.columns(row)
    return _Part(np.empty(w.shape), np.zeros((len(columns), *w.shape)), columns, w, at, inside)


def _finished(
    j: int, row: int, p: FitProblem, own: _Part, steps: Any, differences: int
) -> ResidualRows:
    """The rows of a record of which every lane has come in."""
    if differences == 1:
        own.J[:] -= own.base
    if differences:
        own.J[:] *= own.weights / (steps[1] - steps[-1])[own.columns, None, None]
    residual = own.weights * (own.base - p.targets[own.at])
    return ResidualRows(
        j, p.records[row], residual, np.moveaxis(own.J, 0, -1), own.columns, own.weights
    )


def _seen(runs: Runs, number: int, share: float) -> tuple[slice | np.ndarray, slice | np.ndarray]:
    """Samples of the first part of a record, and their places in a lane; as slices where there is
    no gap.
    """
    r = runs.record(number)
    at = r.samples if share == 1 else r.samples[r.samples < r.offset + share * r.count]
    if at.size and at[-1] - at[0] == at.size - 1:
        return slice(at[0], at[-1] + 1), slice(at[0] - r.offset, at[-1] + 1 - r.offset)
    return at, at - r.offset
