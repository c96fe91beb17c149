"""What all importers share: recordings as runs, what is repeated or missing in them counted, and
the dataset they become.

Nothing is filled in and no run is dropped: a time that starts again begins a new run, a run is
split where too much is missing.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jaxid.data.dataset import Dataset, ModelSpec
from jaxid.data.io import save_dataset
from jaxid.data.records import MINIMUM_SAMPLES
from jaxid.data.registers import found_sign, register_words
from jaxid.errors import DatasetError, DatasetProblem, DatasetWarning


Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


@dataclass
class ImportedRun:
    """One recording: `t [time]` s and channel -> `[time]`; `notes` say what was wrong with it."""

    name: str
    t: np.ndarray
    columns: dict[str, np.ndarray]
    notes: list[str] = field(default_factory=list)


def runs_of(
    name: str, t: np.ndarray, columns: Mapping[str, np.ndarray], file: str
) -> list[ImportedRun]:
    """The runs of a recording whose time may start again; rows that are merely out of order are
    sorted, both said.

    Raises `DatasetError` for rows that are out of order and cannot be sorted: two recordings mixed
    row by row.
    """
    back = np.flatnonzero(np.diff(t) < 0) + 1
    edges = [0, *back.tolist(), len(t)]
    if len(back) == 0 or min(np.diff(edges)) >= MINIMUM_SAMPLES:
        parts = list(zip(edges[:-1], edges[1:], strict=True))
        names = [name] if len(parts) == 1 else [f"{name}_{k}" for k in range(1, len(parts) + 1)]
        runs = [
            _counted(n, t[a:b], {k: v[a:b] for k, v in columns.items()})
            for n, (a, b) in zip(names, parts, strict=True)
        ]
        if len(back):
            rows = ", ".join(str(int(b)) for b in back[:5])
            runs[0].notes.append(
                f"{name}: the time starts again at sample {rows}, so it is {len(parts)} runs"
            )
        return runs
    order = np.argsort(t, kind="stable")
    late = int(np.sum(t < np.maximum.accumulate(t)))
    sorted_t, sorted_columns = t[order], {k: v[order] for k, v in columns.items()}
    torn = _differing(sorted_t, sorted_columns)
    if torn:
        message = (
            f"{late} rows run backwards in time, and {len(torn)} of the times stand there twice"
            " with other values"
        )
        remedy = (
            "It seems to be several recordings mixed row by row: import each by itself (--rows"
            " FIRST:END), or sort them apart"
        )
        raise DatasetError([DatasetProblem(file, None, None, message, remedy)])
    run = _counted(name, sorted_t, sorted_columns)
    run.notes.insert(0, f"{name}: {late} rows were out of order in time; they were sorted")
    return [run]


def _differing(t: np.ndarray, columns: Mapping[str, np.ndarray]) -> list[int]:
    """Rows whose time the next one repeats with other values; two blank cells are alike."""
    repeated = np.flatnonzero(np.diff(t) == 0)

    def alike(v):
        return np.array_equal(v[:1], v[1:], equal_nan=True)

    return [int(k) for k in repeated if not all(alike(v[k : k + 2]) for v in columns.values())]


def _counted(name: str, t: np.ndarray, columns: Mapping[str, np.ndarray]) -> ImportedRun:
    """Without repeated times, which are counted; what is missing is counted too."""
    keep = np.concatenate([[True], np.diff(t) > 0]) if len(t) else np.zeros(0, bool)
    notes = []
    if repeated := int(np.sum(~keep)):
        torn = _differing(t, columns)
        other = f", {len(torn)} of them with other values" if torn else ""
        notes.append(f"{name}: {repeated} rows repeat a time{other}; the first of each was kept")
    t = t[keep] - (t[keep][0] if keep.any() else 0.0)
    step = np.diff(t)
    if len(step):
        period = float(np.median(step))
        missing = np.maximum(np.round(step / period).astype(int) - 1, 0)
        if missing.any():
            worst = int(np.argmax(missing))
            notes.append(
                f"{name}: {missing.sum()} samples are missing in {np.count_nonzero(missing)} gaps"
                f" ({100 * missing.sum() / (missing.sum() + len(t)):.1f} %), the longest of"
                f" {missing[worst]} at {t[worst]:.3f} s"
            )
    return ImportedRun(name, t, {k: v[keep] for k, v in columns.items()}, notes)


def save_runs(
    runs: Sequence[ImportedRun],
    out: str | os.PathLike[str],
    kind: str,
    roles: Mapping[str, tuple[str | None, str]],
    *,
    overwrite: bool = False,
    resolution: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    joints: Mapping[str, str] | None = None,
    notes: Sequence[str] = (),
    beside: Mapping[str, float | str] | None = None,
) -> Path:
    """Writes the dataset folder. `roles`: channel, or its name without the joint -> role (None: by
    convention) and unit; `joints`: channel of a position -> the joint's own name; `beside`: numbers
    of the files that are no series. A sample that is
    NaN was not read (`valid` in `dataset.toml`); every note is warned of and stands in the
    description.
    """
    names = [c for c in runs[0].columns if all(c in r.columns for r in runs)]
    notes = [*notes, *(n for r in runs for n in r.notes)]
    if left := sorted({c for r in runs for c in r.columns} - set(names)):
        notes.append(f"channels that not every run has were left out: {', '.join(left)}")

    def stem(c):
        return c if c in roles else re.sub(r"\d+", "", c)

    role = {c: roles[stem(c)][0] or role_of(c) for c in names}
    outputs = [c for c in names if role[c] == "output"]
    still = [
        c
        for c in outputs
        if all(np.ptp(r.columns[c][np.isfinite(r.columns[c])]) == 0 for r in runs)
    ]
    for c in still:
        if len(still) < len(outputs):  # a joint that was held is one of the arm's all the same
            notes.append(f"{c} never moves")
        else:  # a dataset in which no output moves cannot be read
            role[c] = "auxiliary"
            notes.append(f"{c} never moves and is kept as an auxiliary channel")
    registers = {
        c: found for c in names if (found := found_sign([r.columns[c] for r in runs])) is not None
    }

    def bits(key):
        return {c: number for c, (form, number) in registers.items() if form == key}

    sign_bit = bits("sign_bit")
    # An output that is brought round to 0 may be a counter that wraps, which `jaxid check` tells.
    signed_bits = {c: number for c, number in bits("signed_bits").items() if role[c] != "output"}
    notes += [
        f"{c} {register_words(*registers[c])}; it was taken with it"
        for c in (*sign_bit, *signed_bits)
    ]

    def pick(wanted):
        return {c: [r.columns[c] for r in runs] for c in names if role[c] == wanted}

    blank = [c for c in names if any(np.isnan(r.columns[c]).any() for r in runs)]
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", DatasetWarning
        )  # the same is said below, in words that name the file
        dataset = Dataset.from_arrays(
            [r.t for r in runs],
            pick("input"),
            pick("output"),
            auxiliary=pick("auxiliary"),
            units={c: (units or {}).get(c, roles[stem(c)][1]) for c in names},
            name=Path(out).name,
            description=f"imported from {kind}; "
            + ("; ".join(notes) or "nothing repeated, nothing missing"),
            source={"source": kind, "files": ", ".join(r.name for r in runs)} | dict(beside or {}),
            names=_unique([r.name for r in runs]),
            split_at_gaps=True,
            valid={c: [np.isfinite(r.columns[c]).astype(float) for r in runs] for c in blank},
            resolution={c: v for c in names for s, v in (resolution or {}).items() if stem(c) == s},
            model=ModelSpec(joints=dict(joints)) if joints else None,
            sign_bit=sign_bit,
            signed_bits=signed_bits,
            time_unit="s",  # stated or judged by the importer
            check_model=False,
        )
    folder = save_dataset(dataset, out, overwrite=overwrite)
    for note in notes:
        warnings.warn(note, DatasetWarning, stacklevel=3)
    return folder


def _unique(names: Sequence[str]) -> list[str]:
    """Names of runs, numbered where files of other folders have the same."""
    return [
        n if names.count(n) == 1 else f"{n}_{names[: k + 1].count(n)}" for k, n in enumerate(names)
    ]


def role_of(name: str) -> str:
    """The role of a channel by its name."""
    stem = re.sub(r"\d+", "", name)
    if stem.endswith("_cmd") or stem in ("tau", "force", "current", "voltage", "u"):
        return "input"
    return "output" if stem in ("q", "position", "theta", "alpha", "phi") else "auxiliary"


def held(t: np.ndarray, own: np.ndarray, values: np.ndarray) -> np.ndarray:
    """What was last given (`values [n ...]` at times `own [n]`) at each of the times t; NaN before
    the first.
    """
    at = np.searchsorted(own, t, side="right") - 1
    out = np.array(values[np.maximum(at, 0)], float)
    out[at < 0] = np.nan
    return out


def paths_of(files: Paths) -> list[Path]:
    return [Path(files)] if isinstance(files, str | os.PathLike) else [Path(f) for f in files]


def refused(path: Path, message: str, remedy: str) -> DatasetError:
    return DatasetError([DatasetProblem(path.name or str(path), None, None, message, remedy)])


def first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:120]
