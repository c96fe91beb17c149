"""Where the gap lies: the force that the model lacks, by joint, regime and time, against what noise
alone would show.

Every figure of the missing force (`missing`) is compared with the same figure of simulated data.
Where named effects explain what is missing, the force that they supply along the same motion is
looked at in its place: it has no noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxid.base.wording import number, percent, run_words
from jaxid.data.dataset import Experiment
from jaxid.data.splits import LATE
from jaxid.diagnosis.cause import span, variable, words
from jaxid.diagnosis.missing import Missing
from jaxid.diagnosis.regimes import situations
from jaxid.diagnosis.result import Finding, MissingForce, Regime, STANDS_OUT
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.travel import LEAST, part_of_travel, TravelPart
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.result import EffectEstimate
from jaxid.fitting.scores import free_runs
from jaxid.problem.residual import OutputError


WINDOW_S = 0.5
#: At most so many places are told, of a joint and in all.
MOST = 3
#: The name of a part of the travel, beside the regimes.
PART = "part_of_travel"
#: Share of a force's energy that lies in one direction of motion, from which it is said to.
ONE_WAY = 0.9

#: Each regime in words, and what tells it.
_WORDS = {
    "everywhere": ("is alike in all situations", ""),
    "standstill": ("lies while standing still", "speed"),
    "breakaway": ("lies at breakaway", "speed"),
    "velocity_reversal": ("lies around velocity reversals", "speed"),
    "low_speed": ("lies at low speed", "speed"),
    "high_speed": ("lies at high speed", "speed"),
    "forward": ("lies while moving forwards", "speed"),
    "backward": ("lies while moving backwards", "speed"),
    "high_acceleration": ("lies under high acceleration", "acceleration"),
    "upper_travel": ("lies at the upper end of travel", "position"),
    "lower_travel": ("lies at the lower end of travel", "position"),
    PART: ("lies", "position"),
    "early": ("lies in the first third of the run", "time"),
    "late": ("lies in the last third of the run", "time"),
    "high_load": ("lies under high load", "load"),
    "low_load": ("lies under low load", "load"),
}


#: Where the series of a variable stands in what is missing.
_SERIES = {"speed": "qd", "position": "q", "acceleration": "qdd", "load": "load", "command": "load"}


def supplied(
    found: Sequence[Missing], after: Sequence[Missing], joint: int
) -> list[np.ndarray] | None:
    """The force [time] that the named effects supply at a joint in each run: what is missing
    without them less what is missing with them, noise and filters being the same. None where that
    is not what was missing: a sensor, a spring or play changes the motion itself.
    """
    given = [m.force[:, joint] - a.force[:, joint] for m, a in zip(found, after, strict=True)]
    energy = sum(float(g @ g) for g in given)
    gained = sum(
        float(np.sum(m.force[:, joint] ** 2 - a.force[:, joint] ** 2))
        for m, a in zip(found, after, strict=True)
    )
    above = sum(
        float(np.sum(m.force[:, joint] ** 2 - np.mean(m.null[:, :, joint] ** 2, 0))) for m in found
    )
    least = LIMITS.half * max(energy, above)
    return given if energy > 0 and gained >= least else None


def table(
    found: Sequence[Missing], joints: Sequence[str], given: dict[str, list[np.ndarray]]
) -> list[Regime]:
    """Strength of the missing force in each regime over its strength overall, the same for a
    perfect model, and for the force that named effects supply (`given`, by joint).
    """
    out = []
    for j, joint in enumerate(joints):
        own = given.get(joint)
        measured = [m.force[:, j] for m in found]
        for name, inside in situations(found, j).items():
            count = int(sum(mask.sum() for mask in inside))
            if count < LEAST:
                continue
            drawn = zip(*(m.null[:, :, j] for m in found), strict=True)
            by_chance = [_ratio(draw, inside) for draw in drawn]
            low, high = np.nan, np.nan
            if by_chance:
                low, high = np.percentile(by_chance, [2.5, 97.5])
            row = Regime(
                joint=joint,
                regime=name,
                ratio=_ratio(measured, inside),
                null=(float(low), float(high)),
                samples=count,
                supplied=None if own is None else _ratio(own, inside),
            )
            out.append(row)
    return out


def _ratio(series: Sequence[np.ndarray], masks: Sequence[np.ndarray]) -> float:
    inside = np.concatenate([s[k] for s, k in zip(series, masks, strict=True)])
    return float(np.sqrt(np.mean(inside**2) / max(np.mean(np.concatenate(series) ** 2), 1e-300)))


def floor_of(found: Sequence[Missing], joint: int, masks: Sequence[np.ndarray]) -> float:
    """Root mean square of the missing force that noise alone would show in a regime."""
    each = [m.null[:, mask, joint].ravel() for m, mask in zip(found, masks, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(each) ** 2)))


def floor_at(m: Missing, joint: int) -> np.ndarray:
    """The same at every sample [time], over a hundredth of the run: noise shows more where the
    motion is abrupt.
    """
    from scipy.ndimage import uniform_filter1d

    square = uniform_filter1d(
        np.mean(m.null[:, :, joint] ** 2, 0), 1 + len(m.force) // 100, mode="nearest"
    )
    return np.sqrt(np.maximum(square, 0.0))  # a running sum of zeros ends below zero


def findings(
    bench: ProblemBuilder,
    found: Sequence[Missing],
    rows: Sequence[Regime],
    locations: dict[str, str],
    only: Sequence[str],
    given: dict[str, list[np.ndarray]],
    causes: Mapping[str, EffectEstimate] | None = None,
) -> list[Finding]:
    """The places that hold most of the gap, worst first; `locations` joint -> location of the
    effect blamed there, `only`: joints to look at (all, if empty), `given`: what named effects
    supply there, in place of what is missing; `causes`: the effect named at a joint, in whose terms
    its place is then told.
    """
    b = bench.binding
    joints, outputs = b.chain.signature.joints, b.chain.signature.output_names
    looked = [j for j, joint in enumerate(joints) if joint in only or not only]
    total = sum(_excess(found, j, None, given.get(joints[j])) for j in looked)
    if not 0 < total < np.inf:
        return []  # no more than noise, or no number
    out = []
    for j in looked:
        joint = joints[j]
        cause = (causes or {}).get(joint)
        own = [row for row in rows if row.joint == joint]
        spots = _standing_out(found, j, own, given.get(joint), total)
        for spot in spots[: 1 if cause else MOST]:
            place = _Place(
                found=found,
                joint=j,
                force=given.get(joint, [m.force[:, j] for m in found]),
                regime=spot.regime,
                inside=spot.inside,
                part=spot.part,
                floor=spot.floor,
                cause=cause,
                unit=b.chain.signature.unit("{F}", j),
                position_unit=b.chain.signature.unit("{X}", j),
            )
            # Of what is measured no more than noise is no place.
            if place.times_noise >= 1 or joint in given:
                channel = joint if joint in outputs else outputs[min(j, len(outputs) - 1)]
                told = locations.get(joint, joint)
                out.append(place.finding(joint, channel, told, float(spot.share)))
    return sorted(out, key=lambda f: -f.share_of_gap * f.times_noise_floor)[:MOST]


class _Spot(NamedTuple):
    """A regime or a part of the travel in which a force stands out: by how much, with which share
    of the gap, when (masks [runs][time]), and what noise alone would show there.
    """

    weight: float
    share: float
    regime: str
    inside: Sequence[np.ndarray]
    floor: float
    part: TravelPart | None


def _standing_out(
    found: Sequence[Missing],
    joint: int,
    rows: Sequence[Regime],
    given: list[np.ndarray] | None,
    total: float,
) -> list[_Spot]:
    """Where the force of a joint lies, worst first; everywhere, where it stands out nowhere and is
    a large share of the `total`.
    """
    whole = _excess(found, joint, None, given)
    least = 0.05 * total if given is None else LIMITS.named * whole
    spots = []

    def look(lift, regime, inside, floor, part=None):
        energy = _excess(found, joint, inside, given)
        if energy > least:
            # Elsewhere there may be less than noise: no reason to see more than all of it here.
            share = min(1.0, energy / total)
            spots.append(_Spot(lift * np.sqrt(share), share, regime, inside, floor, part))

    masks = situations(found, joint)
    for row in rows:
        if row.regime in masks and row.null[1] > 0 and row.stands_out:
            inside = masks[row.regime]
            look(_lift(row), row.regime, inside, floor_of(found, joint, inside))
    force = [m.force[:, joint] for m in found] if given is None else given
    part, chance = _clear_part(found, joint, force)
    if part is not None:
        inside = part.masks(found, joint)
        # What effects supply has no noise.
        lift = abs(part.more) / chance if given is None else _ratio(force, inside)
        look(lift, PART, inside, chance, part)
    if not spots and whole / total > 0.2:
        inside = [np.ones(len(m.force), bool) for m in found]
        floor = floor_of(found, joint, inside)
        return [_Spot(0.0, whole / total, "everywhere", inside, floor, None)]
    return sorted(spots, key=lambda spot: -spot.weight)


def _lift(row: Regime) -> float:
    """How much stronger a force is in a regime than elsewhere, against what chance makes of it."""
    return row.ratio / max(row.null[1], 1e-9) if row.supplied is None else row.supplied


def _clear_part(
    found: Sequence[Missing], joint: int, force: Sequence[np.ndarray]
) -> tuple[TravelPart | None, float]:
    """The part of the travel in which a force is clearly another one than in each draw of a perfect
    model, None where there is none; and what these differ by at most.
    """
    part = part_of_travel(found, joint, force)
    if part is None:
        return None, 0.0
    chance = 1e-300
    for draw in range(len(found[0].null)):
        drawn = part_of_travel(found, joint, [m.null[draw][:, joint] for m in found])
        if drawn is not None:
            chance = max(chance, abs(drawn.more))
    return part if abs(part.more) > STANDS_OUT * chance else None, chance


@dataclass(frozen=True)
class _Place:
    """A regime of a joint in which a force lies, or a part of its travel, what noise alone would
    show there (`floor`), and the effect that is named there.
    """

    found: Sequence[Missing]
    joint: int
    force: Sequence[np.ndarray]
    regime: str
    inside: Sequence[np.ndarray]
    part: TravelPart | None
    floor: float
    cause: EffectEstimate | None
    unit: str
    position_unit: str

    @property
    def value(self) -> float:
        """Root mean square of the force; in a part of the travel what it is more than elsewhere."""
        if self.part is not None:
            return abs(self.part.more)
        each = zip(self.force, self.inside, strict=True)
        values = np.concatenate([force[mask] for force, mask in each])
        return float(np.sqrt(np.mean(values**2)))

    @property
    def times_noise(self) -> float:
        return self.value / max(self.floor, 1e-300)

    def finding(self, joint: str, channel: str, location: str, share: float) -> Finding:
        cause, regime = self.cause, self.regime
        window, experiment = _window(self.found, self.force, self.inside)
        spread, told_by = _WORDS[regime]
        seen = f"{joint}: {percent(share)} of the missing force {spread}"
        if cause and words(cause, "seen"):
            seen, told_by = f"{joint}: {words(cause, 'seen')}", variable(cause)
            regime = regime if told_by == _WORDS[regime][1] else "everywhere"
        limits = span(cause) if cause else None
        if limits is None:
            limits = _range(self.found, self.joint, told_by, self.inside)
        strongest = f"strongest {when(window, self.found, experiment)}"
        return Finding(
            channel=channel,
            location=location,
            regime=regime,
            window_s=window,
            share_of_gap=share,
            times_noise_floor=self.times_noise,
            text=f"{seen} {self._size(regime)}; {strongest}",
            variable=told_by,
            range=limits,
            direction=_direction(self.found, self.joint, self.force, self.inside),
            value=self.value,
            unit=self.unit,
        )

    def _size(self, regime: str) -> str:
        """How much it is; on a part of the travel, between where and where."""
        size = f"{number(self.value)} {self.unit}"
        if self.part is None or regime != PART:
            return f"({size} rms; noise of a sample {number(self.floor)})"
        low, high = number(self.part.low), number(self.part.high)
        more = "more" if self.part.more > 0 else "less"
        way = "against the motion, both ways" if self.part.against else "with one sign, both ways"
        return (
            f"between {low} and {high} {self.position_unit}: {size} {more} than elsewhere {way}"
            f" (noise alone: up to {number(self.floor)})"
        )


def _direction(
    found: Sequence[Missing], joint: int, force: Sequence[np.ndarray], masks: Sequence[np.ndarray]
) -> str:
    """In which direction of a joint's motion a force lies: forward, backward or both."""
    speed = np.concatenate([m.qd[k, joint] for m, k in zip(found, masks, strict=True)])
    own = np.concatenate([f[k] for f, k in zip(force, masks, strict=True)])
    energy = float(own @ own)
    if energy == 0:
        return ""
    forward = float(np.sum(own[speed > 0] ** 2)) / energy
    backward = float(np.sum(own[speed < 0] ** 2)) / energy
    if forward > ONE_WAY:
        return "forward"
    return "backward" if backward > ONE_WAY else "both"


