"""Commands from a topic of ROS, and the states at whose times they hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.importers.ros_files import COMMANDS, Message, RosRecording
from jaxid.data.importers.ros_messages import (
    field_of,
    joint_values,
    JointRows,
    StateRow,
    topics_listed,
    values_of,
)
from jaxid.data.importers.runs import held, refused


_QUANTITIES = {"position": "q", "velocity": "qd", "effort": "tau"}


def commands_of(
    recording: RosRecording, asked: str, joints: Sequence[str], stated: Sequence[str]
) -> JointRows:
    """The goals of a topic, at the times when they were given."""
    topic, quantity = asked, ""
    if asked not in recording.topics:
        topic, _, quantity = asked.partition(":")
    kind = _kind_of_commands(recording, topic)
    messages = sorted(recording.read(topic), key=lambda m: m.t)
    if not messages:
        raise refused(recording.path, f"topic {topic!r} is empty", "Name another")
    if kind == "Float64MultiArray":
        return _plain_commands(recording, topic, quantity, messages, joints, stated)
    if kind == "JointTrajectory":
        return _points(messages, joints, recording, topic)
    rows = []
    for m in messages:
        if kind == "JointTrajectoryControllerState":
            row = StateRow(m.t, *_reference(m))
        else:
            row = StateRow(m.t, *joint_values(kind, m))
        if set(joints) <= set(row.joints):
            rows.append(row)
    if not rows:
        message = f"topic {topic!r} commands other joints than {', '.join(joints)}"
        raise refused(recording.path, message, "Name the topic of this robot's commands")
    values = {f"{key}_cmd": commanded for key, commanded in _commanded(rows, joints).items()}
    if kind == "JointState":  # what it leaves at 0 beside the positions is not commanded
        values = {key: v for key, v in values.items() if key == "q_cmd" or v.any()}
    return JointRows(np.array([row.t for row in rows]), tuple(joints), values)


def _commanded(rows: Sequence[StateRow], joints: Sequence[str]) -> dict[str, np.ndarray]:
    """Quantity -> `[time joints]`, of those that every message has for each joint."""
    values = {}
    for key in rows[0].values:
        if all(len(row.values.get(key, ())) == len(row.joints) for row in rows):
            values[key] = np.array([row.of(key, joints) for row in rows], float)
    return values


def _kind_of_commands(recording: RosRecording, topic: str) -> str:
    """What a topic of commands holds, or a refusal that lists those there are."""
    if topic not in recording.topics:
        what = "is not there"
    elif recording.topics[topic][0] not in COMMANDS:
        what = f"holds {recording.topics[topic][0]}, which is not a command"
    else:
        return recording.topics[topic][0]
    found = [n for n, (kind, _) in recording.topics.items() if kind in COMMANDS]
    raise refused(
        recording.path,
        f"topic {topic!r} {what} (topics: {topics_listed(recording)})",
        f"Name one of: {', '.join(found) or 'none is there'}",
    )


def _reference(m: Message) -> tuple[list[str], dict[str, Sequence[float]]]:
    point = m.get("reference") or m.get("desired")
    return list(m.get("joint_names")), {
        "q": values_of(field_of(point, "positions")),
        "qd": values_of(field_of(point, "velocities")),
    }


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
    for m in messages:
        names = list(m.get("joint_names"))
        if not set(joints) <= set(names):
            continue
        for point in m.get("points"):
            due = field_of(point, "time_from_start")
            t = m.t + float(field_of(due, "sec")) + 1e-9 * float(field_of(due, "nanosec"))
            positions = field_of(point, "positions")
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


def with_commands(
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
