"""One recording under two names: runs that hold the same samples, noise and all. They are neither
repeats nor fit and validation.

No two recordings share their noise. A copy may be cut shorter, begin later, carry other time
stamps, or be rounded anew.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from jaxid.conventions.finding import DataFinding
from jaxid.conventions.mending import Mending
from jaxid.conventions.samples import LONGEST, Shown
from jaxid.data.dataset import Dataset, Experiment
from jaxid.data.noise import possible_step, quantisation_step
from jaxid.data.time_stamps import differences


#: Samples that are looked for in the other run: where (share of the run), and how many in a row.
ANCHORS, IN_A_ROW = (0.05, 0.25, 0.5, 0.75, 0.95), 8
#: Rows that have to be the same, and places in the other run beyond which what is looked for stands
#: everywhere.
FEWEST, EVERYWHERE = 30, 20
#: Two readings are one where they differ by no more than that share of the step that either is
#: rounded to.
OF_STEP = 0.505
#: A reading that was changed is another one by this many times as much: two recordings differ by
#: neighbouring codes, too.
CHANGED = 4.0
#: White noise is as large in differences of these orders, to that share; motion is not.
ORDERS, ALIKE = (3, 5, 7), 0.25
#: Its fifth differences change sign between 81 % of neighbours; those of a motion do so seldom, on
#: odd clocks always.
CHANGE_SIGN = 0.7, 0.9
MEDIAN = 0.4549  # of the square of a normal number
#: Share of the largest number that six digits round away; and fewer digits, where all numbers have
#: no more.
DIGITS, FEWER = 5e-6, (3, 4, 5)
#: No machine repeats its motion to that share of it: codes that change at the same rows so often
#: that it would have to.
REPEATS_TO = 1e-5
SPLITS = "fit", "validation", "report"


@dataclass(frozen=True)
class RunSamples:
    """All samples of a run [time channels], outputs first, and by how much a reading may be off in
    a copy [channels].
    """

    experiment: Experiment
    samples: np.ndarray
    loose: np.ndarray
    noisy: bool


@dataclass(frozen=True)
class Same:
    """Rows `first` to `stop` of a copy are those of another run from row `at` on, but for some that
    were changed.
    """

    first: int
    stop: int
    at: int
    changed: int


def copies(dataset: Dataset) -> Iterator[Shown]:
    """Runs of which another one holds samples: what comes later, in the order fit, validation,
    report, is the copy.
    """
    order = sorted(dataset.experiments, key=lambda e: SPLITS.index(e.split))
    runs = [_run(dataset, e) for e in order]
    gone: set[str] = set()
    for k, copy in enumerate(runs):
        for other in runs[:k]:
            if other.experiment.name in gone or copy.experiment.name in gone:
                continue
            same = _same(other, copy)
            if same is None:
                continue
            shown = _shown(other, copy, same)
            if shown.finding.decisive and _whole(copy, same):
                gone.add(copy.experiment.name)
            yield shown


def _run(dataset: Dataset, e: Experiment) -> RunSamples:
    """A run with what its channels are rounded to, and whether its outputs show noise."""
    samples = np.concatenate([e.y, e.u], axis=1)[:LONGEST]
    steps = [quantisation_step([x]) or 0.0 for x in samples.T]
    digits = np.array([_rounded_away(x) for x in samples.T])
    loose = np.maximum(OF_STEP * np.array(steps), digits)
    ny = e.y.shape[1]
    noisy = any(
        _noise_shows(e.t[:LONGEST], x, possible_step(x) or 0.0, d)
        for x, d in zip(samples.T[:ny], digits, strict=False)
    )
    return RunSamples(e, samples, loose, noisy)


def _rounded_away(x: np.ndarray) -> float:
    """What the digits of these numbers [time] round away at most."""
    size = np.abs(x[x != 0])
    if not len(size):
        return 0.0
    first = np.floor(np.log10(size))  # place of the first digit
    for count in FEWER:
        in_units = size / 10.0 ** (first - count + 1)
        if np.all(np.abs(in_units - np.round(in_units)) < 1e-6):
            return float(OF_STEP * 10.0 ** (np.max(first) - count + 1))
    return float(DIGITS * np.max(size))


def _noise_shows(t: np.ndarray, x: np.ndarray, step: float, digits: float) -> bool:
    """Whether no second recording would give a reading `x [time]` at `t [time]` s: it shows noise,
    or so many codes change that no machine would change them at the same rows again. Without either
    a motion that is simulated twice is the same.
    """
    if len(x) < FEWEST:
        return False
    # Motion may look like noise by one of them: time stamps scatter, clocks alternate.
    axes = t - t[0], np.arange(len(x), dtype=float)
    white = [_white(at, x, max(step, digits)) for at in axes]
    if None not in white:
        return all(white)
    changes = np.count_nonzero(np.diff(x))
    return bool(step > 10 * digits and step < REPEATS_TO * changes * np.ptp(x))


def _white(at: np.ndarray, x: np.ndarray, grid: float) -> bool | None:
    """Whether what no curve has of readings [time] along an axis `at [time]` is white noise; None
    where a grid hides it.
    """
    apart = [differences(at, x, order)[0] for order in ORDERS]
    levels = [float(np.sqrt(np.median(d**2) / MEDIAN)) for d in apart]
    if min(levels) <= grid:
        return None
    turns = float(np.mean(apart[1][1:] * apart[1][:-1] < 0))
    return CHANGE_SIGN[0] < turns < CHANGE_SIGN[1] and max(levels) < (1 + ALIKE) * min(levels)


def _same(other: RunSamples, copy: RunSamples) -> Same | None:
    """The rows that both hold, the most of them; None where they share none."""
    if (
        other.samples.shape[1] != copy.samples.shape[1]
        or min(len(other.samples), len(copy.samples)) < FEWEST
    ):
        return None
    loose = np.maximum(other.loose, copy.loose)
    found = [
        _along(other, copy, offset, loose)
        for offset in _offsets(other.samples, copy.samples, loose)
    ]
    return max((s for s in found if s is not None), key=lambda s: s.stop - s.first, default=None)


def _offsets(other: np.ndarray, copy: np.ndarray, loose: np.ndarray) -> set[int]:
    """By how many rows samples of a copy [time channels] stand later in the other run."""
    varied = int(np.argmax([len(np.unique(x)) for x in copy.T]))
    found: set[int] = set()
    for share in ANCHORS:
        first = min(int(share * len(copy)), len(copy) - IN_A_ROW)
        places = np.flatnonzero(np.abs(other[:, varied] - copy[first, varied]) <= loose[varied])
        for k in range(IN_A_ROW):
            places = places[places + k < len(other)]
            near = np.abs(other[places + k] - copy[first + k]) <= loose
            places = places[np.all(near, axis=1)]
        if len(places) <= EVERYWHERE:
            found |= set((places - first).tolist())
    return found


def _along(other: RunSamples, copy: RunSamples, offset: int, loose: np.ndarray) -> Same | None:
    """The rows of a copy that lie within the other run, which stands `offset` rows later; None
    where more than a few of them differ.
    """
    first = max(0, -offset)
    stop = min(len(copy.samples), len(other.samples) - offset)
    if stop - first < FEWEST:
        return None
    apart = np.abs(copy.samples[first:stop] - other.samples[first + offset : stop + offset])
    if np.any((apart > loose) & (apart <= CHANGED * loose)):
        return None
    changed = int(np.count_nonzero(np.any(apart > loose, axis=1)))
    moves = np.any(np.ptp(copy.samples[first:stop, : copy.experiment.y.shape[1]], axis=0) > 0)
    few = IN_A_ROW * changed <= stop - first
    return Same(first, stop, first + offset, changed) if moves and few else None


def _whole(copy: RunSamples, same: Same) -> bool:
    """Whether hardly anything of a copy is its own."""
    return len(copy.samples) - (same.stop - same.first) < FEWEST


def _shown(other: RunSamples, copy: RunSamples, same: Same) -> Shown:
    name, of = copy.experiment.name, other.experiment.name
    whole = _whole(copy, same)
    count = same.stop - same.first
    sure = other.noisy or copy.noisy  # what one of them rounds away shows in the other
    t, there = copy.experiment.t, other.experiment.t
    if whole and count == len(other.samples):
        holds = f"{name} holds {of} sample for sample"
    elif whole:
        holds = (
            f"{name} holds {count} samples of {of}, from {there[same.at]:.4g} s on, sample for"
            " sample"
        )
    else:
        holds = (
            f"{name} holds {count} samples of {of} from {t[same.first]:.4g} s to"
            f" {t[same.stop - 1]:.4g} s, sample for sample"
        )
    if same.changed:
        holds += f" but for {same.changed}"
    noise = ", noise and all" if sure else ""
    doubt = (
        ""
        if sure
        else " Without noise a simulation that is run twice does so, too: nothing is left out here."
    )
    what = name if whole else f"these samples of {name}"
    finding = DataFinding(
        "copy",
        name,
        float(count),
        f"{holds}{noise}: one recording under two names, neither a validation of the other nor a"
        f" repeat. Leave {what} out.{doubt}",
        decisive=sure,
        headline=f"{holds}; everything below leaves {'it' if whole else 'these samples'} out",
    )
    first, stop = (0, len(copy.experiment)) if whole else (same.first, same.stop)
    return Shown(finding, Mending(left_out=((name, first, stop),)) if sure else Mending())
