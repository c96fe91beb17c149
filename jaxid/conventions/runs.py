"""What whole runs show by themselves: their time axis, a start that is no rest, channels and parts
that do not move.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxid.base.errors import DatasetError
from jaxid.conventions.finding import DataFinding
from jaxid.conventions.mending import Mending
from jaxid.conventions.samples import series, Shown
from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.data.noise import Noise


#: Sampling steps that recordings of machines do not have in seconds, but have in other units: a row
#: number, ms, us.
SLOW = 0.5
#: A start at rest is refuted by a speed of this many standard deviations and that share of the
#: run's own.
SURE, SHARE = 8.0, 0.02
#: It shows within this many seconds, and is that share of the speed soon after.
SOON, ALREADY = 0.015, 0.8
#: A channel that spans less than this many standard deviations of its noise does not move.
FLICKER = 8.0


def refused(error: DatasetError) -> list[DataFinding]:
    """What a dataset was refused for as findings: a time that cannot be in seconds, outputs that
    never move; else none.
    """
    out = []
    for p in error.problems:
        if "time_unit =" in f"{p.message}{p.remedy}":
            source = p.message if "time_unit =" in p.message else p.remedy
            unit = source.split('time_unit = "')[1].split('"')[0]
            out.append(
                DataFinding(
                    "time_unit",
                    p.column or "t",
                    None,
                    f"{p.file}: {p.message}",
                    f'time_unit = "{unit}"',
                )
            )
        elif "never moves" in p.message:
            name = p.message.split("'")[1]
            out.append(
                DataFinding("does_not_move", name, 0.0, f"{p.file}: {p.message}. {p.remedy}")
            )
    each = {(f.kind, f.channel, f.line): f for f in reversed(out)}
    return list(reversed(each.values())) if len(out) == len(error.problems) else []


def time_unit(dataset: Dataset) -> Iterator[Shown]:
    """A step that is no machine's in seconds."""
    steps = [float(np.median(np.diff(e.t))) for e in dataset.experiments]
    step = float(np.median(steps)) if steps else 0.0
    if step < SLOW:
        return
    even = all(np.allclose(np.diff(e.t), step, rtol=1e-9, atol=0) for e in dataset.experiments)
    what = "a row number, or milliseconds" if even and step == 1.0 else "milliseconds"
    text = f"The median step is {step:.4g} s, {1 / step:.3g} samples a second: is t {what}?"
    yield Shown(DataFinding("time_unit", "t", step, text, 'time_unit = "ms"'), Mending())


def not_at_rest(dataset: Dataset, noise: dict[str, Noise]) -> Iterator[Shown]:
    """`at_rest = true` of runs whose first samples move."""
    worst: tuple[float, float, str, Experiment] | None = None
    for k, c in enumerate(dataset.outputs):
        if c.unit not in ("rad", "m"):
            continue
        for e in dataset.experiments:
            if not e.at_rest or len(e) < 40:
                continue
            speed, sure, usual = _first_speed(e.t, e.y[:, k], noise[c.name].std)
            if sure > SURE and abs(speed) > SHARE * usual and (worst is None or sure > worst[0]):
                worst = sure, speed, c.name, e
    if worst is None:
        return
    _, speed, name, e = worst
    unit = next(c.unit for c in dataset.outputs if c.name == name)
    text = (
        f"at_rest = true, but {name} moves at {speed:.3g} {unit}/s when {e.name} begins: remove"
        " at_rest, or state the speed."
    )
    yield Shown(
        DataFinding(
            "not_at_rest",
            name,
            float(speed),
            text,
            "at_rest = false",
            decisive=True,
            headline=f"{e.name} does not begin at rest; everything below estimates how runs begin",
        ),
        Mending(moving=True),
    )


