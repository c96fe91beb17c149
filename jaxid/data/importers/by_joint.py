"""Columns that are named after the joints of a robot: which of them is which channel."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from jaxid.data.importers.channels import named_once, Proposed
from jaxid.data.importers.quantities import meaning_of
from jaxid.data.patterns import captures_of


#: What is recorded of a joint, (quantity, whether it is a goal): the end of its channel's name.
_ENDS = {
    ("position", False): "",
    ("position", True): "_cmd",
    ("velocity", False): "_qd",
    ("torque", False): "_tau",
    ("force", False): "_tau",
}


def channels_by_joint(
    proposed: Sequence[Proposed],
    columns: Sequence[str],
    units: Mapping[str, str],
    joints: Mapping[str, bool],
) -> list[Proposed]:
    """The channels with those of a robot's `joints` (name: whether it slides) under their names.
    Torques drive where they were recorded, else goals. Without a column of a joint's position
    `proposed` as it is.
    """
    found: dict[str, Proposed] = {}
    for column in columns:
        channel = _of_a_joint(column, units.get(column, ""), joints)
        if channel is not None and channel.name not in {c.name for c in found.values()}:
            found[column] = channel
    if not any(c.name in joints for c in found.values()):
        return list(proposed)
    torques = any(c.name.endswith("_tau") for c in found.values())
    drive = "_tau" if torques else "_cmd"
    own = [_with_role(c, joints, drive) for c in found.values()]
    for channel in proposed:
        matched = captures_of(channel.column, columns) or {}
        taken = list(matched.values()) or [channel.column]
        left = [column for column in taken if column not in found]
        if len(left) == len(taken):
            own.append(_beside(channel))
    return named_once(own)


def _of_a_joint(column: str, unit: str, joints: Mapping[str, bool]) -> Proposed | None:
    """The channel of a column that begins or ends with a joint's name, the longest of them."""
    for joint in sorted(joints, key=len, reverse=True):
        name = re.escape(joint)
        rest = re.fullmatch(f"{name}(?![A-Za-z0-9])(.*)|(.*)(?<![A-Za-z0-9]){name}", column)
        if rest is None:
            continue
        words = rest[1] or rest[2] or ""
        meaning = meaning_of(words, unit)
        bare = not words or (meaning.goal and not meaning.quantity)
        kind = ("position" if bare or not meaning.quantity else meaning.quantity, meaning.goal)
        told = bare or meaning.quantity
        if not told or kind not in _ENDS:
            return None
        alike = f"{'slide' if joints[joint] else 'joint'}: {kind[0]}"
        return Proposed(f"{joint}{_ENDS[kind]}", column, meaning.unit, "auxiliary", kind[0], alike)
    return None


def _with_role(channel: Proposed, joints: Mapping[str, bool], drive: str) -> Proposed:
    if channel.name in joints:
        return replace(channel, role="output")
    if channel.name.endswith(drive):
        return replace(channel, role="input")
    return channel


def _beside(channel: Proposed) -> Proposed:
    """What is of no joint stays as it was recorded, beside the robot's own channels."""
    return replace(channel, role="auxiliary")
