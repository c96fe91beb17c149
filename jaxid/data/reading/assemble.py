"""From a checked `dataset.toml` and its tables to a `Dataset`: units, roles, the fit to the model,
then the samples.
"""

from __future__ import annotations

import datetime
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

from jaxid.base.errors import DatasetError, DatasetProblem, DatasetWarning, nearest, UsageError
from jaxid.base.wording import as_unit
from jaxid.data.dataset import Controller, Dataset, Geometry
from jaxid.data.experiment import Experiment, FrequencyResponse
from jaxid.data.harvest import Harvest
from jaxid.data.joint_names import in_chain_order, number_of, renamed, renumbered
from jaxid.data.patterns import expanded_channels
from jaxid.data.reading.own_model import file_of, info_of_file, runs_as_code, stated
from jaxid.data.reading.stated_model import as_robot, as_robot_entry, geometry_of, joints_of
from jaxid.data.records import ChannelReading, read_record
from jaxid.data.responses import read_response
from jaxid.data.schema import Document, ExperimentEntry, Header, Places
from jaxid.data.table import Table
from jaxid.data.units import Conversion, conversion, si_unit, UnitError


OpenTable = Callable[[int, ExperimentEntry], Table | DatasetProblem]


def assemble(
    document: Document,
    places: Places,
    open_table: OpenTable,
    *,
    check_model: bool,
    sha256: Callable[[], str],
    open_text: Callable[[str, tuple[str | int, ...]], str | DatasetProblem] | None = None,
):
    """The dataset, or `DatasetError` with every fault of the description, the model and the
    samples.
    """
    problems = list(document.problems)
    document.model = as_robot_entry(document, open_text)
    problems += expanded_channels(document, places, open_table)
    geometry = geometry_of(document, places, open_text, problems)
    file = file_of(document, places, open_text, problems)
    info = _model_info(document, places, problems, geometry, file) if check_model else None
    readings = _readings(document, places, problems, info)
    problems += _roles(document, places, known_model=info is not None)
    problems += _splits(document, places)
    problems += _references(document, places)
    chain = joints_of(geometry) if check_model else ()
    if info is not None:
        problems += _fits_model(document, _of_chain(document, readings, chain), places, info)
    harvests = _samples(document, readings, open_table, problems)
    problems += _still_outputs(harvests)
    if problems:
        raise DatasetError(_each_once(problems))
    experiments: list[Experiment] = []
    responses: list[FrequencyResponse] = []
    notes = [*document.notes, *runs_as_code(file, info)]
    alerts: list[str] = []
    for harvest in harvests:
        experiments += harvest.experiments
        responses += harvest.responses
        notes += harvest.notes
        alerts += harvest.warnings
    alerts += _still_inputs(harvests) + _held_outputs(harvests)
    for text in alerts:
        warnings.warn(text, DatasetWarning, stacklevel=3)
    header = document.header
    assert header is not None
    model = None
    if document.model is not None:
        model = stated(document.model, geometry, file, info)
    controller = None
    if document.controller is not None:
        controller = Controller(document.controller.kind, document.controller.settings)
    dataset = Dataset(
        name=header.name,
        description=header.description,
        source=_origin(header),
        channels=tuple(r.channel for r in readings),
        experiments=tuple(experiments),
        responses=tuple(responses),
        model=model,
        controller=controller,
        notes=(*notes, *alerts),
        sha256=sha256(),
    )
    if check_model and geometry is not None and geometry.robot:
        return as_robot(dataset, places)
    try:
        return in_chain_order(dataset, chain)
    except UsageError as error:
        raise DatasetError(
            [places.problem(("model", "joints"), str(error), "Correct [model.joints]")]
        ) from None


def _of_chain(
    document: Document, readings: list[ChannelReading], chain: tuple[str, ...]
) -> list[ChannelReading]:
    """The channels as the model will have them: without joints that the recording names and the
    chain lacks.
    """
    joints = document.stated.joints
    if not (chain and joints):
        return readings
    try:
        numbers = renumbered(joints, chain)
    except UsageError:
        return readings  # said later, by name
    named = [replace(r, name=renamed(r.name, numbers)) for r in readings]
    return [r for r in named if number_of(r.name) <= len(chain)]


