"""From a minimum to a `Fit`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxid.base.wording import unit_after
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.model_file import sha256_of
from jaxid.fitting import result as results
from jaxid.fitting.covariance import covariance, CovarianceEstimate, without_priors
from jaxid.fitting.ending import ending
from jaxid.fitting.fitter import Minimum
from jaxid.fitting.own_simulation import by_run, own_simulation, simulated_scores
from jaxid.fitting.per_joint import per_joint
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.fitting.result import EffectEstimate, Estimate, Fit, Score, Trace
from jaxid.fitting.reweighting import weighed_by
from jaxid.fitting.same_speed import said_as_one
from jaxid.fitting.scores import (
    free_runs,
    lost,
    make_traces,
    response_scores,
    scores,
    torque_scores,
)
from jaxid.fitting.stated import stated_or_of_the_file, StatedNumber
from jaxid.fitting.step_shift import with_steps
from jaxid.problem.binding import Binding
from jaxid.problem.frequency_response import FrequencyResponseError
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import Residual
from jaxid.problem.solver import solver_name, solver_notes
from jaxid.robots import yardstick
from jaxid.robots.match import is_robot
from jaxid.robots.origin import origin


def estimates(
    binding: Binding, problem: FitProblem, z: np.ndarray, cov: CovarianceEstimate
) -> dict[int, Estimate]:
    """Layout position -> estimate of each fitted number, and of those that the recording tells."""
    theta, slope = problem.theta(z), problem.dtheta(z)
    out = {}
    for k, i in enumerate(problem.free):
        std = cov.std[k] * slope[k]
        out[int(i)] = Estimate(
            float(theta[i]),
            float(std) if np.isfinite(std) else None,
            binding.layout.entries[i].unit,
            float(binding.lower[i]),
            float(binding.upper[i]),
            bool(cov.at_bound[k]),
            bool(cov.identifiable[k]),
        )
    for i, std in binding.read.items():
        out[i] = Estimate(
            float(theta[i]),
            std,
            binding.layout.entries[i].unit,
            float(binding.lower[i]),
            float(binding.upper[i]),
        )
    return out


def named_estimates(
    binding: Binding, found: dict[int, Estimate]
) -> tuple[dict[str, Estimate], tuple[EffectEstimate, ...]]:
    """Estimates of the model's own parameters by id, and of added effects by effect and
    location.
    """
    builtin = {kind.name for kind, _ in binding.chain.mechanism.builtin}
    own: dict[str, Estimate] = {}
    added: dict[tuple[str, str], dict[str, Estimate]] = {}
    for i, estimate in found.items():
        e = binding.layout.entries[i]
        effect = None if e.owner < 0 else binding.chain.effects[e.owner].name
        if effect is None or effect in builtin:
            own[e.name] = estimate
        if effect is not None and (effect not in builtin or is_candidate(binding, effect)):
            added.setdefault((effect, e.location), {})[e.field] = estimate
    return own, tuple(EffectEstimate(e, where, p) for (e, where), p in added.items())


def is_candidate(binding: Binding, effect: str) -> bool:
    """Whether an effect is not part of the nominal model but was put into the chain afterwards."""
    entries = binding.layout.of_effect(effect)
    return not any(i in binding.nominal for i in entries)


def assemble(
    bench: ProblemBuilder,
    problem: FitProblem,
    result: Minimum,
    residual: Residual,
    fitter: str,
    seed: int,
    compile_time: float,
    wall_time: float,
    notes: Sequence[str] = (),
    known: CovarianceEstimate | None = None,
) -> Fit:
    """A `Fit` from a minimum: uncertainty (`known`, where it was worked out before), scores,
    traces, notes.
    """
    binding = bench.binding
    theta = problem.theta(result.z)
    notes = [
        *binding.dataset.notes,
        f"residual: {problem.runs.statement}",
        *solver_notes(binding),
        *notes,
    ]
    common: dict[str, Any] = {
        "model": binding.chain.mechanism.name,
        "fitter": fitter,
        "residual": residual.name,
        "loss_name": problem.loss_name,
        "seed": seed,
        "evaluations": result.evaluations,
        "wall_time_s": wall_time,
        "compile_time_s": compile_time,
        "dataset": binding.dataset.name,
        "dataset_sha256": binding.dataset.sha256,
        "history": tuple(result.history),
        "theta": theta,
        "solver": solver_name(binding),
        "model_sha256": sha256_of(binding.chain.mechanism),
    }
    if result.failed:
        return Fit(
            **common,
            effects=(),
            converged=False,
            failed=True,
            stopped_because=result.stopped_because,
            loss=result.loss,
            parameters={},
            scores={},
            windowed={},
            notes=tuple(notes),
        )
    cov = known or getattr(result, "covariance", None)
    if cov is None or binding.inflation > 1:  # a search takes strengthened priors at their word
        cov = covariance(problem, result.z, binding.inflation)
    cov = _with_steps(bench, problem, residual, result.z, cov)
    found = estimates(binding, problem, result.z, cov)
    own, added = named_estimates(binding, found)
    told = numbers_covariance(binding, problem, result.z, cov)
    names = np.array(problem.names, object)
    groups = [tuple(names[list(group)]) for group in cov.groups]
    notes += _of_numbers(binding, found, cov)
    compared = _Compared()
    for split in ("fit", "validation", "report"):
        compared.add(split, bench, problem, result.z, residual)
    table = compared.table
    notes += compared.notes
    stated = _stated(bench, problem, result.z, cov)
    joints: tuple[dict, ...] = ()
    if is_robot(binding.chain.mechanism):
        notes += yardstick.sentences([s.to_dict() for s in stated])
        if residual.simulation != "momentum":
            joints = per_joint(bench, table, residual if residual.torques else None, problem.free)
    channels = dict(problem.runs.channels)
    noise = dict(zip(channels, map(float, problem.runs.noise), strict=False))
    astray = lost(table, noise)
    notes[:0] = astray
    loss, reweighted = result.loss, None
    if problem.weights is not problem.runs.weights:
        plain = weighed_by(problem, np.ones(len(problem.runs.noise)))
        loss, reweighted = plain.loss(result.z), result.loss
    traces = [] if compared.windowed else [t for t in compared.traces if t.split == "fit"]
    end = ending(problem, result, cov, traces)
    if astray and end.state == "converged":  # a minimum of these data, and no model of the machine
        end = end._replace(state="stalled", because=astray[0])
    return Fit(
        **common,
        effects=added,
        converged=end.state == "converged",
        failed=end.state == "failed",
        stopped_because=end.because,
        loss=loss,
        parameters=own,
        scores=table,
        windowed=compared.windowed,
        notes=tuple(notes),
        correlated=tuple(groups),
        traces=tuple(compared.traces),
        stalled=end.state == "stalled",
        simulation=residual.simulation,
        free_run=compared.free,
        stated=stated,
        per_joint=joints,
        chain=fitted_chain(binding, theta, added),
        robot=origin_of(binding, added),
        covariance=told,
        reweighted_loss=reweighted,
    )


def _of_numbers(
    binding: Binding, found: Mapping[int, Estimate], cov: CovarianceEstimate
) -> list[str]:
    """What a fit notes of its numbers, and of the noise that it counts in."""
    notes = [cov.statement]
    for i, e in found.items():
        if e.at_bound:
            name = binding.layout.names[i]
            notes.append(f"{name} ended at its bound ({e.value:.4g}{unit_after(e.unit)})")
    return [*notes, *binding.said, *(f"noise of {n.text}" for n in binding.noise.values())]


def _with_steps(
    bench: ProblemBuilder,
    problem: FitProblem,
    residual: Residual,
    z: np.ndarray,
    cov: CovarianceEstimate,
) -> CovarianceEstimate:
    """The covariance with what steps of the file's simulator do, where it would refute a number."""
    if bench.binding.chain.mechanism.own_step is None:
        return cov
    if not any(s.refuted for s in _stated(bench, problem, z, cov)):
        return cov
    return with_steps(bench, problem, residual, z, cov)


