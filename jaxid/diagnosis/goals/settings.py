"""What a simulation is told beside its model, and may be otherwise: how goals run from sample to
sample, in which steps the machine moves, and whether its joints stick.

A log of a goal says when it was asked, not what the drive made of it until the next one. A file
says in which steps its simulator moves a robot; steps of first order add to inertias and let
commands act early, as they do in a recording of that simulator and not in one of a machine; and its
soft friction lets a joint creep that a machine's holds. Each is one more thing that is judged like
an effect: by simulation, beside what was found, with the evidence that a claim needs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from jaxid.data.dataset import Dataset
from jaxid.diagnosis.goals.asked import GoalsQuestion
from jaxid.diagnosis.goals.search import Decider, squares_of
from jaxid.diagnosis.hypothesis import Hypothesis, SearchResult
from jaxid.diagnosis.probability import RULE
from jaxid.diagnosis.screen import Retuning
from jaxid.dynamics.catalogue import effect_class
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.step_shift import left_by_steps
from jaxid.problem.binding import Binding
from jaxid.problem.problem import rows
from jaxid.problem.residual import OutputError
from jaxid.problem.step_error import defects
from jaxid.robots.steps import EXACT_STEPS


OTHER = {"zero": "linear", "linear": "zero"}
WORDS = {"zero": "held", "linear": "along straight lines"}
OTHER_WAY = (
    "the goals go {} from sample to sample here, not {} as the dataset has it: the re-tuned model"
    " follows them better so on data that were and were not fitted (state hold of the goals'"
    " channels where that is wrong)"
)
NO_STEPS = (
    "the machine does not move in the file's {}: without what these leave behind the re-tuned model"
    " follows it better. Numbers are those of the machine; `jaxid export` writes those with which"
    " the file follows it best in its own steps"
)
STICKS = (
    "the machine does not move in the file's {}: with joints that friction holds altogether, and"
    " without what steps leave behind, the re-tuned model follows it better. Numbers are those of"
    " the machine; `jaxid export` writes those with which the file follows it best in its own steps"
)
EARLY = (
    "delays are those for the file's {}, in which commands act {:.2g} ms early: a machine that"
    " takes no steps is as much less late"
)


@dataclass(frozen=True)
class SimulationSetting:
    """Something that may be otherwise than a dataset or a file has it. `changed`: the dataset with
    it. `said`: of a binding as it is stated. `promising`: by a decider as it is stated and one with
    it, which is made where it is asked, models of a search that may follow the runs better so.
    `at_once`: it is asked before effects are, too.
    """

    changed: Callable[[Dataset], Dataset]
    said: Callable[[Binding], str]
    promising: Callable[[Decider, Callable[[], Decider], SearchResult], Promise]
    at_once: bool = False

    def question(self, ask: GoalsQuestion) -> GoalsQuestion:
        """The same question with this setting."""
        return ask.about(self.changed(ask.dataset))

    def decider(self, ask: GoalsQuestion, decider: Decider) -> Decider:
        """A decider whose simulations have this setting."""
        bench = decider.bench
        names = [effect.name for effect in bench.binding.chain.effects]
        other = self.question(ask)
        made = other.bound(names)
        changed = replace(bench.binding, dataset=made.dataset, chain=made.chain, layout=made.layout)
        simulations = ProblemBuilder(
            changed, other.step, bench.differences, together=bench.together
        )
        return replace(decider, bench=simulations, evaluations=0)


def settings_of(dataset: Dataset) -> list[SimulationSetting]:
    """What may be otherwise than a dataset has it: steps that it states stay."""
    if dataset.stated.simulator is not None:
        return [HOLD]
    return [STEPS, STICKING, HOLD]


def otherwise(
    settings: Sequence[SimulationSetting],
    ask: GoalsQuestion,
    decider: Decider,
    search: SearchResult,
) -> SimulationSetting | None:
    """The first of some settings, from the most promising on, with which a model explains what a
    claim has to, beside what was chosen or in its place, and is more probable than that.
    """
    if not search.chosen.effects and search.chosen.at_noise:
        return None
    others = [cache(partial(setting.decider, ask, decider)) for setting in settings]
    promises = [s.promising(decider, o, search) for s, o in zip(settings, others, strict=True)]
    for k in sorted(range(len(settings)), key=lambda k: -promises[k].gained):
        if not promises[k].models:
            continue
        other = others[k]()
        claimed = any(_claimed(decider, other, h, search.chosen) for h in promises[k].models)
        decider.evaluations += other.evaluations
        if claimed:
            return settings[k]
    return None


class Promise(NamedTuple):
    """Models that may follow the runs better with a setting, and by how much the log evidence would
    rise, to first order.
    """

    gained: float
    models: Sequence[Hypothesis]


NOTHING = Promise(0.0, ())


def _claimed(decider: Decider, other: Decider, h: Hypothesis, chosen: Hypothesis) -> bool:
    """Whether a model is missed without a setting, and more probable with it than what was
    chosen.
    """
    with_it = other.refit(h.effects, h.theta)
    gained = decider.gained(h, with_it) + RULE.log_prior
    return gained >= RULE.log_odds and decider.gained(chosen, with_it) + RULE.log_prior > 0


# ---- how goals run


def with_other_hold(dataset: Dataset) -> Dataset:
    """The dataset with goals that go the other way from sample to sample."""
    channels = []
    for c in dataset.channels:
        hold = OTHER.get(c.hold, c.hold) if c.role == "input" else c.hold
        channels.append(replace(c, hold=hold))
    return replace(dataset, channels=tuple(channels))


def _hold_said(stated: Binding) -> str:
    hold = stated.dataset.inputs[0].hold
    return OTHER_WAY.format(WORDS.get(OTHER.get(hold, hold)), WORDS.get(hold, hold))


def _chosen_or_none(_: Decider, __: Callable[[], Decider], search: SearchResult) -> Promise:
    chosen = [search.chosen] if search.chosen.effects else []
    return Promise(0.0, [search.nominal, *chosen])


# ---- steps


def stepped_by(dataset: Dataset, simulator: str | None) -> Dataset:
    """The dataset of a robot that moves in the steps of a simulator; None: in those of its file."""
    return replace(dataset, model=replace(dataset.stated, simulator=simulator))


def _steps_said(stated: Binding) -> str:
    return NO_STEPS.format(stated.chain.mechanism.first_order_steps.said)


def _sticking_said(stated: Binding) -> str:
    tree = stated.chain.mechanism.tree.tree  # type: ignore[attr-defined]
    return STICKS.format(tree.simulator.said)


def delays_said(stated: Binding, named: Iterable[str]) -> list[str]:
    """That delays among the effects that are named are those for the file's steps."""
    steps = stated.chain.mechanism.first_order_steps
    if steps is None or "delay" not in [effect_class(name).quantity() for name in named]:
        return []
    return [EARLY.format(steps.said, 1e3 * steps.delay)]


