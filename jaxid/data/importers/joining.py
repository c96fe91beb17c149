"""Other files on the clock of the first: their columns as they stood at its times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.data.importers.arrays import Arrays
from jaxid.data.importers.runs import held, refused
from jaxid.data.importers.source import find_column, numbers_of, series_of, Source, times_of


@dataclass(frozen=True)
class Joined:
    """A file whose columns are taken too: `series` under their own names, `names`: name on the
    command line -> own name.
    """

    source: Source
    series: Arrays
    names: dict[str, str]


@dataclass(frozen=True)
class Clock:
    """The column of the times and its unit, None where it is not said."""

    column: str
    unit: str | None


def joined_files(sources: Sequence[Source]) -> list[Joined]:
    """Each file with the names of its columns: `file.column`, and `column` alone where only one of
    the files has it.

    Raises `UsageError` for two files of one name, whose columns could not be told apart.
    """
    stems = Counter(s.path.stem for s in sources)
    if twice := [stem for stem, count in stems.items() if count > 1]:
        raise UsageError(
            f"--join: two files are called {twice[0]!r}, so their columns cannot be told apart;"
            " rename one"
        )
    every = [series_of(s.columns, None) for s in sources]
    counts: Counter[str] = Counter()
    for series in every:
        counts.update(series.keys())
    found = []
    for source, series in zip(sources, every, strict=True):
        names = {name: name for name in series if counts[name] == 1}
        names |= {f"{source.path.stem}.{name}": name for name in series}
        found.append(Joined(source, series, names))
    return found


def names_once(series: Arrays, joined: Sequence[Joined]) -> list[str]:
    """Every column of all files under one name: its own, or `file.column` where another file has
    that too.
    """
    names = list(series)
    for join in joined:
        taken = {own for name, own in join.names.items() if name == own and name not in series}
        names += [
            name
            for name, own in join.names.items()
            if name in taken or (name != own and own not in taken)
        ]
    return names


def join_columns(
    join: Joined,
    clock: Clock,
    wanted: dict[str, str],
    t: np.ndarray,
    start: int | None,
    columns: dict[str, np.ndarray],
    notes: list[str],
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The times and columns with those of the other file (`wanted`: channel -> its column), as they
    stood at the times t.

    Rows outside of the other file are left out, and said.
    """
    source, series = join.source, join.series
    name = find_column(source, series, clock.column)
    if name is None:
        message = f"there is no column {clock.column!r} to join on{nearest(clock.column, series)}"
        raise refused(
            source.path, message, "All files need the time under one name; rename the column"
        )
    own, own_start = times_of(source, series[name], name, clock.unit, None)
    if (start is None) != (own_start is None):
        raise refused(
            source.path,
            "only one of the two files has a clock that counts from 1970",
            "Give files on one clock",
        )
    own = own + ((own_start or 0) - (start or 0)) * 1e-9
    if (np.diff(own) < 0).any() or (np.diff(t) < 0).any():
        raise refused(
            source.path,
            "time runs backwards in one of the two files",
            "Join one run at a time: --rows FIRST:END",
        )
    step = float(np.median(np.diff(own)))
    inside = (t >= own[0]) & (t <= own[-1] + step)
    if not inside.any():
        message = f"its times, {own[0]:g} to {own[-1]:g} s, lie outside of {t[0]:g} to {t[-1]:g} s"
        raise refused(source.path, message, "Give files of one recording on one clock")
    every = slice(None)
    values = {
        c: numbers_of(source, series[column], column, every, len(own), notes)
        for c, column in wanted.items()
    }
    taken = {c: held(t[inside], own, v) for c, v in values.items()}
    drift = _drift(t[inside], own)
    notes.append(
        f"{source.path.name} joined on the time: its last value at each of {inside.sum()} samples"
        f" ({drift})"
    )
    if lost := int(np.sum(~inside)):
        notes.append(f"{lost} samples before or after {source.path.name} left out")
    return t[inside], {c: v[inside] for c, v in columns.items()} | taken


def _drift(t: np.ndarray, own: np.ndarray) -> str:
    """How the stamps of two files move against each other."""
    if np.isin(t, own).all():
        return "of the same stamps"
    steps = float(np.median(np.diff(t))), float(np.median(np.diff(own)))
    if abs(steps[1] / steps[0] - 1) > 0.02 or len(t) < 20:
        return (
            f"sampled every {1e3 * steps[0]:.4g} and {1e3 * steps[1]:.4g} ms, so no drift between"
            " their clocks can be told"
        )
    near = own[np.clip(np.searchsorted(own, t), 1, len(own) - 1)]
    near = np.where(np.abs(near - t) > steps[1] / 2, near - steps[1], near)
    apart = np.unwrap(near - t, period=steps[1])
    x = t - t.mean()
    slope = float(x @ apart / (x @ x))
    std = float(np.std(apart - apart.mean() - slope * x) / np.sqrt(x @ x))
    size = (
        f"their stamps move apart by {1e6 * slope:.2g} +- {1e6 * std:.1g} ppm, by"
        f" {1e3 * apart[0]:.3g} ms at the start"
    )
    return size + (
        "; with clocks of their own: clock_ppm for its channels"
        if abs(slope) > 3 * std and abs(slope) > 1e-6
        else ""
    )
