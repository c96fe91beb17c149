"""From data to a `Fit`: start values, uncertainty, scores on data that were and were not fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jaxid.data.dataset import Experiment
from jaxid.dynamics.chain import Chain
from jaxid.fitters import descend
from jaxid.fitting.covariance import Covariance, covariance
from jaxid.fitting.ending import ending
from jaxid.fitting.fitter import Minimum
from jaxid.fitting.own_simulation import own_simulation, simulated_scores, SIMULATIONS
from jaxid.fitting.result import EffectEstimate, Estimate, Fit, Score, Trace
from jaxid.fitting.stated import Stated, stated_numbers
from jaxid.problem.binding import Binding
from jaxid.problem.frequency_response import FrequencyResponseError
from jaxid.problem.problem import Problem
from jaxid.problem.residual import InverseDynamics, MultipleShooting, OutputError, Residual, Runs
from jaxid.robots import yardstick
from jaxid.robots.match import is_robot
from jaxid.simulation import sample_buffers as samples


class Begun(NamedTuple):
    """Starts of runs [runs 2 nq], and per run how much its first moments tell about the unknown part of its start (J'J)."""

    starts: np.ndarray
    information: list[np.ndarray]


@dataclass
class Bench:
    """Runs of a binding made ready, one set per split and residual, with the same step. `differences`: where its problems take
    their Jacobians from (see `Problem`).

    `defects` (residual, split) -> what finer steps would add to the simulation, at the samples [samples columns]: taken off the
    targets of its problems, so that a search on coarse steps ends where one on fine steps would.
    """

    binding: Binding
    step: float = samples.STEP
    differences: int = 0
    defects: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)

    def __post_init__(self):
        self._runs: dict[tuple[str, str], Runs] = {}
        self._begun: dict[tuple[str, bytes], Begun] = {}
        self._forgotten = 0.0  # seconds of compiling for runs that were let go
        samples.refuse_endless(self.binding.dataset.experiments, self.step)
        # One shape for all splits, and for the half step that a search may go over to: one program.
        room = min(self.step, samples.STEP / 2)
        self._shape = self._largest({e.name: samples.step_count(e.whole, room) for e in self.binding.dataset.experiments})
        self._rows = self._largest({e.name: len(e.t) for e in self.binding.dataset.experiments})
        if self._shape[1] > samples.LONG:  # compiling once more costs less than the memory of buffers that are mostly empty
            self._shape = self._rows = 0, 0

    def _largest(self, steps: dict[str, int]) -> tuple[int, int]:
        """Steps of the fit runs and a split beside them, and of the longest experiment."""
        fit, *others = (sum(steps[e.name] for e in self.binding.experiments(s)) for s in ("fit", "validation", "report"))
        return fit + max(others), max(steps.values(), default=0)

    def runs(self, residual: Residual, split: str) -> Runs:
        key = (repr(residual), split)
        if key not in self._runs:
            b = self.binding
            experiments = residual.select(b.dataset, split)
            self._runs[key] = residual.runs(
                b.dataset,
                experiments,
                b.layout,
                b.sigma,
                b.motions_of(experiments),
                self.step,
                self._shape_of(residual),
            )
        return self._runs[key]

    def forget_long(self, kept: Residual) -> None:
        """Lets go of the torques of long runs, which only start values were made of, where another residual is fitted."""
        if not isinstance(kept, InverseDynamics):
            gone = [key for key, runs in self._runs.items() if runs.setting is not None and runs.engine.long]
            self._forgotten += sum(self._runs.pop(key).engine.compile_time_s for key in gone)

    def compile_ahead(self, residual: Residual, theta: np.ndarray, free: Sequence[int]) -> None:
        """Begins to compile what a descent of one or two fits needs whose numbers equal theta but in `free`."""
        name = "outputs" if self.differences else "tangents"
        self.runs(residual, "fit").engine.compile_ahead(name, theta, free, few=True)

    def _shape_of(self, residual: Residual) -> tuple[int, int]:
        if isinstance(residual, InverseDynamics):  # at the samples, whatever the step of simulations
            return self._rows
        return (self._shape[0], 0) if isinstance(residual, MultipleShooting) else self._shape

    def problem(
        self,
        residual: Residual,
        split: str,
        free: Sequence[int] | np.ndarray,
        theta: np.ndarray,
        records: Sequence[int] | None = None,
        loss: str = "sum_of_squares",
    ) -> Problem:
        b = self.binding
        runs = self.runs(residual, split)
        priors = b.priors if "fit" in split.split("+") else None  # they count once
        p = Problem(runs, theta, free, b.lower, b.upper, records, loss, b.scale, self.differences, priors)
        defect = self._defect(residual, split)
        return p if defect is None else p.with_targets(runs.targets - defect)

    def _defect(self, residual: Residual, split: str) -> np.ndarray | None:
        parts = [self.defects.get((repr(residual), name)) for name in split.split("+")]
        if len(parts) == 1 or all(part is None for part in parts):
            return parts[0]
        runs = self.runs(residual, split)
        out, numbers = np.zeros_like(runs.targets), iter(runs.records)
        for name, part in zip(split.split("+"), parts, strict=True):
            own = self.runs(residual, name)
            for number in own.records:
                at = runs.record(next(numbers)).samples
                out[at] = 0.0 if part is None else part[own.record(number).samples]
        return out

    def take_off(self, residual: Residual, split: str, defect: np.ndarray) -> None:
        """Sets what finer steps would add."""
        self.defects[repr(residual), split] = defect
        self._begun.clear()

    def begun(self, split: str, thetas: Sequence[np.ndarray]) -> list[Begun]:
        """How the free runs of a split begin with each of several parameter vectors; what was estimated before is kept."""
        new = {theta.tobytes(): theta for theta in thetas if (split, theta.tobytes()) not in self._begun}
        if new:
            self._begun |= {(split, key): b for key, b in zip(new, _begun(self, split, list(new.values())), strict=True)}
        return [self._begun[split, theta.tobytes()] for theta in thetas]

    def compile_time(self) -> float:
        return self._forgotten + sum(r.engine.compile_time_s for r in self._runs.values())


