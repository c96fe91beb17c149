"""The motion that was measured, as what a simulation follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.data.dataset import Dataset, Experiment
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter import TypicalMagnitudes
from jaxid.simulation.sample_buffers import columns


@dataclass(frozen=True)
class Motion:
    """Smoothed measured motion of one run at its samples, for references, start states and inverse
    dynamics.
    """

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    statement: str


def motion(dataset: Dataset, experiment: Experiment, chain: Chain, noise: np.ndarray) -> Motion:
    """Smoothed joint motion of a run in which every joint is read; the cutoff lies where the
    content of a reading ends.
    """
    from jaxid.dynamics.joint_readings import cutoffs, joint_motion, stated_positions

    _, iy = columns(dataset, chain)
    rms = experiment.noise_rms(noise, iy)
    t, y = experiment.t, experiment.motion()[:, iy]
    return Motion(
        *joint_motion(
            chain, t, y, cutoffs(chain, t, y, rms), stated_positions(experiment, chain.signature)
        )
    )


def references(
    experiments: Sequence[Experiment],
    motions: Sequence[Motion],
    driven: np.ndarray,
    inertia_torque: np.ndarray,
) -> list[TypicalMagnitudes]:
    """Typical magnitudes per joint, of a drive with torques `driven` [samples nq]; where that has
    no columns, or does nothing, the torque that moves the inertia stands in for it.
    """
    out = []
    nq = motions[0].q.shape[1]
    for j in range(nq):
        qd = np.concatenate([m.qd[:, j] for m in motions])
        q = np.concatenate([m.q[:, j] for m in motions])
        torque = 0.0
        if j < driven.shape[1]:
            torque = float(np.percentile(np.abs(driven[:, j]), 99))
        if torque <= 0:
            torque = float(inertia_torque[j])
        duration = max(float(e.t[-1] - e.t[0]) for e in experiments)
        step = float(np.median(np.concatenate([np.diff(e.t) for e in experiments])))
        tiny = 1e-9
        out.append(
            TypicalMagnitudes(
                max(torque, tiny),
                max(float(np.percentile(np.abs(qd), 99)), tiny),
                max(float(np.ptp(q)), tiny),
                duration,
                step,
            )
        )
    return out
