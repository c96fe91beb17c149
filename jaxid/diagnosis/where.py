"""Where the gap lies: the force that the model lacks, by joint, regime and time, against what noise
alone would show.

Every figure of the missing force (`missing`) is compared with the same figure of simulated data.
Where named effects explain what is missing, the force that they supply along the same motion is
looked at in its place: it has no noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from jaxid.base.wording import number, percent
from jaxid.data.dataset import Experiment
from jaxid.data.splits import LATE
from jaxid.diagnosis.cause import span, variable, words
from jaxid.diagnosis.missing import Missing
from jaxid.diagnosis.regimes import regimes
from jaxid.diagnosis.result import Finding, MissingForce, Regime
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.result import EffectEstimate
from jaxid.fitting.scores import free_runs
from jaxid.problem.residual import OutputError


WINDOW_S = 0.5
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
    "early": ("lies in the first third of the run", "time"),
    "late": ("lies in the last third of the run", "time"),
    "high_load": ("lies under high load", "load"),
    "low_load": ("lies under low load", "load"),
}


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
    return (
        given
        if energy > 0 and gained >= max(LIMITS.own_energy * energy, LIMITS.own_share * above)
        else None
    )


def table(
    found: Sequence[Missing], joints: Sequence[str], given: dict[str, list[np.ndarray]]
) -> list[Regime]:
    """Strength of the missing force in each regime over its strength overall, the same for a
    perfect model, and for the force that named effects supply (`given`, by joint).
    """
    out = []
    for j, joint in enumerate(joints):
        masks = [regimes(m, j) for m in found]
        for name in dict.fromkeys(n for mask in masks for n in mask):
            mask = [
                k.get(name, np.zeros(len(m.force), bool)) for k, m in zip(masks, found, strict=True)
            ]
            count = int(sum(k.sum() for k in mask))
            if count < 20:
                continue
            ratio = _ratio([m.force[:, j] for m in found], mask)
            null = [
                _ratio([m.null[d][:, j] for m in found], mask) for d in range(len(found[0].null))
            ]
            low, high = (
                (float(x) for x in np.percentile(null, [2.5, 97.5])) if null else (np.nan, np.nan)
            )
            own = _ratio(given[joint], mask) if joint in given else None
            out.append(Regime(joint, name, ratio, (low, high), count, own))
    return out


def _ratio(series: Sequence[np.ndarray], masks: Sequence[np.ndarray]) -> float:
    inside = np.concatenate([s[k] for s, k in zip(series, masks, strict=True)])
    return float(np.sqrt(np.mean(inside**2) / max(np.mean(np.concatenate(series) ** 2), 1e-300)))


def floor_of(found: Sequence[Missing], joint: int, masks: Sequence[np.ndarray]) -> float:
    """Root mean square of the missing force that noise alone would show in a regime."""
    return float(
        np.sqrt(
            np.mean(
                np.concatenate(
                    [m.null[:, k, joint].ravel() for m, k in zip(found, masks, strict=True)]
                )
                ** 2
            )
        )
    )


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
    most: int = 3,
    causes: Mapping[str, EffectEstimate] | None = None,
) -> list[Finding]:
    """The places that hold most of the gap, worst first; `locations` joint -> location of the
    effect blamed there, `only`: joints to look at (all, if empty), `given`: what named effects
    supply there, in place of what is missing; `causes`: the effect named at a joint, in whose terms
    its place is then told.
    """
    b = bench.binding
    joints, outputs = b.chain.signature.joints, b.chain.signature.output_names
    unit = b.chain.signature.unit("{F}")

    def energy_of(j, masks):
        return _excess(found, j, masks, given.get(joints[j]))

    looked = [j for j, joint in enumerate(joints) if joint in only or not only]
    total = sum(energy_of(j, None) for j in looked)
    if not 0 < total < np.inf:
        return []  # no more than noise, or no number
    out = []
    for j in looked:
        joint = joints[j]
        force = given.get(joint, [m.force[:, j] for m in found])
        scored_rows = []
        for row in rows:
            if row.joint != joint or row.null[1] <= 0:
                continue
            inside = [regimes(m, j).get(row.regime, np.zeros(len(m.force), bool)) for m in found]
            energy = energy_of(j, inside)
            lift = row.ratio / max(row.null[1], 1e-9) if row.supplied is None else row.supplied
            if row.stands_out and energy > (
                LIMITS.own_regime * energy_of(j, None) if joint in given else 0.05 * total
            ):
                # Elsewhere there may be less than noise, which is no reason to see more than all of
                # it here.
                share = min(1.0, energy / total)
                scored_rows.append((lift * np.sqrt(share), share, row.regime, inside))
        scored_rows.sort(key=lambda r: -r[0])
        if not scored_rows:
            every = [np.ones(len(m.force), bool) for m in found]
            share = energy_of(j, None) / total
            if share > 0.2:
                scored_rows = [(0.0, share, "everywhere", every)]
        cause = (causes or {}).get(joint)
        for _, share, regime, inside in scored_rows[: 1 if cause else most]:
            values = np.concatenate([f[k] for f, k in zip(force, inside, strict=True)])
            strength = float(np.sqrt(np.mean(values**2)))
            floor = floor_of(found, j, inside)
            above = strength / max(floor, 1e-300)
            if not above >= 1 and joint not in given:
                continue  # no more than noise
            window, experiment = _window(found, force, inside)
            spread, told_by = _WORDS[regime]
            size = f"{number(strength)} {unit} rms; noise of a sample {number(floor)}"
            seen = f"{joint}: {percent(share)} of the missing force {spread}"
            if cause and words(cause, "seen"):
                seen, told_by = f"{joint}: {words(cause, 'seen')}", variable(cause)
                regime = regime if told_by == _WORDS[regime][1] else "everywhere"
            text = f"{seen} ({size}); strongest {when(window, found, experiment)}"
            channel = joint if joint in outputs else outputs[min(j, len(outputs) - 1)]
            limits = (span(cause) if cause else None) or _range(found, j, told_by, inside)
            place = locations.get(joint, joint)
            out.append(
                Finding(
                    channel=channel,
                    location=place,
                    regime=regime,
                    window_s=window,
                    share_of_gap=float(share),
                    times_noise_floor=above,
                    text=text,
                    variable=told_by,
                    range=limits,
                    direction=_direction(found, j, force, inside),
                    value=strength,
                    unit=unit,
                )
            )
    return sorted(out, key=lambda f: -f.share_of_gap * f.times_noise_floor)[:most]


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
    series = {
        "speed": "qd",
        "position": "q",
        "acceleration": "qdd",
        "load": "load",
        "command": "load",
    }.get(name)
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
        return f"from {window[0]:.3f} to {window[1]:.3f} s of {e.name}"
    return (
        f"from {window[0] - e.t[0]:.5g} to {window[1] - e.t[0]:.5g} s after the start of {e.name}"
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
                    unit=s.unit("{F}"),
                    q_unit=s.unit("{X}"),
                    qd_unit=s.unit("{X}/s"),
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
