"""Which candidates are refitted, of what the screens rank."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from jaxid.diagnosis.hypothesis import Candidate, effect_of
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
    alike = [f"{n} at {c.location}" for _, c, _ in kept for n in effect_of(bench, c).resembles]
    front = [str(c) for found in (ranked, by_torque) for _, c, _ in found[:LEADING]]
    return [*kept, *(table[n] for n in dict.fromkeys([*front, *alike]) if n in table and n not in names), *beside]


def waves(bench: Bench, kept: Sequence[Screened], *screens: Sequence[Screened]) -> list[list[Screened]]:
    """What is refitted first, as either screen puts it in front or as it may equal what is there, and the rest."""
    front = [c for ranked in screens for _, c, _ in ranked[:LEADING]]
    alike = {f"{n} at {c.location}" for c in front for n in effect_of(bench, c).resembles}
    first = [f for f in kept if f[1] in front or str(f[1]) in alike]
    return [wave for wave in (first, [f for f in kept if f not in first]) if wave]


def _head(ranked: Sequence[Screened]) -> list[Screened]:
    """What is refitted of a ranking."""
    return [f for k, f in enumerate(ranked) if k < MINIMUM or f[0] >= ranked[0][0] - LIMITS.screen_share]
