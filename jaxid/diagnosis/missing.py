"""The force that the model lacks along the measured motion, and what noise alone would show of it.

m(t) = drive - (M qdd + bias + friction) along the smoothed measured motion. Derivatives of a noisy
position make such a residual even for a perfect model, so it stands beside the same figure of
simulated data: the model's own free run with the sensors' noise, and what repeats of the run differ
by, added, through the same filters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.data.dataset import Experiment
from jaxid.data.repeats import repeats, together
from jaxid.dynamics.joint_readings import joint_motion, stated_positions
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.scores import free_runs
from jaxid.force.drive import drive_torque
from jaxid.problem.binding import Binding
from jaxid.problem.measured_motion import Motion
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import InverseDynamics, Runs
from jaxid.simulation import sample_buffers as samples


#: Simulated repetitions for the null of every regime.
NULLS = 12


@dataclass
class Missing:
    """Missing force of one run: [time nq], and [draws time nq] of what a perfect model would
    show.
    """

    experiment: Experiment
    keep: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    load: np.ndarray
    force: np.ndarray
    null: np.ndarray


def missing_forces(
    bench: ProblemBuilder, theta: np.ndarray, starts: np.ndarray, seed: int, draws: int = NULLS
) -> list[Missing]:
    """Missing force on the fit runs at `theta`; empty where the model does not measure its
    joints.
    """
    b = bench.binding
    if not b.motions or b.chain.mechanism.hidden_states:
        return []
    residual = InverseDynamics(decimate=1)
    runs = bench.runs(residual, "fit")
    experiments = b.experiments("fit")
    _, iy = samples.columns(b.dataset, b.chain)
    problem = bench.problem(residual, "fit", [], theta)
    rng = np.random.default_rng(seed)
    nulls: list[list[np.ndarray]] = [[] for _ in experiments]
    simulated = free_runs(bench, "fit", [theta], starts[None])[0]
    apart, white = what_repeats_differ_by(b), np.where(_repeated(b), b.readings, b.sigma)
    # Readings that are left out have no noise: the motion goes on between their neighbours.
    noise = [np.where(e.read[:, iy], e.noise(white, iy), 0.0) for e in experiments]
    still = [
        _rate_of(runs, e, n * rng.standard_normal(n.shape))
        for e, n in zip(experiments, noise, strict=True)
    ]
    force = _lacking(problem, theta, still)
    for _ in range(draws):
        motion = []
        for e, n, y in zip(experiments, noise, simulated, strict=True):
            noisy = y + n * rng.standard_normal(y.shape)
            if others := apart.get(e.name):
                chosen = rng.choice((-1.0, 1.0)) * others[rng.integers(len(others))]
                noisy[: len(chosen)] += chosen
            motion.append(filtered(runs, e, noisy))
        for k, f in enumerate(_lacking(problem, theta, still, motion)):
            nulls[k].append(f)
    out = []
    for k, e in enumerate(experiments):
        m = b.motions[e.name]
        record = runs.record(runs.records[k])
        keep = np.zeros(len(e.t), bool)
        keep[np.searchsorted(_positions(runs, k), record.samples)] = True
        load = joint_load(b, e, m)
        out.append(
            Missing(
                experiment=e,
                keep=keep,
                q=m.q[keep],
                qd=m.qd[keep],
                qdd=m.qdd[keep],
                load=load[keep],
                force=force[k],
                null=np.array(nulls[k]),
            )
        )
    return out


def joint_load(binding: Binding, e: Experiment, m: Motion) -> np.ndarray:
    """Joint torque [time nq] that was recorded along a motion; nothing where the inputs are no
    torques.
    """
    chain = binding.chain
    iu, _ = samples.columns(binding.dataset, chain)
    if not chain.direct or not len(iu):
        return np.zeros((len(e.t), chain.nq))
    motion = np.concatenate([m.q, m.qd], 1)
    return drive_torque(binding.layout, binding.theta, e.u[:, iu], motion)


def what_repeats_differ_by(binding: Binding) -> dict[str, list[np.ndarray]]:
    """Run -> by how much it and each of its repeats is off their mean [time ny], as far as they all
    go, beyond what the sensors' noise makes of that: a motion that no model foresees, of as much
    variance as one more repeat would have.
    """
    _, iy = samples.columns(binding.dataset, binding.chain)
    of_machine = np.sqrt(
        np.where(
            _repeated(binding), np.maximum(0.0, 1 - (binding.readings / binding.sigma) ** 2), 0.0
        )
    )
    out: dict[str, list[np.ndarray]] = {}
    for group in repeats(binding.dataset.seen):
        motions = together(group)[..., iy]
        apart = (motions - motions.mean(0)) * np.sqrt(len(group) / (len(group) - 1)) * of_machine
        out |= {e.name: list(apart) for e in group}
    return out


def _repeated(binding: Binding) -> np.ndarray:
    """Outputs [ny] whose noise is what repeats differ by."""
    return np.array(
        [
            binding.noise[name].source == "repeatability"
            for name, _ in binding.chain.signature.outputs
        ]
    )


def _positions(runs, k: int) -> np.ndarray:
    record = runs.record(runs.records[k])
    return np.arange(record.first, record.last + 1)


def filtered(runs: Runs, e: Experiment, y: np.ndarray) -> np.ndarray:
    """Joints, their velocities and accelerations [time 3 nq] of simulated outputs y [time ny],
    through the filter of the measured motion.
    """
    assert runs.setting is not None
    chain = runs.layout.chain
    start = stated_positions(e, chain.signature)
    return np.concatenate(
        joint_motion(chain, e.t, y, [runs.setting.cutoff_hz] * chain.nq, start)[:3], 1
    )


def _rate_of(runs: Runs, e: Experiment, noise: np.ndarray) -> np.ndarray:
    """Speed [nq] that noise of the readings [time ny] alone seldom shows: three of its standard
    deviations.
    """
    nq = runs.layout.chain.nq
    return 3 * np.sqrt(np.mean(filtered(runs, e, noise)[:, nq : 2 * nq] ** 2, 0))


def _lacking(
    problem: FitProblem,
    theta: np.ndarray,
    still: Sequence[np.ndarray],
    motion: Sequence[np.ndarray] | None = None,
) -> list[np.ndarray]:
    """The missing force [time nq] at the kept samples of each run. A joint slower than `still` [nq]
    may be held by its friction with any force between those of its two directions: what lies
    between is not missing.
    """
    records = [problem.runs.record(number) for number in problem.records]
    nq = problem.runs.layout.chain.nq
    if motion is None:
        motion = [np.asarray(problem.runs.engine.samples.x[r.first : r.last + 1]) for r in records]
    plain = [-p for p in torque_along(problem, theta, motion)]
    slow = [np.abs(m[:, nq : 2 * nq]) <= s for m, s in zip(motion, still, strict=True)]
    if not any(x.any() for x in slow):
        return plain

    def turned(way: int) -> list[np.ndarray]:
        rates = [
            np.where(x, way * s, m[:, nq : 2 * nq])
            for m, x, s in zip(motion, slow, still, strict=True)
        ]
        whole = [
            np.concatenate([m[:, :nq], v, m[:, 2 * nq :]], 1)
            for m, v in zip(motion, rates, strict=True)
        ]
        return [-p for p in torque_along(problem, theta, whole)]

    out = []
    for r, f, x, a, b in zip(records, plain, slow, turned(1), turned(-1), strict=True):
        held = np.where(a * b <= 0, 0.0, np.where(np.abs(a) < np.abs(b), a, b))
        out.append(np.where(x[r.samples - r.first], held, f))
    return out


def torque_along(
    problem: FitProblem, theta: np.ndarray, motion: Sequence[np.ndarray] | None = None
) -> list[np.ndarray]:
    """Minus the missing force at the kept samples of each run; `motion` [time 3 nq] per run
    replaces the measured one.
    """
    import jax.numpy as jnp

    from jaxid.numerics.precision import float64

    engine = problem.runs.engine
    kept = engine.samples
    if motion is not None:
        x = np.array(kept.x)
        for number, m in zip(problem.records, motion, strict=True):
            r = problem.runs.record(number)
            x[r.first : r.last + 1] = m
        with float64():
            engine.samples = kept._replace(x=jnp.asarray(x))
    try:
        return problem.predictions(problem.z(theta))
    finally:
        engine.samples = kept
