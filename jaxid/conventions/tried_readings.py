"""Readings of a recording, each tried: what it leaves of the drive that the model lacks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from jaxid.conventions.equal_scales import Judged, likeliest_scales, refuted_beside
from jaxid.conventions.limits import ALIKE, FLOOR, GONE, WHOLE
from jaxid.conventions.missing_force import ForceFit, ReadingFit
from jaxid.conventions.readings import (
    exchanges,
    Names,
    Reading,
    refinement,
    scale_of,
    scales,
    signs,
    zeros,
)
from jaxid.force.columns import FEW
from jaxid.force.sampled_motion import SampledMotion
from jaxid.numerics.pool import Pool
from jaxid.numerics.stated_numbers import REFUTED
from jaxid.problem.binding import Binding


#: Channels, or sets of them, whose factor is sought beyond the values that it is looked for at.
SOUGHT = 3
_POOL = Pool("readings")


@dataclass(frozen=True)
class ReadingQuestion:
    """A motion of which a reading may explain what is left: `recorded` is what the model leaves of
    it, beside laws of the joints' own motion where `laws`, and `beside` what it leaves beside them.
    """

    binding: Binding
    fit: ForceFit
    m: SampledMotion
    names: Names
    many: bool
    recorded: ReadingFit
    beside: ReadingFit
    laws: bool

    @property
    def before(self) -> float:
        """What is left of the drive."""
        return self.recorded.worst + FLOOR

    @property
    def hopeless(self) -> float:
        """A reading that leaves more is given up."""
        return ALIKE * GONE * self.before

    @cached_property
    def few(self) -> SampledMotion:
        """The motion at as many samples as all readings are gone through on."""
        return self.m.thinned(FEW) if self.many else self.m


class RankedReadings(NamedTuple):
    """The best reading, the equal ones of its kind, and all that come near."""

    best: Judged
    same: list[Judged]
    near: list[Judged]

    @property
    def elsewhere(self) -> bool:
        """Whether an equal one is of other channels."""
        channels = self.best.reading.channels
        return any(t.reading.channels != channels for t in self.same)


def unexplained(asked: ReadingQuestion) -> bool:
    """Whether more is left than rounding and noise leave."""
    before = asked.before
    if not np.isfinite(before) or before <= 2 * FLOOR:
        return False
    noise = asked.fit.least_noise(asked.recorded, asked.binding, asked.few)
    return before > ALIKE * (noise + FLOOR)


def all_tried(asked: ReadingQuestion) -> list[Judged]:
    """What readings leave, the least first, up to those that leave next to nothing."""
    tried: list[Judged] = []
    for readings, size in _readings(asked.names, asked.fit.driven):
        own = _of_a_size(asked, readings) if size else _on_few(asked, readings, asked.hopeless)
        if asked.many:
            own = _on_all(asked, own)
        tried = sorted([*tried, *own], key=_left)
        enough = WHOLE * min(asked.before, 1.0)  # most of a drive is no remainder
        if tried and tried[0].left <= enough:
            break
    return [t for t in tried if np.isfinite(t.left)]


def _of_a_size(asked: ReadingQuestion, readings: list[Reading]) -> list[Judged]:
    """Those of a size that may be any: at values that it is looked for at, of which the nearest may
    be some way from it, and at the best one.
    """
    own = _on_few(asked, readings, asked.before)
    sized = _sized(asked.fit, asked.few, own, asked.names, asked.hopeless, asked.laws)
    return sorted([*own, *sized], key=_left)


def _on_few(asked: ReadingQuestion, readings: list[Reading], hopeless: float) -> list[Judged]:
    return tried_readings(asked.fit, asked.few, readings, hopeless, asked.laws)


def _on_all(asked: ReadingQuestion, own: list[Judged]) -> list[Judged]:
    """On all samples those that may come out on top."""
    again = [t.reading for t in own if t.left <= min(ALIKE**2 * own[0].left, asked.hopeless)]
    return tried_readings(asked.fit, asked.m, again, asked.hopeless, asked.laws)


def _left(judged: Judged) -> float:
    return judged.left


def ranked(asked: ReadingQuestion, tried: list[Judged]) -> RankedReadings:
    """The best of those tried, of equals that which leaves the model's numbers as stated."""
    fit, names = asked.fit, asked.names
    best = tried[0]
    most = ALIKE * best.left
    kind = best.reading.kind
    same = [t for t in tried[1:] if t.left <= most and t.reading.kind == kind]
    if kind in ("sign", "swapped_channels"):
        best, *same = _nearest_stated(fit, names, [best, *same])
    if kind == "scale":
        best, *same = likeliest_scales(fit, names, [best, *same])
    near = [t for t in tried if t is not best and t.left <= most]
    near = [t for t in near if not refuted_beside(fit, best, t)]
    return RankedReadings(best, same, near)


def _nearest_stated(fit: ForceFit, names: Names, equals: list[Judged]) -> list[Judged]:
    """Of equals first those that leave the model's numbers as they are stated: an angle and its
    goal that both count the other way differ by the sign of the weight alone. Of these the one of
    least channels, inputs before outputs (the order in which readings are made).
    """
    order = [r.channels for r in (*signs(names), *exchanges(names))]

    def rank(judged: Judged) -> tuple[bool, int, int]:
        channels = judged.reading.channels
        return fit.off_stated(judged.fitted) > REFUTED, len(channels), order.index(channels)

    return sorted(equals, key=rank)


def tried_readings(
    fit: ForceFit, m: SampledMotion, readings: list[Reading], hopeless: float, laws: bool
) -> list[Judged]:
    """What readings of a motion leave, the least first; what is `hopeless` is given up."""
    found = _POOL.map(lambda r: Judged(r, fit.fit(r.change(m), laws, hopeless=hopeless)), readings)
    return sorted((t for t in found if np.isfinite(t.left)), key=_left)


def _readings(names: Names, driven: bool) -> Iterator[tuple[list[Reading], bool]]:
    """Those that a fault may be, the many last, and whether they are of a size that may be any."""
    turned = [*signs(names), *exchanges(names)] if driven else []
    yield [*turned, *zeros(names)], False
    yield list(scales(names)), True


def _sized(
    fit: ForceFit, m: SampledMotion, tried: list[Judged], names: Names, hopeless: float, laws: bool
) -> list[Judged]:
    """The scales of the channels that come nearest, at the factor that leaves the least."""
    nearest: dict[tuple[str, ...], Judged] = {}
    for t in tried:
        nearest.setdefault(t.reading.channels, t)
    found = list(
        _POOL.map(lambda t: _sought(fit, m, t, names, laws), list(nearest.values())[:SOUGHT])
    )
    return tried_readings(fit, m, found, hopeless, laws)


def _sought(fit: ForceFit, m: SampledMotion, start: Judged, names: Names, laws: bool) -> Reading:
    """The scale of these channels that leaves the least, from the one that they start at."""
    refined = refinement(start.reading, names)
    assert refined is not None
    more, size = refined
    fitted = fit.fit(m, laws, more=lambda x: more(m, x), size=1, begin=start.fitted.x)
    return scale_of(names, start.reading.channels, size(float(fitted.x[len(fit.free)])))
