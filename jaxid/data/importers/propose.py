"""What a file holds, and the command that would take it: said where no channels were."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxid.data.importers.arrays import Arrays
from jaxid.data.importers.channels import channels_of, Proposed
from jaxid.data.importers.command import command_with, ImportRequest
from jaxid.data.importers.joining import Joined, joined_files, names_once
from jaxid.data.importers.source import (
    parts_of,
    series_of,
    Source,
    stated_rate,
    TIME,
)
from jaxid.data.importers.traces import unit_of
from jaxid.data.registers import found_sign, register_words
from jaxid.data.time_axis import contradicted, impossible, PER_SECOND


_SHOWN = 40  # columns and channels that are listed


@dataclass(frozen=True)
class Recognised:
    """What the files of an import hold. `time`: `t=COLUMN:UNIT`, None where no column is one;
    `columns`: all of them, `own` those of the files themselves that may be channels; `units`: what
    the files state.
    """

    time: str | None
    no_time: bool  # neither a column nor a rate
    channels: list[Proposed]
    columns: list[str]
    own: list[str]
    units: dict[str, str]


def recognised(asked: ImportRequest) -> Recognised:
    """Time and channels, by the names and units of the columns."""
    source = asked.sources[0]
    part = parts_of(source)[0]  # of several recordings, all of which are read by the same names
    series = series_of(part.columns, None)
    joined = joined_files(asked.joined)
    once = names_once(series, joined)
    time = None if asked.rate is not None else _time(part, series)
    clock = _column_of_time(time)
    own = [n for n in series if n != clock and np.size(series[n]) != 1 and _takes(n, series)]
    more, units = _of_joined(joined, series, clock)
    more = [name for name in more if name in once]
    units |= part.units
    return Recognised(
        time=time,
        no_time=time is None and asked.rate is None and stated_rate(part) is None,
        channels=channels_of([*own, *more], units, once),
        columns=[*series_of(source.columns, None), *more],
        own=own,
        units=units,
    )


def proposal(asked: ImportRequest) -> str:
    """The columns of the files, and a command with all channels that they could be, which runs as
    it is printed.
    """
    source = asked.sources[0]
    part = parts_of(source)[0]
    found = recognised(asked)
    said = [str(c) for c in found.channels[:_SHOWN]]
    if found.time is not None:
        said.insert(0, found.time)
    command = command_with(asked, asked.stated.options(), said, asked.rate)
    if found.no_time:
        command = command.replace(" --channel ", " --rate HZ --channel ", 1)
    words = f" ({source.words})" if source.words else ""
    registers = [f"; {n} {register_words(*f)}" for n, f in _registers(part, found.own).items()]
    listed = _listed(found.columns, found.units)
    needs = _needed(part, found.time, found.no_time)
    return (
        f"{source.path.name}{words} holds: {listed}; {needs}: {command}"
        f" ({_remarks(found.channels)}{''.join(registers)})"
    )


def _of_joined(
    joined: Sequence[Joined], series: Mapping[str, Any], clock: str
) -> tuple[list[str], dict[str, str]]:
    """Columns of joined files that may be channels and are not those of the first; all units."""
    names: list[str] = []
    units: dict[str, str] = {}
    for join in joined:
        for name, column in join.names.items():
            if name in series:
                continue
            units[name] = join.source.units.get(column, "")
            if column != clock and _takes(column, join.series):
                names.append(name)
    return names, units


def _column_of_time(time: str | None) -> str:
    """The column of `t=COLUMN:UNIT`, or of `t=COLUMN`; empty where there is no time."""
    if time is None:
        return ""
    column = time.removeprefix("t=")
    return column.rpartition(":")[0] or column


def _listed(names: Sequence[str], units: Mapping[str, str]) -> str:
    """The columns with the units that the file states; of more than are shown, how many, and how to
    see them.
    """
    shown = []
    for name in names[:_SHOWN]:
        unit = units.get(name)
        shown.append(f"{name} ({unit})" if unit else name)
    listed = ", ".join(shown) or "no columns"
    left = len(names) - len(shown)
    if not left:
        return listed
    return (
        f"{listed}, and {left} more, the last {names[-1]!r} (name any of them, or a pattern such as"
        " 'q*=q_*:rad')"
    )


def _needed(part: Source, time: str | None, no_time: bool) -> str:
    if no_time:
        return (
            "no column of times is found; state the sampling rate in place of HZ, and at least one"
            " channel with its unit"
        )
    rate = stated_rate(part)
    if time is None and rate is not None:
        return (
            f"state (sampled at {rate[1]:g} Hz by {rate[0]!r}) at least one channel with its unit"
        )
    return "state the time and at least one channel with its unit"


def _remarks(channels: Sequence[Proposed]) -> str:
    """What of the proposal is a guess, and what only the user knows."""
    said = ["roles input, output, auxiliary are proposed by the names; correct them"]
    if unknown := [c.column for c in channels[:_SHOWN] if not c.unit]:
        said.append(
            f"unit 1 stands where the file states none ({', '.join(unknown[:6])}): write theirs"
        )
    if drives := [c for c in channels if c.quantity == "current" and c.role == "input"]:
        said.append(
            f"{drives[0].column} is a current: a model that takes a force needs its constant, N/A"
            ' or N m/A, as `scale` of a channel with unit = "N" or "N m" in dataset.toml'
        )
    if (left := len(channels) - _SHOWN) > 0:
        said.append(f"{left} more channels are left out of the command")
    return "; ".join([*said, "--rate HZ where no time was recorded"])


def _takes(name: str, series: Arrays) -> bool:
    """Whether a column is one of numbers, and not the same as its only element."""
    if f"{name}[1]" in series or not _numeric(series[name]):
        return False
    base, _, element = name.rpartition("[")
    is_element = base in series and element.endswith("]")
    is_alone = is_element and f"{base}[1]" not in series and _numeric(series[base])
    return not is_alone


def _registers(source: Source, names: Sequence[str]) -> dict[str, tuple[str, int]]:
    """Columns of numbers that are registers without their sign, and which bits hold it."""
    found = {}
    series = series_of(source.columns, None)
    for name in names:
        numbers = source.table(name, series[name]).numbers(name).values
        form = found_sign([numbers[np.isfinite(numbers)]])
        if form is not None:
            found[name] = form
    return found


def _time(source: Source, series: Arrays) -> str | None:
    """`t=COLUMN:UNIT` of what looks like the time; None where a stated rate stands for it."""
    if source.clock:
        return f"t={source.clock}:{unit_of(series[source.clock])}"
    names = [n for n in series if TIME.fullmatch(n)]
    if not names and stated_rate(source) is not None:
        return None
    name = names[0] if names else next(iter(series), "")
    if name not in series:
        return None
    numbers = source.table(name, series[name]).numbers(name).values
    if not names and not (np.diff(numbers) > 0).all():
        return None
    if not np.isfinite(numbers).any():  # dates
        return f"t={name}"
    return f"t={name}:{_unit_of_time(source, name, numbers)}"


def _unit_of_time(source: Source, name: str, numbers: np.ndarray) -> str:
    """The unit behind the name of the times, that which the file states, or the likely one."""
    match = TIME.fullmatch(name)
    if match is not None and match[1]:
        written = match[1].lower()
        return "s" if written.startswith("sec") else written
    stated = source.units.get(name)
    if stated in PER_SECOND:
        return stated
    return _unit(numbers)


def _unit(numbers: np.ndarray) -> str:
    why = contradicted(numbers, "s")
    if why is not None:
        return why[1]
    doubted = impossible(np.sort(numbers[np.isfinite(numbers)])) or ()
    found = re.search(r'time_unit = "(\w+)"', " ".join(doubted))
    return found[1] if found else "s"


def _numeric(cells: Any) -> bool:
    """Whether the first cells are numbers."""
    first = cells[:20] if isinstance(cells, list) else np.ravel(cells)[:20]
    filled = [c for c in first if c not in ("", None)]
    try:
        return np.array(filled, dtype=float).size > 0
    except (ValueError, TypeError):
        return False
