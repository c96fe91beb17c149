"""Numbers that stand in a file beside its series, such as gains and masses: kept, and said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxid.data.importers.source import Source, stated_rate
from jaxid.data.records import MINIMUM_SAMPLES


#: Most numbers of a file that are kept; a file of more is no log with a few of them beside it.
MOST = 50
#: Entries of `[source]` that are the importer's own.
OWN = ("source", "files")

Beside = dict[str, float | str]


def numbers_beside(source: Source) -> Beside:
    """Single numbers of a file, and lists too short to be a recording (as text), by name."""
    if source.rows is not None:
        return {}  # a table has columns alone
    made_times = stated_rate(source) or ("", 0.0)
    out = {name: _few(values) for name, values in source.columns.items()}
    out[made_times[0]] = None
    return {name: value for name, value in out.items() if value is not None}


def _few(values: Any) -> float | str | None:
    """One number, or a few as text; None for everything else."""
    numbers = np.squeeze(np.asarray(values))
    if numbers.ndim > 1 or numbers.size == 0 or numbers.dtype.kind not in "iuf":
        return None
    if not np.isfinite(numbers).all():
        return None
    if numbers.size == 1:
        return float(numbers)
    return ", ".join(map(_written, numbers.tolist())) if numbers.size < MINIMUM_SAMPLES else None


def kept_beside(found: Sequence[tuple[str, Beside]]) -> tuple[Beside, list[str]]:
    """(entries of `[source]`, notes) of the numbers beside the series of runs, by the run's name. A
    number that differs between runs stands there for each.
    """
    by_name: dict[str, Beside] = {}
    for run, beside in found:
        for name, value in beside.items():
            by_name.setdefault(name, {})[run] = value
    entries: Beside = {}
    for name, values in by_name.items():
        entries |= _entries(name, values, len(values) == len(found))
    if not entries:
        return {}, []
    first = dict(list(entries.items())[:MOST])
    left = ""
    if len(entries) > MOST:
        left = f"; {len(entries) - MOST} more are left out"
    listed = "; ".join(f"{name} = {_written(value)}" for name, value in first.items())
    note = (
        "numbers beside the series are kept under [source], and no model uses them: "
        f"{listed}{left}; write what a model is to use under [model.constants] or [controller], "
        "in SI units"
    )
    return first, [note]


def _entries(name: str, values: Mapping[str, float | str], everywhere: bool) -> Beside:
    key = f"{name} of the file" if name in OWN else name
    if everywhere and len(set(values.values())) == 1:
        return {key: next(iter(values.values()))}
    return {f"{key} of {run}": value for run, value in values.items()}


def _written(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.15g}"