def _stated(
    bench: ProblemBuilder, problem: FitProblem, z: np.ndarray, cov: CovarianceEstimate
) -> tuple[StatedNumber, ...]:
    """The numbers that are stated elsewhere, judged by what the data alone tell."""
    judging = without_priors(cov)
    found = estimates(bench.binding, problem, z, judging)
    told = numbers_covariance(bench.binding, problem, z, judging)
    rows = stated_or_of_the_file(bench.binding, found, told)
    if not is_robot(bench.binding.chain.mechanism):
        return rows
    return said_as_one(bench, problem.theta(z), rows)


@dataclass
class _Compared:
    """A fitted model beside the runs: `table` of scores by split and channel, those of `free` runs
    and of windows where they are other ones, and what was simulated.
    """

    table: dict[str, dict[str, Score]] = field(default_factory=dict)
    free: dict[str, dict[str, Score]] = field(default_factory=dict)
    windowed: dict[str, Score] = field(default_factory=dict)
    traces: list[Trace] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(
        self,
        split: str,
        bench: ProblemBuilder,
        problem: FitProblem,
        z: np.ndarray,
        residual: Residual,
    ) -> None:
        """Compares the runs of a split, if it has any."""
        binding = bench.binding
        experiments = residual.select(binding.dataset, split)
        if not experiments:
            return
        if isinstance(residual, FrequencyResponseError):
            self.table[split] = response_scores(bench, residual, split, problem, z)
            if not self.table[split]:
                self.notes.append(
                    f"the {split} data show no line of a frequency response: only their course over"
                    " time is compared"
                )
        if not binding.experiments(split):
            return
        theta = problem.theta(z)
        if residual.torques:
            self.table[split] = torque_scores(bench, residual, split, theta, problem.free)
            return
        if split == "fit" and not residual.windows and len(problem.records) == len(experiments):
            starts = problem.starts(z)[None]
        else:
            starts = estimate_starts(bench, split, [theta])
        predictions, covered = free_runs(bench, split, [theta], starts)[0], None
        self.table[split] = {**self.table.get(split, {}), **scores(bench, split, predictions)}
        if residual.simulation in ("windows", "closed_loop"):
            inside, own_z = own_simulation(bench, residual, split, problem, z)
            self.free[split] = self.table[split]
            self.table[split] = simulated_scores(inside, own_z)
            if inside.runs.channels == binding.chain.signature.outputs:
                covered = by_run(inside, own_z, experiments)
                predictions = covered or predictions
        windows = bool(covered) and residual.windows
        self.traces += make_traces(binding, split, {"fit": predictions}, windows)
        if split == "fit" and residual.windows:
            self.windowed = self.table[split]


