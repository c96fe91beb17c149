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

from jaxid.base.errors import nearest, UsageError
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


_TURN = 4096  # counts of the servos whose calibration LeRobot writes
_COLUMNS = ("observation.state", "action", "timestamp", "episode_index")
_GOALS_OF_JOINTS = "Give a data set whose actions are goals of the joints that are measured"


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


@dataclass(frozen=True)
class StatedUnits:
    """What the caller says of the values: the unit of a joint, of all, and the scale of a joint."""

    units: Mapping[str, str]
    everywhere: str | None
    scales: Mapping[str, Scale]

    def of(self, name: str) -> Scale | None:
        """What the values of a joint stand for where it is stated for this joint."""
        if name in self.scales:
            return self.scales[name]
        if name in self.units:
            return Scale(1.0, 0.0, self.units[name])
        return None


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
    names = sets[0].names
    if any(s.names != names for s in sets):
        raise refused(
            sets[1].path, f"its joints are not those of {sets[0].path.name}", "Import them apart"
        )
    units, everywhere = _units(unit, names)
    scales: dict[str, Scale] = {}
    if calibration is not None:
        scales |= _calibrated(Path(calibration), names, sets)
    scales |= _ranged(ranges, names, units, everywhere, sets)
    if not units and everywhere is None and not scales:
        raise UsageError(
            f"LeRobot files do not say their unit (joints: {', '.join(names)}): state it with"
            " --unit (rad, deg), for one joint with --unit NAME=UNIT; normalised values are none"
            " and need --calibration FILE or --range NAME=LO:HI"
        )
    kept, notes = _kept_joints(sets, StatedUnits(units, everywhere, scales))
    notes.append("times are frame_index / fps, nominal: the recorder keeps no measured ones")
    if 0 < sets[0].rate < 60:
        notes.append(
            f"{sets[0].rate:g} samples a second are too few to see friction at reversals or"
            f" anything faster than {sets[0].rate / 5:.0f} Hz"
        )
    return _written(sets, kept, out, overwrite, notes)


def _kept_joints(
    sets: Sequence[Episodes], stated: StatedUnits
) -> tuple[list[tuple[str, Scale]], list[str]]:
    """What each joint's values stand for, and notes.

    Raises `DatasetError` for joints whose values were normalised and whose range nothing states.
    """
    names = sets[0].names
    normalised, possible = _normalised_joints(sets)
    notes: list[str] = []
    if stated.everywhere == "deg" and possible and not stated.scales:
        notes.append(
            "every joint stays within -100..100: normalised by the recorder they are not degrees"
            " (--calibration FILE)"
        )
    kept: list[tuple[str, Scale]] = []
    refusals: list[str] = []
    for j, name in enumerate(names):
        normal = normalised[name]
        share = _share_of_closing(sets, j, name)
        scale = stated.of(name)
        if scale is not None:
            kept.append((name, scale))
        elif _is_gripper(name) or share:
            what = _gripper_words(share, normal)
            notes.append(f"{name} {what}: kept as auxiliary, unit 1 (--unit {name}=UNIT takes it)")
            kept.append((name, Scale(1.0, 0.0, "")))
        elif normal or stated.everywhere is None:
            refusals.append(f"{name} ({normal or 'no unit stated'})")
        else:
            kept.append((name, Scale(1.0, 0.0, stated.everywhere)))
    if refusals:
        raise _normalised_refusal(sets[0].path, stated.everywhere or "angle", refusals)
    return kept, notes


def _normalised_joints(sets: Sequence[Episodes]) -> tuple[dict[str, str], bool]:
    """How each joint's values show that they were normalised, empty where they do not; and whether
    all may be though none shows it.
    """
    names = sets[0].names
    words = {name: _normalised(sets, j) for j, name in enumerate(names)}
    # The recorder normalises all joints or none (grippers always): one that shows it tells of those
    # whose motion ends within.
    arm = [name for name in names if not _is_gripper(name)]
    within = [name for name in arm if _within(sets, names.index(name))]
    if not any(words[name] for name in arm):
        return words, within == arm
    for name in within:
        words[name] = words[name] or "within -100..100, beside one that touches its end"
    return words, False


def _is_gripper(name: str) -> bool:
    """Whether it is a gripper's joint, which the recorder normalises to 0..100, not -100..100."""
    return "gripper" in name.lower()


def _gripper_words(share: bool, normal: str) -> str:
    if share:
        return "moves within 0..1, a share of its closing"
    return "is a gripper in percent" if normal else "is a gripper"


