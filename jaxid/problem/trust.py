"""How far a number that a file or a user states may be off: the one table of spreads, by kind of
number.

A stated number is neither exact nor worthless. A diagnosis takes it as a Gaussian prior, whose
standard deviation goes by what kind of number it is and by `[model] trust`. What
`[model.parameters.X] prior` states comes before it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np

from jaxid.base.wording import listed
from jaxid.dynamics.parameter_vector import Entry, ParameterVector
from jaxid.robots.yardstick import states


if TYPE_CHECKING:
    from jaxid.problem.binding import Binding


#: What `[model] trust` may say, and what it is where it says nothing.
CHOICES, DEFAULT = ("exact", "measured", "loose"), "measured"
#: Standard deviation of what counts as exact: a share of a number, and of a place in m.
EXACT, EXACT_PLACE = 1e-3, 1e-4


class NumberSpread(NamedTuple):
    """Standard deviation of one kind of number: a `share` of its value and, beside it, `apart` in
    its unit.
    """

    share: float
    apart: float = 0.0

    def of(self, value: float) -> float:
        return float(np.hypot(self.share * value, self.apart))


#: Kind of number -> its spread where it was measured, and where it is known loosely.
SPREADS = {
    "mass": (NumberSpread(0.06), NumberSpread(0.2)),
    "centre of mass": (NumberSpread(0.0, 6e-3), NumberSpread(0.0, 20e-3)),
    "first moment": (NumberSpread(0.1), NumberSpread(0.3)),
    "inertia": (NumberSpread(0.1), NumberSpread(0.5)),
    "length": (NumberSpread(0.005), NumberSpread(0.05)),
    "gain": (NumberSpread(0.06), NumberSpread(0.2)),
    "damping": (NumberSpread(0.5), NumberSpread(2.0)),
    "rotor inertia": (NumberSpread(0.5), NumberSpread(2.0)),
    "dry friction": (NumberSpread(0.5), NumberSpread(2.0)),
}
#: What an effect is of -> the kind of its numbers.
OF_QUANTITY = {
    "damping": "damping",
    "frictionloss": "dry friction",
    "armature": "rotor inertia",
}
OF_FIELD = {
    **OF_QUANTITY,
    "Ia": "rotor inertia",
    "rotor_alpha": "rotor inertia",
    "I_m": "rotor inertia",
    "gravity_torque": "first moment",
    "F_v": "damping",
    "offset": "dry friction",
    "sliding_friction": "dry friction",
}
OF_UNIT = {"kg": "mass", "kg m": "first moment", "kg m^2": "inertia", "m": "length"}
#: How names of coordinates of a centre of mass begin.
CENTRES = ("com_", "payload_", "c1", "c2")


def kind_of(layout: ParameterVector, entry: Entry) -> str:
    """Which kind of `SPREADS` a number is: by its effect, its name or its unit, else a gain."""
    if entry.owner >= 0:
        quantity = layout.chain.effects[entry.owner].quantity()
        if quantity in OF_QUANTITY:
            return OF_QUANTITY[quantity]
    if entry.field in OF_FIELD:
        return OF_FIELD[entry.field]
    if entry.field.startswith("gyration_"):
        return "inertia"
    if entry.field.startswith(CENTRES):
        return "centre of mass"
    return OF_UNIT.get(entry.unit, "gain")


def spread_of(kind: str, value: float, trust: str) -> float:
    """Standard deviation of a number of this kind that is stated as `value`; 0 where a number that
    is stated as nothing says nothing.
    """
    measured, loose = SPREADS[kind]
    if trust == "measured":
        return measured.of(value)
    if trust == "loose":
        return loose.of(value)
    place = EXACT_PLACE if measured.apart else 0.0
    return NumberSpread(0.0 if measured.apart else EXACT, place).of(value)


def trusting(binding: Binding, inflation: float = 1.0) -> Binding:
    """The binding with priors about the fitted numbers that a file or the dataset states, and that
    have none of their own. Residuals whose squares count `inflation` times too often are met by
    priors that count as often.
    """
    layout, trust = binding.layout, trust_of(binding)
    scale = inflation**-0.5
    known = {i: (mean, scale * std) for i, (mean, std) in binding.priors.items()}
    spreads = {}
    for i in binding.free:
        if i in known or i not in binding.nominal or not states(binding, i):
            continue
        value, kind = float(binding.theta[i]), kind_of(layout, layout.entries[i])
        std = spread_of(kind, value, trust)
        if std > 0:
            known[i] = (value, scale * std)
            spreads[kind] = spread_of(kind, 1.0, trust)
    return replace(binding, priors=known, spreads=spreads, inflation=inflation)


def counted_as_often(binding: Binding, inflation: float) -> Binding:
    """The binding with priors that meet residuals whose squares count `inflation` times too
    often.
    """
    scale = (binding.inflation / inflation) ** 0.5
    priors = {i: (mean, scale * std) for i, (mean, std) in binding.priors.items()}
    return replace(binding, priors=priors, inflation=inflation)


def trust_of(binding: Binding) -> str:
    """What the dataset says of how far its numbers are to be trusted."""
    return binding.dataset.stated.trust or DEFAULT


def told(binding: Binding) -> dict[str, Any]:
    """What a result says of the spreads that it used: of each kind of number a share of it, or m of
    a centre of mass.
    """
    return {"level": trust_of(binding), "spreads": dict(binding.spreads)}


def sentence(binding: Binding) -> str:
    """The same in words; nothing where no number is stated."""
    each = [_told(kind, spread) for kind, spread in binding.spreads.items()]
    if not each:
        return ""
    return f"stated numbers count as {trust_of(binding)}: {listed(each)}"


def _told(kind: str, spread: float) -> str:
    if SPREADS[kind][0].apart:
        return f"{kind} to {1e3 * spread:g} mm"
    return f"{kind} to {100 * spread:g} %"