def _each_once(problems: list[DatasetProblem]) -> list[DatasetProblem]:
    """Without doubles (runs may share a file); a column that several files lack is one fault."""
    kept: dict[Any, DatasetProblem] = {}
    more: dict[Any, list[str]] = {}
    for problem in problems:
        lacking = problem.message.startswith("there is no column")
        key = (problem.column, problem.message.split(" (")[0]) if lacking else problem
        if key not in kept:
            kept[key] = problem
        elif problem.file != kept[key].file and problem.file not in more.setdefault(key, []):
            more[key].append(problem.file)
    for key, files in more.items():
        if files:
            message = f"{kept[key].message}, nor in {', '.join(files)}"
            kept[key] = replace(kept[key], message=message)
    return list(kept.values())


def _origin(header: Header) -> dict[str, Any] | str | None:
    more = {"licence": header.licence, "recorded": header.recorded, "hardware": header.hardware}
    more = {key: value for key, value in more.items() if value is not None}
    if isinstance(header.source, str) and not more:
        return header.source
    source = header.source or {}
    if isinstance(source, str):
        source = {"source": source}
    merged: dict[str, Any] = source | more
    for key, value in merged.items():
        if isinstance(value, datetime.date):
            merged[key] = value.isoformat()
    return merged or None


def _readings(
    document: Document, places: Places, problems: list[DatasetProblem], info: Any
) -> list[ChannelReading]:
    wanted = {}
    for signature in [] if info is None else info.signatures:
        for name, unit in (*signature.inputs, *signature.outputs):
            wanted[name] = si_unit(unit)
    readings = []
    for name, entry in document.channels.items():
        try:
            found = conversion(entry.unit, wanted.get(name))
        except UnitError as error:
            remedy = "Write a unit of the table (`jaxid.data.units`), or use `scale` and an SI unit"
            problems.append(places.problem(("channels", name, "unit"), str(error), remedy))
            document.sound.discard("channels")
            found = Conversion(1.0, entry.unit)
        readings.append(ChannelReading(name, entry, found))
    return readings


def _roles(document: Document, places: Places, *, known_model: bool) -> list[DatasetProblem]:
    """What any dataset needs; where the model is known, it says itself which channels are
    lacking.
    """
    if "channels" not in document.sound:
        return []
    roles = [c.role for c in document.channels.values()]
    model = document.stated
    measured = "Add what was measured as [channels.NAME]"
    if not roles:
        return [places.problem(("channels",), "there are no channels", measured)]
    if "output" not in roles and not known_model:
        message = 'there is no channel with role = "output"'
        return [places.problem(("channels",), message, measured)]
    if "input" in roles:
        if not model.free:
            return []
        message = "free motion has no input, but there is an input channel"
        remedy = 'Give the input channels role = "auxiliary", or remove free = true'
        return [places.problem(("model", "free"), message, remedy)]
    if model.free or model.robot is not None or known_model or "model" not in document.sound:
        return []
    message = 'there is no channel with role = "input"'
    remedy = "Add the channel that drives the motion, or say free = true under [model]"
    return [places.problem(("channels",), message, remedy)]


def _splits(document: Document, places: Places) -> list[DatasetProblem]:
    if "experiments" not in document.sound:
        return []
    if not document.experiments:
        message = "there are no experiments"
        remedy = "Add [[experiments]] with a `file` and a `split`"
        return [places.problem(("experiments",), message, remedy)]
    if any(e.split == "fit" for e in document.experiments.values()):
        return []
    message = 'no experiment has split = "fit"'
    remedy = 'Give at least one run to the fit: split = "fit"'
    return [places.problem(("experiments",), message, remedy)]


def _references(document: Document, places: Places) -> list[DatasetProblem]:
    """Names that one part of the file says of another: channels of a frequency response, names of
    experiments.
    """
    problems = []
    names: dict[str, int] = {}
    runs = _names(document.experiments).values()

    def complain(index: int, key: str, message: str, remedy: str) -> None:
        problems.append(places.problem(("experiments", index, key), message, remedy))

    for index, entry in document.experiments.items():
        if entry.name is not None and names.setdefault(entry.name, index) != index:
            message = f"experiment {names[entry.name] + 1} has the name {entry.name!r} already"
            complain(index, "name", message, "Choose another name")
        other = entry.repeat_of
        if other is not None and other not in runs:
            message = f"there is no run {other!r} to repeat{nearest(other, runs)}"
            complain(index, "repeat_of", message, "Name another run")
        if entry.kind != "frequency_response" or "channels" not in document.sound:
            continue
        for role in ("input", "output"):
            channel = getattr(entry, role)
            known = [k for k, c in document.channels.items() if c.role == role]
            if channel not in known:
                message = f"{channel!r} is not an {role} channel{nearest(channel, known)}"
                complain(index, role, message, f'Name a channel with role = "{role}"')
    return problems


