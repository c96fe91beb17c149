"""Recordings of robots made with other tools: ur_rtde's files, ROS 2 bags, MCAP, LeRobot, any CSV.

What is repeated is dropped and counted, what is missing is counted, and nothing is filled in: a run
is split where too much is missing. Times are those of the device where the file has them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxid.base.errors import DatasetError, DatasetProblem
from jaxid.data.importers.lerobot import import_lerobot as import_lerobot
from jaxid.data.importers.map import import_table
from jaxid.data.importers.ros import import_ros
from jaxid.data.importers.runs import ImportedRun, Paths, paths_of, refused, runs_of, save_runs
from jaxid.data.table import ragged_rows, read_table, Table


def import_ur_rtde_csv(
    files: Paths, out: str | os.PathLike[str], *, overwrite: bool = False
) -> Path:
    """Files of `startFileRecording` of ur_rtde, or of Universal Robots' own RTDE client; one run a
    file.

    `actual_q_0` becomes q1, `actual_current_0` current1 (the input), and so on; other columns are
    left out. The controller's `timestamp` is the time. These files repeat and lack samples without
    saying so: both are counted here.
    """
    runs: list[ImportedRun] = []
    for path in paths_of(files):
        runs += _ur_rtde(path)
    return save_runs(runs, out, "ur_rtde", _ROBOT, overwrite=overwrite, resolution={"q": 1e-6})


def import_rosbag(
    files: Paths,
    out: str | os.PathLike[str],
    *,
    topic: str | None = None,
    command_topic: str | None = None,
    command_joints: Sequence[str] = (),
    overwrite: bool = False,
) -> Path:
    """Joint states of ROS 2 bags (folders), one run a bag; needs the package `rosbags`. See
    `ros.import_ros`.

    `effort` becomes tau1 …, in N m as ROS has it; drivers that put a current there need the unit
    corrected in dataset.toml.
    """
    return import_ros(
        files,
        out,
        "rosbag",
        topic=topic,
        command_topic=command_topic,
        command_joints=command_joints,
        overwrite=overwrite,
    )


def import_mcap(
    files: Paths,
    out: str | os.PathLike[str],
    *,
    topic: str | None = None,
    command_topic: str | None = None,
    command_joints: Sequence[str] = (),
    overwrite: bool = False,
) -> Path:
    """Joint states of MCAP files, as ROS 2 messages or JSON with `name`, `position`, `velocity`,
    `effort`; one run a file.

    Needs the package `mcap`, and `rosbags` for ROS 2 messages. See
    `jaxid.data.importers.ros.import_ros`.
    """
    return import_ros(
        files,
        out,
        "mcap",
        topic=topic,
        command_topic=command_topic,
        command_joints=command_joints,
        overwrite=overwrite,
    )


def import_csv(
    files: Paths,
    out: str | os.PathLike[str],
    *,
    channels: Sequence[str] = (),
    overwrite: bool = False,
) -> Path:
    """Any table by a map of channels `NAME=COLUMN:UNIT:ROLE`, and `t=COLUMN:UNIT` the time; see
    `map.import_table`.

    ROLE (input, output, auxiliary) may lack for names by convention: q, position … are outputs;
    tau, force, …_cmd inputs.
    """
    return import_table(files, out, channels=channels, overwrite=overwrite).folder


# ---- what the formats hold

_ROBOT = {
    "q": ("output", "rad"),
    "qd": ("auxiliary", "rad/s"),
    "current": ("input", "A"),
    "q_cmd": ("auxiliary", "rad"),
    "qd_cmd": ("auxiliary", "rad/s"),
    "qdd_cmd": ("auxiliary", "rad/s^2"),
    "current_cmd": ("auxiliary", "A"),
    "tau_cmd": ("auxiliary", "N m"),
    "temperature": ("auxiliary", "degC"),
    "speed_scaling": ("auxiliary", "1"),
}
_UR_NAMES = {
    "actual_q": "q",
    "actual_qd": "qd",
    "actual_current": "current",
    "target_q": "q_cmd",
    "target_qd": "qd_cmd",
    "target_qdd": "qdd_cmd",
    "target_current": "current_cmd",
    "target_moment": "tau_cmd",
    "joint_temperatures": "temperature",
}


def _ur_rtde(path: Path) -> list[ImportedRun]:
    content = path.read_bytes() if path.is_file() else b""
    if content and b"," not in content.split(b"\n", 1)[0]:  # Universal Robots' client writes spaces
        content = re.sub(rb"[ \t]+", b",", content)
    table = _table(path, content)
    columns, left = {}, []
    for name in table.columns:
        channel = _ur_channel(name)
        if channel is not None:
            columns[channel] = _column(table, name)
        elif name != "timestamp":
            left.append(name)
    if not any(c.startswith("q") and c[1:].isdigit() for c in columns):
        raise refused(
            path, "there is no column actual_q_0", "Record timestamp, actual_q and actual_current"
        )
    runs = runs_of(path.stem, _column(table, "timestamp"), columns, path.name)
    run = runs[0]
    if left:
        more = " …" if len(left) > 4 else ""
        run.notes.append(f"{run.name}: {len(left)} columns left out ({', '.join(left[:4])}{more})")
    slow = columns.get("speed_scaling")
    if slow is not None and slow.min() < 0.999:
        run.notes.append(
            f"{run.name}: the robot was slowed down to {100 * slow.min():.0f} %; commands do not"
            " hold, measurements do"
        )
    return runs


def _ur_channel(column: str) -> str | None:
    """`q1` for `actual_q_0`; None for a column that is not taken."""
    if column == "speed_scaling":
        return column
    stem, _, number = column.rpartition("_")
    if stem not in _UR_NAMES or not number.isdigit():
        return None
    base, underscore, tail = _UR_NAMES[stem].partition("_")
    return f"{base}{int(number) + 1}{underscore}{tail}"


def _table(path: Path, content: bytes) -> Table:
    if not path.is_file():
        raise refused(path, "there is no such file", "Correct its name")
    table = read_table(path, path.name, content)
    if table.ragged and not table.problems:
        rows = table.rows if table.rows is not None else np.arange(table.count)
        raise DatasetError(
            [ragged_rows(table.file, rows.tolist(), table.ragged, len(table.columns))]
        )
    if table.problems:
        raise DatasetError(table.problems)
    return table


def _column(table: Table, name: str) -> np.ndarray:
    if name not in table.columns:
        raise DatasetError([table.missing(name, "this import")])
    numbers = table.numbers(name)
    if numbers.faults:
        sample, what = next(iter(numbers.faults.items()))
        raise DatasetError(
            [DatasetProblem(table.file, table.row(sample), name, what, "Correct or remove the row")]
        )
    return numbers.values
