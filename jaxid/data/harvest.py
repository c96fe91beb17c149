"""What one entry of `[[experiments]]` gives, and which samples of its table it chooses."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from jaxid.base.errors import DatasetProblem, nearest
from jaxid.data.experiment import Experiment, FrequencyResponse
from jaxid.data.schema import ExperimentEntry
from jaxid.data.table import ragged_rows, Table


@dataclass
class Harvest:
    """What one entry of `[[experiments]]` gave."""

    experiments: list[Experiment] = field(default_factory=list)
    responses: list[FrequencyResponse] = field(default_factory=list)
    problems: list[DatasetProblem] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    still: dict[str, DatasetProblem] = field(
        default_factory=dict
    )  # output channels that never move, with the words for it
    moving: set[str] = field(default_factory=set)
    still_inputs: set[str] = field(default_factory=set)


def span_text(table: Table, index: np.ndarray) -> str:
    word = "rows" if table.rows is not None else "indices"
    return f"{word} {table.row(index[0])} to {table.row(index[-1])}"


def selected(table: Table, entry: ExperimentEntry, harvest: Harvest) -> np.ndarray | None:
    """The samples that `where` and `rows` choose (both count in the file's own samples)."""
    mask = np.ones(table.count, dtype=bool)
    for column, value in entry.where.items():
        if column not in table.columns:
            message = f"there is no column {column!r} for `where`{nearest(column, table.columns)}"
            harvest.problems.append(
                DatasetProblem(table.file, 1, column, message, "Name a column that exists")
            )
            return None
        chosen = table.equal(column, value)
        if not chosen.any():
            found = list(dict.fromkeys(map(str, table.columns[column])))[:30]
            message = f"no row has {column} = {value!r}{nearest(str(value), found)}"
            harvest.problems.append(
                DatasetProblem(table.file, None, column, message, "Correct `where`")
            )
            return None
        mask &= chosen
    if entry.rows is not None:
        start, stop = entry.rows
        if stop > table.count:
            message = f"rows = [{start}, {stop}] reach beyond the {table.count} samples of the file"
            harvest.problems.append(
                DatasetProblem(
                    table.file, None, None, message, "Correct `rows` (half-open, from 0)"
                )
            )
            return None
        mask[:start] = mask[stop:] = False
    index = np.flatnonzero(mask)
    if len(index) == 0:
        if table.count or not table.problems:
            message = "no sample is selected by `where` and `rows` together"
            harvest.problems.append(
                DatasetProblem(table.file, None, None, message, "Correct `where` or `rows`")
            )
        return None
    return index


def readable(table: Table, index: np.ndarray, harvest: Harvest) -> tuple[np.ndarray, bool]:
    """The selected samples whose rows have a field for each column; whether there are others, which
    is a problem.
    """
    good = ~np.isin(index, list(table.ragged))
    if good.all():
        return index, False
    torn = {k: table.ragged[k] for k in index[~good].tolist()}
    rows = table.rows if table.rows is not None else np.arange(table.count)
    harvest.problems.append(ragged_rows(table.file, rows.tolist(), torn, len(table.columns)))
    return index[good], True
