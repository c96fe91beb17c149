"""What a robot under goals may lack, proposed along its measured motion: numbers of the model, sets
of effects with theirs.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxid.diagnosis.belief import Belief, product, Worth
from jaxid.diagnosis.goals.bodies import shifts_body
from jaxid.diagnosis.goals.limits import limits_shown
from jaxid.diagnosis.goals.study import LedStudy
from jaxid.diagnosis.hypothesis import Candidate, candidates
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.answer import of_model
from jaxid.diagnosis.torque.choose import Chooser, Model
from jaxid.diagnosis.torque.claims import (
    believed,
    claims,
    in_place_of,
    instead,
    likeliest,
    TorqueClaim,
)
from jaxid.diagnosis.torque.held_out import SHARED
from jaxid.diagnosis.torque.judged import scales
from jaxid.diagnosis.torque.library import MOMENT, Unit
from jaxid.diagnosis.torque.weigh import weigh, Weighed
from jaxid.diagnosis.torque.worth import worth
from jaxid.dynamics.effect import BodyEffect, Effect, InputEffect, JointEffect, OutputEffect
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.binding import Binding


@dataclass(frozen=True, eq=False)
class Proposal:
    """A set of units with the numbers of each, and the model's own (of the whole layout of the
    nominal model).
    """

    units: tuple[Unit, ...]
    numbers: tuple[np.ndarray, ...]
    theta: np.ndarray


def shown(kind: type[Effect]) -> bool:
    """Whether an effect is a column along a measured motion under goals: it acts on the way from
    the goal to the joint, at the joint or in the mechanism, and has no motion of its own.
    """
    if issubclass(kind, BodyEffect):
        return shifts_body(kind)
    if issubclass(kind, InputEffect):
        return not kind.stated_as  # what the dataset states is settled before
    if issubclass(kind, OutputEffect):
        return kind.is_offset()
    return issubclass(kind, JointEffect)


@dataclass(frozen=True, eq=False)
class ProposedSets:
    """What columns propose: the re-tuned model, sets of effects to simulate, and the probabilities
    behind them; nothing where the re-tuned model is at the noise. `inflation`: see
    `LinearisedSearch.inflation`.
    """

    bare: Proposal
    sets: tuple[Proposal, ...] = ()
    weighed: Weighed | None = None
    claims: tuple[TorqueClaim, ...] = ()
    worth: dict[tuple[str, str], Worth] = field(default_factory=dict)
    inflation: float = 1.0

    def belief(self, named: Mapping[tuple[str, str], float]) -> Belief:
        """The probabilities of all that was asked, where simulations give what is `named` (effect,
        place) so much and no more.
        """
        kept = self._kept(named)
        if self.weighed is None:
            found = Belief({}, none=0.0 if named else 1.0)
        else:
            found = believed(self.weighed, kept, self.worth)
        own = {
            self._place(claim): min(named[self._place(claim)], claim.together)
            if claim.instead
            else min(named[self._place(claim)], claim.probability)
            for claim in kept
        }
        places = {
            place: min(found.places.get(place, p) if place in own else p, p)
            for place, p in named.items()
        }
        sure = product([own.get(place, p) for place, p in named.items()])
        return replace(
            found,
            places=found.places | places,
            probability=sure if named else None,
            rivals=self._rivals(named),
        )

    def instead(self, named: Container[tuple[str, str]]) -> list[Candidate]:
        """What could be there in the place of what is named, by name and place."""
        if self.weighed is None:
            return []
        return [
            Candidate(u.effect, u.location, ()) for u in instead(self.weighed, self._kept(named))
        ]

    def _rivals(self, named: Container[tuple[str, str]]) -> dict[tuple[str, str], float]:
        """What may act in the place of what is named, by columns."""
        if self.weighed is None:
            return {}
        units = self.weighed.scales.units
        standing = {claim.unit for claim in self._kept(named)}
        standing |= {u for u in self.weighed.best if units[u].place in named}
        return in_place_of(self.weighed, sorted(standing))

    def _kept(self, named: Container[tuple[str, str]]) -> list[TorqueClaim]:
        return [claim for claim in self.claims if self._place(claim) in named]

    def _place(self, claim: TorqueClaim) -> tuple[str, str]:
        assert self.weighed is not None
        return self.weighed.scales.units[claim.unit].place


def proposals(study: LedStudy, most: int) -> ProposedSets:
    """The nominal model, and what is claimed beside it along its free run. Re-tuning for an effect
    that is missing can lead the numbers far away: where nothing is claimed, along the free run of
    what is stated.
    """
    asked = LinearisedSearch(study, study.theta, most)
    bare = _proposal(study, asked.chooser, asked.chooser.nominal)
    if asked.at_noise():
        return ProposedSets(bare)
    found = asked.searched(bare)
    if not found.claims:
        again = LinearisedSearch(study, study.binding.theta, most).searched(bare)
        found = again if again.claims else found
    limits = [
        Proposal((u,), (np.ones(1),), study.binding.theta.copy()) for u in limits_shown(study)[:1]
    ]
    return replace(found, sets=(*limits, *found.sets))


class LinearisedSearch:
    """Every effect as columns along the free run of numbers theta, and what is claimed of them."""

    def __init__(self, study: LedStudy, theta: np.ndarray, most: int):
        self.study, self.most = study, most
        self.fit, self.held = study.of("fit"), study.of("validation") or study.of("fit")
        self.rows, self.white = study.rows_with_effects(theta)
        self.chooser = study.chooser(self.rows, self.white, self.fit, self.held)

    def at_noise(self) -> bool:
        """Whether the re-tuned model is, at every joint."""
        answer = of_model(self.study, self.rows, self.chooser.nominal)
        joints = range(len(self.study.noise))
        return all(
            not answer.gap(which, j) > LIMITS.near
            for which in (self.fit, self.held)
            for j in joints
        )

    def inflation(self, model: Model) -> float:
        """How many times too often the squares of a run's samples count that a model leaves: they
        lie above the noise, and are alike.
        """
        white = self.study.weights_of(self.rows, model.solution)
        each = (white.size / self.study.noise) ** 2 * white.memory / SHARED
        return float(np.clip(np.mean(each), 1.0, None))

    def searched(self, bare: Proposal) -> ProposedSets:
        """What is claimed, and the most probable set where that is another one: first order is
        rough, and simulations decide.
        """
        which = list(dict.fromkeys([*self.fit, *self.held]))
        weighed = weigh(scales(self.study, self.rows, self.white, self.chooser, which))
        claimed = claims(weighed, self.most)
        chosen = self._modelled(claimed)
        probable = self._modelled(likeliest(weighed, self.most))
        sets = []
        for model in (chosen, probable):
            if model is not None and not (sets and set(model.units) == set(sets[0].units)):
                sets.append(model)
        proposed = tuple(_proposal(self.study, self.chooser, model) for model in sets)
        if chosen is None:
            plain = self.inflation(self.chooser.nominal)
            return ProposedSets(bare, proposed, weighed, inflation=plain)
        kept = tuple(claim for claim in claimed if claim.unit in chosen.units)
        judged = self.study.of("report") or self.held
        each = worth(self.study, self.rows, self.chooser, chosen, judged)
        left = self.inflation(chosen)
        return ProposedSets(bare, proposed, weighed, kept, each, left)

    def _modelled(self, found: Sequence[TorqueClaim]) -> Model | None:
        return self.chooser.lively([claim.unit for claim in found])


def _proposal(study: LedStudy, chooser: Chooser, m: Model) -> Proposal:
    theta, p = study.theta.copy(), study.plant.size
    theta[study.plant.free] = np.clip(m.solution.theta[:p], study.lower, study.upper)
    own = tuple(chooser.units[u] for u in m.units)
    ends = np.cumsum([len(u.fields) for u in own])[:-1]
    return Proposal(
        own, tuple(np.split(m.solution.theta[chooser.size :], ends)) if own else (), theta
    )


def candidates_of(bench: ProblemBuilder, s: Proposal) -> list[Candidate]:
    """The candidates of a bench that a set asks for, each with the numbers that its unit shows."""
    kinds = {e.name: e for e in bench.binding.chain.effects}
    pool = {(c.effect, c.location): c for c in candidates(bench, [u.effect for u in s.units])}
    out = []
    for u in s.units:
        c = pool.get(u.owner)
        if c is not None:
            hidden = [
                f for f in getattr(kinds[u.effect], "moments", ()) if f"{MOMENT}{f}" not in u.fields
            ]
            fields = {i: bench.binding.layout.entries[i].field for i in c.index}
            out.append(replace(c, index=tuple(i for i in c.index if fields[i] not in hidden)))
    return out


def kinds_of(sets: Sequence[Proposal]) -> list[str]:
    return list(dict.fromkeys(u.effect for s in sets for u in s.units))


def as_vector(binding: Binding, nominal: Sequence[str], s: Proposal) -> np.ndarray:
    """The numbers of a proposal in the layout of a binding; `nominal`: the names of the numbers
    that `s.theta` has.
    """
    theta, layout = binding.theta.copy(), binding.layout
    for name, value in zip(nominal, s.theta, strict=True):
        theta[layout.index(name)] = value
    for u, numbers in zip(s.units, s.numbers, strict=True):
        own = dict(u.shape) | dict(zip(u.fields, map(float, numbers), strict=True))
        own |= {
            f.removeprefix(MOMENT): v / own["mass"]
            for f, v in own.items()
            if f.startswith(MOMENT) and own["mass"]
        }
        for i in layout.of_effect(*u.owner):
            if (field := layout.entries[i].field) in own:
                theta[i] = np.clip(own[field], binding.lower[i], binding.upper[i])
    return theta


def absent_effects(b: Binding) -> list[Candidate]:
    """Effects that are part of the model, at each joint where its file has nothing of them."""
    free = set(b.free)
    nothing = {i for i in free.intersection(b.nominal) if b.theta[i] == 0.0}
    out = []
    for effect in b.chain.effects:
        if not isinstance(effect, JointEffect):
            continue
        for place in b.chain.offers(effect):
            index = free.intersection(b.layout.of_effect(effect.name, place))
            if index and index <= nothing:
                out.append(Candidate(effect.name, place, tuple(sorted(index))))
    return out
