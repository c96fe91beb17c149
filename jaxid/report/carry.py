"""What to do with a result: the values to write, the commands that carry it into a simulator."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, TYPE_CHECKING

from jaxid.base import wording
from jaxid.dynamics.catalogue import TARGETS
from jaxid.fitting.result import Estimate, Fit
from jaxid.identification.result import Identification
from jaxid.report.effect_text import named_places
from jaxid.report.page import Section
from jaxid.robots.export.target import APPROXIMATE, EXACT, NONE


if TYPE_CHECKING:
    from jaxid.robots.export.target import ExportRow


#: How a note of an export begins that says what the file had.
BEFORE = "before: "


class Change(NamedTuple):
    """A number of a robot's file as it is written, and as it stood there ("" where it did not)."""

    name: str
    value: str
    before: str
    field: str


class ValueToWrite(NamedTuple):
    """A number to write: which it is, what was stated (None for a number of an effect), what the
    data say.
    """

    name: str
    stated: float | None
    found: Estimate


def section(result: Fit | Identification, file: str, believed: bool = True) -> Section | None:
    """The commands for the result of a robot, the values for another model; None where there are
    none. `file` is the name of the result's JSON, `believed` whether its numbers may be written.
    """
    robot = getattr(result, "robot", None) or {}
    if robot.get("file"):
        return _of_robot(result, file, Path(robot["file"]))
    values = values_to_write(result) if believed and isinstance(result, Fit) else []
    if not values:
        return None
    beside = any(value.stated is not None for value in values)
    told = {"values": values, "beside": beside, "file": file, "targets": TARGETS}
    return Section("values.html", told)


def values_to_write(fit: Fit) -> list[ValueToWrite]:
    """Stated numbers that the data refute, and the numbers of the effects."""
    found: list[ValueToWrite] = []
    for s in fit.stated:
        if s.refuted and s.parameter in fit.parameters:
            found.append(ValueToWrite(s.parameter, s.stated, fit.parameters[s.parameter]))
    for effect in fit.effects:
        for name, estimate in effect.parameters.items():
            found.append(ValueToWrite(f"{name} of {effect}", None, estimate))
    return found


def _of_robot(result: Any, file: str, name: Path) -> Section:
    to = "urdf" if name.suffix.lower() == ".urdf" else "mjcf"
    written = changes(result, to)
    return Section(
        "carry.html",
        {
            "lines": _commands(written, to, file, name.name),
            "robot": name.name,
            "changes": list(map(change, written or [])),
            "remarks": remarks(written or []),
        },
    )


def _commands(
    written: Sequence[ExportRow] | None, to: str, file: str, name: str
) -> list[tuple[str, str]]:
    """What can be typed, and what it makes; none where nothing is to be carried over. `written`:
    what the patched file says otherwise, None where that is not known.
    """
    if written is not None and not any(row.how != NONE for row in written):
        return []
    found = "your own file with what was found"
    in_the_file = written is None or any(row.how in (EXACT, APPROXIMATE) for row in written)
    if not in_the_file:
        found = "the law in Python, to be called at each step, for no field of your file has it"
    lines = [
        (
            f"jaxid export {file} --to {to} --ranges --out patched",
            f"{found}, and ranges to randomise by",
        )
    ]
    if in_the_file:
        patched = shlex.quote(f"patched/{name}")
        lines.append(
            (
                f"jaxid replay DATASET --robot {patched} --out round_trip",
                "the patched file in MuJoCo on the same log, joint by joint",
            )
        )
    return lines


def changes(result: Any, to: str) -> list[ExportRow] | None:
    """What the patched file says otherwise; None where the file is not at hand."""
    from jaxid.base.errors import UsageError

    try:
        rows = result.export(to).rows
    except (UsageError, OSError):
        return None
    return [row for row in rows if not row.kept]


def change(row: ExportRow) -> Change:
    """A line of the page."""
    name = f"{row.effect} at {row.location}" if row.location else row.effect
    before = [part.removeprefix(BEFORE) for part in _parts(row) if part.startswith(BEFORE)]
    value = f"{_value(row.value)}{wording.unit_after(row.unit)}"
    return Change(name, _together(value), " ".join(before), row.field)


def remarks(rows: Sequence[ExportRow]) -> list[str]:
    """What is to be said of the numbers, each sentence once with those that it is of."""
    said: dict[str, list[tuple[str, str]]] = {}
    for row in rows:
        for part in _parts(row):
            if not part.startswith(BEFORE):
                said.setdefault(part, []).append((row.effect, row.location))
    told = []
    for part, numbers in said.items():
        names = [_placed(effect, at) for effect, at in wording.by_effect(numbers).items()]
        told.append(f"{wording.listed(names)}: {part.rstrip('.')}.")
    return told


def _parts(row: ExportRow) -> list[str]:
    return [part for part in row.note.split("; ") if part]


def _placed(effect: str, places: Sequence[str]) -> str:
    named = [place for place in places if place]
    return f"{effect} at {named_places(named)}" if named else effect


def _together(value: str) -> str:
    """Each number on one line with its unit; several break between them."""
    return value.replace(" ", "\u00a0").replace(",\u00a0", ", ")


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_value(one)}" for name, one in value.items())
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    return wording.number(value, 4) if isinstance(value, float) else str(value)
