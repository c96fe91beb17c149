"""Recordings as rows of the torque equation: motion on an even grid, everything through one
low-pass, then decimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.data.dataset import Experiment
from jaxid.data.signals import filter_ends, zero_phase
from jaxid.dynamics.joint_readings import joint_motion, joint_readings, stated_positions
from jaxid.force.motion import moving, refuse_cutoff, rows_every
from jaxid.force.torque_filter import check_motion, evenly, moving_band
from jaxid.problem.binding import Binding
from jaxid.simulation.sample_buffers import bucket, columns


#: Positions are smoothed at this many times the cutoff of the torque before they are
#: differentiated.
MOTION = 2.0
#: Where a joint turns about, its dry friction counts as going over smoothly within this share of
#: its top speed.
TURN = 0.005


@dataclass(frozen=True, eq=False)
class TorqueRun:
    """One recording: motion and inputs at all samples of an even grid, and which samples become
    rows.
    """

    experiment: Experiment
    q: np.ndarray  # [time n]
    qd: np.ndarray
    qdd: np.ndarray
    u: np.ndarray  # [time nu]
    kept: slice
    cutoff_hz: float
    moves: np.ndarray  # [n] whether a joint does anything in this run
    room: int  # samples of the longest run, rounded up: what is compiled is compiled once

    def padded(self, x: np.ndarray) -> np.ndarray:
        """A series [time ...] with its last sample repeated up to `room`."""
        return np.pad(x, ((0, self.room - len(x)), *((0, 0),) * (x.ndim - 1)), mode="edge")

    @property
    def split(self) -> str:
        return self.experiment.split

    @property
    def t(self) -> np.ndarray:
        """Times of the rows."""
        return self.experiment.t[self.kept]

    @property
    def step(self) -> float:
        """Seconds from one sample of the grid to the next."""
        t = self.experiment.t
        return float(t[-1] - t[0]) / (len(t) - 1)

    def still(self, turn: np.ndarray) -> np.ndarray:
        """1 where a joint stands still or turns about [time n], to within what the filter of the
        motion resolves, else 0.
        """
        from scipy.ndimage import maximum_filter1d

        slow = np.abs(self.qd) < turn
        slow[1:] |= np.diff(np.sign(self.qd), axis=0) != 0
        width = max(1, round(0.5 / (MOTION * self.cutoff_hz * self.step)))
        return maximum_filter1d(slow.astype(float), width, axis=0)

    def rows(self, x: np.ndarray) -> np.ndarray:
        """A series [time ...] as rows."""
        return self.sampled(x)

    def sampled(self, x: np.ndarray) -> np.ndarray:
        """A series [time ...] through the low-pass, at the rows."""
        flat = x.reshape(len(x), -1)
        smooth = zero_phase(self.experiment.t, flat, self.cutoff_hz)
        # A copy: a view would keep the samples between the rows in memory.
        return smooth[self.kept].copy().reshape(-1, *x.shape[1:])

    def at_joint(self, x: np.ndarray, joint: int) -> np.ndarray:
        """Forces [time k] of one joint as rows of all [rows n k]."""
        own = self.rows(x)
        out = np.zeros((len(own), self.q.shape[1], own.shape[1]))
        out[:, joint] = own
        return out


def read_runs(binding: Binding, cutoff_hz: float | None) -> list[TorqueRun]:
    """Every recording of a binding, fit runs first. Raises `UsageError` for a cutoff that a run's
    sampling does not allow.
    """
    b = binding
    check_motion(b.chain)
    _, iy = columns(b.dataset, b.chain)
    fit = list(map(evenly, b.experiments("fit")))
    even = [*fit, *map(evenly, (*b.experiments("validation"), *b.experiments("report")))]
    cutoff = cutoff_hz or moving_band(b.chain, fit or even, iy, b.readings)
    room = bucket(max(len(e.t) for e in even))
    return [_read(b, e, iy, cutoff, room) for e in even]


def _read(
    binding: Binding, e: Experiment, iy: Sequence[int], cutoff_hz: float, room: int
) -> TorqueRun:
    chain = binding.chain
    iu, _ = columns(binding.dataset, chain)
    rate = (len(e.t) - 1) / e.duration
    refuse_cutoff(e, rate, cutoff_hz)
    motion_hz = min(MOTION * cutoff_hz, rate / 2.5)
    y = e.motion()[:, iy]
    q, qd, qdd, _ = joint_motion(
        chain, e.t, y, [motion_hz] * chain.nq, stated_positions(e, chain.signature)
    )
    # What is not recorded is nothing, as in a simulation: free swings have no inputs.
    u = e.u[:, iu] if iu else np.zeros((len(e.t), len(chain.signature.inputs)))
    ends = filter_ends(e.t, cutoff_hz)
    kept = slice(ends, len(e.t) - ends, rows_every(rate, cutoff_hz))
    return TorqueRun(
        experiment=e,
        q=q,
        qd=qd,
        qdd=qdd,
        u=u,
        kept=kept,
        cutoff_hz=cutoff_hz,
        moves=_moving(binding, q),
        room=room,
    )


def _moving(binding: Binding, q: np.ndarray) -> np.ndarray:
    noise = np.full(q.shape[1], 1e-9)
    for j, reading in enumerate(joint_readings(binding.chain)):
        if reading.q is not None:
            noise[j] = max(binding.readings[reading.q], noise[j])
    return moving(q, noise)


def turning_speeds(runs: Sequence[TorqueRun]) -> np.ndarray:
    """Speed over which each joint's dry friction turns [n]: see `TURN`."""
    return np.maximum(
        TURN * np.percentile(np.abs(np.concatenate([r.qd for r in runs])), 99, axis=0), 1e-9
    )
