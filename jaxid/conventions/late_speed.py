"""A speed that stands later than the position whose rate it is: differenced, averaged or filtered
on its way, by no model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from jaxid.conventions.finding import DataFinding
from jaxid.conventions.limits import GONE
from jaxid.conventions.mending import Mending
from jaxid.conventions.samples import commanded, every_row, LONGEST, samples_of, series, Shown
from jaxid.data.dataset import Channel, Dataset
from jaxid.data.signals import even_grid, speed_content, zero_phase


RATES = {"rad/s": "rad", "m/s": "m"}
#: Share of a speed's power that is the rate of a position, at least: what is less is of another
#: joint.
SAME = 0.9
#: A speed is late by this many rows beyond what its own updates bring: a difference of two samples
#: stands half a row late, and one bus may read speed and position a row apart.
ROWS = 1.5
#: Standard deviations, over parts of the recording, from which a lateness is one.
SURE = 6.0
#: Parts of a run, and the least samples of each.
PARTS, SHORTEST = 6, 40
#: Speeds are compared below this many times the frequency under which nearly all of their power
#: lies.
CONTENT = 2.0


@dataclass(frozen=True)
class Stretch:
    """Speed and rate of the position at equal steps [samples], through one filter without phase."""

    step: float
    speed: np.ndarray
    rate: np.ndarray


@dataclass(frozen=True)
class Lateness:
    """By how many s a speed is late against a position, its standard deviation, and the median step
    (s).
    """

    seconds: float
    std: float
    step: float
    position: Channel


def late_speeds(dataset: Dataset) -> Iterator[Shown]:
    """Speeds, outputs or auxiliary, that are late or early against the position that they are the
    rate of.
    """
    for speed in dataset.channels:
        if speed.unit not in RATES or speed.role == "input" or commanded(speed.name):
            continue
        positions = [
            c
            for c in dataset.channels
            if c.unit == RATES[speed.unit] and c.role != "input" and not commanded(c.name)
        ]
        found = [late for c in positions if (late := lateness(dataset, c, speed)) is not None]
        if found and (shown := _shown(dataset, speed, found[0])) is not None:
            yield shown


def lateness(dataset: Dataset, position: Channel, speed: Channel) -> Lateness | None:
    """How late a speed is against the position that it is the rate of; None where it is none of it,
    or not surely late.
    """
    stretches = list(_stretches(dataset, position, speed))
    if len(stretches) < 3:
        return None
    lags = [_lag(stretches)]
    lags += [_lag(stretches[:k] + stretches[k + 1 :]) for k in range(len(stretches))]
    if any(lag is None for lag in lags):
        return None
    known = np.array([lag for lag in lags if lag is not None])
    count = len(stretches)
    std = float(np.sqrt((count - 1) / count * np.sum((known[1:] - known[1:].mean()) ** 2)))
    step = float(np.median([s.step for s in stretches]))
    held = (max((every_row(y) for _, y in series(dataset, speed)), default=1) - 1) / 2
    late = float(known[0])
    if abs(late) <= max(SURE * std, (ROWS + held) * step):
        return None
    at_once, moved = _apart(stretches, 0.0), _apart(stretches, late)
    if moved > GONE * at_once:
        return None
    return Lateness(late, std, step, position)


def _stretches(dataset: Dataset, position: Channel, speed: Channel) -> Iterator[Stretch]:
    """Parts of all runs, each of them filtered as a whole."""
    whole = [
        (e, *(samples_of(dataset, c, e) for c in (position, speed))) for e in dataset.experiments
    ]
    for e, q, v in whole:
        if q is None or v is None or len(e.t) < 3 * SHORTEST or not np.ptp(q) or not np.ptp(v):
            continue
        t = e.t[:LONGEST]
        grid = even_grid(t)
        if grid is not None:
            q, v, t = np.interp(grid, t, q), np.interp(grid, t, v), grid
        step = float(t[-1] - t[0]) / (len(t) - 1)
        cutoff = float(np.clip(CONTENT * speed_content(t, q, 0.0), 8 / (t[-1] - t[0]), 0.2 / step))
        rate = np.gradient(zero_phase(t, q, cutoff), step)
        smooth = zero_phase(t, v, cutoff)
        ends = min(int(np.ceil(2 / (cutoff * step))), len(t) // 10)
        inside = np.arange(ends, len(t) - ends)
        parts = max(1, min(PARTS, len(inside) // SHORTEST))
        for at in np.array_split(inside, parts):
            yield Stretch(step, smooth[at], rate[at])


def _lag(stretches: list[Stretch]) -> float | None:
    """By how many s the speeds are late; None where they are no rates of these positions.

    The lag of the highest peak of what both have in common, among those within a quarter period of
    the motion.
    """
    step = stretches[0].step
    most = max(2, min(min(len(s.rate) for s in stretches) // 3, _quarter_period(stretches)))
    lags = np.arange(-most, most + 1)
    both = np.array([_shared(stretches, int(k)) for k in lags])
    shares = both[:, 0] ** 2 / np.maximum(both[:, 1] * both[:, 2], 1e-300)
    best = int(np.argmax(shares))
    if shares[best] < SAME or best in (0, len(lags) - 1):
        return None
    left, top, right = shares[best - 1 : best + 2]
    bend = left - 2 * top + right
    part = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return float((lags[best] + part) * step)


def _quarter_period(stretches: list[Stretch]) -> int:
    """Rows in a quarter of the usual period of a motion, by how often its rate changes sign on the
    whole.
    """
    rate = np.concatenate([s.rate for s in stretches])
    power, change = (
        float(np.mean(rate**2)),
        float(np.mean(np.concatenate([np.diff(s.rate) for s in stretches]) ** 2)),
    )
    if change == 0:
        return len(rate)
    return int(np.ceil(np.pi / 2 * np.sqrt(power / change)))


def _shared(stretches: list[Stretch], lag: int) -> tuple[float, float, float]:
    """Products of speed and rate, summed, with the speed taken this many rows earlier."""
    total = np.zeros(3)
    for s in stretches:
        n = len(s.rate)
        v = s.speed[max(0, lag) : n + min(0, lag)]
        r = s.rate[max(0, -lag) : n - max(0, lag)]
        total += v @ r, v @ v, r @ r
    return float(total[0]), float(total[1]), float(total[2])


def _apart(stretches: list[Stretch], late: float) -> float:
    """What is left of a speed beside the rate of the position (rms, share), taken this many s
    earlier.
    """
    product, power, rates = _shared(stretches, round(late / stretches[0].step))
    return float(np.sqrt(max(0.0, 1 - product**2 / max(power * rates, 1e-300))))


def _shown(dataset: Dataset, speed: Channel, late: Lateness) -> Shown | None:
    """The finding; where the speed is early, it is the position that is late."""
    first, second = (
        (speed.name, late.position.name) if late.seconds > 0 else (late.position.name, speed.name)
    )
    by = f"{1e3 * abs(late.seconds):.3g} ± {1e3 * 1.96 * late.std:.1g} ms"
    rows = f"{abs(late.seconds) / late.step:.2g} rows"
    channel = next(c for c in dataset.channels if c.name == first)
    whose = f"{speed.name} is the rate of {late.position.name}"
    if late.seconds > 0:
        remedy = (
            f"it was averaged or filtered on its way. Use {late.position.name} alone: it has the"
            " speed in it without delay"
            f"{'' if speed.role == 'auxiliary' else ', and give ' + speed.name + ' the role auxiliary'}."
        )
    else:
        remedy = (
            f"the position was filtered on its way. Use {speed.name} alone, or record {first} as"
            " its sensor reads it."
        )
    text = (
        f"{whose}, and {first} stands {by} ({rows}) later than {second}, whatever the model:"
        f" {remedy}"
    )
    line = 'role = "auxiliary"' if channel.role == "output" and late.seconds > 0 else ""
    finding = DataFinding(
        "filtered",
        first,
        abs(late.seconds),
        text,
        line,
        (abs(late.seconds) - 1.96 * late.std, abs(late.seconds) + 1.96 * late.std),
        decisive=True,
        headline=f"{first} is {by} late against {second}",
    )
    return Shown(finding, Mending())
