"""What a framework is asked for: rows that say which field carries what, and files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from jaxid.robots.export.law_code import law_of, why_not
from jaxid.robots.export.outcome import AS_STATED
from jaxid.robots.export.sheet import RobotChange, Sheet


#: From the files of a patch (name -> text), the name of the robot's among them and the rows of what
#: they carry to how far its run in a simulator is from the recording, rms by joint; None where it
#: has no run.
Trial = Callable[[Mapping[str, str], str, Sequence["ExportRow"]], Mapping[str, float] | None]
#: By so much of its own size at one joint a run has to be nearer to a recording than another.
NEARER = 0.01


def nearer(off: Mapping[str, float] | None, than: Mapping[str, float] | None) -> bool:
    """Whether one run of a robot is nearer to the recording than another one: the likelihood of all
    joints together, with the size of each one's noise unknown.
    """
    if off is None or than is None:
        return False
    gained = sum(
        np.log(max(than[joint], 1e-300) / max(left, 1e-300)) for joint, left in off.items()
    )
    return bool(gained > NEARER)


EXACT, APPROXIMATE, CODE, NONE = "exact", "approximate", "code", "none"


@dataclass(frozen=True)
class ExportRow:
    """One effect or number and the field that carries it: `how` is exact, approximate, code (no
    field; the code is in a file) or none.
    """

    effect: str
    location: str
    field: str
    value: Any
    unit: str
    how: str
    note: str

    @property
    def kept(self) -> bool:
        """Whether it stays as the file has it."""
        return AS_STATED in self.note

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def of(cls, entry: Mapping[str, Any]) -> ExportRow:
        """A row as `to_dict` wrote it; what is missing is empty."""
        words = ("effect", "location", "field", "unit", "how", "note")
        return cls(value=entry.get("value"), **{word: str(entry.get(word, "")) for word in words})


@dataclass
class Written:
    """Rows and files (name -> text) of one framework; `notes` are for the reader."""

    rows: list[ExportRow] = field(default_factory=list)
    files: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Field:
    """A field of a framework for a quantity: `name` with {joint} and {link} filled in, how well it
    says it, in which unit where that is not SI's, and a `factor` from SI to it. `one`: the field
    has one limit for both directions.
    """

    name: str
    how: str = EXACT
    note: str = ""
    unit: str | None = None
    factor: float = 1.0
    one: bool = False


def value_of(sheet: Sheet, change: RobotChange) -> Any:
    """The number of a change as it stands in the end: both limits of a force, a vector of gravity,
    else one number.
    """
    if change.quantity == "force":
        n = sheet.after[change.place]
        return [n.lowest, n.highest]
    if change.quantity == "gravity" and sheet.gravity is not None:
        return [float(v) for v in sheet.gravity[1]]
    return change.value


def scaled(value: Any, factor: float) -> Any:
    return (
        [factor * v for v in value]
        if isinstance(value, list)
        else factor * value
        if isinstance(value, float)
        else value
    )


def rows_of(
    sheet: Sheet, fields: Mapping[str, Field], lacking: Callable[[RobotChange], ExportRow]
) -> list[ExportRow]:
    """A row for each change; `lacking` makes that of a quantity without a field."""
    rows = []
    for c in sheet.changes:
        known = c.quantity in fields
        rows.append(row(sheet, c, fields[c.quantity]) if known else lacking(c))
    return rows


def row(sheet: Sheet, change: RobotChange, own: Field) -> ExportRow:
    name = own.name.replace("{joint}", change.place).replace("{link}", change.place)
    unit = change.unit if own.unit is None else own.unit
    value, how, note = scaled(value_of(sheet, change), own.factor), own.how, own.note
    if own.one:
        low, high = (getattr(sheet.after[change.place], k) for k in ("lowest", "highest"))
        value = limit([low, high])
        if low != -high:
            how, note = (
                APPROXIMATE,
                joined(f"one limit for both directions: the larger of {low:g} and {high:g}", note),
            )
    return ExportRow(
        change.effect,
        change.location,
        name,
        value,
        unit,
        how,
        joined(note, was(change, own.factor), change.note),
    )


def limit(force: Iterable[float]) -> float | None:
    """The larger of both limits of a force, None where neither is finite."""
    finite = [abs(v) for v in force if np.isfinite(v)]
    return max(finite) if finite else None


def was(change: RobotChange, factor: float = 1.0) -> str:
    """What stood there before."""
    if (
        not isinstance(change.before, float)
        or not np.isfinite(change.before)
        or change.before == change.value
    ):
        return ""
    return f"before: {factor * change.before:.6g}"


def joined(*notes: str) -> str:
    return "; ".join(n for n in notes if n)


def _who_does(file: str, each_step: bool) -> str:
    """Who makes a law that no field says."""
    if not file:
        return "no field has it: a plugin of your own would do it"
    if each_step:
        return f"no field has it: {file} does it each step"
    return f"no field has it: {file} has it, for a plugin of your own"


def coded(
    file: str,
    more: Mapping[str, str] | None = None,
    how: str = CODE,
    remembers: bool = True,
) -> Callable[[RobotChange], ExportRow]:
    """Makes the rows of what has no field: `code` where `file` holds its law, else `none` with the
    reason. `more`: quantities that are said elsewhere than in a field, with a sentence; `how` that
    counts. `remembers`: whether the file can hold laws with a memory.
    """

    def lacking(change: RobotChange) -> ExportRow:
        if more and change.quantity in more:
            note = joined(more[change.quantity], change.note)
            return ExportRow(
                change.effect, change.location, "", change.value, change.unit, how, note
            )
        law = law_of(change.quantity)
        if law is not None and change.place:
            held = bool(file) and (remembers or not law.memory)
            who = _who_does(file if held else "", each_step=remembers)
            note = joined(who, law.words, change.note)
            return ExportRow(
                change.effect,
                change.location,
                "",
                change.value,
                change.unit,
                CODE if held else NONE,
                note,
            )
        return ExportRow(
            change.effect,
            change.location,
            "",
            change.value,
            change.unit,
            NONE,
            joined(reason(change), change.note),
        )

    return lacking


def reason(change: RobotChange) -> str:
    if why := why_not(change.quantity):
        return why
    if change.quantity == "sliding_friction":
        return "set it where your simulator has the contact of this shape with the ground"
    if not change.quantity:
        return "a number of jaxid's model that no field stands for"
    if law_of(change.quantity) or not change.place:
        return "it is at no joint of the robot"
    return "no field says it"


def by_joint(sheet: Sheet, quantities: Iterable[str]) -> dict[str, dict[str, Any]]:
    """For code: the numbers that changed, joint by joint."""
    out: dict[str, dict[str, Any]] = {}
    wanted = set(quantities)
    for c in sheet.changes:
        if c.quantity in wanted and c.place in sheet.after:
            out.setdefault(c.place, {})[c.quantity] = value_of(sheet, c)
    return out
