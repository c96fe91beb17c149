"""Which reading of a recording a model speaks for: decisive, a question, or none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from jaxid.conventions.equal_scales import (
    far,
    Judged,
    likeliest_scales,
    of_many,
    refuted_beside,
)
from jaxid.conventions.finding import DataFinding
from jaxid.conventions.limits import ALIKE, ASKED, FLOOR, GONE, MISFIT, TOLD, WHOLE
from jaxid.conventions.mending import Mending
from jaxid.conventions.missing_force import ForceFit, ReadingFit
from jaxid.conventions.reading_words import doubt_of, headline, mending_lines, sentence
from jaxid.conventions.readings import (
    exchanges,
    FREE,
    GEAR,
    mending_of,
    Names,
    nearest_convention,
    nearest_factor,
    offset_joint,
    Reading,
    refinement,
    scale_of,
    scales,
    signs,
    unmistakable,
    zeros,
)
from jaxid.conventions.samples import Shown
from jaxid.conventions.timing import timed, whole_rows_tell
from jaxid.conventions.unsigned import unsigned
from jaxid.force.columns import FEW
from jaxid.force.sampled_motion import SampledMotion
from jaxid.numerics.pool import Pool
from jaxid.numerics.stated_numbers import REFUTED
from jaxid.problem.binding import Binding


MOST = 4  # findings, one after another
#: Channels, or sets of them, whose factor is sought beyond the values that it is looked for at.
SOUGHT = 3
_POOL = Pool("readings")


def judged(
    binding: Binding, fit: ForceFit, motion: SampledMotion, many: bool = False
) -> Iterator[Shown]:
    """Findings that need the model, one after another: each is looked for in what the decisive ones
    before it leave. `many`: the model has so many numbers that readings are gone through on few
    samples first, and times are asked for where one row more or less tells.
    """
    names, m, asked = Names(binding), motion, None
    for _ in range(MOST):
        shown, changed = _next(binding, fit, m, names, many)
        if changed is None:
            asked = shown
            break
        if shown is not None:
            yield shown
        m = changed
    few = m.thinned(FEW) if many else m
    timing = fit.driven and (not many or whole_rows_tell(fit, few))
    size_alone = unsigned(binding, fit, few, names) if timing else None
    if (
        asked is not None and size_alone is None
    ):  # without its sign an input looks like many a thing
        yield asked
    if timing:
        yield from timed(binding, fit, few, names)
    if size_alone is not None:
        yield size_alone


def _next(
    binding: Binding, fit: ForceFit, m: SampledMotion, names: Names, many: bool = False
) -> tuple[Shown | None, SampledMotion | None]:
    """The next finding, and the motion without it. A fault beside a strong effect that the model
    lacks hides in what that leaves: where laws of the joints' own motion take much of the gap, what
    nothing explains of the whole is asked of what they leave.
    """
    plain, beside = fit.fit(m, False), fit.fit(m, True)
    found = _claimed(binding, fit, m, names, many, plain, beside, laws=False)
    if found is not None and found[0].finding.decisive:
        return found
    if beside.worst + FLOOR <= GONE * (plain.worst + FLOOR):
        less = _claimed(binding, fit, m, names, many, plain, beside, laws=True)
        if less is not None and (found is None or less[0].finding.decisive):
            return less
    return found or (None, None)


def _claimed(
    binding: Binding,
    fit: ForceFit,
    m: SampledMotion,
    names: Names,
    many: bool,
    plain: ReadingFit,
    beside: ReadingFit,
    laws: bool,
) -> tuple[Shown, SampledMotion | None] | None:
    """What a reading explains of what is left of the motion as it is, `plain` or `beside` laws."""
    recorded = beside if laws else plain
    before = recorded.worst + FLOOR
    few = m.thinned(FEW) if many else m
    if not np.isfinite(before) or before <= 2 * FLOOR:
        return None
    if not before > ALIKE * (fit.least_noise(recorded, binding, few) + FLOOR):
        return None
    tried: list[Judged] = []
    hopeless = ALIKE * GONE * before
    for readings, size in _readings(names, fit.driven):
        # The nearest of the values that a size is looked for at may be some way from it.
        own = _tried(fit, few, readings, before if size else hopeless, laws)
        if size:
            own = sorted(
                [*own, *_sized(fit, few, own, names, hopeless, laws)], key=lambda t: t.left
            )
        if many:  # on all samples those that may come out on top
            own = [t for t in own if t.left <= min(ALIKE**2 * own[0].left, hopeless)]
            own = _tried(fit, m, [t.reading for t in own], hopeless, laws)
        tried = sorted([*tried, *own], key=lambda t: t.left)
        if tried and tried[0].left <= WHOLE * min(before, 1.0):  # most of a drive is no remainder
            break
    tried = [t for t in tried if np.isfinite(t.left)]
    if not tried or not tried[0].left <= GONE * before:
        return None
    best = tried[0]
    near = [t for t in tried[1:] if t.left <= ALIKE * best.left]
    same = [t for t in near if t.reading.kind == best.reading.kind]
    if best.reading.kind in ("sign", "swapped_channels"):
        best, *same = _nearest_stated(fit, names, [best, *same])
    if best.reading.kind == "scale":
        best, *same = likeliest_scales(fit, names, [best, *same])
    near = [t for t in tried if t is not best and t.left <= ALIKE * tried[0].left]
    near = [t for t in near if not refuted_beside(fit, best, t)]
    value, interval, what, stated_off = best.reading.value, None, best.reading.what, False
    others = {t.reading.kind for t in near} - {best.reading.kind}
    if best.reading.kind == "sign" and _rivals(fit, best, same):
        others |= {"another channel"}
    change = best.reading.change
    if (refined := _refined(fit, m, best, names, near, before, laws)) is not None:
        value, interval, what, change, conventional = refined
        if (
            not conventional and not laws
        ):  # beside what the model lacks many sizes are alike; less what laws take, one is not
            own = _tried(
                fit,
                m,
                [t.reading for t in (best, *near) if t.reading.channels == best.reading.channels],
                hopeless,
                True,
            )
            near_own = [t for t in own[1:] if t.left <= ALIKE * own[0].left]
            value, interval, what, change, conventional = (
                _refined(fit, m, own[0], names, near_own, before, True) or refined
            )
        if not conventional:
            return None
        if what == FREE:
            known = _known_beside(fit, m, best, names, value, before, laws)
            value, what, change = known or (value, what, change)
            stated_off = known is not None
        others |= {"another channel" for t in same if t.reading.channels != best.reading.channels}
    left = fit.fit(change(m), laws)
    if not np.isfinite([value, left.worst, left.left]).all():
        return None
    closes = max(best.left, left.worst + FLOOR) <= GONE * before  # with its known value, too
    # Beside any law it has to be the whole answer: what has another cause goes some way by many a
    # reading. It has to show in what is fitted, too: held-out motion alone tells how laws that the
    # model lacks extrapolate.
    closes &= ALIKE * (left.left + FLOOR) <= recorded.left + FLOOR
    # What leaves as much as the whole drive explains nothing of it, but for a known slip beside
    # numbers that are stated and off.
    known = best.reading.kind == "scale" and what not in (FREE, GEAR)
    if known and not laws and left.worst > 1.0:
        stated_off = left.worst + FLOOR <= WHOLE * before
    if not closes or (left.worst > (FLOOR if laws else 1.0) and not (stated_off and not laws)):
        return None
    beyond = laws or _beyond(fit, change(m), beside, left, what not in (FREE, GEAR))
    if not beyond and left.worst + FLOOR > ASKED * before:
        return None
    # A factor without a name, and one beside which stated numbers are off, may be those numbers'.
    unnamed = what == FREE or stated_off or (what == GEAR and _bounded(binding))
    decisive = beyond and not others and not unnamed
    mending = mending_of(best.reading, value, {})
    noise = max(fit.noise(left, binding, few), 1e-6)
    alike = tuple(
        dict.fromkeys(
            (t.reading.kind, c)
            for t in (near if others else same)
            for c in t.reading.channels
            if t.reading.kind != best.reading.kind or c not in best.reading.channels
        )
    )
    finding = DataFinding(
        kind=best.reading.kind,
        channel=best.reading.channels[0],
        value=value,
        text=sentence(
            best.reading,
            value,
            what,
            (before, left.worst + FLOOR),
            doubt_of(beyond, bool(others), unnamed),
            laws,
        ),
        line=mending_lines(binding, best.reading, mending),
        interval_95=interval,
        gap_before=recorded.worst / noise,
        gap_if_mended=left.worst / noise,
        decisive=decisive,
        same_as=alike,
        headline=headline(best.reading, value, binding, what),
    )
    return Shown(finding, mending if decisive else Mending(), laws), (
        change(m) if decisive else None
    )


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


def _rivals(fit: ForceFit, best: Judged, same: list[Judged]) -> list[Judged]:
    """Equals of a reading by which the model has other numbers, and which what is stated does not
    refute.
    """
    found = []
    stated = fit.off_stated(best.fitted) <= REFUTED
    for other in same:
        mirrored = fit.apart(best.fitted, other.fitted) <= REFUTED
        refuted = stated and fit.off_stated(other.fitted) > REFUTED
        if not mirrored and not refuted:
            found.append(other)
    return found


def _bounded(binding: Binding) -> bool:
    """Whether the user states bounds: what a free factor explains may be theirs."""
    priors = binding.dataset.stated.parameters.values()
    return any(p.lower is not None or p.upper is not None for p in priors)


def _beyond(
    fit: ForceFit, changed: SampledMotion, recorded: ReadingFit, left: ReadingFit, known: bool
) -> bool:
    """Whether laws of the joints' own motion come nowhere near: they alone do not leave less of the
    motion as `recorded` than the reading alone, and less remains beside them of it; or, of a
    reading that has no number of its own (`known`), they close less of the gap.
    """
    own, beside = recorded.worst + FLOOR, fit.fit(changed).worst + FLOOR
    return (known and left.worst + FLOOR <= ALIKE * own) or (
        left.worst + FLOOR <= own and beside <= GONE * own
    )


def _tried(
    fit: ForceFit, m: SampledMotion, readings: list[Reading], hopeless: float, laws: bool
) -> list[Judged]:
    """What readings of a motion leave, the least first; what is `hopeless` is given up."""
    found = _POOL.map(lambda r: Judged(r, fit.fit(r.change(m), laws, hopeless=hopeless)), readings)
    return sorted((t for t in found if np.isfinite(t.left)), key=lambda t: t.left)


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
    return _tried(fit, m, found, hopeless, laws)


def _sought(fit: ForceFit, m: SampledMotion, start: Judged, names: Names, laws: bool) -> Reading:
    """The scale of these channels that leaves the least, from the one that they start at."""
    refined = refinement(start.reading, names)
    assert refined is not None
    more, size = refined
    fitted = fit.fit(m, laws, more=lambda x: more(m, x), size=1, begin=start.fitted.x)
    return scale_of(names, start.reading.channels, size(float(fitted.x[len(fit.free)])))


def _known_beside(
    fit: ForceFit,
    m: SampledMotion,
    best: Judged,
    names: Names,
    value: float,
    before: float,
    laws: bool,
) -> tuple[float, str, Callable[[SampledMotion], SampledMotion]] | None:
    """A known factor next to a fitted one, of which stated numbers that are off take the rest; None
    where there is none that takes most of the gap by itself.
    """
    factor, what = nearest_factor(value, names.factors(best.reading.channels[0]))
    if abs(np.log(value / factor)) > MISFIT:
        return None
    change = _scaled(replace(best.reading, value=factor), names)
    left = fit.fit(change(m), laws).worst + FLOOR
    return (factor, what, change) if left <= ASKED * before else None


def _refined(
    fit: ForceFit,
    m: SampledMotion,
    best: Judged,
    names: Names,
    near: list[Judged],
    before: float,
    laws: bool,
):
    """Size with interval, words, change, and whether it is a convention's own value; None for what
    has no size. A known factor is one where it leaves as little as any other and none of those that
    come `near` is far from it.
    """
    found = refinement(best.reading, names)
    if found is None:
        return None
    more, size = found
    fitted = fit.fit(m, laws, more=lambda x: more(m, x), size=1, begin=best.fitted.x)
    x = float(fitted.x[len(fit.free)])
    moved = replace(m)
    _, std = fit.spread(fitted, moved, len(fit.free))
    value = size(x)
    ends = (size(x - 1.96 * std), size(x + 1.96 * std)) if std < TOLD else None
    travel = float(np.max(np.ptp(m.q, axis=0)))
    if best.reading.kind == "zero":
        travel = float(np.ptp(m.q[:, names.joints.index(best.reading.channels[0])]))
    if best.reading.kind == "scale":
        known = names.factors(best.reading.channels[0])
        factor, what = nearest_factor(value, known)
        own, name = nearest_factor(best.reading.value, known)
        # Which is all of the answer, and no other size leaves less.
        if abs(np.log(best.reading.value / own)) < 1e-3 and best.left <= min(
            WHOLE * before, fitted.worst + FLOOR
        ):
            factor, what, value = own, name, own
            ends = ends if ends is not None and ends[0] <= own <= ends[1] else None
        change = _scaled(replace(best.reading, value=factor), names)
        alike = unmistakable(value, std, known)
        alike = alike and fit.fit(change(m), laws).worst + FLOOR <= ALIKE * (fitted.worst + FLOOR)
        if alike and not far(best, near, factor):
            return factor, ends, what, change, True
    known = names.factors(best.reading.channels[0])
    own = nearest_convention(best.reading.kind, known, value, std, travel)
    if best.reading.kind == "scale":
        own = of_many(fit, m, best=best, near=near, names=names, value=value, own=own, laws=laws)
    if own is None:
        return value, ends, "", best.reading.change, False
    value, what = own
    if best.reading.kind == "zero":
        j = names.joints.index(best.reading.channels[0])
        return value, ends, what, (lambda m: offset_joint(m, j, -value)), True
    return value, ends, what, _scaled(replace(best.reading, value=value), names), True


def _scaled(reading: Reading, names: Names) -> Callable[[SampledMotion], SampledMotion]:
    again = refinement(reading, names)
    assert again is not None
    return lambda m: again[0](m, np.zeros(1))