def _model_info(
    document: Document,
    places: Places,
    problems: list[DatasetProblem],
    geometry: Geometry | None,
    file: str | None,
) -> Any:
    """What the catalogue knows of the model, with the names of the file checked against it."""
    entry = document.model
    if entry is None or entry.robot is not None:
        return None
    if entry.file is not None:
        info = info_of_file(file, places, problems)
        return None if info is None else _known_names(document, places, problems, info)
    if entry.name is None:
        return None
    from jaxid.dynamics import catalogue
    from jaxid.robots.arm_table import arm_table

    names = catalogue.model_names()
    if entry.name not in names:
        message = f"there is no model {entry.name!r}{nearest(entry.name, names)}"
        problems.append(
            places.problem(
                ("model", "name"),
                message,
                "Name one that `jaxid models` lists, or one of your own by its file: file ="
                ' "mymodel.py"',
            )
        )
        return None
    if geometry is None and (entry.urdf or entry.dh):
        return None  # its fault is reported
    own = () if geometry is None else (catalogue.model_class(entry.name)(arm_table(geometry)),)
    return _known_names(document, places, problems, catalogue.describe(entry.name, *own))


def _known_names(
    document: Document, places: Places, problems: list[DatasetProblem], info: Any
) -> Any:
    """The description of the model, after the names that the file states were looked for in it."""
    from jaxid.dynamics import catalogue

    entry = document.model
    assert entry is not None
    effects = catalogue.effect_names()
    known = (*info.constants, *info.parameters, "smoothing_velocity")

    def unknown(key: tuple[str | int, ...], name: str, what: str, choices: Iterable[str]) -> None:
        if name not in choices:
            message = f"model {info.name!r} has no {what} {name!r}{nearest(name, choices)}"
            problems.append(places.problem(key, message, "Correct or remove it"))

    for name in entry.without:
        unknown(("model", "without"), name, "built-in effect", info.builtin_effects)
    for name in entry.constants:
        unknown(("model", "constants", name), name, "constant or parameter", known)
    for name in entry.parameters:
        unknown(("model", "parameters", name), name, "parameter", info.parameters)
    for index, run in document.experiments.items():
        for name in run.constants:
            unknown(("experiments", index, "constants", name), name, "constant", (*known, *effects))
        for name in run.initial or {}:
            unknown(("experiments", index, "initial", name), name, "state", info.states)
    return info


def _fits_model(
    document: Document, readings: list[ChannelReading], places: Places, info: Any
) -> list[DatasetProblem]:
    """Whether the channels contain one signature of the model; the closest signature is the one to
    speak of.
    """
    if "channels" not in document.sound or not readings:
        return []
    from jaxid.dynamics.joint_readings import with_speeds

    free = document.stated.free
    have = {r.name: r for r in readings}
    speeds = {r.name: r.conversion.si for r in readings if r.entry.role == "output"}
    each = []
    for signature in info.signatures:
        signature = with_speeds(signature, speeds)
        each.append(_signature_faults(have, signature, free, places, info.name))
    return min(each, key=len, default=[])


def _signature_faults(
    have: dict[str, ChannelReading], signature: Any, free: bool, places: Places, model: str
) -> list[DatasetProblem]:
    """What the channels lack of a model's inputs and outputs, or have beside them."""
    needed = {name: (unit, "output") for name, unit in signature.outputs}
    if not free:
        needed |= {name: (unit, "input") for name, unit in signature.inputs}
    spare = [r for r in have.values() if r.name not in needed]
    problems = []
    for name, (unit, role) in needed.items():
        problem = _channel_fault(name, unit, role, have.get(name), spare, places, model)
        if problem is not None:
            problems.append(problem)
    if problems:
        return problems
    outputs = signature.output_names
    for reading in have.values():
        if reading.entry.role == "output" and reading.name not in outputs:
            message = (
                f"model {model!r} has no output {reading.name!r} (it has: {', '.join(outputs)})"
            )
            remedy = 'Give the channel role = "auxiliary", or name another model'
            problems.append(places.problem(("channels", reading.name, "role"), message, remedy))
    return problems


