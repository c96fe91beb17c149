"""Typical magnitudes of a recording: what joints and inputs do in it, by which bounds, scales and
probes are sized.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.data.dataset import Dataset, Experiment
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter import TypicalMagnitudes
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.force.drive import drive_torque
from jaxid.numerics.export_cache import ExportedFunction, key_of
from jaxid.numerics.kept import shared
from jaxid.numerics.precision import float64
from jaxid.problem import measured_motion
from jaxid.problem.measured_motion import Motion
from jaxid.simulation import sample_buffers as samples


def inertia_torque(
    chain: Chain, q: Float[Array, "n nq"], qdd: Float[Array, "n nq"]
) -> Float[Array, "n nq"]:
    """Torque that accelerations take at rest, at each of n positions."""
    body, still = chain.body(), jnp.zeros(chain.nq)
    return jax.vmap(lambda q, a: body.inverse(q, still, a) - body.inverse(q, still, still))(q, qdd)


def _inertia_program(layout: ParameterVector) -> ExportedFunction:
    """`inertia_torque` by all numbers of a layout, one program for all chains of its structure."""
    form = layout.form

    def program(theta, q, qdd):
        return inertia_torque(form.model(theta), q, qdd)

    return shared(
        "inertia", form, lambda: ExportedFunction(program, key_of(inertia_torque, form.bare))
    )


def typical_magnitudes(
    dataset: Dataset, layout: ParameterVector, theta: np.ndarray, motions: dict[str, Motion]
) -> tuple[list[TypicalMagnitudes], list[TypicalMagnitudes]]:
    """Of each joint, in N m and rad (N, m), and of each input channel, in its own unit, in the
    recordings to fit, or in all where none is.
    """
    fit = dataset.to_fit
    chain = layout.chain
    iu, _ = samples.columns(dataset, chain)
    if not fit:
        joints, size = [_of_responses(dataset)] * chain.nq, [1.0] * len(iu)
    else:
        u = np.concatenate([e.u[:, iu] for e in fit])
        size = [float(np.percentile(np.abs(channel), 99)) for channel in u.T]
        if motions:
            joints = _of_motions(layout, theta, fit, iu, [motions[e.name] for e in fit])
        else:
            joints = _of_inputs(layout, theta, fit, iu)
    joints = _spanned(joints, dataset)
    inputs = []
    for k, s in enumerate(size):
        joint = joints[min(k, chain.nq - 1)]
        inputs.append(joint._replace(torque=max(s, 1e-9)))
    return joints, inputs


def _of_responses(dataset: Dataset) -> TypicalMagnitudes:
    omega = np.concatenate([r.omega for r in dataset.responses])
    slowest, fastest = float(omega.min()), float(omega.max())
    return TypicalMagnitudes(1.0, 1.0, 1.0, 2 * np.pi / slowest, np.pi / fastest)


def _of_inputs(
    layout: ParameterVector, theta: np.ndarray, fit: tuple[Experiment, ...], iu: list[int]
) -> list[TypicalMagnitudes]:
    """Of joints whose motion is not measured."""
    nq = layout.chain.nq
    step = float(np.median(np.diff(fit[0].t)))
    duration = max(float(e.t[-1] - e.t[0]) for e in fit)
    torque = [1.0] * nq
    if iu:
        still = [np.zeros((len(e.t), 2 * nq)) for e in fit]
        torque = [s or 1.0 for s in _largest(_driven(layout, theta, fit, iu, still))]
    return [TypicalMagnitudes(torque[j], 1.0, 1.0, duration, step) for j in range(nq)]


def _of_motions(
    layout: ParameterVector,
    theta: np.ndarray,
    fit: tuple[Experiment, ...],
    iu: list[int],
    used: list[Motion],
) -> list[TypicalMagnitudes]:
    """Of joints whose motion is measured."""
    chain = layout.chain
    inertia = _of_inertia(layout, theta, used)
    driven = np.zeros((0, 0))
    law = getattr(chain.mechanism, "drive_law", None)
    if law is not None:  # what the law asks for says more
        goals = np.concatenate([e.u[:, iu[: chain.nq]] for e in fit])
        inertia = np.maximum(inertia, law.size(goals - np.concatenate([m.q for m in used])))
    elif iu:
        states = [np.concatenate([m.q, m.qd], 1) for m in used]
        driven = _driven(layout, theta, fit, iu, states)
    if driven.size and not chain.direct:
        inertia, driven = np.maximum(inertia, _largest(driven)), np.zeros((0, 0))
    return measured_motion.references(fit, used, driven, inertia)


def _spanned(joints: list[TypicalMagnitudes], dataset: Dataset) -> list[TypicalMagnitudes]:
    """The same with the first and last time of all runs, whatever they are for."""
    runs = dataset.experiments
    if not runs:
        return joints
    begin = min(float(e.t[0]) for e in runs)
    span = max(float(e.t[-1]) for e in runs) - begin
    return [r._replace(begin=begin, span=span) for r in joints]


def _largest(x: np.ndarray) -> np.ndarray:
    """What the columns of a series [samples n] seldom exceed."""
    return np.percentile(np.abs(x), 99, axis=0)


def _of_inertia(layout: ParameterVector, theta: np.ndarray, used: list[Motion]) -> np.ndarray:
    """Torque [nq] that the accelerations of motions seldom exceed."""
    q = np.concatenate([m.q for m in used])
    qdd = np.concatenate([m.qdd for m in used])
    pick = np.linspace(0, len(q) - 1, 2000).astype(int)
    with float64():
        return _largest(np.asarray(_inertia_program(layout)(theta, q[pick], qdd[pick])))


def _driven(
    layout: ParameterVector,
    theta: np.ndarray,
    runs: tuple[Experiment, ...],
    iu: list[int],
    motions: list[np.ndarray],
) -> np.ndarray:
    """Joint torque [samples nq] of the inputs of runs, along motions [time 2 nq]."""
    pairs = zip(runs, motions, strict=True)
    return np.concatenate([drive_torque(layout, theta, e.u[:, iu], motion) for e, motion in pairs])
