"""What may stand in `dataset.toml`: pydantic models of it, and its faults as problems with the line
of the key.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    BaseModel,
    Field,
    field_validator,
    FiniteFloat,
    model_validator,
    ValidationError,
)

from jaxid.base.errors import DatasetProblem, nearest
from jaxid.data.places import dotted, Places, real_path
from jaxid.data.schema_fields import Number, plain_text, Positive, Strict
from jaxid.data.schema_model import ControllerEntry, ModelEntry, PriorEntry


Split = Literal["fit", "validation", "report"]
Column = str | Annotated[int, Field(ge=1)]  # a name, or a number that counts from 1


class Header(Strict):
    """The top-level keys other than the tables."""

    name: str
    description: str = ""
    source: str | dict[str, str | int | float | datetime.date] | None = None
    licence: str | None = None
    recorded: str | datetime.date | None = None
    hardware: str | None = None
    time: Column = "t"
    time_unit: Literal["s", "ms", "us", "ns"] | None = None

    _name = field_validator("name")(plain_text)

    @field_validator("time")
    @classmethod
    def _time(cls, value: str | int) -> str | int:
        return plain_text(value) if isinstance(value, str) else value


class ChannelEntry(Strict):
    """`[channels.NAME]`. A value is `scale * raw + offset`, in `unit`; raw is a column, or columns
    with weights. What else may be said of how it was recorded is applied to it in that unit
    (`jaxid.data.forms`).
    """

    role: Literal["input", "output", "auxiliary"]
    unit: str
    column: Column | None = None
    columns: list[Column] | None = Field(default=None, min_length=1)
    weights: list[FiniteFloat] | None = None
    valid: Column | None = None
    sign_bit: int | None = Field(default=None, ge=1, le=62)
    signed_bits: int | None = Field(default=None, ge=2, le=63)
    unwrap: bool | FiniteFloat = False
    drop_glitches: bool = False
    sampled_every: int = Field(default=1, ge=1)
    shift: int = 0
    delay_s: FiniteFloat = 0.0
    clock_ppm: FiniteFloat = 0.0
    scale: FiniteFloat = 1.0
    offset: FiniteFloat = 0.0
    noise_std: FiniteFloat | None = Positive
    resolution: FiniteFloat | None = Positive
    hold: Literal["zero", "linear"] = "zero"

    @field_validator("scale")
    @classmethod
    def _scale(cls, value: float) -> float:
        if value == 0:
            raise ValueError("is 0, so every sample would be the offset")
        return value

    @field_validator("unwrap")
    @classmethod
    def _range(cls, value: bool | float) -> bool | float:
        if not isinstance(value, bool) and value <= 0:
            raise ValueError(f"is {value:g}: write true, or the range of the counter above 0")
        return value

    @field_validator("clock_ppm")
    @classmethod
    def _clock(cls, value: float) -> float:
        if not abs(value) < 1e5:
            raise ValueError(
                f"is {value:g}: a clock that is off by a tenth has another unit (time_unit)"
            )
        return value

    @model_validator(mode="after")
    def _together(self) -> ChannelEntry:
        if (self.columns is None) != (self.weights is None):
            raise ValueError(
                "`columns` and `weights` go together: columns = ['m5', 'm6'], weights = [32.0,"
                " 32.0]"
            )
        if self.columns is not None and self.column is not None:
            raise ValueError("both `column` and `columns` say what to read: keep one of them")
        if self.sign_bit is not None and self.signed_bits is not None:
            raise ValueError(
                "`sign_bit` and `signed_bits` are two forms of a register: keep one of them"
            )
        if self.columns is not None and (self.sign_bit or self.signed_bits):
            raise ValueError(
                "a register is one column: `sign_bit` and `signed_bits` do not go with `columns`"
            )
        if self.columns is not None and len(self.columns) != len(self.weights or ()):
            raise ValueError(
                f"{len(self.columns)} columns have {len(self.weights or ())} weights: write one for"
                " each"
            )
        return self


class ExperimentEntry(Strict):
    """`[[experiments]]`: a recorded run, several of them by a pattern (`files`), or a frequency
    response.
    """

    file: str = ""
    files: str | None = None
    name: str | None = None
    split: Split = "fit"
    kind: Literal["record", "frequency_response"] = "record"
    rows: list[int] | None = Field(default=None, min_length=2, max_length=2)
    window_s: list[FiniteFloat] | None = Field(default=None, min_length=2, max_length=2)
    where: dict[str, str | bool | int | FiniteFloat] = {}
    at_rest: bool = False
    initial: dict[str, FiniteFloat] | None = None
    initial_window_s: FiniteFloat | None = Positive
    constants: dict[str, Number] = {}
    split_at_gaps: bool = False
    input: str | None = None
    output: str | None = None
    columns: dict[Literal["omega", "frequency", "gain", "phase", "re", "im"], str] = {}
    phase_unit: Literal["rad", "deg"] = "rad"
    repeat_of: str | None = None

    @field_validator("name", "repeat_of")
    @classmethod
    def _name(cls, value: str | None) -> str | None:
        return value if value is None else plain_text(value)

    @field_validator("rows", "window_s")
    @classmethod
    def _interval(cls, value: list[float] | None) -> list[float] | None:
        if value is not None and not value[0] < value[1]:
            raise ValueError(f"is {value}: the end must lie behind the start")
        return value

    @field_validator("rows")
    @classmethod
    def _not_negative(cls, value: list[int] | None) -> list[int] | None:
        if value is not None and value[0] < 0:
            raise ValueError(f"is {value}: the first sample is number 0")
        return value

    @model_validator(mode="after")
    def _kinds(self) -> ExperimentEntry:
        if self.files is not None and (self.file or self.name is not None):
            raise ValueError(
                f"`files` are several runs, and {'`file`' if self.file else '`name`'} is of one:"
                " keep one of them"
            )
        response = {"input", "output", "columns", "phase_unit"}
        record = {
            "at_rest",
            "initial",
            "initial_window_s",
            "constants",
            "split_at_gaps",
            "window_s",
            "repeat_of",
        }
        wrong = sorted(self.model_fields_set & (response if self.kind == "record" else record))
        if wrong:
            raise ValueError(f"{wrong[0]!r} has no meaning in an experiment of kind {self.kind!r}")
        if self.at_rest and self.initial is not None:
            raise ValueError("both at_rest and initial fix the initial state")
        if self.kind == "frequency_response" and not (self.input and self.output):
            raise ValueError(
                "a frequency response needs `input` and `output`, the channels it leads from and to"
            )
        return self


@dataclass
class Document:
    """The sound parts of a `dataset.toml`, and its faults. A part that is at fault is None or left
    out.
    """

    header: Header | None = None
    channels: dict[str, ChannelEntry] = field(default_factory=dict)
    experiments: dict[int, ExperimentEntry] = field(default_factory=dict)
    model: ModelEntry | None = None
    controller: ControllerEntry | None = None
    problems: list[DatasetProblem] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    sound: set[str] = field(default_factory=set)  # the sections without a fault
    faulty: dict[tuple[str | int, ...], set[str | int | None]] = field(
        default_factory=dict
    )  # part -> its faulty keys

    @property
    def stated(self) -> ModelEntry:
        """What is stated of the model: an entry that says nothing where there is none."""
        return self.model or ModelEntry()

    @property
    def time(self) -> Column:
        """The column of the times."""
        return self.header.time if self.header is not None else "t"


Entry = TypeVar("Entry", bound=BaseModel)


def read_document(raw: Mapping[str, Any], places: Places) -> Document:
    """Checks every part by itself, so that a fault in one hides none in another."""
    document = Document()
    sections = _sections(raw, places, document)
    head = {key: value for key, value in raw.items() if key not in _SECTIONS}
    allowed = [*Header.model_fields, *_SECTIONS]
    document.header = entry_of(Header, head, (), places, document, "header", allowed)
    for name, value in (sections.get("channels") or {}).items():
        why = _name_fault(name)
        if why is not None:
            message = f"channel {name!r} {why}"
            remedy = "Rename it and state its `column`"
            document.problems.append(places.problem(("channels", name), message, remedy))
            document.sound.discard("channels")
            continue
        entry = entry_of(ChannelEntry, value, ("channels", name), places, document, "channels")
        if entry is not None:
            document.channels[name] = entry
    for index, value in enumerate(sections.get("experiments") or []):
        entry = _experiment(value, ("experiments", index), places, document)
        if entry is not None:
            document.experiments[index] = entry
    model, controller = sections.get("model"), sections.get("controller")
    if model is not None:
        document.model = entry_of(ModelEntry, model, ("model",), places, document, "model")
    if controller is not None:
        document.controller = entry_of(
            ControllerEntry, controller, ("controller",), places, document, "controller"
        )
    return document


#: The sections of a document, and what TOML reads them as.
_SECTIONS = {"channels": dict, "experiments": list, "model": dict, "controller": dict}


def _sections(raw: Mapping[str, Any], places: Places, document: Document) -> dict[str, Any]:
    """The sections that are of the right kind."""
    sections = {}
    for name, kind in _SECTIONS.items():
        value = raw.get(name)
        if name in raw and not isinstance(value, kind):
            what = "a list of tables: [[experiments]]" if kind is list else f"a table: [{name}]"
            message = f"{name!r} is not {what}"
            document.problems.append(places.problem((name,), message, f"Write {what}"))
            continue
        document.sound.add(name)
        sections[name] = value
    return sections


def _name_fault(name: str) -> str | None:
    """Why a channel cannot have this name."""
    if name == "t":
        return "is the name of the time"
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*(\*[A-Za-z0-9_]*)?", name):
        return "is not a name of letters, digits and underscores"
    return None


def _experiment(
    value: Any, key: tuple[str, int], places: Places, document: Document
) -> ExperimentEntry | None:
    """One of `[[experiments]]`; None where what it selects is at fault."""
    if isinstance(value, Mapping) and not {"file", "files"} & set(value):
        remedy = "State 'file', or 'files' with a pattern"
        document.problems.append(places.problem((*key, "file"), "'file' is missing", remedy))
        document.sound.discard("experiments")
    entry = entry_of(ExperimentEntry, value, key, places, document, "experiments")
    if entry is None or not (entry.file or entry.files):
        return None
    if any(_selects(faulty) for faulty in document.faulty.get(key, ())):
        return None
    return entry


def _selects(key: str | int | None) -> bool:
    """Whether a faulty key may have chosen the samples, so that checking all of them would blame
    the wrong ones.
    """
    harmless = {"split", "name", "at_rest", "initial", "initial_window_s", "constants"}
    if not isinstance(key, str):
        return True
    close = get_close_matches(key, list(ExperimentEntry.model_fields), n=1, cutoff=0.5)
    return bool(close) and close[0] not in harmless


def entry_of(
    cls: type[Entry],
    raw: Any,
    key: tuple[str | int, ...],
    places: Places,
    document: Document,
    section: str,
    allowed: list[str] | None = None,
) -> Entry | None:
    """One part, checked; one with a fault is tried again without the faulty keys, so that the rest
    can be checked.
    """
    if not isinstance(raw, Mapping):
        document.sound.discard(section)
        document.problems.append(
            places.problem(key, f"{dotted(key)} is not a table", f"Write it as [{dotted(key)}]")
        )
        return None
    try:
        return cls.model_validate(dict(raw))
    except OverflowError:
        document.sound.discard(section)
        document.problems.append(
            places.problem(key, "a number beyond 1e308", "Write a smaller number")
        )
        return None
    except ValidationError as error:
        document.sound.discard(section)
        found: dict[tuple[str | int, ...], Any] = {}
        for fault in error.errors(include_url=False, include_input=True):
            found.setdefault(real_path(fault["loc"], raw), fault)  # a union reports once a branch
    faulty = document.faulty.setdefault(key, set())
    for where, fault in found.items():
        faulty.add(where[0] if where else None)
        message, remedy = _say(cls, fault, where, allowed)
        document.problems.append(places.problem((*key, *where), message, remedy))
    rest = {k: v for k, v in raw.items() if k not in faulty}
    try:
        return cls.model_validate(rest)
    except (ValidationError, OverflowError):
        return None


def _say(
    cls: type[BaseModel], fault: Any, where: tuple[str | int, ...], allowed: list[str] | None
) -> tuple[str, str]:
    kind, name = fault["type"], where[-1] if where else ""
    owner = (
        PriorEntry if cls is ModelEntry and where[:1] == ("parameters",) and len(where) > 2 else cls
    )
    if kind == "extra_forbidden":
        return (
            f"unknown key {name!r}{nearest(str(name), allowed or list(owner.model_fields))}",
            "Correct or remove it",
        )
    if kind == "missing":
        return f"{name!r} is missing", f"State {name!r}"
    if kind == "literal_error":
        choices = re.findall(r"'([^']*)'", fault["ctx"]["expected"])
        if fault["loc"][-1:] == ("[key]",):
            return f"unknown key {name!r}{nearest(str(name), choices)}", "Correct or remove it"
        return (
            f"{name!r} is {fault['input']!r}{nearest(str(fault['input']), choices)}",
            f"Write one of: {', '.join(choices)}",
        )
    if kind == "value_error":
        text = str(fault["ctx"]["error"])
        return (f"{name!r} {text}" if text.startswith(("is ", "holds ")) else text), "Correct it"
    if kind == "greater_than":
        return f"{name!r} is {fault['input']!r}", "Write a number above 0"
    if kind == "finite_number":
        return f"{name!r} is {fault['input']!r}", "Write a finite number"
    shown = repr(fault["input"])
    if len(shown) >= 60:
        shown = f"{shown[:57]}..."
    return f"{name!r} is {shown}: {fault['msg'].lower()}", "Correct it"
