"""The answer of a diagnosis by torque: which, how far and where, with the words of every other
diagnosis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxid.base.wording import listed, percent
from jaxid.diagnosis import where as location
from jaxid.diagnosis.breakdown import SAMPLES, Share
from jaxid.diagnosis.budget import closed
from jaxid.diagnosis.how_far import gap_text, share_of_gap
from jaxid.diagnosis.missing import Missing
from jaxid.diagnosis.regimes import situations
from jaxid.diagnosis.result import ChannelGap, Finding, HowFar, MissingForce, Ranked, Regime
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.choose import Chooser, Model
from jaxid.diagnosis.torque.library import BODY, Unit
from jaxid.diagnosis.torque.study import TorqueRows, TorqueStudy
from jaxid.dynamics.parameter import resolve, specs
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.result import Covariance, EffectEstimate, Estimate, Score, Trace
from jaxid.fitting.scores import score
from jaxid.identification.payload import NO_MASS, usual_gain_std


#: Simulated repetitions of the noise in every regime.
DRAWS = 12


#: What the noise of a torque is, without repeats and with them.
NOISE, REPEATED = (
    "noise of torque and motion",
    "noise of torque and motion, and what repeats differ by",
)


@dataclass(frozen=True, eq=False)
class Answer:
    """One model of a study, ready to be looked at: its columns and numbers."""

    study: TorqueStudy
    rows: TorqueRows
    at: np.ndarray
    numbers: np.ndarray
    units: tuple[Unit, ...] = ()

    def residual(self, run: int) -> np.ndarray:
        """What it leaves of a run's torque, N m [samples n]."""
        return self.rows.residual(run, self.at, self.numbers)

    def gap(self, which: Sequence[int], joint: int | None = None) -> float:
        """Root mean square of what it leaves of some runs in multiples of the noise, over joints
        that move; nan for none, infinite where what it leaves is no number.
        """
        total, count = 0.0, 0
        for k in which:
            inside = self.study.runs[k].moves.copy()
            inside &= True if joint is None else np.arange(len(inside)) == joint
            r = (self.residual(k) / self.study.noise_of(k))[:, inside]
            total, count = total + float(np.sum(r**2)), count + r.size
        if not count:
            return float("nan")
        return float(np.sqrt(total / count)) if np.isfinite(total) else float("inf")

    def rms(self, which: Sequence[int], joint: int) -> float:
        """Root mean square of what it leaves at a joint, N m, each row counted by how well it is
        known: that over `TorqueStudy.typical` is the gap.
        """
        return self.gap(which, joint) * self.study.typical(which, joint)

    def measured(self, run: int) -> np.ndarray:
        r = self.study.runs[run]
        return r.rows(self.study.plant.drive(r, self.rows.theta))


def of_model(study: TorqueStudy, rows: TorqueRows, model: Model) -> Answer:
    return Answer(
        study,
        rows,
        model.solution.at,
        model.solution.theta,
        tuple(rows.units[u] for u in model.units),
    )


def estimates(
    study: TorqueStudy, chooser: Chooser, model: Model
) -> tuple[dict[str, Estimate], tuple[EffectEstimate, ...], Covariance]:
    """Numbers of the nominal model, effects with theirs, and the covariance of the former as far
    as the data determine them.
    """
    s, b = model.solution, study.binding
    covariance, determined = s.spread
    dof = max(1, chooser.fit.rows - len(s.at))
    level = max(1.0, s.cost / dof)
    slopes, told = chooser.fit.scores(s.at, s.theta), np.nan_to_num(covariance)
    sandwich = told @ (slopes.T @ slopes) @ told * len(slopes) / max(1, len(slopes) - 1)
    wider = np.sqrt(np.maximum(1.0, np.diag(sandwich) / np.maximum(np.diag(told) * level, 1e-300)))
    covariance = covariance * wider * wider[:, None]
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0) * level)
    own: dict[str, Estimate] = {}
    for k, i in enumerate(study.plant.free):
        e = b.layout.entries[i]
        sure = bool(determined[k]) and np.isfinite(std[k])
        shown = float(std[k]) if sure else None
        own[e.name] = Estimate(
            float(s.theta[k]),
            shown,
            e.unit,
            float(b.lower[i]),
            float(b.upper[i]),
            bool(s.bound[k]),
            sure,
        )
    effects, first = [], chooser.size
    for u in model.units:
        unit = chooser.units[u]
        at = slice(first, first + len(unit.fields))
        first = at.stop
        effects.append(_effect(study, unit, s.theta[at], covariance[at, at] * level, s.bound[at]))
    names = {name: k for k, (name, e) in enumerate(own.items()) if e.std is not None}
    sure = list(names.values())
    matrix = covariance[np.ix_(sure, sure)] * level
    return own, tuple(effects), Covariance(tuple(names), matrix)