def _first_speed(t: np.ndarray, y: np.ndarray, noise: float) -> tuple[float, float, float]:
    """Speed over the first rows that show one, how many standard deviations it is from rest, and
    the run's usual speed.

    From rest, the same time again brings three times as much, and twice as much where a drive soon
    runs at its speed; a joint that moves already goes as far again.
    """
    usual = float(np.percentile(np.abs(np.gradient(y, t)), 95))
    soon = max(
        SOON, 1.5 * float(np.median(np.diff(t)))
    )  # a row that comes after a gap says nothing of the start
    for k in (k for k in (1, 2, 3, 4, 6, 8, 12, 16) if 3 * k < len(y) and t[k] - t[0] <= soon):
        first, again, third = np.diff(np.interp(t[0] + (t[k] - t[0]) * np.arange(4), t, y))
        sure = abs(first) / (np.sqrt(2) * max(noise, 1e-300))
        if sure > SURE:
            steady = (
                first * again > 0
                and first * third > 0
                and abs(first) > ALREADY * max(abs(again), abs(third))
            )
            return (float(first / (t[k] - t[0])), sure, usual) if steady else (0.0, 0.0, usual)
    return 0.0, 0.0, usual


def does_not_move(dataset: Dataset, noise: dict[str, Noise]) -> Iterator[Shown]:
    """Runs in which an output only flickers, and runs that come to rest long before they end."""
    for c in dataset.outputs:
        floor = max(noise[c.name].std, 1e-12)
        flicker = [e.name for e, y in series(dataset, c) if len(y) and np.ptp(y) < FLICKER * floor]
        if flicker:
            several = len(flicker) > 1
            text = (
                f"{c.name} does not move in"
                f" {', '.join(flicker[:4])}{' …' if len(flicker) > 4 else ''}: its readings flicker"
                f" by no more than its noise ({floor:.2g} {c.unit}). Leave"
                f" {'these runs' if several else 'this run'} out, or record motion."
            )
            yield Shown(DataFinding("does_not_move", c.name, 0.0, text), Mending())
    ends = [
        (e, end)
        for e in dataset.experiments
        if (end := _moves_until(dataset, e, noise)) is not None
    ]
    for e, end in ends[:3]:
        start = float(e.t[0])
        share = (e.t[-1] - end) / e.duration
        text = (
            f"{e.name} stands still from {end:.3g} s on, {100 * share:.0f} % of it: what is kept"
            " from its end for choosing and reporting says nothing. Take the part that moves, or"
            " record on."
        )
        yield Shown(
            DataFinding("does_not_move", e.name, end, text, f"window_s = [{start:.4g}, {end:.4g}]"),
            Mending(),
        )


def _moves_until(dataset: Dataset, e: Experiment, noise: dict[str, Noise]) -> float | None:
    """When everything has come to rest for good, s, where that is before the last 40 % of a run;
    else None.
    """
    last = 0
    for k, c in enumerate(dataset.outputs):
        y = e.motion()[:, k]
        if c.unit not in ("rad", "m"):
            return None
        floor = max(noise[c.name].std, c.resolution or 0.0)
        away = np.flatnonzero(
            np.abs(y - np.median(y[-max(5, len(y) // 20) :])) > max(6 * floor, 1e-4 * np.ptp(y))
        )
        last = max(last, int(away[-1]) if len(away) else 0)
    return float(e.t[min(last + 1, len(e) - 1)]) if 0 < last < 0.6 * len(e) else None


def constant_inputs(dataset: Dataset) -> Iterator[Shown]:
    """Inputs that are one number in every run."""
    for c in dataset.inputs:
        values = [v for _, v in series(dataset, c)]
        if values and c.unit != "1" and np.ptp(np.concatenate(values)) == 0:
            text = (
                f"input {c.name} is {values[0][0]:.4g} {c.unit} in every sample: nothing of its law"
                " can be told. Vary it."
            )
            yield Shown(DataFinding("does_not_move", c.name, float(values[0][0]), text), Mending())


def outputs_first(dataset: Dataset) -> list[Channel]:
    return sorted(dataset.channels, key=lambda c: ("output", "input", "auxiliary").index(c.role))
