"""Joint states and commands from ROS 2 bags and MCAP files: one topic of states, and one of
commands where it is named. Topics are never mixed.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxid.base.errors import nearest
from jaxid.data.importers.ros_commands import commands_of, with_commands
from jaxid.data.importers.ros_files import (
    open_bag,
    open_mcap,
    RosRecording,
    STATES,
)
from jaxid.data.importers.ros_messages import joint_values, JointRows, StateRow, topics_listed
from jaxid.data.importers.runs import (
    ImportedRun,
    Paths,
    paths_of,
    refused,
    runs_of,
    save_runs,
)


_ROLES = {
    "q": ("output", "rad"),
    "qd": ("auxiliary", "rad/s"),
    "tau": ("input", "N m"),
    "q_cmd": ("input", "rad"),
    "qd_cmd": ("auxiliary", "rad/s"),
    "tau_cmd": ("auxiliary", "N m"),
    "kp_cmd": ("auxiliary", "N m/rad"),
    "kd_cmd": ("auxiliary", "N m s/rad"),
}
_OPENING = 0.2  # m, more than the fingers of a gripper move
_GOALS = ("leader", "command", "goal", "desired", "target", "reference")


def import_ros(
    files: Paths,
    out: str | os.PathLike[str],
    kind: str,
    *,
    topic: str | None = None,
    command_topic: str | None = None,
    command_joints: Sequence[str] = (),
    overwrite: bool = False,
) -> Path:
    """A dataset folder from bags (`kind` "rosbag") or MCAP files ("mcap"), one run a file.

    `topic` is that of the states where there are several; `command_topic` adds goals as q1_cmd …,
    `TOPIC:effort` says what a Float64MultiArray holds and `command_joints` whose. Raises
    `DatasetError` or `UsageError` that list what there is.
    """
    read = open_bag if kind == "rosbag" else open_mcap
    opened = [read(path) for path in paths_of(files)]
    runs: list[ImportedRun] = []
    names: tuple[str, ...] = ()
    for recording in opened:
        notes: list[str] = []
        states = _states(recording, _topic(recording, topic), notes)
        if names and set(states.joints) != set(names):
            message = (
                f"its joints are {', '.join(states.joints)}, those of {opened[0].path.name}"
                f" {', '.join(names)}"
            )
            raise refused(recording.path, message, "Import recordings of one robot together")
        names = names or _arm_first(states)
        order = [states.joints.index(name) for name in names]
        t, columns = states.t, {k: v[:, order] for k, v in states.values.items()}
        if command_topic is not None:
            commands = commands_of(recording, command_topic, names, command_joints)
            t, columns = with_commands(t, columns, commands, names, command_topic, notes)
        for what, count in recording.trailing.items():
            notes.append(f"{recording.path.name}: {count} messages of {what} have trailing bytes")
        found = runs_of(recording.path.stem, t, _channels(columns), recording.path.name)
        found[0].notes[:0] = notes
        runs += found
    roles, joints, note = _roles(names, runs)
    kind_words = "rosbag2" if kind == "rosbag" else "mcap"
    return save_runs(runs, out, kind_words, roles, overwrite=overwrite, joints=joints, notes=[note])


def _channels(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A channel for each quantity and joint whose values are all finite."""
    channels = {}
    for quantity, values in columns.items():
        for j, of_joint in enumerate(values.T):
            if np.isfinite(of_joint).all():
                channels[_channel(quantity, j)] = of_joint
    return channels


