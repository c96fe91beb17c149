"""Candidates and hypotheses: effects at places, and models refitted with some of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.wording import names_of
from jaxid.diagnosis.belief import Belief
from jaxid.diagnosis.evidence import HeldOut, level, memory
from jaxid.diagnosis.torque.library import shows
from jaxid.dynamics import catalogue
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Effect
from jaxid.fitting.covariance import covariance, CovarianceEstimate
from jaxid.fitting.effect_starts import probes, read_off
from jaxid.fitting.least_squares import Path
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.secant import Slopes
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import InverseDynamics


@dataclass(frozen=True)
class Candidate:
    """An effect at a location: the positions of its parameters in the layout."""

    effect: str
    location: str
    index: tuple[int, ...]
    refines: str = ""

    def __str__(self) -> str:
        return f"{self.effect} at {self.location}"


@dataclass
class Hypothesis:
    """A set of effects with the model refitted to it, and what it predicts. `left_open`: mean
    square over the noise by which runs that touch move within what the fit leaves open, by split.
    `slopes`: of the fit runs where a descent on secants ended.
    """

    effects: tuple[Candidate, ...]
    theta: np.ndarray
    path: Path
    validation: HeldOut
    left_open: Mapping[str, float] = field(default_factory=dict)
    slopes: Slopes | None = None

    @property
    def fit_loss(self) -> float:
        return self.path.loss

    @property
    def at_noise(self) -> bool:
        """Whether fit and validation runs are followed to the noise."""
        fit = level(self.path.count) + self.left_open.get("fit", 0.0)
        return bool(self.fit_loss <= fit) and self.validation_at_noise

    @property
    def validation_at_noise(self) -> bool:
        allowed = level(self.validation.count) + self.left_open.get("validation", 0.0)
        return bool(self.validation.loss <= allowed)

    @cached_property
    def residuals(self) -> list[np.ndarray]:
        """What it leaves of each fit run over the noise, [samples columns]; simulated once."""
        return self.path.problem.residuals(self.path.z)

    @property
    def index(self) -> tuple[int, ...]:
        """Positions of the effects' numbers in the layout."""
        return tuple(chain.from_iterable(c.index for c in self.effects))

    @property
    def size(self) -> int:
        """Number of effect parameters."""
        return len(self.index)

    @property
    def departed(self) -> float:
        """By how much its numbers depart from what is stated of them, chi-square units. The loss of
        the fit runs has it too.
        """
        known, _ = self.path.problem.known_before(self.path.z)
        return float(known @ known)

    @cached_property
    def fit_inflation(self) -> float:
        """What `evidence.inflation` is for held-out runs, for the residual of the fit runs."""
        return max(1.0, self.fit_loss) * memory(self.residuals)

    @cached_property
    def covariance(self) -> CovarianceEstimate:
        """Of the fitted numbers, in search scale: slopes of all of them are simulated for it,
        once.
        """
        return covariance(self.path.problem, self.path.z)

    @property
    def bic(self) -> float:
        return self.path.count * np.log(
            max(self.fit_loss, 1e-300)
        ) + self.path.problem.free.size * np.log(max(2, self.path.count))


@dataclass
class SearchResult:
    """What the search found: the accepted steps, and all that was tried on the way.

    `rivals`: the two hypotheses between which further data should decide. `several`: more than one
    effect was chosen, and motions are simulated. `without`: what is left on validation data, in
    multiples of the noise, where one of several is taken out and the rest refitted; what is missed
    most comes first. `settled`: nominal and chosen, refitted to the runs that fitted and to those
    that chose. `stands`: the model with nothing re-tuned, where the chosen effects were asked
    beside that. `cut_short`: not all was asked, as the search had simulated as much as it may.
    `belief`: probabilities of what was fitted.
    """

    nominal: Hypothesis
    chosen: Hypothesis
    tried: list[Hypothesis] = field(default_factory=list)
    confusable: list[Candidate] = field(default_factory=list)
    rivals: tuple[Hypothesis, Hypothesis] | None = None
    several: bool = False
    without: tuple[tuple[Candidate, float], ...] = ()
    settled: tuple[Hypothesis, Hypothesis] | None = None
    stands: Hypothesis | None = None
    cut_short: bool = False
    belief: Belief | None = None

    def believed(self, claimed: bool) -> Belief | None:
        """The probabilities, where what was chosen is claimed or is not."""
        if self.belief is None or claimed:
            return self.belief
        return replace(self.belief, probability=None, families=(), worth={})


