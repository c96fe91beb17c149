"""Tables that instruments and scripts write as text: separator, decimal sign, preamble, header,
units and comments recognised.

The rows that hold the data are looked for from the end of the file, where nothing else stands; what
is above them is then the header, the units and the preamble.
"""

from __future__ import annotations

import csv
import datetime
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path

from jaxid.base.errors import DatasetError, UsageError
from jaxid.data.importers.runs import refused
from jaxid.data.table import csv_columns, Table
from jaxid.data.time_axis import CLOCK
from jaxid.data.units import conversion, UnitError


SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
#: What a separator is called on the command line.
_WORDS = {"tab": "\t", "\\t": "\t", "space": " ", "comma": ",", "semicolon": ";"}
#: How one is written there that a shell would not show.
_SHOWN = {"\t": "tab", " ": "space"}
COMMENTS = ("#", "%", "//")
_BODY = 60  # rows at the end that say how numbers are written, at most half of all


_LIST = re.compile(
    r"(?:array|tensor)?[\[(]+(?:'\w',)?\s*[\[(]*\s*[-+.\d]"
)  # `[0.1, 0.2]`, `array([0.1])`; units in brackets are none
_TORN = re.compile(
    r"[\d\s.,;|+\-eE]*[.,;|\s][\d\s.,;|+\-eE]*\d[\d\s.,;|+\-eE]*"
)  # numbers that another sign separates


@dataclass(frozen=True)
class TextFormat:
    """How a file writes its table. Rows count from 1, as an editor shows them; `header` and `units`
    are None where there is none, `comment` begins rows that are passed over.
    """

    separator: str
    decimal: str
    first: int
    header: int | None
    units: int | None
    comment: str | None

    def options(self) -> str:
        """The options of `jaxid import csv` that say it."""
        decimal = None if self.decimal == "." else self.decimal
        return StatedFormat(self.separator, decimal, self.header or 0, self.first).options()

    def words(self) -> str:
        said = [f"columns separated by {SEPARATORS.get(self.separator, repr(self.separator))}"]
        if self.decimal == ",":
            said.append("decimal commas")
        said.append(f"header in row {self.header}" if self.header else "no header")
        if self.units:
            said.append(f"units in row {self.units}")
        said.append(f"data from row {self.first}")
        return ", ".join(said)

    def is_comment(self, line: str) -> bool:
        return self.comment is not None and line.lstrip().startswith(self.comment)

    def fields(self, line: str) -> list[str]:
        """The cells of a row."""
        if self.separator == " ":
            return line.split()
        cells = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True), [])
        return [c.strip() for c in cells]

    def names(self, line: str) -> list[str]:
        """The cells of a row of names or units, which may begin like a comment."""
        if self.is_comment(line):
            line = line.lstrip().removeprefix(self.comment or "")
        return self.fields(line)

    def with_point(self, cell: str) -> str:
        """A cell whose number has a decimal point."""
        if self.decimal == "," and re.fullmatch(r"[+-]?\d*,\d*([eE][+-]?\d+)?", cell):
            return cell.replace(",", ".")
        return cell

    def is_data(self, cell: str) -> bool:
        """Whether a cell holds a number, a date or a list."""
        if self.decimal == "," and "." in cell and "," not in cell and not _is_date(cell):
            return False
        text = self.with_point(cell)
        try:
            float(text)
            return "_" not in text
        except ValueError:
            return bool(_LIST.match(text)) or _is_date(text)


@dataclass(frozen=True)
class StatedFormat:
    """What the user says of it himself; None is left to be recognised, a `header` of 0 is none."""

    separator: str | None = None
    decimal: str | None = None
    header: int | None = None
    first: int | None = None

    def options(self) -> str:
        """The options that say it again."""
        separator = self.separator and shlex.quote(_SHOWN.get(self.separator, self.separator))
        header = "none" if self.header == 0 else self.header
        options = {
            "separator": separator,
            "decimal": self.decimal,
            "header": header,
            "first": self.first,
        }
        return " ".join(f"--{name} {value}" for name, value in options.items() if value)


