"""Frequency responses from a table: gain and phase, or both parts, over a frequency."""

from __future__ import annotations

import numpy as np

from jaxid.base.errors import DatasetProblem
from jaxid.data.experiment import FrequencyResponse
from jaxid.data.harvest import Harvest, readable, selected, span_text
from jaxid.data.sample_faults import sample_faults
from jaxid.data.schema import ExperimentEntry
from jaxid.data.table import Table
from jaxid.data.units import Conversion


def read_response(
    table: Table, entry: ExperimentEntry, name: str, units: dict[str, Conversion]
) -> Harvest:
    """A frequency response `output / input`, from the units of the two channels to SI."""
    harvest = Harvest()
    axis, *parts = _response_keys(table, entry)
    stated: dict[str, str] = {**entry.columns}
    columns = {key: stated.get(key, key) for key in (axis, *parts)}
    there = {key: column for key, column in columns.items() if column in table.columns}
    for key, column in columns.items():
        if key not in there:
            harvest.problems.append(table.missing(column, f"{key!r} of the frequency response"))
    index = selected(table, entry, harvest)
    if index is None:
        return harvest
    index, _ = readable(table, index, harvest)
    for column in there.values():
        harvest.problems += sample_faults(table, column, index)
    if harvest.problems or table.problems:
        return harvest
    values = {key: table.numbers(column).values[index] for key, column in columns.items()}
    _refuse(values[axis] <= 0, "above 0", axis, table, columns[axis], index, harvest)
    if "gain" in values:
        _refuse(values["gain"] < 0, "at least 0", "gain", table, columns["gain"], index, harvest)
        phase = values["phase"]
        if entry.phase_unit == "deg":
            phase = np.deg2rad(phase)
        response = values["gain"] * np.exp(1j * phase)
    else:
        response = values["re"] + 1j * values["im"]
    if harvest.problems:
        return harvest
    input, output = entry.input or "", entry.output or ""
    factor = units[output].factor / units[input].factor
    harvest.responses.append(
        FrequencyResponse(
            name=name,
            split=entry.split,
            omega=values[axis] if axis == "omega" else 2 * np.pi * values[axis],
            response=factor * response,
            input=input,
            output=output,
            source=f"{table.file}, {span_text(table, index)}",
        )
    )
    return harvest


def _response_keys(table: Table, entry: ExperimentEntry) -> tuple[str, str, str]:
    """What a frequency response is read from: its axis, and gain and phase or both parts."""

    def there(key: str) -> bool:
        return key in entry.columns or key in table.columns

    axis = "frequency" if there("frequency") and not there("omega") else "omega"
    polar = there("gain") or there("phase")
    if not polar and (there("re") or there("im")):
        return axis, "re", "im"
    return axis, "gain", "phase"


def _refuse(
    bad: np.ndarray,
    least: str,
    key: str,
    table: Table,
    column: str,
    index: np.ndarray,
    harvest: Harvest,
) -> None:
    """Tells of the first selected sample that is `bad` [selected]."""
    if not bad.any():
        return
    sample = int(index[np.flatnonzero(bad)[0]])
    value = table.numbers(column).values[sample]
    text = f"{table.place(sample)} is {value:g}; {key} must be {least}"
    row = table.row(sample)
    harvest.problems.append(
        DatasetProblem(table.file, row, column, text, "Correct or remove the row")
    )
