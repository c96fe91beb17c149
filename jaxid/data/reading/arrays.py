"""Datasets from arrays and data frames, through the same checks as a folder."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from jaxid.base.errors import DatasetError, DatasetProblem, nearest
from jaxid.data.dataset import Controller, Dataset, ModelSpec
from jaxid.data.reading.assemble import assemble
from jaxid.data.schema import ExperimentEntry, Places, read_document
from jaxid.data.table import Table, table_of_arrays


RUN_SETTINGS = (
    "split",
    "at_rest",
    "initial",
    "constants",
    "initial_window_s",
    "split_at_gaps",
    "repeat_of",
)
FORMS = (
    "sign_bit",
    "signed_bits",
    "scale",
    "offset",
    "unwrap",
    "drop_glitches",
    "sampled_every",
    "shift",
    "delay_s",
    "clock_ppm",
)
CHANNEL_SETTINGS = ("noise_std", "resolution", "hold", *FORMS)
VALID = (  # behind a channel's name: the column that says where it was read; no channel can have such a name
    ".valid"
)
DATASET_SETTINGS = (
    "name",
    "time_unit",
    "names",
    "description",
    "source",
    "model",
    "controller",
    "check_model",
)

# The conventions of names; a number behind a name is a joint.
_NAMED_UNITS = {
    "q": "rad",
    "q_cmd": "rad",
    "qd": "rad/s",
    "qd_cmd": "rad/s",
    "qdd": "rad/s^2",
    "tau": "N m",
    "tau_cmd": "N m",
    "theta": "rad",
    "alpha": "rad",
    "phi": "rad",
    "tau_theta": "N m",
    "tau_alpha": "N m",
    "u_theta": "V",
    "u_alpha": "V",
    "force": "N",
    "position": "m",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "tip_acceleration": "m/s^2",
    "current": "A",
    "current_cmd": "A",
    "voltage": "V",
    "temperature": "degC",
}


def from_arrays(
    t: Any,
    inputs: Mapping[str, Any],
    outputs: Mapping[str, Any],
    auxiliary: Mapping[str, Any],
    units: Mapping[str, str],
    **settings: Any,
) -> Dataset:
    """See `Dataset.from_arrays`."""
    _check_arguments(settings)
    name = str(settings.get("name", "data"))
    signals: dict[str, Any] = {}
    channels: dict[str, dict[str, Any]] = {}
    groups = {"input": inputs, "output": outputs, "auxiliary": auxiliary}
    for role, group in groups.items():
        for channel, values in group.items():
            if channel in signals:
                message = "the channel has two roles"
                raise DatasetError(
                    [DatasetProblem(name, None, channel, message, "Give it one role")]
                )
            signals[channel] = values
            channels[channel] = _channel(channel, role, units, settings)
    valid = settings.get("valid") or {}
    signals |= {f"{channel}{VALID}": read for channel, read in valid.items()}
    for channel in valid.keys() & channels.keys():
        channels[channel]["valid"] = f"{channel}{VALID}"
    count = _runs(t)
    runs = [(t, signals)] if count is None else _each_run(name, t, signals, count)
    entries = _run_entries(name, count, settings)
    by_channel = {"units": units} | {
        key: settings.get(key) or {} for key in ("valid", *CHANNEL_SETTINGS)
    }
    problems = _unnamed(name, by_channel, signals) + _without_unit(name, channels)
    if problems:
        raise DatasetError(problems)
    controller = settings.get("controller")
    if isinstance(controller, Controller):
        controller = {"kind": controller.kind, **controller.settings}
    entire = {
        "name": name,
        "description": str(settings.get("description", "")),
        "time_unit": settings.get("time_unit"),
        "source": settings.get("source"),
        "channels": channels,
        "experiments": entries,
        "model": _model(settings.get("model"), free=not inputs) or None,
        "controller": controller,
    }
    raw = {key: value for key, value in entire.items() if value is not None}
    tables = [
        table_of_arrays(entry["file"], {"t": time, **values})
        for entry, (time, values) in zip(entries, runs, strict=True)
    ]

    def open_table(index: int, entry: ExperimentEntry) -> Table:
        return tables[index]

    places = Places(name)
    return assemble(
        read_document(raw, places),
        places,
        open_table,
        check_model=bool(settings.get("check_model", True)),
        sha256=lambda: _digest(raw, tables),
    )


def _check_arguments(settings: Mapping[str, Any]) -> None:
    allowed = (*RUN_SETTINGS, *CHANNEL_SETTINGS, "valid", *DATASET_SETTINGS)
    for key in settings:
        if key not in allowed:
            raise TypeError(f"from_arrays has no argument {key!r}{nearest(key, allowed)}")


def _unnamed(
    name: str, by_channel: Mapping[str, Mapping[str, Any]], signals: Mapping[str, Any]
) -> list[DatasetProblem]:
    """Settings of channels that are not there."""
    problems = []
    for what, given in by_channel.items():
        for key in given:
            if key in signals:
                continue
            message = f"{what} names a channel that is not there{nearest(key, signals)}"
            problems.append(DatasetProblem(name, None, key, message, "Correct the name"))
    return problems


def _without_unit(name: str, channels: Mapping[str, Mapping[str, Any]]) -> list[DatasetProblem]:
    problems = []
    for channel, entry in channels.items():
        if "unit" not in entry:
            remedy = f"Say units={{{channel!r}: ...}}"
            problems.append(DatasetProblem(name, None, channel, "the unit is not stated", remedy))
    return problems


def _runs(t: Any) -> int | None:
    """How many runs `t` holds, or None for one run given plainly."""
    if isinstance(t, list | tuple) and t and np.ndim(t[0]) > 0:
        return len(t)
    return None


def _each_run(
    name: str, t: Sequence[Any], signals: Mapping[str, Any], count: int
) -> list[tuple[Any, dict[str, Any]]]:
    for channel, values in signals.items():
        if not isinstance(values, list | tuple) or len(values) != count:
            message = f"t holds {count} runs, but {channel!r} is not a list of {count} arrays"
            remedy = "Give one array a run, in the same order"
            raise DatasetError([DatasetProblem(name, None, channel, message, remedy)])
    runs = []
    for i in range(count):
        runs.append((t[i], {channel: values[i] for channel, values in signals.items()}))
    return runs


def _run_entries(name: str, count: int | None, settings: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One entry a run; a setting given as a list has one value a run."""
    total = 1 if count is None else count

    def refuse(message: str, remedy: str) -> DatasetError:
        return DatasetError([DatasetProblem(name, None, None, message, remedy)])

    entries: list[dict[str, Any]] = [{} for _ in range(total)]
    for key in RUN_SETTINGS:
        given = settings.get(key)
        values = list(given) if isinstance(given, list | tuple) else [given] * total
        if len(values) != total:
            message = f"{key} has {len(values)} values for {total} run{'s' * (total > 1)}"
            raise refuse(message, "Give one value, or one a run")
        for entry, value in zip(entries, values, strict=True):
            if value is not None:
                entry[key] = _builtin(value)
    names = settings.get("names")
    if isinstance(names, str):
        names = [names]
    elif names is None:
        names = [name] if count is None else [f"run_{i + 1}" for i in range(total)]
    if len(names) != total:
        raise refuse(f"{len(names)} names for {total} runs", "Give one name a run")
    return [
        {"file": str(n), "name": str(n), **entry} for n, entry in zip(names, entries, strict=True)
    ]


