"""What the samples of a channel show by themselves: wrapped, glitches, repeated rows, cut off at an
end, filtered.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from jaxid.conventions.finding import DataFinding
from jaxid.conventions.mending import lines, Mending
from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.data.forms import glitches


#: Words of goals in names of channels: q_cmd, target_position, qref, Sollposition.
GOAL = re.compile(
    r"cmd|command|goal|target|desired|demand|setpoint|soll|(?:^|_)(?:ref|des|set)(?:_|$|\d)|reference",
    re.I,
)
LONGEST = 400_000  # samples of a run that are looked at
#: A wrap is a jump that, with the period taken off, fits its neighbours to this many times what
#: they usually change by.
FITS = 6.0
#: Glitches are left out where they are few; more of a channel than that is its noise or its law.
FEW = 0.02
#: Ranges of counters that are no power of two.
RANGES = np.array([360.0, 3600.0, 36000.0, 1000.0, 10000.0])
#: Repeated rows: this many of the changes fall on every n-th row, and this many of these rows bring
#: a change.
IN_STEP, FRESH = 0.98, 0.6


@dataclass(frozen=True)
class Shown:
    """A finding, and what mends it (nothing where it is but a question). `beside`: it was found
    beside any friction and spring that the model may lack, whose gap a simulation of the model
    leaves as it is.
    """

    finding: DataFinding
    mending: Mending
    beside: bool = False


def series(dataset: Dataset, channel: Channel) -> Iterator[tuple[Experiment, np.ndarray]]:
    """Each run and the channel's samples in it [time]."""
    if channel.role == "auxiliary":
        for e in dataset.experiments:
            if channel.name in e.auxiliary:
                yield e, e.auxiliary[channel.name][:LONGEST]
        return
    if channel.role == "input":
        column = dataset.input_names.index(channel.name)
        yield from ((e, e.u[:LONGEST, column]) for e in dataset.experiments)
        return
    column = dataset.output_names.index(channel.name)
    for e in dataset.experiments:
        values = e.y[:LONGEST, column]
        yield e, values[e.read[:LONGEST, column]]


def samples_of(dataset: Dataset, channel: Channel, e: Experiment) -> np.ndarray | None:
    """An output's or auxiliary channel's samples in a run, one at each time."""
    if channel.role == "auxiliary":
        values = e.auxiliary.get(channel.name)
        return None if values is None else values[:LONGEST]
    column = dataset.output_names.index(channel.name)
    return e.motion()[:LONGEST, column]


def commanded(name: str) -> bool:
    """Whether a channel's name says that it is a goal and not measured."""
    return GOAL.search(name) is not None


def wrapped(dataset: Dataset, channel: Channel) -> Shown | None:
    """Jumps by one turn, or by the range of a counter, between neighbours that are smooth but for
    it.
    """
    parts = [y for _, y in series(dataset, channel)]
    steps = [np.diff(y) for y in parts if len(y) > 3]
    if not steps or (channel.role != "output" and channel.unit != "rad"):
        return None
    d = np.concatenate(steps)
    moved = np.abs(d[d != 0])
    if not len(moved):
        return None
    usual = float(np.percentile(moved, 90))
    span = max(float(np.ptp(y)) for y in parts)
    for period in [2 * pi] if channel.unit == "rad" else []:
        if (found := _wraps(d, period, usual, span)) is not None:
            return _wrapped(dataset, channel, period, found)
    jumps = np.abs(d[np.abs(d) > 0.7 * span])
    if channel.role == "output" and len(jumps) >= 2 and span > 30 * usual:
        period = _counter(channel, float(np.median(jumps)), usual)
        if period is not None and (found := _wraps(d, period, usual, span)) is not None:
            return _wrapped(dataset, channel, period, found)
    return None


def _wraps(d: np.ndarray, period: float, usual: float, span: float) -> int | None:
    """How often a series with steps d [time] wraps; None where it does not, or jumps in other ways
    too.
    """
    jumps = np.flatnonzero(np.abs(d) > 0.6 * period)
    if not len(jumps) or span > 1.05 * period or usual > period / 8:
        return None
    rest = np.abs(np.abs(d[jumps]) - period)
    near = np.array([np.abs(np.delete(d[max(0, j - 3) : j + 4], min(j, 3))).max() for j in jumps])
    # What is left of a jump goes as its neighbours go; a pair that goes there and back is a glitch.
    back = np.array([np.any(np.abs(d[max(0, j - 3) : j + 4] + d[j]) < 0.3 * period) for j in jumps])
    fits = (rest <= FITS * np.maximum(np.minimum(near, period / 8), usual / 10)) & ~back
    return len(jumps) if fits.sum() >= max(1, 0.6 * len(jumps)) else None