def _effect(
    study: TorqueStudy, unit: Unit, values: np.ndarray, covariance: np.ndarray, bound: np.ndarray
) -> EffectEstimate:
    if unit.fields == BODY:
        body = _body(unit, values, covariance, usual_gain_std(study.binding.chain))
        return EffectEstimate(unit.effect, unit.location, body)
    std = np.sqrt(np.maximum(np.nan_to_num(np.diag(covariance)), 0.0))
    found = {}
    for k, field in enumerate(unit.fields):
        held = bool(bound[k])
        if field not in unit.hidden:
            found[field] = Estimate(
                value=float(values[k]),
                std=None if held else float(std[k]),
                unit=_unit(study, unit, field),
                lower=float(unit.least[k]),
                upper=float("inf"),
                at_bound=held,
                identifiable=not held,
            )
    for field, value in unit.shape.items():
        told, bounds = _unit(study, unit, field), _bounds(study, unit, field)
        found[field] = Estimate(float(value), None, told, *bounds, False, True)
    return EffectEstimate(unit.effect, unit.location, found)


def _kind(study: TorqueStudy, unit: Unit) -> Any:
    return next(k for k in study.kinds if k.name == unit.effect)


def _bounds(study: TorqueStudy, unit: Unit, field: str) -> tuple[float, float]:
    spec = specs(_kind(study, unit)())[field]
    reference = study.binding.references[unit.joints[0]]
    return resolve(spec.lower, reference), resolve(spec.upper, reference)


def _unit(study: TorqueStudy, unit: Unit, field: str) -> str:
    own = specs(_kind(study, unit)())
    beside = "{I}" if field == "inertia" else "rad"
    template = own[field].unit if field in own else beside
    return study.binding.chain.signature.unit(template, unit.joints[0])


def _body(
    unit: Unit, values: np.ndarray, covariance: np.ndarray, gain_std: float = 0.0
) -> dict[str, Estimate]:
    """Mass, centre of mass and inertia about the link's origin of a body, from its ten numbers. An
    error of the drive gains, relative `gain_std`, is one of mass and inertia alike, and none of the
    centre.
    """
    m, inf = float(values[0]), float("inf")
    with_gains = covariance + gain_std**2 * np.diag(values**2)

    def told(variance: float, spread: float) -> bool:
        return bool(np.sqrt(max(variance, 0.0)) < LIMITS.half * spread)

    def quantity(value: float, variance: float, unit_: str, sure: bool) -> Estimate:
        std = float(np.sqrt(max(variance, 0.0))) if sure else None
        return Estimate(value, std, unit_, -inf, inf, False, sure)

    sure = told(covariance[0, 0], unit.spread[0])
    out = {"mass": quantity(m, with_gains[0, 0], "kg", sure)}
    for k, axis in ((1, "x"), (2, "y"), (3, "z")) if abs(m) > NO_MASS else ():
        slope = np.zeros(10)
        slope[k], slope[0] = 1 / m, -values[k] / m**2
        seen = sure and told(covariance[k, k], unit.spread[k])
        out[axis] = quantity(float(values[k] / m), float(slope @ covariance @ slope), "m", seen)
    for k in range(4, 10):
        seen = told(covariance[k, k], unit.spread[k])
        out[unit.fields[k]] = quantity(float(values[k]), float(with_gains[k, k]), "kg m^2", seen)
    return out