def _without_steps(decider: Decider, _: Callable[[], Decider], search: SearchResult) -> Promise:
    """Without what the file's steps leave behind."""
    if decider.bench.binding.chain.mechanism.first_order_steps is None:
        return NOTHING

    def apart(h: Hypothesis) -> np.ndarray:
        return left_by_steps(decider.bench, h.path.problem, OutputError(), "fit", h.path.z)

    return _promised(decider, search, apart)


def _sticking(decider: Decider, other: Callable[[], Decider], search: SearchResult) -> Promise:
    """In the steps of another simulator, where joints give way as a file says."""
    if decider.bench.binding.chain.mechanism.own_step is None:
        return NOTHING
    runs = other().bench.runs(OutputError(), "fit")
    return _promised(decider, search, lambda h: defects(h.path.problem, h.path.z, runs))


def _promised(
    decider: Decider, search: SearchResult, apart: Callable[[Hypothesis], np.ndarray]
) -> Promise:
    """What was chosen, or that with fewer effects, whichever is most probable once predictions are
    `apart` by so much, to first order and on the fit runs, if it is more so than what was chosen.
    Models of an earlier question, with other candidates, are left out.
    """
    chosen, names = search.chosen, decider.bench.binding.layout.names
    fewer = [h for h in search.tried if set(h.effects) < set(chosen.effects)]
    every = {id(h): h for h in (search.nominal, *fewer, chosen)}
    measured = [h for h in every.values() if np.isfinite(h.fit_loss)]
    found = [h for h in measured if h.path.problem.runs.layout.names == names]
    foreseen = [_evidence_apart(decider, h, apart(h)) for h in found]
    if not foreseen:
        return NOTHING
    best = int(np.argmax(foreseen))
    as_stated = decider.evidence(chosen, *squares_of(chosen.residuals))
    gained = foreseen[best] + RULE.log_prior - as_stated
    return Promise(gained, [found[best]]) if gained > 0 else NOTHING


def _evidence_apart(decider: Decider, h: Hypothesis, apart: np.ndarray) -> float:
    """Log evidence of the fit runs once predictions are `apart` [samples columns] by so much and
    the numbers are re-tuned, to first order.
    """
    problem, z = h.path.problem, h.path.z
    parts = list(rows([(problem, z)]))
    moved = []
    for part in parts:
        at = problem.runs.record(part.record).samples
        moved.append(part.r + part.w * apart[at])
    retuning = Retuning(parts, problem.size)
    remaining = retuning.remaining(np.concatenate([r.ravel() for r in moved]))
    ends = np.cumsum([r.size for r in moved])[:-1]
    by_run = [x.reshape(r.shape) for x, r in zip(np.split(remaining, ends), moved, strict=True)]
    return decider.evidence(h, *squares_of(by_run))


HOLD = SimulationSetting(with_other_hold, _hold_said, _chosen_or_none)
STEPS = SimulationSetting(
    changed=lambda dataset: stepped_by(dataset, EXACT_STEPS),
    said=_steps_said,
    promising=_without_steps,
    at_once=True,
)
STICKING = SimulationSetting(
    changed=lambda dataset: stepped_by(dataset, "own"),
    said=_sticking_said,
    promising=_sticking,
    at_once=True,
)
