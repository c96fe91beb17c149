"""From a table to checked runs and frequency responses: columns, selection, samples, time, gaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.base.errors import DatasetProblem
from jaxid.data.experiment import Channel, Experiment, StatedChannel
from jaxid.data.forms import FormError, Signal, signal
from jaxid.data.harvest import Harvest, readable, selected, span_text
from jaxid.data.sample_faults import sample_faults, without_time
from jaxid.data.schema import ChannelEntry, ExperimentEntry
from jaxid.data.table import Table
from jaxid.data.time_axis import contradicted, impossible, seconds
from jaxid.data.units import Conversion


MINIMUM_SAMPLES = 20
GAP, LONG_STEP = 20.0, 5.0  # in medians of the time step


@dataclass(frozen=True)
class ChannelReading:
    """How a channel is read: its columns and forms (`jaxid.data.forms`), and the conversion of its
    unit to SI.
    """

    name: str
    entry: ChannelEntry
    conversion: Conversion

    @property
    def column(self) -> str | int:
        return self.columns[0]

    @property
    def columns(self) -> list[str | int]:
        """The columns that it is made of."""
        if self.entry.columns is not None:
            return self.entry.columns
        return [self.entry.column if self.entry.column is not None else self.name]

    @property
    def reads(self) -> list[str | int]:
        """The columns that it looks at."""
        return self.columns + ([self.entry.valid] if self.entry.valid is not None else [])

    @property
    def channel(self) -> Channel:
        def width(value: float | None) -> float | None:
            return None if value is None else value * self.conversion.factor

        entry = self.entry
        column = "" if entry.columns is not None else str(self.column)
        stated = StatedChannel(
            unit=entry.unit,
            factor=self.conversion.factor,
            scale=entry.scale,
            offset=entry.offset,
            column=column,
            shift=entry.shift,
            clock_ppm=entry.clock_ppm,
            delay_s=entry.delay_s,
        )
        noise, step = width(entry.noise_std), width(entry.resolution)
        return Channel(self.name, entry.role, self.conversion.si, noise, step, entry.hold, stated)


def read_record(
    table: Table,
    entry: ExperimentEntry,
    name: str,
    readings: Sequence[ChannelReading],
    time: str | int,
    time_unit: str | None = None,
) -> Harvest:
    """One recorded run (several where it is split at gaps), or what is wrong with it."""
    harvest = Harvest()
    harvest.problems += _absent(table, readings, time)
    index = selected(table, entry, harvest)
    clock = table.find(time)
    if index is None or clock is None:
        return harvest
    index, torn = readable(table, index, harvest)
    times = _times(table, clock, index, time_unit, harvest)
    if times is None:
        return harvest
    sound = not (times.faulty or torn)
    if entry.window_s is not None:
        if not sound:
            return harvest  # which samples the window holds is not known
        index = _in_window(table, entry.window_s, clock, index, times.t, harvest)
    if len(index) == 0:
        return harvest
    t = times.t[index]
    if sound and not times.certain:
        doubted = _doubted(table, clock, index, t)
        harvest.problems += doubted
        sound = not doubted
    signals = _signals(table, readings, index, t, harvest)
    if not torn:
        harvest.problems += _too_few(table, len(index), name)
    cuts = _time(table, entry, name, clock, index, t, harvest) if sound else None
    if harvest.problems or table.problems or cuts is None:
        return harvest
    known, cuts = _known_span(table, name, signals, cuts, harvest)
    if known is not None:
        source = f"{table.file}, {span_text(table, index[known])}"
        run = _run(entry, name, readings, signals, t, known, source)
        harvest.experiments += _pieces(run, cuts, harvest, table)
    return harvest


def _signals(
    table: Table,
    readings: Sequence[ChannelReading],
    index: np.ndarray,
    t: np.ndarray,
    harvest: Harvest,
) -> dict[str, Signal]:
    """The channels that are whole, in SI."""
    signals = {}
    for reading in readings:
        if not _there(table, reading):
            continue
        found = _channel(table, reading, index, t, harvest)
        if found is not None:
            signals[reading.name] = found
    return signals


@dataclass(frozen=True)
class _Times:
    """`t [time]` s of all rows of a table; whether selected rows have none; whether their unit is
    stated or written with them.
    """

    t: np.ndarray
    faulty: bool
    certain: bool


def _times(
    table: Table, clock: str, index: np.ndarray, time_unit: str | None, harvest: Harvest
) -> _Times | None:
    """The times of a table, or None where its unit contradicts them or no row is selected."""
    counted = table.numbers(clock).values
    contradiction = contradicted(counted, time_unit)
    if contradiction is not None:
        why, unit = contradiction
        row = table.row(int(index[0])) if len(index) else None
        remedy = f'Say time_unit = "{unit}"'
        harvest.problems.append(DatasetProblem(table.file, row, clock, why, remedy))
        return None
    t, read_as = seconds(table.columns[clock], counted, time_unit)
    if read_as:
        faults = without_time(table, clock, t, index)
        harvest.notes.append(f"{table.file}: {read_as}")
    else:
        faults = sample_faults(table, clock, index)
    harvest.problems += faults
    if len(index) == 0:
        return None
    return _Times(t, faulty=bool(faults), certain=bool(read_as) or time_unit is not None)


def _doubted(table: Table, clock: str, index: np.ndarray, t: np.ndarray) -> list[DatasetProblem]:
    """A problem where times [selected] cannot be in the unit in which they were read."""
    doubt = impossible(t, clock)
    if doubt is None:
        return []
    return [DatasetProblem(table.file, table.row(int(index[0])), clock, *doubt)]


def _too_few(table: Table, count: int, name: str) -> list[DatasetProblem]:
    if count >= MINIMUM_SAMPLES:
        return []
    message = f"{count} samples in experiment {name!r}; fewer than {MINIMUM_SAMPLES} say too little"
    return [DatasetProblem(table.file, None, None, message, "Record or select a longer run")]


def _in_window(
    table: Table,
    window: Sequence[float],
    clock: str,
    index: np.ndarray,
    t: np.ndarray,
    harvest: Harvest,
) -> np.ndarray:
    """The samples within a window [s, s)."""
    start, stop = window
    inside = index[(t[index] >= start) & (t[index] < stop)]
    if len(inside) == 0:
        first, last = t[index[[0, -1]]]
        message = (
            f"no sample lies in window_s = [{start:g}, {stop:g}]; time runs from {first:g} to"
            f" {last:g} s"
        )
        harvest.problems.append(
            DatasetProblem(table.file, None, clock, message, "Correct window_s")
        )
    return inside


def _run(
    entry: ExperimentEntry,
    name: str,
    readings: Sequence[ChannelReading],
    signals: Mapping[str, Signal],
    t: np.ndarray,
    known: slice,
    source: str,
) -> Experiment:
    """A run of the samples at which every channel has a value."""
    t = t[known]
    values = {channel: s.values[known] for channel, s in signals.items()}
    left_out = [signals[r.name].left_out[known] for r in readings if r.entry.role == "output"]
    return Experiment(
        name=name,
        split=entry.split,
        t=t,
        u=_stack(values, readings, "input", len(t)),
        y=_stack(values, readings, "output", len(t)),
        auxiliary={r.name: values[r.name] for r in readings if r.entry.role == "auxiliary"},
        initial=None if entry.initial is None else dict(entry.initial),
        at_rest=entry.at_rest,
        constants={k: float(v) for k, v in entry.constants.items()},
        initial_window_s=entry.initial_window_s,
        source=source,
        left_out=np.stack(left_out, 1) if left_out else None,
        repeat_of=entry.repeat_of,
    )


def _absent(
    table: Table, readings: Sequence[ChannelReading], time: str | int
) -> list[DatasetProblem]:
    """Columns that are named and not there, or there twice."""
    wanted = [(time, "the time")]
    for reading in readings:
        for column in reading.reads:
            role = "this channel" if column == reading.name else f"channel {reading.name!r}"
            wanted.append((column, role))
    twice, missing = [], []
    for column, role in wanted:
        ambiguous = table.ambiguous(column)
        if ambiguous is not None:
            twice.append(ambiguous)
        elif table.find(column) is None:
            missing.append(table.missing(column, role))
    # what is lacking beside is the one with the wrong name
    return list(dict.fromkeys(twice or missing))


def _there(table: Table, reading: ChannelReading) -> bool:
    return all(table.find(c) is not None for c in reading.reads)


def _known_span(
    table: Table, name: str, signals: dict[str, Signal], cuts: list[int], harvest: Harvest
) -> tuple[slice | None, list[int]]:
    """The samples between the first and the last at which every channel has a value, and where to
    cut among them.
    """
    known = (
        np.all([s.known for s in signals.values()], axis=0)
        if signals
        else np.ones(table.count, bool)
    )
    there = np.flatnonzero(known)
    if len(there) < MINIMUM_SAMPLES:
        message = (
            f"shifted against one another, the channels of {name!r} have {len(there)} samples in"
            " common"
        )
        harvest.problems.append(
            DatasetProblem(
                table.file, None, None, message, "Correct `shift`, `delay_s` or `clock_ppm`"
            )
        )
        return None, []
    first, end = int(there[0]), int(there[-1]) + 1
    if (lost := len(known) - (end - first)) > 0:
        where = f"{name}: {lost} sample{'s' * (lost > 1)} at the ends left out"
        harvest.notes.append(f"{where}, where a shifted channel has no value")
    for channel, s in signals.items():
        if count := int(np.sum(s.left_out)):
            harvest.notes.append(
                f"{name}: {count} of {len(s.left_out)} samples of {channel} left out of the loss"
            )
        if s.held:
            harvest.notes.append(
                f"{name}: {s.held} of {len(s.values)} samples of {channel} not taken; the last good"
                " one holds there"
            )
    return slice(first, end), [c - first for c in cuts if first < c < end]


def _stack(
    columns: dict[str, np.ndarray], readings: Sequence[ChannelReading], role: str, count: int
) -> np.ndarray:
    chosen = [columns[r.name] for r in readings if r.entry.role == role]
    out = np.stack(chosen, axis=1) if chosen else np.zeros((count, 0))
    out.setflags(write=False)  # so that a run takes it as it is
    return out


def _channel(
    table: Table, reading: ChannelReading, index: np.ndarray, t: np.ndarray, harvest: Harvest
) -> Signal | None:
    """The channel's samples in SI. Notes whether it moves."""
    entry = reading.entry
    valid = np.ones(len(index), bool)
    if entry.valid is not None and (found := table.find(entry.valid)) is not None:
        valid = np.nan_to_num(table.numbers(found).values[index]) != 0
    columns = [c for c in map(table.find, reading.columns) if c is not None]
    faults: list[DatasetProblem] = []
    for column in columns:
        faults += sample_faults(table, column, index[valid])
    harvest.problems += faults
    weights = entry.weights if entry.weights is not None else [1.0]
    raw = np.sum(
        [w * table.numbers(c).values[index] for w, c in zip(weights, columns, strict=True)], axis=0
    )
    raw[~valid & ~np.isfinite(raw)] = 0.0  # an empty cell where nothing is read
    if faults:
        harvest.moving.add(reading.name)
        return None
    try:
        found = signal(raw, t, valid, entry, reading.conversion)
    except FormError as error:
        text = f"channel {reading.name!r}: {error}"
        harvest.problems.append(DatasetProblem(table.file, None, columns[0], text, error.remedy))
        return None
    values = found.values
    if not np.isfinite(values).all():
        first = int(index[np.flatnonzero(~np.isfinite(values))[0]])
        text = f"{table.place(first)} is too large after scale, offset and unit"
        remedy = "Correct scale, offset or unit"
        harvest.problems.append(
            DatasetProblem(table.file, table.row(first), columns[0], text, remedy)
        )
        return None
    still = np.ptp(values[~found.left_out]) == 0
    if entry.role == "input" and still:
        harvest.still_inputs.add(reading.name)
    elif entry.role == "output" and not still:
        harvest.moving.add(reading.name)
    elif entry.role == "output":
        constant = f"it is {values[0]:g} {reading.conversion.si} in all {len(index)} samples"
        text = f"output {reading.name!r} never moves: {constant}"
        remedy = 'Check the sensor, or give the channel role = "auxiliary"'
        harvest.still[reading.name] = DatasetProblem(table.file, None, columns[0], text, remedy)
    return found