def ranking(
    study: TorqueStudy, chooser: Chooser, rows: TorqueRows, which: Sequence[int]
) -> tuple[Ranked, ...]:
    """Every set that was tried, best on held-out runs first, by the effect that is new in it."""
    nominal = of_model(study, rows, chooser.nominal).gap(which)
    best: dict[tuple[str, str], tuple[Model, Unit, list[Unit]]] = {}
    for m in sorted(chooser.tried, key=lambda m: m.loss):
        own = [chooser.units[u] for u in m.units]
        for k, u in enumerate(own):
            best.setdefault(u.place, (m, u, own[:k] + own[k + 1 :]))
    out = []
    for m, u, others in best.values():
        gap = of_model(study, rows, m).gap(which)
        beside = f" beside {listed(map(str, others))}" if others else ""
        share = closed(nominal**2, gap**2)
        closes = percent(share) if share else "nothing"
        cost = m.cost + chooser.price(m.units)
        evidence = float(chooser.nominal.loss - m.loss)
        sentence = f"{u}{beside}: closes {closes} of the gap on held-out data"
        out.append(Ranked(u.effect, u.location, gap, cost, evidence, sentence))
    return tuple(sorted(out, key=lambda r: r.validation_gap))


# ---- how far


def how_far(
    study: TorqueStudy,
    before: Answer,
    retuned: Answer,
    after: Answer,
    which: Sequence[int],
    split: str,
    verdict: str,
    note: str,
    ceiling: float | None,
) -> HowFar:
    """Gaps on some runs: as stated, re-tuned, with the effects."""
    models = (before, retuned, after)
    gaps = [m.gap(which) for m in models]
    channels: dict[str, ChannelGap] = {}
    source = REPEATED if any(x.any() for x in study.between) else NOISE
    for j, (name, unit) in enumerate(study.binding.chain.torque_channels):
        moving = [k for k in which if study.runs[k].moves[j]]
        if moving:
            stated, again, final = (m.rms(moving, j) for m in models)
            channels[name] = ChannelGap(
                unit, stated, again, final, study.typical(moving, j), source
            )
    runs = []
    for k in which:
        name = study.runs[k].experiment.name
        runs.append(Share(name, "", len(before.residual(k)), *(m.gap([k]) for m in models)))
    shrinkage, reason = share_of_gap(gaps[0], gaps[2], verdict, split)
    if shrinkage is not None:
        reason = "rows of torque within one run are not independent"
    text = gap_text(split, gaps, verdict)
    if ceiling is not None:
        text += (
            f"; any law of a joint's own position, speed and load would close {percent(ceiling)}"
            " of it"
        )
    text += ". Torque and motion are low-passed alike, and rows count by how well they are known"
    return HowFar(
        gap_before=gaps[0],
        gap_retuned=gaps[1],
        gap_after=gaps[2],
        noise_floor=1.0,
        shrinkage=shrinkage,
        shrinkage_interval_95=None,
        interval_reason=reason,
        per_channel=channels,
        text=f"{text}. {note}".strip(),
        per_run=tuple(runs),
        per_regime=_by_regime(study, models, which),
        interval_from="",
        split=split,
        ceiling=ceiling,
    )


