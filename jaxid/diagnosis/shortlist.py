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
    most = 2 * MAXIMUM if blind else MAXIMUM
    beside, _ = _parted(_head(ranked), refining)
    _, ranked = _parted(ranked, refining)
    _, by_torque = _parted(by_torque, refining)
    table = _by_name(ranked or by_torque)
    timing, _ = _parted(list(table.values()), lambda c: alone and is_timing(bench, c))
    best = ranked if blind else _head(ranked)
    # At the joint first: what is on the way of the command always explains torque, by delivering
    # less of it.
    at_joint, before = _parted(by_torque, lambda c: effect_of(bench, c).location == "joint")
    in_order = _by_name([*timing, *best, *_head(at_joint), *_head(before)])
    kept = [name for name in in_order if name in table][:most]
    front = _by_name([*ranked[:FRONT], *by_torque[:FRONT]])
    wanted = set(front)
    for _, c, _ in (*(table[name] for name in kept), *front.values()):
        wanted |= {f"{effect} at {c.location}" for effect in effect_of(bench, c).resembles}
    more = [name for name in table if name in wanted and name not in kept]
    return [*(table[name] for name in (*kept, *more)), *beside]


def _parted(
    found: Sequence[Screened], test: Callable[[Candidate], bool]
) -> tuple[list[Screened], list[Screened]]:
    """Those whose candidates pass a test, and the others."""
    passed, others = [], []
    for f in found:
        (passed if test(f[1]) else others).append(f)
    return passed, others


def _by_name(found: Sequence[Screened]) -> dict[str, Screened]:
    return {str(c): (share, c, starts) for share, c, starts in found}


def _head(ranked: Sequence[Screened]) -> list[Screened]:
    """What is refitted of a ranking: the first ones, and those that are as good as the best."""
    close = [f for f in ranked[MINIMUM:] if f[0] >= ranked[0][0] - LIMITS.equivalent]
    return [*ranked[:MINIMUM], *close]
