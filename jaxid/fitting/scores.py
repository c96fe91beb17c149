"""Errors of a model on data that were and were not fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from jaxid.base.wording import listed, times
from jaxid.data.dataset import Experiment
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.result import Score, Trace
from jaxid.problem.binding import Binding
from jaxid.problem.frequency_response import FrequencyResponseError
from jaxid.problem.momentum import of_the_joints
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import OutputError, Residual
from jaxid.simulation import sample_buffers as samples


def free_runs(
    bench: ProblemBuilder, split: str, thetas: Sequence[np.ndarray], starts: np.ndarray
) -> list[list[np.ndarray]]:
    """Free runs of several parameter vectors: per theta and experiment the outputs at the samples
    [samples ny], with what the bench takes off its targets.
    """
    runs = bench.runs(OutputError(), split)
    n = len(runs.records)
    theta = np.repeat(np.array(thetas), n, 0)
    record = np.tile(np.array(runs.records), len(thetas))
    y = runs.engine.outputs(theta, starts.reshape(len(theta), -1), record)
    out = [runs.sample_prediction(r, row) for r, row in zip(record, y, strict=True)]
    if (more := bench.defect(OutputError(), split)) is not None:
        out = [x + more[runs.record(r).samples] for r, x in zip(record, out, strict=True)]
    return [out[k * n : (k + 1) * n] for k in range(len(thetas))]


def scored(e: Experiment, split: str) -> np.ndarray:
    """Which samples of a run count in its score: those that estimated the start of a run that was
    not fitted do not.
    """
    from jaxid.problem.beginnings import head_samples

    keep = np.ones(len(e.t), bool)
    if split != "fit" and not e.at_rest and e.initial is None:
        keep[: head_samples(e)] = False
    return keep


def scores(
    bench: ProblemBuilder, split: str, predictions: Sequence[np.ndarray]
) -> dict[str, Score]:
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
    return Score(
        rmse,
        rmse / max(float(np.std(y)), 1e-300),
        rmse / max(float(np.sqrt(np.mean(y**2))), 1e-300),
        unit,
    )


#: On data that were not fitted a channel is lost where its error is more than its own standard
#: deviation, this many times its noise, and this many times what it is on those that were.
LOST, ABOVE_NOISE, ABOVE_FIT = 1.0, 3.0, 3.0


def lost(table: Mapping[str, Mapping[str, Score]], noise: Mapping[str, float]) -> tuple[str, ...]:
    """A sentence where the numbers of a fit predict data that were not fitted worse than a constant
    would; `noise` by channel.
    """
    fit: Mapping[str, Score] = table.get("fit", {})
    found: dict[str, tuple[float, str]] = {}
    for split in ("validation", "report"):
        for name, s in table.get(split, {}).items():
            seen = not s.nrmse <= LOST and not s.rmse <= ABOVE_NOISE * noise.get(name, 0.0)
            if seen and name in fit and not s.nrmse <= ABOVE_FIT * fit[name].nrmse:
                found.setdefault(name, (s.nrmse, split))
    if not found:
        return ()
    worst = sorted(found, key=lambda name: -np.nan_to_num(found[name][0], nan=np.inf))
    said = [
        f"{name} is off by {times(found[name][0])} times its standard deviation ({found[name][1]})"
        for name in worst[:2]
    ]
    more = [f"{len(worst) - 2} more channels too"] if len(worst) > 2 else []
    return (f"worse than no model on data that were not fitted: {listed([*said, *more])}",)


def response_scores(
    bench: ProblemBuilder,
    residual: FrequencyResponseError,
    split: str,
    problem: FitProblem,
    z: np.ndarray,
) -> dict[str, Score]:
    """Distance of the modelled from the measured response over the lines of a split, |error| as a
    root mean square.

    Empty where the records of the split show no line: their inputs hold nothing in the band.
    """
    own = (
        problem
        if split == "fit"
        else bench.problem(residual, split, problem.free, problem.theta(z))
    )
    (name, unit), *_ = own.runs.channels
    error, target = [], []
    for number, p in zip(
        own.records, own.predictions(z if split == "fit" else own.z(problem.theta(z))), strict=True
    ):
        at = own.runs.record(number).samples
        lines = own.runs.weights[at, 0] > 0
        target.append(own.runs.targets[at, 0][lines])
        error.append(p[lines, 0] - target[-1])
    if not sum(map(len, target)):
        return {}
    per_line = 1.0 if residual.magnitude else np.sqrt(2.0)
    return {name: score(per_line * np.concatenate(target), per_line * np.concatenate(error), unit)}


def torque_scores(
    bench: ProblemBuilder,
    residual: Residual,
    split: str,
    theta: np.ndarray,
    free: Sequence[int] | np.ndarray,
) -> dict[str, Score]:
    """The same for inverse dynamics: filtered torque against what the model needs for the measured
    motion. Of momentum: what is left of it, beside what the joints alone carry.
    """
    problem = bench.problem(residual, split, free, theta)
    runs = problem.runs
    out = {}
    missing = np.concatenate(problem.predictions(problem.z(theta)))
    if residual.momenta:
        drive = of_the_joints(problem, theta)
    else:
        from jaxid.force.torque_filter import measured_torque

        drive = measured_torque(bench.binding.dataset, runs, theta)
    for c, (name, unit) in enumerate(runs.channels):
        out[name] = score(drive[:, c], missing[:, c], unit)
    return out


def make_traces(
    binding: Binding,
    split: str,
    predictions: dict[str, Sequence[np.ndarray]],
    windows: bool = False,
) -> list[Trace]:
    """Traces of a split, one per experiment and channel; `predictions` label -> outputs per
    experiment, of `windows` or of whole runs.
    """
    out = []
    _, iy = samples.columns(binding.dataset, binding.chain)
    for k, e in enumerate(binding.experiments(split)):
        for c, (name, unit) in enumerate(binding.chain.signature.outputs):
            series = {label: p[k][:, c] for label, p in predictions.items()}
            out.append(
                Trace(
                    experiment=e.name,
                    split=split,
                    channel=name,
                    unit=unit,
                    t=e.t,
                    measured=e.y[:, iy[c]],
                    simulated=series,
                    noise=float(binding.sigma[c]),
                    windows=windows,
                )
            )
    return out