def _by_regime(
    study: TorqueStudy, models: Sequence[Answer], which: Sequence[int]
) -> tuple[Share, ...]:
    out, found = [], [missing(models[0], k, 0) for k in which]
    noise = [study.noise_of(k) for k in which]
    left = []
    for m in models:
        each = [m.residual(k) / n for k, n in zip(which, noise, strict=True)]
        left.append(np.concatenate(each) if each else np.zeros((0, 0)))
    for j, joint in enumerate(study.binding.chain.signature.joints):
        if not any(study.runs[k].moves[j] for k in which):
            continue
        for name, inside in situations(found, j).items():
            own = np.concatenate(inside)
            count = int(np.sum(own))
            if count >= SAMPLES:
                gaps = [float(np.sqrt(np.mean(x[own, j] ** 2))) for x in left]
                out.append(Share(name, joint, count, *gaps))
    return tuple(out)


# ---- where


def missing(answer: Answer, k: int, seed: int, draws: int = DRAWS) -> Missing:
    """The torque that a model lacks along the rows of a run, and what noise alone would show. Where
    a joint turns about, what its dry friction may hold is not missing.
    """
    study = answer.study
    run = study.runs[k]
    keep = np.zeros(len(run.experiment.t), bool)
    keep[run.kept] = True
    left = answer.residual(k)
    force = np.sign(left) * np.maximum(np.abs(left) - study.unsure[k], 0.0)
    rng = np.random.default_rng([seed, k])
    null = study.scatter_of(k) * rng.standard_normal((draws, *force.shape))
    still = run.moves.astype(float)
    return Missing(
        experiment=run.experiment,
        keep=keep,
        q=run.q[keep],
        qd=run.qd[keep],
        qdd=run.qdd[keep],
        load=answer.measured(k),
        force=force * still,
        null=null,
    )


def places(
    study: TorqueStudy,
    nominal: Answer,
    final: Answer,
    verdict: str,
    which: Sequence[int],
    seed: int,
) -> tuple[tuple[Finding, ...], tuple[MissingForce, ...], tuple[Regime, ...]]:
    """Findings, pictures and regimes of some runs."""
    joints, bench = study.binding.chain.signature.joints, ProblemBuilder(study.binding)
    before = [missing(nominal, k, seed) for k in which]
    after = [missing(final, k, seed, 1) for k in which]
    named: dict[str, str] = {}
    for u in final.units if verdict == "named" else ():
        for j in u.joints:
            named.setdefault(joints[j], u.location if len(u.joints) == 1 else joints[j])
    given = {}
    for joint in named:
        force = location.supplied(before, after, joints.index(joint))
        if force is not None:
            given[joint] = force
    rows = location.table(before, joints, given)
    found = []
    if verdict != "none":
        found = location.findings(bench, before, rows, named, tuple(named), given)
    return tuple(found), tuple(location.pictures(bench, before, after)), tuple(rows)


def traces(study: TorqueStudy, nominal: Answer, final: Answer, label: str) -> tuple[Trace, ...]:
    """Measured torque, low-passed, and what the models need for the measured motion."""
    out = []
    for k in (*study.of("report"), *study.of("validation"), *study.of("fit")):
        run, measured = study.runs[k], nominal.measured(k)
        needed = {"re-tuned": measured - nominal.residual(k)}
        if label:
            needed[label] = measured - final.residual(k)
        for j, (name, unit) in enumerate(study.binding.chain.torque_channels):
            series = {key: y[:, j] for key, y in needed.items()}
            out.append(
                Trace(
                    experiment=run.experiment.name,
                    split=run.split,
                    channel=name,
                    unit=unit,
                    t=run.t,
                    measured=measured[:, j],
                    simulated=series,
                    noise=study.typical([k], j),
                )
            )
    return tuple(out)


def scores(answer: Answer) -> dict[str, dict[str, Score]]:
    """Split -> channel -> how well the torque is predicted."""
    study, out = answer.study, {}
    for split in ("fit", "validation", "report"):
        which = study.of(split)
        if which:
            measured = np.concatenate([answer.measured(k) for k in which])
            left = np.concatenate([answer.residual(k) for k in which])
            channels = study.binding.chain.torque_channels
            out[split] = {}
            for (name, unit), y, r in zip(channels, measured.T, left.T, strict=True):
                out[split][name] = score(y, r, unit)
    return out
