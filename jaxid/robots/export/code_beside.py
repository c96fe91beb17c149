"""What an export leaves to code beside the robot's file, in runs of that file in MuJoCo: laws on
commands change the recorded goals; the others are not in these runs, which is said.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from jaxid.base.numbers import is_finite
from jaxid.base.wording import listed
from jaxid.data.dataset import Dataset, Experiment
from jaxid.robots.export.law_code import command_law
from jaxid.robots.export.target import CODE, ExportRow


def commanded(dataset: Dataset, rows: Iterable[ExportRow]) -> Dataset:
    """The dataset with its inputs as the laws on commands among these rows hand them on, sample by
    sample.
    """
    runs = dataset.experiments
    for row in _left_to_code(rows):
        if _on_command(row) and row.location in dataset.input_names:
            column = dataset.input_names.index(row.location)
            runs = tuple(_handed_on(e, column, row) for e in runs)
    return replace(dataset, experiments=runs)


def on_commands(rows: Iterable[ExportRow]) -> str:
    """What acts on commands; "" where nothing does."""
    return _told(row for row in _left_to_code(rows) if _on_command(row))


def left_out(rows: Iterable[ExportRow]) -> str:
    """What acts elsewhere, and so is not in these runs; "" where nothing does."""
    return _told(row for row in _left_to_code(rows) if not _on_command(row))


def _told(rows: Iterable[ExportRow]) -> str:
    return listed([f"{row.effect} at {row.location}" for row in rows])


def _left_to_code(rows: Iterable[ExportRow]) -> list[ExportRow]:
    return [row for row in rows if row.how == CODE and _has_numbers(row.value)]


def _has_numbers(value: object) -> bool:
    return isinstance(value, Mapping) and all(map(is_finite, value.values()))


def _on_command(row: ExportRow) -> bool:
    return command_law(row.effect, row.value) is not None


def _handed_on(e: Experiment, column: int, row: ExportRow) -> Experiment:
    law = command_law(row.effect, row.value)
    assert law is not None
    steps = np.diff(e.t, prepend=2 * e.t[0] - e.t[1])
    u = e.u.copy()
    u[:, column] = [law(value, dt) for value, dt in zip(e.u[:, column], steps, strict=True)]
    return replace(e, u=u)