def default_residual(binding: Binding) -> Residual:
    """The free run: it says most about a simulator, and a drift that a wrong law causes is what it is asked to show. A
    dataset of frequency responses alone is compared by them."""
    return OutputError() if binding.dataset.experiments else FrequencyResponseError()


def start_values(bench: Bench, free: Sequence[int], seed: int) -> list[np.ndarray]:
    """Guesses of every number of the model, best first: what inverse dynamics finds, what was stated or is the default."""
    b = bench.binding
    guesses = [b.theta]
    linear = [i for i in free if i not in b.stated] or list(free)
    if b.motions and linear and not b.chain.mechanism.hidden_states:
        quick = InverseDynamics(decimate=1)
        problem = bench.problem(quick, "fit", linear, b.theta)
        path = descend([(problem, problem.z(b.theta))], 15, 1e-8)[0]
        if np.isfinite(path.cost):
            guesses.insert(0, problem.theta(path.z))
            if b.stated & set(free):
                both = bench.problem(quick, "fit", free, b.theta)
                path = descend([(both, both.z(guesses[0]))], 15, 1e-8)[0]
                if np.isfinite(path.cost):
                    guesses.insert(0, both.theta(path.z))
    return guesses


def estimate_starts(bench: Bench, split: str, thetas: Sequence[np.ndarray]) -> np.ndarray:
    """Starts of the free runs of a split that is not fitted, from their first moments only; [thetas runs 2 nq]."""
    return np.array([b.starts for b in bench.begun(split, thetas)])


