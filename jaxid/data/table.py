"""A data file as a table of columns, each fault with its row and column: CSV, Parquet, or
arrays.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import DatasetProblem, nearest
from jaxid.data.list_cells import with_list_elements


_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "?"}
_DECIMAL_COMMA = re.compile(r"[+-]*(\d+,\d*|\d*,\d+)")


@dataclass(frozen=True)
class NumericColumn:
    """A column as float64, NaN where a cell is no finite number; `faults`: sample index -> what
    stands there.
    """

    values: np.ndarray
    faults: dict[int, str]


@dataclass
class Table:
    """Columns of equal length. `rows` is the row of each sample as an editor shows it, None for
    arrays in memory.

    `ragged` are samples whose row has another count of fields than the header, with that count;
    `twice` are names that stand over several, different columns, with their numbers.
    """

    file: str
    columns: Mapping[str, Any]
    count: int
    rows: np.ndarray | None = None
    problems: list[DatasetProblem] = field(default_factory=list)
    ragged: Mapping[int, int] = field(default_factory=dict)
    twice: Mapping[str, list[int]] = field(default_factory=dict)
    _numbers: dict[str, NumericColumn] = field(default_factory=dict)

    def row(self, sample: int) -> int:
        return int(self.rows[sample]) if self.rows is not None else sample

    def place(self, sample: int) -> str:
        if self.rows is None:
            return f"sample at index {sample}"
        return f"sample {self.row(sample) - 1} (row {self.row(sample)})"

    def find(self, column: str | int) -> str | None:
        """The name of a column that is given by name or by number, from 1; None where there is
        none.
        """
        if isinstance(column, int):
            return list(self.columns)[column - 1] if 1 <= column <= len(self.columns) else None
        return column if column in self.columns else None

    def ambiguous(self, column: str | int) -> DatasetProblem | None:
        """What to say of a name that stands over several columns."""
        if column not in self.twice:
            return None
        numbers = self.twice[str(column)]
        which = " and ".join(map(str, numbers))
        message = f"column {column!r} stands twice (columns {which}, which differ)"
        return DatasetProblem(
            self.file, 1, str(column), message, f"Name one by its number: column = {numbers[0]}"
        )

    def missing(self, column: str | int, role: str) -> DatasetProblem:
        header, remedy = None, "Name a column that exists"
        if self.rows is not None:
            header = 1
            remedy = (
                "Add the column, or name the one to read with `column` (of a channel) or `time`"
                " (top level)"
            )
        if isinstance(column, int):
            message = f"there is no column {column} for {role}: the file has {len(self.columns)}"
            return DatasetProblem(self.file, header, None, message, "Columns count from 1")
        message = f"there is no column {column!r} for {role}{nearest(column, self.columns)}"
        return DatasetProblem(self.file, header, column, message, remedy)

    def numbers(self, column: str) -> NumericColumn:
        """A column as numbers; converted once."""
        if column not in self._numbers:
            self._numbers[column] = _as_numbers(self.columns[column])
        return self._numbers[column]

    def release(self) -> None:
        """Gives the memory of the samples back: of a table that is read no more."""
        self._numbers.clear()
        object.__setattr__(self, "columns", {})

    def equal(self, column: str, value: str | bool | int | float) -> np.ndarray:
        """Where a column holds `value`, for `where`; text compares as text, numbers as numbers."""
        cells = self.columns[column]
        if isinstance(value, bool):
            words = {"true", "1", "1.0"} if value else {"false", "0", "0.0"}
            return np.array([str(c).strip().lower() in words for c in cells], dtype=bool)
        if isinstance(value, str):
            return np.array([str(c).strip() == value.strip() for c in cells], dtype=bool)
        return self.numbers(column).values == float(value)


def _cell(text: Any) -> tuple[float, str | None]:
    """One cell as a number, or NaN and what is wrong with it."""
    word = str(text).strip()
    if word.lower() in _MISSING:
        return np.nan, "missing"
    value = _number(word)
    if np.isfinite(value):
        return value, None
    if "inf" in word.lower():
        return np.nan, "infinite"
    shown = word if len(word) <= 40 else word[:37] + "..."
    hint = ", a decimal comma" if _DECIMAL_COMMA.fullmatch(word) else ""
    return np.nan, f"not a number: {shown!r}{hint}"


def _number(word: str) -> float:
    """The number that a word is, not a number for any other."""
    if "_" in word:  # which Python takes in numbers
        return np.nan
    try:
        return float(word)
    except ValueError:
        return np.nan


def _as_numbers(cells: Any) -> NumericColumn:
    if not isinstance(cells, list):
        array = np.asarray(cells)
        if array.dtype.kind in "biuf":
            return _finite(array.astype(float, copy=False))
        if array.dtype.kind in "Mm":
            faults = dict.fromkeys(range(len(array)), "a date, not a number")
            return NumericColumn(np.full(len(array), np.nan), faults)
    cells = list(cells)
    try:
        if not any("_" in cell for cell in cells):
            values = np.array([float(cell) for cell in cells], dtype=float)
            if np.isfinite(values).all():
                return NumericColumn(values, {})
    except (ValueError, TypeError):
        pass
    values, faults = np.empty(len(cells)), {}
    for i, cell in enumerate(cells):
        values[i], fault = _cell(cell)
        if fault is not None:
            faults[i] = fault
    return NumericColumn(values, faults)


def _finite(values: np.ndarray) -> NumericColumn:
    """Numbers [row], of which those that are not finite are faults."""
    faults = {}
    for i in np.flatnonzero(~np.isfinite(values)):
        faults[int(i)] = "missing" if np.isnan(values[i]) else "infinite"
    if faults:
        values = values.copy()
        values[list(faults)] = np.nan
    return NumericColumn(values, faults)


def table_of_arrays(name: str, columns: Mapping[str, Any]) -> Table:
    """A table of arrays in memory; unequal lengths and shapes other than [time] are its
    problems.
    """
    problems, good = [], {}
    first, count = "", 0
    uneven = []

    def problem(column: str, message: str, remedy: str) -> DatasetProblem:
        return DatasetProblem(name, None, column, message, remedy)

    for column, values in columns.items():
        array = np.asarray(values)
        if array.ndim != 1:
            message = f"an array of shape {array.shape}"
            problems.append(problem(column, message, "Give one number a sample: shape [time]"))
            continue
        if array.dtype.kind == "c":
            problems.append(problem(column, "complex numbers", "Give real numbers"))
            continue
        if not good:
            first, count = column, len(array)
        good[column] = array if array.dtype.kind in "biufMm" else array.tolist()
        if len(array) != count:
            message = f"{len(array)} samples, but {first!r} has {count}"
            uneven.append(problem(column, message, "Give equal lengths"))
    problems += uneven
    if problems:
        return Table(name, {}, 0, problems=problems)
    return Table(name, good, count)


def read_table(path: Path, file: str, content: bytes, *, numbered: bool = False) -> Table:
    """The table of a `.csv` or `.parquet` file, whose bytes are `content`; one of `numbered`
    columns needs no header.
    """
    if path.suffix.lower() in (".parquet", ".pq"):
        return _read_parquet(file, content)
    return _read_csv(file, content, numbered)


def _broken(
    file: str, row: int | None, message: str, remedy: str, column: str | None = None
) -> Table:
    return Table(file, {}, 0, problems=[DatasetProblem(file, row, column, message, remedy)])


def _read_parquet(file: str, content: bytes) -> Table:
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not content:
        return _broken(file, None, "the file is empty", "Write a header row and samples")
    try:
        whole = pq.ParquetFile(pa.BufferReader(content))  # without threads, see `_owned_by_arrow`
        names, rows = whole.schema_arrow.names, whole.metadata.num_rows
        plain = len(set(names)) == whole.metadata.num_columns and "." not in "".join(names)
        if plain:  # one at a time, for memory's sake
            arrow = (whole.read(columns=[n], use_threads=False).column(0) for n in names)
        else:
            arrow = whole.read(use_threads=False).columns
        named, twice = distinct(names, list(map(_arrow_column, arrow)))
        columns = with_list_elements(named)
        pa.default_memory_pool().release_unused()
    except (pa.ArrowException, OSError, ValueError, NotImplementedError) as error:
        said = str(error).strip() or type(error).__name__
        message = f"not readable as Parquet ({said.splitlines()[0][:120]})"
        return _broken(file, None, message, "Write the file again, or give CSV")
    if rows == 0:
        return _broken(file, 1, "a header without samples", "Give at least 20 samples")
    return Table(file, columns, rows, np.arange(rows) + 2, twice=twice)


def _arrow_column(column: Any) -> Any:
    import pyarrow as pa

    kind = column.type
    whole = column.num_chunks and not column.null_count
    if pa.types.is_integer(kind) or pa.types.is_floating(kind):
        # Whole numbers stay: a clock in ns does not fit a float.
        if not (whole and pa.types.is_integer(kind)):
            column = column.cast(pa.float64(), safe=False)
        if not whole:
            return column.to_numpy()
        # `to_numpy` imports pandas, 0.2 s.
        return np.concatenate(list(map(np.from_dlpack, column.chunks)))
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        what = "M" if pa.types.is_timestamp(kind) else "m"
        return np.asarray(column.cast(pa.int64()).to_pylist()).astype(f"{what}8[{kind.unit}]")
    return column.to_pylist()


def _read_csv(file: str, content: bytes, numbered: bool = False) -> Table:
    fault = _not_text(content)
    if fault is not None:
        return _broken(file, *fault)
    if (numbers := _read_numbers(file, content)) is not None:
        return numbers
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content.count(b"\n", 0, error.start) + 1
        return _broken(file, row, "a character that is not UTF-8", "Save the file as UTF-8")
    lines: list[list[str]] = []
    rows: list[int] = []
    reader = csv.reader(io.StringIO(text, newline=None), skipinitialspace=True, strict=True)
    try:
        for fields in reader:
            lines.append(fields)
            rows.append(reader.line_num)
    except csv.Error as error:
        remedy = "Check the quotes in and before this row"
        return _broken(file, reader.line_num, f"not readable as CSV ({error})", remedy)
    while lines and not any(f.strip() for f in lines[-1]):
        lines.pop()
        rows.pop()
    header = [name.strip() for name in lines[0]]
    if numbered and _all_numbers(header):
        return csv_columns(file, [str(k + 1) for k in range(len(header))], lines, rows)
    fault = _header_fault(file, header, lines[1:])
    if fault is not None:
        return Table(file, {}, 0, problems=[fault])
    return csv_columns(file, header, lines[1:], rows[1:])


def _not_text(content: bytes) -> tuple[int | None, str, str] | None:
    """Row, fault and remedy of a file that holds no text in UTF-8."""
    if not content.strip():
        return (
            None,
            "the file is empty",
            "Write a header row of channel names and one row a sample",
        )
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return 1, "the text is UTF-16", "Save the file as UTF-8"
    nul = content.find(b"\0")
    if nul < 0:
        return None
    row = content.count(b"\n", 0, nul) + 1
    return row, "binary data, not text", "Give CSV as text, or name a Parquet file .parquet"


def _all_numbers(cells: Sequence[str]) -> bool:
    """Whether the cells that hold something, of which there is one, hold numbers."""
    filled = [cell for cell in cells if cell]
    return bool(filled) and all(_cell(cell)[1] is None for cell in filled)


def _read_numbers(file: str, content: bytes) -> Table | None:
    """The table of a plain file of names and numbers, fast and in little memory; None for anything
    else, which is read row by row so that each fault has its place.
    """
    import pyarrow as pa
    from pyarrow import csv as arrow

    names = _plain_header(content)
    if names is None:
        return None
    owned = _owned_by_arrow(content)
    try:
        table = arrow.read_csv(
            pa.BufferReader(owned),
            arrow.ReadOptions(skip_rows=1, column_names=names),
            arrow.ParseOptions(ignore_empty_lines=False),
            arrow.ConvertOptions(null_values=[""], strings_can_be_null=False),
        )
    except (pa.ArrowException, OSError, ValueError):
        return None
    if table.num_rows == 0:
        return None
    for column in table.columns:
        is_number = pa.types.is_integer(column.type) or pa.types.is_floating(column.type)
        if not is_number or column.null_count:
            return None
    columns = {name: _arrow_column(table.column(i)) for i, name in enumerate(names)}
    return Table(file, columns, table.num_rows, np.arange(table.num_rows) + 2)


def _plain_header(content: bytes) -> list[str] | None:
    """The names in the first row, of which each stands once; None for anything else."""
    end = content.find(b"\n")
    head = content[: max(end, 0)]
    if end < 0 or content.find(b'"', end) >= 0 or not head.isascii():
        return None
    cells = next(csv.reader([head.decode().strip()], skipinitialspace=True), [])
    names = [cell.strip() for cell in cells]
    if not all(names) or len(set(names)) < len(names):
        return None
    if all(_cell(name)[1] is None for name in names):
        return None
    return names


def _owned_by_arrow(content: bytes) -> Any:
    """The bytes in memory of Arrow's own, for its reader of CSV, which always has a thread read
    ahead.

    Bytes of Python may be let go last by such a thread. Where that happens while the interpreter
    ends, the process is aborted ("terminate called without an active exception"). So Arrow's
    threads hold no memory of Python.
    """
    import pyarrow as pa

    buffer = pa.allocate_buffer(len(content))
    memoryview(buffer).cast("B")[:] = content
    return buffer


def _header_fault(
    file: str, header: Sequence[str], lines: Sequence[Sequence[str]]
) -> DatasetProblem | None:
    message = _other_separator(header, lines)
    if message is not None:
        remedy = (
            "`jaxid import csv` reads it as it is; or save it with commas between columns and"
            " decimal points"
        )
        return DatasetProblem(file, 1, None, message, remedy)
    if not any(header):
        remedy = "Let the first row name the columns"
        return DatasetProblem(file, 1, None, "the first row is empty", remedy)
    if all(_cell(name)[1] is None for name in header):
        remedy = (
            "Let the first row name the columns, or name them by number: time = 1, and column = 2"
            " for a channel"
        )
        return DatasetProblem(file, 1, None, "the first row holds numbers, not names", remedy)
    if not lines:
        return DatasetProblem(file, 1, None, "a header without samples", "Give at least 20 samples")
    return None


def _other_separator(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str | None:
    """What else than commas separates the columns of what was read as one column."""
    if len(header) != 1:
        return None
    for sign, word in ((";", "semicolons"), ("\t", "tabs")):
        if sign not in header[0]:
            continue
        decimal_commas = any(len(fields) > 1 or "," in fields[0] for fields in lines[:3] if fields)
        return f"columns separated by {word}" + " and decimal commas" * decimal_commas
    return None


def csv_columns(
    file: str, header: Sequence[str], lines: Sequence[list[str]], rows: Sequence[int]
) -> Table:
    """The table of rows of text; a row with another count of fields is a sample whose cells are
    missing.
    """
    width = len(header)
    kept, ragged = [], {}
    for sample, fields in enumerate(lines):
        while len(fields) > width and not fields[-1].strip():
            fields.pop()
        if len(fields) != width:
            ragged[sample] = len(fields)
            fields = [""] * width
        kept.append(fields)
    if len(ragged) == len(kept):
        return Table(file, {}, 0, problems=[ragged_rows(file, list(rows), ragged, width)])
    named, twice = distinct(
        [name or str(k + 1) for k, name in enumerate(header)],
        [list(c) for c in zip(*kept, strict=True)],
    )
    return Table(
        file, with_list_elements(named), len(kept), np.array(rows), ragged=ragged, twice=twice
    )


def ragged_rows(
    file: str, rows: Sequence[int], ragged: Mapping[int, int], width: int
) -> DatasetProblem:
    """One problem for all rows with another count of fields than the header's."""
    sample, found = next(iter(ragged.items()))
    more = f"; so {len(ragged)} rows" if len(ragged) > 1 else ""
    comma = ", decimal commas perhaps" if found == 2 * width else ""
    what = "an empty row" if found == 0 else f"{found} fields where the header has {width}{comma}"
    remedy = (
        "Give one field a column in every row; `jaxid import csv` reads a file that begins with"
        " other lines"
    )
    return DatasetProblem(file, rows[sample], None, what + more, remedy)


def distinct(
    names: Sequence[str], columns: Sequence[Any]
) -> tuple[dict[str, Any], dict[str, list[int]]]:
    """Columns by name, and which names stand over several columns that differ (with their numbers);
    each keeps its place.
    """
    out: dict[str, Any] = {}
    places: dict[str, list[int]] = {}
    for number, (name, column) in enumerate(zip(names, columns, strict=True), 1):
        places.setdefault(name, []).append(number)
        key = name if len(places[name]) == 1 else f"{name} (column {number})"
        out[key] = column
    differing = {}
    for name, numbers in places.items():
        first = list(out[name])
        if any(list(columns[number - 1]) != first for number in numbers[1:]):
            differing[name] = numbers
    return out, differing
