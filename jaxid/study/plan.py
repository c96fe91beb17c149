"""A study file and the tasks it stands for: the product of datasets, models, effects, fitters and
seeds.

A task is known by the hash of everything its result depends on: the bytes of the dataset, the
settings, the version of jaxid. So a study that is started again goes on where it stopped, and one
that was changed runs only what changed.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from jaxid.base.errors import DatasetError, DatasetProblem, nearest, UsageError
from jaxid.base.wording import one_line
from jaxid.data.model_names import called, parts_of
from jaxid.data.schema import Document, entry_of, Places
from jaxid.data.schema_fields import plain_text
from jaxid.dynamics.catalogue import LOSSES, RESIDUALS


#: Most tasks of a study.
MOST = 1_000_000
#: A study or a dataset.toml above this size is none.
LARGEST_BYTES = 10_000_000
SEEDS = 2**31 - 1


class _StrictTable(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def _distinct(values: list[Any] | None) -> list[Any] | None:
    if values is None:
        return None
    if not values:
        raise ValueError("is an empty list")
    for k, value in enumerate(values):
        if value in values[:k]:
            raise ValueError(f"names {value!r} twice")
    return values


class StudyEntry(_StrictTable):
    """The top-level keys. `store` counts from the folder of the study file, like the datasets."""

    name: str
    store: str
    description: str = ""

    _names = field_validator("name", "store")(plain_text)


class RunsEntry(_StrictTable):
    """`[[runs]]`: the product of its lists."""

    command: Literal["fit", "diagnose"]
    datasets: list[str]
    models: list[str] | None = None
    effects: list[list[str]] | None = None
    without: list[str] = []
    fitters: list[str] | None = None
    residual: str | None = None
    loss: str | None = None
    seeds: int | list[int] = 1
    budget: int | None = Field(default=None, ge=1)
    max_effects: int | None = Field(default=None, ge=1, le=20)
    timeout_s: float | None = Field(default=None, gt=0)

    _lists = field_validator("datasets", "models", "effects", "fitters")(_distinct)

    @field_validator("effects", mode="before")
    @classmethod
    def _sets(cls, value: Any) -> Any:
        """Names alone are no sets of them: all together or each in its turn?"""
        if isinstance(value, list) and value and all(isinstance(name, str) for name in value):
            together, apart = json.dumps([value]), json.dumps([[name] for name in value])
            others = f" adds them together, {apart} each alone" if len(value) > 1 else ""
            raise ValueError(f"is a list of sets: {together}{others}")
        return value

    @field_validator("timeout_s", mode="before")
    @classmethod
    def _number(cls, value: Any) -> Any:
        whole = isinstance(value, int) and not isinstance(value, bool)
        return float(value) if whole and abs(value) < 1e15 else value

    @field_validator("seeds")
    @classmethod
    def _seeds(cls, value: int | list[int]) -> int | list[int]:
        if isinstance(value, list):
            seeds, least = value, 0
            _distinct(value)
        else:
            seeds, least = [value], 1
        for seed in seeds:
            if not least <= seed <= SEEDS:
                raise ValueError(
                    f"is {seed}: a number of seeds is 1 or more, a list holds seeds from 0 to"
                    f" {SEEDS}"
                )
        return value

    @property
    def seed_list(self) -> Sequence[int]:
        return range(self.seeds) if isinstance(self.seeds, int) else self.seeds

    @property
    def count(self) -> int:
        lists = (self.datasets, self.models, self.effects, self.fitters, self.seed_list)
        return math.prod(len(values) for values in lists if values is not None)


@dataclass(frozen=True)
class Task:
    """One fit or diagnosis. `dataset` is a folder, `label` and `system` what dataset and model are
    called in tables.
    """

    command: str
    dataset: str
    dataset_sha256: str
    label: str
    model: str | None
    model_sha256: str | None  # of a robot's file, and of one of a model of the user's own
    system: str
    effects: tuple[str, ...] | None
    without: tuple[str, ...]
    fitter: str | None
    residual: str | None
    loss: str | None
    seed: int
    budget: int | None
    max_effects: int | None
    timeout_s: float | None
    version: str

    @cached_property
    def settings(self) -> dict[str, Any]:
        """Every field by its name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @cached_property
    def group(self) -> str:
        """What tasks share that run in the same compiled programs: everything but the seed."""
        apart = {"seed", "timeout_s", "label", "dataset", "system"}
        if self.model_sha256 is not None:
            apart.add("model")  # a path; the content counts
        counts = {k: v for k, v in self.settings.items() if k not in apart}
        own = parts_of(self.model or "")
        if own is not None and own[1] is not None:  # one of several in a file
            counts["model_class"] = own[1]
        return json.dumps(counts, sort_keys=True)

    @cached_property
    def key(self) -> str:
        return hashlib.sha256(f"{self.group}\n{self.seed}".encode()).hexdigest()[:32]

    @property
    def method(self) -> str:
        """The fitter's name in tables."""
        return self.fitter or ("lm" if self.loss in (None, "sum_of_squares") else "hybrid")