def _begun(bench: Bench, split: str, thetas: Sequence[np.ndarray]) -> list[Begun]:
    """The start is fitted on the longest of some nested first stretches that the model follows to within twice the noise: with a
    fine encoder a wrong friction law would else bend the start within a tenth of a second.
    """
    runs = bench.runs(OutputError(), split)
    jobs = []
    for theta in thetas:
        for heads in runs.heads:
            for head in heads:
                p = bench.problem(OutputError(), split, [], theta, [head])
                jobs.append((p, p.z(theta)))
    unknown = [k for k, (p, _) in enumerate(jobs) if p.size]
    paths = dict(zip(unknown, descend([jobs[k] for k in unknown], 8, 1e-8), strict=True)) if unknown else {}
    starts = np.zeros((len(thetas), len(runs.heads), jobs[0][0].start0.shape[1]))
    out: list[Begun] = []
    k = 0
    for i in range(len(thetas)):
        out.append(Begun(starts[i], []))
        for j, heads in enumerate(runs.heads):
            own = range(k, k + len(heads))  # longest first
            k += len(heads)
            best = own[-1]
            for n in own:
                if n in paths and 2 * paths[n].cost <= 2 * max(1, paths[n].count - jobs[n][0].size):
                    best = n
                    break
            p, z = jobs[best]
            z = paths[best].z if best in paths else z
            starts[i, j] = p.starts(z)[0]
            hessian = paths[best].hessian if best in paths else None
            out[-1].information.append(np.zeros((p.size, p.size)) if hessian is None else hessian)
    return out


def free_runs(bench: Bench, split: str, thetas: Sequence[np.ndarray], starts: np.ndarray) -> list[list[np.ndarray]]:
    """Free runs of several parameter vectors: per theta and experiment the outputs at the samples [samples ny]."""
    runs = bench.runs(OutputError(), split)
    n = len(runs.records)
    theta = np.repeat(np.array(thetas), n, 0)
    record = np.tile(np.array(runs.records), len(thetas))
    y = runs.engine.outputs(theta, starts.reshape(len(theta), -1), record)
    out = [runs.sample_prediction(r, row) for r, row in zip(record, y, strict=True)]
    return [out[k * n : (k + 1) * n] for k in range(len(thetas))]


def scored(e: Experiment, split: str) -> np.ndarray:
    """Which samples of a run count in its score: those that estimated the start of a run that was not fitted do not."""
    from jaxid.problem.residual import head_samples

    keep = np.ones(len(e.t), bool)
    if split != "fit" and not e.at_rest and e.initial is None:
        keep[: head_samples(e)] = False
    return keep


def scores(bench: Bench, split: str, predictions: Sequence[np.ndarray]) -> dict[str, Score]:
    """rmse, nrmse, relative error per channel of the free runs of a split."""
    b = bench.binding
    out = {}
    _, iy = samples.columns(b.dataset, b.chain)
    for c, (name, unit) in enumerate(b.chain.signature.outputs):
        y, e = [], []
        for experiment, prediction in zip(b.experiments(split), predictions, strict=True):
            keep = scored(experiment, split) & experiment.read[:, iy[c]]
            y.append(experiment.y[keep, iy[c]])
            e.append(prediction[keep, c] - y[-1])
        out[name] = score(np.concatenate(y), np.concatenate(e), unit)
    return out


def score(y: np.ndarray, error: np.ndarray, unit: str) -> Score:
    rmse = float(np.sqrt(np.mean(error**2)))
    return Score(rmse, rmse / max(float(np.std(y)), 1e-300), rmse / max(float(np.sqrt(np.mean(y**2))), 1e-300), unit)


def response_scores(
    bench: Bench, residual: FrequencyResponseError, split: str, problem: Problem, z: np.ndarray
) -> dict[str, Score]:
    """Distance of the modelled from the measured response over the lines of a split, |error| as a root mean square.

    Empty where the records of the split show no line: their inputs hold nothing in the band.
    """
    own = problem if split == "fit" else bench.problem(residual, split, problem.free, problem.theta(z))
    (name, unit), *_ = own.runs.channels
    error, target = [], []
    for number, p in zip(own.records, own.predictions(z if split == "fit" else own.z(problem.theta(z))), strict=True):
        at = own.runs.record(number).samples
        lines = own.runs.weights[at, 0] > 0
        target.append(own.runs.targets[at, 0][lines])
        error.append(p[lines, 0] - target[-1])
    if not sum(map(len, target)):
        return {}
    per_line = 1.0 if residual.magnitude else np.sqrt(2.0)
    return {name: score(per_line * np.concatenate(target), per_line * np.concatenate(error), unit)}


