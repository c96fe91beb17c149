"""How probable it is that each effect is missing, that one of several is, that a law of no name is,
or that nothing is; and what each named effect is worth.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from typing import Any


@dataclass(frozen=True)
class Worth:
    """What one named effect is worth on held-out runs, as shares of the mean square above the noise
    that the re-tuned model leaves: what it closes by itself (`alone`), and what is lost when it is
    left out of all that is named (`missed_without`, with its 95 % interval).
    """

    alone: float
    missed_without: float
    missed_interval_95: tuple[float, float] | None = None

    @property
    def share(self) -> bool:
        """Whether both figures say the same, so that it is a share of the gap. Where not, another
        named effect could stand for a part of it.
        """
        spread = 0.0
        if self.missed_interval_95 is not None:
            low, high = self.missed_interval_95
            spread = (high - low) / 2
        return abs(self.alone - self.missed_without) <= max(0.1, spread)


@dataclass(frozen=True)
class EffectFamily:
    """Effects of which at least one is missing, with that probability: at one `location`, or each
    at its own of `locations`.
    """

    effects: tuple[str, ...]
    location: str
    probability: float
    locations: tuple[str, ...] = ()

    @property
    def places(self) -> tuple[tuple[str, str], ...]:
        """Each effect with where it acts."""
        at = self.locations or (self.location,) * len(self.effects)
        return tuple(zip(self.effects, at, strict=True))

    def to_dict(self) -> dict[str, Any]:
        at = tuple(location for _, location in self.places)
        return {**asdict(self), "locations": at}


@dataclass(frozen=True)
class FreeLaw:
    """A law of no name: where it acts, and what it depends on."""

    at: str
    over: str
    probability: float

    @property
    def sentence(self) -> str:
        return f"What is missing at {self.at} depends on {self.over}, by a law of no name."

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class Belief:
    """Probabilities of a diagnosis. `places`: of each effect at each place; `rivals`: that one acts
    in the place of what is named; `probability`: that all named effects are missing, or one of the
    family that each stands for; `none`: that nothing is. What was not asked is None.
    """

    places: dict[tuple[str, str], float]
    probability: float | None = None
    families: tuple[EffectFamily, ...] = ()
    free_law: FreeLaw | None = None
    none: float | None = None
    worth: dict[tuple[str, str], Worth] = field(default_factory=dict)
    rivals: dict[tuple[str, str], float] = field(default_factory=dict)

    def of(self, effect: str, location: str) -> dict[str, Any]:
        """What is told of one named effect."""
        worth = self.worth.get((effect, location))
        return {
            "probability": self.places.get((effect, location)),
            "alone": None if worth is None else worth.alone,
            "missed_without": None if worth is None else worth.missed_without,
            "missed_interval_95": None if worth is None else worth.missed_interval_95,
        }

    def standing_for(self, place: tuple[str, str]) -> float:
        """How probable it is that an effect is at a place, or one of the family that it stands
        for.
        """
        own = [family.probability for family in self.families if place in family.places]
        return max(own, default=self.places.get(place, 1.0))

    def with_families(
        self, more: Sequence[EffectFamily], named: Sequence[tuple[str, str]]
    ) -> Belief:
        """With families that the named effects stand for as well."""
        found = replace(self, families=(*self.families, *more))
        each = [found.standing_for(place) for place in named]
        return replace(found, probability=product(each) if named else self.probability)

    def asked_again(self, more: Belief, standing: Container[tuple[str, str]]) -> Belief:
        """Where all effects were asked once more beside those that stand: what was told of others
        when less stood is no longer so. What may act in the place of those that stand still may.
        """
        kept = {place: p for place, p in self.places.items() if place in standing}
        kept |= self._in_its_place(kept)
        for place, p in more.places.items():
            kept[place] = p if place in standing else max(p, kept.get(place, 0.0))
        return replace(self, places=kept, free_law=more.free_law)

    def beside(self, more: dict[tuple[str, str], float]) -> Belief:
        """With further effects at places, of which each is there with such a probability."""
        sure = product([p for p in (self.probability, *more.values()) if p is not None])
        return replace(self, places=self.places | more, probability=sure, none=0.0)

    def at_most(self, judged: Mapping[tuple[str, str], float]) -> Belief:
        """Where simulations give effects at places so much and no more."""
        places = {place: min(p, judged.get(place, p)) for place, p in self.places.items()}
        return replace(self, places=places)

    def at_the_noise(
        self, simulated: Container[tuple[str, str]], named: Sequence[tuple[str, str]]
    ) -> Belief:
        """Where what is `named` leaves the noise: nothing is left that effects beside it could
        explain. Of those that were not simulated there may be what acts in its place, where that
        is not there itself.
        """
        places = {place: p for place, p in self.places.items() if place in simulated}
        room = 1.0 - product([self.places.get(place, 1.0) for place in named])
        places |= self._in_its_place(places, room)
        none = 0.0 if places and self.probability is not None else 1.0
        return replace(self, places=places, free_law=None, none=none)

    def _in_its_place(
        self, told: Container[tuple[str, str]], most: float = 1.0
    ) -> dict[tuple[str, str], float]:
        """How probable at most each rival is of what stands, but for those that are told."""
        return {
            place: min(p, self.places.get(place, p), most)
            for place, p in self.rivals.items()
            if place not in told
        }

    def of_a_gap(self) -> Belief:
        """Where the verdict is that something is missing. The sets that were compared may hold
        nothing that explains it, and then the empty one is the most probable of them.
        """
        return replace(self, none=None if self.none is None else 0.0)

    def possible(self, least: float) -> list[tuple[str, str, float]]:
        """Effects and places of at least this probability, most probable first."""
        found = [(*place, p) for place, p in self.places.items() if p >= least]
        return sorted(found, key=lambda entry: -entry[2])

    def to_dict(self) -> dict[str, Any]:
        return {
            "probability": self.probability,
            "families": [f.to_dict() for f in self.families],
            "free_law": None if self.free_law is None else self.free_law.to_dict(),
            "none": self.none,
        }


def product(each: Sequence[float]) -> float:
    """Of probabilities of what is independent."""
    out = 1.0
    for p in each:
        out *= p
    return out


def joined_beliefs(parts: Sequence[Belief]) -> Belief | None:
    """Of parts of a machine that do not move each other; None of none."""
    if not parts:
        return None
    places: dict[tuple[str, str], float] = {}
    worth: dict[tuple[str, str], Worth] = {}
    rivals: dict[tuple[str, str], float] = {}
    for part in parts:
        places |= part.places
        worth |= part.worth
        rivals |= part.rivals
    sure = [part.probability for part in parts if part.probability is not None]
    absent = [part.none for part in parts if part.none is not None]
    laws = [part.free_law for part in parts if part.free_law is not None]
    return Belief(
        places=places,
        probability=product(sure) if sure else None,
        families=tuple(chain.from_iterable(part.families for part in parts)),
        free_law=max(laws, key=lambda law: law.probability, default=None),
        none=product(absent) if len(absent) == len(parts) else None,
        worth=worth,
        rivals=rivals,
    )