@dataclass(frozen=True)
class PlannedRuns:
    """One `[[runs]]`: its place in the file, what stands there, and the tasks it stands for."""

    index: int
    entry: RunsEntry
    tasks: tuple[Task, ...]


@dataclass(frozen=True)
class Study:
    """A study file that was read: what it is called, where its results go, its tasks by key in
    their order.
    """

    path: Path
    name: str
    description: str
    store: Path
    tasks: dict[str, Task]
    runs: tuple[PlannedRuns, ...]

    @property
    def digest(self) -> str:
        """Changes with any task."""
        return hashlib.sha256("\n".join(self.tasks).encode()).hexdigest()


class StudyError(UsageError):
    """A study that was refused; `problems` holds every fault found, `str()` lists them all."""

    def __init__(self, problems: Sequence[DatasetProblem]):
        self.problems = list(problems)
        lines = list(map(str, self.problems))
        if len(lines) > 1:
            lines = [f"{len(lines)} problems in the study:", *(f"- {line}" for line in lines)]
        super().__init__("\n".join(lines))


def jaxid_version() -> str:
    try:
        return version("jaxid")
    except PackageNotFoundError:
        return "not installed"


def read_study(path: str | Path) -> Study:
    """Reads a study file and the fingerprints of its data; no JAX is loaded.

    Raises `StudyError` with every mistake at once, each with its place and what to do. Whether
    models, effects and fitters exist and fit the data is asked by `jaxid.study.check.check_study`.
    """
    study, problems = parse_study(path)
    if problems:
        raise StudyError(problems)
    return study


def parse_study(path: str | Path) -> tuple[Study, list[DatasetProblem]]:
    """The study as far as it could be read, so that all it names can be looked at, and its
    faults.
    """
    path = Path(path)
    text, raw = _toml(path)
    places = Places(path.name, text)
    document = Document()
    rest = {k: v for k, v in raw.items() if k != "runs"}
    head = entry_of(
        StudyEntry, rest, (), places, document, "header", [*StudyEntry.model_fields, "runs"]
    )
    entries = _run_entries(raw.get("runs"), places, document)
    total = sum(entry.count for entry in entries.values())
    if total > MOST:
        message = f"{total} tasks are more than a study can hold ({MOST})"
        remedy = "Divide it into several studies"
        document.problems.append(places.problem(("runs",), message, remedy))
    folders = _Folders(path.parent, places, document)
    parts: list[PlannedRuns] = []
    tasks: dict[str, Task] = {}
    for index, entry in entries.items():
        own = tuple(_tasks(entry, ("runs", index), folders)) if total <= MOST else ()
        parts.append(PlannedRuns(index, entry, own))
        for task in own:
            tasks.setdefault(task.key, task)
    if head is None:
        return Study(path, "", "", path.parent, tasks, tuple(parts)), document.problems
    store = path.parent / head.store
    document.problems += _store_problems(store, head.store, places)
    study = Study(path, head.name, head.description, store, tasks, tuple(parts))
    return study, document.problems


def _store_problems(store: Path, name: str, places: Places) -> Iterator[DatasetProblem]:
    try:
        if store.is_file():
            yield places.problem(("store",), f"{name!r} is a file", "Name a folder")
    except (OSError, ValueError) as error:  # a name that is too long
        message = f"{name!r} cannot be a folder ({_why(error)})"
        yield places.problem(("store",), message, "Name another")