def torque_scores(
    bench: Bench, residual: Residual, split: str, theta: np.ndarray, free: Sequence[int] | np.ndarray
) -> dict[str, Score]:
    """The same for inverse dynamics: filtered torque against what the model needs for the measured motion."""
    problem = bench.problem(residual, split, free, theta)
    runs = problem.runs
    out = {}
    missing = np.concatenate(problem.predictions(problem.z(theta)))
    from jaxid.problem.torque_filter import measured_torque

    drive = measured_torque(bench.binding.dataset, runs, theta)
    for c, (name, unit) in enumerate(runs.channels):
        out[name] = score(drive[:, c], missing[:, c], unit)
    return out


def torque_traces(bench: Bench, residual: Residual, split: str, thetas: dict[str, np.ndarray]) -> list[Trace]:
    """Measured torque of each joint, filtered, and what each of the models (label -> numbers) needs for the measured motion."""
    from jaxid.problem.torque_filter import measured_torque

    runs = bench.runs(residual, split)
    drive = measured_torque(bench.binding.dataset, runs, list(thetas.values())[-1])
    problems = {label: bench.problem(residual, split, [], theta) for label, theta in thetas.items()}
    missing = {label: p.predictions(p.z(thetas[label])) for label, p in problems.items()}
    out, first = [], 0
    for k, number in enumerate(runs.records):
        record = runs.record(number)
        e = runs.experiments[record.experiment]
        own = drive[first : first + len(record.samples)]
        first += len(record.samples)
        for c, (name, unit) in enumerate(runs.channels):
            series = {label: own[:, c] + p[k][:, c] for label, p in missing.items()}
            t = e.t[record.samples - record.first]
            out.append(Trace(e.name, split, name, unit, t, own[:, c], series, float(runs.noise[c])))
    return out


def estimates(binding: Binding, problem: Problem, z: np.ndarray, cov: Covariance) -> dict[int, Estimate]:
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
        out[i] = Estimate(float(theta[i]), std, binding.layout.entries[i].unit, float(binding.lower[i]), float(binding.upper[i]))
    return out


