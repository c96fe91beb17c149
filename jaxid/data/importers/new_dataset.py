"""A dataset folder from files of a recording, with what is recognised: `jaxid new`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from jaxid.base.errors import nearest, UsageError
from jaxid.base.wording import names_of
from jaxid.data.importers.by_joint import channels_by_joint
from jaxid.data.importers.channels import Proposed
from jaxid.data.importers.command import ImportRequest
from jaxid.data.importers.joining import joined_files
from jaxid.data.importers.map import import_table, Imported
from jaxid.data.importers.propose import recognised
from jaxid.data.importers.source import read_source
from jaxid.data.importers.text import StatedFormat


ROLES = ("input", "output", "auxiliary")
#: Asks a person for the unit of a channel.
Ask = Callable[[Proposed], str]


def new_dataset(
    files: Sequence[Path],
    out: str | os.PathLike[str],
    *,
    join: Sequence[Path] = (),
    rate: float | None = None,
    units: Mapping[str, str] | None = None,
    roles: Mapping[str, str] | None = None,
    joints: Mapping[str, bool] | None = None,
    ask: Ask | None = None,
    overwrite: bool = False,
) -> Imported:
    """The files as a dataset folder, with time and channels as they are recognised; those of a
    robot's `joints` (name: whether it slides) by their names. `units` and `roles` (by channel or by
    column) come before what is recognised. `ask` is asked for the units of inputs and outputs that
    no file states, once for the joints' positions; without it they have to be in `units`.

    Raises `UsageError` that says what was recognised and what to type.
    """
    stated = StatedFormat()
    sources = [read_source(path, stated) for path in files]
    joined = joined_files([read_source(path, stated) for path in join])
    asked = ImportRequest(sources, [j.source for j in joined], stated, None, rate, out, overwrite)
    found = recognised(asked)
    if found.no_time:
        listed = ", ".join(found.columns)
        raise UsageError(
            f"{sources[0].path.name} holds no column of times ({listed}): type --rate HZ"
        )
    channels = channels_by_joint(found.channels, found.columns, found.units, joints or {})
    channels = _with_roles(channels, roles or {})
    channels = _with_units(channels, units or {}, ask)
    said = [str(channel) for channel in channels]
    if found.time is not None:
        said.insert(0, found.time)
    return import_table(files, out, channels=said, join=join, rate=rate, overwrite=overwrite)


def _with_roles(channels: Sequence[Proposed], roles: Mapping[str, str]) -> list[Proposed]:
    _known(channels, roles)
    found = []
    for channel in channels:
        role = roles.get(channel.name, roles.get(channel.column, channel.role))
        if role not in ROLES:
            raise UsageError(f"{role!r} is not a role of {channel.name}{nearest(role, ROLES)}")
        found.append(replace(channel, role=role))
    return found


def _with_units(
    channels: Sequence[Proposed], units: Mapping[str, str], ask: Ask | None
) -> list[Proposed]:
    _known(channels, units)
    said = _said_of_one(channels, units)
    found: list[Proposed] = []
    unknown: dict[str, Proposed] = {}
    for channel in channels:
        unit = units.get(channel.name, units.get(channel.column, channel.unit))
        kind = channel.alike or channel.name
        unit = unit or said.get(kind, "")
        if not unit and channel.role != "auxiliary":
            if ask is None:
                unknown.setdefault(kind, channel)
            else:
                unit = said[kind] = ask(channel)
        found.append(replace(channel, unit=unit))
    if unknown:
        raise UsageError(_lacking(unknown.values()))
    return found


def _said_of_one(channels: Sequence[Proposed], units: Mapping[str, str]) -> dict[str, str]:
    """Units that a person said of one of several channels that are alike."""
    said: dict[str, str] = {}
    for channel in channels:
        unit = units.get(channel.name, units.get(channel.column))
        if unit and channel.alike:
            said.setdefault(channel.alike, unit)
    return said


def _lacking(unknown: Iterable[Proposed]) -> str:
    """What to type for the units that no file states, of several alike for the first."""
    names, options, more = [], [], ""
    for channel in unknown:
        names.append(f"{channel.column} ({channel.role})")
        options.append(f"--unit {channel.name}=UNIT")
        if channel.alike:
            more = "; of several joints one stands for all"
    typed = " ".join(options)
    return f"no file states the unit of {', '.join(names)}: type {typed}, such as rad or N m{more}"


def _known(channels: Sequence[Proposed], said: Mapping[str, str]) -> None:
    """Raises `UsageError` for a name that is neither a channel's nor a column's."""
    names = [*(names_of(channels)), *(c.column for c in channels)]
    for name in said:
        if name not in names:
            listed = ", ".join(f"{c.name} (column {c.column})" for c in channels)
            raise UsageError(f"there is no channel {name!r}{nearest(name, names)}: {listed}")