def _run_entries(runs: Any, places: Places, document: Document) -> dict[int, RunsEntry]:
    """The `[[runs]]` by their places; of one with faults what is sound."""
    if not isinstance(runs, list) or not runs:
        remedy = "Add one with `command` and `datasets`"
        document.problems.append(places.problem(("runs",), "there is no [[runs]]", remedy))
        return {}
    entries = {}
    for index, value in enumerate(runs):
        key = ("runs", index)
        entry = entry_of(RunsEntry, value, key, places, document, "runs")
        if entry is not None:
            entries[index] = entry
            document.problems += _meaningless(entry, key, places)
        elif isinstance(value, dict):
            faulty = document.faulty.get(key, ())
            sound = {k: v for k, v in value.items() if k not in faulty}
            entries[index] = RunsEntry.model_construct(**{"command": "fit", "datasets": []} | sound)
    return entries


def _toml(path: Path) -> tuple[str, dict[str, Any]]:
    def refuse(message: str, remedy: str, row: int | None = None) -> StudyError:
        return StudyError([DatasetProblem(path.name or str(path), row, None, message, remedy)])

    named = "Name a study, a TOML file with `name`, `store` and [[runs]]"
    try:
        if not path.is_file():
            raise refuse("there is no such file", named)
        if path.stat().st_size > LARGEST_BYTES:
            raise refuse("is too large for a study", named)
        content = path.read_bytes()
    except StudyError:
        raise
    except (OSError, ValueError) as error:
        message = f"not readable ({_why(error)})"
        raise refuse(message, "Check the path and its permissions") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content.count(b"\n", 0, error.start) + 1
        raise refuse("a character that is not UTF-8", "Save the file as UTF-8", row) from None
    try:
        return text, tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        line = re.search(r"at line (\d+)", str(error))
        said = str(error).split(" (at ")[0].strip().rstrip(".") or type(error).__name__
        message = f"not readable as TOML: {said[:1].lower()}{said[1:]}"
        raise refuse(message, "Correct the line", int(line[1]) if line else None) from None


