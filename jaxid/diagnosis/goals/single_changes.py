"""How probable single changes of a file are, of all that were simulated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from jaxid.diagnosis.belief import Belief
from jaxid.diagnosis.hypothesis import Hypothesis
from jaxid.diagnosis.probability import normalised, RULE


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
    return Belief(known, weights[chosen] if chosen else None, none=none)


def _places(alone: SingleChanges, h: Hypothesis) -> frozenset[tuple[str, str]]:
    """Effects and places; none of numbers of the model."""
    if alone.of_numbers(h):
        return frozenset()
    return frozenset((c.effect, c.location) for c in h.effects)
