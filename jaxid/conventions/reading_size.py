"""How large a reading of a recording is, and which convention its size stands for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxid.conventions.equal_scales import far, Judged, of_many
from jaxid.conventions.limits import ALIKE, ASKED, FLOOR, MISFIT, TOLD, WHOLE
from jaxid.conventions.readings import (
    Names,
    nearest_convention,
    nearest_factor,
    offset_joint,
    Reading,
    refinement,
    unmistakable,
)
from jaxid.conventions.tried_readings import RankedReadings, ReadingQuestion, tried_readings
from jaxid.force.sampled_motion import SampledMotion


Change = Callable[[SampledMotion], SampledMotion]


class Size(NamedTuple):
    """How large a reading is: `what` it is called, what it changes of a motion, and whether it is
    `conventional`, a convention's own value.
    """

    value: float
    interval: tuple[float, float] | None
    what: str
    change: Change
    conventional: bool = True


def size_of(asked: ReadingQuestion, ranked: RankedReadings) -> Size:
    """The size of the best reading. Beside what the model lacks many sizes are alike; less what
    laws take, one is not.
    """
    best, near = ranked.best, ranked.near
    size = _refined(asked, best, near)
    if size.conventional or asked.laws:
        return size
    channels = best.reading.channels
    again = [t.reading for t in (best, *near) if t.reading.channels == channels]
    own = tried_readings(asked.fit, asked.m, again, asked.hopeless, True)
    if not own:
        return size
    near_own = [t for t in own[1:] if t.left <= ALIKE * own[0].left]
    return _refined(replace(asked, laws=True), own[0], near_own)


def known_beside(asked: ReadingQuestion, best: Judged, size: Size) -> Size | None:
    """A known factor next to a fitted one, of which stated numbers that are off take the rest; None
    where there is none that takes most of the gap by itself.
    """
    factors = asked.names.factors(best.reading.channels[0])
    factor, what = nearest_factor(size.value, factors)
    if abs(np.log(size.value / factor)) > MISFIT:
        return None
    change = _scaled(replace(best.reading, value=factor), asked.names)
    left = asked.fit.fit(change(asked.m), asked.laws).worst + FLOOR
    if not left <= ASKED * asked.before:
        return None
    return Size(factor, size.interval, what, change)


class Fitted(NamedTuple):
    """A size as it was fitted: its value with standard deviation (of its variable), the interval
    where it is known well, and what it leaves of the drive.
    """

    value: float
    std: float
    interval: tuple[float, float] | None
    left: float


def _fitted(asked: ReadingQuestion, best: Judged) -> Fitted:
    """The size at which a reading leaves the least."""
    fit = asked.fit
    refined = refinement(best.reading, asked.names)
    assert refined is not None
    more, size = refined
    found = fit.fit(
        asked.m, asked.laws, more=lambda x: more(asked.m, x), size=1, begin=best.fitted.x
    )
    at = len(fit.free)
    x = float(found.x[at])
    _, std = fit.spread(found, replace(asked.m), at)
    interval = None
    if std < TOLD:
        interval = size(x - 1.96 * std), size(x + 1.96 * std)
    return Fitted(size(x), std, interval, found.worst + FLOOR)


def _refined(asked: ReadingQuestion, best: Judged, near: list[Judged]) -> Size:
    """The size of a reading that has one. A known factor is one where it leaves as little as any
    other and none of those that come `near` is far from it.
    """
    fitted = _fitted(asked, best)
    if best.reading.kind == "zero":
        return _zero(asked, best, fitted)
    return _scale(asked, best, near, fitted)


def _zero(asked: ReadingQuestion, best: Judged, fitted: Fitted) -> Size:
    j = asked.names.joints.index(best.reading.channels[0])
    travel = float(np.ptp(asked.m.q[:, j]))
    own = nearest_convention("zero", {}, fitted.value, fitted.std, travel)
    if own is None:
        return _of_no_convention(best, fitted)
    value, what = own
    return Size(value, fitted.interval, what, lambda m: offset_joint(m, j, -value))


def _scale(asked: ReadingQuestion, best: Judged, near: list[Judged], fitted: Fitted) -> Size:
    names, reading = asked.names, best.reading
    known = names.factors(reading.channels[0])
    fitted = _at_a_known_factor(asked, best, fitted, known)
    factor, what = nearest_factor(fitted.value, known)
    change = _scaled(replace(reading, value=factor), names)
    alone = unmistakable(fitted.value, fitted.std, known) and not far(best, near, factor)
    if alone and _as_little(asked, change, fitted):
        return Size(factor, fitted.interval, what, change)
    own = of_many(
        asked.fit,
        asked.m,
        best=best,
        near=near,
        names=names,
        value=fitted.value,
        own=nearest_convention("scale", known, fitted.value, fitted.std, travel=0.0),
        laws=asked.laws,
    )
    if own is None:
        return _of_no_convention(best, fitted)
    value, what = own
    change = _scaled(replace(reading, value=value), names)
    return Size(value, fitted.interval, what, change)


def _at_a_known_factor(
    asked: ReadingQuestion, best: Judged, fitted: Fitted, known: Mapping[str, float]
) -> Fitted:
    """At the known factor that was tried, where that is all of the answer and no other size leaves
    less; else as it is.
    """
    own, _ = nearest_factor(best.reading.value, known)
    tried = abs(np.log(best.reading.value / own)) < 1e-3
    whole = best.left <= min(WHOLE * asked.before, fitted.left)
    if not (tried and whole):
        return fitted
    interval = fitted.interval
    if interval is not None and not interval[0] <= own <= interval[1]:
        interval = None
    return fitted._replace(value=own, interval=interval)


def _as_little(asked: ReadingQuestion, change: Change, fitted: Fitted) -> bool:
    """Whether a known factor leaves as little as the fitted one."""
    left = asked.fit.fit(change(asked.m), asked.laws).worst + FLOOR
    return left <= ALIKE * fitted.left


def _of_no_convention(best: Judged, fitted: Fitted) -> Size:
    return Size(fitted.value, fitted.interval, "", best.reading.change, conventional=False)


def _scaled(reading: Reading, names: Names) -> Change:
    refined = refinement(reading, names)
    assert refined is not None
    change, _ = refined
    return lambda m: change(m, np.zeros(1))
