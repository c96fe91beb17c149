"""Writes the files of a dataset: `dataset.toml` by tomlkit, the samples by pyarrow or as CSV."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.data.dataset import Dataset, Geometry
from jaxid.data.model_names import parts_of
from jaxid.data.time_axis import impossible


def write_files(dataset: Dataset, folder: Path, format: str) -> None:
    """Runs are `run_1`, `run_2` …, frequency responses `response_1` … in the order of the
    dataset.
    """
    import tomlkit

    flagged = {
        c.name
        for i, c in enumerate(dataset.outputs)
        if any(not e.read[:, i].all() for e in dataset.experiments)
    }
    description = _header(dataset, flagged)
    entries = []
    for number, run in enumerate(dataset.experiments, 1):
        file = f"run_{number}.{format}"
        columns = {"t": run.t}
        columns |= {c.name: run.u[:, i] for i, c in enumerate(dataset.inputs)}
        columns |= {c.name: run.y[:, i] for i, c in enumerate(dataset.outputs)}
        flags = {
            _flag(c.name): run.read[:, i].astype(int)
            for i, c in enumerate(dataset.outputs)
            if c.name in flagged
        }
        _write_table(folder / file, columns | run.auxiliary | flags, format)
        entry = {"file": file, "name": run.name, "split": run.split}
        # The gaps of a loaded run are within the limit already; those of arrays were checked as
        # well.
        entry |= {"at_rest": True} if run.at_rest else {}
        entry |= (
            {"initial_window_s": run.initial_window_s} if run.initial_window_s is not None else {}
        )
        entry |= {"initial": run.initial} if run.initial is not None else {}
        entry |= {"constants": run.constants} if run.constants else {}
        entry |= {"repeat_of": run.repeat_of} if run.repeat_of is not None else {}
        entries.append(entry)
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
    links = None if dataset.model is None else dataset.model.geometry
    if links is not None and links.urdf:
        (folder / "arm.urdf").write_text(links.urdf, encoding="utf-8")
    own = None if dataset.model is None else parts_of(dataset.model.file or "")
    if own is not None:
        (folder / Path(own[0]).name).write_bytes(Path(own[0]).read_bytes())
    if links is not None and links.robot:
        (folder / robot_file(links)).write_text(links.robot, encoding="utf-8")
    (folder / "dataset.toml").write_text(tomlkit.dumps(description), encoding="utf-8")


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
        model = dataset.model
        entry: dict[str, Any] = {"name": model.name} if model.name is not None else {}
        if (own := parts_of(model.file or "")) is not None:
            entry = (
                {"file": Path(own[0]).name, "name": own[1]}
                if own[1]
                else {"file": Path(own[0]).name}
            )
        entry |= {"free": True} if model.free else {}
        entry |= {"without": list(model.without)} if model.without else {}
        entry |= {"constants": dict(model.constants)} if model.constants else {}
        if model.parameters:
            entry["parameters"] = {
                name: _stated(prior.__dict__) for name, prior in model.parameters.items()
            }
        if (links := model.geometry) is not None and links.urdf:
            entry |= {"urdf": "arm.urdf"} | _stated({"tip": links.tip, "root": links.root})
        elif links is not None and links.robot:
            del entry["name"]
            entry |= {"robot": robot_file(links)} | (
                {"tip": links.tip} if links.tip is not None else {}
            )
            entry |= {"base": dict(model.base)} if model.base else {}
        elif links is not None:
            entry["dh"] = {"convention": links.convention, **links.columns}
        entry |= {"joints": dict(model.joints)} if model.joints else {}
        top["model"] = entry
    if dataset.controller is not None:
        top["controller"] = {"kind": dataset.controller.kind, **dataset.controller.settings}
    if any(impossible(run.t) for run in dataset.experiments):
        top["time_unit"] = "s"
    top["channels"] = {
        c.name: _stated(
            {
                "role": c.role,
                "unit": c.unit,
                "noise_std": c.noise_std,
                "resolution": c.resolution,
                "hold": None if c.hold == "zero" else c.hold,
                "valid": _flag(c.name) if c.name in flagged else None,
            }
        )
        for c in dataset.channels
    }
    return top


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
