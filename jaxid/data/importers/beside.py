"""Numbers that stand in a file beside its series, such as gains and masses: kept, and said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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
    rate = stated_rate(source)
    out: Beside = {}
    for name, values in source.columns.items():
        if source.rows is not None or (rate is not None and name == rate[0]):
            continue
        numbers = np.squeeze(np.asarray(values))
        fits = numbers.ndim < 2 and 0 < numbers.size < MINIMUM_SAMPLES
        if not fits or numbers.dtype.kind not in "iuf" or not np.isfinite(numbers).all():
            continue
        plain = [float(value) for value in np.ravel(numbers)]
        out[name] = plain[0] if len(plain) == 1 else ", ".join(f"{value:.15g}" for value in plain)
    return out


def kept_beside(found: Sequence[tuple[str, Beside]]) -> tuple[Beside, list[str]]:
    """(entries of `[source]`, notes) of the numbers beside the series of runs, by the run's name. A
    number that differs between runs stands there for each.
    """
    entries: Beside = {}
    for name in dict.fromkeys(name for _, beside in found for name in beside):
        values = {run: beside[name] for run, beside in found if name in beside}
        entries |= _entries(name, values, len(values) == len(found))
    if not entries:
        return {}, []
    first = dict(list(entries.items())[:MOST])
    left = f"; {len(entries) - MOST} more are left out" if len(entries) > MOST else ""
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