def _why(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def _meaningless(
    entry: RunsEntry, key: tuple[str | int, ...], places: Places
) -> Iterator[DatasetProblem]:
    """Settings that the command does not know."""
    given = entry.model_fields_set
    wrong = {"fit": {"max_effects"}, "diagnose": {"fitters", "loss", "budget"}}[entry.command]
    for name in sorted(given & wrong):
        yield places.problem(
            (*key, name), f"{name!r} has no meaning for the command {entry.command!r}", "Remove it"
        )
    for name, choices in (("residual", RESIDUALS), ("loss", LOSSES)):
        value = getattr(entry, name)
        if value is not None and value not in choices:
            yield places.problem(
                (*key, name),
                f"{name!r} is {value!r}{nearest(value, choices)}",
                f"Write one of: {', '.join(choices)}",
            )


def _tasks(entry: RunsEntry, key: tuple[str | int, ...], folders: _Folders) -> Iterator[Task]:
    found = [folders.dataset(name, (*key, "datasets")) for name in entry.datasets]
    models = [folders.model(name, (*key, "models")) for name in entry.models or [None]]
    now = jaxid_version()
    for data, model, effects, fitter in itertools.product(
        found, models, entry.effects or [None], entry.fitters or [None]
    ):
        if data is None or model is None:
            continue
        system = called(model[0]) if model[1] else model[0] or data[3]
        for seed in entry.seed_list:
            yield Task(
                command=entry.command,
                dataset=data[0],
                dataset_sha256=data[1],
                label=data[2],
                model=model[0],
                model_sha256=model[1],
                system=system,
                effects=None if effects is None else tuple(effects),
                without=tuple(entry.without),
                fitter=fitter,
                residual=entry.residual,
                loss=entry.loss,
                seed=int(seed),
                budget=entry.budget,
                max_effects=entry.max_effects,
                timeout_s=entry.timeout_s,
                version=now,
            )


class _Folders:
    """Datasets and files of models of a study, each read once: (folder, sha256, label, its model),
    (path or id, sha256).
    """

    def __init__(self, folder: Path, places: Places, document: Document):
        self.folder, self.places, self.document = folder, places, document
        self.found: dict[str, tuple[str, str, str, str] | None] = {}
        self.labels: dict[str, str] = {}

    def problem(self, key: tuple[str | int, ...], message: str, remedy: str) -> None:
        self.document.problems.append(self.places.problem(key, message, remedy))

    def dataset(self, name: str, key: tuple[str | int, ...]) -> tuple[str, str, str, str] | None:
        if name not in self.found:
            self.found[name] = self._looked_up(name, key)
        return self.found[name]

    def _looked_up(self, name: str, key: tuple[str | int, ...]) -> tuple[str, str, str, str] | None:
        try:
            folder = (self.folder / name).resolve()
            if folder.name == "dataset.toml":
                folder = folder.parent
            if not (folder / "dataset.toml").is_file():
                what = f"is not a folder; paths count from {self.folder.resolve()}"
                if folder.is_dir():
                    what = "holds no dataset.toml"
                self.problem(key, f"dataset {name!r} {what}", "Name a folder with a dataset.toml")
                return None
            digest, label, model = fingerprint(folder)
        except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: a circle of links
            message = f"dataset {name!r} cannot be read ({_why(error)})"
            self.problem(key, message, "Correct the path")
            return None
        label = label or name
        if self.labels.setdefault(label, digest) != digest:
            label = name  # another recording has this name
        return str(folder), digest, label, model

    def model(self, name: str | None, key: tuple[str | int, ...]) -> tuple[Any, str | None] | None:
        if name is None:
            return None, None
        file, suffix, what = name, "", "a robot"
        own = parts_of(name)
        if own is not None:
            file, what = own[0], "a model"
            suffix = f":{own[1]}" if own[1] else ""
        elif not name.lower().endswith((".urdf", ".xml", ".mjcf")):
            return name, None
        try:
            path = (self.folder / file).resolve()
            if path.is_file() and path.stat().st_size <= LARGEST_BYTES:
                return str(path) + suffix, hashlib.sha256(path.read_bytes()).hexdigest()
            message = f"model {name!r} is not a file of {what} here"
            self.problem(key, message, f"Paths count from {self.folder.resolve()}")
        except (OSError, ValueError, RuntimeError) as error:
            self.problem(key, f"model {name!r} cannot be read ({_why(error)})", "Correct the path")
        return None


def fingerprint(folder: Path) -> tuple[str, str, str]:
    """(`dataset_sha256` as a loaded dataset has it, its name, its model) without reading any
    sample.

    Files outside the folder and what is no plain file are left out; loading refuses them.
    """
    description = folder / "dataset.toml"
    if description.stat().st_size > LARGEST_BYTES:
        raise ValueError("its dataset.toml is too large")
    content = description.read_bytes()
    digest, raw = hashlib.sha256(content), {}
    # Where a part is of the wrong kind, loading says so.
    with suppress(ValueError, RecursionError):
        raw = tomllib.loads(content.decode("utf-8-sig"))
    model = _of_kind(raw.get("model"), dict)
    listed = [model.get(key) for key in ("file", "urdf", "robot")]
    listed += [_of_kind(e, dict).get("file") for e in _of_kind(raw.get("experiments"), list)]
    for file in sorted({_of_kind(f, str) for f in listed} - {""}):
        path = folder / file
        with suppress(OSError, ValueError, RuntimeError):
            if path.is_file() and path.resolve().is_relative_to(folder.resolve()):
                with open(path, "rb") as stream:
                    own = hashlib.file_digest(stream, "sha256").digest()
                digest.update(file.encode() + b"\0" + own)
    return digest.hexdigest(), _of_kind(raw.get("name"), str), _of_kind(model.get("name"), str)


def _of_kind(value: Any, kind: type) -> Any:
    """The value, or an empty one of this kind where it is of another."""
    return value if isinstance(value, kind) else kind()


def dataset_problems(error: DatasetError, name: str) -> Iterator[DatasetProblem]:
    """A dataset's faults as faults of the study, with the dataset's name before the file's."""
    for p in error.problems:
        yield DatasetProblem(f"{one_line(name)}: {p.file}", p.row, p.column, p.message, p.remedy)
