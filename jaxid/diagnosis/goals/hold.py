"""How goals run from sample to sample: held, or along straight lines.

A log of a goal says when it was asked, not what the drive made of it until the next one. That is
one more thing that may be other than stated, and it is judged like an effect: by simulation, beside
what was found, with the evidence that a claim needs.
"""

from __future__ import annotations

from dataclasses import replace

from jaxid.data.dataset import Dataset
from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.hypothesis import Hypothesis, SearchResult
from jaxid.diagnosis.probability import RULE
from jaxid.fitting.problem_builder import ProblemBuilder


OTHER = {"zero": "linear", "linear": "zero"}
WORDS = {"zero": "held", "linear": "along straight lines"}
OTHER_WAY = (
    "the goals go {} from sample to sample here, not {} as the dataset has it: the re-tuned model"
    " follows them better so on data that were and were not fitted (state hold of the goals'"
    " channels where that is wrong)"
)


def with_other_hold(dataset: Dataset) -> Dataset:
    """The dataset with goals that go the other way from sample to sample."""
    channels = []
    for c in dataset.channels:
        hold = OTHER.get(c.hold, c.hold) if c.role == "input" else c.hold
        channels.append(replace(c, hold=hold))
    return replace(dataset, channels=tuple(channels))


def said(stated: Dataset) -> str:
    """That goals go the other way than a dataset states."""
    hold = stated.inputs[0].hold
    return OTHER_WAY.format(WORDS.get(OTHER.get(hold, hold)), WORDS.get(hold, hold))


def goes_the_other_way(decider: Decider, search: SearchResult) -> bool:
    """Whether goals that go the other way explain what a claim has to, beside what was chosen or in
    its place, and are more probable than what was chosen.
    """
    found = [search.nominal, search.chosen] if search.chosen.effects else [search.nominal]
    ended = [_ended(decider, h) for h in found]
    chosen = ended[-1]
    if not chosen.effects and decider.at_noise(chosen):
        return False
    binding = decider.bench.binding
    swapped = replace(binding, dataset=with_other_hold(binding.dataset))
    bench = decider.bench
    other = replace(
        decider,
        bench=ProblemBuilder(swapped, bench.step, bench.differences, together=bench.together),
    )
    claimed = any(_claimed(decider, other, h, chosen) for h in ended)
    decider.evaluations = other.evaluations
    return claimed


def _ended(decider: Decider, h: Hypothesis) -> Hypothesis:
    """A model whose descent has ended: what it leaves is not for want of iterations."""
    return h if decider.at_noise(h) else decider.polished(h)


def _claimed(decider: Decider, other: Decider, h: Hypothesis, chosen: Hypothesis) -> bool:
    """Whether a model is missed without the other hold, and more probable with it than what was
    chosen.
    """
    with_it = other.polished(other.refit(h.effects, h.theta))
    gained = decider.gained(h, with_it) + RULE.log_prior
    return gained >= RULE.log_odds and decider.gained(chosen, with_it) + RULE.log_prior > 0