def origin_of(binding: Binding, added: Sequence[EffectEstimate]) -> dict:
    """Where a robot comes from, and which of its own laws the model leaves out; nothing for another
    model.
    """
    mechanism = binding.chain.mechanism
    if not is_robot(mechanism):
        return {}
    present = {e.name for e in binding.chain.effects if not is_candidate(binding, e.name)}
    present |= {e.effect for e in added}
    without = [kind.name for kind, _ in mechanism.builtin if kind.name not in present]
    return origin(mechanism, binding.dataset.stated.geometry) | {"without": without}


def numbers_covariance(
    binding: Binding, problem: FitProblem, z: np.ndarray, cov: CovarianceEstimate
) -> results.Covariance:
    """That of the fitted numbers themselves, of which some are searched by their logarithm."""
    n, slope = len(problem.free), problem.dtheta(z)
    names = tuple(binding.layout.names[i] for i in problem.free)
    return results.Covariance(names, cov.matrix[:n, :n] * slope * slope[:, None])


def fitted_chain(binding: Binding, theta: np.ndarray, added: Sequence[EffectEstimate]) -> Chain:
    """The model with these numbers, without candidates that were not taken."""
    kept = {e.effect for e in added}
    gone = [
        e.name
        for e in binding.chain.effects
        if e.name not in kept and is_candidate(binding, e.name)
    ]
    return binding.layout.model(theta).without(*gone)
