"""A cause in its own terms: where the effect acts, what it is in plain words, and what to look for
at the machine.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from jaxid.base.wording import number, percent, unit_after
from jaxid.dynamics import catalogue


if TYPE_CHECKING:
    from jaxid.fitting.result import EffectEstimate, Estimate


class Amount:
    """A fitted number inside a sentence: with its unit, as a share (`{gain:%}`), or of a wave
    number the period (`{order:period}`).
    """

    def __init__(self, estimate: Estimate):
        self.value = estimate.value
        self.unit = unit_after(estimate.unit)
        known = abs(estimate.value) / estimate.std if estimate.std and estimate.value else 100.0
        self.digits = int(np.clip(round(np.log10(known)) + 1, 1, 4)) if np.isfinite(known) else 3

    def __format__(self, form: str) -> str:
        if form == "%":
            return percent(self.value)
        if form == "period":  # rad/m counts phase along metres
            return (
                f"{number(2 * np.pi / self.value, self.digits)}"
                f" {self.unit.partition('/')[2] or 'rad'}"
            )
        return number(self.value, self.digits) + self.unit


def words(effect: EffectEstimate, field: str) -> str:
    """A sentence of the effect's class (`seen`, `plain` or `check`) with the fitted numbers in it,
    as it reads at its kind of joint; "" where it has none.
    """
    try:
        kind = catalogue.effect_class(effect.effect)
        template = getattr(kind, field, "")
        if on_slide(effect):
            template = kind.on_slide.get(field, template)
        return template.format_map({name: Amount(p) for name, p in effect.parameters.items()})
    except (ValueError, KeyError):  # an effect of the user's own, or without its numbers
        return ""


def on_slide(effect: EffectEstimate) -> bool:
    """Whether an effect acts at a slide: by a force in N and not by a torque in N m."""
    units = [estimate.unit for estimate in effect.parameters.values()]
    return any("N" in unit.split("/")[0].split() and "N m" not in unit for unit in units)


def variable(effect: EffectEstimate) -> str:
    """What the effect is a law of: speed, position, load, command, acceleration, reading or time;
    "" where it says nothing.
    """
    return words(effect, "axis")


def span(effect: EffectEstimate) -> tuple[float | None, float | None] | None:
    """The range of that variable in which the effect acts, where its numbers say so; None is an
    open end.
    """
    try:
        limits: Callable | None = getattr(catalogue.effect_class(effect.effect), "span", None)
    except ValueError:
        return None
    return (
        None if limits is None else limits({name: p.value for name, p in effect.parameters.items()})
    )
