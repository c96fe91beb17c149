"""How probable single changes of a file are, of all that were simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from jaxid.diagnosis.belief import Belief, EffectFamily
from jaxid.diagnosis.goals.compared import ComparedSets, Place, places_of
from jaxid.diagnosis.hypothesis import Hypothesis
from jaxid.diagnosis.probability import RULE
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
    found = []
    for h in (*asked, *more):
        places = _places(alone, h)
        prior = RULE.log_prior if places else 0.0
        found.append((places, prior - alone.evidence(h) / 2))
    compared = ComparedSets.by_evidence(found)
    weights, known = compared.weights, compared.places
    chosen = _places(alone, more[0])
    none = weights.get(frozenset(), 0.0)
    if not chosen:
        return Belief(known, none=none)
    belief = Belief(known, weights[chosen], none=none)
    family = _family(weights, chosen)
    return belief if family is None else belief.with_families([family], list(chosen))


def _family(
    weights: Mapping[frozenset[Place], float], chosen: frozenset[Place]
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


def _places(alone: SingleChanges, h: Hypothesis) -> frozenset[Place]:
    """Effects and places; none of numbers of the model."""
    if alone.of_numbers(h):
        return frozenset()
    return places_of(h.effects)
