"""How probable single changes of a file are, of all that were simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from jaxid.diagnosis.belief import Belief, EffectFamily
from jaxid.diagnosis.hypothesis import Hypothesis
from jaxid.diagnosis.probability import normalised, RULE
from jaxid.diagnosis.simulated import FAMILY


class SingleChanges(Protocol):
    """What tells numbers of the model from effects, and what a change is worth."""

    def of_numbers(self, h: Hypothesis) -> bool: ...

    def evidence(self, h: Hypothesis) -> float: ...


def belief_of(
    alone: SingleChanges, asked: Sequence[Hypothesis], more: Sequence[Hypothesis]
) -> Belief:
    """How probable each effect is, of all single changes that were asked and of some more models,
    the chosen one first: by their sums of squares with what their numbers cost. A number that is
    off is no effect, and as likely beforehand as none.
    """
    each: dict[frozenset[tuple[str, str]], float] = {}
    for h in (*asked, *more):
        places = _places(alone, h)
        prior = RULE.log_prior if places else 0.0
        each[places] = max(each.get(places, -np.inf), prior - alone.evidence(h) / 2)
    weights = dict(zip(each, normalised(np.array(list(each.values()))).tolist(), strict=True))
    known: dict[tuple[str, str], float] = {}
    for places, weight in weights.items():
        for place in places:
            known[place] = known.get(place, 0.0) + weight
    chosen = _places(alone, more[0])
    none = weights.get(frozenset(), 0.0)
    if not chosen:
        return Belief(known, none=none)
    found = Belief(known, weights[chosen], none=none)
    family = _family(weights, chosen)
    return found if family is None else found.with_families([family], list(chosen))


def _family(
    weights: Mapping[frozenset[tuple[str, str]], float], chosen: frozenset[tuple[str, str]]
) -> EffectFamily | None:
    """A single effect with others that may act alone in its place, until one of all is there with
    what a claim needs; None where it is sure by itself, or they are not even together.
    """
    if len(chosen) != 1 or weights[chosen] >= RULE.sure:
        return None
    others = [places for places in weights if len(places) == 1 and places != chosen]
    others.sort(key=lambda places: weights[places], reverse=True)
    own, together = list(chosen), weights[chosen]
    for places in others[: FAMILY - 1]:
        own += places
        together += weights[places]
        if together >= RULE.sure:
            effects, locations = zip(*own, strict=True)
            return EffectFamily(effects, locations[0], min(together, 1.0), locations)
    return None


def _places(alone: SingleChanges, h: Hypothesis) -> frozenset[tuple[str, str]]:
    """Effects and places; none of numbers of the model."""
    if alone.of_numbers(h):
        return frozenset()
    return frozenset((c.effect, c.location) for c in h.effects)
