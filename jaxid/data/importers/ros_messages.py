"""What one message of ROS says of joints, whatever its type."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from jaxid.data.importers.ros_files import Message, RosRecording


_LEGS = ("FR", "FL", "RR", "RL")
#: Order of the motors in Unitree's messages for quadrupeds, as its SDK has it.
_QUADRUPED = tuple(
    f"{leg}_{joint}_joint" for leg, joint in product(_LEGS, ("hip", "thigh", "calf"))
)


@dataclass(frozen=True)
class JointRows:
    """Values of joints over time: `t [time]`, the joints' names, quantity (q, qd, tau …) -> [time
    joints].
    """

    t: np.ndarray
    joints: tuple[str, ...]
    values: dict[str, np.ndarray]


@dataclass(frozen=True)
class StateRow:
    """One message: its time in s, its joints, quantity -> a value for each joint, or none."""

    t: float
    joints: list[str]
    values: Mapping[str, Sequence[float]]

    def of(self, quantity: str, joints: Sequence[str]) -> list[float]:
        """The values of a quantity in the order of `joints`."""
        return [self.values[quantity][self.joints.index(joint)] for joint in joints]


def topics_listed(recording: RosRecording) -> str:
    return ", ".join(
        f"{n} ({kind}, {count})" for n, (kind, count) in list(recording.topics.items())[:30]
    )


def joint_values(kind: str, m: Message) -> tuple[list[str], Mapping[str, Sequence[float]]]:
    """Names of a message's joints and what it says of them: q, qd, tau, kp, kd; empty lists where
    it says nothing.
    """
    if kind == "LowState":
        return _motor_values(m.get("motor_state"), {"q": "q", "qd": "dq", "tau": "tau_est"})
    if kind == "LowCmd":
        theirs = {"q": "q", "qd": "dq", "tau": "tau", "kp": "kp", "kd": "kd"}
        return _motor_values(m.get("motor_cmd"), theirs)
    if kind == "JointTrajectoryControllerState":
        point = m.get("feedback") or m.get("actual")
        return list(m.get("joint_names")), {
            "q": values_of(field_of(point, "positions")),
            "qd": values_of(field_of(point, "velocities")),
            "tau": values_of(field_of(point, "effort")),
        }
    if kind == "DynamicJointState":
        return _interfaces(m.get("joint_names"), m.get("interface_values"))
    return list(m.get("name")), {
        "q": values_of(m.get("position")),
        "qd": values_of(m.get("velocity")),
        "tau": values_of(m.get("effort")),
    }


#: Interfaces of ros2_control -> quantity.
_INTERFACES = {"position": "q", "velocity": "qd", "effort": "tau"}


def _interfaces(
    names: Sequence[str], values: Sequence[Any]
) -> tuple[list[str], dict[str, list[float]]]:
    """Joints with a position among what ros2_control reports, which holds sensors and pins too; a
    quantity that some joint lacks is left out.
    """
    rows: dict[str, dict[str, float]] = {}
    for name, value in zip(names, values, strict=True):
        told = dict(zip(field_of(value, "interface_names"), field_of(value, "values"), strict=True))
        if "position" in told:
            rows[name] = {q: float(told[key]) for key, q in _INTERFACES.items() if key in told}
    measured: dict[str, list[float]] = {}
    for quantity in _INTERFACES.values():
        everywhere = all(quantity in row for row in rows.values())
        measured[quantity] = [row[quantity] for row in rows.values()] if everywhere else []
    return list(rows), measured


def _motor_values(
    motors: Sequence[Any], names: Mapping[str, str]
) -> tuple[list[str], dict[str, list[float]]]:
    """Unitree's motors by their joints; `names`: quantity -> its name in the message."""
    joints = [f"motor_{k}" for k in range(len(motors))]
    if len(motors) == 20:
        joints[: len(_QUADRUPED)] = _QUADRUPED
    values = {}
    for quantity, name in names.items():
        values[quantity] = [float(field_of(motor, name)) for motor in motors]
    return joints, values


def field_of(record: Any, name: str) -> Any:
    """A field of a part of a message, which the readers give as a dict or as an object."""
    if isinstance(record, dict):
        return record.get(name)
    return getattr(record, name, None)


def values_of(values: Any) -> Sequence[float]:
    return [] if values is None else values