def _roles(
    names: Sequence[str], runs: Sequence[ImportedRun]
) -> tuple[dict[str, tuple[str, str]], dict[str, str], str]:
    """(roles, names of the joints by their positions, note) of what was recorded."""
    roles = dict(_ROLES)
    joints = {f"q{j}": name for j, name in enumerate(names, 1)}
    note = "joints are " + ", ".join(f"{j} = {name}" for j, name in enumerate(names, 1))
    recorded = runs[0].columns
    if any(c.startswith("tau") and not c.endswith("_cmd") for c in recorded):
        roles["q_cmd"] = ("auxiliary", "rad")
    elif "q1_cmd" not in recorded:
        note += (
            "; no effort was recorded, so the dataset says that nothing drives the motion (free):"
            " name the goals with --command-topic, or add the channel that drives it"
        )
    doubtful = _sliding(names, runs)
    if doubtful:
        note += (
            f"; {', '.join(doubtful)} may slide, in m, or turn, which ROS does not say: kept as"
            " auxiliary, unit 1"
        )
    for name in doubtful:
        j = names.index(name)
        roles |= {_channel(quantity, j): ("auxiliary", "1") for quantity in _ROLES}
        del joints[f"q{j + 1}"]
    return roles, joints, note


def _finger(name: str, q: np.ndarray) -> bool:
    """Whether a joint is named like a finger and never leaves the opening of a gripper in m: no
    angle then, perhaps.
    """
    return (
        re.search(r"finger|gripper|claw", name, re.IGNORECASE) is not None
        and float(np.abs(q).max()) <= _OPENING
    )


def _arm_first(states: JointRows) -> tuple[str, ...]:
    """The joints in their order, those that may slide behind the others."""
    finger = {name: _finger(name, states.values["q"][:, j]) for j, name in enumerate(states.joints)}
    return tuple(sorted(states.joints, key=lambda name: finger[name]))


def _sliding(names: Sequence[str], runs: Sequence[ImportedRun]) -> list[str]:
    """Joints that may slide in every run; none where nothing else was recorded."""
    found = []
    for j, name in enumerate(names, 1):
        positions = [run.columns.get(f"q{j}") for run in runs]
        if all(q is not None and _finger(name, q) for q in positions):
            found.append(name)
    return found if len(found) < len(names) else []


def _channel(quantity: str, joint: int) -> str:
    base, _, tail = quantity.partition("_")
    return f"{base}{joint + 1}" + (f"_{tail}" if tail else "")


# ---- which topic


def _topic(recording: RosRecording, asked: str | None) -> str:
    """The topic of the states, or a refusal that lists those there are."""
    if asked is not None:
        return _asked_topic(recording, asked)
    for kinds in (("JointState", "LowState"), STATES):
        found = [n for n, (kind, count) in recording.topics.items() if kind in kinds and count]
        if len(found) == 1:
            return found[0]
        if found:
            raise _several_topics(recording, found)
    there = f"there are no joint states in it (topics: {topics_listed(recording) or 'none'})"
    raise refused(recording.path, there, "Record a topic of sensor_msgs/JointState")


def _asked_topic(recording: RosRecording, asked: str) -> str:
    if asked not in recording.topics:
        raise refused(
            recording.path,
            f"there is no topic {asked!r}{nearest(asked, recording.topics)}",
            f"Topics: {topics_listed(recording)}",
        )
    kind = recording.topics[asked][0]
    if kind not in STATES:
        raise refused(
            recording.path,
            f"topic {asked!r} holds {kind}, which is not a state of joints",
            f"Name one of {', '.join(STATES)}; topics: {topics_listed(recording)}",
        )
    return asked


def _several_topics(recording: RosRecording, found: Sequence[str]) -> Exception:
    listed = []
    goals, states = [], []
    for topic in found:
        joints = ", ".join(_joints_of(recording, topic))
        listed.append(f"{topic} ({recording.topics[topic][1]} messages: {joints})")
        is_goal = any(word in topic for word in _GOALS)
        (goals if is_goal else states).append(topic)
    own = [*states, *found][0]
    other = next(topic for topic in [*goals, *found] if topic != own)
    return refused(
        recording.path,
        f"{len(found)} topics hold states of joints, and they are not mixed: {', '.join(listed)}",
        f"Choose one: --topic {own} (and --command-topic {other} if those are its goals)",
    )


def _joints_of(recording: RosRecording, topic: str) -> list[str]:
    first = next(recording.read(topic), None)
    return [] if first is None else list(joint_values(recording.topics[topic][0], first)[0])[:12]