def _range(
    found: Sequence[Missing], joint: int, name: str, masks: Sequence[np.ndarray]
) -> tuple[float, float] | None:
    """From where to where a variable went inside a regime; None for one that is not recorded by
    joint.
    """
    series = _SERIES.get(name)
    if series is None:
        return None
    inside = np.concatenate(
        [getattr(m, series)[k, joint] for m, k in zip(found, masks, strict=True)]
    )
    return (float(inside.min()), float(inside.max())) if len(inside) else None


def _excess(
    found: Sequence[Missing],
    joint: int,
    masks: Sequence[np.ndarray] | None,
    given: Sequence[np.ndarray] | None,
) -> float:
    """Energy of the missing force above what noise would show, over a regime or everything, in
    units of that noise; where the force itself is `given`, its energy.
    """
    total = 0.0
    for k, m in enumerate(found):
        mask = np.ones(len(m.force), bool) if masks is None else masks[k]
        null = m.null[:, mask, joint]
        floor = np.mean(m.null[:, :, joint] ** 2) + 1e-300
        energy = np.sum(m.force[mask, joint] ** 2) - np.sum(null**2) / max(1, len(null))
        total += float(energy if given is None else np.sum(given[k][mask] ** 2)) / float(floor)
    return max(total, 0.0)


