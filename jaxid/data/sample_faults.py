"""Samples of a table that cannot be read, each kind as one problem with its first place."""

from __future__ import annotations

import numpy as np

from jaxid.base.errors import DatasetProblem
from jaxid.data.table import Table


def without_time(
    table: Table, clock: str, t: np.ndarray, index: np.ndarray
) -> list[DatasetProblem]:
    """Dates that are none (NaT, an empty cell)."""
    bad = index[~np.isfinite(t[index])]
    if not len(bad):
        return []
    more = f"; so {len(bad)} samples" if len(bad) > 1 else ""
    remedy = "Write its time, or cut it out with `rows`"
    return [
        DatasetProblem(
            table.file,
            table.row(int(bad[0])),
            clock,
            f"{table.place(int(bad[0]))} has no time{more}",
            remedy,
        )
    ]


def sample_faults(table: Table, column: str, index: np.ndarray) -> list[DatasetProblem]:
    """One problem for each kind of fault among the selected samples of a column."""
    faults = table.numbers(column).faults
    if not faults:
        return []
    kinds: dict[str, list[int]] = {}
    for sample in sorted(set(faults) & set(index.tolist())):
        kinds.setdefault(faults[sample].split(":")[0], []).append(sample)
    problems = []
    for kind, samples in kinds.items():
        first = samples[0]
        text = f"{table.place(first)} is {faults[first]}"
        if len(samples) > 1:
            text += f"; {len(samples)} samples in all are {kind}"
        remedy = {
            "missing": "Fill it, cut it out with `rows` or `window_s`, or leave the experiment out",
            "infinite": "Correct the sample, or cut it out with `rows` or `window_s`",
        }.get(kind, "Write a number with a decimal point")
        problems.append(DatasetProblem(table.file, table.row(first), column, text, remedy))
    return problems
