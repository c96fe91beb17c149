"""Residuals, Jacobians and losses of records so long that not even one lane's prediction should be
in memory as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxid.numerics.precision import float64
from jaxid.problem.objective import LOSSES, penalised, ResidualRows
from jaxid.simulation.windows import TOGETHER, WINDOW


#: A record of one job: (job, row of its record).
Key = tuple[int, int]


def rows_by_windows(
    jobs: Sequence[tuple[Any, np.ndarray]], lanes: Any, share: float, pieces: bool, whole: Callable
) -> Iterator[ResidualRows]:
    """`Problem.rows` of long records: the lanes of some records side by side, window by window.

    `whole(jobs, lanes)` does it where windows cannot be taken; without `pieces` the rows of a
    record are put together again.
    """
    engine, differences = jobs[0][0].runs.engine, jobs[0][0].differences
    for keys in _batches(lanes, TOGETHER):
        own = lanes.only(list(chain.from_iterable(keys.values())))
        along = None if differences else (own.dtheta, own.dstart)
        windows = engine.windows(own.theta, own.start, own.record, share, along)
        if windows is None:
            for part in keys.values():
                yield from whole(jobs, lanes.only(part))
            continue
        parts = _pieces(jobs, own, keys, windows, share)
        yield from parts if pieces else _joined(parts)


def _batches(lanes: Any, most: int) -> Iterator[dict[Key, list[int]]]:
    """Records of jobs with their lanes, in order, not more than this many lanes at a time if it can
    be helped.
    """
    every: dict[Key, list[int]] = {}
    for k, (job, row, *_) in enumerate(lanes.of):
        every.setdefault((job, row), []).append(k)
    batch: dict[Key, list[int]] = {}
    for key, part in every.items():
        if batch and sum(map(len, batch.values())) + len(part) > most:
            yield batch
            batch = {}
        batch[key] = part
    if batch:
        yield batch


def _pieces(
    jobs: Sequence[tuple[Any, np.ndarray]],
    lanes: Any,
    keys: dict[Key, list[int]],
    windows: Any,
    share: float,
) -> Iterator[ResidualRows]:
    """Rows of each window of each record."""
    begin, members = 0, []
    for job, row in keys:
        p, count = jobs[job][0], len(keys[job, row])
        r = p.runs.record(p.records[row])
        at = r.samples if share == 1 else r.samples[r.samples < r.offset + share * r.count]
        members.append((job, row, range(begin, begin + count), at, at - r.offset, p.columns(row)))
        begin += count
    for first, out in windows:
        for job, row, own, at, inside, columns in members:
            low, high = np.searchsorted(inside, (first[own[0]], first[own[0]] + WINDOW))
            if low == high:
                continue
            p = jobs[job][0]
            places, at_samples = _run(inside[low:high] - first[own[0]]), _run(at[low:high])
            w = p.weights[at_samples]
            base, J = _linear(
                out=out,
                lanes=lanes,
                own=own,
                places=places,
                w=w,
                steps=lanes.steps[job],
                columns=columns,
                differences=p.differences,
            )
            residual = w * (base - p.targets[at_samples])
            yield ResidualRows(job, p.records[row], residual, np.moveaxis(J, 0, -1), columns, w)


def _run(index: np.ndarray) -> slice | np.ndarray:
    """Increasing positions, as a slice where there is no gap."""
    return slice(index[0], index[-1] + 1) if index[-1] - index[0] == index.size - 1 else index


def _linear(
    out: Sequence[np.ndarray],
    lanes: Any,
    own: range,
    places: Any,
    w: np.ndarray,
    steps: Any,
    columns: list[int],
    differences: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Prediction of a record in one window, and its derivative along each of its columns, weighted
    [columns samples outputs].
    """
    J = np.zeros((len(columns), *w.shape))
    base = out[0][own[0]][places]
    for k in own:
        _, _, c, place, side = lanes.of[k]
        if c < 0:
            base = out[0][k][places]
        elif differences:
            J[place] += side * out[0][k][places]
        else:
            np.multiply(w, out[1][k][places], out=J[place])
    if differences == 1:
        J -= base
    if differences:
        J *= w / (steps[1] - steps[-1])[columns, None, None]
    return base, J


def _joined(parts: Iterator[ResidualRows]) -> Iterator[ResidualRows]:
    """Rows of whole records, in the order in which their first pieces came."""
    found: dict[Key, list[ResidualRows]] = {}
    for part in parts:
        found.setdefault((part.job, part.record), []).append(part)
    for key in list(found):
        own = found.pop(key)

        def both(name, own=own):
            return np.concatenate([getattr(part, name) for part in own])

        J = np.concatenate([np.moveaxis(part.J, -1, 0) for part in own], 1)
        yield own[0]._replace(r=both("r"), J=np.moveaxis(J, 0, -1), w=both("w"))


def losses_by_windows(
    problem: Any, z: np.ndarray, whole: Callable[[np.ndarray], Callable[[], np.ndarray]]
) -> np.ndarray:
    """Loss of each row of z [pop size]; `whole(z)()` gives it where windows cannot be taken."""
    engine, runs, records = problem.runs.engine, problem.runs, np.array(problem.records)
    loss, data, out = LOSSES[problem.loss_name], problem.data, np.empty(len(z))
    summed: Any = loss.summed
    each = max(1, TOGETHER // records.size)
    for begin in range(0, len(z), each):
        some = z[begin : begin + each]
        theta = np.repeat(np.array([problem.theta(x) for x in some]), records.size, 0)
        starts = np.concatenate([problem.starts(x) for x in some])
        windows = engine.windows(theta, starts, np.tile(records, len(some)))
        if windows is None:
            out[begin : begin + each] = whole(some)()
            continue
        total = np.zeros((len(some), len(data.norm)))
        with float64(), np.errstate(all="ignore"):
            for first, (y,) in windows:
                for lane in range(len(y)):
                    r = runs.record(records[lane % records.size])
                    low, high = np.searchsorted(
                        r.samples - r.offset, (first[lane], first[lane] + WINDOW)
                    )
                    if low == high:
                        continue
                    at = r.samples[low:high]
                    w = problem.weights[at]
                    e = np.where(
                        w > 0, y[lane][at - r.offset - first[lane]] - runs.targets[at], 0.0
                    )
                    total[lane // records.size] += np.asarray(summed(e, w * e)).sum(0)
            out[begin : begin + each] = np.asarray(
                penalised(loss.total(jnp.asarray(total), data.count, data.norm))
            )
    return out
