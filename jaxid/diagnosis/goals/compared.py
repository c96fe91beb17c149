"""How probable effects are, of sets of them that were simulated and compared."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from jaxid.diagnosis.belief import Belief, EffectFamily
from jaxid.diagnosis.hypothesis import Candidate
from jaxid.diagnosis.probability import normalised, RULE
from jaxid.diagnosis.torque.weigh import LARGEST


#: An effect and where it acts.
Place = tuple[str, str]


def places_of(effects: Iterable[Candidate]) -> frozenset[Place]:
    return frozenset((c.effect, c.location) for c in effects)


@dataclass(frozen=True)
class ComparedSets:
    """Sets of effects at places that were compared, with their probabilities, which sum to one."""

    weights: Mapping[frozenset[Place], float] = field(default_factory=dict)

    @classmethod
    def by_evidence(cls, found: Iterable[tuple[frozenset[Place], float]]) -> ComparedSets:
        """Of sets with their log evidence; of one that was simulated several times the best counts,
        and what diverged counts for nothing.
        """
        each: dict[frozenset[Place], float] = {}
        for places, evidence in found:
            measured = float(np.nan_to_num(evidence, nan=-LARGEST))
            each[places] = max(each.get(places, -np.inf), measured)
        weights = normalised(np.array(list(each.values())))
        return cls(dict(zip(each, weights.tolist(), strict=True)))

    @property
    def places(self) -> dict[Place, float]:
        """How probable it is that an effect is at a place."""
        every = frozenset(chain.from_iterable(self.weights))
        return {place: self.any_of({place}) for place in every}

    def any_of(self, wanted: Set[Place]) -> float:
        """How probable it is that one of these is there."""
        inside = [weight for places, weight in self.weights.items() if places & wanted]
        return min(sum(inside), 1.0)

    def claimed(self, c: Candidate, rivals: Sequence[Candidate]) -> bool:
        """Whether an effect or one of its rivals at its place is as probable as a claim has to
        be.
        """
        return self._at_its_place(c, rivals).probability >= RULE.sure

    def with_families(
        self, belief: Belief, effects: Sequence[Candidate], rivals: Sequence[Candidate]
    ) -> Belief:
        """What some effects stand for that are not sure by themselves, where columns did not tell
        it: first of all what may act at the same place.
        """
        told = set(chain.from_iterable(family.places for family in belief.families))
        unsure = [c for c in effects if (c.effect, c.location) not in told]
        unsure = [c for c in unsure if belief.places.get((c.effect, c.location), 1.0) < RULE.sure]
        found = []
        for c in unsure:
            family = self._at_its_place(c, rivals)
            if family.probability < RULE.sure:
                family = self._family(c, [e for e in rivals if self._instead(e, c)])
            if len(family.effects) > 1:
                found.append(family)
        return belief.with_families(found, [(c.effect, c.location) for c in effects])

    def _at_its_place(self, c: Candidate, rivals: Sequence[Candidate]) -> EffectFamily:
        """The family of an effect with its rivals at the same place."""
        return self._family(c, [e for e in rivals if e.location == c.location])

    def _family(self, c: Candidate, rivals: Sequence[Candidate]) -> EffectFamily:
        """An effect and rivals that may act in its place: that one of them is there."""
        own = [c, *rivals]
        effects = tuple(e.effect for e in own)
        locations = tuple(e.location for e in own)
        return EffectFamily(effects, c.location, self.any_of(places_of(own)), locations)

    def _instead(self, other: Candidate, c: Candidate) -> bool:
        """Whether some set has another effect and not this one."""
        other_place, place = (other.effect, other.location), (c.effect, c.location)
        return any(other_place in s and place not in s for s in self.weights)
