"""A speed that stands later than the position whose rate it is: differenced, averaged or filtered
on its way, by no model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

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
    count = len(stretches)
    if count < 3:
        return None
    most = _farthest(stretches)
    each = np.array([_products(stretch, most) for stretch in stretches])
    together = each.sum(axis=0)
    rows = _lag(together)
    if rows is None:
        return None
    without_one = [_lag(together - own) for own in each]
    jackknife = np.array([lag for lag in without_one if lag is not None])
    if len(jackknife) < count:
        return None
    row = stretches[0].step
    late = rows * row
    scatter = np.sum((jackknife - jackknife.mean()) ** 2)
    std = row * float(np.sqrt((count - 1) / count * scatter))
    step = float(np.median([s.step for s in stretches]))
    held = (max((every_row(y) for _, y in series(dataset, speed)), default=1) - 1) / 2
    if abs(late) <= max(SURE * std, (ROWS + held) * step):
        return None
    at_once = _apart(together, 0)
    moved = _apart(together, round(rows))
    if moved > GONE * at_once:
        return None
    return Lateness(late, std, step, position)


def _stretches(dataset: Dataset, position: Channel, speed: Channel) -> Iterator[Stretch]:
    """Parts of all runs, each of them filtered as a whole."""
    for e in dataset.experiments:
        q, v = samples_of(dataset, position, e), samples_of(dataset, speed, e)
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


def _farthest(stretches: list[Stretch]) -> int:
    """Rows by which speeds are moved at most: a quarter period of the motion."""
    shortest = min(len(s.rate) for s in stretches)
    return max(2, min(shortest // 3, _quarter_period(stretches)))


def _products(stretch: Stretch, most: int) -> Float[np.ndarray, "lags 3"]:
    """Speed times rate, speed squared and rate squared, summed over the rows that both have, with
    the speed taken -most to most rows earlier.
    """
    from scipy.signal import correlate

    n = len(stretch.rate)
    lags = np.arange(-most, most + 1)
    earlier, later = np.maximum(lags, 0), np.maximum(-lags, 0)
    speed_power = np.concatenate([[0.0], np.cumsum(stretch.speed**2)])
    rate_power = np.concatenate([[0.0], np.cumsum(stretch.rate**2)])
    product = correlate(stretch.speed, stretch.rate)[n - 1 + lags]
    return np.stack(
        [
            product,
            speed_power[n - later] - speed_power[earlier],
            rate_power[n - earlier] - rate_power[later],
        ],
        axis=1,
    )


def _lag(products: Float[np.ndarray, "lags 3"]) -> float | None:
    """By how many rows the speeds are late; None where they are no rates of these positions.

    The lag of the highest peak of what both have in common, between rows by a parabola.
    """
    product, speed_power, rate_power = products.T
    shares = product**2 / np.maximum(speed_power * rate_power, 1e-300)
    best = int(np.argmax(shares))
    if shares[best] < SAME or best in (0, len(shares) - 1):
        return None
    left, top, right = shares[best - 1 : best + 2]
    bend = left - 2 * top + right
    part = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return best + part - len(shares) // 2


def _quarter_period(stretches: list[Stretch]) -> int:
    """Rows in a quarter of the usual period of a motion, by how often its rate changes sign on the
    whole.
    """
    rate = np.concatenate([s.rate for s in stretches])
    steps = np.concatenate([np.diff(s.rate) for s in stretches])
    power = float(np.mean(rate**2))
    change = float(np.mean(steps**2))
    if change == 0:
        return len(rate)
    return int(np.ceil(np.pi / 2 * np.sqrt(power / change)))


def _apart(products: Float[np.ndarray, "lags 3"], lag: int) -> float:
    """What is left of a speed beside the rate of the position (rms, share), taken this many rows
    earlier.
    """
    product, speed_power, rate_power = products[len(products) // 2 + lag]
    common = product**2 / max(speed_power * rate_power, 1e-300)
    return float(np.sqrt(max(0.0, 1 - common)))


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
