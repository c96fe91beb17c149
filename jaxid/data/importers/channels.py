"""Which channels the columns of a file could be: names by convention, joints by number, roles. A
proposal to correct.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from jaxid.data.importers.quantities import Meaning, meaning_of
from jaxid.data.patterns import captures_of
from jaxid.data.units import conversion, UnitError


#: What drives the motion, the first of these that was recorded; (quantity, whether it is a goal).
_DRIVES = (
    ("torque", False),
    ("force", False),
    ("torque", True),
    ("force", True),
    ("current", False),
    ("current", True),
    ("voltage", False),
    ("voltage", True),
    ("position", True),
    ("velocity", True),
)
_NAMES = {
    "position": "q",
    "velocity": "qd",
    "acceleration": "qdd",
    "torque": "tau",
    "force": "force",
    "current": "current",
    "voltage": "voltage",
    "temperature": "temperature",
}
_LINEAR = {"position": "position", "velocity": "velocity", "acceleration": "acceleration"}


@dataclass(frozen=True)
class Proposed:
    """One channel: what is written behind `--channel`, in parts; `unit` is empty where nothing
    states it. Channels of one `alike` have one unit, where a person says it.
    """

    name: str
    column: str
    unit: str
    role: str
    quantity: str
    alike: str = ""

    def __str__(self) -> str:
        return f"{self.name}={self.column}:{self.unit or '1'}:{self.role}"


def channels_of(
    columns: Sequence[str], units: Mapping[str, str], everything: Sequence[str]
) -> list[Proposed]:
    """A channel for every one of `columns`, those of several joints together as one pattern.

    `everything` are all names that a pattern would match. Some channel is an output, for a dataset
    needs one.
    """
    groups: dict[tuple[str, bool], list[str]] = {}
    meanings = {c: meaning_of(re.sub(r"(\[\d+\])+$", "", c), units.get(c, "")) for c in columns}
    for column in columns:
        meaning = meanings[column]
        groups.setdefault((meaning.quantity, meaning.goal), []).append(column)
    nameless = ("", True)  # `setpoint`, `action`: the goal of what is measured
    if nameless in groups and ("position", False) in groups and ("position", True) not in groups:
        groups["position", True] = goals = groups.pop(nameless)
        meanings |= {c: replace(meanings[c], quantity="position") for c in goals}
    drive = next((kind for kind in _DRIVES if kind in groups), None)
    measured = [kind for kind in (("position", False), ("velocity", False)) if kind in groups]
    roles = {drive: "input"} | dict.fromkeys(measured[:1], "output")
    found: list[Proposed] = []
    for kind, members in groups.items():
        role = roles.get(kind, "auxiliary")
        found += _of_group(members, meanings, role, everything)
    if found and not measured:
        place = next((k for k, c in enumerate(found) if not c.quantity), 0)
        found[place] = replace(found[place], role="output")
    order = {c: k for k, c in enumerate(columns)}
    found.sort(key=lambda c: order.get(c.column, order.get(c.column.replace("*", "0"), 0)))
    return named_once(found)


def _of_group(
    members: Sequence[str], meanings: Mapping[str, Meaning], role: str, everything: Sequence[str]
) -> list[Proposed]:
    """Columns of one quantity: one by its name, several as a pattern, or else numbered."""
    meaning = meanings[members[0]]
    if not meaning.quantity:
        return _nameless(members, meanings, role, everything)
    base, tail = _base(meaning), "_cmd" if meaning.goal else ""
    if len(members) == 1:
        return [Proposed(f"{base}{tail}", members[0], meaning.unit, role, meaning.quantity)]
    pattern = _pattern(members)
    stem = _NAMES[meaning.quantity]
    one_unit = len({meanings[c].unit for c in members}) == 1
    if one_unit and _matched(pattern, everything) == list(members):
        return [Proposed(f"{stem}*{tail}", pattern, meaning.unit, role, meaning.quantity)]
    return [
        Proposed(f"{stem}{k}{tail}", c, meanings[c].unit, role, meaning.quantity)
        for k, c in enumerate(members, 1)
    ]


def _nameless(
    members: Sequence[str], meanings: Mapping[str, Meaning], role: str, everything: Sequence[str]
) -> list[Proposed]:
    """Columns of no known quantity: each by its own name, those of a list as a pattern."""
    families: dict[str, list[str]] = {}
    for column in members:
        indices = re.findall(r"\[\d+\]", column)
        family = column
        if len(indices) == 1:
            family = column.replace(indices[0], "[*]")
        families.setdefault(family, []).append(column)
    found = []
    for family, columns in families.items():
        whole = _matched(family, everything) == columns
        units = {meanings[c].unit for c in columns}
        if role == "auxiliary" and len(columns) > 1 and whole and len(units) == 1:
            name = f"{_plain(family)}*"
            found.append(Proposed(name, family, units.pop(), role, ""))
            continue
        found += [Proposed(_plain(c), c, meanings[c].unit, role, "") for c in columns]
    return found


def _matched(pattern: str, names: Sequence[str]) -> list[str]:
    """The names that match a pattern with one `*`; none for any other."""
    return list((captures_of(pattern, names) or {}).values())


def _base(meaning: Meaning) -> str:
    """The first part of a channel's name, by quantity and unit."""
    try:
        si = conversion(meaning.unit).si if meaning.unit else ""
    except UnitError:
        si = ""
    linear = _LINEAR if si.startswith("m") else {}
    return linear.get(meaning.quantity, _NAMES[meaning.quantity])


def _pattern(names: Sequence[str]) -> str:
    """The names with `*` where they differ, cut at the ends of words; empty where nothing is in
    common.
    """
    start = os.path.commonprefix(list(names))
    end = os.path.commonprefix([n[len(start) :][::-1] for n in names])[::-1]
    middles = [n[len(start) : len(n) - len(end)] for n in names]
    if not all(m.isdigit() for m in middles):
        start = re.sub(r"[A-Za-z0-9]+$", "", start)
        end = re.sub(r"^[A-Za-z0-9]+", "", end) if not re.match(r"[A-Z]", end) else end
    elif start[-1:].isdigit() or end[:1].isdigit():
        start, end = start.rstrip("0123456789"), end.lstrip("0123456789")
    return f"{start}*{end}" if start or end else ""


def _plain(column: str) -> str:
    """A column's name as that of a channel."""
    word = re.sub(r"\W+", "_", re.split(r"[./](?=[^./]+$)", column)[-1], flags=re.ASCII).strip("_")
    return word if re.match(r"[A-Za-z]", word) else f"channel_{word}"


def named_once(found: Sequence[Proposed]) -> list[Proposed]:
    """Names that stand there twice are numbered."""
    out: list[Proposed] = []
    taken = {"t"}
    for one in found:
        name, count = one.name, 1
        while name in taken:
            count += 1
            name = f"{one.name}_{count}"
        taken.add(name)
        out.append(replace(one, name=name))
    return out