def _window(
    found: Sequence[Missing], force: Sequence[np.ndarray], masks: Sequence[np.ndarray]
) -> tuple[tuple[float, float], str]:
    """The half second (or twentieth of the run) in which the missing force of a regime is
    strongest.
    """
    best, where = -1.0, ((0.0, 0.0), "")
    for m, missing, mask in zip(found, force, masks, strict=True):
        t = m.experiment.t[m.keep]
        energy = np.concatenate([[0.0], np.cumsum(np.where(mask, missing**2, 0.0))])
        until = np.searchsorted(t, t + min(WINDOW_S, (t[-1] - t[0]) / 20), side="right")
        strength = energy[until] - energy[np.arange(len(t))]
        k = int(np.argmax(strength))
        if strength[k] > best:
            best = float(strength[k])
            where = ((float(t[k]), float(t[until[k] - 1])), m.experiment.name)
    return where


def output_findings(
    bench: ProblemBuilder,
    theta: np.ndarray,
    starts: np.ndarray,
    locations: dict[str, str],
    only: Sequence[str],
    causes: Mapping[str, EffectEstimate] | None = None,
) -> list[Finding]:
    """Where the force cannot be seen: the window of each channel where the free run is worst."""
    b = bench.binding
    runs = bench.runs(OutputError(), "fit")
    predictions = free_runs(bench, "fit", [theta], starts[None])[0]
    out = []
    for c, (name, unit) in enumerate(b.chain.signature.outputs):
        if name not in only and any(n in only for n, _ in b.chain.signature.outputs):
            continue
        for record, e, p in zip(runs.records, runs.experiments, predictions, strict=True):
            error = p[:, c] - runs.targets[runs.record(record).samples][:, c]
            energy = np.concatenate([[0.0], np.cumsum(error**2)])
            until = np.searchsorted(e.t, e.t + min(WINDOW_S, (e.t[-1] - e.t[0]) / 20), side="right")
            strength = energy[until] - energy[np.arange(len(e.t))]
            k = int(np.argmax(strength))
            rms = float(np.sqrt(strength[k] / max(1, until[k] - k)))
            share = (
                float(np.clip(strength[k] / energy[-1], 0.0, 1.0))
                if np.isfinite(energy[-1]) and energy[-1] > 0
                else 0.0
            )
            window = (float(e.t[k]), float(e.t[until[k] - 1]))
            above = rms / float(b.sigma[c])
            if not np.isfinite(above):
                continue  # a run that diverges is worst nowhere
            cause = (causes or {}).get(name)
            seen = f"{words(cause, 'seen')}; " if cause and words(cause, "seen") else ""
            text = (
                f"{name}: {seen}the free run is worst {during(window, e)} ({number(rms)} {unit}"
                " rms)"
            )
            told_by = variable(cause) if cause else "time"
            limits = span(cause) if cause else None
            out.append(
                Finding(
                    channel=name,
                    location=locations.get(name, name),
                    regime="time_window",
                    window_s=window,
                    share_of_gap=share,
                    times_noise_floor=above,
                    text=text,
                    variable=told_by,
                    range=limits,
                    value=rms,
                    unit=unit,
                )
            )
    return sorted(out, key=lambda f: -f.times_noise_floor)[:3]


