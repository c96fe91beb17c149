"""Writes a designed experiment: the dataset folder, excitation.json, trajectory.csv, a plot, and
what a UR plays.
"""

from __future__ import annotations

import csv
import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TYPE_CHECKING

import numpy as np

from jaxid.base.atomic_files import replace_files, settle
from jaxid.base.errors import UsageError
from jaxid.base.serialise import finite
from jaxid.data.write import write_files


if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
        for row in zip(*columns.values(), strict=True):
            writer.writerow([f"{value:.9g}" for value in row])


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

    motion = made.fourier is not None
    rows = _motion_rows(made) if motion else _input_rows(made)
    f = Figure(figsize=(10, 1.2 + 1.9 * len(rows)), layout="constrained")
    axes = np.atleast_1d(f.subplots(len(rows), 1, sharex=True))
    for ax, row in zip(axes, rows, strict=True):
        _draw_row(ax, made, row)
    axes[-1].set_xlabel("time (s)")
    if motion:
        axes[0].legend(
            ncols=min(7, len(made.rates) // 2),
            loc="upper center",
            bbox_to_anchor=(0.5, 1.25),
            frameon=False,
            fontsize=9,
        )
    content = made.content
    number = f"condition number {content['condition_number']:.4g}"
    f.suptitle(
        f"{content['model']}: {content['duration_s']:g} s, {number} (dotted: limits)", fontsize=11
    )
    return f


@dataclass(frozen=True)
class _Row:
    """Curves by name under one label, and the `quantity` of their limits."""

    label: str
    curves: dict[str, np.ndarray]
    quantity: str


def _motion_rows(made: Excitation) -> list[_Row]:
    inputs, outputs = made.dataset.inputs, made.dataset.outputs
    run = made.dataset.experiments[0]
    joints = outputs[: len(made.rates) // 2]
    unit = outputs[0].unit
    positions = {c.name: run.y[:, i] for i, c in enumerate(outputs)}
    speeds = {c.name: made.rates[f"qd{j}"] for j, c in enumerate(joints, 1)}
    accelerations = {c.name: made.rates[f"qdd{j}"] for j, c in enumerate(joints, 1)}
    torques = {c.name: run.u[:, i] for i, c in enumerate(inputs)}
    return [
        _Row(f"position ({unit})", positions, "range"),
        _Row(f"speed ({unit}/s)", speeds, "speed"),
        _Row(f"acceleration ({unit}/s²)", accelerations, "acceleration"),
        _Row(f"nominal torque ({inputs[0].unit})", torques, ""),
    ]


def _input_rows(made: Excitation) -> list[_Row]:
    run = made.dataset.experiments[0]
    rows = []
    for i, c in enumerate(made.dataset.inputs):
        rows.append(_Row(f"{c.name} ({c.unit})", {c.name: run.u[:, i]}, "input"))
    for i, c in enumerate(made.dataset.outputs):
        rows.append(_Row(f"{c.name} ({c.unit})\nsimulated", {c.name: run.y[:, i]}, "range"))
    return rows


def _draw_row(ax: Axes, made: Excitation, row: _Row) -> None:
    for name, values in row.curves.items():
        (line,) = ax.plot(made.t, values, lw=1.3, label=name)
        if len(row.curves) > 1 and row.quantity == "range":
            continue  # ranges of several joints would be a thicket of lines
        of_input = values if row.quantity == "input" else None
        for entry in made.limits:
            if entry["joint"] != name or entry["quantity"] != row.quantity:
                continue
            for bound in _bounds(entry, of_input):
                ax.axhline(bound, color=line.get_color(), lw=0.8, ls=":", alpha=0.9)
    ax.set_ylabel(row.label)
    ax.grid(alpha=0.25)
    ax.margins(x=0)


def _bounds(entry: dict[str, Any], values: np.ndarray | None) -> list[float]:
    if "lower" in entry:
        return [entry["lower"], entry["upper"]]
    center = 0.0 if values is None else float(values[0])
    return [center - entry["limit"], center + entry["limit"]]
