"""What a file holds, and the command that would take it: said where no channels were."""

from __future__ import annotations

import re
import shlex
from typing import Any

import numpy as np

from jaxid.data.importers.arrays import Arrays
from jaxid.data.importers.source import parts_of, series_of, Source, stated_rate
from jaxid.data.table import Table
from jaxid.data.time_axis import contradicted, impossible, PER_SECOND


#: Names that a column of times has, and the unit behind them: `t`, `Time`, `__time`, `stamp_ns`, `log.t_ms`, `X_Value`.
_TIME = re.compile(
    r"(?:.*[./])?_*(?:t|time|timestamp|time_?stamp|stamp|zeit|temps|x_value|clock)s?(?:_?(s|ms|us|ns|sec|seconds))?", re.I
)
_SHOWN, _EXAMPLES = 20, 2


def proposal(source: Source, out: Any) -> str:
    """The columns of a file, and a command with its time and two of its channels."""
    part = parts_of(source)[0]  # of several recordings, all of which are read by the same names
    series = series_of(part.columns, None)
    shown = (
        ", ".join(f"{n} ({source.units[n]})" if n in source.units else n for n in list(series_of(source.columns, None))[:_SHOWN])
        or "no columns"
    )
    words = f" ({source.words})" if source.words else ""
    time = _time(part, series)
    clock = "" if time is None else time.removeprefix("t=").rpartition(":")[0] or time.removeprefix("t=")
    rest = [n for n in series if n != clock and np.size(series[n]) != 1]
    said = [*([] if time is None else [time]), *_channels(part, rest, clock)]
    example = " ".join(
        [f"jaxid import {source.kind}", shlex.quote(str(source.path)), *(f"--channel {shlex.quote(c)}" for c in said)]
    )
    rate = stated_rate(part)
    needed = "the time and " if time is not None or rate is None else f"(sampled at {rate[1]:g} Hz by {rate[0]!r}) "
    return (
        f"{source.path.name}{words} holds: {shown}; state {needed}at least one channel with its unit: {example} --out {out} "
        "(roles input, output, auxiliary behind the unit where the name does not say it; --rate HZ where no time was recorded)"
    )


def _time(source: Source, series: Arrays) -> str | None:
    """`t=COLUMN:UNIT` of what looks like the time; None where a stated rate stands for it."""
    names = [n for n in series if _TIME.fullmatch(n)]
    if not names and stated_rate(source) is not None:
        return None
    name = names[0] if names else next(iter(series), "TIME")
    if name not in series:
        return f"t={name}:s"
    numbers = Table(source.path.name, {name: series[name]}, len(series[name]), source.rows).numbers(name).values
    if not np.isfinite(numbers).any():  # dates
        return f"t={name}"
    match = _TIME.fullmatch(name)
    suffix = {"sec": "s", "seconds": "s"}.get(match[1].lower(), match[1].lower()) if match and match[1] else None
    unit = suffix or (source.units.get(name) if source.units.get(name) in PER_SECOND else None)
    return f"t={name}:{unit or _unit(numbers)}"


def _unit(numbers: np.ndarray) -> str:
    if (why := contradicted(numbers, "s")) is not None:
        return why[1]
    found = re.search(r'time_unit = "(\w+)"', " ".join(impossible(np.sort(numbers[np.isfinite(numbers)])) or ()))
    return found[1] if found else "s"


def _channels(source: Source, names: list[str], clock: str) -> list[str]:
    """`NAME=COLUMN:UNIT` of the first columns of numbers; elements of an array together."""
    series = series_of(source.columns, None)
    said: dict[str, str] = {}
    for n in names:
        base, _, element = n.rpartition("[") if n.endswith("]") else (n, "", "")
        if (f"{n}[1]" in series) or (element and base in names and f"{base}[1]" not in series) or not _numeric(series[n]):
            continue
        word = re.sub(r"\W+", "_", re.split(r"[./](?=[^./]+$)", base)[-1]).strip("_")
        word = word if re.match(r"[A-Za-z]", word) else "q" if "q" not in said else f"channel_{word}"
        column = f"{base}[*]" if element and not clock.startswith(f"{base}[") else n
        said.setdefault(word, f"{word}{'*' if column != n else ''}={column}:{source.units.get(n, 'UNIT')}")
        if len(said) == _EXAMPLES:
            break
    return list(said.values())


def _numeric(cells: Any) -> bool:
    """Whether the first cells are numbers."""
    first = [c for c in (cells[:20] if isinstance(cells, list) else np.ravel(cells)[:20]) if c not in ("", None)]
    try:
        return bool(first) and bool(np.array(first, dtype=float).size)
    except (ValueError, TypeError):
        return False
