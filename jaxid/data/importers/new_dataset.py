"""A dataset folder from files of a recording, with what is recognised: `jaxid new`."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from jaxid.base.errors import nearest, UsageError
from jaxid.base.wording import names_of
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
    ask: Ask | None = None,
    overwrite: bool = False,
) -> Imported:
    """The files as a dataset folder, with time and channels as they are recognised. `units` and
    `roles` (by channel or by column) come before what is recognised. `ask` is asked for the units
    of inputs and outputs that no file states; without it they have to be in `units`.

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
    channels = _with_roles(found.channels, roles or {})
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
    found, unknown = [], []
    for channel in channels:
        unit = units.get(channel.name, units.get(channel.column, channel.unit))
        if not unit and channel.role != "auxiliary":
            if ask is None:
                unknown.append(channel)
            else:
                unit = ask(channel)
        found.append(replace(channel, unit=unit))
    if unknown:
        listed = ", ".join(f"{channel.column} ({channel.role})" for channel in unknown)
        options = " ".join(f"--unit {channel.name}=UNIT" for channel in unknown)
        raise UsageError(f"no file states the unit of {listed}: type {options}, such as rad or N m")
    return found


def _known(channels: Sequence[Proposed], said: Mapping[str, str]) -> None:
    """Raises `UsageError` for a name that is neither a channel's nor a column's."""
    names = [*(names_of(channels)), *(c.column for c in channels)]
    for name in said:
        if name not in names:
            listed = ", ".join(f"{c.name} (column {c.column})" for c in channels)
            raise UsageError(f"there is no channel {name!r}{nearest(name, names)}: {listed}")
