"""Effects that say the same at several places, so that they are told once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxid.fitting.result import EffectEstimate, Estimate


#: Probability below which numbers do not scatter about one value by chance.
CHANCE = 0.05


@dataclass(frozen=True)
class AlikeEffects:
    """One effect at places where its numbers are the same within what is known of them. `common`
    stands at the first place, with the mean of each number and the standard deviation of that.
    """

    common: EffectEstimate
    locations: tuple[str, ...]


def alike(effects: Sequence[EffectEstimate]) -> list[AlikeEffects]:
    """Effects by kind, in the order in which they were named: one entry where all places of a kind
    agree, else one for each place.
    """
    kinds: dict[str, list[EffectEstimate]] = {}
    for effect in effects:
        kinds.setdefault(effect.effect, []).append(effect)
    out = []
    for own in kinds.values():
        common = _common(own)
        if common is None:
            out += [AlikeEffects(effect, (effect.location,)) for effect in own]
        else:
            shared = replace(own[0], parameters=common)
            out.append(AlikeEffects(shared, tuple(effect.location for effect in own)))
    return out


def _common(own: Sequence[EffectEstimate]) -> dict[str, Estimate] | None:
    """The numbers that places of one effect share; None where they do not agree."""
    names = list(own[0].parameters)
    if len(own) < 2 or not names:
        return None
    if any(list(effect.parameters) != names for effect in own):
        return None
    out = {}
    for name in names:
        mean = _mean([effect.parameters[name] for effect in own])
        if mean is None:
            return None
        out[name] = mean
    return out


def _mean(numbers: Sequence[Estimate]) -> Estimate | None:
    """Weighted mean of numbers; None where they differ by more than chance, or one is not known."""
    first = numbers[0]
    if any(n.unit != first.unit for n in numbers):
        return None
    values = np.array([n.value for n in numbers])
    stds = np.array([n.std or 0.0 for n in numbers])
    if np.all(values == values[0]):
        return replace(first, std=None if first.std is None else float(stds.max()))
    if not np.all(stds > 0):
        return None
    weights = 1 / stds**2
    mean = float(weights @ values / weights.sum())
    scatter = float(weights @ (values - mean) ** 2)
    if scatter > _most_scatter(len(values) - 1):
        return None
    return replace(first, value=mean, std=float(weights.sum() ** -0.5))


def _most_scatter(degrees: int) -> float:
    """Chi-square beyond which scatter is no chance."""
    from scipy.special import chdtri

    return float(chdtri(degrees, CHANCE))
