"""Runs that repeat one another, and what they differ by from first to last where that goes one way:
a machine that warms up, a sensor that drifts. One way is no scatter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from jaxid.base.wording import listed, names_of
from jaxid.data.dataset import Dataset, Experiment


#: Of this many runs in any order, one in sixty changes one way by chance; of four, one in twelve,
#: so they have to settle, too.
FEWEST, ENOUGH = 4, 5
#: Share of what repeats differ by that goes along one pattern: noise of five runs shares a quarter
#: with each.
ONE_PATTERN = 0.5


@dataclass(frozen=True)
class OneWay:
    """Repeats that change one way, in their order, and the root mean square by which the last one
    is off the first [ny].
    """

    runs: tuple[Experiment, ...]
    apart: np.ndarray


def repeats(runs: Sequence[Experiment]) -> list[list[Experiment]]:
    """Groups of two and more runs with the same inputs at the same times, the same constants and
    the same start, or of which one is stated to repeat the other; one may stop before the other,
    but not before half of it. Where no input changes, the start has to be stated.
    """
    groups: list[list[Experiment]] = []
    for run in runs:
        group = next((g for g in groups if _same_conditions(g[0], run)), None)
        if group is None:
            groups.append([run])
        else:
            group.append(run)
    return [g for g in groups if len(g) > 1]


def _same_conditions(a: Experiment, b: Experiment) -> bool:
    count = min(len(a), len(b))
    if 2 * count < max(len(a), len(b)):
        return False
    times = float(np.max(np.abs((a.t[:count] - a.t[0]) - (b.t[:count] - b.t[0]))))
    if times > 0.01 * float(np.median(np.diff(a.t))):
        return False
    stated = a.repeat_of == b.name or b.repeat_of in (a.name, a.repeat_of or b.name)
    if stated:
        return True
    if not np.array_equal(a.u[:count], b.u[:count]):
        return False
    if (a.constants, a.initial, a.at_rest) != (b.constants, b.initial, b.at_rest):
        return False
    if a.initial is not None or a.at_rest:
        return True
    # A motion that no input makes comes from its start alone, speeds and all.
    if not np.any(a.u[:count] != a.u[0]):
        return False
    # A start that nobody states must at least look the same.
    return bool(np.all(np.abs(a.y[0] - b.y[0]) <= 0.02 * np.ptp(a.y, axis=0)))


def together(group: Sequence[Experiment]) -> np.ndarray:
    """The motions of repeats as far as they all go [runs time ny]."""
    count = min(map(len, group))
    return np.stack([e.motion()[:count] for e in group])


def one_way(runs: Sequence[Experiment]) -> list[OneWay]:
    """Groups of repeats, in the order in which they are listed, that change one way from the first
    to the last.
    """
    return [found for group in repeats(runs) if (found := _one_way(group)) is not None]


def _one_way(group: list[Experiment]) -> OneWay | None:
    """See `one_way`: the runs' place along the pattern by which they differ most."""
    if len(group) < FEWEST:
        return None
    motions = together(group)
    size = np.maximum(np.ptp(motions, axis=(0, 1)), 1e-300)
    off = ((motions - motions.mean(0)) / size).reshape(len(group), -1)
    squares, patterns = np.linalg.eigh(off @ off.T)
    if not squares[-1] > ONE_PATTERN * np.trace(off @ off.T):
        return None
    steps = np.diff(patterns[:, -1])
    rises = bool(np.all(steps > 0) or np.all(steps < 0))
    settles = all(abs(later) < abs(earlier) for earlier, later in pairwise(steps))
    if not rises or (len(group) < ENOUGH and not settles):
        return None
    apart = np.sqrt(np.mean((motions[-1] - motions[0]) ** 2, axis=0))
    return OneWay(tuple(group), apart)


def one_way_sentences(dataset: Dataset) -> list[str]:
    """What is said of repeats that change one way."""
    return [_sentence(dataset, found) for found in one_way(dataset.experiments)]


def _sentence(dataset: Dataset, found: OneWay) -> str:
    names = names_of(found.runs)
    told = listed(names) if len(names) <= 6 else f"{names[0]} to {names[-1]}"
    moved = [
        f"{off:.2g} {c.unit} in {c.name}"
        for off, c in zip(found.apart, dataset.outputs, strict=True)
    ]
    return (
        f"{len(names)} runs of one input change one way, run by run: {told}. The last differs from"
        f" the first by {listed(moved)} (root mean square). That is a drift, as of friction that"
        " falls while a machine warms up, and no scatter: the noise floor leaves it out."
    )
