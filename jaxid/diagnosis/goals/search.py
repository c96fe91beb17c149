"""The first few proposals, decided by simulation under the law."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from jaxid.diagnosis.evidence import held_out, HeldOut, knowledge, level
from jaxid.diagnosis.goals.compared import ComparedSets, places_of
from jaxid.diagnosis.goals.propose import (
    absent_effects,
    as_vector,
    candidates_of,
    ProposedSets,
)
from jaxid.diagnosis.hypothesis import Candidate, Hypothesis, SearchResult
from jaxid.diagnosis.left_open import left_open
from jaxid.diagnosis.probability import log_evidence, RULE
from jaxid.diagnosis.selection import in_lead, joint_loss
from jaxid.diagnosis.torque.weigh import LARGEST, TOGETHER
from jaxid.diagnosis.verdict import judge
from jaxid.dynamics.effect import BodyEffect
from jaxid.fitting.fitter import Progress
from jaxid.fitting.least_squares import Path
from jaxid.fitting.problem_builder import (
    descend_over_stretches,
    estimate_starts,
    ProblemBuilder,
    touches,
)
from jaxid.fitting.secant import descend_on_secants, residuals, Slopes
from jaxid.fitting.wide_slopes import descend_widely, WIDTHS
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import OutputError
from jaxid.problem.trust import counted_as_often


#: Iterations and tolerance of a descent from near where it ends: from a model that is like it, or
#: from where it ended with other priors. One from anywhere else takes twice as many at the most.
NEAR, FAR = (12, 1e-3), (24, 1e-3)
#: Rounds of a refit of runs that touch.
TOUCHING = 16
#: An effect that is missed this many times as much as it has to be needs no simulation without it.
SURELY = 4.0


@dataclass
class Decider:
    """Refits by simulation, and counts what is simulated."""

    bench: ProblemBuilder
    names: Sequence[str]  # of the nominal model's numbers
    progress: Progress | None = None
    done: int = 0
    total: int = 1
    evaluations: int = field(default=0)
    lead: list[Hypothesis] = field(
        default_factory=list
    )  # what explained most so far, for the line of progress
    #: (effect, place) -> probability by the last simulation that asked whether it is missed.
    sure: dict[tuple[str, str], float] = field(default_factory=dict)
    compared: ComparedSets = field(default_factory=ComparedSets)  # what was, last
    asked: frozenset[int] = frozenset()  # numbers of the model that are asked for as effects
    most: float = np.inf  # of the noise that a stretch of runs that touch may leave

    def refit(
        self, effects: Sequence[Candidate], theta: np.ndarray, like: Hypothesis | None = None
    ) -> Hypothesis:
        """A model with these effects fitted to the free runs from numbers theta; its runs begin as
        those of `like`, whose slopes lead the way.
        """
        told = (" and ".join(map(str, effects)) or "nominal model", in_lead(self.lead))
        if self.progress:
            self.progress("simulated", self.done, self.total, "; ".join(filter(None, told)))
        free = [
            *(i for i in self.bench.binding.free if i not in self.asked),
            *(i for c in effects for i in c.index),
        ]
        p = self.bench.problem(OutputError(), "fit", free, theta)
        known = None
        if touches(self.bench.binding):
            path, spent = self._touching(p, like)
        elif like is None:
            path, known, spent = descend_on_secants(p, [p.z(theta)], None, *FAR)
        else:  # its own numbers, or those of the model that it is like
            starts = like.path.problem.starts(like.path.z)
            other, at = like.theta.copy(), [i for c in effects for i in c.index]
            other[at] = theta[at]
            begin = [p.z(theta, starts), p.z(other, starts)]
            path, known, spent = descend_on_secants(p, begin, like.slopes, *NEAR)
        self.done, self.evaluations = self.done + 1, self.evaluations + spent
        return self._judged(effects, path, known)

    def _touching(self, p: FitProblem, like: Hypothesis | None) -> tuple[Path, int]:
        """A descent on the fit runs that touch, and how often these were simulated. Where those of
        `like` are at the noise with these numbers, it goes on from there.
        """
        if not p.free.size:
            starts = estimate_starts(self.bench, "fit", [p.base])[0]
            return descend_widely(p, p.z(p.base, starts), len(WIDTHS))
        if like is not None:
            z = p.z(p.base, like.path.problem.starts(like.path.z))
            (left,) = residuals(p, [z])
            if np.mean(left**2) <= level(left.size):
                return descend_widely(p, z, TOUCHING)
        every = range(len(p.records))
        return descend_over_stretches(self.bench, "fit", p.free, p.base, every, self.most)

    def taken_over(self, h: Hypothesis) -> Hypothesis:
        """A model of another bench with the same numbers free, as the nominal model of this one:
        its effects are numbers of the model.
        """
        bench, own = self.bench, h.path
        named = dict(zip(own.problem.runs.layout.names, h.theta, strict=True))
        theta = np.array([named[name] for name in bench.binding.layout.names])
        p = bench.problem(OutputError(), "fit", bench.binding.free, theta)
        path = replace(own, problem=p, z=p.z(theta, own.problem.starts(own.z)))
        return replace(h, effects=(), theta=theta, path=path)

    def polished(self, h: Hypothesis) -> Hypothesis:
        """The same from where its descent ended, with slopes of its own: those of another model
        lead only so far.
        """
        own = h.slopes if h.slopes is not None and h.slopes.own else None
        path, known, spent = self._from(h, "fit", h.path.problem, h.path.z, own)
        self.evaluations += spent
        return self._judged(h.effects, path, known)

    def _from(
        self,
        h: Hypothesis,
        split: str,
        p: FitProblem,
        z: np.ndarray,
        known: Slopes | None = None,
    ) -> tuple[Path, Slopes | None, int]:
        """A descent of a model from z, with slopes that are taken there unless they are `known`,
        its slopes at the end, and how often the runs were simulated. Runs that touch are not
        followed nearer than the model leaves them open.
        """
        if not touches(self.bench.binding):
            return descend_on_secants(p, [z], known, *NEAR)
        near, spent = descend_widely(p, z, TOUCHING)
        if near.loss <= level(near.count) + max(h.left_open.values(), default=0.0):
            return near, None, spent
        theta, every = p.theta(near.z), range(len(p.records))
        again, more = descend_over_stretches(self.bench, split, p.free, theta, every)
        return min(near, again, key=lambda path: path.cost), None, spent + more

    def reweighed(self, h: Hypothesis) -> Hypothesis:
        """The same with priors that count as often as what the model itself leaves: columns, which
        are of first order and know no steps, leave more, and hold the numbers of the file too near
        to what is stated. First once each, as for a model that is right; where more than the noise
        is left, as often as that.
        """
        before = self.bench.binding.inflation
        once = self._counted(h, 1.0)
        if once.at_noise:
            return once
        if once.fit_inflation < before:
            return self._counted(once, once.fit_inflation)
        self.bench.binding = counted_as_often(self.bench.binding, before)
        return h

    def _counted(self, h: Hypothesis, inflation: float) -> Hypothesis:
        """The same refitted with priors that count so often, which hold from now on."""
        self.bench.binding = counted_as_often(self.bench.binding, inflation)
        return self._posed_again(h)

    def released(self, chosen: Hypothesis, nominal: Hypothesis) -> tuple[Hypothesis, Hypothesis]:
        """What was chosen, and the nominal model, where stated numbers that the runs refute beside
        what was chosen are not known any more. That such a number is wrong altogether is no more
        improbable than that an effect is missing: without this an effect may stand for what holds
        the number back.
        """
        most = RULE.per_number - RULE.log_prior
        while True:
            binding = self.bench.binding
            refuted = {i for i in binding.priors if self._departure(chosen, i) > most}
            if not refuted:
                return chosen, nominal
            priors = {i: known for i, known in binding.priors.items() if i not in refuted}
            self.bench.binding = replace(binding, priors=priors)
            chosen = self._from_stated(chosen, refuted)
            nominal = self._from_stated(nominal, refuted)

    def _from_stated(self, h: Hypothesis, but: Set[int]) -> Hypothesis:
        """A model refitted from the numbers that are stated, `but` some and those of its effects:
        a number that was held back may have drawn others along.
        """
        again = self._posed_again(h)
        kept = [*but, *chain.from_iterable(c.index for c in h.effects)]
        theta = self.bench.binding.theta.copy()
        theta[kept] = again.theta[kept]
        anew = self.refit(h.effects, theta)
        return anew if self.gained(again, anew) > 0 else again

    def _departure(self, h: Hypothesis, i: int) -> float:
        """What it costs that a number is not as it is stated."""
        binding = self.bench.binding
        if i not in binding.priors or i not in h.path.problem.free:
            return 0.0
        mean, std = binding.priors[i]
        return float((h.theta[i] - mean) / std) ** 2 / 2 / binding.inflation

    def _posed_again(self, h: Hypothesis) -> Hypothesis:
        """A model refitted with what is known of its numbers by now."""
        p = self.bench.problem(OutputError(), "fit", h.path.problem.free, h.theta)
        return self.polished(replace(h, path=replace(h.path, problem=p)))

    def _judged(
        self, effects: Sequence[Candidate], path: Path, slopes: Slopes | None = None
    ) -> Hypothesis:
        theta = path.problem.theta(path.z)
        if not np.isfinite(path.cost):
            return Hypothesis(tuple(effects), theta, path, HeldOut([], [], np.inf, 0))
        (held,) = held_out(self.bench, "validation", [theta], OutputError(), [knowledge(path)])
        found = Hypothesis(tuple(effects), theta, path, held, slopes=slopes)
        if touches(self.bench.binding) and not found.at_noise and np.isfinite(joint_loss(found)):
            found = replace(found, left_open=left_open(self.bench, found))
        if effects:
            self.lead = [min([*self.lead, found], key=joint_loss)]
        return found

    def settled(self, h: Hypothesis) -> Hypothesis:
        """The same refitted to the fit and validation runs: once these have chosen, its numbers are
        those of all of them.
        """
        bench, own = self.bench, h.path.problem
        if not bench.binding.experiments("validation") or not np.isfinite(h.fit_loss):
            return h
        p = bench.problem(OutputError(), "fit+validation", own.free, h.theta)
        starts = [own.starts(h.path.z), estimate_starts(bench, "validation", [h.theta])[0]]
        z = p.z(h.theta, np.concatenate(starts))
        path, _, spent = self._from(h, "fit+validation", p, z)
        self.evaluations += spent
        return replace(h, theta=p.theta(path.z), path=path)

    def decided(self, nominal: Hypothesis, proposed: ProposedSets) -> SearchResult:
        """Of the sets that were proposed the one that simulations bear out; its effects taken back
        where they are not missed. None is asked where the re-tuned model reaches the noise.
        """
        sets, tried = proposed.sets, []
        if not sets or judge(SearchResult(nominal, nominal)).name == "none":
            return SearchResult(nominal, nominal, belief=proposed.belief({}))
        self.total = self.done + len(sets)
        for s in sets:
            theta = as_vector(self.bench.binding, self.names, s)
            if own := candidates_of(self.bench, s):
                tried.append(self.refit(own, theta, nominal))
        best = self.best_of(nominal, tried)
        if best.effects:
            nominal, chosen = self.confirmed(nominal, best, tried)
        elif self.bench.binding.inflation > 1:
            # priors that count so often may be all that keeps it from the noise
            nominal = chosen = self.reweighed(nominal)
        else:
            chosen = nominal
        named = self.certain(chosen.effects)
        rivals = self.rivals(chosen, tried)
        belief = proposed.belief(named).at_most(self.sure)
        belief = self.compared.with_families(belief, chosen.effects, rivals)
        return SearchResult(
            nominal=nominal,
            chosen=chosen,
            tried=tried,
            confusable=list(dict.fromkeys([*proposed.instead(named), *rivals])),
            several=len({c.effect for c in chosen.effects}) > 1,
            belief=belief,
        )

    def best_of(self, stands: Hypothesis, tried: Sequence[Hypothesis]) -> Hypothesis:
        """The most probable of what was tried beside what stands, or that; how probable effects are
        so is kept.
        """
        measured = [h for h in tried if np.isfinite(joint_loss(h))]

        def gained(h: Hypothesis) -> float:
            return np.nan_to_num(self.gained(stands, h), nan=-np.inf)

        best = max([stands, *measured], key=gained)
        self.compare(best, [stands, *tried])
        return best

    def confirmed(
        self, nominal: Hypothesis, best: Hypothesis, tried: list[Hypothesis]
    ) -> tuple[Hypothesis, Hypothesis]:
        """The nominal model, and the best one without what is not missed, both with priors that
        count as often as what the best one leaves.
        """
        before = self.bench.binding.inflation
        best = self.reweighed(best)
        if self.bench.binding.inflation != before:
            nominal = self._posed_again(nominal)
        best, nominal = self.released(best, nominal)
        return nominal, self.thinned(nominal, best, tried)

    def gained(
        self, before: Hypothesis, after: Hypothesis, joints: Sequence[int] | None = None
    ) -> float:
        """By how much the log evidence of fit and validation runs rises from one model to another
        at some joints (default: all), priors and the price of effects counted.
        """
        found = [self.evidence(h, *_left(h), joints) for h in (before, after)]
        return float(found[1] - found[0])

    def evidence(
        self,
        h: Hypothesis,
        left: np.ndarray,
        count: np.ndarray,
        joints: Sequence[int] | None = None,
    ) -> float:
        """Log evidence of a model that leaves these sums of squares of so many samples, [outputs],
        at some joints (default: all), priors and the price of effects counted.
        """
        joints = range(self.bench.binding.chain.nq) if joints is None else joints
        directions = RULE.directions
        if len(joints) > TOGETHER:
            directions /= len(joints)
        own = log_evidence(left[list(joints)], count[list(joints)], directions)
        return float(own.sum()) - self._price(h)

    def _price(self, h: Hypothesis) -> float:
        """What the effects of a model and the numbers of its file cost."""
        own = float(RULE.per_number * h.size - RULE.log_prior * len(h.effects))
        return own + sum(self._departure(h, int(i)) for i in h.path.problem.free)

    def with_what_the_file_lacks(self, search: SearchResult) -> SearchResult:
        """A brake that the file leaves at nothing (`damping`, `frictionloss` of a joint) and that
        re-tuning made something of is an effect that the file lacks: the model without it is the
        nominal one, and it is taken back where it is not missed. Where more is left than the noise,
        it may stand for what is not known, and stays a number.
        """
        b, chosen = self.bench.binding, search.chosen
        lacked = [c for c in absent_effects(b) if all(chosen.theta[i] != 0.0 for i in c.index)]
        if not lacked:
            return search
        self.asked, tried = frozenset(i for c in lacked for i in c.index), list(search.tried)
        theta = search.nominal.theta.copy()
        theta[list(self.asked)] = 0.0
        self.total += 1
        nominal = self.refit((), theta)
        whole = replace(chosen, effects=(*lacked, *chosen.effects))
        if not np.isfinite(nominal.fit_loss) or not self.gained(nominal, whole) > 0:
            self.asked = frozenset()
            return search
        whole = self.thinned(nominal, whole, tried)
        belief = search.belief and search.belief.beside(self.certain(lacked)).at_most(self.sure)
        found = replace(
            search,
            belief=belief,
            nominal=nominal,
            chosen=whole,
            tried=[*tried, whole],
            several=len({c.effect for c in whole.effects}) > 1,
        )
        if judge(found).name == "named":
            return found
        self.asked = frozenset()
        return search

    def believed(self, search: SearchResult) -> SearchResult:
        """What columns told of effects beside what was chosen is refuted where that is at the
        noise.
        """
        if search.belief is None or not search.chosen.at_noise:
            return search
        named = [(c.effect, c.location) for c in search.chosen.effects]
        belief = search.belief.at_the_noise(self.sure, named)
        possible = {place[:2] for place in belief.possible(RULE.possible)}
        for family in belief.families:
            possible |= set(family.places)
        alike = [c for c in search.confusable if (c.effect, c.location) in possible]
        return replace(search, belief=belief, confusable=alike)

    def certain(self, effects: Sequence[Candidate]) -> dict[tuple[str, str], float]:
        """How probable simulations make each of some effects."""
        places = [(c.effect, c.location) for c in effects]
        return {place: self.sure.get(place, 1.0) for place in places}

    def compare(self, won: Hypothesis, tried: Sequence[Hypothesis]) -> None:
        """How probable effects are, of the set that won and of all others that were simulated
        beside it.
        """
        every = [won, *tried]
        self.compared = ComparedSets.by_evidence(
            (places_of(h.effects), self.gained(won, h)) for h in every
        )
        self.sure |= self.compared.places

    def rivals(self, chosen: Hypothesis, tried: Sequence[Hypothesis]) -> list[Candidate]:
        """Effects of other sets that are possible in the place of those that are chosen."""
        every: dict[Candidate, None] = {}
        for h in tried:
            every |= dict.fromkeys(h.effects)
        others = [c for c in every if c not in chosen.effects]
        return [c for c in others if self.sure.get((c.effect, c.location), 0.0) >= RULE.possible]

    def thinned(
        self, nominal: Hypothesis, chosen: Hypothesis, tried: list[Hypothesis]
    ) -> Hypothesis:
        """Without what is not missed, place by place: what the evidence without it does not refute
        with the probability of a claim.
        """
        least = RULE.log_odds
        for c in sorted(chosen.effects, key=lambda c: self._foreseen(chosen, c)):
            left = [e for e in chosen.effects if e is not c]
            gained = self._foreseen(chosen, c)
            less = nominal
            if left and gained < SURELY * least:
                theta = chosen.theta.copy()
                theta[list(c.index)] = self.bench.binding.theta[list(c.index)]
                self.total += 1
                less = self.refit(left, theta, chosen)
                tried.append(less)
            if not left or less is not nominal:
                gained = self.gained(less, chosen, self._joints(c))
            place = c.effect, c.location
            self.sure[place] = min(_probability(gained), self.sure.get(place, 1.0))
            if gained < least:
                chosen = less
        return chosen

    def _joints(self, c: Candidate) -> Sequence[int]:
        """The joints at which an effect is judged: its own, or all of them."""
        model = self.bench.binding.chain
        kind = next(e for e in model.effects if e.name == c.effect)
        if isinstance(kind, BodyEffect) or " and " in c.location:
            return range(model.nq)
        return [model.places(kind).index(c.location) % model.nq]

    def _foreseen(self, h: Hypothesis, c: Candidate) -> float:
        """By how much the fit runs alone would miss an effect, log evidence, to second order about
        where the fit stands; nothing where that is not known.
        """
        p, H, b = h.path.problem, h.path.hessian, self.bench.binding
        at = [k for k, i in enumerate(p.free) if i in c.index and not b.layout.log[i]]
        if H is None or not at or not np.isfinite(H).all():
            return 0.0
        others = [k for k in range(len(H)) if k not in at]
        S = (
            H[np.ix_(at, at)]
            - H[np.ix_(at, others)]
            @ np.linalg.pinv(H[np.ix_(others, others)], hermitian=True)
            @ H[np.ix_(others, at)]
        )
        d = h.path.z[at] - b.theta[p.free[at]]
        missed, (left, count) = float(d @ S @ d), _left(h)
        beyond = max(float(left.sum() - count.sum()), 0.0)
        directions = RULE.directions
        gained = directions / 2 * np.log1p(missed / (beyond + directions))
        return float(gained + RULE.log_prior - RULE.per_number * len(c.index))


def _probability(gained: float) -> float:
    """That of what raises the log evidence by so much."""
    return float(1 / (1 + np.exp(-np.clip(gained, -LARGEST, LARGEST))))


def _left(h: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squares over the noise of fit and validation runs, and their samples, [outputs]."""
    return squares_of([*h.residuals, *h.validation.settled])


def squares_of(residuals: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squares of runs [samples outputs], and their samples, [outputs]."""
    left = np.sum([np.sum(r**2, axis=0) for r in residuals], axis=0)
    return left, np.full(len(left), float(sum(map(len, residuals))))
