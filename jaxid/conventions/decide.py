"""Which reading of a recording a model speaks for: decisive, a question, or none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jaxid.conventions.equal_scales import (
    Judged,
)
from jaxid.conventions.finding import DataFinding
from jaxid.conventions.limits import ALIKE, ASKED, FLOOR, GONE, WHOLE
from jaxid.conventions.mending import Mending
from jaxid.conventions.missing_force import ForceFit, ReadingFit
from jaxid.conventions.reading_size import known_beside, Size, size_of
from jaxid.conventions.reading_words import doubt_of, headline, mending_lines, sentence
from jaxid.conventions.readings import (
    FREE,
    GEAR,
    mending_of,
    Names,
    Reading,
    refinement,
)
from jaxid.conventions.samples import Shown
from jaxid.conventions.timing import timed, whole_rows_tell
from jaxid.conventions.tried_readings import (
    all_tried,
    ranked,
    RankedReadings,
    ReadingQuestion,
    unexplained,
)
from jaxid.conventions.unsigned import unsigned
from jaxid.force.columns import FEW
from jaxid.force.sampled_motion import SampledMotion
from jaxid.numerics.stated_numbers import REFUTED
from jaxid.problem.binding import Binding


MOST = 4  # findings, one after another


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
    asked = ReadingQuestion(
        binding=binding,
        fit=fit,
        m=m,
        names=names,
        many=many,
        recorded=plain,
        beside=beside,
        laws=False,
    )
    found = _claimed(asked)
    if found is not None and found[0].finding.decisive:
        return found
    if beside.worst + FLOOR <= GONE * (plain.worst + FLOOR):
        less = _claimed(replace(asked, recorded=beside, laws=True))
        if less is not None and (found is None or less[0].finding.decisive):
            return less
    return found or (None, None)


def _claimed(asked: ReadingQuestion) -> tuple[Shown, SampledMotion | None] | None:
    """What a reading explains of what is left of the motion."""
    if not unexplained(asked):
        return None
    tried = all_tried(asked)
    if not tried or not tried[0].left <= GONE * asked.before:
        return None
    found = ranked(asked, tried)
    best = found.best
    others = {t.reading.kind for t in found.near} - {best.reading.kind}
    if best.reading.kind == "sign" and _rivals(asked.fit, best, found.same):
        others.add("another channel")
    size = Size(best.reading.value, None, best.reading.what, best.reading.change)
    stated_off = False
    if refinement(best.reading, asked.names) is not None:
        size = size_of(asked, found)
        if not size.conventional:
            return None
        known = known_beside(asked, best, size) if size.what == FREE else None
        size = known or size
        stated_off = known is not None
        if found.elsewhere:
            others.add("another channel")
    changed = size.change(asked.m)
    left = asked.fit.fit(changed, asked.laws)
    if not np.isfinite([size.value, left.worst, left.left]).all():
        return None
    slip = best.reading.kind == "scale" and size.what not in (FREE, GEAR)
    if slip and not asked.laws and left.worst > 1.0:
        stated_off = left.worst + FLOOR <= WHOLE * asked.before
    if not _closes(asked, best, left, stated_off):
        return None
    own_value = size.what not in (FREE, GEAR)
    beyond = asked.laws or _beyond(asked.fit, changed, asked.beside, left, own_value)
    if not beyond and left.worst + FLOOR > ASKED * asked.before:
        return None
    # A factor without a name, and one beside which stated numbers are off, may be those numbers'.
    gear = size.what == GEAR and _bounded(asked.binding)
    unnamed = size.what == FREE or stated_off or gear
    doubt = doubt_of(beyond, bool(others), unnamed)
    shown = _shown(asked, found, size, left, doubt, bool(others))
    return shown, changed if shown.finding.decisive else None


def _closes(asked: ReadingQuestion, best: Judged, left: ReadingFit, stated_off: bool) -> bool:
    """Whether a reading, with its known value too, closes the gap. Beside any law it has to be the
    whole answer: what has another cause goes some way by many a reading. It has to show in what is
    fitted, too: held-out motion alone tells how laws that the model lacks extrapolate. What leaves
    as much as the whole drive explains nothing of it, but for a known slip beside numbers that are
    stated and off.
    """
    if max(best.left, left.worst + FLOOR) > GONE * asked.before:
        return False
    shows = ALIKE * (left.left + FLOOR) <= asked.recorded.left + FLOOR
    if not shows:
        return False
    if asked.laws:
        return left.worst <= FLOOR
    return left.worst <= 1.0 or stated_off


def _shown(
    asked: ReadingQuestion,
    found: RankedReadings,
    size: Size,
    left: ReadingFit,
    doubt: str,
    others: bool,
) -> Shown:
    """The finding; decisive where nothing is doubtful."""
    reading = found.best.reading
    mending = mending_of(reading, size.value, {})
    noise = max(asked.fit.noise(left, asked.binding, asked.few), 1e-6)
    gap = asked.before, left.worst + FLOOR
    finding = DataFinding(
        kind=reading.kind,
        channel=reading.channels[0],
        value=size.value,
        text=sentence(reading, size.value, size.what, gap, doubt, asked.laws),
        line=mending_lines(asked.binding, reading, mending),
        interval_95=size.interval,
        gap_before=asked.recorded.worst / noise,
        gap_if_mended=left.worst / noise,
        decisive=not doubt,
        same_as=_alike(reading, found.near if others else found.same),
        headline=headline(reading, size.value, asked.binding, size.what),
    )
    return Shown(finding, Mending() if doubt else mending, asked.laws)


def _alike(reading: Reading, others: list[Judged]) -> tuple[tuple[str, str], ...]:
    """(kind, channel) of other readings that explain as much, each once."""
    own = {(reading.kind, channel) for channel in reading.channels}
    found: dict[tuple[str, str], None] = {}
    for other in others:
        for channel in other.reading.channels:
            found[other.reading.kind, channel] = None
    return tuple(pair for pair in found if pair not in own)


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
