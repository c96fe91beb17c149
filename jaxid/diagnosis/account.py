"""What a diagnosis tells of its hypotheses: where the gap lies, their numbers and ranking, measured
and simulated series.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.base.wording import number, percent
from jaxid.diagnosis import where as location
from jaxid.diagnosis.budget import closed
from jaxid.diagnosis.evidence import inflation, worth
from jaxid.diagnosis.hypothesis import Candidate, Hypothesis, SearchResult
from jaxid.diagnosis.missing import missing_forces
from jaxid.diagnosis.result import Ranked
from jaxid.fitting.assemble import assemble, estimates
from jaxid.fitting.fitter import Minimum
from jaxid.fitting.own_simulation import by_run, own_simulation
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.fitting.result import EffectEstimate, Fit
from jaxid.fitting.scores import free_runs, make_traces
from jaxid.problem.binding import Binding
from jaxid.problem.residual import OutputError, Residual
from jaxid.problem.trust import sentence


def effect_estimates(
    binding: Binding, h: Hypothesis, named: Sequence[Candidate]
) -> tuple[EffectEstimate, ...]:
    """The numbers of the named effects with their standard deviations."""
    if not named:
        return ()
    found = estimates(binding, h.path.problem, h.path.z, h.covariance)
    out = []
    for c in named:
        numbers = {binding.layout.entries[i].field: found[i] for i in c.index}
        out.append(EffectEstimate(c.effect, c.location, numbers))
    return tuple(out)


def fit_of(
    bench: ProblemBuilder,
    h: Hypothesis,
    residual: Residual,
    seed: int,
    compile_time: float,
    wall_time: float,
) -> Fit:
    """A hypothesis as a fit."""
    problem = h.path.problem
    minimum = Minimum(h.path.z, h.fit_loss, h.path.converged, h.path.stopped, h.path.linearisations)
    return assemble(
        bench=bench,
        problem=problem,
        result=minimum,
        residual=residual,
        fitter="lm",
        seed=seed,
        compile_time=compile_time,
        wall_time=wall_time,
        known=h.covariance,
    )


def _starts(bench: ProblemBuilder, h: Hypothesis) -> np.ndarray:
    """Starts of the fit runs."""
    problem = h.path.problem
    if list(problem.records) == list(bench.runs(OutputError(), "fit").records):
        return problem.starts(h.path.z)
    return estimate_starts(bench, "fit", [h.theta])[0]


def _causes(binding: Binding, named: Sequence[EffectEstimate]) -> dict[str, EffectEstimate]:
    """Joint -> the first of the named effects that acts on it or on its input."""
    signature = binding.chain.signature
    joint_of = dict(zip(signature.input_names, signature.joints, strict=False))
    joint_of |= dict(zip(signature.joints, signature.joints, strict=True))
    causes: dict[str, EffectEstimate] = {}
    for e in named:
        if e.location in joint_of:
            causes.setdefault(joint_of[e.location], e)
    return causes


def where_it_lies(
    bench: ProblemBuilder,
    nominal: Hypothesis,
    final: Hypothesis,
    verdict: str,
    named: Sequence[EffectEstimate],
    seed: int,
):
    """Findings, pictures and regime table; no finding where there is no gap."""
    starts = _starts(bench, nominal)
    joints = bench.binding.chain.signature.joints
    causes = _causes(bench.binding, named)
    places = {joint: e.location for joint, e in causes.items()}
    own = causes if verdict == "named" else {}
    only = tuple(own)  # what is left of no named effect may lie anywhere
    before = missing_forces(bench, nominal.theta, starts, seed)
    found, rows, pictures = [], [], []
    if before:
        after = before
        if final is not nominal:
            after = missing_forces(bench, final.theta, _starts(bench, final), seed, draws=0)
        given = {}
        for joint in only:
            force = location.supplied(before, after, joints.index(joint))
            if force is not None:
                given[joint] = force
        rows = location.table(before, joints, given)
        pictures = location.pictures(bench, before, after)
        if verdict != "none":
            found = location.findings(bench, before, rows, places, only, given, causes=own)
    if not found and verdict != "none":  # not measured, or too weak to be seen through derivatives
        found = location.output_findings(bench, nominal.theta, starts, places, only, own)
    return tuple(found), tuple(pictures), tuple(rows)


def ranked(search: SearchResult) -> list[Ranked]:
    """Every hypothesis that was refitted, best validation gap first; those with several effects
    name the last one added.
    """
    out, seen = [], set()
    nominal = search.nominal
    for h in sorted([*search.tried, search.chosen], key=lambda h: h.validation.loss):
        key = frozenset(map(str, h.effects))
        if key in seen or not h.effects:
            continue
        seen.add(key)
        last: Candidate = h.effects[-1]
        gap = float(np.sqrt(max(h.validation.loss, 0.0)))
        evidence = worth(h.validation, nominal.validation, inflation(h.validation))
        others = tuple(map(str, h.effects[:-1]))
        beside = f" beside {' and '.join(others)}" if others else ""
        share = closed(nominal.validation.loss, h.validation.loss)
        closes = percent(share) if share else "nothing"
        sentence = f"{last}{beside}: closes {closes} of the gap on validation data"
        out.append(
            Ranked(last.effect, last.location, gap, float(h.bic), float(evidence), sentence, others)
        )
    return out


def traces(
    bench: ProblemBuilder, residual: Residual, nominal: Hypothesis, final: Hypothesis, named
):
    """Measured and simulated series of every split, for the report, simulated as models were
    compared.
    """
    out = []
    hypotheses, labels = [nominal], ["re-tuned"]
    if named:
        hypotheses.append(final)
        labels.append(f"with {' and '.join(map(str, named))}")
    thetas = [h.theta for h in hypotheses]
    for split in ("report", "validation", "fit"):
        if not bench.binding.experiments(split):
            continue
        windows = _by_windows(bench, residual, split, hypotheses)
        if split == "fit":
            starts = np.array([_starts(bench, h) for h in hypotheses])
        else:
            starts = estimate_starts(bench, split, thetas)
        series = windows or free_runs(bench, split, thetas, starts)
        out += make_traces(
            bench.binding, split, dict(zip(labels, series, strict=True)), bool(windows)
        )
    return tuple(out)


def _by_windows(
    bench: ProblemBuilder, residual: Residual, split: str, hypotheses: Sequence[Hypothesis]
) -> list[list[np.ndarray]]:
    """What each hypothesis simulates of the runs of a split, window by window; empty where models
    are compared otherwise, or a run is not covered.
    """
    if not residual.windows:
        return []
    out = []
    for h in hypotheses:
        problem, z = own_simulation(bench, residual, split, h.path.problem, h.path.z)
        series = by_run(problem, z, bench.binding.experiments(split))
        if series is None:
            return []
        out.append(series)
    return out


def notes_of(binding: Binding, fit: Fit, compile_time: float) -> list[str]:
    """What a fit notes beyond its dataset's notes, the friction law, and the time that compiling
    took.
    """
    own = [n for n in fit.notes if n not in binding.dataset.notes]
    smoothing = binding.chain.smoothing_velocity
    law = f"tanh(qd / v) with v = {smoothing:g}" if smoothing else "true sticking"
    if binding.chain.mechanism.integrator:
        law = "soft, as the robot's file has it in MuJoCo"
    said = [f"Coulomb friction: {law}", f"compilation took {number(compile_time)} s"]
    return [*own, *said, *filter(None, [sentence(binding)])]