def _time(
    table: Table,
    entry: ExperimentEntry,
    name: str,
    column: str,
    index: np.ndarray,
    t: np.ndarray,
    harvest: Harvest,
) -> list[int] | None:
    """Where to cut the run (sample positions after a gap), or None where time is at fault."""
    step = np.diff(t)
    back = np.flatnonzero(step <= 0)
    if len(back):
        sample = int(index[back[0] + 1])
        what = "stands still" if step[back[0]] == 0 else "runs backwards"
        text = (
            f"time {what} at {table.place(sample)}: {float(t[back[0] + 1])!r} s after"
            f" {float(t[back[0]])!r} s"
        )
        if len(back) > 1:
            text += f"; {len(back)} times in all"
        remedy = "Give increasing times, or choose one run of the file with `where` or `rows`"
        harvest.problems.append(DatasetProblem(table.file, table.row(sample), column, text, remedy))
        return None
    if len(step) == 0:
        return []
    median = float(np.median(step))
    gaps = np.flatnonzero(step > GAP * median)
    if len(gaps) and not entry.split_at_gaps:
        sample = int(index[gaps[0] + 1])
        width = step[gaps[0]]
        text = (
            f"a gap of {width:.4g} s before {table.place(sample)}, {width / median:.0f} median"
            f" steps of {median:.4g} s"
        )
        if len(gaps) > 1:
            text += f"; {len(gaps)} gaps in all"
        remedy = "Choose a part with `rows` or `window_s`, or say split_at_gaps = true"
        harvest.problems.append(DatasetProblem(table.file, table.row(sample), column, text, remedy))
        return None
    long = np.flatnonzero((step > LONG_STEP * median) & (step <= GAP * median))
    if len(long):
        worst = long[np.argmax(step[long])]
        harvest.warnings.append(
            f"{name}: {len(long)} time step{'s' * (len(long) > 1)} over {LONG_STEP:g} medians"
            f" ({median:.4g} s), the longest {step[worst]:.4g} s before"
            f" {table.place(int(index[worst + 1]))} of {table.file}"
        )
    return [int(g) + 1 for g in gaps]


def _pieces(run: Experiment, cuts: list[int], harvest: Harvest, table: Table) -> list[Experiment]:
    if not cuts:
        return [run]
    edges = [0, *cuts, len(run)]
    spans = [(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    pieces = [
        run.piece(a, b, name=f"{run.name}#{number}", split=run.split)
        for number, (a, b) in enumerate(spans, 1)
        if b - a >= MINIMUM_SAMPLES
    ]
    dropped = len(spans) - len(pieces)
    if not pieces:
        message = (
            f"split at its gaps, experiment {run.name!r} has no part of {MINIMUM_SAMPLES} samples"
        )
        harvest.problems.append(
            DatasetProblem(table.file, None, None, message, "Record without gaps")
        )
    harvest.notes.append(
        f"{run.name}: split at {len(cuts)} gap{'s' * (len(cuts) > 1)} into {len(pieces)} runs"
        + (f"; {dropped} shorter than {MINIMUM_SAMPLES} samples left out" if dropped else "")
    )
    return pieces
