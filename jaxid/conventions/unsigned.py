"""Inputs of which only the size was recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxid.base.wording import listed, number
from jaxid.conventions.finding import DataFinding
from jaxid.conventions.limits import GONE
from jaxid.conventions.mending import Mending
from jaxid.conventions.missing_force import ForceFit
from jaxid.conventions.readings import Names
from jaxid.conventions.samples import Shown
from jaxid.force.sampled_motion import SampledMotion
from jaxid.problem.binding import Binding


#: Units of what drives one way or the other: a pressure or a goal that is never negative says
#: nothing.
TWO_WAY = "N m", "N", "V", "A", "1"


def unsigned(binding: Binding, fit: ForceFit, m: SampledMotion, names: Names) -> Shown | None:
    """An input that never changes its sign where the motion asks for both."""
    plain = fit.fit(m)
    if plain.worst < 0.3:
        return None
    inputs = binding.dataset.input_names
    u = np.concatenate([e.u for e in binding.dataset.experiments])
    two_way = [
        n for n, unit in zip(names.inputs, names.input_units, strict=True) if unit in TWO_WAY
    ]
    raw = {n: u[:, inputs.index(n)] for n in two_way}
    one_way = [
        n
        for n, u in raw.items()
        if min(abs(u.min()), abs(u.max())) <= 0.02 * np.percentile(np.abs(u), 99) and u.any()
    ]
    signed = _signed(fit, m, [names.inputs.index(n) for n in one_way]) if one_way else None
    if signed is not None:
        name, left = one_way[0], fit.fit(signed).worst
        if left < GONE * plain.worst:
            text = (
                f"{listed(tuple(one_way))} never changes its sign, and the motion asks for both:"
                " the sensor seems to read its size alone (with the signs that the motion asks"
                f" for, what is missing falls from {number(100 * plain.worst, 2)} to {number(100 * left, 2)} %)."
                " Record the signed reading, or multiply by the sign of the command."
            )
            return Shown(DataFinding("unsigned", name, None, text), Mending())
    return None


def _signed(fit: ForceFit, m: SampledMotion, which: list[int]) -> SampledMotion | None:
    """The motion with these inputs given the signs that the model itself asks for, starting from
    those of the acceleration.
    """
    sources, theta, norm = [], fit.binding.theta.copy(), fit.norm(m)

    def alone(j):
        return replace(m, mix=m.mix * (np.arange(len(m.mix)) == j))

    without = replace(m, mix=0 * m.mix)

    def signs(wanted: np.ndarray) -> np.ndarray:
        """Those with which each input [samples which] drives as is wanted of the joints [samples
        nq].
        """
        still = fit.forces.missing(theta, without)
        push = np.stack([fit.forces.missing(theta, alone(j)) - still for j in which], 1)
        return np.where(np.sum(push * wanted[:, None] / norm**2, axis=2) >= 0, 1.0, -1.0)

    sign = signs(m.qdd)
    for _ in range(6):
        sources, first = [], 0
        for s in m.sources:
            own = sign[first : first + len(s.at)]
            first += len(s.at)
            u = np.array(s.u)
            at = np.clip(np.searchsorted(s.at, s.t), 0, len(s.at) - 1)
            u[:, which] = u[:, which] * own[at]
            sources.append(replace(s, u=u))
        fitted = fit.fit(replace(m, sources=tuple(sources)), laws=False)
        theta[fit.free] = fitted.x[: len(fit.free)]
        new = signs(-fit.forces.missing(theta, without))
        if np.array_equal(new, sign):
            break
        sign = new
    return replace(m, sources=tuple(sources)) if sources else None
