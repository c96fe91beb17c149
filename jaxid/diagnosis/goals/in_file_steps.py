"""The numbers with which a robot's file follows, in its own steps, a machine that takes none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jaxid.diagnosis.goals.asked import GoalsQuestion
from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.hypothesis import Candidate
from jaxid.diagnosis.result import Diagnosis
from jaxid.fitting.result import Fit
from jaxid.problem.binding import Binding


def with_numbers_of_the_file(ask: GoalsQuestion, found: Diagnosis) -> Diagnosis:
    """The diagnosis of a machine that takes no steps, with what to write into its file: the same
    numbers and effects refitted in the file's own steps, as near to the machine's as the file's
    are trusted. `ask`: the question in these steps.
    """
    fit = found.final
    binding = _about(ask.known([e.effect for e in fit.effects]), _numbers_of(fit))
    decider = Decider(ask.made(binding), binding.layout.names, ask.progress)
    chosen = decider.refit(_candidates(binding, fit), binding.theta)
    chosen = decider.settled(decider.polished(chosen))
    if not np.isfinite(chosen.fit_loss):
        return found
    names = binding.layout.names
    written = {names[i]: float(chosen.theta[i]) for i in chosen.path.problem.free}
    simulator = {**fit.robot["simulator"], "numbers": written}
    return replace(found, final=replace(fit, robot={**fit.robot, "simulator": simulator}))


def _numbers_of(fit: Fit) -> dict[str, float]:
    """Name in the layout -> value of all numbers of a fit."""
    numbers = {name: estimate.value for name, estimate in fit.parameters.items()}
    for effect in fit.effects:
        for field, estimate in effect.parameters.items():
            numbers[f"{effect.effect}.{field}@{effect.location}"] = estimate.value
    return numbers


def _about(binding: Binding, numbers: Mapping[str, float]) -> Binding:
    """The binding that begins at these numbers, and knows its own to be near them."""
    theta, priors = binding.theta.copy(), dict(binding.priors)
    for i, name in enumerate(binding.layout.names):
        if name in numbers:
            theta[i] = np.clip(numbers[name], binding.lower[i], binding.upper[i])
    for i, (_, std) in binding.priors.items():
        priors[i] = (float(theta[i]), std)
    return replace(binding, theta=theta, priors=priors)


def _candidates(binding: Binding, fit: Fit) -> list[Candidate]:
    out = []
    for effect in fit.effects:
        index = binding.layout.of_effect(effect.effect, effect.location)
        out.append(Candidate(effect.effect, effect.location, tuple(index)))
    return out