def _channel(
    channel: str, role: str, units: Mapping[str, str], settings: Mapping[str, Any]
) -> dict[str, Any]:
    entry = {"role": role}
    unit = (
        units.get(channel)
        or _NAMED_UNITS.get(channel)
        or _NAMED_UNITS.get(re.sub(r"\d+(?=_cmd$|$)", "", channel))
    )
    entry |= {"unit": unit} if unit is not None else {}
    for key in CHANNEL_SETTINGS:
        value = (settings.get(key) or {}).get(channel)
        entry |= {key: _builtin(value)} if value is not None else {}
    return entry


def _model(model: str | ModelSpec | None, free: bool) -> dict[str, Any]:
    spec = model if isinstance(model, ModelSpec) else ModelSpec(name=model)
    entry = {k: v for k, v in asdict(spec).items() if v}
    entry |= {"without": list(spec.without)} if spec.without else {}
    return entry | ({"free": True} if free else {})


def _builtin(value: Any) -> Any:
    """NumPy scalars as Python numbers."""
    if isinstance(value, Mapping):
        return {str(k): _builtin(v) for k, v in value.items()}
    return value.item() if isinstance(value, np.generic) else value


def _digest(raw: Mapping[str, Any], tables: Sequence[Table]) -> str:
    digest = hashlib.sha256(repr(raw).encode())
    for table in tables:
        for column, values in table.columns.items():
            digest.update(column.encode() + b"\0" + np.asarray(values).tobytes())
    return digest.hexdigest()


_TIME_INDEX = ("DatetimeIndex", "TimedeltaIndex")


def from_frame(
    frame: Any,
    inputs: Sequence[str] | Mapping[str, str],
    outputs: Sequence[str] | Mapping[str, str],
    auxiliary: Sequence[str] | Mapping[str, str],
    time: str,
    **settings: Any,
) -> Dataset:
    """See `Dataset.from_frame`."""
    single = not isinstance(frame, list | tuple)
    frames = [frame] if single else list(frame)
    groups = [_mapping(g) for g in (inputs, outputs, auxiliary)]
    columns = [time]
    for group in groups:
        columns += group.values()
    name = str(settings.get("name", "data"))
    problems = []
    for one in frames:
        problems += _absent_columns(name, one, columns, time)
    if problems:
        raise DatasetError(list(dict.fromkeys(problems)))

    def arrays_of(column: str) -> Any:
        arrays = [np.asarray(one[column]) for one in frames]
        return arrays[0] if single else arrays

    def signals_of(group: Mapping[str, str]) -> dict[str, Any]:
        return {channel: arrays_of(column) for channel, column in group.items()}

    units = settings.pop("units", None) or {}
    signals = [signals_of(group) for group in groups]
    return from_arrays(arrays_of(time), signals[0], signals[1], signals[2], units, **settings)


def _absent_columns(
    name: str, frame: Any, columns: Sequence[str], time: str
) -> list[DatasetProblem]:
    """A problem for each column that a table of pandas, polars or Arrow lacks."""
    there = [str(c) for c in getattr(frame, "column_names", frame.columns)]
    index = getattr(frame, "index", None)
    is_time = type(index).__name__ in _TIME_INDEX or getattr(index, "name", None) == time
    problems = []
    for column in columns:
        if column in there:
            continue
        remedy = "Name a column of the frame"
        if column == time and is_time:
            remedy = "The time is the frame's index: give frame.reset_index()"
        message = f"there is no column {column!r}{nearest(column, there)}"
        problems.append(DatasetProblem(name, None, column, message, remedy))
    return problems


def _mapping(columns: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    if isinstance(columns, str):
        return {columns: columns}
    return dict(columns) if isinstance(columns, Mapping) else {c: c for c in columns}