def without_each(
    h: Hypothesis, known: Mapping[frozenset[str], Hypothesis]
) -> tuple[tuple[Candidate, float], ...]:
    """What the effects of a hypothesis contribute: see `SearchResult.without`; the refits are among
    those known.
    """
    if len(h.effects) < 2:
        return ()
    left = []
    for k, c in enumerate(h.effects):
        less = known.get(key_of([*h.effects[:k], *h.effects[k + 1 :]]))
        if less is not None:
            left.append((c, float(np.sqrt(max(less.validation.loss, 0.0)))))
    return tuple(sorted(left, key=lambda pair: -pair[1]))


def candidates(bench: ProblemBuilder, allowed: Sequence[str]) -> list[Candidate]:
    """Every allowed effect that the model lacks, at each of its locations."""
    b = bench.binding
    out = []
    for effect in b.chain.effects:
        if effect.name in allowed and not any(
            i in b.nominal for i in b.layout.of_effect(effect.name)
        ):
            for place in b.chain.offers(effect):
                index = tuple(b.layout.of_effect(effect.name, place))
                present = (
                    any(i in b.nominal for i in b.layout.of_effect(effect.refines, place))
                    or effect.refines not in allowed
                )
                out.append(Candidate(effect.name, place, index, "" if present else effect.refines))
    return out


def possible(nominal: Chain, names: Iterable[str], residual: str = "") -> list[type[Effect]]:
    """Those effects that a model lacks and has a place for, and that a residual can see; raises
    `UsageError` for a name that does not exist.
    """
    kinds = [catalogue.effect_class(n, nominal.mechanism) for n in names]
    lacking = [k for k in kinds if k.name not in nominal.contents and nominal.offers(k)]
    return [k for k in lacking if residual != InverseDynamics.name or shows(k, nominal)]


def check_asked(nominal: Chain, asked: Sequence[str], residual: str = "") -> None:
    """Raises `UsageError` where an effect that was asked for cannot be a candidate."""
    model, why = nominal.mechanism.name, []
    for name in asked:
        if name in nominal.contents:
            taken, *_ = [e.name for e in nominal.effects if name in (e.name, *e.contains)]
            why.append(
                f"{name} is part of {model} already (left out with `without`, {taken} becomes a"
                " candidate)"
            )
        elif not possible(nominal, [name]):
            why.append(f"{model} cannot take {name}")
        elif not possible(nominal, [name], residual):
            why.append(f"{residual} compares torques at joints and cannot see {name}")
    if why:
        able = names_of(possible(nominal, catalogue.effect_names(), residual))
        raise UsageError(f"{'; '.join(why)}. Candidates are: {', '.join(able) or 'none'}")


def sensible(effects: Sequence[Candidate]) -> bool:
    """Whether every effect that refines another has that one beside it: Stribeck friction is what
    dry friction has more of at low speed, and without it would be a law of its own that no surface
    has; only where nothing is left of that one in the end is it taken out.
    """
    return all(not c.refines or refined_by(c, effects) for c in effects)


def refined_by(c: Candidate, pool: Sequence[Candidate]) -> list[Candidate]:
    """The effect of a pool that a candidate refines."""
    return [e for e in pool if e.effect == c.refines and e.location == c.location]


def key_of(effects: Sequence[Candidate]) -> frozenset[str]:
    return frozenset(map(str, effects))


def effect_of(bench: ProblemBuilder, c: Candidate) -> Effect:
    return next(e for e in bench.binding.chain.effects if e.name == c.effect)


def read_off_of(
    bench: ProblemBuilder, p: FitProblem, z: np.ndarray, c: Candidate
) -> list[np.ndarray]:
    """Parameter vectors with a candidate as the missing force of a problem of torques shows it."""
    return read_off(bench.binding, p, z, effect_of(bench, c), c.location)


def probes_of(bench: ProblemBuilder, c: Candidate, theta: np.ndarray) -> list[np.ndarray]:
    """Parameter vectors with one candidate switched on at each of its probe strengths."""
    return probes(bench.binding, effect_of(bench, c), c.location, theta)


def probes_of_all(
    bench: ProblemBuilder, pool: Sequence[Candidate], theta: np.ndarray
) -> tuple[list[Candidate], list[np.ndarray]]:
    """Every probe of each candidate: whose it is, and its numbers [layout]."""
    owners: list[Candidate] = []
    thetas: list[np.ndarray] = []
    for c in pool:
        probed = probes_of(bench, c, theta)
        owners += [c] * len(probed)
        thetas += probed
    return owners, thetas
