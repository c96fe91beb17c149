"""Which candidates are refitted, of what the screens rank."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from jaxid.diagnosis.hypothesis import Candidate, effect_of
from jaxid.diagnosis.screen import Screened
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.problem_builder import ProblemBuilder


#: At least and at most this many candidates are refitted, and those that a screen puts in front
#: however many others there are.
MINIMUM, MAXIMUM, FRONT = 6, 16, 4


def is_timing(bench: ProblemBuilder, c: Candidate) -> bool:
    """Whether a candidate is about when something happens. Timing comes before physics: it is
    always refitted first, and wins a tie. One sample of offset between two channels, or the wrong
    hold of the command, is soon made and looks like lag, friction or inertia.
    """
    return effect_of(bench, c).acts_on == "timing"


def shortlist(
    bench: ProblemBuilder,
    ranked: Sequence[Screened],
    by_torque: Sequence[Screened],
    refining: Callable[[Candidate], bool],
    alone: bool,
) -> list[Screened]:
    """The best of both screens, and what may equal one of them at some of its numbers; all that
    reacts where there is one screen only. `alone`: nothing is in the model yet, which is when
    timing is asked. What `refining` says to bring another effect along takes nobody's place.
    """
    blind = not by_torque  # a model with inner states
    beside = [f for f in _head(ranked) if refining(f[1])]
    ranked, by_torque = ([f for f in found if not refining(f[1])] for found in (ranked, by_torque))
    kept = ranked if blind else _head(ranked)
    # At the joint first: what is on the way of the command always explains torque, by delivering
    # less of it.
    at_joint = [f for f in by_torque if effect_of(bench, f[1]).location == "joint"]
    more = [
        str(c)
        for _, c, _ in (*_head(at_joint), *_head([f for f in by_torque if f not in at_joint]))
    ]
    table = {str(f[1]): f for f in ranked or by_torque}
    first = [f for f in table.values() if alone and is_timing(bench, f[1])]
    names = {str(c) for _, c, _ in kept}
    others = [
        f
        for f in (*kept, *(table[n] for n in more if n in table and n not in names))
        if f not in first
    ]
    kept = [*first, *others][: 2 * MAXIMUM if blind else MAXIMUM]
    front = [*ranked[:FRONT], *by_torque[:FRONT]]
    alike = {
        f"{n} at {c.location}" for _, c, _ in (*kept, *front) for n in effect_of(bench, c).resembles
    }
    wanted = (alike | {str(c) for _, c, _ in front}) - {str(c) for _, c, _ in kept}
    return [*kept, *(f for n, f in table.items() if n in wanted), *beside]


def _head(ranked: Sequence[Screened]) -> list[Screened]:
    """What is refitted of a ranking."""
    return [
        f for k, f in enumerate(ranked) if k < MINIMUM or f[0] >= ranked[0][0] - LIMITS.screen_share
    ]
