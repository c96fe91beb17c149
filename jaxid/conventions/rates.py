"""Two readings of one joint that contradict each other: its speed is not the rate of its position.
No physics is needed to see it; which of the two is wrong a model tells, or the factor.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from jaxid.conventions.finding import DataFinding
from jaxid.conventions.limits import GONE
from jaxid.conventions.mending import exchange_lines, lines, Mending
from jaxid.conventions.missing_force import ForceFit
from jaxid.conventions.readings import (
    Change,
    EFFECT_RANGE,
    exchanged,
    factors_of,
    FREE,
    nearest_factor,
    scaled_joint,
)
from jaxid.conventions.samples import LONGEST, Shown
from jaxid.data.dataset import Dataset
from jaxid.data.signals import content_cutoff, differentiate, filter_ends, zero_phase
from jaxid.dynamics.joint_readings import joint_readings
from jaxid.force.sampled_motion import SampledMotion
from jaxid.problem.binding import Binding
from jaxid.simulation.sample_buffers import columns


#: Share of a speed's power that is the rate of the position, at least: what is less is no reading
#: of the same joint.
SAME = 0.9
#: A ratio is a convention's within this share of it: both are readings of one motion, but for noise
#: and a filter.
NEAR = 0.03


def contradictions(
    binding: Binding, dataset: Dataset, fit: ForceFit | None, m: SampledMotion | None
) -> tuple[list[Shown], SampledMotion | None]:
    """What the speeds of joints say of their positions; and the motion as it then is (it is made of
    positions).
    """
    outputs = binding.chain.signature.outputs
    both = {
        j: (r.q, r.qd)
        for j, r in enumerate(joint_readings(binding.chain))
        if r.q is not None and r.qd is not None
    }
    ratios = {j: _ratio(binding, q, qd) for j, (q, qd) in both.items()}
    found, m = _crosswise(
        binding, dataset, fit, m, {j: both[j] for j, ratio in ratios.items() if ratio is None}
    )
    for j, ratio in ratios.items():
        if ratio is None:
            continue
        position, speed = (outputs[k][0] for k in both[j])
        if ratio < 0:
            told, turned = _told(fit, m, lambda m, j=j: scaled_joint(m, j, -1.0))
            channel, mate = (position, speed) if told else (speed, position)
            found.append(
                _shown(
                    dataset=dataset,
                    kind="sign",
                    channel=channel,
                    mate=mate,
                    value=-1.0,
                    what="the opposite sign",
                    ratio=ratio,
                    sure=told is not None,
                )
            )
            m = turned if told else m
        if (factor := _factor(dataset, abs(ratio), position, speed)) is not None:
            by_position, size, what = factor
            channel, mate = (position, speed) if by_position else (speed, position)
            shown = _shown(
                dataset=dataset,
                kind="scale",
                channel=channel,
                mate=mate,
                value=size,
                what=what,
                ratio=ratio,
                sure=what != FREE,
            )
            found.append(
                shown if what != FREE else Shown(replace(shown.finding, decisive=False), Mending())
            )
            m = scaled_joint(m, j, 1 / size) if by_position and m is not None else m
    return found, m


def _crosswise(
    binding: Binding,
    dataset: Dataset,
    fit: ForceFit | None,
    m: SampledMotion | None,
    lost: dict[int, tuple[int, int]],
) -> tuple[list[Shown], SampledMotion | None]:
    """Two joints of which each one's speed is the rate of the other one's position; `lost`
    (position, speed) of those whose own is not.
    """
    found: list[Shown] = []
    outputs = binding.chain.signature.outputs
    for j, k in combinations(lost, 2):
        (q, qd), (other, other_qd) = lost[j], lost[k]
        if outputs[q][1] != outputs[other][1] or not all(
            _ratio(binding, *p) for p in ((q, other_qd), (other, qd))
        ):
            continue
        told, turned = _told(fit, m, lambda m, j=j, k=k: exchanged(m, j, k, inputs=False))
        positions, speeds = (
            (outputs[x][0], outputs[y][0]) for x, y in ((q, other), (qd, other_qd))
        )
        (a, b), (c, d) = (positions, speeds) if told else (speeds, positions)
        doubt = "" if told is not None else f" It could be {c} and {d} as well."
        finding = DataFinding(
            "swapped_channels",
            a,
            1.0,
            f"Each of {a} and {b} goes with the other one of {c} and {d}: {a} and {b} are"
            f" exchanged.{doubt}",
            exchange_lines(dataset, a, b),
            decisive=True,
            same_as=() if told is not None else (("swapped_channels", c),),
            headline=f"{a} and {b} are exchanged; everything below takes each for the other",
        )
        found.append(Shown(finding, Mending(exchanged=((a, b),))))
        m = turned if told else m
    return found, m


def _ratio(binding: Binding, q: int, qd: int) -> float | None:
    """Rate of a position over the speed that was recorded; None where they are no readings of one
    motion.
    """
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


def _factor(
    dataset: Dataset, ratio: float, position: str, speed: str
) -> tuple[bool, float, str] | None:
    """Whether the position is off, by which factor, and what that is called; None where the two
    agree, or differ by no more than a sensor's scale may.
    """
    if abs(np.log(ratio)) <= NEAR:
        return None
    for channel, off in ((position, ratio), (speed, 1 / ratio)):
        size, name = nearest_factor(off, factors_of(dataset, channel))
        if abs(np.log(off / size)) <= NEAR:
            return channel == position, size, name
    return None if EFFECT_RANGE[0] < ratio < EFFECT_RANGE[1] else (False, 1 / ratio, FREE)


def _told(
    fit: ForceFit | None, m: SampledMotion | None, change: Change
) -> tuple[bool | None, SampledMotion | None]:
    """Whether the model follows a motion so much better, or so much worse, with its positions
    changed, inputs as they are, None where that makes no such difference; and the motion then.
    """
    if fit is None or m is None or not fit.driven:
        return None, m
    turned = change(m)
    one, other = fit.fit(turned).worst, fit.fit(m).worst
    return (one < other if min(one, other) <= GONE * max(one, other) else None), turned


def _shown(
    dataset: Dataset,
    kind: str,
    channel: str,
    mate: str,
    value: float,
    what: str,
    ratio: float,
    sure: bool,
) -> Shown:
    forms = {"scale": 1 / value}
    unit = "off by a factor" if what == FREE else "in another unit"
    has = f"has {what}" if kind == "sign" else f"seems to be {unit} ({what})"
    doubt = "" if sure else f" It could be {mate} as well."
    text = (
        f"The rate of the position is {ratio:.4g} times the speed that was recorded, for {channel}"
        f" {has}.{doubt}"
    )
    taken = "negated" if kind == "sign" else f"times {1 / value:.6g}"
    finding = DataFinding(
        kind,
        channel,
        value,
        text,
        lines(dataset, channel, forms),
        decisive=True,
        same_as=() if sure else ((kind, mate),),
        headline=f"{channel} {has}; everything below takes it {taken}",
    )
    return Shown(finding, Mending({channel: forms}))
