"""Readings of a recording that need a model to be told apart: signs, zeros, scales, exchanged
channels. Each changes a motion and is undone by a mending; rows and clocks are in `timing`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from math import pi

import numpy as np

from jaxid.base.wording import names_of
from jaxid.conventions.limits import APART, MISFIT, TOLD
from jaxid.conventions.mending import Mending
from jaxid.data.dataset import Dataset, StatedChannel
from jaxid.data.units import conversion, read_as
from jaxid.dynamics.joint_readings import read_by
from jaxid.force.sampled_motion import SampledMotion
from jaxid.problem.binding import Binding
from jaxid.simulation.sample_buffers import columns


Change = Callable[[SampledMotion], SampledMotion]

#: Codes of an encoder per turn, which no unit has a name for.
CODES = 1000, 1024, 2000, 2048, 4000, 4096, 8192, 16384, 65536
#: Units from which values are converted a second time by mistake.
TWICE = "deg", "rev", "deg/s", "rev/s", "rpm", "mm", "mm/s", "mN", "mN m"
#: Of quantities that the table of units lacks.
THOUSANDTHS = {
    "thousandths read as the unit": 1000.0,
    "the unit read as thousandths": 1e-3,
}
#: Where a channel's factor is looked for; which one it is, is found from there.
TURNING = "rad", "rad/s"
TURNS = 180 / pi, pi / 180, 2 * pi, 1 / (2 * pi), 4096 / (2 * pi), 0.03, 15.0, 30.0, 100.0, 200.0
SIZES = 1000.0, 1e-3, 9.80665, 1 / 9.80665, 50.0, 0.02, 20.0, 0.05, 200.0, 0.005
#: What sensor_scale and torque_scale may be: a factor in it stays theirs.
EFFECT_RANGE = 0.1, 3.0
#: A fitted factor may be a known one within this share of it.
NAMED = 0.03
#: What has no name of its own, and what is a whole number (or one over it).
FREE = "a factor, as of a gear"
GEAR = "a gear of a whole ratio"
#: A ratio is a whole number within this share of it, or three standard deviations, where such a
#: number is told from its neighbours by less than a quarter of their distance.
WHOLE_RATIO, TOLD_APART = 0.002, 0.25
#: Up to this many inputs or outputs, all their signs are tried together.
TOGETHER = 3


@dataclass(frozen=True)
class Reading:
    """One way in which channels may have been recorded: `change` gives the motion as it would then
    be.
    """

    kind: str
    channels: tuple[str, ...]
    value: float
    change: Change
    what: str = ""


def scaled_input(m: SampledMotion, j: int, factor: float) -> SampledMotion:
    """The motion with input j times a factor."""
    by = np.ones(len(m.mix))
    by[j] = factor
    return replace(m, mix=m.mix * by)


def scaled_joint(m: SampledMotion, j: int, factor: float) -> SampledMotion:
    """The motion with joint j times a factor."""
    by = np.ones(m.q.shape[1])
    by[j] = factor
    return replace(m, q=m.q * by, qd=m.qd * by, qdd=m.qdd * by)


def offset_joint(m: SampledMotion, j: int, offset: float) -> SampledMotion:
    """The motion with an offset added to joint j."""
    return replace(m, q=m.q + offset * (np.arange(m.q.shape[1]) == j))


def exchanged(m: SampledMotion, a: int, b: int, inputs: bool) -> SampledMotion:
    """The motion with two inputs, or two joints, taken for each other."""
    order = np.arange(m.u.shape[1] if inputs else m.q.shape[1])
    order[[a, b]] = b, a
    if inputs:
        return replace(m, mix=m.mix[:, order], rows=m.rows[order], drift=m.drift[order])
    return replace(
        m, q=m.q[:, order], qd=m.qd[:, order], qdd=m.qdd[:, order], weight=m.weight[:, order]
    )


def _each(changes: list[Change]) -> Change:
    def change(m: SampledMotion) -> SampledMotion:
        for c in changes:
            m = c(m)
        return m

    return change


class Names:
    """Names and units of the inputs of a motion, and of what reads its joints, in its order."""

    def __init__(self, binding: Binding):
        iu, _ = columns(binding.dataset, binding.chain)
        inputs = [binding.dataset.inputs[i] for i in iu[: len(binding.chain.signature.commands)]]
        self.inputs = names_of(inputs)
        self.input_units = [c.unit for c in inputs]
        self._dataset = binding.dataset
        outputs = [binding.chain.signature.outputs[k] for k in read_by(binding.chain)]
        self.joints, self.joint_units = [name for name, _ in outputs], [unit for _, unit in outputs]

    def unit(self, channel: str) -> str:
        """Of an input or a joint."""
        return dict(
            zip((*self.inputs, *self.joints), (*self.input_units, *self.joint_units), strict=True)
        )[channel]

    def factors(self, channel: str) -> dict[str, float]:
        """The known factors by which a channel may be too large, those of values that were
        converted twice among them.
        """
        found, factor = _stated(self._dataset, channel)
        known = known_factors(found, factor)
        return known if factor != 1.0 else known | converted_twice(found, known)


def factors_of(dataset: Dataset, channel: str) -> dict[str, float]:
    """The known factors by which a channel of a recording may be too large where it is compared
    with another: a unit that was forgotten in either. A conversion too many in one looks like a
    unit that was forgotten in the other, which is commoner.
    """
    return known_factors(*_stated(dataset, channel))


def _stated(dataset: Dataset, channel: str) -> tuple[str, float]:
    """The SI unit of a channel, and how much of it the stated unit is."""
    (found,) = (c for c in dataset.channels if c.name == channel)
    stated = found.stated or StatedChannel(found.unit)
    return found.unit, stated.factor


def known_factors(unit: str, stated: float = 1.0) -> dict[str, float]:
    """By how much a channel is too large where its unit is another one than the stated one, which
    is `stated` of the SI unit. What is as near to 1 as a stated number may be off tells no unit.
    """
    found = read_as(unit, stated) or dict(THOUSANDTHS)
    if unit in TURNING:
        turn = stated / (2 * pi)
        found |= {f"counts of {n} per turn read as an angle": n * turn for n in CODES}
    return {what: factor for what, factor in found.items() if abs(np.log(factor)) > MISFIT}


def converted_twice(unit: str, known: Mapping[str, float]) -> dict[str, float]:
    """By how much a channel in an SI unit is too large where it was converted to it twice; only
    factors that are not known already.
    """
    found = {}
    for name in TWICE:
        once = conversion(name)
        alike = any(abs(np.log(once.factor / other)) < 1e-6 for other in known.values())
        if once.si == unit and not alike:
            found[f"converted from {name} twice"] = once.factor
    return found


def signs(names: Names) -> Iterator[Reading]:
    """Inputs or outputs negated, one by one and together."""
    for group, units, scale in (
        (names.inputs, names.input_units, scaled_input),
        (names.joints, names.joint_units, scaled_joint),
    ):
        own = [k for k, unit in enumerate(units) if unit != "1"]
        sizes = range(1, len(own) + 1) if len(own) <= TOGETHER else (1, len(own))
        for size in sizes:
            for chosen in combinations(own, size):
                change = _each([lambda m, j=j, s=scale: s(m, j, -1.0) for j in chosen])
                yield Reading("sign", tuple(group[j] for j in chosen), -1.0, change)


def exchanges(names: Names) -> Iterator[Reading]:
    """Two inputs or two outputs of one unit exchanged."""
    for group, units, inputs in (
        (names.inputs, names.input_units, True),
        (names.joints, names.joint_units, False),
    ):
        for a, b in combinations(range(len(group)), 2):
            if units[a] == units[b] and units[a] != "1":
                yield Reading(
                    "swapped_channels",
                    (group[a], group[b]),
                    1.0,
                    lambda m, a=a, b=b, i=inputs: exchanged(m, a, b, i),
                )


def zeros(names: Names) -> Iterator[Reading]:
    """A joint's angle off by quarter turns."""
    for j, unit in enumerate(names.joint_units):
        if unit == "rad":
            for offset in (pi / 2, -pi / 2, pi):
                yield Reading(
                    "zero",
                    (names.joints[j],),
                    offset,
                    lambda m, j=j, c=offset: offset_joint(m, j, -c),
                )


