"""Any table or arrays as a dataset, by a map of channels: `NAME=COLUMN:UNIT:ROLE`, `t=COLUMN:UNIT`,
`'q*=positions[*]:rad'`.

What was recognised of a file comes back as the command that says it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jaxid.base.errors import DatasetError, DatasetProblem, nearest, UsageError
from jaxid.data.importers.arrays import Arrays
from jaxid.data.importers.beside import Beside, kept_beside, numbers_beside
from jaxid.data.importers.command import full_command, ImportRequest
from jaxid.data.importers.joining import Clock, join_columns, Joined, joined_files, names_once
from jaxid.data.importers.propose import proposal
from jaxid.data.importers.runs import (
    ImportedRun,
    Paths,
    paths_of,
    refused,
    role_of,
    runs_of,
    save_runs,
)
from jaxid.data.importers.source import (
    find_column,
    joint_names_of,
    numbers_of,
    parts_of,
    read_source,
    series_of,
    Source,
    stated_rate,
    times_of,
)
from jaxid.data.importers.text import StatedFormat
from jaxid.data.patterns import captures_of, joint_numbers
from jaxid.data.time_axis import PER_SECOND
from jaxid.data.units import conversion, UnitError


ROLES = ("input", "output", "auxiliary")


@dataclass(frozen=True)
class Wanted:
    """One `--channel`: what is written into `name`, of which column; None where it is not said.

    `pattern`: `q*=positions[*]`, where the channel is one of several that were asked for at once.
    """

    name: str
    column: str
    unit: str | None
    role: str | None
    pattern: str = ""


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
    join: Paths = (),
    rows: tuple[int, int] | None = None,
    rate: float | None = None,
    stated: StatedFormat = StatedFormat(),
    overwrite: bool = False,
) -> Imported:
    """Files of one layout as a dataset folder, one run or more a file. See the module for
    `channels`.

    `join` are files whose columns are taken too, each row's last value at the times of the first;
    `rows` (half-open, from 0) are chosen before anything is judged; `rate` (Hz) makes the times of
    files that have none. Raises `DatasetError` or `UsageError` that say what was recognised and
    what to type.
    """
    sources = [read_source(p, stated) for p in paths_of(files)]
    joined = joined_files([read_source(p, StatedFormat()) for p in paths_of(join)])
    asked = ImportRequest(sources, [j.source for j in joined], stated, rows, rate, out, overwrite)
    clock, wanted = _clock_and_channels(asked, [parse_channel(c) for c in channels])
    runs: list[ImportedRun] = []
    notes: list[str] = []
    joints: dict[str, int] = {}
    found: list[Wanted] = []
    beside: list[tuple[str, Beside]] = []
    for source in sources:
        for part in parts_of(source):
            found, t, columns, said = _read(part, clock, wanted, joined, rows, rate, joints)
            notes += said
            beside.append((part.path.stem, numbers_beside(part)))
            runs += runs_of(part.path.stem, t, columns, part.path.name)
    constants, said = kept_beside(beside)
    notes += said
    roles = {w.name: (w.role or role_of(w.name), w.unit or "1") for w in found}
    folder = save_runs(
        runs,
        out,
        sources[0].kind,
        roles,
        overwrite=overwrite,
        units={name: unit for name, (_, unit) in roles.items()},
        notes=notes,
        beside=constants,
        joints={f"q{k}": name for name, k in joints.items() if f"q{k}" in roles},
    )
    return Imported(folder, full_command(asked, clock, _in_full(found, roles)))


def _in_full(found: Sequence[Wanted], roles: Mapping[str, tuple[str, str]]) -> list[str]:
    """The channels with units and roles, as `--channel` takes them: those of a pattern at once,
    which keeps the names of joints.
    """
    ends: dict[str, set[str]] = {}
    for w in found:
        ends.setdefault(w.pattern, set()).add(f"{w.unit}:{roles[w.name][0]}")
    said: dict[str, None] = {}
    for w in found:
        end = f"{w.unit}:{roles[w.name][0]}"
        if w.pattern and len(ends[w.pattern]) == 1:
            said[f"{w.pattern}:{end}"] = None
        else:
            said[f"{w.name}={w.column}:{end}"] = None
    return list(said)


def _clock_and_channels(
    asked: ImportRequest, wanted: Sequence[Wanted]
) -> tuple[Clock, list[Wanted]]:
    """The column of the times and the channels beside it.

    Raises `UsageError` with a proposal where no channel is named, or the times are not clear.
    """
    times = [w for w in wanted if w.name == "t"]
    channels = [w for w in wanted if w.name != "t"]
    has_rate = asked.rate is not None or stated_rate(asked.sources[0]) is not None
    if not channels or len(times) > 1 or not (times or has_rate):
        raise UsageError(proposal(asked))
    if not times:
        return Clock("", None), channels
    return Clock(times[0].column, times[0].unit), channels


def parse_channel(text: str) -> Wanted:
    """`NAME=COLUMN`, `NAME=COLUMN:UNIT` or `NAME=COLUMN:UNIT:ROLE`."""
    match = re.fullmatch(r"([A-Za-z_][\w]*(?:\*\w*)?)=(.+)", text)
    if match is None:
        raise UsageError(
            f"--channel {text}: write NAME=COLUMN:UNIT or NAME=COLUMN:UNIT:ROLE (input, output,"
            " auxiliary)"
        )
    name, rest = match[1], match[2].split(":")
    role = rest.pop() if len(rest) > 1 and rest[-1] in ROLES else None
    unit = rest.pop() if len(rest) > 1 else None
    if unit is not None and name != "t":
        try:
            conversion(unit, "kg")
        except UnitError as error:
            raise UsageError(f"--channel {text}: {error}") from None
    if name == "t" and unit is not None and unit not in PER_SECOND:
        raise UsageError(
            f"--channel {text}: unknown unit of time {unit!r}{nearest(unit, PER_SECOND)}"
        )
    return Wanted(name, ":".join(rest), unit, role)


def _read(
    source: Source,
    clock: Clock,
    wanted: Sequence[Wanted],
    joined: Sequence[Joined],
    rows: tuple[int, int] | None,
    rate: float | None,
    joints: dict[str, int],
) -> tuple[list[Wanted], np.ndarray, dict[str, np.ndarray], list[str]]:
    """The channels that were found (patterns as one a joint), t [time] s, channel -> [time], and
    notes.
    """
    notes: list[str] = []
    flat = series_of(source.columns, None)
    column = (
        source.clock if source.clock and clock.column in flat else clock.column
    )  # a block's name means its times
    name = find_column(source, flat, column) if column else None
    length = len(flat[name]) if name is not None else None
    series = series_of(source.columns, length)
    found = _expanded(wanted, source, series, joined, joints)
    if name is None:
        length = len(next(iter(series[w.column] for w in found if w.column in series)))
        t, start = _nominal(source, clock, series, rate, length, notes), None
    else:
        t, start = times_of(source, flat[name], name, clock.unit, rows)
        if rate is not None:
            notes.append(f"{source.path.name}: --rate is not used, for its times were recorded")
    chosen = slice(*rows) if rows is not None else slice(None)
    t = t[chosen]
    own = [w for w in found if w.column in series]
    columns = {
        w.name: numbers_of(source, series[w.column], w.column, chosen, len(t), notes) for w in own
    }
    for join in joined:
        others = {
            w.name: join.names[w.column]
            for w in found
            if w.column not in series and w.column in join.names
        }
        t, columns = join_columns(join, clock, others, t, start, columns, notes)
    columns = {w.name: columns[w.name] for w in found}
    return found, t, columns, notes


def _expanded(
    wanted: Sequence[Wanted],
    source: Source,
    series: Arrays,
    joined: Sequence[Joined],
    joints: dict[str, int],
) -> list[Wanted]:
    """Channels with the columns they are read from, patterns as one a joint; units that the file
    states are filled in.
    """
    problems: list[DatasetProblem] = []

    def complain(column: str, message: str, remedy: str) -> None:
        problems.append(DatasetProblem(source.path.name, None, column, message, remedy))

    found: list[Wanted] = []
    units: dict[str, str | None] = {}
    for join in joined:
        units |= {name: join.source.units.get(own) for name, own in join.names.items()}
    everything = list(dict.fromkeys([*series, *units]))
    units |= source.units
    for w in wanted:
        if "*" in w.name:
            once = captures_of(w.column, names_once(series, joined))
            columns = once or captures_of(w.column, everything) or {}
            if not columns:
                message = f"no column matches {w.column!r} (there is: {', '.join(everything[:20])})"
                complain(w.column, message, "Write 'q*=pos_*:rad' or 'q*=q[*]:rad'")
            found += _one_a_joint(w, _by_name(columns, joint_names_of(source)), joints)
            continue
        column = find_column(source, series, w.column)
        if column is None and w.column in everything:
            column = w.column
        if column is None:
            hint, remedy = _no_such_column(w, series, everything)
            complain(w.column, f"there is no column {w.column!r}{hint}", remedy)
            continue
        found.append(replace(w, column=column))
    if problems:
        raise DatasetError(problems)
    found = [replace(w, unit=w.unit or units.get(w.column)) for w in found]
    for w in found:
        if w.unit is None:
            message = f"the unit of channel {w.name!r} is not stated"
            remedy = f"Write --channel {w.name}={w.column}:UNIT"
            raise DatasetError([DatasetProblem(source.path.name, None, w.column, message, remedy)])
    return found


def _by_name(columns: dict[str, str], names: Sequence[str]) -> dict[str, str]:
    """What `*` stands for -> column, with the file's own names of the joints for their numbers."""
    if len(columns) != len(names) or not all(capture.isdigit() for capture in columns):
        return columns
    order = sorted(columns, key=int)
    return {name: columns[capture] for name, capture in zip(names, order, strict=True)}


