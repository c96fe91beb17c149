"""The split rules: validation data from the tail of fit runs, report data from the second half of
validation runs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from jaxid.data.records import MINIMUM_SAMPLES


if TYPE_CHECKING:
    from jaxid.data.dataset import Dataset, Experiment


TAIL = 0.3
GUARD_SAMPLES, GUARD_S = 20, 0.1
#: A run whose first time stamp (s) is later than this is spoken of by the time since its start.
LATE = 1e4
#: What a part knows of the samples before it, by time (s) and at most this many: an effect that
#: remembers starts from them. Validation runs are simulated for every hypothesis, report runs for a
#: few. Fit runs have a past where they are what lies behind a contact.
PAST = {"fit": (5.0, 1000), "validation": (5.0, 1000), "report": (60.0, 20_000)}


def with_splits(dataset: Dataset) -> Dataset:
    """See `Dataset.with_splits`."""
    runs = list(dataset.experiments)
    notes: list[str] = []
    if "validation" not in {run.split for run in runs}:
        note = "no validation run: the last 30 % of each fit run are kept for it"
        runs = _cut(runs, "fit", "validation", 1 - TAIL, note, notes)
    if "report" not in {run.split for run in runs}:
        note = "no report run: the second half of each validation run is kept for it"
        runs = _cut(runs, "validation", "report", 0.5, note, notes)
    if not notes:
        return dataset
    return replace(
        dataset, experiments=tuple(map(_forgetful, runs)), notes=(*dataset.notes, *notes)
    )


def _cut(
    runs: list[Experiment], first: str, second: str, share: float, rule: str, notes: list[str]
) -> list[Experiment]:
    """Each run of split `first` in two; the later part becomes `second`."""
    cut: list[Experiment] = []
    told: list[str] = []
    for run in runs:
        if run.split != first:
            cut.append(run)
            continue
        stop = round(share * len(run))
        start = _after_guard(run, stop)
        if stop < MINIMUM_SAMPLES or len(run) - start < MINIMUM_SAMPLES:
            cut.append(run)
            told.append(f"{run.name} is too short ({len(run)} samples) and stays whole")
            continue
        base = run.name.removesuffix(f"#{first}")
        name = run.name if run.name.endswith(f"#{first}") else f"{base}#{first}"
        cut.append(run.piece(0, stop, name=name, split=first))
        everything = start + len(run.whole) - len(run)
        cut.append(
            run.piece(start, len(run), name=f"{base}#{second}", split=second, past=everything)
        )
        told.append(
            f"{base} cut {_place(run, stop)}, {start - stop} samples"
            f" ({run.t[start] - run.t[stop]:.3g} s) left out, {len(run) - start} samples for"
            f" {second}"
        )
    if told:
        notes.append(f"{rule} ({'; '.join(told)})")
    return cut


def _forgetful(run: Experiment) -> Experiment:
    """The run with the end of its past, if it has one."""
    past = run.past
    if past is None:
        return run
    longest, most = PAST[run.split]
    n = min(int(np.sum(past.t >= run.t[0] - longest)), most)
    if n == len(past):
        return run
    end = past.piece(len(past) - n, len(past), name=past.name, split=past.split)
    return replace(run, past=end)


def _place(run: Experiment, stop: int) -> str:
    """Where a run is cut; of clocks that count from 1970 or from when a machine was switched on
    nobody wants to read.
    """
    return (
        f"at {run.t[stop]:.6g} s"
        if abs(run.t[0]) < LATE
        else f"{run.t[stop] - run.t[0]:.6g} s after its start"
    )


def _after_guard(run: Experiment, stop: int) -> int:
    """The first sample behind a guard gap of 20 samples or 0.1 s, whichever is longer; a fast
    record is over so soon that a third of what is left has to do.
    """
    by_time = int(np.searchsorted(run.t, run.t[stop] + GUARD_S, side="left"))
    return min(
        max(stop + GUARD_SAMPLES, by_time),
        max(stop + GUARD_SAMPLES, stop + (len(run) - stop) // 3),
        len(run),
    )
