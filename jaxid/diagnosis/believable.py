"""Whether the numbers of named effects can be believed: none does nothing, none stands at a bound,
no drive is switched off.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxid.diagnosis.thresholds import LIMITS
from jaxid.dynamics import catalogue
from jaxid.dynamics.effect import InputEffect, neutral
from jaxid.dynamics.parameter import specs, with_fields
from jaxid.fitting.result import Covariance, EffectEstimate, Estimate


def doubts(
    effects: Sequence[EffectEstimate], covariance: Covariance | None = None
) -> dict[str, str]:
    """Effect at its place -> what speaks against it as it was estimated, in words; `covariance` of
    all fitted numbers.
    """
    return {str(e): why for e in effects if (why := _doubt(e, covariance))}


def _doubt(effect: EffectEstimate, covariance: Covariance | None) -> str:
    strengths = _strengths(effect)
    if _passes(effect) < LIMITS.switched_off:
        return f"{effect} all but switches the drive off"
    if _does_nothing(effect, strengths, covariance):
        return f"{effect} is within two standard deviations of doing nothing"
    for name, p in strengths.items():
        share = (p.lower, p.upper) == (0.0, 1.0)  # its end is where it is whole
        if p.at_bound and p.value != 0 and not share:
            return f"{name} of {effect} was pushed to its bound"
    return ""


def _does_nothing(
    effect: EffectEstimate, strengths: dict[str, Estimate], covariance: Covariance | None
) -> bool:
    """Whether the spread of each strength is known, and takes it, and all together, in."""
    for p in strengths.values():
        if p.std is None or not p.std > 0:
            return False
        if abs(p.value) >= LIMITS.two_sigma * p.std:
            return False
    return bool(strengths) and not _together(effect, strengths, covariance)


def _passes(effect: EffectEstimate) -> float:
    """Share of a slow command that comes through an effect on its way."""
    kind = catalogue.effect_class(effect.effect)
    if not issubclass(kind, InputEffect):
        return 1.0
    own: Any = neutral(kind)
    known = specs(kind)
    numbers = {name: p.value for name, p in effect.parameters.items() if name in known}
    transfer = with_fields(own, numbers).transfer(np.zeros(1))
    return 1.0 if transfer is None else float(np.max(transfer[0]))


def _together(
    effect: EffectEstimate, strengths: dict[str, Estimate], covariance: Covariance | None
) -> bool:
    """Whether several numbers, none of them sure, are not all zero: a sine and a cosine of unknown
    phase. Together they are as far from it as two standard deviations are for one.
    """
    from scipy.stats import chi2

    names = [f"{effect.effect}.{k}@{effect.location}" for k in strengths]
    if len(names) < 2 or covariance is None or not set(names) <= set(covariance.names):
        return False
    at = [covariance.names.index(n) for n in names]
    C, x = covariance.matrix[np.ix_(at, at)], np.array([p.value for p in strengths.values()])
    if not np.isfinite(C).all() or np.linalg.matrix_rank(C) < len(at):
        return False
    return float(x @ np.linalg.solve(C, x)) > float(chi2.ppf(chi2.cdf(2**2, 1), len(at)))


def _strengths(effect: EffectEstimate) -> dict[str, Estimate]:
    """The numbers without which an effect does nothing: those that are 0 then."""
    own = specs(catalogue.effect_class(effect.effect))
    return {
        k: p
        for k, p in effect.parameters.items()
        if k in own and own[k].value == 0 and not own[k].log
    }
