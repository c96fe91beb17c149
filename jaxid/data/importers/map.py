"""Any table or arrays as a dataset, by a map of channels: `NAME=COLUMN:UNIT:ROLE`, `t=COLUMN:UNIT`, `'q*=positions[*]:rad'`.

What was recognised of a file comes back as the command that says it.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.data.importers.arrays import Arrays
from jaxid.data.importers.propose import proposal
from jaxid.data.importers.runs import held, Paths, paths_of, refused, role_of, Run, runs_of, save_runs
from jaxid.data.importers.source import find_column, numbers_of, parts_of, read_source, series_of, Source, stated_rate, times_of
from jaxid.data.importers.text import Stated
from jaxid.data.patterns import captures_of, joint_numbers
from jaxid.data.time_axis import PER_SECOND
from jaxid.data.units import conversion, UnitError
from jaxid.errors import DatasetError, nearest, Problem, UsageError


ROLES = ("input", "output", "auxiliary")


@dataclass(frozen=True)
class Wanted:
    """One `--channel`: what is written into `name`, of which column; None where it is not said."""

    name: str
    column: str
    unit: str | None
    role: str | None


@dataclass(frozen=True)
class Imported:
    """The folder that was written, and the command that says what was recognised."""

    folder: Path
    command: str


def import_table(
    files: Paths,
    out: str | os.PathLike[str],
    *,
    channels: Sequence[str] = (),
    join: str | os.PathLike[str] | None = None,
    rows: tuple[int, int] | None = None,
    rate: float | None = None,
    stated: Stated = Stated(),
    overwrite: bool = False,
) -> Imported:
    """Files of one layout as a dataset folder, one run or more a file. See the module for `channels`.

    `join` is a file whose columns are taken too, each row's last value at the times of the first; `rows` (half-open, from 0) are
    chosen before anything is judged; `rate` (Hz) makes the times of files that have none. Raises `DatasetError` or `UsageError`
    that say what was recognised and what to type.
    """
    wanted = [parse_channel(c) for c in channels]
    sources = [read_source(p, stated) for p in paths_of(files)]
    joined = None if join is None else read_source(Path(join), Stated())
    time = [w for w in wanted if w.name == "t"]
    if len(time) > 1 or len(wanted) == len(time) or (not time and rate is None and stated_rate(sources[0]) is None):
        raise UsageError(proposal(sources[0], out))
    clock = time[0] if time else Wanted("t", "", None, None)
    runs: list[Run] = []
    notes: list[str] = []
    joints: dict[str, int] = {}
    found: list[Wanted] = []
    for source in sources:
        for part in parts_of(source):
            found, t, columns, said = _read(part, clock, [w for w in wanted if w.name != "t"], joined, rows, rate, joints)
            notes += said
            runs += runs_of(part.path.stem, t, columns, part.path.name)
    roles = {w.name: (w.role or role_of(w.name), w.unit or "1") for w in found}
    folder = save_runs(
        runs, out, sources[0].kind, roles, overwrite=overwrite, units={n: u for n, (_, u) in roles.items()}, notes=notes,
        joints={f"q{k}": name for name, k in joints.items() if f"q{k}" in roles},
    )  # fmt: skip
    return Imported(folder, _command(sources, joined, clock, found, rows, rate, out))


def parse_channel(text: str) -> Wanted:
    """`NAME=COLUMN`, `NAME=COLUMN:UNIT` or `NAME=COLUMN:UNIT:ROLE`."""
    match = re.fullmatch(r"([A-Za-z_][\w]*(?:\*\w*)?)=(.+)", text)
    if match is None:
        raise UsageError(f"--channel {text}: write NAME=COLUMN:UNIT or NAME=COLUMN:UNIT:ROLE (input, output, auxiliary)")
    name, rest = match[1], match[2].split(":")
    role = rest.pop() if len(rest) > 1 and rest[-1] in ROLES else None
    unit = rest.pop() if len(rest) > 1 else None
    if unit is not None and name != "t":
        try:
            conversion(unit, "kg")
        except UnitError as error:
            raise UsageError(f"--channel {text}: {error}") from None
    if name == "t" and unit is not None and unit not in PER_SECOND:
        raise UsageError(f"--channel {text}: unknown unit of time {unit!r}{nearest(unit, PER_SECOND)}")
    return Wanted(name, ":".join(rest), unit, role)


def _read(
    source: Source,
    clock: Wanted,
    wanted: Sequence[Wanted],
    join: Source | None,
    rows: tuple[int, int] | None,
    rate: float | None,
    joints: dict[str, int],
) -> tuple[list[Wanted], np.ndarray, dict[str, np.ndarray], list[str]]:
    """The channels that were found (patterns as one a joint), t [time] s, channel -> [time], and notes."""
    notes: list[str] = []
    flat = series_of(source.columns, None)
    name = find_column(source, flat, clock.column) if clock.column else None
    length = len(flat[name]) if name is not None else None
    series = series_of(source.columns, length)
    other = {} if join is None else series_of(join.columns, None)
    other |= {f"{join.path.stem}.{n}": v for n, v in other.items()} if join is not None else {}
    found = _expanded(wanted, source, series, other, joints)
    if name is None:
        length = len(next(iter(series[w.column] for w in found if w.column in series)))
        t, start = _nominal(source, clock, series, rate, length, notes), None
    else:
        t, start = times_of(source, flat[name], name, clock.unit, rows)
    chosen = slice(*rows) if rows is not None else slice(None)
    t = t[chosen]
    columns = {w.name: numbers_of(source, series[w.column], w.column, chosen, len(t)) for w in found if w.column in series}
    if join is not None:
        t, columns = _joined(join, other, clock, [w for w in found if w.column not in series], t, start, columns, notes)
        columns = {w.name: columns[w.name] for w in found}
    return found, t, columns, notes


def _expanded(wanted: Sequence[Wanted], source: Source, series: Arrays, other: Arrays, joints: dict[str, int]) -> list[Wanted]:
    """Channels with the columns they are read from, patterns as one a joint; units that the file states are filled in."""
    problems: list[Problem] = []
    found: list[Wanted] = []
    everything = list(dict.fromkeys([*series, *other]))
    for w in wanted:
        if "*" in w.name:
            names = captures_of(w.column, everything) or {}
            if not names:
                message = f"no column matches {w.column!r} (there is: {', '.join(everything[:20])})"
                problems.append(Problem(source.path.name, None, w.column, message, "Write 'q*=pos_*:rad' or 'q*=q[*]:rad'"))
            numbers = joint_numbers(list(names), joints)
            pairs = sorted((numbers[c], at) for c, at in names.items())
            found += [replace(w, name=w.name.replace("*", str(k)), column=at) for k, at in pairs]
            continue
        column = find_column(source, series, w.column) or (w.column if w.column in other else None)
        if column is None:
            wide = [n for n in everything if n.startswith(f"{w.column}[")]
            hint = f": it is an array of {len(wide)} columns" if wide else nearest(w.column, everything)
            remedy = "Correct the column"
            if wide:
                remedy = f"Name one, {w.name}={wide[0]}:UNIT, or all: '{w.name}*={w.column}[*]:UNIT'"
            elif list(series) == [str(k + 1) for k in range(len(series))]:
                hint, remedy = ": the file has no header", f"Name it by number, from 1: --channel {w.name}=2:UNIT"
            problems.append(Problem(source.path.name, None, w.column, f"there is no column {w.column!r}{hint}", remedy))
            continue
        found.append(replace(w, column=column, unit=w.unit or source.units.get(column)))
    for w in found:
        if w.unit is None and not problems:
            message = f"the unit of channel {w.name!r} is not stated"
            problems.append(Problem(source.path.name, None, w.column, message, f"Write --channel {w.name}={w.column}:UNIT"))
    if problems:
        raise DatasetError(problems)
    return found


def _nominal(source: Source, clock: Wanted, series: Arrays, rate: float | None, length: int, notes: list[str]) -> np.ndarray:
    """Times of a file that has none: its samples by a rate that is stated."""
    stated = stated_rate(source)
    if rate is None and stated is None:
        message = f"there is no column {clock.column!r} for the time{nearest(clock.column, series)}"
        raise refused(source.path, message, "Name it, --channel t=COLUMN:UNIT, or state the sampling rate: --rate HZ")
    hz, said = (rate, "--rate") if rate is not None else (stated[1], f"{stated[0]!r} of the file") if stated else (1.0, "")
    notes.append(f"{source.path.name}: its times are nominal, samples at {hz:g} Hz by {said}; none were recorded")
    return np.arange(length) / hz


# ---- another file on the same clock


def _joined(
    join: Source,
    other: Arrays,
    clock: Wanted,
    wanted: Sequence[Wanted],
    t: np.ndarray,
    start: int | None,
    columns: dict[str, np.ndarray],
    notes: list[str],
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The columns of the other file as they stood at the times t; rows outside of it are left out, and said."""
    name = find_column(join, other, clock.column)
    if name is None:
        message = f"there is no column {clock.column!r} to join on{nearest(clock.column, other)}"
        raise refused(join.path, message, "Both files need the time under one name; rename the column")
    own, own_start = times_of(join, other[name], name, clock.unit, None)
    if (start is None) != (own_start is None):
        raise refused(join.path, "only one of the two files has a clock that counts from 1970", "Give files on one clock")
    own = own + ((own_start or 0) - (start or 0)) * 1e-9
    if (np.diff(own) < 0).any() or (np.diff(t) < 0).any():
        raise refused(join.path, "time runs backwards in one of the two files", "Join one run at a time: --rows FIRST:END")
    step = float(np.median(np.diff(own)))
    inside = (t >= own[0]) & (t <= own[-1] + step)
    if not inside.any():
        message = f"its times, {own[0]:g} to {own[-1]:g} s, lie outside of {t[0]:g} to {t[-1]:g} s"
        raise refused(join.path, message, "Give files of one recording on one clock")
    values = {w.name: numbers_of(join, other[w.column], w.column, slice(None), len(own)) for w in wanted}
    taken = {n: held(t[inside], own, v) for n, v in values.items()}
    notes.append(
        f"{join.path.name} joined on the time: its last value at each of {inside.sum()} samples ({_drift(t[inside], own)})"
    )
    if lost := int(np.sum(~inside)):
        notes.append(f"{lost} samples before or after {join.path.name} left out")
    return t[inside], {n: v[inside] for n, v in columns.items()} | taken