def _counter(channel: Channel, jump: float, usual: float) -> float | None:
    """A power of two or of ten of raw counts that is the range of a counter."""
    stated = channel.stated
    count = 1.0 if stated is None else stated.factor * abs(stated.scale)  # in the channel's unit
    powers = count * 2.0 ** np.arange(8, 33)
    ranges = np.array([*powers, *(count * RANGES)])
    period = float(ranges[np.argmin(np.abs(ranges - jump))])
    return period if abs(period - jump) <= 3 * usual else None


def _wrapped(dataset: Dataset, channel: Channel, period: float, count: int) -> Shown:
    forms = {"unwrap": True if channel.unit == "rad" and period == 2 * pi else period}
    what = "one turn" if forms["unwrap"] is True else f"{period:.6g} {channel.unit}"
    text = (
        f"{channel.name} jumps by {what} between neighbouring samples, {count}"
        f" time{'s' * (count > 1)}: it is wrapped."
    )
    finding = DataFinding(
        "wrapped",
        channel.name,
        period,
        text,
        lines(dataset, channel.name, {"unwrap": period}),
        decisive=True,
        headline=f"{channel.name} is wrapped; everything below takes it unwrapped",
    )
    return Shown(finding, Mending({channel.name: forms}))


def glitch(dataset: Dataset, channel: Channel) -> Shown | None:
    """Single samples (up to three) far off both sides."""
    if channel.role != "output":
        return None
    parts = [(e, *timed) for e, *timed in _timed(dataset, channel) if len(timed[0]) > 30]
    found = [_lone(y, t) for _, t, y in parts]
    count, total = sum(int(np.sum(lone)) for lone in found), sum(map(len, found))
    if not count or count > FEW * total:
        return None
    off = max(_distance(y, t, lone) for (_, t, y), lone in zip(parts, found, strict=True))
    name, first = next(
        (e.name, t[lone][0]) for (e, t, _), lone in zip(parts, found, strict=True) if lone.any()
    )
    text = (
        f"{count} of {total} samples of {channel.name} lie far off their neighbours (by up to"
        f" {off:.3g} {channel.unit}; the first at {first:.4g} s of {name}): left out, they count in"
        " no loss."
    )
    finding = DataFinding(
        "glitch",
        channel.name,
        float(count),
        text,
        lines(dataset, channel.name, {"drop_glitches": True}),
        decisive=True,
        headline=(
            f"{count} sample{'s' * (count > 1)} of {channel.name} are glitches; everything below"
            " leaves them out"
        ),
    )
    return Shown(finding, Mending({channel.name: {"drop_glitches": True}}))


def _timed(
    dataset: Dataset, channel: Channel
) -> Iterator[tuple[Experiment, np.ndarray, np.ndarray]]:
    """Each run with the times and the samples of an output [time] that count."""
    column = dataset.output_names.index(channel.name)
    for e, y in series(dataset, channel):
        yield e, e.t[:LONGEST][e.read[:LONGEST, column]], y