def when(window: tuple[float, float], found: Sequence[Missing], name: str) -> str:
    return during(window, next(m.experiment for m in found if m.experiment.name == name))


def during(window: tuple[float, float], e: Experiment) -> str:
    """A window of a run in words: in its own time, or from its start where its clock began long
    before.
    """
    if abs(e.t[0]) < LATE:
        return f"from {window[0]:.3f} to {window[1]:.3f} s of {run_words(e.name)}"
    return (
        f"from {window[0] - e.t[0]:.5g} to {window[1] - e.t[0]:.5g} s after the start of"
        f" {run_words(e.name)}"
    )


def pictures(
    bench: ProblemBuilder, before: Sequence[Missing], after: Sequence[Missing]
) -> list[MissingForce]:
    """Series for the report, one per joint and fit run."""
    b = bench.binding
    s = b.chain.signature
    out = []
    for m, a in zip(before, after, strict=True):
        for j, joint in enumerate(s.joints):
            out.append(
                MissingForce(
                    joint=joint,
                    unit=s.unit("{F}", j),
                    q_unit=s.unit("{X}", j),
                    qd_unit=s.unit("{X}/s", j),
                    experiment=m.experiment.name,
                    t=m.experiment.t[m.keep],
                    q=m.q[:, j],
                    qd=m.qd[:, j],
                    load=m.load[:, j],
                    before=m.force[:, j],
                    after=a.force[:, j],
                    floor=floor_at(m, j),
                )
            )
    return out
