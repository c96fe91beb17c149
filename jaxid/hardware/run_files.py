"""The files of a recorded run: its tables, its report, its place in `dataset.toml`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.hardware.channels import channel_map
from jaxid.hardware.recorder import Column


def write_run(
    *,
    out: Path,
    number: str,
    table: Mapping[str, np.ndarray],
    extra: Mapping[str, Mapping[str, np.ndarray]],
    columns: Sequence[Column],
    entry: Mapping[str, Any],
    about: Mapping[str, Any],
    report: Mapping[str, Any],
) -> None:
    """Each file appears whole or not at all; `dataset.toml` comes last, so that it never names a
    file that is not there.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq
    import tomlkit

    text = json.dumps(report, indent=1)

    def parquet(name: str, content: Mapping[str, np.ndarray]) -> None:
        data = pa.table({k: pa.array(v) for k, v in content.items()})
        partial = out / f"{name}.partial"
        pq.write_table(data.replace_schema_metadata({"jaxid": text}), partial)
        partial.replace(out / name)

    parquet(entry["file"], table)
    for name, content in extra.items():
        parquet(f"run_{number}.{name}.parquet", content)
    _replace(out / f"run_{number}.json", text)
    path = out / "dataset.toml"
    if path.is_file():
        document = tomlkit.parse(path.read_text(encoding="utf-8"))
        _append_run(document, entry)
        _replace(path, tomlkit.dumps(document))
        return
    content = _new_dataset(out, about, columns)
    content["experiments"] = [entry]
    _replace(path, tomlkit.dumps(content))


def _append_run(document: Any, entry: Mapping[str, Any]) -> None:
    """Adds a run to a `dataset.toml`, unless it stands there already."""
    import tomlkit

    runs = document["experiments"]
    if entry["file"] not in [str(run["file"]) for run in runs]:
        runs.append(tomlkit.item(dict(entry)))


def _new_dataset(out: Path, about: Mapping[str, Any], columns: Sequence[Column]) -> dict[str, Any]:
    """The description of a dataset without its runs."""
    model, robot = about.get("model"), about.get("robot")
    content: dict[str, Any] = {key: about[key] for key in ("name", "description", "source")}
    if robot:
        model = str(out / robot)
    if model:
        content["model"] = {"robot": robot} if robot else {"name": model}
        if about.get("model_constants"):
            content["model"]["constants"] = about["model_constants"]
    content["channels"] = channel_map(model, columns, about.get("joint"), about.get("gain"))
    return content


def _replace(path: Path, text: str) -> None:
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
