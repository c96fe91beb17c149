"""LeRobot data sets (v2.1: a file an episode; v3: files of many): names of joints kept, a unit a
joint, normalised values refused without the calibration that says what they stand for.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.data.importers.runs import (
    first_line,
    ImportedRun,
    Paths,
    paths_of,
    refused,
    runs_of,
    save_runs,
)
from jaxid.data.units import conversion, UnitError
from jaxid.errors import nearest, UsageError


_TURN = 4096  # counts of the servos whose calibration LeRobot writes
_COLUMNS = ("observation.state", "action", "timestamp", "episode_index")


@dataclass(frozen=True)
class Scale:
    """What a recorded value stands for: `factor * raw + offset` in `unit`."""

    factor: float
    offset: float
    unit: str


@dataclass(frozen=True)
class Episodes:
    """A data set: names of the joints, `state`, `action [time joints]`, `t [time]` s, episode
    [time].
    """

    path: Path
    names: tuple[str, ...]
    state: np.ndarray
    action: np.ndarray
    t: np.ndarray
    episode: np.ndarray
    rate: float


def import_lerobot(
    files: Paths,
    out: str | os.PathLike[str],
    *,
    unit: str | Sequence[str] | None = None,
    calibration: str | os.PathLike[str] | None = None,
    ranges: Sequence[str] = (),
    overwrite: bool = False,
) -> Path:
    """A LeRobot data set (folder with meta/info.json and data/), one run an episode: states are q1
    …, actions q1_cmd ….

    `unit` is that of states and actions, which the files do not say: one for all (rad, deg), or
    `NAME=UNIT` for a joint. Values that the recorder normalised to -100..100 or 0..100 need
    `calibration` (its JSON file) or `ranges`, `NAME=LO:HI` in the unit.
    """
    sets = [_read(p) for p in paths_of(files)]
    if any(s.names != sets[0].names for s in sets):
        raise refused(
            sets[1].path, f"its joints are not those of {sets[0].path.name}", "Import them apart"
        )
    names = sets[0].names
    units, everywhere = _units(unit, names)
    scales: dict[str, Scale] = (
        {} if calibration is None else _calibrated(Path(calibration), names, sets)
    )
    scales |= _ranged(ranges, names, units, everywhere, sets)
    if not units and everywhere is None and not scales:
        raise UsageError(
            f"LeRobot files do not say their unit (joints: {', '.join(names)}): state it with"
            " --unit (rad, deg), for one joint with --unit NAME=UNIT; normalised values are none"
            " and need --calibration FILE or --range NAME=LO:HI"
        )
    kept: list[tuple[str, Scale]] = []
    notes: list[str] = []
    refusals: list[str] = []
    # The recorder normalises all joints or none (grippers always): one that shows it tells of those
    # whose motion ends within.
    arm = [j for j, n in enumerate(names) if "gripper" not in n.lower()]
    shown = any(_normalised(sets, j) for j in arm)
    if everywhere == "deg" and not shown and not scales and all(_within(sets, j) for j in arm):
        notes.append(
            "every joint stays within -100..100: normalised by the recorder they are no degrees"
            " (--calibration FILE)"
        )
    for j, name in enumerate(names):
        own = units.get(name)
        share = _share_of_closing(sets, j, name)
        normal = _normalised(sets, j)
        if not normal and shown and j in arm and _within(sets, j):
            normal = "within -100..100, beside one that touches its end"
        if name in scales:
            kept.append((name, scales[name]))
        elif own is not None:
            kept.append((name, Scale(1.0, 0.0, own)))
        elif "gripper" in name.lower() or share:
            what = (
                "moves within 0..1, a share of its closing"
                if share
                else f"is a gripper{normal and ' in percent'}"
            )
            notes.append(f"{name} {what}: kept as auxiliary, unit 1 (--unit {name}=UNIT takes it)")
            kept.append((name, Scale(1.0, 0.0, "")))
        elif normal or everywhere is None:
            refusals.append(f"{name} ({normal or 'no unit stated'})")
        else:
            kept.append((name, Scale(1.0, 0.0, everywhere)))
    if refusals:
        first = refusals[0].partition(" ")[0]
        raise refused(
            sets[0].path,
            f"values that are no {everywhere or 'angle'} but were normalised by the recorder:"
            f" {', '.join(refusals)}",
            "Give the recorder's calibration (--calibration FILE), each joint's ends (--unit deg"
            f" --range {first}=-110:110), or insist with --unit {first}=UNIT",
        )
    notes.append("times are frame_index / fps, nominal: the recorder keeps no measured ones")
    if 0 < sets[0].rate < 60:
        notes.append(
            f"{sets[0].rate:g} samples a second are too few to see friction at reversals or"
            f" anything faster than {sets[0].rate / 5:.0f} Hz"
        )
    return _written(sets, kept, out, overwrite, notes)


def _written(
    sets: Sequence[Episodes],
    kept: Sequence[tuple[str, Scale]],
    out: Any,
    overwrite: bool,
    notes: list[str],
) -> Path:
    """The folder: joints in the order of the file, grippers without a unit behind them as auxiliary
    channels.
    """
    joints: dict[str, str] = {}
    channels: dict[str, tuple[int, np.ndarray | None, Scale]] = {}
    roles: dict[str, tuple[str | None, str]] = {}
    for j, (name, scale) in enumerate(kept):
        base = f"q{len(joints) + 1}" if scale.unit else f"gripper{j + 1}"
        if scale.unit:
            joints[base] = name
        roles[base] = ("output" if scale.unit else "auxiliary", scale.unit or "1")
        roles[f"{base}_cmd"] = ("input" if scale.unit else "auxiliary", scale.unit or "1")
        channels[base] = (j, None, scale)
    runs: list[ImportedRun] = []
    for s in sets:
        for number in np.unique(s.episode):
            own = s.episode == number
            columns = {
                f"{c}_cmd": k.factor * s.action[own, j] + k.offset
                for c, (j, _, k) in channels.items()
            }
            columns |= {
                c: k.factor * s.state[own, j] + k.offset for c, (j, _, k) in channels.items()
            }
            runs += runs_of(f"episode_{int(number)}", s.t[own], columns, s.path.name)
    said = "joints are " + ", ".join(f"{c} = {n}" for c, n in joints.items())
    return save_runs(
        runs,
        out,
        "lerobot",
        roles,
        overwrite=overwrite,
        units={c: u for c, (_, u) in roles.items()},
        joints=joints,
        notes=[said, *notes],
    )


def _read(path: Path) -> Episodes:
    import pyarrow.parquet as pq

    try:
        info = json.loads((path / "meta" / "info.json").read_text(encoding="utf-8"))
        parts = [pq.read_table(p) for p in sorted((path / "data").rglob("*.parquet"))]
    except (OSError, ValueError) as error:
        raise refused(
            path, f"not readable as a LeRobot data set ({first_line(error)})", "Name its folder"
        ) from None
    if not parts or any(w not in p.column_names for w in _COLUMNS for p in parts):
        there = ", ".join(parts[0].column_names[:20]) if parts else "no Parquet file under data/"
        raise refused(
            path,
            f"its data lack one of {', '.join(_COLUMNS)} (there is: {there})",
            "Give a LeRobot data set of a robot",
        )

    def column(name):
        return np.concatenate([np.array(p[name].to_pylist(), float) for p in parts])

    state, action, t, episode = (column(w) for w in _COLUMNS)
    if state.ndim != 2 or state.shape != action.shape:
        message = (
            f"states of shape {state.shape[1:]} and actions of shape {action.shape[1:]} are not of"
            " the same joints"
        )
        raise refused(
            path, message, "Give a data set whose actions are goals of the joints that are measured"
        )
    names, goals = (_names(info, key, state.shape[1]) for key in ("observation.state", "action"))
    if set(names) == set(goals) and names != goals:
        action = action[:, [goals.index(n) for n in names]]
    elif names != goals:
        message = f"states are of {', '.join(names)}, actions of {', '.join(goals)}"
        raise refused(
            path, message, "Give a data set whose actions are goals of the joints that are measured"
        )
    return Episodes(path, names, state, action, t, episode, float(info.get("fps", 0) or 0))


def _names(info: Any, feature: str, count: int) -> tuple[str, ...]:
    """Names of a feature's elements without what they measure (`pan.pos`), from lists and mappings
    in one another.
    """
    found = ((info.get("features") or {}).get(feature) or {}).get("names")
    names = [n.removesuffix(".pos").removeprefix("main_") for n in _leaves(found)]
    return (
        tuple(names)
        if len(names) == count == len(set(names))
        else tuple(f"joint_{k + 1}" for k in range(count))
    )


def _leaves(names: Any) -> list[str]:
    """The names in lists and mappings, however deep they lie in one another, in their order."""
    if (
        isinstance(names, Mapping)
        and names
        and all(isinstance(place, int) for place in names.values())
    ):
        return sorted(names, key=lambda name: names[name])
    if isinstance(names, Mapping):
        return [leaf for group in names.values() for leaf in _leaves(group)]
    if isinstance(names, list):
        return [leaf for one in names for leaf in _leaves(one)]
    return [] if names is None else [str(names)]


def _normalised(sets: Sequence[Episodes], j: int) -> str:
    """How the values of a joint show that they were normalised: they end at exactly 100 and never
    go beyond.
    """
    values = np.concatenate([a[:, j] for s in sets for a in (s.state, s.action)])
    low, high = float(values.min()), float(values.max())

    def touches(end, at):
        return abs(end - at) < 1e-3

    if high <= 100.001 and low >= -100.001 and (touches(high, 100) or touches(low, -100)):
        ends = "0..100" if low >= -0.001 and touches(high, 100) else "-100..100"
        return f"within {ends}, touching its end"
    return ""


def _share_of_closing(sets: Sequence[Episodes], j: int, name: str) -> bool:
    """Whether a joint of a hand never leaves 0..1: then it is as likely a share of its closing as
    an angle.
    """
    if not re.search(r"gripper|hand|finger|thumb|claw", name, re.IGNORECASE):
        return False
    values = np.concatenate([a[:, j] for s in sets for a in (s.state, s.action)])
    return bool(values.min() >= -0.001 and values.max() <= 1.001)


def _within(sets: Sequence[Episodes], j: int) -> bool:
    return all(np.abs(a[:, j]).max() <= 100.001 for s in sets for a in (s.state, s.action))


def _units(
    unit: str | Sequence[str] | None, names: Sequence[str]
) -> tuple[dict[str, str], str | None]:
    """Unit of single joints, and that of all others."""
    own: dict[str, str] = {}
    everywhere = None
    for text in [unit] if isinstance(unit, str) else (unit or ()):
        name, sign, one = text.rpartition("=")
        try:
            si = conversion(one).si
        except UnitError as error:
            raise UsageError(f"--unit {text}: {error}") from None
        if not sign and si not in ("rad", "m"):
            raise UsageError(
                f"--unit {one} is no unit of a joint: rad, deg, m; normalised values need"
                " --calibration or --range"
            )
        if not sign:
            everywhere = one
        elif name in names:
            own[name] = one
        else:
            raise UsageError(f"--unit {text}: there is no joint {name!r}{nearest(name, names)}")
    return own, everywhere


def _ranged(
    ranges: Sequence[str],
    names: Sequence[str],
    units: Mapping[str, str],
    everywhere: str | None,
    sets: Sequence[Episodes],
) -> dict[str, Scale]:
    """`NAME=LO:HI`: what the ends of the normalised range stand for."""
    out = {}
    for text in ranges:
        name, _, ends = text.partition("=")
        try:
            low, high = (float(e) for e in ends.split(":"))
        except ValueError:
            raise UsageError(
                f"--range {text}: write NAME=LO:HI, the joint's angle at -100 (or 0) and at 100"
            ) from None
        if name not in names:
            raise UsageError(f"--range {text}: there is no joint {name!r}{nearest(name, names)}")
        unit = units.get(name, everywhere)
        if unit is None or low == high:
            raise UsageError(
                f"--range {text}: state the unit of its ends, --unit deg, and two ends that differ"
            )
        out[name] = _between(low, high, _from_zero(name), unit)
    return out


def _from_zero(name: str) -> bool:
    """Whether the recorder normalises a joint to 0..100: it does so for grippers, and takes
    -100..100 for all others.
    """
    return "gripper" in name.lower()


def _between(low: float, high: float, from_zero: bool, unit: str) -> Scale:
    return (
        Scale((high - low) / 100, low, unit)
        if from_zero
        else Scale((high - low) / 200, (low + high) / 2, unit)
    )


def _calibrated(path: Path, names: Sequence[str], sets: Sequence[Episodes]) -> dict[str, Scale]:
    """Scales from the recorder's calibration: the ends of each motor's range in counts, 4096 a
    turn, zero in their middle.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        motors = {
            n: content[n]
            for n in content
            if isinstance(content[n], dict) and {"range_min", "range_max"} <= set(content[n])
        }
    except (OSError, ValueError, TypeError) as error:
        raise UsageError(
            f"--calibration {path}: not readable as JSON ({first_line(error)})"
        ) from None
    if not motors:
        raise UsageError(
            f"--calibration {path}: it names no motor with range_min and range_max; give LeRobot's"
            " own file"
        )
    lacking = [n for n in names if n not in motors]
    if lacking:
        raise UsageError(
            f"--calibration {path}: nothing of {', '.join(lacking)}{nearest(lacking[0], motors)}"
        )
    out = {}
    for name in names:
        half = np.pi * (float(motors[name]["range_max"]) - float(motors[name]["range_min"])) / _TURN
        low, high = (0.0, 2 * half) if _from_zero(name) else (-half, half)
        if motors[name].get("drive_mode"):
            low, high = high, low
        out[name] = _between(low, high, _from_zero(name), "rad")
    return out
