"""Which candidates are refitted, of what the screens rank, and in which order."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from jaxid.diagnosis.hypothesis import Candidate, effect_of, Hypothesis
from jaxid.diagnosis.screen import Screened
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.problem_builder import Bench


#: At least and at most so many candidates are refitted.
MINIMUM, MAXIMUM = 6, 16
#: Timing comes before physics: these are always refitted first, and win a tie. One sample of offset between two channels, or the
#: wrong hold of the command, is soon made and looks like lag, friction or inertia.
TIMING = ("input_hold", "input_delay", "sensor_delay")
#: Of a large gap so many of each screen are asked first, and the others where none of these leaves the noise alone: hardly two
#: laws do. (A small one is soon closed by many, of which the evidence has to choose.)
LEADING = 4


def shortlist(
    bench: Bench,
    ranked: Sequence[Screened],
    by_torque: Sequence[Screened],
    refining: Callable[[Candidate], bool],
    alone: bool,
    blind: bool,
) -> list[Screened]:
    """The best of both screens, at least those that either puts in front. `alone`: nothing is in the model yet, which is when
    timing is asked. `blind`: with one screen only, all that reacts is tried. What `refining` says to bring another effect along
    takes nobody's place."""
    beside = [f for f in _head(ranked) if refining(f[1])]
    ranked, by_torque = ([f for f in found if not refining(f[1])] for found in (ranked, by_torque))
    kept = ranked if blind else _head(ranked)
    # At the joint first: what is on the way of the command always explains torque, by delivering less of it.
    at_joint = [f for f in by_torque if effect_of(bench, f[1]).location == "joint"]
    more = [str(c) for _, c, _ in (*_head(at_joint), *_head([f for f in by_torque if f not in at_joint]))]
    table = {str(f[1]): f for f in ranked or by_torque}
    first = [f for f in table.values() if f[1].effect in TIMING and alone]
    names = {str(c) for _, c, _ in kept}
    others = [f for f in (*kept, *(table[n] for n in more if n in table and n not in names)) if f not in first]
    kept = [*first, *others][: 2 * MAXIMUM if blind else MAXIMUM]
    names = {str(c) for _, c, _ in kept}
    wanted = _with_alike(bench, [*kept, *_front(ranked, by_torque)]) - names
    return [*kept, *(f for n, f in table.items() if n in wanted), *beside]


def waves(bench: Bench, kept: Sequence[Screened], *screens: Sequence[Screened]) -> list[list[Screened]]:
    """What is refitted first, as either screen puts it in front or as it may equal what is there, and the rest."""
    leads = _with_alike(bench, _front(*screens))
    first = [f for f in kept if str(f[1]) in leads]
    return [wave for wave in (first, [f for f in kept if f not in first]) if wave]


def still_to_ask(wave: Sequence[Screened], found: Sequence[Hypothesis]) -> list[Screened]:
    """Of a wave the ones to be refitted after others: all, or, where one of these leaves no more than the noise, the laws of
    fewer numbers, of which it may have taken the place."""
    enough = [h.effects[-1] for h in found if max(h.fit_loss, h.validation.loss) < LIMITS.explained]
    plainer = lambda c: any(len(c.index) < len(e.index) for e in enough)
    return [f for f in wave if not enough or plainer(f[1])]


def _front(*screens: Sequence[Screened]) -> list[Screened]:
    """What each screen puts in front."""
    return [f for ranked in screens for f in ranked[:LEADING]]


def _with_alike(bench: Bench, found: Sequence[Screened]) -> set[str]:
    """The names of candidates and of what may equal one of them at some of its numbers."""
    alike = {f"{n} at {c.location}" for _, c, _ in found for n in effect_of(bench, c).resembles}
    return alike | {str(c) for _, c, _ in found}


def _head(ranked: Sequence[Screened]) -> list[Screened]:
    """What is refitted of a ranking."""
    return [f for k, f in enumerate(ranked) if k < MINIMUM or f[0] >= ranked[0][0] - LIMITS.screen_share]
