"""Traces of controllers and drives as text: one block a variable, one below the other, each with
its own times.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxid.data.importers.runs import refused
from jaxid.data.records import MINIMUM_SAMPLES


#: The column of the times of all blocks, in the unit of the file, which it does not state.
CLOCK = "t"
_NAMED = re.compile(r"\s*\d+\.(?:Variable|Name)\s*([;,\t])\s*(.+?)[\s;,]*")


def read_trace(path: Path, lines: Sequence[str]) -> dict[str, np.ndarray] | None:
    """The times of all blocks together, `t [time]`, and each variable at them, NaN where its block
    has no sample.

    None for any other text. Raises `DatasetError` for a block without samples, or whose times do
    not rise.
    """
    blocks: dict[str, list[tuple[float, float]]] = {}
    separator, name = ";", ""
    for line in lines:
        if (named := _NAMED.fullmatch(line)) is not None:
            separator, name = named[1], named[2]
            if name in blocks:
                raise refused(
                    path, f"the trace holds two blocks of {name!r}", "Give a trace of one recording"
                )
            blocks[name] = []
        elif name and (sample := _sample(line, separator)) is not None:
            blocks[name].append(sample)
    if not blocks:
        return None
    arrays = {name: np.array(samples, float).reshape(-1, 2) for name, samples in blocks.items()}
    for name, samples in arrays.items():
        if len(samples) < MINIMUM_SAMPLES:
            raise refused(
                path,
                f"the block of {name!r} holds {len(samples)} samples",
                "Record the trace again",
            )
        if not (np.diff(samples[:, 0]) > 0).all():
            raise refused(
                path, f"the times of {name!r} do not rise", "Cut the trace where they start again"
            )
    t = np.unique(np.concatenate([samples[:, 0] for samples in arrays.values()]))
    columns = {CLOCK: t}
    for name, samples in arrays.items():
        columns[name] = np.full(len(t), np.nan)
        columns[name][np.searchsorted(t, samples[:, 0])] = samples[:, 1]
    return columns


def words_of(columns: dict[str, np.ndarray]) -> str:
    """What the file is."""
    names = [n for n in columns if n != CLOCK]
    return (
        f"a trace with one block a variable ({len(names)}), each with its own times, all under"
        f" {CLOCK!r}"
    )


def unit_of(times: np.ndarray) -> str:
    """The unit in which a controller's step lies between microseconds and half a second: a guess to
    propose.
    """
    step = float(np.median(np.diff(times)))
    return next(
        (unit for unit, scale in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)) if step * scale < 0.5),
        "ns",
    )


def _sample(line: str, separator: str) -> tuple[float, float] | None:
    """A row of a block: a time and a value."""
    if separator != ",":
        line = line.replace(",", ".")
    cells = [c for c in line.split(separator) if c.strip()]
    if len(cells) != 2:
        return None
    try:
        return float(cells[0]), float(cells[1])
    except ValueError:
        return None
