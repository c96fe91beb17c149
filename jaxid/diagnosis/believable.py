"""Whether the numbers of named effects can be believed: none does nothing, none stands at a bound, no drive is switched off."""

from __future__ import annotations

from collections.abc import Sequence

from jaxid import catalogue
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.dynamics.parameter import specs
from jaxid.fitting.result import EffectEstimate, Estimate


def doubts(effects: Sequence[EffectEstimate]) -> list[str]:
    """What speaks against each of the effects as they were estimated, in words."""
    return [why for e in effects if (why := _doubt(e))]


def _doubt(effect: EffectEstimate) -> str:
    strengths = _strengths(effect)
    if effect.effect == "torque_scale" and any(1 + p.value < LIMITS.switched_off for p in strengths.values()):
        return f"{effect} all but switches the drive off"
    known = {k: p for k, p in strengths.items() if p.std is not None and p.std > 0}
    if known and len(known) == len(strengths) and all(abs(p.value) < 2 * p.std for p in known.values() if p.std is not None):
        return f"{effect} is within two standard deviations of doing nothing"
    for name, p in strengths.items():
        share = (p.lower, p.upper) == (0.0, 1.0)  # its end is where it is whole
        if p.at_bound and p.value != 0 and not share:
            return f"{name} of {effect} was pushed to its bound"
    return ""


def _strengths(effect: EffectEstimate) -> dict[str, Estimate]:
    """The numbers without which an effect does nothing: those that are 0 then."""
    own = specs(catalogue.effect_class(effect.effect))
    return {k: p for k, p in effect.parameters.items() if k in own and own[k].value == 0 and not own[k].log}
