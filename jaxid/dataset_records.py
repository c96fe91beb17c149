"""From a table to checked runs and frequency responses: columns, selection, samples, time, gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from jaxid.dataset_schema import ChannelEntry, ExperimentEntry
from jaxid.dataset_table import Table
from jaxid.errors import nearest
from jaxid.experiment import Channel, Experiment, FrequencyResponse, Problem
from jaxid.units import Conversion


MINIMUM_SAMPLES = 20
GAP, LONG_STEP = 20.0, 5.0  # in medians of the time step


@dataclass(frozen=True)
class Reading:
    """How a channel is read: its column, and `value = factor * (scale * raw + offset) + shift` in SI."""

    name: str
    entry: ChannelEntry
    conversion: Conversion

    @property
    def column(self) -> str:
        return self.entry.column if self.entry.column is not None else self.name

    @property
    def channel(self) -> Channel:
        def width(value: float | None) -> float | None:
            return None if value is None else value * self.conversion.factor

        entry = self.entry
        return Channel(self.name, entry.role, self.conversion.si, width(entry.noise_std), width(entry.resolution), entry.hold)

    def convert(self, raw: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):
            stated = self.entry.scale * raw + self.entry.offset
            return self.conversion.factor * stated + self.conversion.shift


@dataclass
class Harvest:
    """What one entry of `[[experiments]]` gave."""

    experiments: list[Experiment] = field(default_factory=list)
    responses: list[FrequencyResponse] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    still: dict[str, Problem] = field(default_factory=dict)  # output channels that never move, with the words for it
    moving: set[str] = field(default_factory=set)
    still_inputs: set[str] = field(default_factory=set)


def read_record(table: Table, entry: ExperimentEntry, name: str, readings: Sequence[Reading], time: str) -> Harvest:
    """One recorded run (several where it is split at gaps), or what is wrong with it."""
    harvest = Harvest()
    absent = [table.missing(time, "the time")] if time not in table.columns else []
    absent += [
        table.missing(r.column, f"channel {r.name!r}" if r.column != r.name else "this channel")
        for r in readings
        if r.column not in table.columns
    ]
    harvest.problems += absent
    index = _selected(table, entry, harvest)
    if index is None or time not in table.columns:
        return harvest
    t = table.numbers(time).values
    time_faults = _sample_faults(table, time, index)
    harvest.problems += time_faults
    if entry.window_s is not None:
        if time_faults:
            return harvest  # which samples the window holds is not known
        start, stop = entry.window_s
        span = t[index[[0, -1]]]
        index = index[(t[index] >= start) & (t[index] < stop)]
        if len(index) == 0:
            message = f"no sample lies in window_s = [{start:g}, {stop:g}]; time runs from {span[0]:g} to {span[1]:g} s"
            harvest.problems.append(Problem(table.file, None, time, message, "Correct window_s"))
            return harvest
    values = {r.name: _channel(table, r, index, harvest) for r in readings if r.column in table.columns}
    if len(index) < MINIMUM_SAMPLES and table.whole:
        message = f"{len(index)} samples in experiment {name!r}; fewer than {MINIMUM_SAMPLES} say too little"
        harvest.problems.append(Problem(table.file, None, None, message, "Record or select a longer run"))
    cuts = None if time_faults else _time(table, entry, name, time, index, t[index], harvest)
    if harvest.problems or table.problems or cuts is None:
        return harvest
    columns = {k: v for k, v in values.items() if v is not None}
    run = Experiment(
        name=name,
        split=entry.split,
        t=t[index],
        u=_stack(columns, readings, "input", len(index)),
        y=_stack(columns, readings, "output", len(index)),
        auxiliary={r.name: columns[r.name] for r in readings if r.entry.role == "auxiliary"},
        initial=None if entry.initial is None else dict(entry.initial),
        at_rest=entry.at_rest,
        constants={k: float(v) for k, v in entry.constants.items()},
        initial_window_s=entry.initial_window_s,
        source=f"{table.file}, {_span(table, index)}",
    )
    harvest.experiments += _pieces(run, cuts, harvest, table)
    return harvest


def _span(table: Table, index: np.ndarray) -> str:
    word = "rows" if table.rows is not None else "indices"
    return f"{word} {table.row(index[0])} to {table.row(index[-1])}"


def _stack(columns: dict[str, np.ndarray], readings: Sequence[Reading], role: str, count: int) -> np.ndarray:
    chosen = [columns[r.name] for r in readings if r.entry.role == role]
    return np.stack(chosen, axis=1) if chosen else np.zeros((count, 0))


def _selected(table: Table, entry: ExperimentEntry, harvest: Harvest) -> np.ndarray | None:
    """The samples that `where` and `rows` choose (both count in the file's own samples)."""
    mask = np.ones(table.count, dtype=bool)
    for column, value in entry.where.items():
        if column not in table.columns:
            message = f"there is no column {column!r} for `where`{nearest(column, table.columns)}"
            harvest.problems.append(Problem(table.file, 1, column, message, "Name a column that exists"))
            return None
        chosen = table.equal(column, value)
        if not chosen.any():
            found = list(dict.fromkeys(str(c) for c in table.columns[column]))[:30]
            message = f"no row has {column} = {value!r}{nearest(str(value), found)}"
            harvest.problems.append(Problem(table.file, None, column, message, "Correct `where`"))
            return None
        mask &= chosen
    if entry.rows is not None:
        start, stop = entry.rows
        if stop > table.count:
            if table.whole:
                message = f"rows = [{start}, {stop}] reach beyond the {table.count} samples of the file"
                harvest.problems.append(Problem(table.file, None, None, message, "Correct `rows` (half-open, from 0)"))
            return None
        mask[:start] = mask[stop:] = False
    index = np.flatnonzero(mask)
    if len(index) == 0:
        if table.count or not table.problems:
            message = "no sample is selected by `where` and `rows` together"
            harvest.problems.append(Problem(table.file, None, None, message, "Correct `where` or `rows`"))
        return None
    return index


def _sample_faults(table: Table, column: str, index: np.ndarray) -> list[Problem]:
    """One problem for each kind of fault among the selected samples of a column."""
    faults = table.numbers(column).faults
    if not faults:
        return []
    kinds: dict[str, list[int]] = {}
    for sample in sorted(set(faults) & set(index.tolist())):
        kinds.setdefault(faults[sample].split(":")[0], []).append(sample)
    problems = []
    for kind, samples in kinds.items():
        first = samples[0]
        text = f"{table.place(first)} is {faults[first]}"
        if len(samples) > 1:
            text += f"; {len(samples)} samples in all are {kind}"
        remedy = {
            "missing": "Fill it, cut it out with `rows` or `window_s`, or leave the experiment out",
            "infinite": "Correct the sample, or cut it out with `rows` or `window_s`",
        }.get(kind, "Write a number with a decimal point")
        problems.append(Problem(table.file, table.row(first), column, text, remedy))
    return problems


def _channel(table: Table, reading: Reading, index: np.ndarray, harvest: Harvest) -> np.ndarray | None:
    """The channel's samples in SI. Notes whether it moves."""
    faults = _sample_faults(table, reading.column, index)
    harvest.problems += faults
    values = reading.convert(table.numbers(reading.column).values[index])
    if faults:
        harvest.moving.add(reading.name)
        return None
    if not np.isfinite(values).all():
        first = int(index[np.flatnonzero(~np.isfinite(values))[0]])
        text = f"{table.place(first)} is too large after scale, offset and unit"
        harvest.problems.append(Problem(table.file, table.row(first), reading.column, text, "Correct scale, offset or unit"))
        return None
    still = np.ptp(values) == 0
    if reading.entry.role == "output" and not still:
        harvest.moving.add(reading.name)
    elif reading.entry.role == "output":
        constant = f"it is {values[0]:g} {reading.conversion.si} in all {len(index)} samples"
        text = f"output {reading.name!r} never moves: {constant}"
        harvest.still[reading.name] = Problem(
            table.file, None, reading.column, text, 'Check the sensor, or give the channel role = "auxiliary"'
        )
    elif reading.entry.role == "input" and still:
        harvest.still_inputs.add(reading.name)
    return values


def _time(
    table: Table, entry: ExperimentEntry, name: str, column: str, index: np.ndarray, t: np.ndarray, harvest: Harvest
) -> list[int] | None:
    """Where to cut the run (sample positions after a gap), or None where time is at fault."""
    step = np.diff(t)
    back = np.flatnonzero(step <= 0)
    if len(back):
        sample = int(index[back[0] + 1])
        what = "stands still" if step[back[0]] == 0 else "runs backwards"
        text = f"time {what} at {table.place(sample)}: {float(t[back[0] + 1])!r} s after {float(t[back[0]])!r} s"
        if len(back) > 1:
            text += f"; {len(back)} times in all"
        remedy = "Give increasing times, or choose one run of the file with `where` or `rows`"
        harvest.problems.append(Problem(table.file, table.row(sample), column, text, remedy))
        return None
    if len(step) == 0 or not table.whole:
        return []
    median = float(np.median(step))
    gaps = np.flatnonzero(step > GAP * median)
    if len(gaps) and not entry.split_at_gaps:
        sample = int(index[gaps[0] + 1])
        width = step[gaps[0]]
        text = f"a gap of {width:.4g} s before {table.place(sample)}, {width / median:.0f} median steps of {median:.4g} s"
        if len(gaps) > 1:
            text += f"; {len(gaps)} gaps in all"
        remedy = "Choose a part with `rows` or `window_s`, or say split_at_gaps = true"
        harvest.problems.append(Problem(table.file, table.row(sample), column, text, remedy))
        return None
    long = np.flatnonzero((step > LONG_STEP * median) & (step <= GAP * median))
    if len(long):
        worst = long[np.argmax(step[long])]
        harvest.warnings.append(
            f"{name}: {len(long)} time step{'s' * (len(long) > 1)} over {LONG_STEP:g} medians ({median:.4g} s), "
            f"the longest {step[worst]:.4g} s before {table.place(int(index[worst + 1]))} of {table.file}"
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
        message = f"split at its gaps, experiment {run.name!r} has no part of {MINIMUM_SAMPLES} samples"
        harvest.problems.append(Problem(table.file, None, None, message, "Record without gaps"))
    harvest.notes.append(
        f"{run.name}: split at {len(cuts)} gap{'s' * (len(cuts) > 1)} into {len(pieces)} runs"
        + (f"; {dropped} shorter than {MINIMUM_SAMPLES} samples left out" if dropped else "")
    )
    return pieces


def read_response(table: Table, entry: ExperimentEntry, name: str, units: dict[str, Conversion]) -> Harvest:
    """A frequency response `output / input`, from the units of the two channels to SI."""
    harvest = Harvest()
    named = {key: entry.columns.get(key, key) for key in ("omega", "frequency", "gain", "phase", "re", "im")}

    def there(key: str) -> bool:
        return key in entry.columns or named[key] in table.columns

    axis = "frequency" if there("frequency") and not there("omega") else "omega"
    polar = there("gain") or there("phase") or not (there("re") or there("im"))
    keys = [axis, *(("gain", "phase") if polar else ("re", "im"))]
    absent = [key for key in keys if named[key] not in table.columns]
    harvest.problems += [table.missing(named[key], f"{key!r} of the frequency response") for key in absent]
    index = _selected(table, entry, harvest)
    if index is None:
        return harvest
    for key in keys:
        if key not in absent:
            harvest.problems += _sample_faults(table, named[key], index)
    if harvest.problems or table.problems:
        return harvest
    first, a, b = (table.numbers(named[key]).values[index] for key in keys)
    for key, values, bad in ((keys[0], first, first <= 0), *([(keys[1], a, a < 0)] if polar else [])):
        if bad.any():
            sample = int(index[np.flatnonzero(bad)[0]])
            least = "above 0" if key == keys[0] else "at least 0"
            text = f"{table.place(sample)} is {values[bad][0]:g}; {key} must be {least}"
            harvest.problems.append(Problem(table.file, table.row(sample), named[key], text, "Correct or remove the row"))
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