def scales(names: Names) -> Iterator[Reading]:
    """A channel off by a known factor; and all channels of one unit, as of a log in degrees."""
    for channels in _scaled_sets(names):
        unit = names.unit(channels[0])
        for factor in TURNS if unit in TURNING else SIZES:
            yield scale_of(names, channels, factor)


def scale_of(names: Names, channels: tuple[str, ...], factor: float) -> Reading:
    """The reading by which these channels were recorded `factor` times too large."""
    return Reading(
        "scale", channels, factor, lambda m: _scaled_together(names, m, channels, 1 / factor)
    )


def _scaled_sets(names: Names) -> list[tuple[str, ...]]:
    """Channels that one slip may scale: each alone, all joints or inputs of a unit, and both."""
    every = (*names.joints, *names.inputs)
    units = list(zip(every, map(names.unit, every), strict=True))
    sets = [(name,) for name, unit in units if unit != "1"]
    for unit in dict.fromkeys(unit for _, unit in units if unit != "1"):
        joints = tuple(name for name in names.joints if names.unit(name) == unit)
        inputs = tuple(name for name in names.inputs if names.unit(name) == unit)
        sets += [joints, inputs, (*joints, *inputs)]
    return list(dict.fromkeys(s for s in sets if s))


def _scaled_together(
    names: Names, m: SampledMotion, channels: tuple[str, ...], factor: float
) -> SampledMotion:
    """The motion with these channels times a factor."""
    for name in channels:
        if name in names.joints:
            m = scaled_joint(m, names.joints.index(name), factor)
        else:
            m = scaled_input(m, names.inputs.index(name), factor)
    return m