def _channel_fault(
    name: str,
    unit: str,
    role: str,
    reading: ChannelReading | None,
    spare: Sequence[ChannelReading],
    places: Places,
    model: str,
) -> DatasetProblem | None:
    """What is wrong with a channel that a model needs; `spare`: those that it does not need."""
    if reading is None:
        message = (
            f"model {model!r} needs the {role} channel {name!r} in {unit}, and the data lack it"
        )
        remedy = f'Add [channels.{name}] with role = "{role}"'
        others = [r for r in spare if r.entry.role == role]
        if others:
            message += f" ({role} channel here: {', '.join(r.name for r in others)})"
            form = as_unit(others[0].conversion.si, si_unit(unit))
            remedy += f" and the `column` to read, {form}"
        return places.problem(("channels", name), message, remedy)
    if reading.entry.role != role:
        message = f"model {model!r} needs {name!r} as {role}, but it is {reading.entry.role}"
        return places.problem(("channels", name, "role"), message, f'Write role = "{role}"')
    if reading.conversion.si != si_unit(unit):
        message = (
            f"{name!r} is in {reading.entry.unit!r}, but model {model!r} needs a unit like {unit!r}"
        )
        remedy = f"Correct the unit, or convert it: {as_unit(reading.conversion.si, unit)}"
        return places.problem(("channels", name, "unit"), message, remedy)
    return None


def _samples(
    document: Document,
    readings: list[ChannelReading],
    open_table: OpenTable,
    problems: list[DatasetProblem],
) -> list[Harvest]:
    names = _names(document.experiments)
    unit = document.header.time_unit if document.header is not None else None
    units = {r.name: r.conversion for r in readings}
    harvests = []
    last = {entry.file: index for index, entry in document.experiments.items()}
    for index, entry in document.experiments.items():
        table = open_table(index, entry)
        if isinstance(table, DatasetProblem):
            problems.append(table)
            continue
        problems += table.problems
        if not table.columns:
            continue
        if entry.kind == "record":
            harvest = read_record(table, entry, names[index], readings, document.time, unit)
        elif entry.input in units and entry.output in units:
            harvest = read_response(table, entry, names[index], units)
        else:
            continue
        problems += harvest.problems
        harvests.append(harvest)
        if last[entry.file] == index:
            table.release()  # before the next file comes into memory
    return harvests


def _names(entries: dict[int, ExperimentEntry]) -> dict[int, str]:
    """An experiment's name: as stated, or its file's stem with what `where` chose, made unique by a
    number.
    """
    taken = {e.name for e in entries.values() if e.name is not None}
    names = {}
    for index, entry in entries.items():
        name = entry.name
        if name is None:
            stem = entry.file.rsplit("/", 1)[-1]
            if stem.endswith((".csv", ".parquet", ".pq")):
                stem = stem.rsplit(".", 1)[0]
            base = name = ":".join([stem, *map(str, entry.where.values())])
            number = 2
            while name in taken:
                name, number = f"{base}_{number}", number + 1
            taken.add(name)
        names[index] = name
    return names


def _still_outputs(harvests: list[Harvest]) -> list[DatasetProblem]:
    """A run is refused where none of its outputs moves. A joint that is held while others move is
    sound.
    """
    problems: list[DatasetProblem] = []
    for harvest in harvests:
        if not harvest.moving:
            problems += harvest.still.values()
    return problems


def _held_outputs(harvests: list[Harvest]) -> list[str]:
    """Words about outputs that move in no run though others do: a joint that its brake holds, or a
    sensor that is stuck.
    """
    moving: set[str] = set()
    still: dict[str, DatasetProblem] = {}
    for harvest in harvests:
        moving |= harvest.moving
        still |= harvest.still
    if not moving:
        return []
    held = [name for name in still if name not in moving]
    return [
        f"output {name!r} never moves: what it alone would show is not determined" for name in held
    ]


def _still_inputs(harvests: list[Harvest]) -> list[str]:
    runs: dict[str, list[str]] = {}
    for harvest in harvests:
        for name in sorted(harvest.still_inputs):
            runs.setdefault(name, []).append(harvest.experiments[0].name)
    return [
        f"input {name!r} is constant in {', '.join(where)}: it excites nothing"
        for name, where in runs.items()
    ]
