"""Joint states and commands from ROS 2 bags and MCAP files: one topic of states, and one of
commands where it is named. Topics are never mixed.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.data.importers.ros_files import (
    COMMANDS,
    Message,
    open_bag,
    open_mcap,
    RosRecording,
    STATES,
)
from jaxid.data.importers.runs import (
    held,
    ImportedRun,
    Paths,
    paths_of,
    refused,
    runs_of,
    save_runs,
)
from jaxid.errors import nearest, UsageError


_QUANTITIES = {"position": "q", "velocity": "qd", "effort": "tau"}
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
#: Order of the motors in Unitree's messages for quadrupeds, as its SDK has it.
_QUADRUPED = tuple(
    f"{leg}_{joint}_joint" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf")
)


@dataclass(frozen=True)
class JointRows:
    """Values of joints over time: `t [time]`, the joints' names, quantity (q, qd, tau …) -> [time
    joints].
    """

    t: np.ndarray
    joints: tuple[str, ...]
    values: dict[str, np.ndarray]


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
    opened = [(open_bag if kind == "rosbag" else open_mcap)(p) for p in paths_of(files)]
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
        order = [states.joints.index(n) for n in names]
        t, columns = states.t, {k: v[:, order] for k, v in states.values.items()}
        if command_topic is not None:
            commands = _commands(recording, command_topic, names, command_joints)
            t, columns = _with_commands(t, columns, commands, names, command_topic, notes)
        flat = {
            _channel(k, j): v[:, j]
            for k, v in columns.items()
            for j in range(len(names))
            if np.isfinite(v[:, j]).all()
        }
        notes += [
            f"{recording.path.name}: {n} messages of {what} have trailing bytes"
            for what, n in recording.trailing.items()
        ]
        found = runs_of(recording.path.stem, t, flat, recording.path.name)
        found[0].notes[:0] = notes
        runs += found
    said = "joints are " + ", ".join(f"{j + 1} = {n}" for j, n in enumerate(names))
    joints = {f"q{j + 1}": n for j, n in enumerate(names)}
    torque = any(c.startswith("tau") and not c.endswith("_cmd") for c in runs[0].columns)
    roles = dict(_ROLES) | ({"q_cmd": ("auxiliary", "rad")} if torque else {})
    if not torque and "q1_cmd" not in runs[0].columns:
        said += (
            "; no effort was recorded, so the dataset says that nothing drives the motion (free):"
            " name the goals with "
        )
        said += "--command-topic, or add the channel that drives it"
    if doubtful := _sliding(names, runs):
        said += (
            f"; {', '.join(doubtful)} may slide, in m, or turn, which ROS does not say: kept as"
            " auxiliary, unit 1"
        )
    for name in doubtful:
        number = names.index(name) + 1
        roles |= {_channel(quantity, number - 1): ("auxiliary", "1") for quantity in _ROLES}
        del joints[f"q{number}"]
    kind_words = "rosbag2" if kind == "rosbag" else "mcap"
    return save_runs(runs, out, kind_words, roles, overwrite=overwrite, joints=joints, notes=[said])


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
    found = [
        name
        for j, name in enumerate(names)
        if all(f"q{j + 1}" in r.columns and _finger(name, r.columns[f"q{j + 1}"]) for r in runs)
    ]
    return found if len(found) < len(names) else []


def _channel(quantity: str, joint: int) -> str:
    base, _, tail = quantity.partition("_")
    return f"{base}{joint + 1}" + (f"_{tail}" if tail else "")


# ---- which topic


def _topic(recording: RosRecording, asked: str | None) -> str:
    """The topic of the states, or a refusal that lists those there are."""
    listed = _list(recording)
    if asked is not None:
        if asked not in recording.topics:
            raise refused(
                recording.path,
                f"there is no topic {asked!r}{nearest(asked, recording.topics)}",
                f"Topics: {listed}",
            )
        if recording.topics[asked][0] not in STATES:
            message = (
                f"topic {asked!r} holds {recording.topics[asked][0]}, which is no state of joints"
            )
            raise refused(
                recording.path, message, f"Name one of {', '.join(STATES)}; topics: {listed}"
            )
        return asked
    for kinds in (("JointState", "LowState"), STATES):
        found = [n for n, (kind, count) in recording.topics.items() if kind in kinds and count]
        if len(found) == 1:
            return found[0]
        if found:
            message = (
                f"{len(found)} topics hold states of joints, and they are not mixed: "
                + ", ".join(
                    f"{n} ({recording.topics[n][1]} messages:"
                    f" {', '.join(_joints_of(recording, n))})"
                    for n in found
                )
            )
            goals = [n for n in found if any(word in n for word in _GOALS)]
            own = next((n for n in found if n not in goals), found[0])
            other = next((n for n in [*goals, *found] if n != own), own)
            raise refused(
                recording.path,
                message,
                f"Choose one: --topic {own} (and --command-topic {other} if those are its goals)",
            )
    there = f"there are no joint states in it (topics: {listed or 'none'})"
    raise refused(recording.path, there, "Record a topic of sensor_msgs/JointState")


def _list(recording: RosRecording) -> str:
    return ", ".join(
        f"{n} ({kind}, {count})" for n, (kind, count) in list(recording.topics.items())[:30]
    )


def _joints_of(recording: RosRecording, topic: str) -> list[str]:
    first = next(recording.read(topic), None)
    return [] if first is None else list(_joint_values(recording.topics[topic][0], first)[0])[:12]


# ---- states


def _joint_values(kind: str, m: Message) -> tuple[list[str], Mapping[str, Sequence[float]]]:
    """Names of a message's joints and what it says of them: q, qd, tau, kp, kd; empty lists where
    it says nothing.
    """
    if kind in ("LowState", "LowCmd"):
        motors = m.get("motor_state" if kind == "LowState" else "motor_cmd")
        names = (
            {"q": "q", "qd": "dq", "tau": "tau_est"}
            if kind == "LowState"
            else {"q": "q", "qd": "dq", "tau": "tau", "kp": "kp", "kd": "kd"}
        )

        def of(motor, key):
            return motor[key] if isinstance(motor, dict) else getattr(motor, key)

        values = {
            ours: [float(of(motor, theirs)) for motor in motors] for ours, theirs in names.items()
        }
        return (
            [*_QUADRUPED, *(f"motor_{k}" for k in range(12, len(motors)))]
            if len(motors) == 20
            else [f"motor_{k}" for k in range(len(motors))]
        ), values
    if kind == "JointTrajectoryControllerState":
        point = m.get("feedback") or m.get("actual")

        def part(key):
            return (
                (point.get(key) if isinstance(point, dict) else getattr(point, key, None))
                if point is not None
                else None
            )

        return list(m.get("joint_names")), {
            "q": _list_of(part("positions")),
            "qd": _list_of(part("velocities")),
            "tau": _list_of(part("effort")),
        }
    return list(m.get("name")), {
        "q": _list_of(m.get("position")),
        "qd": _list_of(m.get("velocity")),
        "tau": _list_of(m.get("effort")),
    }


def _list_of(values: Any) -> Sequence[float]:
    return [] if values is None else values


def _states(recording: RosRecording, topic: str, notes: list[str]) -> JointRows:
    """The joints that stand together in one message; several publishers on the topic are told apart
    by their joints.
    """
    kind = recording.topics[topic][0]
    rows = sorted(
        ((m.t, *_joint_values(kind, m)) for m in recording.read(topic)), key=lambda r: r[0]
    )
    if not rows:
        raise refused(recording.path, f"topic {topic!r} is empty", "Record again")
    sets = Counter(frozenset(names) for _, names, _ in rows)
    # A driver may leave joints out at times: what is a part of a larger set belongs to it.
    largest = max(sets, key=lambda s: (sets[s] >= 20, len(s), sets[s]))
    own = [r for r in rows if frozenset(r[1]) == largest]
    for other, count in sets.items():
        if other == largest:
            continue
        if other < largest:
            notes.append(
                f"{recording.path.stem}: {count} messages with only some of the joints were"
                " left out"
            )
        else:
            left = ", ".join(sorted(other)[:8])
            notes.append(
                f"{recording.path.stem}: {topic} has another publisher, of {left} ({count}"
                " messages); it was left out"
            )
    names = own[0][1]
    repeated = [n for n in names if names.count(n) > 1]
    if repeated:
        raise refused(
            recording.path,
            f"joint {repeated[0]!r} stands twice in a message of {topic}",
            "Record again",
        )
    values: dict[str, np.ndarray] = {}
    for quantity in ("q", "qd", "tau"):
        if all(len(r[2][quantity]) == len(r[1]) for r in own):
            values[quantity] = np.array(
                [[r[2][quantity][r[1].index(n)] for n in names] for r in own], float
            )
        elif any(len(r[2][quantity]) for r in own):
            notes.append(
                f"{recording.path.stem}: {quantity} stands in some messages only and was left out"
            )
    for quantity in ("qd", "tau"):
        if quantity in values and not values[quantity].any():
            notes.append(
                f"{recording.path.stem}: {quantity} is 0 throughout, so it was not measured, and"
                " was left out"
            )
            del values[quantity]
    if kind == "LowState":
        moved = [j for j in range(len(names)) if any(v[:, j].any() for v in values.values())]
        names, values = [names[j] for j in moved], {k: v[:, moved] for k, v in values.items()}
    if "q" not in values:
        raise refused(
            recording.path, f"topic {topic!r} holds no positions", "Name another with --topic"
        )
    _one_publisher(recording, topic, np.array([r[0] for r in own]), values["q"])
    return JointRows(np.array([r[0] for r in own]), tuple(names), values)


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


# ---- commands


def _commands(
    recording: RosRecording, asked: str, joints: Sequence[str], stated: Sequence[str]
) -> JointRows:
    """The goals of a topic, at the times when they were given."""
    topic, _, quantity = asked.partition(":") if asked not in recording.topics else (asked, "", "")
    if topic not in recording.topics or recording.topics[topic][0] not in COMMANDS:
        found = [n for n, (kind, _) in recording.topics.items() if kind in COMMANDS]
        what = (
            f"holds {recording.topics[topic][0]}, which is no command"
            if topic in recording.topics
            else "is not there"
        )
        remedy = f"Name one of: {', '.join(found) or 'none is there'}"
        raise refused(
            recording.path, f"topic {topic!r} {what} (topics: {_list(recording)})", remedy
        )
    kind = recording.topics[topic][0]
    messages = sorted(recording.read(topic), key=lambda m: m.t)
    if not messages:
        raise refused(recording.path, f"topic {topic!r} is empty", "Name another")
    if kind == "Float64MultiArray":
        return _plain_commands(recording, topic, quantity, messages, joints, stated)
    if kind == "JointTrajectory":
        return _points(messages, joints, recording, topic)
    rows = []
    for m in messages:
        names, values = (
            _joint_values(kind, m) if kind != "JointTrajectoryControllerState" else _reference(m)
        )
        if set(joints) <= set(names):
            rows.append(
                (
                    m.t,
                    {
                        k: [v[names.index(j)] for j in joints]
                        for k, v in values.items()
                        if len(v) == len(names)
                    },
                )
            )
    if not rows:
        message = f"topic {topic!r} commands other joints than {', '.join(joints)}"
        raise refused(recording.path, message, "Name the topic of this robot's commands")
    kept = [k for k in rows[0][1] if all(k in r[1] for r in rows)]
    if kind == "JointState":
        kept = [k for k in kept if k == "q" or any(np.any(r[1][k]) for r in rows)]
    return JointRows(
        np.array([r[0] for r in rows]),
        tuple(joints),
        {f"{k}_cmd": np.array([r[1][k] for r in rows], float) for k in kept},
    )


def _reference(m: Message) -> tuple[list[str], dict[str, Sequence[float]]]:
    point = m.get("reference") or m.get("desired")

    def part(key):
        return _list_of(point.get(key) if isinstance(point, dict) else getattr(point, key, None))

    return list(m.get("joint_names")), {"q": part("positions"), "qd": part("velocities")}


def _plain_commands(
    recording: RosRecording,
    topic: str,
    quantity: str,
    messages: list[Message],
    joints: Sequence[str],
    stated: Sequence[str],
) -> JointRows:
    """Numbers without names: what they are and whose has to be said."""
    quantity = quantity or next((q for q in _QUANTITIES if q in topic), "")
    if quantity not in _QUANTITIES:
        message = f"{topic} holds numbers, and its name does not say of what"
        raise refused(
            recording.path,
            message,
            f"Write --command-topic {topic}:position (or :velocity, :effort)",
        )
    width = len(messages[0].get("data"))
    if set(stated) != set(joints) or len(stated) != width:
        message = (
            f"{topic} holds {width} numbers a message without names of joints; the states are of"
            f" {', '.join(joints)}"
        )
        remedy = f"State the controller's own order: --command-joints {','.join(joints)}"
        raise refused(recording.path, message, remedy)
    order = [list(stated).index(j) for j in joints]
    whole = [m for m in messages if len(m.get("data")) == width]
    values = np.array([list(m.get("data")) for m in whole], float)[:, order]
    return JointRows(
        np.array([m.t for m in whole]), tuple(joints), {f"{_QUANTITIES[quantity]}_cmd": values}
    )


def _points(
    messages: list[Message], joints: Sequence[str], recording: RosRecording, topic: str
) -> JointRows:
    """The points of trajectories at their times: a point is the goal from when it is due."""
    rows = []

    def of(thing, key):
        return thing[key] if isinstance(thing, dict) else getattr(thing, key)

    for m in messages:
        names = list(m.get("joint_names"))
        if not set(joints) <= set(names):
            continue
        for point in m.get("points"):
            due = of(point, "time_from_start")
            t = m.t + float(of(due, "sec")) + 1e-9 * float(of(due, "nanosec"))
            positions = of(point, "positions")
            rows.append((t, [positions[names.index(j)] for j in joints]))
    if not rows:
        raise refused(
            recording.path,
            f"topic {topic!r} commands other joints than {', '.join(joints)}",
            "Name another topic",
        )
    rows.sort(key=lambda r: r[0])
    return JointRows(
        np.array([r[0] for r in rows]),
        tuple(joints),
        {"q_cmd": np.array([r[1] for r in rows], float)},
    )


def _with_commands(
    t: np.ndarray,
    columns: dict[str, np.ndarray],
    commands: JointRows,
    names: Sequence[str],
    topic: str,
    notes: list[str],
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The last command at the time of each state; what was before the first one is left out."""
    inside = t >= commands.t[0]
    if inside.sum() < 2:
        raise UsageError(
            f"--command-topic {topic}: its first command came {commands.t[0] - t[-1]:.3g} s after"
            " the last state"
        )
    if not inside.all():
        notes.append(
            f"{int(np.sum(~inside))} samples before the first command of {topic} were left out"
        )
    late = t[inside] - commands.t[np.searchsorted(commands.t, t[inside], side="right") - 1]
    notes.append(
        f"{topic}: the last command at each sample, {1e3 * float(np.median(late)):.3g} ms old in"
        " the median"
    )
    taken = {k: held(t[inside], commands.t, v) for k, v in commands.values.items()}
    return t[inside], {k: v[inside] for k, v in columns.items()} | taken