def _one_a_joint(
    pattern: Wanted, columns: Mapping[str, str], joints: dict[str, int]
) -> list[Wanted]:
    """A pattern as channels in order of the joints; `columns`: what `*` stands for -> column."""
    numbers = joint_numbers(list(columns), joints)
    by_joint = sorted((numbers[capture], column) for capture, column in columns.items())
    asked = f"{pattern.name}={pattern.column}"
    return [
        replace(pattern, name=pattern.name.replace("*", str(number)), column=column, pattern=asked)
        for number, column in by_joint
    ]


def _no_such_column(wanted: Wanted, series: Arrays, everything: Sequence[str]) -> tuple[str, str]:
    """(hint, remedy) for a channel whose column is not there."""
    wide = [name for name in everything if name.startswith(f"{wanted.column}[")]
    if wide:
        return (
            f": it is an array of {len(wide)} columns",
            f"Name one, {wanted.name}={wide[0]}:UNIT, or all:"
            f" '{wanted.name}*={wanted.column}[*]:UNIT'",
        )
    if list(series) == [str(k + 1) for k in range(len(series))]:
        return (
            ": the file has no header",
            f"Name it by number, from 1: --channel {wanted.name}=2:UNIT",
        )
    return nearest(wanted.column, everything), "Correct the column"


def _nominal(
    source: Source, clock: Clock, series: Arrays, rate: float | None, length: int, notes: list[str]
) -> np.ndarray:
    """Times of a file that has none: its samples by a rate that is stated."""
    stated = stated_rate(source)
    if rate is not None:
        hz, said = rate, "--rate"
    elif stated is not None:
        hz, said = stated[1], f"{stated[0]!r} of the file"
    else:
        message = f"there is no column {clock.column!r} for the time{nearest(clock.column, series)}"
        raise refused(
            source.path,
            message,
            "Name it, --channel t=COLUMN:UNIT, or state the sampling rate: --rate HZ",
        )
    notes.append(
        f"{source.path.name}: its times are nominal, samples at {hz:g} Hz by {said}; none were"
        " recorded"
    )
    return np.arange(length) / hz
