"""Scales of a recording that explain as much: which of them what is stated of the model allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.conventions.limits import ALIKE, APART, FLOOR
from jaxid.conventions.missing_force import ForceFit, ReadingFit
from jaxid.conventions.readings import (
    EFFECT_RANGE,
    FREE,
    GEAR,
    NAMED,
    Names,
    nearest_factor,
    Reading,
    scale_of,
)
from jaxid.force.sampled_motion import SampledMotion
from jaxid.numerics.stated_numbers import REFUTED


#: Logarithm of a factor, to each side, to which those that fit alike are gone through.
FARTHEST = 3.0


@dataclass(frozen=True)
class Judged:
    """A reading with what it leaves of the drive."""

    reading: Reading
    fitted: ReadingFit

    @property
    def left(self) -> float:
        return self.fitted.worst + FLOOR


def likeliest_scales(fit: ForceFit, names: Names, equals: list[Judged]) -> list[Judged]:
    """Of equals first those that leave the model's numbers as they are stated, and of these one
    that has a name; without those that what is stated refutes where it does not refute all.
    """

    def rank(judged: Judged) -> tuple[bool, bool, float]:
        off = fit.off_stated(judged.fitted) > REFUTED
        return off, not _named(judged.reading, names), judged.left

    best, *same = sorted(equals, key=rank)
    return [best, *(t for t in same if not refuted_beside(fit, best, t))]


def refuted_beside(fit: ForceFit, best: Judged, other: Judged) -> bool:
    """Whether what is stated refutes another scale and not this one."""
    if best.reading.kind != "scale" or other.reading.kind != "scale":
        return False
    return fit.off_stated(best.fitted) <= REFUTED < fit.off_stated(other.fitted)


def _named(reading: Reading, names: Names) -> bool:
    """Whether a scale is that of a known slip, as far as a fit tells."""
    factor, _ = nearest_factor(reading.value, names.factors(reading.channels[0]))
    return abs(np.log(reading.value / factor)) < NAMED


def of_many(
    fit: ForceFit,
    m: SampledMotion,
    best: Judged,
    near: Sequence[Judged],
    names: Names,
    value: float,
    own: tuple[float, str] | None,
    laws: bool,
) -> tuple[float, str] | None:
    """The convention that a fitted factor `value` stands for, `own` by itself: of many factors that
    fit alike the one by which the model's numbers are nearest to what is stated of
    them. Where that tells nothing a known factor stands, and what has no name is none.
    """
    if not far(best, near, value if own is None else own[0]):
        return own
    steps = np.linspace(-FARTHEST, FARTHEST, 4 * int(FARTHEST) + 1)
    sizes = best.reading.value * np.exp(steps)
    off = _off_stated(fit, m, best, names, sizes, laws)
    told = np.nanmin(off, initial=np.inf) <= REFUTED < np.nanmax(off, initial=0.0)
    if not told:
        return own if own is not None and own[1] not in (FREE, GEAR) else None
    value = float(sizes[int(np.nanargmin(off))])
    low, high = EFFECT_RANGE
    return None if low < value < high else (value, FREE)


def _off_stated(
    fit: ForceFit, m: SampledMotion, best: Judged, names: Names, sizes: np.ndarray, laws: bool
) -> np.ndarray:
    """How far each of these factors takes a number from what is stated of it; NaN where the factor
    does not fit as well as the best one.
    """
    off = np.full(len(sizes), np.nan)
    for k, size in enumerate(sizes):
        reading = scale_of(names, best.reading.channels, float(size))
        fitted = fit.fit(reading.change(m), laws, begin=best.fitted.x)
        if fitted.worst <= ALIKE * best.left:
            off[k] = fit.off_stated(fitted)
    return off


def far(best: Judged, near: Sequence[Judged], factor: float) -> bool:
    """Whether a factor of the same channel that leaves as little lies far from this one."""
    what = best.reading.kind, best.reading.channels
    own = [t.reading.value for t in near if (t.reading.kind, t.reading.channels) == what]
    return any(abs(np.log(value / factor)) > APART for value in own)
