"""Recordings of robots made with other tools: ur_rtde's files, ROS 2 bags, MCAP, LeRobot, any CSV.

What is repeated is dropped and counted, what is missing is counted, and nothing is filled in: a run is split where too much is
missing. Times are those of the device where the file has them.
"""

from __future__ import annotations

import json
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.dataset_io import save_dataset
from jaxid.errors import UsageError
from jaxid.experiment import Dataset, DatasetError, DatasetWarning, Problem


Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


@dataclass
class Run:
    """One recording: `t [time]` s and channel -> `[time]`; `notes` say what was wrong with it."""

    name: str
    t: np.ndarray
    columns: dict[str, np.ndarray]
    notes: list[str] = field(default_factory=list)


def import_ur_rtde_csv(files: Paths, out: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Files of `startFileRecording` of ur_rtde, or of Universal Robots' own RTDE client; one run a file.

    `actual_q_0` becomes q1, `actual_current_0` current1 (the input), and so on; other columns are left out. The controller's
    `timestamp` is the time. These files repeat and lack samples without saying so: both are counted here.
    """
    return _save([_ur_rtde(p) for p in _paths(files)], out, overwrite, "ur_rtde", _ROBOT, {"q": 1e-6})


def import_rosbag(files: Paths, out: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Joint states (`sensor_msgs/JointState`) of ROS 2 bags (folders), one run a bag; needs the package `rosbags`.

    `effort` becomes tau1 …, in N m as ROS has it; drivers that put a current there need the unit corrected in dataset.toml.
    """
    return _save([_rosbag(p) for p in _paths(files)], out, overwrite, "rosbag2", _JOINTS)


def import_mcap(files: Paths, out: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Joint states of MCAP files, as ROS 2 messages or JSON with `name`, `position`, `velocity`, `effort`; one run a file.

    Needs the package `mcap`, and `rosbags` for ROS 2 messages.
    """
    return _save([_mcap(p) for p in _paths(files)], out, overwrite, "mcap", _JOINTS)


def import_lerobot(files: Paths, out: str | os.PathLike[str], *, unit: str | None = None, overwrite: bool = False) -> Path:
    """A LeRobot data set (folder with meta/info.json and data/), one run an episode: states are q1 …, actions q1_cmd ….

    `unit` is that of states and actions, which the files do not say (rad, deg).
    """
    if unit is None:
        raise UsageError("LeRobot files do not say their unit: state it with --unit (rad, deg); normalised values are none")
    runs = [run for p in _paths(files) for run in _lerobot(p)]
    units = {name: unit for run in runs for name in run.columns}
    return _save(runs, out, overwrite, "lerobot", {"q_cmd": ("input", unit), "q": ("output", unit)}, units=units)


def import_csv(files: Paths, out: str | os.PathLike[str], *, channels: Sequence[str] = (), overwrite: bool = False) -> Path:
    """Any CSV or Parquet file by a map, one run a file: `channels` are `NAME=COLUMN:UNIT:ROLE`, and `t=COLUMN:UNIT` the time.

    ROLE (input, output, auxiliary) may lack for names by convention: q, position … are outputs; tau, force, …_cmd inputs.
    """
    chosen = [_parse(c) for c in channels]
    times = [c for c in chosen if c[0] == "t"]
    rest = [c for c in chosen if c[0] != "t"]
    if len(times) != 1 or not rest:
        raise UsageError("state the time and at least one channel: --channel t=time:s --channel q=angle:deg:output")
    runs = []
    for path in _paths(files):
        table = _table(path, path.read_bytes() if path.is_file() else b"")
        columns = {name: _column(table, column) for name, column, _, _ in chosen}
        t = columns.pop("t") * _factor(times[0][2])
        runs.append(_cleaned(path.stem, t, columns))
    roles = {name: (role, unit) for name, _, unit, role in rest}
    return _save(runs, out, overwrite, "csv", roles, units={name: unit for name, (_, unit) in roles.items()})


# ---- what the formats hold

_ROBOT = {
    "q": ("output", "rad"), "qd": ("auxiliary", "rad/s"), "current": ("input", "A"), "q_cmd": ("auxiliary", "rad"),
    "qd_cmd": ("auxiliary", "rad/s"), "qdd_cmd": ("auxiliary", "rad/s^2"), "current_cmd": ("auxiliary", "A"),
    "tau_cmd": ("auxiliary", "N m"), "temperature": ("auxiliary", "degC"), "speed_scaling": ("auxiliary", "1"),
}  # fmt: skip
_JOINTS = {"q": ("output", "rad"), "qd": ("auxiliary", "rad/s"), "tau": ("input", "N m")}
_UR_NAMES = {
    "actual_q": "q", "actual_qd": "qd", "actual_current": "current", "target_q": "q_cmd", "target_qd": "qd_cmd",
    "target_qdd": "qdd_cmd", "target_current": "current_cmd", "target_moment": "tau_cmd", "joint_temperatures": "temperature",
}  # fmt: skip


def _ur_rtde(path: Path) -> Run:
    content = path.read_bytes() if path.is_file() else b""
    if content and b"," not in content.split(b"\n", 1)[0]:  # Universal Robots' client writes spaces
        content = re.sub(rb"[ \t]+", b",", content)
    table = _table(path, content)
    columns, left = {}, []
    for name in table.columns:
        stem, _, number = name.rpartition("_")
        if stem in _UR_NAMES and number.isdigit():
            base, _, tail = _UR_NAMES[stem].partition("_")
            columns[f"{base}{int(number) + 1}" + (f"_{tail}" if tail else "")] = _column(table, name)
        elif name == "speed_scaling":
            columns[name] = _column(table, name)
        elif name != "timestamp":
            left.append(name)
    if not any(c.startswith("q") and c[1:].isdigit() for c in columns):
        raise _refused(path, "there is no column actual_q_0", "Record timestamp, actual_q and actual_current")
    run = _cleaned(path.stem, _column(table, "timestamp"), columns)
    if left:
        run.notes.append(f"{run.name}: {len(left)} columns left out ({', '.join(left[:4])}{' …' if len(left) > 4 else ''})")
    slow = columns.get("speed_scaling")
    if slow is not None and slow.min() < 0.999:
        run.notes.append(
            f"{run.name}: the robot was slowed down to {100 * slow.min():.0f} %; commands do not hold, measurements do"
        )
    return run


def _rosbag(path: Path) -> Run:
    reader_of = _needed("rosbags.highlevel", "rosbags").AnyReader
    stores = _needed("rosbags.typesys", "rosbags")
    rows = []
    try:
        with reader_of([path], default_typestore=stores.get_typestore(stores.Stores.ROS2_HUMBLE)) as reader:
            wanted = [c for c in reader.connections if c.msgtype == "sensor_msgs/msg/JointState"]
            for connection, stamp, raw in reader.messages(connections=wanted):
                message = reader.deserialize(raw, connection.msgtype)
                rows.append((_stamp(message, stamp), list(message.name), message.position, message.velocity, message.effort))
    except Exception as error:  # whatever a damaged bag makes its parser raise
        raise _refused(path, f"not readable as a ROS 2 bag ({_first_line(error)})", "Name the bag's folder") from None
    return _joint_states(path, rows)


def _mcap(path: Path) -> Run:
    make_reader = _needed("mcap.reader", "mcap").make_reader
    rows = []
    try:
        with path.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages():
                if channel.message_encoding == "json":
                    content = json.loads(message.data)
                    if isinstance(content, dict) and {"name", "position"} <= content.keys():
                        parts = (content.get(k) or [] for k in ("position", "velocity", "effort"))
                        rows.append((message.log_time * 1e-9, list(content["name"]), *parts))
                elif schema is not None and schema.name.replace("/msg/", "/") == "sensor_msgs/JointState":
                    stores = _needed("rosbags.typesys", "rosbags")
                    store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
                    m = store.deserialize_cdr(message.data, "sensor_msgs/msg/JointState")
                    rows.append((_stamp(m, message.log_time), list(m.name), m.position, m.velocity, m.effort))
    except UsageError:
        raise
    except Exception as error:
        raise _refused(path, f"not readable as MCAP ({_first_line(error)})", "Give an .mcap file") from None
    return _joint_states(path, rows)


def _stamp(message: Any, log_time: int) -> float:
    """Seconds: the message's own stamp, or when it was logged where it has none."""
    own = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
    return own if own > 0 else log_time * 1e-9


def _joint_states(path: Path, rows: list) -> Run:
    if not rows:
        raise _refused(path, "there are no joint states in it", "Record a topic of sensor_msgs/JointState")
    rows.sort(key=lambda r: r[0])
    names = sorted({n for r in rows for n in r[1]}, key=[*rows[0][1], *sorted({n for r in rows for n in r[1]})].index)
    whole = [r for r in rows if set(r[1]) == set(names)]
    columns: dict[str, np.ndarray] = {}
    for stem, k in (("q", 2), ("qd", 3), ("tau", 4)):
        if all(len(r[k]) == len(r[1]) for r in whole):
            values = np.array([[r[k][r[1].index(n)] for n in names] for r in whole], float)
            columns |= {f"{stem}{j + 1}": values[:, j] for j in range(len(names))}
    columns = {name: v for name, v in columns.items() if np.isfinite(v).all()}
    run = _cleaned(path.stem, np.array([r[0] for r in whole]), columns)
    run.notes.append(f"{run.name}: joints are " + ", ".join(f"{j + 1} = {n}" for j, n in enumerate(names)))
    if len(whole) < len(rows):
        run.notes.append(f"{run.name}: {len(rows) - len(whole)} messages with only some of the joints were left out")
    return run


def _lerobot(path: Path) -> list[Run]:
    import pyarrow.parquet as pq

    try:
        info = json.loads((path / "meta" / "info.json").read_text(encoding="utf-8"))
        parts = [pq.read_table(p) for p in sorted((path / "data").rglob("*.parquet"))]
    except (OSError, ValueError) as error:
        raise _refused(path, f"not readable as a LeRobot data set ({_first_line(error)})", "Name its folder") from None
    wanted = ["observation.state", "action", "timestamp", "episode_index"]
    if not parts or any(w not in p.column_names for w in wanted for p in parts):
        raise _refused(path, f"its data lack one of {', '.join(wanted)}", "Give a LeRobot data set of a robot")
    column = lambda name: np.concatenate([np.array(p[name].to_pylist(), float) for p in parts])
    state, action, t, episode = (column(w) for w in wanted)
    runs = []
    for number in np.unique(episode):
        own = episode == number
        columns = {f"q{j + 1}_cmd": action[own, j] for j in range(action.shape[1])}
        columns |= {f"q{j + 1}": state[own, j] for j in range(state.shape[1])}
        runs.append(_cleaned(f"episode_{int(number)}", t[own], columns))
    rate = float(info.get("fps", 0))
    if 0 < rate < 60:
        runs[0].notes.append(
            f"{rate:g} samples a second are too few to see friction at reversals or anything faster than {rate / 5:.0f} Hz"
        )
    return runs


# ---- what they share


def _cleaned(name: str, t: np.ndarray, columns: Mapping[str, np.ndarray]) -> Run:
    """Without repeated times and those that run backwards, both counted; what is missing is counted too."""
    top = np.maximum.accumulate(t)
    keep = np.concatenate([[True], t[1:] > top[:-1]]) if len(t) else np.zeros(0, bool)
    notes = []
    repeated, back = int(np.sum(np.diff(t) == 0)), int(np.sum(~keep) - np.sum(np.diff(t) == 0))
    if repeated:
        torn = [k for k in np.flatnonzero(np.diff(t) == 0) if any(v[k] != v[k + 1] for v in columns.values())]
        other = f", {len(torn)} of them with other values" if torn else ""
        notes.append(f"{name}: {repeated} rows repeat a time{other}; the first of each was kept")
    if back > 0:
        notes.append(f"{name}: {back} rows run backwards in time and were left out")
    t = t[keep] - (t[keep][0] if keep.any() else 0.0)
    step = np.diff(t)
    if len(step):
        period = float(np.median(step))
        missing = np.maximum(np.round(step / period).astype(int) - 1, 0)
        if missing.any():
            worst = int(np.argmax(missing))
            notes.append(
                f"{name}: {missing.sum()} samples are missing in {np.count_nonzero(missing)} gaps "
                f"({100 * missing.sum() / (missing.sum() + len(t)):.1f} %), the longest of {missing[worst]} at {t[worst]:.3f} s"
            )
    return Run(name, t, {k: v[keep] for k, v in columns.items()}, notes)


def _save(
    runs: list[Run],
    out: str | os.PathLike[str],
    overwrite: bool,
    kind: str,
    roles: Mapping[str, tuple[str | None, str]],
    resolution: Mapping[str, float] | None = None,
    *,
    units: Mapping[str, str] | None = None,
) -> Path:
    names = [c for c in runs[0].columns if all(c in r.columns for r in runs)]
    notes = [n for r in runs for n in r.notes]
    if left := sorted({c for r in runs for c in r.columns} - set(names)):
        notes.append(f"channels that not every run has were left out: {', '.join(left)}")
    stem = lambda c: c if c in roles else re.sub(r"\d+", "", c)
    role = {c: roles[stem(c)][0] or _role(c) for c in names}
    for c in names:  # a joint that nobody moved would make the whole dataset unreadable
        if role[c] == "output" and all(np.ptp(r.columns[c]) == 0 for r in runs):
            role[c] = "auxiliary"
            notes.append(f"{c} never moves and is kept as an auxiliary channel")
    pick = lambda wanted: {c: [r.columns[c] for r in runs] for c in names if role[c] == wanted}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DatasetWarning)  # the same is said below, in words that name the file
        dataset = Dataset.from_arrays(
            [r.t for r in runs],
            pick("input"),
            pick("output"),
            auxiliary=pick("auxiliary"),
            units={c: (units or {}).get(c, roles[stem(c)][1]) for c in names},
            name=Path(out).name,
            description=f"imported from {kind}; " + ("; ".join(notes) or "nothing repeated, nothing missing"),
            source={"source": kind, "files": ", ".join(r.name for r in runs)},
            names=[r.name for r in runs],
            split_at_gaps=True,
            resolution={c: v for c in names for s, v in (resolution or {}).items() if stem(c) == s},
            check_model=False,
        )
    folder = save_dataset(dataset, out, overwrite=overwrite)
    for note in notes:
        warnings.warn(note, DatasetWarning, stacklevel=3)
    return folder


def _role(name: str) -> str:
    stem = re.sub(r"\d+", "", name)
    if stem.endswith("_cmd") or stem in ("tau", "force", "current", "u"):
        return "input"
    return "output" if stem in ("q", "position", "theta", "alpha", "phi") else "auxiliary"


def _parse(text: str) -> tuple[str, str, str, str | None]:
    match = re.fullmatch(r"([A-Za-z_]\w*)=(.+?):([^:]+)(?::(input|output|auxiliary))?", text)
    if match is None:
        raise UsageError(f"--channel {text}: write NAME=COLUMN:UNIT or NAME=COLUMN:UNIT:ROLE (input, output, auxiliary)")
    return match[1], match[2], match[3], match[4]


def _factor(unit: str) -> float:
    from jaxid.units import conversion, UnitError

    try:
        return conversion(unit).factor
    except UnitError as error:
        raise UsageError(f"--channel t: {error}") from None


def _paths(files: Paths) -> list[Path]:
    return [Path(files)] if isinstance(files, str | os.PathLike) else [Path(f) for f in files]


def _table(path: Path, content: bytes):
    from jaxid.dataset_table import read_table

    if not path.is_file():
        raise _refused(path, "there is no such file", "Correct its name")
    table = read_table(path, path.name, content)
    if table.problems:
        raise DatasetError(table.problems)
    return table


def _column(table: Any, name: str) -> np.ndarray:
    if name not in table.columns:
        raise DatasetError([table.missing(name, "this import")])
    numbers = table.numbers(name)
    if numbers.faults:
        sample, what = next(iter(numbers.faults.items()))
        raise DatasetError([Problem(table.file, table.row(sample), name, what, "Correct or remove the row")])
    return numbers.values


def _needed(module: str, package: str) -> Any:
    from importlib import import_module

    try:
        return import_module(module)
    except ImportError:
        raise UsageError(f"this format needs a package that is not installed: pip install {package}") from None


def _refused(path: Path, message: str, remedy: str) -> DatasetError:
    return DatasetError([Problem(path.name or str(path), None, None, message, remedy)])


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:120]