# ---- states


def _states(recording: RosRecording, topic: str, notes: list[str]) -> JointRows:
    """The joints that stand together in one message; several publishers on the topic are told apart
    by their joints.
    """
    kind = recording.topics[topic][0]
    rows = [StateRow(m.t, *joint_values(kind, m)) for m in recording.read(topic)]
    rows.sort(key=lambda row: row.t)
    if not rows:
        raise refused(recording.path, f"topic {topic!r} is empty", "Record again")
    rows = _of_one_publisher(recording.path.stem, topic, rows, notes)
    names = rows[0].joints
    repeated = [n for n in names if names.count(n) > 1]
    if repeated:
        raise refused(
            recording.path,
            f"joint {repeated[0]!r} stands twice in a message of {topic}",
            "Record again",
        )
    values = _values(recording.path.stem, rows, notes)
    if kind == "LowState":
        moves = [v.any(axis=0) for v in values.values()]
        moved = np.flatnonzero(np.any(moves, axis=0))
        names, values = [names[j] for j in moved], {k: v[:, moved] for k, v in values.items()}
    if "q" not in values:
        raise refused(
            recording.path, f"topic {topic!r} holds no positions", "Name another with --topic"
        )
    t = np.array([row.t for row in rows])
    _one_publisher(recording, topic, t, values["q"])
    return JointRows(t, tuple(names), values)


def _of_one_publisher(
    file: str, topic: str, rows: Sequence[StateRow], notes: list[str]
) -> list[StateRow]:
    """The messages of the largest set of joints that stands often; the others are noted."""
    sets = Counter(frozenset(row.joints) for row in rows)
    # A driver may leave joints out at times: what is a part of a larger set belongs to it.
    largest = max(sets, key=lambda s: (sets[s] >= 20, len(s), sets[s]))
    for other, count in sets.items():
        if other == largest:
            continue
        if other < largest:
            notes.append(f"{file}: {count} messages with only some of the joints were left out")
            continue
        left = ", ".join(sorted(other)[:8])
        notes.append(
            f"{file}: {topic} has another publisher, of {left} ({count} messages); it was left out"
        )
    return [row for row in rows if frozenset(row.joints) == largest]


def _values(file: str, rows: Sequence[StateRow], notes: list[str]) -> dict[str, np.ndarray]:
    """Quantity -> `[time joints]` in the order of the first message; what was not measured is left
    out and noted.
    """
    names = rows[0].joints
    values: dict[str, np.ndarray] = {}
    for quantity in ("q", "qd", "tau"):
        lengths = [len(row.values[quantity]) for row in rows]
        if lengths != [len(row.joints) for row in rows]:
            if any(lengths):
                notes.append(f"{file}: {quantity} stands in some messages only and was left out")
            continue
        values[quantity] = np.array([row.of(quantity, names) for row in rows], float)
    for quantity in ("qd", "tau"):
        if quantity in values and not values[quantity].any():
            notes.append(
                f"{file}: {quantity} is 0 throughout, so it was not measured, and was left out"
            )
            del values[quantity]
    return values


def _one_publisher(recording: RosRecording, topic: str, t: np.ndarray, q: np.ndarray) -> None:
    """Refuses two publishers of the same joints: every other sample then belongs to another motion,
    smooth by itself.
    """
    if len(q) < 40:
        return
    one = np.median(np.abs(np.diff(q, axis=0)), axis=0)
    two = np.median(np.abs(q[2:] - q[:-2]), axis=0)
    zigzag = np.mean(np.diff(q[1:], axis=0) * np.diff(q[:-1], axis=0) < 0, axis=0)
    mixed = (one > 5 * np.maximum(two, 1e-12)) & (zigzag > 0.9) & (one > 1e-3)
    if mixed.any():
        message = (
            f"two publishers of the same joints are mixed on {topic}: every other message tells of"
            " another motion"
        )
        raise refused(recording.path, message, "Record them under topics of their own")
