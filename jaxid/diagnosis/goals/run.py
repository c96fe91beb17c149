"""A robot that goals drive, diagnosed: proposed along the measured motion, decided by simulation
under the law.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from jaxid.base.errors import UsageError
from jaxid.base.wording import listed, names_of
from jaxid.data.dataset import Dataset
from jaxid.diagnosis.goals.as_stated import AsStated
from jaxid.diagnosis.goals.asked import Answer, GoalsQuestion, simulated_step
from jaxid.diagnosis.goals.further import with_what_is_still_missing
from jaxid.diagnosis.goals.gains import asked_for, known_loosely, with_room
from jaxid.diagnosis.goals.in_file_steps import with_numbers_of_the_file
from jaxid.diagnosis.goals.law_told import law_told
from jaxid.diagnosis.goals.own_run import run_of_file, stepped_changes, without_steps
from jaxid.diagnosis.goals.propose import (
    as_vector,
    kinds_of,
    Proposal,
    proposals,
    ProposedSets,
    shown,
)
from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.goals.settings import (
    delays_said,
    otherwise,
    settings_of,
    SimulationSetting,
    stepped_by,
)
from jaxid.diagnosis.goals.study import LedStudy
from jaxid.diagnosis.goals.touching import simulated_changes, simulated_effects
from jaxid.diagnosis.hypothesis import Hypothesis, SearchResult
from jaxid.diagnosis.question import Offer, SearchOutcome
from jaxid.diagnosis.result import Diagnosis
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.joint_readings import all_read
from jaxid.fitting.assemble import assemble
from jaxid.fitting.fitter import Minimum, Progress
from jaxid.fitting.least_squares import Path
from jaxid.fitting.problem_builder import ProblemBuilder, touches
from jaxid.fitting.result import Fit
from jaxid.problem.binding import Binding
from jaxid.problem.residual import OutputError
from jaxid.simulation.sample_buffers import step_count


TOO_DEAR = (
    "simulating recordings of this length with this many numbers would take too long: the torque"
    " that the law asks for along the measured motion is compared instead, and no free run judges"
    " the answer"
)
SETTLED = (
    "numbers are fitted to the fit and validation runs together, once these have chosen the"
    " effects: errors on validation runs are no longer held out, those on report runs are"
)


TOUCHING = (
    "contacts are simulated: how a run begins is fitted to the whole of it, and changes of the file"
    " are asked one at a time"
)
NO_RUN = (
    "a diagnosis over contacts needs the position of every joint, and a run of the file that comes"
    " to its end: here one diverges, or joints are not what is read"
)


#: Steps of all free runs of one linearisation beyond which simulations are not worth their time.
DEAR = 4e6


def dear(binding: Binding) -> bool:
    """Whether a fit by simulation takes too long."""
    step, runs = simulated_step(binding), binding.experiments("fit")
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
    priors = dataset.stated.parameters.values()
    return not chain.mechanism.known() and all(p.prior is None for p in priors)


def begin_simulations(binding: Binding) -> float:
    """The step of the simulations; those of the model alone are being compiled."""
    step = simulated_step(binding)
    ProblemBuilder(binding, step, differences=1).compile_ahead(
        OutputError(), binding.theta, binding.free
    )
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
    binding = with_room(binding)
    step = begin_simulations(binding)  # while the rows are made
    ask = GoalsQuestion(
        model=model,
        dataset=dataset,
        without=without,
        kinds=[k for k in library if shown(k)],
        max_effects=max_effects,
        step=step,
        answer=answer,
        progress=progress,
    )
    notes = []
    if touches(binding):
        found = _touching(ask, binding, seed, began)
    else:
        found, otherwise = _in_its_settings(ask, binding, seed, began)
        notes += otherwise
    left = sorted(k.name for k in library if not shown(k))
    notes.append(
        f"asked along the measured motion: {listed(sorted(names_of(ask.kinds)))}; not asked, for"
        f" they have a motion of their own: {listed(left) or 'none'}"
    )
    return replace(found, notes=(*found.notes, *notes), wall_time_s=time.perf_counter() - began)


def _in_its_settings(
    ask: GoalsQuestion, binding: Binding, seed: int, began: float
) -> tuple[Diagnosis, list[str]]:
    """The diagnosis with the settings of the simulation that the recording has, and a note of each
    that is otherwise than stated.
    """
    stated, asked, notes = ask, settings_of(ask.dataset), []
    while True:
        try:
            found = _diagnosed(ask, binding, seed, began, asked)
            break
        except _Otherwise as turned:
            other = turned.setting
        notes.append(other.said(binding))
        asked.remove(other)
        ask = other.question(ask)
        binding = ask.bound()
    simulator = stated.dataset.stated.simulator
    if ask.dataset.stated.simulator != simulator:
        found = with_numbers_of_the_file(ask.about(stepped_by(ask.dataset, simulator)), found)
    return found, notes


def _diagnosed(
    ask: GoalsQuestion,
    binding: Binding,
    seed: int,
    began: float,
    settings: Sequence[SimulationSetting],
) -> Diagnosis:
    """The diagnosis with settings as they are stated; raises `_Otherwise` where one of some turns
    out not to be so.
    """
    say = ask.progress or (lambda *_: None)
    say("along the motion", 0, 2, "rows")
    study = LedStudy(known_loosely(without_steps(binding)), ask.kinds)
    say("along the motion", 1, 2, f"effects, {len(ask.kinds)} kinds")
    notes: list[str] = []

    run = run_of_file(bench := ask.made(binding))
    stated = None
    if run is not None and stands(binding.chain, ask.dataset):
        stated = AsStated(bench, run, lambda: stepped_changes(binding, ask.kinds))
    by_itself = stated is not None and stated.stands
    near = binding.theta if by_itself else study.theta
    names, bare = binding.layout.names, Proposal((), (), near)
    road = _Road(ask, names, bare, seed, began, settings)
    alone = kinds_of([c.proposal for c in stated.changes]) if stated is not None else []
    if stated is not None:
        stated.ask(lambda: ask.made(ask.bound(alone)), ask.progress)

    if stated is not None and stated.explains:
        found, more = _as_stated(ask, road, stated, alone)
        notes += more
    else:
        found = _searched(ask, road, study, stated.nearest if stated is not None else None)
    if study.of("validation"):
        notes.append(SETTLED)
    notes += law_told(found.final, binding.chain.signature.joints)
    notes += delays_said(binding, [e.effect for e in found.which.effects])
    notes.append(
        f"{found.nominal.evaluations} free runs were simulated under the law, in steps of"
        f" {ask.step:.2g} s at most"
    )
    return replace(found, notes=(*found.notes, *notes))


def _touching(ask: GoalsQuestion, binding: Binding, seed: int, began: float) -> Diagnosis:
    """The diagnosis of runs that touch: by single changes of the file, which are simulated."""
    bench = ask.made(binding)
    say = ask.progress or (lambda *_: None)
    say("the file's own run", 0, 1, "how runs begin")
    run = run_of_file(bench)
    if run is None:
        raise UsageError(NO_RUN)

    def begun_as(names: Sequence[str]) -> ProblemBuilder:
        other = ask.made(ask.bound(names))
        other.begin_as(bench)
        return other

    every = [kind.name for kind in ask.kinds]
    wide = begun_as(every)
    say("the file's own run", 1, 1, f"changes, {len(every)} kinds of effects")
    stated = AsStated(bench, run, lambda: simulated_changes(bench, wide, binding, ask.kinds))
    alone = kinds_of([change.proposal for change in stated.changes])
    road = _Road(
        ask=ask,
        names=binding.layout.names,
        bare=Proposal((), (), binding.theta),
        seed=seed,
        began=began,
    )
    stated.ask(lambda: begun_as(alone), ask.progress)
    if stated.begin is not None:
        road.retuned = stated.enough[0]
    road.begun = stated.alone.decider.bench if stated.alone is not None else bench
    if stated.explains:
        found, notes = _as_stated(ask, road, stated, alone, only=stated.moved)
    else:
        found, notes = _beside_numbers(ask, road, binding, every), []
    notes.append(TOUCHING)
    return replace(found, notes=(*found.notes, *notes))


def _beside_numbers(
    ask: GoalsQuestion, road: _Road, binding: Binding, every: Sequence[str]
) -> Diagnosis:
    """The diagnosis where no change explains the runs by itself: effects beside numbers that are
    re-tuned, one at a time.
    """
    wide = ask.made(ask.known(every))
    first = Decider(wide, road.names, ask.progress)
    retuned = first.refit((), as_vector(wide.binding, road.names, road.bare))
    own = retuned.theta[[wide.binding.layout.index(name) for name in road.names]]
    road.bare = Proposal((), (), own)
    sets = tuple(simulated_effects(wide, binding, ask.kinds, retuned))
    names = kinds_of(sets)

    def decide(decider: Decider, nominal: Hypothesis) -> tuple[Decider, SearchResult]:
        return decider, decider.decided(nominal, ProposedSets(road.bare, sets))

    return ask.answer(
        ask.known(names), names, lambda bench, offer: road(bench, offer, decide), ask.step
    )


def _as_stated(
    ask: GoalsQuestion,
    road: _Road,
    stated: AsStated,
    names: Sequence[str],
    only: Sequence[str] | None = None,
) -> tuple[Diagnosis, list[str]]:
    """The diagnosis of a recording that the file explains but for one change, and its notes; `only`
    these numbers of the model are re-tuned, by default all.
    """
    notes, own = [], ask.bound(names, stated.gains)
    if only is not None:
        own = replace(own, free=[own.layout.index(name) for name in only])
    if stated.begin is not None:
        road.bare = Proposal((), (), stated.begin)
    if stated.gains:
        notes.append(asked_for(own, stated.gains))

    def decide(decider: Decider, nominal: Hypothesis) -> tuple[Decider, SearchResult]:
        found = stated.decided(decider, nominal)
        road.question(decider, found, road.settings)
        return decider, found

    found = ask.answer(
        own,
        names if stated.lacks else (),
        lambda bench, offer: road(bench, offer, decide),
        ask.step,
    )
    text = f"{found.which.text} {stated.said(found.which.verdict)}".strip()
    return replace(found, which=replace(found.which, text=text)), notes


def _searched(
    ask: GoalsQuestion, road: _Road, study: LedStudy, alone: Proposal | None
) -> Diagnosis:
    """The diagnosis by effects beside numbers that are re-tuned. `alone`: effects that explain most
    where nothing is re-tuned, which first order about re-tuned numbers may not show.
    """
    proposed = proposals(study, ask.max_effects)
    if alone is not None:
        proposed = replace(proposed, sets=(*proposed.sets, alone))
    road.bare = proposed.bare
    names = kinds_of(proposed.sets)

    def decide(decider: Decider, nominal: Hypothesis) -> tuple[Decider, SearchResult]:
        first = decider.decided(nominal, proposed)
        decider, found = with_what_is_still_missing(ask, decider, first)
        road.question(decider, found, road.settings)
        return decider, decider.with_what_the_file_lacks(decider.believed(found))

    return ask.answer(
        ask.known(names, proposed.inflation),
        names,
        lambda bench, offer: road(bench, offer, decide),
        ask.step,
    )


class _Otherwise(Exception):
    """A setting of the simulation is otherwise than stated: another diagnosis has to take the place
    of this one.
    """

    def __init__(self, setting: SimulationSetting):
        super().__init__(setting)
        self.setting = setting


#: From the nominal model what is chosen, and the decider whose simulations that is of.
Decide = Callable[[Decider, Hypothesis], tuple[Decider, SearchResult]]


@dataclass
class _Road:
    """From a bench to the re-tuned nominal model and what is chosen."""

    ask: GoalsQuestion
    names: Sequence[str]
    bare: Proposal
    seed: int
    began: float
    settings: Sequence[SimulationSetting] = ()  # that may be otherwise than stated
    retuned: Hypothesis | None = None  # the re-tuned model, where another bench fitted it
    begun: ProblemBuilder | None = None  # of models whose runs begin alike

    def __call__(
        self,
        bench: ProblemBuilder,
        offer: Offer,
        decide: Decide,
    ) -> SearchOutcome:
        if self.begun is not None:
            bench.begin_as(self.begun)
        first = Decider(bench, self.names, self.ask.progress)
        theta = as_vector(bench.binding, self.names, self.bare)
        if self.retuned is None:
            nominal = first.refit((), theta)
        else:
            nominal = first.taken_over(self.retuned)
        search = SearchResult(nominal, nominal)
        offer(lambda: self._fitted(first, nominal.path), search)
        self.question(first, search, [s for s in self.settings if s.at_once])
        decider, search = decide(first, nominal)
        plain = decider.settled(search.nominal)
        search.settled = plain, decider.settled(search.chosen) if search.chosen.effects else plain
        return SearchOutcome(
            bench=decider.bench,
            nominal_fit=self._fitted(decider, plain.path),
            search=search,
            compile_time=decider.bench.compile_time(),
        )

    def question(
        self, decider: Decider, search: SearchResult, settings: Sequence[SimulationSetting]
    ) -> None:
        """Raises `_Otherwise` where a setting is otherwise than stated, beside what was found."""
        setting = otherwise(settings, self.ask, decider, search)
        if setting is not None:
            raise _Otherwise(setting)

    def _fitted(self, decider: Decider, path: Path) -> Fit:
        """A descent on the bench of a decider as a fit."""
        minimum = Minimum(path.z, path.loss, path.converged, path.stopped, decider.evaluations, [])
        return assemble(
            bench=decider.bench,
            problem=path.problem,
            result=minimum,
            residual=OutputError(),
            fitter="lm",
            seed=self.seed,
            compile_time=decider.bench.compile_time(),
            wall_time=time.perf_counter() - self.began,
        )
