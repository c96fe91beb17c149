"""Two encoders of one joint whose difference has two ends: the play between them, read off without
a model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from jaxid.conventions.finding import DataFinding
from jaxid.conventions.limits import GONE
from jaxid.conventions.mending import Mending
from jaxid.conventions.samples import commanded, LONGEST, samples_of, Shown
from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.data.noise import quantisation_step, sensor_noise
from jaxid.data.signals import content_cutoff, differentiate, filter_ends


#: Share of a position's power that another one follows, at least, where both are of one joint.
ONE_JOINT = 0.99
#: The two ends lie this many times apart what the difference scatters at each of them.
APART = 6.0
#: Each end holds at least, and what lies between them at most, that share of the samples.
EACH, BETWEEN = 0.1, 0.25
#: Times that the difference goes from one end to the other, at least: a coupling that slips once
#: does so once.
TURNS = 4
#: A ratio of two encoders is 1, or a whole number, within this share of it.
RATIO = 0.02
SHORTEST = 60


@dataclass(frozen=True)
class Ends:
    """The play between two positions, how it scatters (what lies between winds up under load, too),
    and how often it is passed.
    """

    size: float
    std: float
    turns: int


def plays(dataset: Dataset) -> Iterator[Shown]:
    """Play between two measured positions of a joint, one of which may be auxiliary."""
    for a, b in _pairs(dataset):
        if (ends := play(dataset, a, b)) is not None:
            yield _shown(a, b, ends)


def read_twice(dataset: Dataset) -> tuple[str, ...]:
    """Names of two measured positions of one joint; empty where no joint is read twice."""
    for a, b in _pairs(dataset):
        if _ratio([(x, y) for _, x, y in _moving(dataset, a, b)]) is not None:
            return a.name, b.name
    return ()


def _pairs(dataset: Dataset) -> Iterator[tuple[Channel, Channel]]:
    """Measured positions that may be of one joint."""
    positions = [
        c
        for c in dataset.channels
        if c.role != "input" and c.unit in ("rad", "m") and not commanded(c.name)
    ]
    return ((a, b) for a, b in combinations(positions, 2) if a.unit == b.unit)


def _moving(
    dataset: Dataset, a: Channel, b: Channel
) -> list[tuple[Experiment, np.ndarray, np.ndarray]]:
    """The runs in which both positions are read and the first one moves, with their samples."""
    runs = [(e, samples_of(dataset, a, e), samples_of(dataset, b, e)) for e in dataset.experiments]
    return [
        (e, x, y)
        for e, x, y in runs
        if x is not None and y is not None and len(x) >= SHORTEST and np.ptp(x) > 0
    ]


def play(dataset: Dataset, a: Channel, b: Channel) -> Ends | None:
    """The play between two positions; None where they are not of one joint, or their difference has
    no two ends.

    What grows with the speed, the acceleration or the drive is a time between the two readings, or
    a shaft that winds up.
    """
    moving = _moving(dataset, a, b)
    ratio = _ratio([(x, y) for _, x, y in moving])
    if ratio is None:
        return None
    parts = [y / ratio - x for _, x, y in moving]
    counts = [
        quantisation_step([x for _, x, _ in moving]),
        quantisation_step([y / ratio for _, _, y in moving]),
    ]
    count = max(step or 0.0 for step in counts)
    apart = np.concatenate(parts)
    low, high = _two_ends(apart)
    size = high - low
    labels = [np.where(d > (low + high) / 2, 0.5, -0.5) for d in parts]
    label = np.concatenate(labels)
    scatter = max(
        float(np.median(np.abs(apart[label == s] - end))) * 1.5
        for s, end in ((0.5, high), (-0.5, low))
    )
    between = float(np.mean((apart > low + size / 4) & (apart < high - size / 4)))
    turns = sum(int(np.count_nonzero(np.diff(_settled(d, low, high)))) for d in parts)
    if size < APART * max(scatter, count) or min(np.mean(label > 0), np.mean(label < 0)) < EACH:
        return None
    if between > BETWEEN or turns < TURNS:
        return None
    if float(np.std(apart - size * label)) > GONE * _beside_motion(moving, parts):
        return None
    return Ends(size, scatter, turns)


def _ratio(pairs: list[tuple[np.ndarray, np.ndarray]]) -> float | None:
    """How far the second of two positions goes for the first one; None where it does not follow
    it.
    """
    if not pairs:
        return None
    x = np.concatenate([first - np.mean(first) for first, _ in pairs])
    y = np.concatenate([second - np.mean(second) for _, second in pairs])
    product, power = float(x @ y), float(x @ x) * float(y @ y)
    if power == 0 or product**2 < ONE_JOINT * power:
        return None
    ratio = product / float(x @ x)
    for whole in (round(ratio), 1 / round(1 / ratio) if round(1 / ratio) else 0):
        if whole and abs(ratio / whole - 1) < RATIO:
            return float(whole)
    return ratio


def _two_ends(d: np.ndarray) -> tuple[float, float]:
    """The middles of what lies above and below half of the range of most samples."""
    low, high = (float(end) for end in np.percentile(d, [5, 95]))
    for _ in range(5):
        half = (low + high) / 2
        low, high = float(np.median(d[d <= half])), float(np.median(d[d >= half]))
    return low, high


def _settled(d: np.ndarray, low: float, high: float) -> np.ndarray:
    """At which end the difference was last [samples at an end]."""
    size = high - low
    at = np.where(d > high - size / 4, 1, np.where(d < low + size / 4, -1, 0))
    return at[at != 0]


def _beside_motion(
    moving: list[tuple[Experiment, np.ndarray, np.ndarray]], parts: list[np.ndarray]
) -> float:
    """What is left of the differences (rms) beside what is linear in position, speed, acceleration
    and the inputs.
    """
    rows, values = [], []
    for (e, x, _), d in zip(moving, parts, strict=True):
        t = e.t[:LONGEST]
        cutoff = content_cutoff(t, x, sensor_noise([x]))
        q, qd, qdd, _ = differentiate(t, x[:, None], cutoff)
        inside = slice(filter_ends(t, cutoff), len(t) - filter_ends(t, cutoff))
        u = e.u[: len(t)]
        rows.append(np.column_stack([np.ones(len(t)), q, qd, qdd, u])[inside])
        values.append(d[inside])
    A, y = np.concatenate(rows), np.concatenate(values)
    size = np.sqrt(np.mean(A**2, axis=0))
    A = A[:, size > 0] / size[size > 0]
    return float(np.std(y - A @ np.linalg.lstsq(A, y, rcond=1e-9)[0]))


def _shown(a: Channel, b: Channel, ends: Ends) -> Shown:
    size = f"{ends.size:.3g} ± {1.96 * ends.std:.1g} {a.unit}"
    text = (
        f"The difference of {b.name} and {a.name} goes between two ends {size} apart as the motion"
        f" turns, {ends.turns} times, and is nearly constant at each: play between the two"
        " (backlash), read off without any fit, with what winds up under load in it. It does not"
        " go with speed, acceleration or drive, as a delay or a soft shaft would."
    )
    finding = DataFinding(
        "play",
        b.name,
        ends.size,
        text,
        "",
        (ends.size - 1.96 * ends.std, ends.size + 1.96 * ends.std),
        decisive=True,
        headline=f"there is play of {size} between {a.name} and {b.name}",
    )
    return Shown(finding, Mending())
