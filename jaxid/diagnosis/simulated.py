"""Evidence of sets of effects that were simulated: the rule of `probability`, by free runs.

A set is a model that was refitted with some effects. What it leaves of fit and validation runs is
its evidence, and a probability is a sum over all sets that were fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from jaxid.diagnosis.belief import Belief, EffectFamily, product, Worth
from jaxid.diagnosis.hypothesis import Candidate, Hypothesis, key_of
from jaxid.diagnosis.probability import (
    EvidenceRule,
    log_evidence,
    log_prior,
    normalised,
    Probabilities,
    RULE,
    SetMember,
)


#: A free run drifts by one slow curve, so that a discrepancy has fewer directions than by torque.
#: Measured on 1184 kept blind cases (`benchmarks/blind.py`).
SIMULATED = replace(RULE, directions=6.0)
#: Effects of one family at most.
FAMILY = 5
#: Blocks of held-out runs that are drawn anew for an interval, and how often.
BLOCKS, DRAWS = 20, 400


@dataclass(frozen=True)
class SimulatedClaim:
    """An effect that is claimed, by itself or with others of which one is there: the probability of
    that.
    """

    candidate: Candidate
    instead: tuple[Candidate, ...]
    probability: float


@dataclass(frozen=True, eq=False)
class SimulatedSets:
    """All sets that were fitted, the empty one among them, with their probabilities."""

    fitted: tuple[Hypothesis, ...]
    candidates: tuple[Candidate, ...]
    found: Probabilities
    rule: EvidenceRule = SIMULATED

    def of(self, candidate: Candidate) -> float:
        return self.found.places.get((candidate.effect, candidate.location), 0.0)

    def any_of(self, candidates: Sequence[Candidate]) -> float:
        """That one of them is there."""
        wanted = {(c.effect, c.location) for c in candidates}
        return self.found.of(lambda unit: (unit.name, unit.place) in wanted)

    def claim(self, candidate: Candidate, alike: Sequence[Candidate]) -> SimulatedClaim | None:
        """The claim that it is there, or it or some of what is `alike`; None where neither is
        sure.
        """
        alone = self.of(candidate)
        if alone >= self.rule.sure:
            return SimulatedClaim(candidate, (), alone)
        family = [candidate]
        for other in sorted(alike, key=self.of, reverse=True)[: FAMILY - 1]:
            family.append(other)
            together = self.any_of(family)
            if together >= self.rule.sure:
                return SimulatedClaim(candidate, tuple(family[1:]), together)
        return None


def simulated_sets(fitted: Iterable[Hypothesis], rule: EvidenceRule = SIMULATED) -> SimulatedSets:
    """Each set once, as it was fitted last; what diverged has no evidence."""
    each = {key_of(h.effects): h for h in fitted}
    hypotheses = tuple(sorted(each.values(), key=lambda h: len(h.effects)))
    candidates = tuple(dict.fromkeys(chain.from_iterable(h.effects for h in hypotheses)))
    units = tuple(SetMember(c.effect, c.location, len(c.index)) for c in candidates)
    place = {c: k for k, c in enumerate(candidates)}
    sets = tuple(tuple(map(place.__getitem__, h.effects)) for h in hypotheses)
    weights = normalised(np.array([log_weight(h, rule) for h in hypotheses]))
    return SimulatedSets(hypotheses, candidates, Probabilities(units, sets, weights), rule)


def log_weight(h: Hypothesis, rule: EvidenceRule = SIMULATED) -> float:
    """Log evidence of a set with its prior and price, up to a constant of the data. What is stated
    of numbers costs half of chi-square.
    """
    beyond = np.array([_left(h) - h.path.count - h.validation.count])
    units = [SetMember(c.effect, c.location, len(c.index)) for c in h.effects]
    prior = log_prior([range(len(units))], units, rule)
    found = log_evidence(beyond, np.zeros(1), rule.directions)[0] + prior[0]
    return float(found - h.departed / 2)


def told_apart(better: Hypothesis, other: Hypothesis) -> bool:
    """Whether another set is so improbable beside one that the data tell it from that."""
    odds = (1 - SIMULATED.sure) / SIMULATED.sure
    return log_weight(other) < log_weight(better) + np.log(odds)


def _left(h: Hypothesis) -> float:
    """Sum of squares over fit and validation runs in units of the noise. Numbers of effects take up
    one each of the fit runs by chance.
    """
    fitted = h.fit_loss * h.path.count - h.departed + h.size
    return fitted + h.validation.loss * h.validation.count


def claimed(
    chosen: Hypothesis,
    nominal: Hypothesis,
    alike: Sequence[Candidate],
    fitted: Callable[[Hypothesis, Sequence[Candidate]], SimulatedSets],
    without: Callable[[Hypothesis, Candidate], Hypothesis],
) -> tuple[Hypothesis, list[SimulatedClaim], SimulatedSets]:
    """The chosen set without what is not sure enough to be claimed, what is claimed, and all sets
    that were `fitted`; `without` refits a set without one of its effects.
    """
    while True:
        sets = fitted(chosen, alike)
        claims = {c: sets.claim(c, alike) for c in chosen.effects}
        sure = [claim for claim in claims.values() if claim is not None]
        if len(sure) == len(claims):
            return chosen, sure, sets
        if not sure:
            return nominal, [], sets
        unsure = [c for c, claim in claims.items() if claim is None]
        chosen = without(chosen, min(unsure, key=sets.of))


def believed(sets: SimulatedSets, claims: Sequence[SimulatedClaim], chosen: Hypothesis) -> Belief:
    """The probabilities of all that was fitted, and what each claim is worth."""
    families = [_family(claim) for claim in claims if claim.instead]
    return Belief(
        places=sets.found.places,
        probability=product([claim.probability for claim in claims]) if claims else None,
        families=tuple(families),
        none=sets.found.none,
        worth=worth(sets.fitted, chosen),
    )


def _family(claim: SimulatedClaim) -> EffectFamily:
    names = [c.effect for c in (claim.candidate, *claim.instead)]
    return EffectFamily(tuple(dict.fromkeys(names)), claim.candidate.location, claim.probability)


def worth(fitted: Iterable[Hypothesis], chosen: Hypothesis) -> dict[tuple[str, str], Worth]:
    """What each effect of the chosen model closes by itself, and what is missed without it, of
    validation runs; of those whose models were fitted.
    """
    known = {key_of(h.effects): h for h in fitted} | {key_of(chosen.effects): chosen}
    nominal = known.get(frozenset())
    if nominal is None or not chosen.effects:
        return {}
    out = {}
    for c in chosen.effects:
        alone = known.get(key_of([c]))
        without = known.get(key_of([e for e in chosen.effects if e is not c]))
        if alone is None or without is None:
            continue
        told = _shares(*(_blocks(h) for h in (nominal, chosen, alone, without)))
        if told is not None:
            out[c.effect, c.location] = told
    return out


def _blocks(h: Hypothesis) -> np.ndarray:
    """Mean squares [blocks] of what is left of validation runs above the noise."""
    series = [np.mean(np.asarray(r) ** 2, axis=1) for r in h.validation.settled]
    if not series:
        return np.zeros(0)
    parts = np.array_split(np.concatenate(series), BLOCKS)
    return np.array([part.mean() for part in parts if part.size]) - 1.0


def _shares(
    before: np.ndarray, after: np.ndarray, alone: np.ndarray, without: np.ndarray
) -> Worth | None:
    """Of blocks that are left by the re-tuned model, by that with all effects, with one alone, and
    with all but that.
    """
    if not before.size or not before.mean() > 0:
        return None
    if len({x.size for x in (before, after, alone, without)}) > 1:
        return None
    size = before.size
    drawn_anew = np.random.default_rng(0).multinomial(size, np.full(size, 1 / size), DRAWS)
    times = np.concatenate([np.ones((1, size)), drawn_anew])  # first as it was recorded
    gap, whole, one, less = (np.maximum(times @ x, 0.0) for x in (before, after, alone, without))
    drawn = (less - whole)[gap > 0] / gap[gap > 0]
    closes, missed = float((gap[0] - one[0]) / gap[0]), float(drawn[0])
    if not np.isfinite([closes, *drawn]).all():
        return None
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Worth(closes, missed, (float(low), float(high)))
