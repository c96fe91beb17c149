"""What the numbers of a model start from on a dataset, between which bounds, and which are free."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from jaxid.base import wording
from jaxid.base.errors import UsageError
from jaxid.data.dataset import ModelSpec, ParameterPrior
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Effect, JointEffect
from jaxid.dynamics.parameter import settings
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.robots import match as robots
from jaxid.robots.floating import ANGLES


def held_friction(
    chain: Chain, layout: ParameterVector, free: list[int], fixed: set[int], theta: np.ndarray
) -> list[str]:
    """What is to be said of numbers of the model's own friction that a fit leaves as they are,
    effect by effect.
    """
    held = fixed.difference(free)
    said = []
    for k, effect in enumerate(chain.effects):
        if not isinstance(effect, JointEffect):
            continue
        of_effect = [i for i, e in enumerate(layout.entries) if e.owner == k]
        own = []
        for i in held.intersection(of_effect):
            entry = layout.entries[i]
            # Nothing brakes a base that floats.
            if not entry.spec.fixed and entry.location not in ANGLES:
                own.append(i)
        own.sort()
        if own and not set(free).isdisjoint(of_effect):
            names = wording.listed([layout.names[i] for i in own])
            values = wording.listed([f"{v:g}" for v in dict.fromkeys(theta[own].tolist())])
            said.append(
                f"held and not fitted: {names} = {values}; --effect {effect.name} fits them,"
                f" [model.parameters.{layout.names[own[0]]}] one by one"
            )
    return said


class StatedValues(NamedTuple):
    """Numbers [layout] with what a dataset states, which of them are `fixed` and which `stated`,
    and the priors by their names.
    """

    theta: np.ndarray
    fixed: set[int]
    stated: set[int]
    priors: dict[str, ParameterPrior]


def stated_values(layout: ParameterVector, spec: ModelSpec) -> StatedValues:
    """The numbers of a chain as its files and the dataset have them."""
    mechanism = layout.chain.mechanism
    theta, stated = layout.values.copy(), set()
    fixed = {i for i, e in enumerate(layout.entries) if e.spec.fixed}
    others = {"smoothing_velocity", *settings(mechanism)}
    for name, value in spec.constants.items():
        if name in others or name.startswith(robots.POSE):
            continue
        i = layout.index(name)
        theta[i] = value
        fixed.add(i)
        stated.add(i)
    priors = mechanism.known() | dict(spec.parameters)
    for name, prior in priors.items():
        if prior.start is not None:
            theta[layout.index(name)] = prior.start
            stated.add(layout.index(name))
    return StatedValues(theta, fixed, stated, priors)


def own_numbers(layout: ParameterVector, effects: set[str]) -> set[int]:
    """The numbers of the mechanism and of these effects."""
    own = set()
    for i, entry in enumerate(layout.entries):
        if entry.owner < 0 or layout.chain.effects[entry.owner].name in effects:
            own.add(i)
    return own


def free_numbers(
    layout: ParameterVector, own: set[int], added: Iterable[tuple[type[Effect], str | None]]
) -> list[int]:
    """The numbers to fit: `own`, and those of the added effects at their places."""
    free = sorted(own)
    for kind, place in added:
        for p in [place] if place else layout.chain.offers(kind):
            free += [i for i in layout.of_effect(kind.name, p) if i not in free]
    return free


def bounded(
    layout: ParameterVector, values: StatedValues, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers and their bounds [layout], with the bounds that are stated and room for numbers that
    are. Raises `UsageError` for a stated number beyond them.
    """
    theta, lower, upper = values.theta.copy(), lower.copy(), upper.copy()
    for name, prior in values.priors.items():
        i = layout.index(name)
        lower[i] = prior.lower if prior.lower is not None else min(lower[i], theta[i])
        upper[i] = prior.upper if prior.upper is not None else max(upper[i], theta[i])
        if lower[i] <= theta[i] <= upper[i]:
            continue
        if prior.value is not None:
            raise UsageError(
                f"{name} = {theta[i]:g} lies outside its bounds [{lower[i]:g}, {upper[i]:g}]"
            )
        theta[i] = np.sqrt(lower[i] * upper[i]) if lower[i] > 0 else (lower[i] + upper[i]) / 2
    return theta, lower, upper


def stated_scales(
    layout: ParameterVector,
    priors: Mapping[str, ParameterPrior],
    lower: np.ndarray,
    upper: np.ndarray,
) -> tuple[dict[int, tuple[float, float]], tuple[str, ...]]:
    """Search scales as stated, set in the layout; the Gaussian priors, and sentences about both.
    Bounds that nobody states make room for a prior.
    """
    known, said, alike = {}, [], {}
    layout.log = layout.log.copy()
    for name, prior in priors.items():
        i = layout.index(name)
        if prior.prior is not None:
            known[i] = mean, std = prior.prior["mean"], prior.prior["std"]
            low, high = mean - 5 * std, mean + 5 * std
            if prior.upper is None:
                upper[i] = max(upper[i], high)
            if prior.lower is None and not (lower[i] > 0 and low <= 0):
                least = 0.0 if lower[i] >= 0 else -np.inf
                lower[i] = max(least, min(lower[i], low))
            alike.setdefault(f"{mean:.4g} ± {std:.4g} {layout.entries[i].unit}", []).append(name)
        if prior.log is not None:
            if prior.log and not lower[i] > 0:
                raise UsageError(
                    f"{name}: log = true searches its logarithm, and its lower bound is"
                    f" {lower[i]:g}: state `lower` above 0 under [model.parameters.{name}]"
                )
            layout.log[i] = prior.log
            how = "by its logarithm" if prior.log else "linearly"
            said.append(f"{name} is searched {how} (stated)")
    said += [f"prior of {', '.join(names)}: {text} (stated)" for text, names in alike.items()]
    return known, tuple(said)
