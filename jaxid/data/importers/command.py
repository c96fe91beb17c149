"""The command that says what was recognised, with every option that was given."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jaxid.data.importers.joining import Clock
from jaxid.data.importers.source import find_column, parts_of, series_of, Source, stated_rate
from jaxid.data.importers.text import StatedFormat
from jaxid.data.time_axis import PER_SECOND


@dataclass(frozen=True)
class ImportRequest:
    """What an import of tables was asked for, beside its channels."""

    sources: Sequence[Source]
    joined: Sequence[Source]
    stated: StatedFormat
    rows: tuple[int, int] | None
    rate: float | None
    out: Any
    overwrite: bool


def command_with(
    asked: ImportRequest, form: str, channels: Sequence[str], rate: float | None
) -> str:
    """`jaxid import …` of these files with `form`, the options of how the text is written, and
    `channels`.
    """
    parts = [
        f"jaxid import {asked.sources[0].kind}",
        *(shlex.quote(str(s.path)) for s in asked.sources),
        form,
    ]
    parts += [f"--join {shlex.quote(str(s.path))}" for s in asked.joined]
    parts += [f"--rows {asked.rows[0]}:{asked.rows[1]}"] if asked.rows is not None else []
    parts += [f"--rate {rate:.12g}"] if rate is not None else []
    parts += [f"--channel {shlex.quote(c)}" for c in channels]
    parts += [f"--out {shlex.quote(str(asked.out))}"]
    parts += ["--overwrite"] if asked.overwrite else []
    return " ".join(filter(None, parts))


def full_command(asked: ImportRequest, clock: Clock, channels: Sequence[str]) -> str:
    """The command with what was recognised: the form of the text, and the unit of the time or the
    rate that made it.
    """
    source = asked.sources[0]
    form = source.options
    if not clock.column or not has_column(source, clock.column):
        stated = stated_rate(parts_of(source)[0])
        rate = asked.rate if asked.rate is not None or stated is None else stated[1]
        return command_with(asked, form, channels, rate)
    unit = clock.unit or time_unit(source, clock.column)
    time = f"t={clock.column}:{unit}" if unit else f"t={clock.column}"
    return command_with(asked, form, [time, *channels], None)


def has_column(source: Source, column: str) -> bool:
    part = parts_of(source)[0]
    return find_column(part, series_of(part.columns, None), column) is not None


def time_unit(source: Source, column: str) -> str | None:
    """The unit of the times that the file itself states."""
    part = parts_of(source)[0]
    name = find_column(part, series_of(part.columns, None), column)
    unit = part.units.get(name) if name is not None else None
    return unit if unit in PER_SECOND else None
