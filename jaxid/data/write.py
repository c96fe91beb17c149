"""Writes the files of a dataset: `dataset.toml` by tomlkit, the samples by pyarrow or as CSV."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.data.dataset import Dataset, Experiment, Geometry, ModelSpec
from jaxid.data.model_names import parts_of
from jaxid.data.time_axis import impossible


def write_files(dataset: Dataset, folder: Path, format: str) -> None:
    """Runs are `run_1`, `run_2` …, frequency responses `response_1` … in the order of the
    dataset.
    """
    import tomlkit

    flagged = _flagged(dataset)
    description = _header(dataset, flagged)
    entries = []
    for number, run in enumerate(dataset.experiments, 1):
        file = f"run_{number}.{format}"
        _write_table(folder / file, _columns(dataset, run, flagged), format)
        entry = {
            "file": file,
            "name": run.name,
            "split": run.split,
            # The gaps of a loaded run are within the limit already; those of arrays were checked as
            # well.
            "at_rest": run.at_rest or None,
            "initial_window_s": run.initial_window_s,
            "initial": run.initial,
            "constants": run.constants or None,
            "repeat_of": run.repeat_of,
        }
        entries.append(_stated(entry))
    for number, response in enumerate(dataset.responses, 1):
        file = f"response_{number}.{format}"
        parts = {
            "omega": response.omega,
            "re": np.real(response.response),
            "im": np.imag(response.response),
        }
        _write_table(folder / file, parts, format)
        about = {"kind": "frequency_response", "input": response.input, "output": response.output}
        entries.append({"file": file, "name": response.name, "split": response.split, **about})
    description["experiments"] = entries
    if dataset.model is not None:
        _write_model_files(dataset.model, folder)
    (folder / "dataset.toml").write_text(tomlkit.dumps(description), encoding="utf-8")


def _flagged(dataset: Dataset) -> set[str]:
    """Outputs of which some readings do not count."""
    flagged = set()
    for i, channel in enumerate(dataset.outputs):
        if not all(run.read[:, i].all() for run in dataset.experiments):
            flagged.add(channel.name)
    return flagged


def _columns(dataset: Dataset, run: Experiment, flagged: set[str]) -> dict[str, np.ndarray]:
    columns = {"t": run.t}
    columns |= {c.name: run.u[:, i] for i, c in enumerate(dataset.inputs)}
    columns |= {c.name: run.y[:, i] for i, c in enumerate(dataset.outputs)}
    columns |= run.auxiliary
    for i, channel in enumerate(dataset.outputs):
        if channel.name in flagged:
            columns[_flag(channel.name)] = run.read[:, i].astype(int)
    return columns


def _write_model_files(model: ModelSpec, folder: Path) -> None:
    """The files that a model's entry names, beside `dataset.toml`."""
    links = model.geometry
    if links is not None and links.urdf:
        (folder / "arm.urdf").write_text(links.urdf, encoding="utf-8")
    own = parts_of(model.file or "")
    if own is not None:
        file = Path(own[0])
        (folder / file.name).write_bytes(file.read_bytes())
    if links is not None and links.robot:
        written_robot(links, folder)


def _flag(channel: str) -> str:
    """The column that says which readings of a channel count."""
    return f"{channel}.valid"  # no channel can have this name


def _header(dataset: Dataset, flagged: set[str]) -> dict[str, Any]:
    top: dict[str, Any] = {"name": dataset.name}
    if dataset.description:
        top["description"] = dataset.description
    if dataset.source is not None:
        top["source"] = dataset.source
    if dataset.model is not None:
        top["model"] = _model(dataset.model)
    if dataset.controller is not None:
        top["controller"] = {"kind": dataset.controller.kind, **dataset.controller.settings}
    if any(impossible(run.t) for run in dataset.experiments):
        top["time_unit"] = "s"
    channels = {}
    for channel in dataset.channels:
        entry = {
            "role": channel.role,
            "unit": channel.unit,
            "noise_std": channel.noise_std,
            "resolution": channel.resolution,
            "hold": None if channel.hold == "zero" else channel.hold,
            "valid": _flag(channel.name) if channel.name in flagged else None,
        }
        channels[channel.name] = _stated(entry)
    top["channels"] = channels
    return top


def _model(model: ModelSpec) -> dict[str, Any]:
    """The entry `[model]`."""
    entry: dict[str, Any] = {}
    own = parts_of(model.file or "")
    links = model.geometry
    if own is not None:
        entry["file"] = Path(own[0]).name
        entry["name"] = own[1] or None
    elif links is None or not links.robot:
        entry["name"] = model.name
    entry["free"] = model.free or None
    entry["without"] = list(model.without) or None
    entry["constants"] = dict(model.constants) or None
    if model.parameters:
        priors = model.parameters.items()
        entry["parameters"] = {name: _stated(prior.__dict__) for name, prior in priors}
    if links is not None:
        entry |= _links(links, model.base)
    entry["joints"] = dict(model.joints) or None
    entry["trust"] = model.trust
    entry["simulator"] = model.simulator
    return _stated(entry)


def _links(links: Geometry, base: Mapping[str, Any]) -> dict[str, Any]:
    """How `[model]` names the links of a chain."""
    if links.urdf:
        return {"urdf": "arm.urdf", "tip": links.tip, "root": links.root}
    if links.robot:
        return {"robot": robot_file(links), "tip": links.tip, "base": dict(base) or None}
    return {"dh": {"convention": links.convention, **links.columns}}


def written_robot(links: Geometry, folder: Path) -> str:
    """Writes a robot's file into a dataset's folder; its name there."""
    assert links.robot is not None
    name = robot_file(links)
    (folder / name).write_text(links.robot, encoding="utf-8")
    return name


def robot_file(links: Geometry) -> str:
    """The name under which a robot's file is written."""
    return "robot.urdf" if links.file.lower().endswith(".urdf") else "robot.xml"


def _stated(entry: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in entry.items() if v is not None}


def _write_table(path: Path, columns: dict[str, np.ndarray], format: str) -> None:
    if format == "csv":
        with path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(
                zip(*(map(repr, values.tolist()) for values in columns.values()), strict=True)
            )
        return
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({name: pa.array(values) for name, values in columns.items()}), path)