def read_text(
    path: Path, content: bytes, stated: StatedFormat
) -> tuple[Table, dict[str, str], TextFormat]:
    """The table, units of its columns where the file has them, and how it is written.

    Raises `DatasetError` where no rows of numbers are found.
    """
    lines = decoded(path, content).splitlines()
    form = recognise(lines, stated)
    if form is None:
        shown = next((line for line in lines if line.strip()), "")[:60]
        raise refused(
            path,
            f"no rows of numbers are found in it (it begins with {shown!r})",
            "State --separator, --decimal and --header",
        )
    header = None
    names = []
    if form.header:
        header = form.names(lines[form.header - 1])
        names = _stacked(lines, form, header)
    rows, numbers = _rows(lines, form, header)
    if not rows:
        raise refused(path, "a header without samples", "Give at least 20 samples")
    counts = [len(r) for r in rows]
    width = max(dict.fromkeys(counts), key=counts.count)
    names = [*names, *(str(k + 1) for k in range(len(names), width))][:width]
    stripped, units = zip(*(_unit(n) for n in names), strict=True)
    table = csv_columns(path.name, list(stripped), rows, numbers)
    if table.problems:
        raise DatasetError(table.problems)
    said = {name: unit for name, unit in zip(stripped, units, strict=True) if unit}
    if form.units is not None:
        cells = form.names(lines[form.units - 1])
        for name, cell in zip(stripped, cells, strict=False):
            unit = _inside(cell)
            if _known(unit):
                said[name] = unit
    return table, said, form


def _rows(
    lines: Sequence[str], form: TextFormat, header: list[str] | None
) -> tuple[list[list[str]], list[int]]:
    """The cells of the rows of data, numbers with a point, and the lines on which they stand."""
    rows, numbers = [], []
    for number, line in enumerate(lines[form.first - 1 :], form.first):
        if not line.strip() or form.is_comment(line):
            continue
        cells = form.fields(line)
        if any(cells) and cells != header:
            rows.append([form.with_point(c) for c in cells])
            numbers.append(number)
    return rows, numbers


