"""Where a fit of an added effect begins: at its neutral value many effects have no derivative."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.dynamics.effect import Effect
from jaxid.dynamics.parameter import resolve
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.binding import Binding
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import InverseDynamics


def probes(binding: Binding, effect: Effect, place: str, theta: np.ndarray) -> list[np.ndarray]:
    """Parameter vectors with an effect switched on at one place, at each of its probe strengths."""
    b = binding
    reference = b.reference(effect, b.chain.places(effect).index(place))
    out = []
    for probe in effect.probes:
        new = theta.copy()
        for i in b.layout.of_effect(effect.name, place):
            field = b.layout.entries[i].field
            if field in probe:
                new[i] = np.clip(resolve(probe[field], reference), b.lower[i], b.upper[i])
        out.append(new)
    return out


def read_off(
    binding: Binding, p: FitProblem, z: np.ndarray, effect: Effect, place: str
) -> list[np.ndarray]:
    """Parameter vectors with an effect as the missing force of a problem of torques shows it; none
    where it is not read off.
    """
    b, read = binding, getattr(effect, "read_off", None)
    if read is None:
        return []
    joint, parts = b.chain.places(effect).index(place), []
    for number, missing in zip(p.records, p.predictions(z), strict=True):
        record = p.runs.record(number)
        e = p.runs.experiments[record.experiment]
        at = record.samples - record.first
        parts.append(
            np.stack(
                [
                    b.motions[e.name].q[at, joint],
                    b.motions[e.name].qd[at, joint],
                    -missing[:, joint],
                ]
            )
        )
    theta = p.theta(z)
    for name, value in read(*np.concatenate(parts, 1)).items():
        i = next(
            k for k in b.layout.of_effect(effect.name, place) if b.layout.entries[k].field == name
        )
        theta[i] = np.clip(value, b.lower[i], b.upper[i])
    return [theta]


def probe_starts(
    bench: ProblemBuilder, problem: FitProblem, theta: np.ndarray, keep: int = 4
) -> list[np.ndarray]:
    """Starts for added effects: the best of their probes, and what the torque residual makes of
    them all (free of the free run's local minima). At the neutral value many effects have no
    derivative.
    """
    b, added, found = bench.binding, [], []
    for effect in b.chain.effects:
        for place in b.chain.places(effect):
            index = b.layout.of_effect(effect.name, place)
            if set(index) & set(problem.free) and not set(index) & b.nominal:
                added.append((effect, place))
                found += probes(b, effect, place, theta)
    if not found:
        return []
    best = _best_probes(problem, theta, found)[:keep]
    if not b.motions or b.chain.mechanism.hidden_states or not b.dataset.split("fit"):
        return best
    torque = bench.problem(InverseDynamics(decimate=1), "fit", problem.free, theta)
    if any(getattr(effect, "read_off", None) for effect, _ in added):
        own = [i for i in problem.free if i in b.nominal]
        without = bench.problem(InverseDynamics(decimate=1), "fit", own, theta)
        z = levenberg_marquardt([(without, without.z(theta))], 15, 1e-7)[0].z
        for effect, place in added:
            found += read_off(b, without, z, effect, place)
    paths = levenberg_marquardt([(torque, torque.z(f)) for f in found], 15, 1e-7)
    paths.sort(key=lambda path: path.cost)
    return best + [torque.theta(p.z) for p in paths[:2] if np.isfinite(p.cost)]


def _best_probes(
    problem: FitProblem, theta: np.ndarray, found: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Those of the vectors that simulate the data at all, best first."""
    records = problem.records
    starts = problem.starts(problem.z(theta))
    y = problem.runs.engine.outputs(
        np.repeat(np.array(found), len(records), 0),
        np.tile(starts, (len(found), 1)),
        np.tile(np.array(records), len(found)),
    )
    cost = np.zeros((len(found), len(records)))
    with np.errstate(all="ignore"):
        for k, record in enumerate(records * len(found)):
            cost.flat[k] = np.sum(problem.runs.residual(record, y[k]) ** 2)
        total = np.nan_to_num(cost.sum(1), nan=np.inf)
    order = np.argsort(total, kind="stable")
    return [found[k] for k in order if np.isfinite(total[k])]
