"""Whether estimates allow the numbers that somebody stated: all together, by the smallest change
that the data ask for.

Numbers that hang together are not refuted one by one. Where data tell only a ratio or a sum, many
values of each are as good as the estimate; a stated set is refuted where none of its points is, and
then by as few of its numbers as possible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np


#: A stated number is refuted beyond this many standard deviations; several together where chance
#: takes them as far as rarely.
REFUTED = 3.0
#: A direction of the correlations that holds less than this share of the largest is known exactly,
#: up to rounding.
ROUNDING = 1e-13


def apart(found: float, stated: float, std: float | None) -> float | None:
    """How far a number lies from where it is stated, in standard deviations; None where that is no
    number.
    """
    if std is None or not std > 0:
        return None
    deviation = (found - stated) / std
    return deviation if np.isfinite(deviation) and np.isfinite(std) else None


@dataclass(frozen=True)
class BoundedEstimates:
    """Estimates `value` [n] with `covariance` [n n], between `lower` and `upper` [n]."""

    value: np.ndarray
    covariance: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def beside(self, held: Sequence[int], at: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """All numbers [n] where those that are `held` stand `at` [held], their covariance, and how
        far that is from the estimate (squared, in standard deviations). One that would leave its
        bounds stays at them.
        """
        held, at = list(held), np.asarray(at, float)
        while True:
            value, covariance, far = self._held(held, at)
            std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
            out = (value < self.lower - REFUTED * std) | (value > self.upper + REFUTED * std)
            out &= std > 0
            out[held] = False
            if not out.any():
                break
            beyond = np.flatnonzero(out)
            held = [*held, *map(int, beyond)]
            at = np.concatenate([at, np.clip(value, self.lower, self.upper)[beyond]])
        return np.clip(value, self.lower, self.upper), covariance, far

    def usable(self) -> tuple[BoundedEstimates, np.ndarray]:
        """The same, where what is no number says nothing, and which [n] have an estimate with a
        standard deviation.
        """
        variance = np.diag(self.covariance)
        sure = np.isfinite(self.value) & np.isfinite(variance) & (variance > 0)
        both = np.outer(sure, sure) & np.isfinite(self.covariance)
        return replace(self, covariance=np.where(both, self.covariance, 0.0)), sure

    def _held(self, held: list[int], at: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        if not held:
            return self.value, self.covariance, 0.0
        off = at - self.value[held]
        across = self.covariance[:, held]
        inverse = inverted(self.covariance[np.ix_(held, held)])
        moved = across @ (inverse @ off)
        value = np.where(moved == 0, self.value, self.value + moved)
        value[held] = at
        rest = self.covariance - across @ inverse @ across.T
        rest[held], rest[:, held] = 0.0, 0.0
        return value, (rest + rest.T) / 2, float(off @ inverse @ off)


@dataclass(frozen=True)
class SmallestChange:
    """The smallest change of stated numbers that data allow.

    `refuted` says which of them it changes (positions), `instead` which others might be changed in
    place of one, `value` [n] and `covariance` [n n] of all numbers with the rest as stated.
    `deviation` is how far what is refuted lies from where it is stated, in standard deviations:
    beside the rest as stated, by itself, or as unlikely as all are together, what is most.
    """

    refuted: tuple[int, ...]
    instead: dict[int, tuple[int, ...]]
    value: np.ndarray
    covariance: np.ndarray
    deviation: dict[int, float]

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of each number [n], 0 of those that are as stated."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def smallest_change(known: BoundedEstimates, stated: np.ndarray) -> SmallestChange:
    """What estimates say of `stated` numbers [n] (nan where nothing is stated): see `SmallestChange`.

    Numbers are let go one after the other, each time the one without which the rest comes nearest,
    until chance takes the rest as far from the estimate as it is; then each is tried in its place
    again.
    """
    known, sure = known.usable()
    kept = [int(k) for k in np.flatnonzero(np.isfinite(stated) & sure)]
    gone: list[int] = []
    while kept and not _allowed(known, kept, stated):
        worst = _worst(known, kept, stated)
        kept.remove(worst)
        gone.append(worst)
    for k in list(gone):
        if _allowed(known, [*kept, k], stated):
            gone.remove(k)
            kept.append(k)
    kept.sort()
    instead: dict[int, tuple[int, ...]] = {}
    for k in gone:
        others = [i for i in kept if _allowed(known, _exchanged(kept, i, k), stated)]
        if others:
            instead[k] = tuple(others)
    value, covariance, _ = known.beside(kept, stated[kept])
    deviation = {k: _deviation(known, [*kept, k], stated) for k in gone}
    return SmallestChange(tuple(gone), instead, value, covariance, deviation)


def _deviation(known: BoundedEstimates, kept: Sequence[int], stated: np.ndarray) -> float:
    """How far the last of these is from where it is stated."""
    from scipy.special import chdtrc, chdtri

    kept = list(kept)
    k = kept[-1]
    off = known.value[k] - stated[k]
    _, _, far = known.beside(kept, stated[kept])
    chance = max(float(chdtrc(len(kept), far)), 1e-300)
    sizes = (
        _gains(known, kept, stated)[-1],
        off**2 / known.covariance[k, k],
        float(chdtri(1, chance)),
    )
    side = (
        np.sign(known.beside(kept[:-1], stated[kept[:-1]])[0][k] - stated[k]) or np.sign(off) or 1.0
    )
    return float(side * np.sqrt(max(sizes)))


def _allowed(known: BoundedEstimates, kept: Sequence[int], stated: np.ndarray) -> bool:
    """Whether chance takes these numbers from the estimate to where they are stated: together,
    alone, and beside each other.
    """
    from scipy.special import chdtrc

    if not kept:
        return True
    kept = list(kept)
    off = known.value[kept] - stated[kept]
    if np.any(off**2 > REFUTED**2 * np.diag(known.covariance)[kept]):
        return False
    _, _, far = known.beside(kept, stated[kept])
    together = chdtrc(len(kept), far) >= chdtrc(1, REFUTED**2)
    return bool(together and np.all(_gains(known, kept, stated) <= REFUTED**2))


def _gains(known: BoundedEstimates, kept: Sequence[int], stated: np.ndarray) -> np.ndarray:
    """By how much nearer the rest comes without each of them, squared standard deviations; bounds
    left aside.
    """
    kept = list(kept)
    inverse = inverted(known.covariance[np.ix_(kept, kept)])
    pull = inverse @ (stated[kept] - known.value[kept])
    return pull**2 / np.maximum(np.diag(inverse), 1e-300)


def _worst(known: BoundedEstimates, kept: Sequence[int], stated: np.ndarray) -> int:
    """That without which the rest comes nearest to the estimate, bounds counted."""
    _, _, whole = known.beside(kept, stated[list(kept)])
    gains = _gains(known, kept, stated)
    best, gained = kept[int(np.argmax(gains))], -np.inf
    for i in np.argsort(-gains):
        if gains[i] <= gained:
            break
        rest = [k for k in kept if k != kept[i]]
        _, _, far = known.beside(rest, stated[rest])
        if whole - far > gained:
            best, gained = kept[i], whole - far
    return best


def inverted(covariance: np.ndarray) -> np.ndarray:
    """The inverse of a covariance, in units of its diagonal; what rounding left of a direction
    counts as that.
    """
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / size / size[:, None])
    least = ROUNDING * max(values[-1], 1e-300)
    return (vectors / np.maximum(values, least)) @ vectors.T / size / size[:, None]


def _exchanged(kept: Sequence[int], gone: int, new: int) -> list[int]:
    return [k for k in (*kept, new) if k != gone]