def recognise(lines: Sequence[str], stated: StatedFormat = StatedFormat()) -> TextFormat | None:
    """How rows of text hold a table, or None where none of them are numbers."""
    comment = _comment_sign(lines)
    data: list[int] = []
    for k, line in enumerate(lines):
        is_comment = comment is not None and line.lstrip().startswith(comment)
        if line.strip(" \t,;|") and not is_comment:
            data.append(k)
    if stated.first is not None:
        data = [k for k in data if k >= stated.first - 1]
    half = -(-len(data) // 2)
    body = [lines[k] for k in data[len(data) - min(_BODY, half) :]]
    form, numeric = _best_separators(body, stated, comment)
    if form is None:
        return None
    if stated.first is None:
        form = replace(form, first=_first(lines, data, numeric, form) + 1)
    else:
        form = replace(form, first=stated.first)
    if stated.header is not None:
        return replace(form, header=stated.header or None, first=max(form.first, stated.header + 1))
    return _with_header(lines, len(numeric), form)


def _comment_sign(lines: Sequence[str]) -> str | None:
    """What the first comment among the first lines begins with."""
    begun = [line.lstrip() for line in lines[:1000]]
    first = next(filter(lambda line: line.startswith(COMMENTS), begun), "")
    return next(filter(first.startswith, COMMENTS), None)


def _best_separators(
    body: Sequence[str], stated: StatedFormat, comment: str | None
) -> tuple[TextFormat | None, list[bool]]:
    """The format by which most columns are numbers, and which of them are; None for no numbers."""
    best: TextFormat | None = None
    best_numeric: list[bool] = []
    separators = [stated.separator] if stated.separator else SEPARATORS
    decimals = [stated.decimal] if stated.decimal else [".", ","]
    for separator in separators:
        for decimal in decimals:
            if decimal == separator and not stated.decimal:
                continue
            form = TextFormat(separator, decimal, 1, None, None, comment)
            numeric = _numeric(body, form)
            if sum(numeric) > sum(best_numeric):
                best, best_numeric = form, numeric
    return best, best_numeric


def _numeric(body: Sequence[str], form: TextFormat) -> list[bool]:
    """Which columns of the rows at the end hold numbers, dates or lists; empty where the rows
    differ in their count of fields, or where what is left of numbers shows that another sign
    separates them.
    """
    rows = [form.fields(line) for line in body]
    widths = [len(row) for row in rows]
    width = max(widths, key=widths.count, default=0)
    usual = [row for row in rows if len(row) == width]
    if not usual or len(usual) < 0.9 * len(rows):
        return []
    numeric = []
    for cells in zip(*usual, strict=True):
        written = [c for c in cells if c]
        data = [c for c in written if form.is_data(c)]
        is_numeric = bool(written) and len(data) >= 0.9 * len(written)
        others = set(written) - set(data)
        if not is_numeric and any(map(_TORN.fullmatch, others)):
            return []
        numeric.append(is_numeric)
    return numeric


def _is_date(text: str) -> bool:
    if CLOCK.fullmatch(text):
        return True
    try:
        datetime.datetime.fromisoformat(text.replace(",", "."))
        return len(text) >= 10
    except ValueError:
        return False


def _first(
    lines: Sequence[str], data: Sequence[int], numeric: Sequence[bool], form: TextFormat
) -> int:
    """The first row that looks like those at the end."""
    for k in data:
        cells = form.fields(lines[k])
        if len(cells) == len(numeric):
            written = list(filter(None, compress(cells, numeric)))
            if written and all(map(form.is_data, written)):
                return k
    return data[0]


def _with_header(lines: Sequence[str], width: int, form: TextFormat) -> TextFormat:
    """The form with the header, and the units below it, that stand right above the data."""
    above: list[int] = []
    for k in range(form.first - 2, -1, -1):
        cells = form.names(lines[k])
        written = list(filter(None, cells))
        if not written:
            continue
        if not (width <= len(cells) <= width + 2 or len(written) >= width):
            break
        above.append(k)
        if len(above) == 2:
            break
    if not above:
        return form
    units = [_inside(c) for c in form.names(lines[above[0]]) if c]
    if len(above) == 2 and 2 * len(units) >= width and all(map(_known, units)):
        return replace(form, header=above[1] + 1, units=above[0] + 1)
    return replace(form, header=above[0] + 1)


def _stacked(lines: Sequence[str], form: TextFormat, header: list[str]) -> list[str]:
    """Names that stand in several rows over each other (pandas' levels, merged cells): those above
    are joined before the lowest ones as long as these are not unique or left open.
    """
    names = list(header)
    for row in range((form.header or 1) - 1, 0, -1):
        if all(names) and len(set(names)) == len(names):
            break
        above = form.names(lines[row - 1])
        if len(above) != len(names) or not any(above) or any(map(form.is_data, above)):
            break
        for k in range(1, len(above)):
            above[k] = above[k] or above[k - 1]
        names = [".".join(filter(None, pair)) for pair in zip(above, names, strict=True)]
    return names


def _unit(name: str) -> tuple[str, str]:
    """`q [rad]` or `q (rad)` as name and unit."""
    match = re.fullmatch(r"(.*\S)\s*[\[(]([^\[\]()]*)[\])]", name)
    if match and _known(match[2]) and match[2].strip() and not match[2].strip().isdigit():
        return match[1], match[2].strip()
    return name, ""


def _inside(cell: str) -> str:
    return cell.strip().strip("[]()").strip()


def _known(unit: str) -> bool:
    try:
        conversion(unit, "kg")
        return True
    except UnitError:
        return False


def decoded(path: Path, content: bytes) -> str:
    """The text of a file, by its mark, as UTF-8, or as instruments write it. Raises `DatasetError`
    for binary data.
    """
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", errors="replace")
    if b"\0" in content[:4096]:
        raise refused(
            path,
            "binary data of a kind that is not known",
            "Convert it to CSV, MAT, npz, JSON or Parquet",
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")  # instruments that write ° and µ


def separator_of(text: str | None) -> str | None:
    """A separator as it is stated on the command line."""
    if text is None:
        return None
    found = _WORDS.get(text.lower(), text)
    if len(found) != 1:
        raise UsageError(
            f"--separator {text}: write one character, or tab, space, comma, semicolon"
        )
    return found