def _drift(t: np.ndarray, own: np.ndarray) -> str:
    """How the stamps of two files move against each other."""
    steps = float(np.median(np.diff(t))), float(np.median(np.diff(own)))
    if abs(steps[1] / steps[0] - 1) > 0.02 or len(t) < 20:
        return f"sampled every {1e3 * steps[0]:.4g} and {1e3 * steps[1]:.4g} ms, so no drift between their clocks can be told"
    near = own[np.clip(np.searchsorted(own, t), 1, len(own) - 1)]
    near = np.where(np.abs(near - t) > steps[1] / 2, near - steps[1], near)
    apart = np.unwrap(near - t, period=steps[1])
    x = t - t.mean()
    slope = float(x @ apart / (x @ x))
    std = float(np.std(apart - apart.mean() - slope * x) / np.sqrt(x @ x))
    size = f"their stamps move apart by {1e6 * slope:.2g} +- {1e6 * std:.1g} ppm, by {1e3 * apart[0]:.3g} ms at the start"
    return size + ("; with clocks of their own: clock_ppm for its channels" if abs(slope) > 3 * std and abs(slope) > 1e-6 else "")


# ---- what is said


def _command(
    sources: Sequence[Source],
    join: Source | None,
    clock: Wanted,
    found: Sequence[Wanted],
    rows: Any,
    rate: float | None,
    out: Any,
) -> str:
    parts = [f"jaxid import {sources[0].kind}", *(shlex.quote(str(s.path)) for s in sources), sources[0].options]
    parts += [f"--join {shlex.quote(str(join.path))}"] if join is not None else []
    parts += [f"--rows {rows[0]}:{rows[1]}"] if rows is not None else []
    parts += [f"--rate {rate:g}"] if rate is not None else []
    time = [f"t={clock.column}:{clock.unit or 's'}"] if clock.column else []
    if clock.column and rate is None and (nominal := nominal_rate(sources[0], clock)) is not None:
        time, parts = [], [*parts, f"--rate {nominal:g}"]
    said = [*time, *(f"{w.name}={w.column}:{w.unit}:{w.role or role_of(w.name)}" for w in found)]
    return " ".join([*filter(None, parts), *(f"--channel {shlex.quote(c)}" for c in said), f"--out {shlex.quote(str(out))}"])


def nominal_rate(source: Source, clock: Wanted) -> float | None:
    """The rate that made the times of a file which has none."""
    part = parts_of(source)[0]
    stated = stated_rate(part)
    return stated[1] if stated is not None and find_column(part, series_of(part.columns, None), clock.column) is None else None
