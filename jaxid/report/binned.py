"""The missing force as means over parts of a variable, with intervals, and the law that was fitted
on top.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxid.report import plot


if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jaxid.diagnosis.result import MissingForce


#: Parts of an axis, and visits that a part needs for a mean with an interval.
PARTS, VISITS = 24, 3
#: Share of the greatest speed below which a joint counts as standing still: what sticks holds any
#: force.
STILL = 0.03


@dataclass(frozen=True)
class Means:
    """Means over the parts of an axis: middle of each part, mean, and half its 95 % interval from
    one visit to the next (nan where there are too few to tell).
    """

    x: np.ndarray
    mean: np.ndarray
    half: np.ndarray


def means(runs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], edges: np.ndarray) -> Means:
    """Of runs (x, y, whether a sample counts; each [time]). Samples of one visit to a part are one
    observation: neighbours in time say the same.
    """
    found: list[list[float]] = [[] for _ in edges[1:]]
    for x, y, keep in runs:
        part = np.where(keep & np.isfinite(y), np.digitize(x, edges) - 1, -1)
        cuts = np.flatnonzero(np.diff(part)) + 1
        for stretch in np.split(np.arange(len(part)), cuts):
            if len(stretch) and 0 <= (k := part[stretch[0]]) < len(found):
                found[k].append(float(np.mean(y[stretch])))
    told = [k for k, values in enumerate(found) if values]
    values = [np.array(found[k]) for k in told]
    middle = 0.5 * (edges[1:] + edges[:-1])
    half = np.full(len(values), np.nan)
    for k, v in enumerate(values):
        if len(v) >= VISITS:
            half[k] = 1.96 * np.std(v, ddof=1) / np.sqrt(len(v))
    return Means(middle[told], np.array([v.mean() for v in values]), half)


def moving(force: MissingForce) -> np.ndarray:
    """Whether the joint moves at each sample."""
    return np.abs(force.qd) > STILL * (np.percentile(np.abs(force.qd), 99) + 1e-300)


def directions(field: str) -> list[tuple[str, int]]:
    """In which directions of motion the force is looked at apart: against anything but the speed
    itself both may cancel.
    """
    return [("", 0)] if field == "qd" else [("forwards", 1), ("backwards", -1)]


def supplied(forces: Sequence[MissingForce], field: str, sign: int = 0) -> Means:
    """What the named effects supply, as means over a field of the motion; in one direction of
    motion, or in both (0).
    """
    runs = []
    for f in forces:
        keep = moving(f) & ((sign == 0) | (np.sign(f.qd) == sign))
        runs.append((getattr(f, field), plot.series(f.before) - plot.series(f.after), keep))
    return means(runs, edges_of(forces, field))


def edges_of(forces: Sequence[MissingForce], field: str) -> np.ndarray:
    """Edges of the parts of an axis; none where the field does not vary."""
    low, high = np.quantile(np.concatenate([getattr(f, field) for f in forces]), [0.005, 0.995])
    return np.linspace(low, high, PARTS + 1) if high > low else np.zeros(0)


def draw(axes: Axes, forces: Sequence[MissingForce], field: str, which: str, law: bool) -> None:
    """Means of `before` or `after` against a field of the motion; `law`: what the named effects
    supply as a line on top.
    """
    edges = edges_of(forces, field)
    if not len(edges):
        return
    for (_, sign), color, mark in zip(
        directions(field), (plot.VERMILLION, plot.ORANGE), "o^", strict=False
    ):
        keep = [moving(f) & ((sign == 0) | (np.sign(f.qd) == sign)) for f in forces]
        series = [
            (getattr(f, field), plot.series(getattr(f, which)), k)
            for f, k in zip(forces, keep, strict=True)
        ]
        m = means(series, edges)
        known = np.isfinite(m.half)
        axes.errorbar(
            m.x[known], m.mean[known], m.half[known], fmt=mark, ms=3.6, lw=1.0, color=color
        )
        axes.plot(m.x[~known], m.mean[~known], mark, ms=3.6, mfc="white", mew=0.9, color=color)
        if law:
            line = supplied(forces, field, sign)
            axes.plot(
                line.x,
                line.mean,
                color=plot.BLUE,
                lw=1.6,
                ls="-" if sign >= 0 else (0, (4, 2)),
                zorder=3,
            )
    axes.axhline(0.0, color=plot.BLACK, linewidth=0.6)
