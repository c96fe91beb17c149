"""Writes a designed experiment: the dataset folder, excitation.json, trajectory.csv, a plot, and
what a UR plays.
"""

from __future__ import annotations

import csv
import json
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TYPE_CHECKING

import numpy as np

from jaxid.data.write import write_files
from jaxid.errors import UsageError
from jaxid.serialise import finite
from jaxid.storage.atomic_files import replace_files, settle


if TYPE_CHECKING:
    from jaxid.excitation.result import Excitation


#: Rates at which a UR is commanded: CB3 and e-series.
UR_RATES = (125, 500)


def write(made: Excitation, folder: Path) -> Path:
    """All files of an excitation; an earlier one in the same folder is replaced, at once. Raises
    `UsageError` where other files lie, and `NotSaved` where they cannot be written.
    """
    settle(folder)
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--out {folder}: a file has this name; choose another folder")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / "excitation.json").is_file():
        raise UsageError(f"--out {folder} holds other files; choose another folder")
    with TemporaryDirectory() as place:
        _write(made, Path(place))
        files = {path.name: path.read_bytes() for path in sorted(Path(place).iterdir())}
    older: dict[str, str] = {}
    with suppress(OSError, ValueError, KeyError):
        older = json.loads((folder / "excitation.json").read_bytes())["files"]
    return replace_files(
        folder, files, [n for n in older.values() if n not in files and Path(n).name == n]
    )


def _write(made: Excitation, folder: Path) -> None:
    files = {
        "dataset": "dataset.toml",
        "run": "run_1.parquet",
        "trajectory": "trajectory.csv",
        "plot": "excitation.png",
    }
    write_files(made.dataset, folder, "parquet")
    table = {"t": made.t, **made.commands, **made.rates}
    _csv(folder / "trajectory.csv", table)
    if made.content["model"] in ("ur10", "ur10e") and made.fourier is not None:
        for rate in UR_RATES:
            name = f"ur_{rate}hz.csv"
            t = np.arange(round(made.t[-1] * rate) + 1) / rate
            q = made.fourier(t)[0]
            _csv(folder / name, {"t": t, **{f"q{j + 1}_cmd": q[:, j] for j in range(q.shape[1])}})
            files[f"ur_{rate}hz"] = name
        (folder / "ur.script").write_text(urscript(made), encoding="utf-8")
        files["urscript"] = "ur.script"
    figure(made).savefig(folder / "excitation.png", dpi=110)
    made.content["files"] = files
    content = json.dumps(finite(made.content), indent=1, allow_nan=False)
    (folder / "excitation.json").write_text(content, encoding="utf-8")


def _csv(path: Path, columns: dict[str, np.ndarray]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*([f"{v:.9g}" for v in c] for c in columns.values()), strict=True))


def urscript(made: Excitation) -> str:
    """A program for PolyScope that moves to the beginning and plays the path by servoj at 125
    Hz.
    """
    assert made.fourier is not None
    step = 1 / UR_RATES[0]
    t = np.arange(round(made.t[-1] / step) + 1) * step
    q = made.fourier(t)[0]

    def pose(row):
        return "[" + ", ".join(f"{v:.6f}" for v in row) + "]"

    lines = [
        (
            "# Made by jaxid excite. Speed slider at 100 %, emergency stop in reach. This file was"
            " not tried on a controller."
        ),
        "def jaxid_excitation():",
        f"  movej({pose(q[0])}, a=0.5, v=0.3)",
        "  sleep(1.0)",
        *(f"  servoj({pose(row)}, 0, 0, {step:g}, 0.1, 300)" for row in q[1:]),
        "  stopj(2.0)",
        "end",
    ]
    return "\n".join(lines) + "\n"


def figure(made: Excitation) -> Any:
    """Every command (and for a motion its speed and acceleration) over time, with limits."""
    from matplotlib.figure import Figure

    t, dataset = made.t, made.dataset
    run = dataset.experiments[0]
    content = made.content
    motion = made.fourier is not None
    outputs = [c for c in dataset.outputs]
    inputs = [c for c in dataset.inputs]
    joints = len(made.rates) // 2
    rows: list[tuple[str, list[tuple[str, np.ndarray]], str]] = []
    if motion:
        unit = outputs[0].unit
        rows.append(
            (f"position ({unit})", [(c.name, run.y[:, i]) for i, c in enumerate(outputs)], "range")
        )
        rows.append(
            (
                f"speed ({unit}/s)",
                [(c.name, made.rates[f"qd{j + 1}"]) for j, c in enumerate(outputs[:joints])],
                "speed",
            )
        )
        rows.append(
            (
                f"acceleration ({unit}/s²)",
                [(c.name, made.rates[f"qdd{j + 1}"]) for j, c in enumerate(outputs[:joints])],
                "acceleration",
            )
        )
        rows.append(
            (
                f"nominal torque ({inputs[0].unit})",
                [(c.name, run.u[:, i]) for i, c in enumerate(inputs)],
                "",
            )
        )
    else:
        rows += [
            (f"{c.name} ({c.unit})", [(c.name, run.u[:, i])], "input") for i, c in enumerate(inputs)
        ]
        rows += [
            (f"{c.name} ({c.unit})\nsimulated", [(c.name, run.y[:, i])], "range")
            for i, c in enumerate(outputs)
        ]
    f = Figure(figsize=(10, 1.2 + 1.9 * len(rows)), layout="constrained")
    axes = np.atleast_1d(f.subplots(len(rows), 1, sharex=True))
    for ax, (label, series, quantity) in zip(axes, rows, strict=True):
        for k, (name, values) in enumerate(series):
            (line,) = ax.plot(t, values, lw=1.3, label=name)
            if len(series) > 1 and quantity == "range":
                continue  # ranges of several joints would be a thicket of lines
            for entry in made.limits:
                if entry["joint"] == name and entry["quantity"] == quantity:
                    for bound in _bounds(entry, values if quantity == "input" else None):
                        ax.axhline(bound, color=line.get_color(), lw=0.8, ls=":", alpha=0.9)
        ax.set_ylabel(label)
        ax.grid(alpha=0.25)
        ax.margins(x=0)
    axes[-1].set_xlabel("time (s)")
    if motion:
        axes[0].legend(
            ncols=min(7, joints),
            loc="upper center",
            bbox_to_anchor=(0.5, 1.25),
            frameon=False,
            fontsize=9,
        )
    number = f"condition number {content['condition_number']:.4g}"
    f.suptitle(
        f"{content['model']}: {content['duration_s']:g} s, {number} (dotted: limits)", fontsize=11
    )
    return f


def _bounds(entry: dict[str, Any], values: np.ndarray | None) -> list[float]:
    if "lower" in entry:
        return [entry["lower"], entry["upper"]]
    center = 0.0 if values is None else float(values[0])
    return [center - entry["limit"], center + entry["limit"]]
