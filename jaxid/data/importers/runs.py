"""What all importers share: recordings as runs, what is repeated or missing in them counted, and
the dataset they become.

Nothing is filled in and no run is dropped: a time that starts again begins a new run, a run is
split where too much is missing.
"""

from __future__ import annotations

import os
import re
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jaxid.base.errors import DatasetError, DatasetProblem, DatasetWarning
from jaxid.base.wording import names_of
from jaxid.data.dataset import Dataset, ModelSpec
from jaxid.data.io import save_dataset
from jaxid.data.records import MINIMUM_SAMPLES
from jaxid.data.registers import found_sign, register_words


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
    starts = np.flatnonzero(np.diff(t) < 0) + 1
    edges = [0, *starts.tolist(), len(t)]
    if len(starts) == 0:
        return [_counted(name, t, columns)]
    if min(np.diff(edges)) >= MINIMUM_SAMPLES:
        return _runs_between(edges, name, t, columns)
    return [_sorted(name, t, columns, file)]


def _runs_between(
    edges: Sequence[int], name: str, t: np.ndarray, columns: Mapping[str, np.ndarray]
) -> list[ImportedRun]:
    """A run between each two edges, at which the time starts again."""
    runs = []
    for number, (a, b) in enumerate(zip(edges[:-1], edges[1:], strict=True), 1):
        part = {channel: values[a:b] for channel, values in columns.items()}
        runs.append(_counted(f"{name}_{number}", t[a:b], part))
    rows = ", ".join(map(str, edges[1:-1][:5]))
    runs[0].notes.append(
        f"{name}: the time starts again at sample {rows}, so it is {len(runs)} runs"
    )
    return runs


def _sorted(name: str, t: np.ndarray, columns: Mapping[str, np.ndarray], file: str) -> ImportedRun:
    """One run of rows that are out of order in time."""
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
    return run


def _differing(t: np.ndarray, columns: Mapping[str, np.ndarray]) -> list[int]:
    """Rows whose time the next one repeats with other values; two blank cells are alike."""
    differing = np.zeros(max(len(t) - 1, 0), bool)
    for values in columns.values():
        both_blank = np.isnan(values[:-1]) & np.isnan(values[1:])
        differing |= (values[:-1] != values[1:]) & ~both_blank
    return np.flatnonzero(differing & (np.diff(t) == 0)).tolist()


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
    shared, said = _shared_columns(runs)
    notes = [*notes, *said]
    keys = {channel: _key(channel, roles) for channel in shared}
    role = {channel: roles[key][0] or role_of(channel) for channel, key in keys.items()}
    notes += _motionless(role, shared)
    sign_bit, signed_bits, said = _signed(role, shared)
    notes += said

    def of_role(wanted: str) -> dict[str, list[np.ndarray]]:
        return {c: values for c, values in shared.items() if role[c] == wanted}

    said = "; ".join(notes) or "nothing repeated, nothing missing"
    with warnings.catch_warnings():
        # the same is said below, in words that name the file
        warnings.simplefilter("ignore", DatasetWarning)
        dataset = Dataset.from_arrays(
            [run.t for run in runs],
            of_role("input"),
            of_role("output"),
            auxiliary=of_role("auxiliary"),
            units={c: (units or {}).get(c, roles[key][1]) for c, key in keys.items()},
            name=Path(out).name,
            description=f"imported from {kind}; {said}",
            source={
                "source": kind,
                "files": ", ".join(names_of(runs)),
                **(beside or {}),
            },
            names=_unique(names_of(runs)),
            split_at_gaps=True,
            valid=_finite_where_blank(shared),
            resolution=_by_channel(keys, resolution or {}),
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


def _key(channel: str, roles: Mapping[str, tuple[str | None, str]]) -> str:
    """The key of a channel in `roles`: the channel, or its name without the joint."""
    return channel if channel in roles else re.sub(r"\d+", "", channel)


def _by_channel(keys: Mapping[str, str], values: Mapping[str, float]) -> dict[str, float]:
    """Numbers by the channels; `keys`: channel -> its key in `values`."""
    return {channel: values[key] for channel, key in keys.items() if key in values}


def _shared_columns(
    runs: Sequence[ImportedRun],
) -> tuple[dict[str, list[np.ndarray]], list[str]]:
    """The values, run by run, of the channels that every run has; the notes of the runs and one of
    other channels.
    """
    counts: Counter[str] = Counter()
    notes: list[str] = []
    for run in runs:
        counts.update(run.columns.keys())
        notes += run.notes
    shared = {}
    for channel in runs[0].columns:
        if counts[channel] == len(runs):
            shared[channel] = [run.columns[channel] for run in runs]
    left = sorted(counts.keys() - shared.keys())
    if left:
        notes.append(f"channels that not every run has were left out: {', '.join(left)}")
    return shared, notes


def _motionless(role: dict[str, str], columns: Mapping[str, Sequence[np.ndarray]]) -> list[str]:
    """Notes of the outputs that never move; where none moves, all become auxiliary in `role`."""
    outputs = [c for c, r in role.items() if r == "output"]
    still = []
    for channel in outputs:
        ranges = [np.ptp(values[np.isfinite(values)]) for values in columns[channel]]
        if not np.any(ranges):
            still.append(channel)
    # A joint that was held is one of the arm's all the same.
    if len(still) < len(outputs):
        return [f"{channel} never moves" for channel in still]
    # A dataset in which no output moves cannot be read.
    role |= dict.fromkeys(still, "auxiliary")
    return [f"{channel} never moves and is kept as an auxiliary channel" for channel in still]


def _signed(
    role: Mapping[str, str], columns: Mapping[str, Sequence[np.ndarray]]
) -> tuple[dict[str, int], dict[str, int], list[str]]:
    """The channels whose registers hold a sign bit, those in two's complement, and notes."""
    sign_bit: dict[str, int] = {}
    signed_bits: dict[str, int] = {}
    words = {}
    for channel, values in columns.items():
        found = found_sign(values)
        if found is None:
            continue
        form, number = found
        words[channel] = f"{channel} {register_words(*found)}; it was taken with it"
        if form == "sign_bit":
            sign_bit[channel] = number
        # An output that is brought round to 0 may be a counter that wraps, which `jaxid check`
        # tells.
        elif form == "signed_bits" and role[channel] != "output":
            signed_bits[channel] = number
    return sign_bit, signed_bits, [words[channel] for channel in (*sign_bit, *signed_bits)]


def _finite_where_blank(
    columns: Mapping[str, Sequence[np.ndarray]],
) -> dict[str, list[np.ndarray]]:
    """1.0 where a sample was read, 0.0 where it was not, of the channels that have blanks."""
    valid = {}
    for channel, values in columns.items():
        finite = [np.isfinite(v) for v in values]
        if not all(f.all() for f in finite):
            valid[channel] = [f.astype(float) for f in finite]
    return valid


def _unique(names: Sequence[str]) -> list[str]:
    """Names of runs, numbered where files of other folders have the same."""
    unique = []
    for k, name in enumerate(names):
        if names.count(name) > 1:
            name = f"{name}_{names[: k + 1].count(name)}"
        unique.append(name)
    return unique


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
