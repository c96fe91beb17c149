"""What is claimed of sets that were weighed: effects, or families of which one is there.

A probability of 95 % is a claim. Below it an effect may stand for its family, the few effects at
its place of which one is there with 95 %. A free law is in no family. What is claimed has to be
missed, by its share of the gap of its joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.diagnosis.belief import Belief, EffectFamily, FreeLaw, product, Worth
from jaxid.diagnosis.torque.free_laws import OVER
from jaxid.diagnosis.torque.library import Unit
from jaxid.diagnosis.torque.weigh import Asked, Question, Scales, Weighed


#: Most effects of one family: of more, nothing is said.
FAMILY = 4


@dataclass(frozen=True, eq=False)
class TorqueClaim:
    """A unit that is claimed, the probability of its effect at its place, and the units at the same
    place that it stands for, with the probability that one of all these is there.
    """

    unit: int
    probability: float
    instead: tuple[int, ...] = ()
    together: float = 1.0


def is_free(unit: Unit) -> bool:
    """Whether a unit is a law of no name."""
    return unit.effect in OVER


def claims(weighed: Weighed, most: int | None = None) -> list[TorqueClaim]:
    """All that is claimed, in the order of the units, of at most so many effects."""
    scales, out = weighed.scales, []
    for asked in weighed.asked:
        standing = [u for u in asked.best if not is_free(scales.units[u])]
        for u in standing:
            claim = _claim(weighed, asked, standing, u)
            if claim is not None:
                out.append(claim)
    out.sort(key=lambda claim: claim.unit)
    out = _missed(scales, out)
    return out if most is None else _of_kinds(scales, out, most)


def likeliest(weighed: Weighed, most: int) -> list[TorqueClaim]:
    """The most probable set without free laws, of at most so many effects, however sure it is."""
    units = weighed.scales.units
    named = sorted(u for u in weighed.best if not is_free(units[u]))
    every = [TorqueClaim(u, weighed.places[units[u].place]) for u in named]
    return _of_kinds(weighed.scales, every, most)


def _of_kinds(scales: Scales, found: list[TorqueClaim], most: int) -> list[TorqueClaim]:
    """Claims of at most so many effects: the effect without which least is lost goes first."""
    kinds = {scales.units[claim.unit].effect for claim in found}
    if len(kinds) <= most:
        return found
    units = [claim.unit for claim in found]
    question = Question(scales, [], units, scales.moving, scales.rule.directions)
    effects = np.array([scales.units[u].effect for u in units])
    kept = np.arange(len(units))
    while len(kinds) > most:
        ordered = sorted(kinds)
        without = [kept[effects[kept] != kind] for kind in ordered]
        worth, _ = question.judged([tuple(s.tolist()) for s in without])
        last = int(np.argmax(worth))
        kinds.discard(ordered[last])
        kept = without[last]
    return [found[k] for k in kept]


def _claim(
    weighed: Weighed, asked: Asked, standing: Sequence[int], unit: int
) -> TorqueClaim | None:
    scales, rule = weighed.scales, weighed.scales.rule
    name = scales.units[unit].place
    p = weighed.places[name]
    if p >= rule.sure:
        return TorqueClaim(unit, p)
    # What stands elsewhere and could do the same takes its part of the family's probability too.
    elsewhere = min(p / max(asked.found.places[name], 1e-300), 1.0)
    if p < rule.possible:
        return None
    family, together = _family(scales, asked, standing, unit)
    together *= elsewhere
    for other in _swapped(weighed, unit)[: FAMILY - len(family)]:
        if together >= rule.sure:
            break
        family = (*family, other)
        together += weighed.swaps[unit][other]
    return TorqueClaim(unit, p, family, together) if together >= rule.sure else None


def _swapped(weighed: Weighed, unit: int) -> list[int]:
    """Units at the same place that were asked with others and may act instead, likeliest first."""
    units, odds = weighed.scales.units, weighed.swaps.get(unit, {})
    near = [v for v in odds if units[v].location == units[unit].location]
    named = [v for v in near if not is_free(units[v])]
    return sorted(named, key=lambda v: odds[v], reverse=True)


def _family(
    scales: Scales, asked: Asked, standing: Sequence[int], unit: int
) -> tuple[tuple[int, ...], float]:
    """The units that stand for the one at its place, of those that it was asked with and one of
    each effect, until one of all is there with what a claim needs, and that probability. Others
    that stand beside it are none of them.
    """
    place = scales.units[unit].location
    beside = {scales.units[u].effect for u in standing}
    shapes: dict[str, int] = {}
    for u in asked.units:
        own = scales.units[u]
        if own.location == place and own.effect not in beside and not is_free(own):
            shapes.setdefault(own.effect, u)
    family = [unit]
    together = _with(asked, place, [scales.units[unit].effect])
    while together < scales.rule.sure and len(family) <= FAMILY:
        names = [scales.units[u].effect for u in family]
        others = [u for name, u in shapes.items() if name not in names]
        if not others:
            break
        worth = {u: _with(asked, place, [*names, scales.units[u].effect]) for u in others}
        family.append(max(worth, key=lambda u: worth[u]))
        together = worth[family[-1]]
    return tuple(family[1:]), together


def _with(asked: Asked, place: str, names: Sequence[str]) -> float:
    """That one of these effects is at the place."""
    return asked.found.of(lambda h: h.place == place and h.name in names)


def _missed(scales: Scales, found: Sequence[TorqueClaim]) -> list[TorqueClaim]:
    """Those without which enough of the gap of their joints comes back."""
    if not found:
        return []
    units = [claim.unit for claim in found]
    question = Question(scales, [], units, scales.moving, scales.rule.directions)
    whole = tuple(range(len(units)))
    sets = [(), whole, *(whole[:i] + whole[i + 1 :] for i in whole)]
    left = np.maximum(question.left(sets) - scales.data.rows, 0.0)
    out = []
    for i, claim in enumerate(found):
        joints = list(scales.units[claim.unit].joints)
        back = left[2 + i, joints].sum() - left[1, joints].sum()
        if back >= scales.rule.share * left[0, joints].sum() and back > 0:
            out.append(claim)
    return out


def sets_by_place(weighed: Weighed, most: int) -> list[tuple[int, ...]]:
    """For each effect at a place the most probable set with it, without free laws, for at most so
    many places, most probable first.
    """
    scales = weighed.scales
    best: dict[tuple[str, str], tuple[float, tuple[int, ...]]] = {}
    for asked in weighed.asked:
        for s, weight in zip(asked.found.sets, asked.found.weights, strict=True):
            named = tuple(asked.units[u] for u in s if not is_free(scales.units[asked.units[u]]))
            for u in named:
                place = scales.units[u].place
                if weight > best.get(place, (-1.0, ()))[0]:
                    best[place] = float(weight), named
    ordered = sorted(best, key=lambda place: -weighed.places.get(place, 0.0))
    return [best[place][1] for place in ordered[:most]]


def instead(weighed: Weighed, found: Sequence[TorqueClaim]) -> list[Unit]:
    """Effects that could be there in the place of what is claimed: those of its families, and at
    its joints whatever else is possible.
    """
    scales = weighed.scales
    units: dict[tuple[str, str], Unit] = {}
    joints: set[int] = set()
    for claim in found:
        units |= {scales.units[u].place: scales.units[u] for u in claim.instead}
        joints |= set(scales.units[claim.unit].joints)
    claimed = {scales.units[claim.unit].place for claim in found}
    for unit in scales.units:
        near = joints & set(unit.joints)
        if near and weighed.places.get(unit.place, 0.0) >= scales.rule.possible:
            units.setdefault(unit.place, unit)
    return [u for place, u in units.items() if place not in claimed and not is_free(u)]


def in_place_of(weighed: Weighed, units: Sequence[int]) -> dict[tuple[str, str], float]:
    """How probable it is that an effect at a place acts and one of these units does not."""
    every = weighed.scales.units
    standing = {every[u].place for u in units}
    found: dict[tuple[str, str], float] = {}
    for asked in weighed.asked:
        own = standing & {every[u].place for u in asked.units}
        weighed_sets = zip(asked.found.sets, asked.found.weights, strict=True)
        for s, weight in weighed_sets:
            places = {every[asked.units[k]].place for k in s}
            if own <= places:
                continue
            for place in places:
                before = found.get(place, 0.0)
                found[place] = before + float(weight)
    for u in units:
        for v, p in weighed.swaps.get(u, {}).items():
            place = every[v].place
            before = found.get(place, 0.0)
            found[place] = max(before, p)
    others = [place for place in found if place[0] not in OVER and place not in standing]
    return {place: min(found[place], 1.0) for place in others}


def believed(
    weighed: Weighed,
    found: Sequence[TorqueClaim],
    worth: dict[tuple[str, str], Worth] | None = None,
) -> Belief:
    """The probabilities of all that was asked; `worth`: what each claim is worth."""
    scales = weighed.scales
    named = {p: x for p, x in weighed.places.items() if p[0] not in OVER}
    free = {p: x for p, x in weighed.places.items() if p[0] in OVER}
    families = [_told(scales, claim) for claim in found if claim.instead]
    return Belief(
        places=named,
        probability=product([_sure(claim) for claim in found]) if found else None,
        families=tuple(families),
        free_law=_free_law(free),
        none=product([asked.found.none for asked in weighed.asked]),
        worth=worth or {},
    )


def _sure(claim: TorqueClaim) -> float:
    return claim.together if claim.instead else claim.probability


def _told(scales: Scales, claim: TorqueClaim) -> EffectFamily:
    own = [scales.units[u] for u in (claim.unit, *claim.instead)]
    names = [u.effect for u in own if not is_free(u)]
    return EffectFamily(tuple(names), own[0].location, claim.together)


def _free_law(places: dict[tuple[str, str], float]) -> FreeLaw | None:
    if not places:
        return None
    (name, place), p = max(places.items(), key=lambda entry: entry[1])
    return FreeLaw(place, OVER[name], p)
