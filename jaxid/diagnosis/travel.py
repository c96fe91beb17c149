"""The part of a joint's travel in which the missing force is another one than elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TYPE_CHECKING

import numpy as np

from jaxid.diagnosis.regimes import STANDS


if TYPE_CHECKING:
    from jaxid.diagnosis.missing import Missing


#: Most stretches that the travel is divided into, samples of one on average, and the fewest with
#: which it is looked at.
STRETCHES, MEAN, LEAST = 40, 60, 20
#: Share of the travel beyond which a part of it is the rule and no place.
WIDEST = 0.5


class TravelPart(NamedTuple):
    """From where to where, by how much the force is larger there than elsewhere, and whether this
    is a force against the motion; `energy`: of that difference, summed over samples.
    """

    low: float
    high: float
    more: float
    against: bool
    energy: float

    def masks(self, found: Sequence[Missing], joint: int) -> list[np.ndarray]:
        """Which samples lie in it [runs][time]."""
        return [(m.q[:, joint] >= self.low) & (m.q[:, joint] < self.high) for m in found]


def part_of_travel(
    found: Sequence[Missing], joint: int, force: Sequence[np.ndarray]
) -> TravelPart | None:
    """Where a force [runs][time] differs most from its median over the travel, as far as half of
    that: as a force of one sign, or against the motion. None where the joint hardly travels, or
    where that is most of the travel.
    """
    q = np.concatenate([m.q[:, joint] for m in found])
    speed = np.concatenate([m.qd[:, joint] for m in found])
    values = np.concatenate(force)
    moving = np.abs(speed) > STANDS * np.percentile(np.abs(speed), 99)
    low, high = np.percentile(q, [0.5, 99.5])
    if not high > low:
        return None
    stretches = min(STRETCHES, len(q) // MEAN)
    if stretches < 2:
        return None
    edges = np.linspace(low, high, stretches + 1)
    either_way = _part(edges, q, values, against=False)
    against = _part(edges, q[moving], (values * np.sign(speed))[moving], against=True)
    parts = [part for part in (either_way, against) if part is not None]
    return max(parts, key=lambda part: part.energy, default=None)


def _part(edges: np.ndarray, q: np.ndarray, values: np.ndarray, against: bool) -> TravelPart | None:
    inside = (q >= edges[0]) & (q < edges[-1])
    stretches = len(edges) - 1
    stretch = np.searchsorted(edges, q[inside], side="right") - 1
    count = np.bincount(stretch, minlength=stretches)
    total = np.bincount(stretch, values[inside], minlength=stretches)
    seen = count >= LEAST
    if seen.sum() < stretches / 2:
        return None
    mean = total / np.maximum(count, 1)
    more = np.where(seen, mean - np.median(mean[seen]), 0.0)
    peak = int(np.argmax(np.abs(more) * np.sqrt(count)))
    level = more / more[peak] if more[peak] else more
    first = last = peak
    while first > 0 and level[first - 1] >= 0.5:
        first -= 1
    while last < stretches - 1 and level[last + 1] >= 0.5:
        last += 1
    own = slice(first, last + 1)
    if last + 1 - first > WIDEST * stretches or not more[peak]:
        return None
    return TravelPart(
        low=float(edges[first]),
        high=float(edges[last + 1]),
        more=float(np.average(more[own], weights=count[own])),
        against=against,
        energy=float(np.sum(count[own] * more[own] ** 2)),
    )
