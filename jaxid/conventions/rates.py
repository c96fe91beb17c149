"""Two readings of one joint that contradict each other: its speed is not the rate of its position. No physics is needed to see
it; which of the two is wrong a model tells, or the factor."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from jaxid.conventions.finding import DataFinding
from jaxid.conventions.limits import GONE
from jaxid.conventions.mending import exchange_lines, lines, Mending
from jaxid.conventions.missing_force import ForceFit, Motion
from jaxid.conventions.readings import ANGLES, EFFECT_RANGE, exchanged, FREE, scaled_joint
from jaxid.conventions.samples import LONGEST, Shown
from jaxid.data.dataset import Dataset
from jaxid.data.signals import content_cutoff, differentiate, filter_ends, zero_phase
from jaxid.dynamics.joint_readings import joint_readings
from jaxid.problem.binding import Binding
from jaxid.simulation.sample_buffers import columns


#: Share of a speed's power that is the rate of the position, at least: what is less is no reading of the same joint.
SAME = 0.9
#: A ratio is a convention's within this share of it: both are readings of one motion, but for noise and a filter.
NEAR = 0.03


def contradictions(
    binding: Binding, dataset: Dataset, fit: ForceFit | None, m: Motion | None
) -> tuple[list[Shown], Motion | None]:
    """What the speeds of joints say of their positions; and the motion as it then is (it is made of positions)."""
    found, m = _crosswise(binding, dataset, fit, m)
    outputs = binding.chain.signature.outputs
    for j, r in enumerate(joint_readings(binding.chain)):
        ratio = None if r.q is None or r.qd is None else _ratio(binding, r.q, r.qd)
        if ratio is None or r.q is None or r.qd is None:
            continue
        position, speed = outputs[r.q], outputs[r.qd]
        factor = _factor(abs(ratio))
        if ratio < 0:
            turned = None if fit is None or m is None or not fit.driven else scaled_joint(m, j, -1.0)
            told = None if turned is None or fit is None or m is None else _told(fit, turned, m)
            channel, mate = (position[0], speed[0]) if told else (speed[0], position[0])
            found.append(_shown(dataset, "sign", channel, mate, -1.0, "the opposite sign", ratio, told is not None))
            m = turned if told else m
        if factor is not None:
            by_position, size, what = factor
            channel, mate = (position[0], speed[0]) if by_position else (speed[0], position[0])
            shown = _shown(dataset, "scale", channel, mate, size, what, ratio, what != FREE)
            found.append(shown if what != FREE else Shown(replace(shown.finding, decisive=False), Mending()))
            m = scaled_joint(m, j, 1 / size) if by_position and m is not None else m
    return found, m


def _crosswise(binding: Binding, dataset: Dataset, fit: ForceFit | None, m: Motion | None) -> tuple[list[Shown], Motion | None]:
    """Two joints of which each one's speed is the rate of the other one's position."""
    found: list[Shown] = []
    outputs = binding.chain.signature.outputs
    both = [(j, r.q, r.qd) for j, r in enumerate(joint_readings(binding.chain)) if r.q is not None and r.qd is not None]
    for (j, q, qd), (k, other, other_qd) in combinations(both, 2):
        if outputs[q][1] != outputs[other][1] or any(_ratio(binding, *pair) for pair in ((q, qd), (other, other_qd))):
            continue
        if not all(_ratio(binding, *pair) for pair in ((q, other_qd), (other, qd))):
            continue
        turned = None if fit is None or m is None or not fit.driven else exchanged(m, j, k, inputs=False)
        told = None if turned is None or fit is None or m is None else _told(fit, turned, m)
        a, b = (outputs[x][0] for x in ((q, other) if told else (qd, other_qd)))
        c, d = (outputs[x][0] for x in ((qd, other_qd) if told else (q, other)))
        doubt = "" if told is not None else f" It could be {c} and {d} as well."
        finding = DataFinding(
            "swapped_channels", a, 1.0,
            f"Each of {a} and {b} goes with the other one of {c} and {d}: {a} and {b} are exchanged.{doubt}",
            exchange_lines(dataset, a, b), decisive=True, same_as=() if told is not None else (("swapped_channels", c),),
            headline=f"{a} and {b} are exchanged; everything below takes each for the other",
        )  # fmt: skip
        found.append(Shown(finding, Mending(exchanged=((a, b),))))
        m = turned if told else m
    return found, m


def _ratio(binding: Binding, q: int, qd: int) -> float | None:
    """Rate of a position over the speed that was recorded; None where they are no readings of one motion."""
    _, iy = columns(binding.dataset, binding.chain)
    rates, speeds = [], []
    for e in binding.dataset.experiments:
        t, y = e.t[:LONGEST], e.motion()[:LONGEST, iy]
        if len(t) < 60:
            continue
        noise = e.noise_rms(binding.readings, iy)
        cutoff = content_cutoff(t, y[:, q], noise[q])
        ends = filter_ends(t, cutoff)
        inside = slice(ends, len(t) - ends)
        rates.append(differentiate(t, y[:, [q]], cutoff)[1][inside, 0])
        speeds.append(zero_phase(t, y[:, [qd]], cutoff)[inside, 0])
    if not rates or not sum(map(len, rates)):
        return None
    v, rate = np.concatenate(speeds), np.concatenate(rates)
    product = float(v @ rate)
    power = float(v @ v) * float(rate @ rate)
    return product / float(v @ v) if power > 0 and product**2 > SAME * power else None


def _factor(ratio: float) -> tuple[bool, float, str] | None:
    """Whether the position is off, by which factor, and what that is called; None where the two agree, or differ by no more than
    a sensor's scale may. A unit that was forgotten makes a number larger where it is finer: that of the position a ratio above 1,
    that of the speed one below."""
    if abs(np.log(ratio)) <= NEAR:
        return None
    off = ratio if ratio > 1 else 1 / ratio
    named = [(name, size) for name, size in ANGLES.items() if abs(np.log(off / size)) <= NEAR]
    if not named:
        return None if EFFECT_RANGE[0] < ratio < EFFECT_RANGE[1] else (False, 1 / ratio, FREE)
    # rpm are a unit of speeds alone; a position in counts or degrees is the commoner slip.
    name, size = named[0]
    return ratio > 1 and "rpm" not in name, size, name


def _told(fit: ForceFit, turned: Motion, as_it_is: Motion) -> bool | None:
    """Whether the model follows the motion so much better with its position negated, inputs as they are; None where that makes no
    such difference."""
    one, other = fit.fit(turned).worst, fit.fit(as_it_is).worst
    return one < other if min(one, other) <= GONE * max(one, other) else None


def _shown(dataset: Dataset, kind: str, channel: str, mate: str, value: float, what: str, ratio: float, sure: bool) -> Shown:
    forms = {"scale": 1 / value}
    unit = "off by a factor" if what == FREE else "in another unit"
    has = f"has {what}" if kind == "sign" else f"seems to be {unit} ({what})"
    doubt = "" if sure else f" It could be {mate} as well."
    text = f"The rate of the position is {ratio:.4g} times the speed that was recorded, for {channel} {has}.{doubt}"
    taken = "negated" if kind == "sign" else f"times {1 / value:.6g}"
    finding = DataFinding(
        kind, channel, value, text, lines(dataset, channel, forms), decisive=True, same_as=() if sure else ((kind, mate),),
        headline=f"{channel} {has}; everything below takes it {taken}",
    )  # fmt: skip
    return Shown(finding, Mending({channel: forms}))