def _lone(y: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Glitches that stand clear of the channel's own flicker everywhere, [time]."""
    found = glitches(y, t)
    if not found.any():
        return found
    bend = np.abs(np.diff(y[~found], 2))
    clear = 3 * float(np.percentile(bend, 99.5)) if len(bend) else np.inf
    for k in np.flatnonzero(found):
        beside = [y[i] for i in range(max(0, k - 5), min(len(y), k + 6)) if not found[i]]
        found[k] = bool(beside) and min(abs(y[k] - b) for b in beside) > clear
    return found


def _distance(y: np.ndarray, t: np.ndarray, lone: np.ndarray) -> float:
    """How far at most those samples lie off the line between the others."""
    if not lone.any():
        return 0.0
    return float(np.max(np.abs(y[lone] - np.interp(t[lone], t[~lone], y[~lone]))))


def repeated_rows(dataset: Dataset, channel: Channel) -> Shown | None:
    """An output that has a new value at every n-th row only."""
    if channel.role != "output":
        return None
    every = {every_row(y) for e, y in series(dataset, channel) if len(y) == min(len(e), LONGEST)}
    if len(every) != 1 or (n := every.pop()) < 2:
        return None
    text = (
        f"{channel.name} has a new value at every {n}. row only: it is sampled {n} times more"
        " slowly than it is logged."
    )
    finding = DataFinding(
        "repeated_rows",
        channel.name,
        float(n),
        text,
        lines(dataset, channel.name, {"sampled_every": n}),
        decisive=True,
        headline=(
            f"{channel.name} is sampled at every {n}. row; everything below leaves out the rows"
            " that repeat"
        ),
    )
    return Shown(finding, Mending({channel.name: {"sampled_every": n}}))


def every_row(y: np.ndarray) -> int:
    changes = np.flatnonzero(np.diff(y) != 0) + 1
    if len(changes) < 20:
        return 1
    n = int(np.median(np.diff(changes)))
    if n < 2 or n > len(y) // 20:
        return 1
    counts = np.bincount(changes % n, minlength=n)
    moving = (changes[-1] - changes[0]) / n + 1
    return n if counts.max() >= IN_STEP * len(changes) and counts.max() >= FRESH * moving else 1


def saturated(dataset: Dataset, channel: Channel) -> Shown | None:
    """Stretches at the very end of a channel's range that a moving signal runs into and comes out
    of: cut off, not at rest.
    """
    if channel.role == "auxiliary":
        return None
    where: list[tuple[float, int, int]] = []
    total = 0
    for _, y in series(dataset, channel):
        total += len(y)
        for end in (float(y.max()), float(y.min())):
            where += [(end, a, b) for a, b in _cut_off(y, end)]
    count = sum(b - a for _, a, b in where)
    if len(where) < 3 or count < 0.01 * total:
        return None
    ends = sorted({f"{end:.4g}" for end, _, _ in where})
    remedy = (
        "a limit of the drive that the model may lack (saturation), or of the log"
        if channel.role == "input"
        else "the range of the sensor or of the log: record within it, or leave these runs out"
    )
    text = (
        f"{channel.name} stays at {' and '.join(ends)} {channel.unit} for {count} of {total}"
        f" samples, in {len(where)} stretches that it runs into: {remedy}."
    )
    return Shown(DataFinding("saturated", channel.name, float(where[0][0]), text), Mending())


def _cut_off(y: np.ndarray, end: float) -> list[tuple[int, int]]:
    """Stretches [first, stop) of at least five equal samples at an end, entered and left by slopes
    and not by steps or rests.
    """
    if np.ptp(y) == 0:
        return []
    at = np.concatenate([[False], y == end, [False]])
    edges = np.flatnonzero(np.diff(at.astype(int)))
    span, found = float(np.ptp(y)), []
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        if b - a < 5 or a < 4 or b > len(y) - 4:
            continue
        before, after = np.abs(np.diff(y[a - 4 : a])), np.abs(np.diff(y[b : b + 4]))
        steps = abs(y[a] - y[a - 1]), abs(y[b] - y[b - 1])
        gentle = all(0 < s < 0.1 * span for s in steps)
        # A curve that comes to its top by itself bends there; one that is cut off runs on.
        bends = min(before.mean(), after.mean()) < 0.2 * max(
            np.abs(np.diff(y[max(0, a - 40) : a])).max(), 1e-300
        )
        if gentle and np.all(before > 0) and np.all(after > 0) and not bends:
            found.append((int(a), int(b)))
    return found


def filtered(dataset: Dataset, channel: Channel, step: float) -> Shown | None:
    """Noise that is even up to a frequency and gone above it: a filter, whose delay is the signal's
    too.
    """
    if channel.role != "output" or channel.resolution is not None:
        return None
    ends = [_corner(y, 1 / step) for e, y in series(dataset, channel) if len(y) >= 1000]
    if not ends or any(f is None for f in ends):
        return None
    corner = float(np.median([f for f in ends if f is not None]))
    text = (
        f"the noise of {channel.name} ends at about {corner:.3g} Hz, far below what {1 / step:.4g}"
        " samples a second show: it was filtered. A causal filter delays it by some"
        f" {1 / (2 * pi * corner):.2g} s or more, which is sensor_lag at {channel.name}; how large"
        " its noise is is not known."
    )
    return Shown(DataFinding("filtered", channel.name, corner, text), Mending())


def _corner(y: np.ndarray, rate: float) -> float | None:
    """The frequency above which a flat floor of noise falls by far and stays down, Hz."""
    from scipy.signal import welch

    f, power = welch(np.diff(y, 2), rate, nperseg=min(len(y) // 4, 512))
    shape = (2 - 2 * np.cos(2 * np.pi * f / rate)) ** 2
    level = np.log10(np.maximum(power[1:-1] / shape[1:-1], 1e-300))
    f = f[1:-1]
    # Octaves: motion falls with frequency at first, white noise is flat, a filter ends it.
    smooth = np.convolve(np.pad(level, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    top = smooth[(f > 0.4 * rate) & (f < 0.48 * rate)].mean()
    for k in range(8, len(f)):
        if f[k] > 0.25 * rate:
            break
        flat = smooth[(f >= f[k]) & (f <= 2 * f[k])]
        if len(flat) > 6 and np.ptp(flat) < 0.5 and flat.mean() - top > 1.5:
            last = np.flatnonzero(smooth > flat.mean() - 0.3)[-1]
            return float(f[last]) if f[last] <= 0.25 * rate else None
    return None


def shown(dataset: Dataset, channels: Sequence[Channel]) -> Iterator[Shown]:
    """All that the channels show by themselves; what mends one comes before what is looked for
    next.
    """
    for channel in channels:
        for look in (wrapped, glitch, repeated_rows, saturated):
            if (found := look(dataset, channel)) is not None:
                yield found
        step = float(np.median([np.median(np.diff(e.t)) for e in dataset.experiments]))
        if (found := filtered(dataset, channel, step)) is not None:
            yield found
