"""From a table to checked runs and frequency responses: columns, selection, samples, time, gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from jaxid.data.dataset import Channel, Experiment, FrequencyResponse, StatedChannel
from jaxid.data.forms import FormError, Signal, signal
from jaxid.data.sample_faults import sample_faults, without_time
from jaxid.data.schema import ChannelEntry, ExperimentEntry
from jaxid.data.table import ragged_rows, Table
from jaxid.data.time_axis import contradicted, impossible, seconds
from jaxid.data.units import Conversion
from jaxid.errors import DatasetProblem, nearest


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


@dataclass
class Harvest:
    """What one entry of `[[experiments]]` gave."""

    experiments: list[Experiment] = field(default_factory=list)
    responses: list[FrequencyResponse] = field(default_factory=list)
    problems: list[DatasetProblem] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    still: dict[str, DatasetProblem] = field(
        default_factory=dict
    )  # output channels that never move, with the words for it
    moving: set[str] = field(default_factory=set)
    still_inputs: set[str] = field(default_factory=set)


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
    index = _selected(table, entry, harvest)
    clock = table.find(time)
    if index is None or clock is None:
        return harvest
    index, torn = _readable(table, index, harvest)
    counted = table.numbers(clock).values
    if (why := contradicted(counted, time_unit)) is not None:
        row = table.row(int(index[0])) if len(index) else None
        harvest.problems.append(
            DatasetProblem(table.file, row, clock, why[0], f'Say time_unit = "{why[1]}"')
        )
        return harvest
    t, said = seconds(table.columns[clock], counted, time_unit)
    time_faults = (
        without_time(table, clock, t, index) if said else sample_faults(table, clock, index)
    )
    harvest.problems += time_faults
    if said:
        harvest.notes.append(f"{table.file}: {said}")
    if len(index) == 0:
        return harvest
    if entry.window_s is not None:
        if time_faults or torn:
            return harvest  # which samples the window holds is not known
        start, stop = entry.window_s
        span = t[index[[0, -1]]]
        index = index[(t[index] >= start) & (t[index] < stop)]
        if len(index) == 0:
            message = (
                f"no sample lies in window_s = [{start:g}, {stop:g}]; time runs from {span[0]:g} to"
                f" {span[1]:g} s"
            )
            harvest.problems.append(
                DatasetProblem(table.file, None, clock, message, "Correct window_s")
            )
            return harvest
    doubted = (
        None
        if time_unit is not None or said or time_faults or torn
        else impossible(t[index], clock)
    )
    if doubted is not None:
        harvest.problems.append(
            DatasetProblem(table.file, table.row(int(index[0])), clock, *doubted)
        )
    signals = {
        r.name: _channel(table, r, index, t[index], harvest) for r in readings if _there(table, r)
    }
    if len(index) < MINIMUM_SAMPLES and not torn:
        message = (
            f"{len(index)} samples in experiment {name!r}; fewer than {MINIMUM_SAMPLES} say too"
            " little"
        )
        harvest.problems.append(
            DatasetProblem(table.file, None, None, message, "Record or select a longer run")
        )
    cuts = (
        None
        if time_faults or doubted or torn
        else _time(table, entry, name, clock, index, t[index], harvest)
    )
    if harvest.problems or table.problems or cuts is None:
        return harvest
    whole = {k: v for k, v in signals.items() if v is not None}
    known, cuts = _known_span(table, name, whole, cuts, harvest)
    if known is None:
        return harvest
    values = {k: v.values[known] for k, v in whole.items()}
    outputs = [r for r in readings if r.entry.role == "output"]
    run = Experiment(
        name=name,
        split=entry.split,
        t=t[index][known],
        u=_stack(values, readings, "input", len(index[known])),
        y=_stack(values, readings, "output", len(index[known])),
        auxiliary={r.name: values[r.name] for r in readings if r.entry.role == "auxiliary"},
        initial=None if entry.initial is None else dict(entry.initial),
        at_rest=entry.at_rest,
        constants={k: float(v) for k, v in entry.constants.items()},
        initial_window_s=entry.initial_window_s,
        source=f"{table.file}, {_span(table, index[known])}",
        left_out=np.stack([whole[r.name].left_out[known] for r in outputs], 1) if outputs else None,
        repeat_of=entry.repeat_of,
    )
    harvest.experiments += _pieces(run, cuts, harvest, table)
    return harvest


def _absent(
    table: Table, readings: Sequence[ChannelReading], time: str | int
) -> list[DatasetProblem]:
    """Columns that are named and not there, or there twice."""
    wanted = [(time, "the time")]
    wanted += [
        (c, f"channel {r.name!r}" if c != r.name else "this channel")
        for r in readings
        for c in r.reads
    ]
    problems = []
    for column, role in wanted:
        if (twice := table.ambiguous(column)) is not None:
            problems.append(twice)
        elif table.find(column) is None:
            problems.append(table.missing(column, role))
    twice = [p for p in problems if "stands twice" in p.message]
    return list(
        dict.fromkeys(twice or problems)
    )  # what is lacking beside is the one with the wrong name


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


def _span(table: Table, index: np.ndarray) -> str:
    word = "rows" if table.rows is not None else "indices"
    return f"{word} {table.row(index[0])} to {table.row(index[-1])}"


def _stack(
    columns: dict[str, np.ndarray], readings: Sequence[ChannelReading], role: str, count: int
) -> np.ndarray:
    chosen = [columns[r.name] for r in readings if r.entry.role == role]
    out = np.stack(chosen, axis=1) if chosen else np.zeros((count, 0))
    out.setflags(write=False)  # so that a run takes it as it is
    return out


def _selected(table: Table, entry: ExperimentEntry, harvest: Harvest) -> np.ndarray | None:
    """The samples that `where` and `rows` choose (both count in the file's own samples)."""
    mask = np.ones(table.count, dtype=bool)
    for column, value in entry.where.items():
        if column not in table.columns:
            message = f"there is no column {column!r} for `where`{nearest(column, table.columns)}"
            harvest.problems.append(
                DatasetProblem(table.file, 1, column, message, "Name a column that exists")
            )
            return None
        chosen = table.equal(column, value)
        if not chosen.any():
            found = list(dict.fromkeys(str(c) for c in table.columns[column]))[:30]
            message = f"no row has {column} = {value!r}{nearest(str(value), found)}"
            harvest.problems.append(
                DatasetProblem(table.file, None, column, message, "Correct `where`")
            )
            return None
        mask &= chosen
    if entry.rows is not None:
        start, stop = entry.rows
        if stop > table.count:
            message = f"rows = [{start}, {stop}] reach beyond the {table.count} samples of the file"
            harvest.problems.append(
                DatasetProblem(
                    table.file, None, None, message, "Correct `rows` (half-open, from 0)"
                )
            )
            return None
        mask[:start] = mask[stop:] = False
    index = np.flatnonzero(mask)
    if len(index) == 0:
        if table.count or not table.problems:
            message = "no sample is selected by `where` and `rows` together"
            harvest.problems.append(
                DatasetProblem(table.file, None, None, message, "Correct `where` or `rows`")
            )
        return None
    return index


def _readable(table: Table, index: np.ndarray, harvest: Harvest) -> tuple[np.ndarray, bool]:
    """The selected samples whose rows have a field for each column; whether there are others, which
    is a problem.
    """
    good = ~np.isin(index, list(table.ragged))
    if good.all():
        return index, False
    torn = {k: table.ragged[k] for k in index[~good].tolist()}
    rows = table.rows if table.rows is not None else np.arange(table.count)
    harvest.problems.append(ragged_rows(table.file, rows.tolist(), torn, len(table.columns)))
    return index[good], True


def _channel(
    table: Table, reading: ChannelReading, index: np.ndarray, t: np.ndarray, harvest: Harvest
) -> Signal | None:
    """The channel's samples in SI. Notes whether it moves."""
    entry = reading.entry
    valid = np.ones(len(index), bool)
    if entry.valid is not None and (found := table.find(entry.valid)) is not None:
        valid = np.nan_to_num(table.numbers(found).values[index]) != 0
    columns = [c for c in map(table.find, reading.columns) if c is not None]
    faults = [f for c in columns for f in sample_faults(table, c, index[valid])]
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
        harvest.problems.append(
            DatasetProblem(
                table.file, table.row(first), columns[0], text, "Correct scale, offset or unit"
            )
        )
        return None
    still = np.ptp(values[~found.left_out]) == 0
    if reading.entry.role == "output" and not still:
        harvest.moving.add(reading.name)
    elif reading.entry.role == "output":
        constant = f"it is {values[0]:g} {reading.conversion.si} in all {len(index)} samples"
        text = f"output {reading.name!r} never moves: {constant}"
        harvest.still[reading.name] = DatasetProblem(
            table.file,
            None,
            columns[0],
            text,
            'Check the sensor, or give the channel role = "auxiliary"',
        )
    elif reading.entry.role == "input" and still:
        harvest.still_inputs.add(reading.name)
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


def read_response(
    table: Table, entry: ExperimentEntry, name: str, units: dict[str, Conversion]
) -> Harvest:
    """A frequency response `output / input`, from the units of the two channels to SI."""
    harvest = Harvest()
    named = {
        key: entry.columns.get(key, key)
        for key in ("omega", "frequency", "gain", "phase", "re", "im")
    }

    def there(key: str) -> bool:
        return key in entry.columns or named[key] in table.columns

    axis = "frequency" if there("frequency") and not there("omega") else "omega"
    polar = there("gain") or there("phase") or not (there("re") or there("im"))
    keys = [axis, *(("gain", "phase") if polar else ("re", "im"))]
    absent = [key for key in keys if named[key] not in table.columns]
    harvest.problems += [
        table.missing(named[key], f"{key!r} of the frequency response") for key in absent
    ]
    index = _selected(table, entry, harvest)
    if index is None:
        return harvest
    index, _ = _readable(table, index, harvest)
    for key in keys:
        if key not in absent:
            harvest.problems += sample_faults(table, named[key], index)
    if harvest.problems or table.problems:
        return harvest
    first, a, b = (table.numbers(named[key]).values[index] for key in keys)
    for key, values, bad in (
        (keys[0], first, first <= 0),
        *([(keys[1], a, a < 0)] if polar else []),
    ):
        if bad.any():
            sample = int(index[np.flatnonzero(bad)[0]])
            least = "above 0" if key == keys[0] else "at least 0"
            text = f"{table.place(sample)} is {values[bad][0]:g}; {key} must be {least}"
            harvest.problems.append(
                DatasetProblem(
                    table.file, table.row(sample), named[key], text, "Correct or remove the row"
                )
            )
    if harvest.problems:
        return harvest
    factor = units[entry.output or ""].factor / units[entry.input or ""].factor
    phase = np.deg2rad(b) if entry.phase_unit == "deg" else b
    response = a * np.exp(1j * phase) if polar else a + 1j * b
    harvest.responses.append(
        FrequencyResponse(
            name=name,
            split=entry.split,
            omega=first if axis == "omega" else 2 * np.pi * first,
            response=factor * response,
            input=entry.input or "",
            output=entry.output or "",
            source=f"{table.file}, {_span(table, index)}",
        )
    )
    return harvest
