"""The noise floor of each output channel: how close to the measurement any model can come.

The largest counts of what is stated (noise and step of the sensor, together where both are), a
quantisation that is found, and the scatter between repeated runs. Where nothing is stated, the
sensor's white noise is estimated from differences of neighbouring samples. Without repeats the
floor is the sensor's alone: what the machine does differently from run to run is not in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import comb, sqrt

import numpy as np

from jaxid.base.wording import names_of
from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.data.repeats import one_way, repeats, together
from jaxid.data.units import si_unit


BLOCK = 50  # samples; the median over blocks keeps impacts and reversals out of the estimate
HELD = 1e-6  # the floor of an output that never moves
_LEAST_SHARE = 1e-9  # of the motion: the floor of data that are free of noise


@dataclass(frozen=True)
class Noise:
    """One standard deviation in `unit`; `source` is "stated", "quantisation", "sensor" or
    "repeatability".
    """

    std: float
    source: str
    unit: str
    text: str


Window = Callable[[Experiment], float]


def noise_floor(
    dataset: Dataset, readings: bool = False, window: Window | None = None
) -> dict[str, Noise]:
    """Output channel -> its noise. Report runs are not looked at unless there is no other run.
    `readings`: without what the machine does differently from run to run, which is motion, too.
    `window`: the length, s, of parts of a run that each have a start of their own; what repeats
    differ by is then what they differ by within one, not what has added up since they began.
    Repeats that change one way, report runs among them, tell no scatter: their drift is none, and
    hides what there is.
    """
    runs = dataset.seen or list(dataset.experiments)
    groups = [] if readings else repeats(runs)
    drifting: set[str] = set()
    if groups:
        for drift in one_way(dataset.experiments):
            drifting |= set(names_of(drift.runs))
    scattered = [g for g in groups if g[0].name not in drifting]
    alone = ""
    if not groups:
        alone = "; the sensor's alone, for no run was repeated"
    elif not scattered:
        alone = "; the sensor's alone, for repeats change one way"
    return {
        channel.name: _floor(channel, i, runs, scattered, window, alone)
        for i, channel in enumerate(dataset.outputs)
    }


def _floor(
    channel: Channel,
    column: int,
    runs: Sequence[Experiment],
    groups: list[list[Experiment]],
    window: Window | None,
    alone: str,
) -> Noise:
    parts: list[tuple[Experiment, np.ndarray]] = []
    for run in runs:
        parts += [(run, at) for at in _evenly(run.read[:, column])]
    series = [run.y[at, column] for run, at in parts]
    found: dict[str, tuple[float, str]] = {}
    if channel.noise_std is not None:
        found["stated"] = _stated(channel.noise_std, channel.resolution)
    step, how = channel.resolution, "stated"
    if step is None:
        step, how = quantisation_step(series), "found in the data"
    if step is not None:
        found["quantisation"] = (
            step / sqrt(12),
            f"step {step:.3g} {channel.unit} / sqrt(12), {how}",
        )
    if channel.noise_std is None and channel.resolution is None and series:
        found["sensor"] = _visible(parts, series, column)
    if groups:
        found["repeatability"] = _between_repeats(groups, channel, column, window)
    if not found:
        text = f"{channel.name}: no run to estimate the noise from"
        return Noise(0.0, "sensor", channel.unit, text)
    source, (std, text) = max(found.items(), key=lambda item: item[1][0])
    motion = max((float(np.ptp(y)) for y in series), default=0.0)
    if std < _LEAST_SHARE * motion and source == "sensor":
        std = _LEAST_SHARE * motion
        text = f"no noise visible, {_LEAST_SHARE:g} of the motion is used"
    if not std > 0:  # an output that never moves, by a reading that never flickers
        std, text = HELD, f"it never moves, {HELD:g} {channel.unit} is used"
    return Noise(
        float(std),
        source,
        channel.unit,
        f"{channel.name}: {std:.3g} {channel.unit} ({text}{alone})",
    )


def _visible(
    parts: Sequence[tuple[Experiment, np.ndarray]], series: Sequence[np.ndarray], column: int
) -> tuple[float, str]:
    """The sensor's noise as the readings show it, beside what is known to scatter them."""
    text = "estimated from differences of neighbouring samples"
    scatter = [run.noise(np.zeros(1), [column])[at, 0] for run, at in parts]
    if any(s.any() for s in scatter):
        return _beside(series, scatter), text
    return sensor_noise(series), text


def _stated(noise: float, step: float | None) -> tuple[float, str]:
    """A stated step comes on top of the noise before it."""
    if step is None:
        return float(noise), "stated"
    text = f"stated: {noise:.3g}, and step {step:.3g} / sqrt(12)"
    return float(np.hypot(noise, step / sqrt(12))), text


def _between_repeats(
    groups: Sequence[list[Experiment]], channel: Channel, column: int, window: Window | None
) -> tuple[float, str]:
    """Root mean square of the scatter of groups of repeated runs, and how it was found."""
    # a start's speed alone, or its position, too
    known = 1 if si_unit(channel.unit) in ("rad/s", "m/s") else 2
    between = []
    for group in groups:
        begins = [] if window is None else edges(group[0], window(group[0]))
        between.append(_scatter(together(group)[..., column], begins, known))
    count = sum(map(len, groups))
    text = f"scatter between {count} runs with identical inputs"
    if window is not None:
        text += f", within windows of {window(groups[0][0]):.3g} s"
    return float(np.sqrt(np.mean(np.square(between)))), text


def _evenly(read: np.ndarray) -> list[np.ndarray]:
    """Indices of the readings [time] that count, in stretches where each is as many samples behind
    the last as usual: differences of neighbours mean something only there.
    """
    at = np.flatnonzero(read)
    if len(at) == len(read) or len(at) < 2:
        return [at]
    stretches = np.split(at, np.flatnonzero(np.diff(at) != np.median(np.diff(at))) + 1)
    return [s for s in stretches if len(s) > 5] or [at]