def named_estimates(binding: Binding, found: dict[int, Estimate]) -> tuple[dict[str, Estimate], tuple[EffectEstimate, ...]]:
    """Estimates of the model's own parameters by id, and of added effects by effect and location."""
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
    bench: Bench,
    problem: Problem,
    result: Minimum,
    residual: Residual,
    fitter: str,
    seed: int,
    compile_time: float,
    wall_time: float,
    notes: Sequence[str] = (),
) -> Fit:
    """A `Fit` from a minimum: uncertainty, scores, traces, notes."""
    binding = bench.binding
    theta = problem.theta(result.z)
    notes = [*binding.dataset.notes, f"residual: {problem.runs.statement}", *solver_notes(binding), *notes]
    if result.failed:
        return Fit(
            binding.chain.mechanism.name, (), fitter, residual.name, problem.loss_name, seed, False, True,
            result.stopped_because, result.loss, {}, {}, {}, result.evaluations, wall_time, compile_time,
            binding.dataset.name, binding.dataset.sha256, tuple(notes), history=tuple(result.history), theta=theta,
            solver=solver_name(binding),
        )  # fmt: skip
    cov = getattr(result, "covariance", None) or covariance(problem, result.z)
    found = estimates(binding, problem, result.z, cov)
    own, added = named_estimates(binding, found)
    names = problem.names
    groups = tuple(tuple(names[i] for i in g) for g in cov.groups)
    notes.append(cov.statement)
    notes += [f"{binding.layout.names[i]} ended at its bound ({e.value:.4g} {e.unit})" for i, e in found.items() if e.at_bound]
    notes += binding.said
    notes += [f"noise of {n.text}" for n in binding.noise.values()]

    table: dict[str, dict[str, Score]] = {}
    traces: list[Trace] = []
    free: dict[str, dict[str, Score]] = {}
    windowed: dict[str, Score] = {}
    for split in ("fit", "validation", "report"):
        experiments = residual.select(binding.dataset, split)
        if not experiments:
            continue
        if isinstance(residual, FrequencyResponseError):
            table[split] = response_scores(bench, residual, split, problem, result.z)
            if not table[split]:
                notes.append(f"the {split} data show no line of a frequency response: only their course over time is compared")
        if not binding.experiments(split):
            continue
        if isinstance(residual, InverseDynamics):
            table[split] = torque_scores(bench, residual, split, theta, problem.free)
            continue
        if split == "fit" and not isinstance(residual, MultipleShooting) and len(problem.records) == len(experiments):
            starts = problem.starts(result.z)[None]
        else:
            starts = estimate_starts(bench, split, [theta])
        predictions = free_runs(bench, split, [theta], starts)[0]
        table[split] = {**table.get(split, {}), **scores(bench, split, predictions)}
        if SIMULATIONS.get(residual.name) in ("windows", "closed_loop"):
            inside, z = own_simulation(bench, residual, split, problem, result.z)
            free[split], table[split] = table[split], simulated_scores(inside, z)
            if inside.runs.channels == binding.chain.signature.outputs and len(inside.records) == len(experiments):
                predictions = inside.predictions(z)
        traces += make_traces(binding, split, {"fit": predictions})
        if split == "fit" and isinstance(residual, MultipleShooting):
            windowed = table[split]
    joints: tuple[dict, ...] = ()
    if is_robot(binding.chain.mechanism):
        rows = yardstick.stated(binding, found)
        notes += yardstick.sentences(rows, binding.chain.mechanism.tree.tree)  # type: ignore[attr-defined]
        joints = () if isinstance(residual, InverseDynamics) else yardstick.per_joint(bench, table)
        stated = tuple(Stated(**row) for row in rows)
    else:
        stated = stated_numbers(binding, found)
    end = ending(problem, result, cov, [] if windowed else [t for t in traces if t.split == "fit"])
    return Fit(
        binding.chain.mechanism.name, added, fitter, residual.name, problem.loss_name, seed, end.state == "converged",
        end.state == "failed", end.because, result.loss, own, table, windowed, result.evaluations, wall_time, compile_time,
        binding.dataset.name, binding.dataset.sha256, tuple(notes), groups, tuple(result.history), tuple(traces), theta,
        end.state == "stalled", SIMULATIONS.get(residual.name, "free_run"), free, stated, joints,
        fitted_chain(binding, theta, added), solver_name(binding),
    )  # fmt: skip


def fitted_chain(binding: Binding, theta: np.ndarray, added: Sequence[EffectEstimate]) -> Chain:
    """The model with these numbers, without candidates that were not taken."""
    kept = {e.effect for e in added}
    gone = [e.name for e in binding.chain.effects if e.name not in kept and is_candidate(binding, e.name)]
    return binding.layout.model(theta).without(*gone)


def solver_notes(binding: Binding) -> tuple[str, ...]:
    """What is to be said of a solver that is not jaxid's own stepping."""
    s = binding.layout.solver
    return () if s is None else (f"simulated by {s} (rtol {s.rtol:g}, atol {s.atol:g}), not by jaxid's own stepping",)


def solver_name(binding: Binding) -> str:
    """What simulates the runs of a binding."""
    return "own" if binding.layout.solver is None else str(binding.layout.solver)


def make_traces(binding: Binding, split: str, predictions: dict[str, Sequence[np.ndarray]]) -> list[Trace]:
    """Traces of a split, one per experiment and channel; `predictions` label -> outputs per experiment."""
    out = []
    _, iy = samples.columns(binding.dataset, binding.chain)
    for k, e in enumerate(binding.experiments(split)):
        for c, (name, unit) in enumerate(binding.chain.signature.outputs):
            series = {label: p[k][:, c] for label, p in predictions.items()}
            out.append(Trace(e.name, split, name, unit, e.t, e.y[:, iy[c]], series, float(binding.sigma[c])))
    return out
