"""What a simulation is told beside its model, and may be otherwise: how goals run from sample to
sample, and in which steps the machine moves.

A log of a goal says when it was asked, not what the drive made of it until the next one. A file
says in which steps its simulator moves a robot; steps of first order add to inertias and let
commands act early, as they do in a recording of that simulator and not in one of a machine. Each is
one more thing that is judged like an effect: by simulation, beside what was found, with the
evidence that a claim needs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

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
EARLY = (
    "delays are those for the file's {}, in which commands act {:.2g} ms early: a machine that"
    " takes no steps is as much less late"
)


@dataclass(frozen=True)
class SimulationSetting:
    """Something that may be otherwise than a dataset or a file has it. `otherwise`: the dataset
    with it. `said`: of a binding as it is stated. `promising`: those of some models that may follow
    the runs better so. `at_once`: it is asked before effects are, too.
    """

    otherwise: Callable[[Dataset], Dataset]
    said: Callable[[Binding], str]
    promising: Callable[[Decider, SearchResult], list[Hypothesis]]
    at_once: bool = False

    def question(self, ask: GoalsQuestion) -> GoalsQuestion:
        """The same question with this setting."""
        return replace(ask, dataset=self.otherwise(ask.dataset))

    def is_so(self, ask: GoalsQuestion, decider: Decider, search: SearchResult) -> bool:
        """Whether it explains what a claim has to, beside what was chosen or in its place, and is
        more probable than what was chosen.
        """
        if not search.chosen.effects and search.chosen.at_noise:
            return False
        found = self.promising(decider, search)
        if not found:
            return False
        ended = {id(h): _ended(decider, h) for h in (*found, search.chosen)}
        chosen = ended[id(search.chosen)]
        if not chosen.effects and chosen.at_noise:
            return False
        other = replace(decider, bench=self._bench(ask, decider))
        claimed = any(_claimed(decider, other, ended[id(h)], chosen) for h in found)
        decider.evaluations = other.evaluations
        return claimed

    def _bench(self, ask: GoalsQuestion, decider: Decider) -> ProblemBuilder:
        """The simulations of a decider with this setting."""
        bench = decider.bench
        names = [effect.name for effect in bench.binding.chain.effects]
        made = self.question(ask).bound(names)
        changed = replace(bench.binding, dataset=made.dataset, chain=made.chain, layout=made.layout)
        return ProblemBuilder(changed, bench.step, bench.differences, together=bench.together)


def _ended(decider: Decider, h: Hypothesis) -> Hypothesis:
    """A model whose descent has ended: what it leaves is not for want of iterations."""
    return h if h.at_noise else decider.polished(h)


def _claimed(decider: Decider, other: Decider, h: Hypothesis, chosen: Hypothesis) -> bool:
    """Whether a model is missed without a setting, and more probable with it than what was
    chosen.
    """
    with_it = other.polished(other.refit(h.effects, h.theta))
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


def _chosen_or_none(decider: Decider, search: SearchResult) -> list[Hypothesis]:
    chosen = [search.chosen] if search.chosen.effects else []
    return [search.nominal, *chosen]


# ---- steps


def with_exact_steps(dataset: Dataset) -> Dataset:
    """The dataset of a robot that moves in steps which leave nothing behind."""
    return replace(dataset, model=replace(dataset.stated, simulator=EXACT_STEPS))


def in_file_steps(ask: GoalsQuestion) -> GoalsQuestion:
    """The question about the robot in the steps of its file."""
    stated = replace(ask.dataset.stated, simulator=None)
    return replace(ask, dataset=replace(ask.dataset, model=stated))


def _steps_said(stated: Binding) -> str:
    steps = stated.chain.mechanism.first_order_steps
    return NO_STEPS.format(steps.said)


def delays_said(stated: Binding, named: Iterable[str]) -> list[str]:
    """That delays among the effects that are named are those for the file's steps."""
    steps = stated.chain.mechanism.first_order_steps
    if steps is None or "delay" not in [effect_class(name).quantity() for name in named]:
        return []
    return [EARLY.format(steps.said, 1e3 * steps.delay)]


def _without_steps(decider: Decider, search: SearchResult) -> list[Hypothesis]:
    """What was chosen, or that with fewer effects, whichever is most probable without what steps
    leave behind, to first order and on the fit runs, if it is more so than what was chosen. Steps
    that the dataset states stay.
    """
    binding = decider.bench.binding
    if (
        binding.chain.mechanism.first_order_steps is None
        or binding.dataset.stated.simulator is not None
    ):
        return []
    chosen = search.chosen
    fewer = [h for h in search.tried if set(h.effects) < set(chosen.effects)]
    found = [h for h in (search.nominal, *fewer, chosen) if np.isfinite(h.fit_loss)]
    foreseen = [_evidence_without_steps(decider, h) for h in found]
    if not foreseen:
        return []
    best = int(np.argmax(foreseen))
    in_steps = decider.evidence(chosen, *squares_of(chosen.residuals))
    return [found[best]] if foreseen[best] + RULE.log_prior > in_steps else []


def _evidence_without_steps(decider: Decider, h: Hypothesis) -> float:
    """Log evidence of the fit runs once what the steps leave behind is taken off and the numbers
    are re-tuned, to first order.
    """
    problem, z = h.path.problem, h.path.z
    left_behind = left_by_steps(decider.bench, problem, OutputError(), "fit", z)
    parts = list(rows([(problem, z)]))
    moved = []
    for part in parts:
        at = problem.runs.record(part.record).samples
        moved.append(part.r + part.w * left_behind[at])
    retuning = Retuning(parts, problem.size)
    remaining = retuning.remaining(np.concatenate([r.ravel() for r in moved]))
    ends = np.cumsum([r.size for r in moved])[:-1]
    by_run = [x.reshape(r.shape) for x, r in zip(np.split(remaining, ends), moved, strict=True)]
    return decider.evidence(h, *squares_of(by_run))


HOLD = SimulationSetting(with_other_hold, _hold_said, _chosen_or_none)
STEPS = SimulationSetting(with_exact_steps, _steps_said, _without_steps, at_once=True)