def sensor_noise(series: Sequence[np.ndarray]) -> float:
    """The standard deviation of white noise on smooth signals `[time]`: third differences, median
    over blocks.

    Where fifth differences give less than half of it, the motion shows in the third ones and the
    fifth are used.
    """
    third, fifth = (_from_differences(series, order) for order in (3, 5))
    return fifth if fifth < 0.5 * third else third


def _from_differences(series: Sequence[np.ndarray], order: int) -> float:
    variances: list[np.ndarray] = []
    for y in series:
        squares = (np.diff(y, order) / sqrt(comb(2 * order, order))) ** 2
        count = max(1, len(squares) // BLOCK)
        length, longer = divmod(len(squares), count)  # the first blocks take what is left over
        at = longer * (length + 1)
        blocks = (
            squares[:at].reshape(longer, length + 1),
            squares[at:].reshape(count - longer, length),
        )
        variances += [b.mean(1) / _median_of_variance(b.shape[1], order) for b in blocks if b.size]
    return sqrt(float(np.median(np.concatenate(variances)))) if variances else 0.0


def _median_of_variance(count: int, order: int) -> float:
    """Median of the mean square of `count` differences of unit variance: that of chi-square over
    its degrees of freedom (Wilson and Hilferty 1931), which correlation of neighbouring differences
    makes fewer than `count`.
    """
    freedom = max(1.0, count * comb(2 * order, order) ** 2 / comb(4 * order, 2 * order))
    return (1 - 2 / (9 * freedom)) ** 3


def _beside(series: Sequence[np.ndarray], scatter: Sequence[np.ndarray]) -> float:
    """The same where each sample `[time]` is off by a known standard deviation beside that noise:
    likeliest variance.
    """
    d = np.concatenate([np.diff(y, 3) ** 2 / comb(6, 3) for y in series])
    known = np.concatenate([s[1 : len(s) - 2] ** 2 for s in scatter])
    variance = float(np.mean(d))
    for _ in range(30):
        weight = 1 / (variance + known) ** 2
        variance = max(float(np.sum(weight * (d - known)) / np.sum(weight)), 1e-2 * variance)
    return sqrt(variance)


#: This many values of a long series show whether it may be quantised at all, and the share of
#: distances on a grid that they need.
FIRST, MAYBE = 20_000, 0.3


def quantisation_step(series: Sequence[np.ndarray]) -> float | None:
    """The step of a quantised signal, or None: every distance of distinct values is then a multiple
    of one step.
    """
    values = np.concatenate([np.zeros(0), *(np.asarray(y, dtype=float) for y in series)])
    if len(values) > 4 * FIRST:
        first = _grid_of(values[:FIRST])
        if first is not None and first[2] < MAYBE:
            return None
    found = _grid_of(values)
    if found is None:
        return None
    step, enough, on_grid = found
    return step if enough and on_grid > 0.99 else None


def possible_step(values: np.ndarray) -> float | None:
    """The step that readings [time] may be rounded to, or None where some do not fit it. Unlike
    `quantisation_step` it asks for no number of readings: what it gives is not ruled out.
    """
    found = _grid_of(np.asarray(values, dtype=float))
    if found is None:
        return None
    step, _, on_grid = found
    return step if on_grid > 0.99 else None


def _grid_of(values: np.ndarray) -> tuple[float, bool, float] | None:
    """Smallest distance of distinct values, whether there are values enough to call it a step, and
    the share of distances that are multiples of it; None where there are too few.
    """
    distinct = np.unique(values)
    if len(distinct) < 3:
        return None
    spacing = np.diff(distinct)
    rounding = 1000 * np.finfo(float).eps * float(np.max(np.abs(distinct)))
    # The same code may come out of a conversion as two floats: such a pair is no step.
    spacing = spacing[spacing > rounding]
    if len(spacing) < 2:
        return None
    smallest = spacing[spacing < 1.5 * spacing.min()]
    step = float(np.mean(smallest))
    multiple = spacing / step
    on_grid = np.abs(multiple - np.round(multiple)) < 0.05
    # Repeated values speak for a step; so do many distances of several steps (one step each is but
    # steady motion).
    enough = bool(len(distinct) <= len(values) / 2 or np.count_nonzero(multiple > 1.5) >= 12)
    return step, enough, float(on_grid.mean())


def edges(e: Experiment, length: float) -> np.ndarray:
    """Where windows of `length` s begin: indices of samples; the last one goes on to the end of the
    run.
    """
    return np.searchsorted(e.t, np.arange(e.t[0], e.t[-1] - 0.5 * length, length))


def _scatter(repeated: np.ndarray, begins: Sequence[int] | np.ndarray, known: int) -> float:
    """Standard deviation between repeats [runs time]; within windows that begin there, what the
    start of each tells (a line, for a position; its value, for a speed: `known` numbers) taken off.
    """
    variances = np.var(repeated, axis=0, ddof=1)
    if not len(begins):
        return sqrt(float(np.mean(variances)))
    apart = repeated - repeated.mean(0)
    squares, freedom = 0.0, 0
    for part in np.split(apart, [i for i in begins[1:] if i < apart.shape[1]], axis=1):
        n = part.shape[1]
        if n > known:
            start = np.vander(np.linspace(-1, 1, n), known)
            rest = part.T - start @ np.linalg.lstsq(start, part.T, rcond=None)[0]
            squares += float(np.sum(rest**2))
            freedom += (n - known) * (len(part) - 1)
    return sqrt(squares / freedom) if freedom else sqrt(float(np.mean(variances)))
