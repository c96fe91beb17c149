"""A file of a recording as named columns, whatever its kind: where a column is, its numbers, and
its times.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import DatasetError, DatasetProblem
from jaxid.data.importers.arrays import Arrays, kind_of, read_arrays
from jaxid.data.importers.runs import refused
from jaxid.data.importers.text import decoded, read_text, StatedFormat
from jaxid.data.importers.traces import CLOCK, read_trace, words_of as trace_words
from jaxid.data.records import MINIMUM_SAMPLES
from jaxid.data.table import read_table, Table
from jaxid.data.time_axis import contradicted, impossible, PER_SECOND, since_start


#: Names that a column of times has, and the unit behind them: `t`, `Time`, `__time`, `stamp_ns`,
#: `log.t_ms`, `X_Value`.
TIME = re.compile(
    r"(?:.*[./])?_*(?:t|time|timestamp|time_?stamp|stamp|zeit|temps|x_value|clock)s?"
    r"(?:_?(s|ms|us|ns|sec|seconds))?",
    re.I,
)
#: Names of a list of the names of joints.
_NAMES = re.compile(r"(?:.*[./])?(?:joint|dof|motor|actuator)s?_?names?(?:_list)?", re.I)
_RATES = ("hz", "rate", "fs", "fps", "sample_rate", "sampling_rate", "samplerate")
_STEPS = ("dt", "Ts", "ts", "period", "sample_time", "interval")


@dataclass
class Source:
    """What one file holds: column -> cells [time] (or arrays of two axes), units that it states,
    and how it was read.
    """

    path: Path
    kind: str
    columns: Arrays
    units: dict[str, str] = field(default_factory=dict)
    rows: np.ndarray | None = None
    words: str = ""
    options: str = ""
    twice: Mapping[str, list[int]] = field(default_factory=dict)
    ragged: Mapping[int, int] = field(default_factory=dict)
    clock: str = ""  # the column of the times, where the kind of file says it

    def table(self, column: str, cells: Any) -> Table:
        """A column by itself, whose cells are read as those of a table."""
        return Table(self.path.name, {column: cells}, len(cells), self.rows)


def read_source(path: Path, stated: StatedFormat) -> Source:
    """A file by its own kind, whatever it is called."""
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise refused(path, f"{path} {what}", _instead(path))
    content = path.read_bytes()
    if not content.strip():
        raise refused(path, "the file is empty", "Record again")
    kind = kind_of(path, content)
    if kind == "csv":
        trace = read_trace(path, decoded(path, content).splitlines())
        if trace is not None:
            return Source(path, kind, trace, words=trace_words(trace), clock=CLOCK)
        table, units, form = read_text(path, content, stated)
        return Source(
            path=path,
            kind=kind,
            columns=dict(table.columns),
            units=units,
            rows=table.rows,
            words=form.words(),
            options=form.options(),
            twice=table.twice,
            ragged=table.ragged,
        )
    if kind == "parquet":
        table = read_table(Path("a.parquet"), path.name, content)
        if table.problems:
            raise DatasetError(table.problems)
        return Source(
            path=path,
            kind="csv",
            columns=dict(table.columns),
            units={},
            rows=table.rows,
            words="a Parquet file",
            options="",
            twice=table.twice,
        )
    return Source(path, kind, read_arrays(kind, path), words=f"read as {kind}")


def _instead(path: Path) -> str:
    """What to type for a folder that is a recording of another kind."""
    for kind, mark in (("lerobot", "meta/info.json"), ("rosbag", "metadata.yaml")):
        if (path / mark).is_file():
            return f"It looks like a recording of its own kind: jaxid import {kind} {path}"
    return "Name a file"


def parts_of(source: Source) -> list[Source]:
    """A file that holds a list of recordings (`data[0].q`, `data[1].q`) as one source each.

    A list whose elements share one clock is one recording of several joints: `motor_state[0].q`.
    """
    common: Arrays = {}
    elements: dict[int, Arrays] = {}
    listed = []
    for name, values in source.columns.items():
        match = re.fullmatch(r"(.*?)\[(\d+)\]\.(.+)", name)
        if match is None:
            common[name] = values
        else:
            listed.append(name)
            elements.setdefault(int(match[2]), {})[match[3]] = values
    if not elements or _one_clock(source, listed):
        return [source]
    parts = []
    for k, own in sorted(elements.items()):
        path = source.path
        if len(elements) > 1:
            path = path.with_stem(f"{path.stem}_{k + 1}")
        parts.append(replace(source, path=path, columns=common | own))
    return parts


def _one_clock(source: Source, elements: Sequence[str]) -> bool:
    """Whether the `elements` of a list are columns of one recording: the rows of a text, or arrays
    as long as the times that stand beside the list.
    """
    if source.rows is not None:
        return True
    times = [name for name in source.columns if name not in elements and TIME.fullmatch(name)]
    lengths = {len(np.atleast_1d(source.columns[name])) for name in times}
    lengths.discard(1)
    if not lengths:
        return False
    return all(len(np.atleast_1d(source.columns[name])) in lengths for name in elements)


def joint_names_of(source: Source) -> list[str]:
    """Names of the joints that stand beside arrays of all joints (`joint_names`, `dof_names`), in
    the order of the arrays; empty where no one list says them.
    """
    lists = []
    for name, values in source.columns.items():
        if source.rows is not None or not _NAMES.fullmatch(name):
            continue
        cells = np.squeeze(np.asarray(values))
        if cells.ndim == 1 and cells.dtype.kind in "UO" and all(isinstance(c, str) for c in cells):
            lists.append([str(c) for c in cells])
    if len(lists) != 1 or len(set(lists[0])) != len(lists[0]):
        return []
    return lists[0]


def series_of(columns: Arrays, length: int | None) -> Arrays:
    """Every column of one axis; an array of two axes as one column a row of its shorter axis
    (`length` decides): `q[0]` …
    """
    out: Arrays = {}
    for name, values in columns.items():
        if isinstance(values, list):
            out[name] = values
            continue
        array = np.asarray(values)
        if array.ndim > 2:
            values = array = np.squeeze(array)
        if array.ndim == 1:
            out[name] = values
        elif array.ndim == 2:
            rows = _in_rows(array, length)
            out |= {f"{name}[{k}]": rows[:, k] for k in range(min(rows.shape[1], 200))}
            if rows.shape[1] == 1:
                out[name] = rows[:, 0]
    return out


def _in_rows(array: np.ndarray, length: int | None) -> np.ndarray:
    """An array of two axes with the samples along the first: the axis of this length, else the
    longer one.
    """
    first, second = array.shape
    if first != length and (second == length or first < second):
        return array.T
    return array


def find_column(source: Source, columns: Arrays, column: str) -> str | None:
    """A column by its name, by its number from 1, or by the end of its path where that is
    unique.
    """
    if column in source.twice:
        numbers = source.twice[column]
        message = (
            f"column {column!r} stands twice (columns {' and '.join(map(str, numbers))}, which"
            " differ)"
        )
        raise refused(source.path, message, f"Name one by its number, as in q={numbers[0]}:rad")
    if column in columns:
        return column
    in_order = source.rows is not None or len(source.columns) == 1
    if in_order and column.isdigit() and 1 <= int(column) <= len(columns):
        return list(columns)[int(column) - 1]
    ends = [n for n in columns if n.endswith("." + column)]
    if len(ends) == 1:
        return ends[0]
    headed = re.fullmatch(r"(.*\S)\s*[\[(][^\[\]()]*[\])]", column)
    if headed and headed[1] in columns and headed[1] in source.units:
        return headed[1]  # as its header has it, unit and all
    return None


def stated_rate(source: Source) -> tuple[str, float] | None:
    """A sampling rate that the file states: its name, and Hz."""
    found = _first_number(source.columns, _RATES)
    if found is not None:
        return found
    found = _first_number(source.columns, _STEPS)
    if found is not None:
        name, step = found
        return name, 1 / step
    return None


def _first_number(columns: Arrays, names: Sequence[str]) -> tuple[str, float] | None:
    """The first column of one of these names that is a single number above 0, and that number."""
    for name, value in columns.items():
        known = name.rpartition(".")[2] in names
        if known and np.size(value) == 1 and np.asarray(value).dtype.kind in "iuf":
            number = float(np.ravel(value)[0])
            if number > 0:
                return name, number
    return None


def times_of(
    source: Source, cells: Any, name: str, unit: str | None, rows: tuple[int, int] | None
) -> tuple[np.ndarray, int | None]:
    if not unit and source.units.get(name) in PER_SECOND:
        unit = source.units[name]
    numbers = source.table(name, cells).numbers(name).values
    if (why := contradicted(numbers, unit)) is not None:
        raise refused(source.path, f"column {name}: {why[0]}", f"Write --channel t={name}:{why[1]}")
    t, start = since_start(cells, numbers, unit)
    if start is not None:
        return t, start
    chosen = slice(None) if rows is None else slice(*rows)
    if not np.isfinite(t[chosen]).all():
        numbers_of(source, cells, name, chosen, len(t[chosen]))
    doubted = impossible(t[chosen], name) if unit is None else None
    if doubted is not None:
        option = rf"--channel t={name}:\1"
        message, remedy = (re.sub(r'time_unit = "(\w+)"', option, said) for said in doubted)
        raise DatasetError([DatasetProblem(source.path.name, None, name, message, remedy)])
    return t, start


def numbers_of(
    source: Source,
    cells: Any,
    column: str,
    chosen: slice,
    length: int,
    notes: list[str] | None = None,
) -> np.ndarray:
    """A column as numbers at the chosen rows; raises `DatasetError` with the first cell that is
    none.

    With `notes`, blank cells are NaN, which a note counts; without, they are at fault like any
    other.
    """
    table = source.table(column, cells)
    numbers = table.numbers(column)
    values = numbers.values[chosen]
    if len(values) != length:
        raise refused(
            source.path,
            f"{column!r} has {len(values)} samples, the time {length}",
            "Name arrays of one recording",
        )
    among = range(*chosen.indices(len(cells)))
    bad = sorted(k for k in numbers.faults if k in among)
    blank = [k for k in bad if numbers.faults[k] == "missing" and k not in source.ragged]
    if notes is not None and blank:
        bad = sorted({*bad} - {*blank})
        if length - len(blank) < MINIMUM_SAMPLES:
            message = (
                f"{column!r} holds {length - len(blank)} readings in {length} rows; the other cells"
                " are blank"
            )
            raise refused(
                source.path,
                message,
                f"Leave it out; fewer than {MINIMUM_SAMPLES} readings say too little",
            )
        notes.append(
            f"{source.path.name}: {len(blank)} of {length} cells of {column} are blank, no reading"
            " there"
        )
    if bad:
        first = bad[0]
        what = numbers.faults[first]
        if first in source.ragged:
            what = f"{source.ragged[first]} fields where the others have {len(source.columns)}"
        if len(bad) > 1:
            what += f"; so {len(bad)} rows"
        row = table.row(first) if source.rows is not None else None
        remedy = f"Correct it, or choose other rows: --rows 0:{first}"
        raise DatasetError([DatasetProblem(table.file, row, column, what, remedy)])
    return values
