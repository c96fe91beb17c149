"""The numbers with which a robot's file follows, in its own steps, a machine that takes none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jaxid.diagnosis.goals.asked import GoalsQuestion
from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.hypothesis import Candidate
from jaxid.diagnosis.result import Diagnosis
from jaxid.fitting.result import EffectEstimate, Fit
from jaxid.problem.binding import Binding


def with_numbers_of_the_file(ask: GoalsQuestion, found: Diagnosis) -> Diagnosis:
    """The diagnosis of a machine that takes no steps, with what to write into its file: the same
    numbers and effects refitted in the file's own steps, as near to the machine's as the file's
    are trusted; with hard friction, where the machine's joints stick. `ask`: the question in these
    steps.
    """
    fit = found.final
    sticks = fit.robot["simulator"]["kind"] == "own"
    binding = _about(ask.known([e.effect for e in fit.effects]), fit)
    if sticks:
        binding = _hardened(binding)
    decider = Decider(ask.made(binding), binding.layout.names, ask.progress)
    chosen = decider.settled(decider.refit(_candidates(binding, fit), binding.theta))
    if not np.isfinite(chosen.fit_loss):
        return found
    names = binding.layout.names
    written = {names[i]: float(chosen.theta[i]) for i in chosen.path.problem.free}
    for effect in fit.effects:
        for i, field in _fields(binding, effect):
            written[f"{effect.effect}.{field}@{effect.location}"] = float(chosen.theta[i])
    simulator = {**fit.robot["simulator"], "numbers": written, "hard": sticks}
    return replace(found, final=replace(fit, robot={**fit.robot, "simulator": simulator}))


def _fields(binding: Binding, effect: EffectEstimate) -> Iterator[tuple[int, str]]:
    """Place in the layout and name of each number of an effect, one that is part of the model
    among them.
    """
    for i in binding.layout.of_effect(effect.effect, effect.location):
        yield i, binding.layout.entries[i].field


def _about(binding: Binding, fit: Fit) -> Binding:
    """The binding that begins at the numbers of a fit, and knows its own to be near them."""
    found = {}
    for i, name in enumerate(binding.layout.names):
        if name in fit.parameters:
            found[i] = fit.parameters[name].value
    for effect in fit.effects:
        for i, field in _fields(binding, effect):
            if field in effect.parameters:
                found[i] = effect.parameters[field].value
    theta = binding.theta.copy()
    for i, value in found.items():
        theta[i] = np.clip(value, binding.lower[i], binding.upper[i])
    priors = {i: (float(theta[i]), std) for i, (_, std) in binding.priors.items()}
    return replace(binding, theta=theta, priors=priors)


def _hardened(binding: Binding) -> Binding:
    """The binding with dry friction as hard as an export can make it."""
    theta = binding.theta.copy()
    step = binding.chain.mechanism.tree.tree.simulator  # type: ignore[attr-defined]
    for joint in binding.chain.signature.joints:
        rate, share = step.hard(joint)
        theta[binding.layout.index(f"slip_rate@{joint}")] = rate
        theta[binding.layout.index(f"slip_share@{joint}")] = share
    return replace(binding, theta=theta)


def _candidates(binding: Binding, fit: Fit) -> list[Candidate]:
    """The effects of a fit but for those that are part of the model, whose numbers are fitted
    anyway.
    """
    out = []
    for effect in fit.effects:
        index = tuple(binding.layout.of_effect(effect.effect, effect.location))
        if not set(index) <= set(binding.free):
            out.append(Candidate(effect.effect, effect.location, index))
    return out