def mending_of(reading: Reading, value: float, dataset_units: dict[str, str]) -> Mending:
    """What undoes a reading with this fault."""
    if reading.kind == "sign":
        return Mending({c: {"scale": -1.0} for c in reading.channels})
    if reading.kind == "swapped_channels":
        a, b = reading.channels
        return Mending(exchanged=((a, b),))
    if reading.kind == "zero":
        return Mending({reading.channels[0]: {"offset": -value}})
    return Mending({c: {"scale": 1 / value} for c in reading.channels})


def refinement(
    reading: Reading, names: Names
) -> tuple[Callable[[SampledMotion, np.ndarray], SampledMotion], Callable[[float], float]] | None:
    """For a reading with a size: the motion by one number beside its own value, and the size by
    that number.
    """
    if reading.kind == "zero":
        j = names.joints.index(reading.channels[0])
        return (lambda m, x: offset_joint(m, j, -reading.value - float(x[0]))), (
            lambda x: reading.value + x
        )
    if reading.kind == "scale":

        def factor(x):
            return reading.value * float(np.exp(np.clip(x, -2.0, 2.0)))

        def change(m, x):
            return _scaled_together(names, m, reading.channels, 1 / factor(x[0]))

        return change, factor
    return None


def nearest_factor(value: float, known: Mapping[str, float]) -> tuple[float, str]:
    """The known factor next to a size, and its name."""
    name, factor = min(known.items(), key=lambda item: abs(np.log(value / item[1])))
    return factor, name


def unmistakable(value: float, std: float, known: Mapping[str, float]) -> bool:
    """Whether a fitted size, the standard deviation of its logarithm `std`, stands for one known
    factor: the only one in reach, or of those the only one that it meets. Nothing is known of a
    size whose `std` is beyond `TOLD`.
    """
    off = np.abs(np.log(value / np.array([*known.values()])))
    reach = NAMED if std >= TOLD else min(APART, max(NAMED, 3 * std))
    near, met = off <= reach, off <= 3 * std
    return 1 in (np.count_nonzero(near), np.count_nonzero(near & met))


def nearest_convention(
    kind: str, known: Mapping[str, float], value: float, std: float, travel: float
) -> tuple[float, str] | None:
    """The convention's own value that a fitted size stands for, and its name; None where it stays
    an effect.
    """
    if kind == "zero":
        wound = (value + pi) % (2 * pi) - pi
        quarter = round(wound / (pi / 2)) * (pi / 2)
        if quarter and abs(wound - quarter) <= max(0.1, 3 * std) and std < 0.1:
            return (
                pi if abs(quarter) == pi else quarter
            ), f"{abs(quarter) / (pi / 2):.0f} quarter turn"
        beyond = max(0.5, 0.5 * travel)  # what a tilted base and a sensor's bias may be
        return (wound, "an offset") if abs(wound) > beyond and std < 0.1 else None
    factor, name = nearest_factor(value, known)
    if std < 0.2 and unmistakable(value, std, known):
        return factor, name
    low, high = EFFECT_RANGE
    if low < value < high or std >= 0.05:
        return None
    whole = whole_ratio(value, std)
    return (value, FREE) if whole is None else (whole, GEAR)


def whole_ratio(value: float, std: float) -> float | None:
    """The whole number, or one over it, that a ratio stands for; `std` is of its logarithm."""
    larger = max(value, 1 / value)
    number = round(larger)
    reach = max(WHOLE_RATIO, 3 * std) * number
    if reach > TOLD_APART or abs(larger - number) > reach:
        return None
    return float(number) if value > 1 else 1 / number
