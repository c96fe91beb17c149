"""A robot that goals drive, diagnosed: proposed along the measured motion, decided by simulation
under the law.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxid.data.dataset import Dataset
from jaxid.diagnosis.goals.as_stated import AsStated
from jaxid.diagnosis.goals.floor import between_simulators, not_this_file, with_floor
from jaxid.diagnosis.goals.law_told import law_told
from jaxid.diagnosis.goals.propose import (
    as_vector,
    goes_the_other_way,
    kinds_of,
    Proposal,
    proposals,
    shown,
    with_other_hold,
)
from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.goals.study import LedStudy, loop_step
from jaxid.diagnosis.hypothesis import Hypothesis, Search
from jaxid.diagnosis.result import Diagnosis
from jaxid.diagnosis.verdict import level
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.joint_readings import all_read
from jaxid.fitting.assemble import assemble
from jaxid.fitting.fitter import Minimum, Progress
from jaxid.fitting.least_squares import Path
from jaxid.fitting.problem_builder import Bench
from jaxid.fitting.result import Fit
from jaxid.problem.binding import bind, Binding
from jaxid.problem.residual import OutputError
from jaxid.simulation.sample_buffers import STEP, step_count
from jaxid.wording import listed


#: Is told of the nominal fit and of what is known so far: what a run that is stopped keeps.
Offer = Callable[[Callable[[], Fit], Search], None]

Answer = Callable[
    [Binding, Sequence[str], Callable[[Bench, Offer], tuple[Fit, Search]], float], Diagnosis
]

TOO_DEAR = (
    "simulating recordings of this length with this many numbers would take too long: the torque that the law asks for along the "
    "measured motion is compared instead, and no free run judges the answer"
)
MEANING = (
    "standard deviations of the file's numbers and of the effects count what MuJoCo and jaxid make of the same file: its "
    "first-order steps and soft friction pass for other numbers"
)
OTHER_WAY = (
    "the goals go {} from sample to sample here, not {} as the dataset has it: the re-tuned model follows them better so on data "
    "that were and were not fitted (state hold of the goals' channels where that is wrong)"
)
THEIRS = (
    "Its noise is what MuJoCo and jaxid make of the same file; no effect explains what is nearer."
)
SETTLED = (
    "numbers are fitted to the fit and validation runs together, once these have chosen the effects: errors on validation runs "
    "are no longer held out, those on report runs are"
)
WORDS = {"zero": "held", "linear": "along straight lines"}


#: So many refits, about, tell what single change of a file explains a recording.
REFITS = 20
#: Steps of all free runs of one linearisation beyond which simulations are not worth their time.
DEAR = 4e6


def dear(binding: Binding) -> bool:
    """Whether a fit by simulation takes too long."""
    step, runs = max(STEP, loop_step(binding)), binding.experiments("fit")
    lanes = 1 + len(binding.free) + 2 * binding.chain.nq * len(runs)
    return sum(step_count(e, step) for e in runs) * lanes > DEAR


def led(chain: Chain) -> bool:
    """Whether goals drive a model through a law, with every joint measured."""
    law = getattr(chain.mechanism, "drive_law", None)
    return (
        law is not None
        and law.kind != "pid"
        and not chain.mechanism.hidden_states
        and all_read(chain)
    )


def stands(chain: Chain, dataset: Dataset) -> bool:
    """Whether the numbers of a model stand until they are doubted: the dataset asks for none of its
    law, and knows none of the others only so well.
    """
    stated = dataset.model.parameters.values() if dataset.model is not None else ()
    return not chain.mechanism.known() and all(p.prior is None for p in stated)


def begin_simulations(binding: Binding) -> float:
    """The step of the simulations; those of the model alone are being compiled."""
    step = max(STEP, loop_step(binding))
    Bench(binding, step, differences=1).compile_ahead(OutputError(), binding.theta, binding.free)
    return step


def diagnose_led(
    model: object,
    dataset: Dataset,
    binding: Binding,
    without: tuple[str, ...],
    library: Sequence[type[Effect]],
    max_effects: int,
    seed: int,
    progress: Progress | None,
    answer: Answer,
) -> Diagnosis:
    """The diagnosis of a binding without candidates; `answer(binding with candidates, names of
    effects, search, step)` makes that of a search on simulations in such steps.
    """
    began = time.perf_counter()
    say = progress or (lambda *_: None)
    say("along the motion", 0, 3, "rows")
    step = begin_simulations(binding)  # while the rows are made
    kinds = [k for k in library if shown(k)]
    study, notes = LedStudy(binding, kinds), []
    swapped = with_other_hold(dataset)
    other = LedStudy(bind(model, swapped, without=without), kinds, begin=study.theta)
    if goes_the_other_way(study, other):
        hold = dataset.inputs[0].hold
        notes.append(
            OTHER_WAY.format(WORDS[other.binding.dataset.inputs[0].hold], WORDS.get(hold, hold))
        )
        dataset, study = swapped, other
        study.tuned(study.theta)
    say("along the motion", 1, 3, "noise")
    made = lambda b: Bench(b, step, differences=1, together=True)
    with_kinds = lambda names: bind(
        model, dataset, without=without, candidates=[k for k in kinds if k.name in names]
    )
    plain = study.binding
    between = between_simulators(bench := made(plain))  # the program that is there
    series = None if between is None else between.apart
    doubts, apart, simulated = {}, None, None
    if between is not None:
        doubts, apart = (
            study.taken_up(between.apart, clocks=False)[0],
            study.taken_up(between.apart)[1],
        )
        simulated = study.taken_up(between.at_once(plain.experiments("fit")), clocks=False)[1]
    study = study.with_binding(with_floor(plain, apart))
    say("along the motion", 2, 3, f"effects, {len(kinds)} kinds")
    asked = f"asked along the measured motion: {listed(sorted(k.name for k in kinds))}"
    left = sorted(k.name for k in library if not shown(k))
    notes.append(
        f"{asked}; not asked, for they have a motion of their own: {listed(left) or 'none'}"
    )

    stated = (
        AsStated(bench, study, kinds, between)
        if between is not None and stands(plain.chain, dataset)
        else None
    )
    strange = not_this_file(plain, between, simulated)
    by_itself = strange or (stated is not None and stated.stands)
    near = plain.theta if by_itself else study.theta
    road = _Road(plain.layout.names, Proposal((), (), near), seed, began, progress)
    alone = kinds_of([c.proposal for c in stated.changes]) if stated is not None else []
    if stated is not None:
        stated.ask(lambda floor: made(with_floor(with_kinds(alone), floor)), progress)

    if stated is not None and stated.explains:
        names, taken, doubts = alone, stated.difference, stated.doubts
        own = with_floor(with_kinds(names), taken.floor, doubts)
        found = answer(
            own,
            names if stated.lacks else (),
            lambda b, offer: road(taken.off(b), offer, stated.decided),
            step,
        )
        found = replace(
            found, which=replace(found.which, text=f"{found.which.text} {stated.said()}".strip())
        )
        notes.append(taken.said(plain))
        # The readings have gone through the steps of the file's simulator already: delays are its
        # own.
        found = replace(
            found, final=replace(found.final, robot={**found.final.robot, "taken_off": True})
        )
    elif strange:  # what is left is judged by the readings' own noise, and nothing is asked
        found = answer(plain, (), lambda bench, offer: road(bench, offer, with_sets([])), step)
        found = replace(found, which=replace(found.which, text=f"{found.which.text} {strange}"))
    else:
        road.bare, sets = proposals(study, max_effects)
        names, limit = kinds_of(sets), Limit()
        wide = with_floor(with_kinds(names), apart, doubts)
        found = answer(
            wide,
            names,
            lambda bench, offer: road(bench, offer, with_sets(sets, limit), series),
            step,
        )
        if found.which.verdict == "unknown" and limit.reached and between is not None:
            # No effect is borne out, and what two simulators of the file as it stands differ by
            # accounts for what is left.
            again = with_floor(plain, between.size, doubts)
            nothing = answer(
                again, (), lambda bench, offer: road(bench, offer, with_sets([])), step
            )
            if nothing.which.verdict == "none":
                text = f"{nothing.which.text} {THEIRS}"
                found = replace(
                    nothing, which=replace(nothing.which, text=text, ranking=found.which.ranking)
                )
    if doubts:
        notes.append(MEANING)
    if study.of("validation"):
        notes.append(SETTLED)
    notes += law_told(found.final, binding.chain.signature.joints)
    notes.append(
        f"{found.nominal.evaluations} free runs were simulated under the law, in steps of {step:.2g} s at most"
    )
    return replace(found, notes=(*found.notes, *notes), wall_time_s=time.perf_counter() - began)


@dataclass
class Limit:
    """Whether what two simulators differ by accounts for what the nominal model leaves."""

    reached: bool = False


#: From the nominal model what is chosen.
Decide = Callable[[Decider, Hypothesis], Search]


def with_sets(sets: Sequence[Proposal], limit: Limit | None = None) -> Decide:
    """What simulations bear out of some sets of effects, beside numbers that are re-tuned."""

    def decide(decider: Decider, nominal: Hypothesis) -> Search:
        most = decider.with_their_difference(nominal)
        if limit is not None:
            limit.reached = most <= level(nominal.path.count)
        return decider.with_what_the_file_lacks(decider.decided(nominal, sets, most))

    return decide


@dataclass
class _Road:
    """From a bench to the re-tuned nominal model and what is chosen."""

    names: Sequence[str]
    bare: Proposal
    seed: int
    began: float
    progress: Progress | None

    def __call__(
        self,
        bench: Bench,
        offer: Offer,
        decide: Decide,
        between: Sequence[np.ndarray] | None = None,
    ) -> tuple[Fit, Search]:
        decider = Decider(bench, self.names, between, self.progress)
        theta = as_vector(bench.binding, self.names, self.bare)
        nominal = decider.refit((), theta)

        def fitted(path: Path = nominal.path) -> Fit:
            minimum = Minimum(
                path.z, path.loss, path.converged, path.stopped, decider.evaluations, []
            )
            spent = time.perf_counter() - self.began
            return assemble(
                bench=bench,
                problem=path.problem,
                result=minimum,
                residual=OutputError(),
                fitter="lm",
                seed=self.seed,
                compile_time=bench.compile_time(),
                wall_time=spent,
            )

        offer(fitted, Search(nominal, nominal))
        search = decide(decider, nominal)
        plain = decider.settled(search.nominal)
        bench.doubt(decider.passes_for(search.chosen))
        search.settled = plain, decider.settled(search.chosen) if search.chosen.effects else plain
        return fitted(plain.path), search