def _normalised_refusal(path: Path, wanted: str, refusals: Sequence[str]) -> Exception:
    first = refusals[0].partition(" ")[0]
    return refused(
        path,
        f"values that are not {wanted} but were normalised by the recorder: {', '.join(refusals)}",
        "Give the recorder's calibration (--calibration FILE), each joint's ends (--unit deg"
        f" --range {first}=-110:110), or insist with --unit {first}=UNIT",
    )


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
    columns_of: dict[str, tuple[int, Scale]] = {}
    roles: dict[str, tuple[str | None, str]] = {}
    for j, (name, scale) in enumerate(kept):
        if scale.unit:
            base = f"q{len(joints) + 1}"
            joints[base] = name
            roles[base] = ("output", scale.unit)
            roles[f"{base}_cmd"] = ("input", scale.unit)
        else:
            base = f"gripper{j + 1}"
            roles[base] = roles[f"{base}_cmd"] = ("auxiliary", "1")
        columns_of[base] = (j, scale)
    runs: list[ImportedRun] = []
    for s in sets:
        for number in np.unique(s.episode):
            own = s.episode == number
            goals: dict[str, np.ndarray] = {}
            states: dict[str, np.ndarray] = {}
            for channel, (j, scale) in columns_of.items():
                goals[f"{channel}_cmd"] = scale.factor * s.action[own, j] + scale.offset
                states[channel] = scale.factor * s.state[own, j] + scale.offset
            runs += runs_of(f"episode_{int(number)}", s.t[own], goals | states, s.path.name)
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
    info, parts = _parts(path)
    state, action, t, episode = (_column(parts, name) for name in _COLUMNS)
    if state.ndim != 2 or state.shape != action.shape:
        raise refused(
            path,
            f"states of shape {state.shape[1:]} and actions of shape {action.shape[1:]} are not of"
            " the same joints",
            _GOALS_OF_JOINTS,
        )
    names = _names(info, "observation.state", state.shape[1])
    goals = _names(info, "action", state.shape[1])
    if set(names) != set(goals):
        raise refused(
            path,
            f"states are of {', '.join(names)}, actions of {', '.join(goals)}",
            _GOALS_OF_JOINTS,
        )
    if names != goals:
        action = action[:, [goals.index(name) for name in names]]
    return Episodes(
        path=path,
        names=names,
        state=state,
        action=action,
        t=t,
        episode=episode,
        rate=float(info.get("fps", 0) or 0),
    )


def _parts(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """`meta/info.json` and the tables under `data/`."""
    import pyarrow.parquet as pq

    try:
        info = json.loads((path / "meta" / "info.json").read_text(encoding="utf-8"))
        parts = [pq.read_table(p) for p in sorted((path / "data").rglob("*.parquet"))]
    except (OSError, ValueError) as error:
        raise refused(
            path, f"not readable as a LeRobot data set ({first_line(error)})", "Name its folder"
        ) from None
    if not parts:
        raise _lacking(path, "no Parquet file under data/")
    if not all(set(_COLUMNS) <= set(part.column_names) for part in parts):
        raise _lacking(path, ", ".join(parts[0].column_names[:20]))
    return info, parts


def _lacking(path: Path, there: str) -> Exception:
    return refused(
        path,
        f"its data lack one of {', '.join(_COLUMNS)} (there is: {there})",
        "Give a LeRobot data set of a robot",
    )


def _column(parts: Sequence[Any], name: str) -> np.ndarray:
    return np.concatenate([np.array(part[name].to_pylist(), float) for part in parts])


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
    if names is None:
        return []
    if isinstance(names, Mapping):
        places = names.values()
        if names and all(isinstance(place, int) for place in places):
            return sorted(names, key=lambda name: names[name])
        return _leaves(list(places))
    if not isinstance(names, list):
        return [str(names)]
    found: list[str] = []
    for one in names:
        found += _leaves(one)
    return found


def _values(sets: Sequence[Episodes], j: int) -> np.ndarray:
    """All states and actions of a joint."""
    return np.concatenate([np.append(s.state[:, j], s.action[:, j]) for s in sets])


def _normalised(sets: Sequence[Episodes], j: int) -> str:
    """How the values of a joint show that they were normalised: they end at exactly 100 and never
    go beyond.
    """
    values = _values(sets, j)
    low, high = float(values.min()), float(values.max())
    touches_low, touches_high = abs(low + 100) < 1e-3, abs(high - 100) < 1e-3
    if high > 100.001 or low < -100.001 or not (touches_high or touches_low):
        return ""
    ends = "0..100" if low >= -0.001 and touches_high else "-100..100"
    return f"within {ends}, touching its end"


def _share_of_closing(sets: Sequence[Episodes], j: int, name: str) -> bool:
    """Whether a joint of a hand never leaves 0..1: then it is as likely a share of its closing as
    an angle.
    """
    if not re.search(r"gripper|hand|finger|thumb|claw", name, re.IGNORECASE):
        return False
    values = _values(sets, j)
    return bool(values.min() >= -0.001 and values.max() <= 1.001)


def _within(sets: Sequence[Episodes], j: int) -> bool:
    return bool(np.abs(_values(sets, j)).max() <= 100.001)


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
                f"--unit {one} is not a unit of a joint: rad, deg, m; normalised values need"
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
        out[name] = _between(low, high, _is_gripper(name), unit)
    return out


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
        low, high = (0.0, 2 * half) if _is_gripper(name) else (-half, half)
        if motors[name].get("drive_mode"):
            low, high = high, low
        out[name] = _between(low, high, _is_gripper(name), "rad")
    return out
