"""The settings of inverse dynamics: filtered motion, decimation, and the noise of the torque
residual.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Dataset, Experiment
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.force.drive import drive_torque
from jaxid.simulation.rollout import inverse_dynamics_rollout, Lane
from jaxid.simulation.sample_buffers import columns


#: Fewest rows of the torque equation for each number of a model that decimation may leave.
ROWS = 30
#: Positions are smoothed at this many times the cutoff of the torque before they are
#: differentiated, and rows come at this many.
MOTION, ROWS_PER_CUTOFF = 2.0, 2.5
#: Torques say something up to this many times the frequencies of the motion, and up to this at
#: least (Hz).
HARMONICS, LOWEST = 4.0, 5.0


@dataclass(frozen=True)
class TorqueSetting:
    """Filtered motion (q, qd, qdd) of each run, and how torques become rows of the residual."""

    motion: list[Float[np.ndarray, "time motion"]]
    ends: list[int]  # samples to leave out at each end of a run
    decimate: int
    taps: Float[np.ndarray, " taps"]
    noise: Float[np.ndarray, " nq"]
    cutoff_hz: float
    statement: str
    inputs: list[int]  # columns of u and y that the model uses
    outputs: list[int]


def torque_setting(
    dataset: Dataset,
    experiments: Sequence[Experiment],
    chain: Chain,
    noise: Float[np.ndarray, " outputs"],
    cutoff_hz: float | None,
    decimate: int | None,
) -> TorqueSetting:
    """Filter and decimation of runs at equal steps. With `cutoff_hz`, the torque of model and drive
    up to there, positions up to `MOTION` times that before they are differentiated, and rows as
    often as the filter leaves something new; so, too, where the motion lies (`moving_band`), for
    runs whose clock is uneven, for beyond the motion is what the clock adds. Else positions up to a
    tenth of the sampling rate (or where the content of noisy ones ends), and 2.5 times fewer rows
    than that allows: torques up to a sixth of it. At least `ROWS` rows for each number of the
    model. With `decimate` given torques pass the low-pass that this takes (1: none), positions one
    at `cutoff_hz`. Noise of the residual: that of the drive's torque at high frequency (1 N m for a
    free motion).
    """
    from jaxid.data.signals import filter_ends
    from jaxid.dynamics.joint_readings import joint_motion, stated_positions

    iu, iy = columns(dataset, chain)
    check_motion(chain)
    fit = dataset.split("fit") or experiments  # one rule for all splits
    rate = (len(fit[0].t) - 1) / fit[0].duration
    bands = _bands(fit, chain, iy, noise, cutoff_hz, decimate)
    motion, ends, statement = [], [], ""
    for e in experiments:
        start = stated_positions(e, chain.signature)
        cutoffs = [bands.motion_hz] * chain.nq
        q, qd, qdd, statement = joint_motion(chain, e.t, e.motion()[:, iy], cutoffs, start)
        motion.append(np.concatenate([q, qd, qdd], 1))
        ends.append(filter_ends(e.t, bands.torque_hz))
    taps = np.ones(1)
    if bands.decimate > 1:
        taps = _low_pass(bands.decimate)
        statement += (
            f"; residual low-passed at {0.4 * rate / bands.decimate:.3g} Hz and taken at every"
            f" {bands.decimate}th sample"
        )
    level = np.ones(chain.nq)
    if iu:
        layout, pairs = ParameterVector(chain), zip(experiments, motion, strict=True)
        level = _level([drive_torque(layout, None, e.u[:, iu], m) for e, m in pairs], taps)
    return TorqueSetting(
        motion=motion,
        ends=ends,
        decimate=bands.decimate,
        taps=taps,
        noise=level,
        cutoff_hz=bands.motion_hz,
        statement=statement,
        inputs=iu,
        outputs=[iy[k] for k in chain.joint_outputs],
    )


class Bands(NamedTuple):
    """Up to which frequency torques and positions pass, and every how many samples there is a
    row.
    """

    torque_hz: float
    motion_hz: float
    decimate: int


def _bands(
    fit: Sequence[Experiment],
    chain: Chain,
    iy: Sequence[int],
    noise: Float[np.ndarray, " outputs"],
    cutoff_hz: float | None,
    decimate: int | None,
) -> Bands:
    """See `torque_setting`."""
    from jaxid.data.signals import even_grid
    from jaxid.dynamics.joint_readings import cutoffs

    first = fit[0]
    rate = (len(first.t) - 1) / first.duration
    uneven = any(even_grid(e.t) is not None for e in fit)
    by_torque = decimate is None and (bool(cutoff_hz) or uneven)
    if by_torque:
        torque_hz = cutoff_hz or moving_band(chain, [evenly(e) for e in fit], iy, noise)
        motion_hz, every = min(MOTION * torque_hz, rate / 2.5), rate / (ROWS_PER_CUTOFF * torque_hz)
    else:
        motion_hz = cutoff_hz
        if motion_hz is None:
            content = max(cutoffs(chain, first.t, first.motion()[:, iy], noise))
            motion_hz = min(rate / 10, max(content, 2.0))
        torque_hz, every = motion_hz, rate / (0.4 * motion_hz)
    if decimate is None:
        kept = sum(len(e.t) for e in fit) * chain.nq
        decimate = max(1, min(round(every), kept // (ROWS * own_numbers(chain))))
    return Bands(torque_hz, motion_hz, decimate)


def _low_pass(decimate: int) -> Float[np.ndarray, " taps"]:
    from scipy.signal import firwin

    return np.asarray(firwin(10 * decimate + 1, 0.8 / decimate), np.float64)


def _level(
    torques: Sequence[Float[np.ndarray, "time nq"]], taps: Float[np.ndarray, " taps"]
) -> Float[np.ndarray, " nq"]:
    """Noise of the rows: that of the drive's torques at high frequency, as far as it passes the
    taps.
    """
    third = np.concatenate([np.diff(tau, 3, axis=0) for tau in torques]) / np.sqrt(20.0)
    white = 1.4826 * np.median(np.abs(third), axis=0) * np.sqrt(np.sum(taps**2))
    span = np.percentile(np.abs(np.concatenate(torques)), 99, axis=0)
    level = np.maximum(np.maximum(white, 1e-3 * span), 1e-12)
    driven = span > 0
    if not np.any(driven):
        return level
    # Where nothing drives (the angles of a base that floats) rows are as good as the worst driven.
    return np.where(driven, level, level[driven].max())


def check_motion(chain: Chain) -> None:
    """Raises `UsageError` where the measured motion does not tell the torque that a model needs."""
    from jaxid.dynamics.joint_readings import all_read

    if chain.mechanism.hidden_states:
        raise UsageError(
            f"{chain.mechanism.name} has an inner state that the measured motion does not show: use"
            " output_error"
        )
    if not all_read(chain):
        raise UsageError(
            "inverse dynamics needs every joint's position or speed measured"
            f" ({', '.join(chain.signature.joints)})"
        )


def evenly(e: Experiment) -> Experiment:
    """The run at equal steps, by splines, where its steps differ by more than rounding: a filter
    over samples would else take crowded samples for long times. A run with equal steps is returned
    as it is.
    """
    from jaxid.data.signals import even_grid, spline

    if (grid := even_grid(e.t)) is None:
        return e
    near = np.clip(np.searchsorted(e.t, grid), 0, len(e.t) - 1)

    def take(x):
        return None if x is None else x[near]

    u = (
        np.stack([np.interp(grid, e.t, c) for c in e.u.T], 1)
        if e.u.size
        else np.zeros((len(grid), e.u.shape[1]))
    )
    other = {k: np.interp(grid, e.t, v) for k, v in e.auxiliary.items()}
    y = spline(e.t, e.motion(), grid)
    return replace(
        e,
        t=grid,
        u=u,
        y=y,
        auxiliary=other,
        past=None,
        scatter=take(e.scatter),
        left_out=take(e.left_out),
    )


def moving_band(
    chain: Chain,
    runs: Sequence[Experiment],
    iy: Sequence[int],
    sigma: Float[np.ndarray, " outputs"],
) -> float:
    """Frequency (Hz) in which torques of runs at equal steps say something: `HARMONICS` times the
    one below which the speed of every joint lies, at least `LOWEST`, at most a tenth of the
    sampling frequency. `iy` are the columns of the chain's outputs, `sigma` their noise.
    """
    from jaxid.data.signals import speed_content
    from jaxid.dynamics.joint_readings import joint_readings

    rate = min((len(e.t) - 1) / e.duration for e in runs)
    used = [r.q for r in joint_readings(chain) if r.q is not None]
    content = []
    for k in used:  # of each joint the run in which it is quickest: in a slow one it is noise
        e = max(runs, key=lambda e, k=k: _quickness(e, iy[k]))
        content.append(speed_content(e.t, e.motion()[:, iy[k]], float(sigma[k])))
    return float(min(rate / 10, max(HARMONICS * max(content, default=0.0), LOWEST)))


def _quickness(e: Experiment, column: int) -> float:
    """Standard deviation of the speed of a reading, its noise included."""
    return float(np.std(np.diff(e.motion()[:, column])) * len(e.t) / e.duration)


def own_numbers(chain: Chain) -> int:
    """How many numbers of the nominal model a fit determines; candidates of a diagnosis do not
    count.
    """
    builtin = {kind.name for kind, _ in chain.mechanism.builtin}
    held = chain.mechanism.held()
    own = [
        e
        for e in ParameterVector(chain).entries
        if e.owner < 0 or chain.effects[e.owner].name in builtin
    ]
    return max(1, sum(not e.spec.fixed and e.name not in held for e in own))


def decimated_torque_lane(taps: Float[np.ndarray, " taps"]) -> Lane:
    """`inverse_dynamics_rollout` followed by a zero-phase low-pass over time; equal filters share
    one lane, hence one program.
    """
    return _decimated(tuple(map(float, taps)))


@functools.cache
def _decimated(taps: tuple[float, ...]) -> Lane:
    kernel = np.array(taps)

    def lane(chain, samples, where, start, steps, length, reach, burn):
        missing = inverse_dynamics_rollout(
            chain=chain,
            samples=samples,
            where=where,
            start=start,
            steps=steps,
            length=length,
            reach=reach,
            burn=burn,
        )
        inside = jnp.arange(length)[:, None] <= where[2] - where[0]
        smooth = jax.vmap(
            lambda column: jnp.convolve(column, jnp.asarray(kernel), mode="same"), 1, 1
        )
        return smooth(jnp.where(inside, missing, 0.0))

    lane.taps = kernel  # type: ignore[attr-defined]
    return lane


def measured_torque(
    dataset: Dataset, runs: Any, theta: Float[np.ndarray, " numbers"]
) -> Float[np.ndarray, "samples nq"]:
    """The drive's joint torque, with the numbers theta, at the residual's samples, through the same
    low-pass, [samples nq].
    """
    taps = getattr(runs.engine.lane, "taps", np.ones(1))
    iu, _ = columns(dataset, runs.layout.chain)
    out = []
    for number in runs.records:
        record = runs.record(number)
        u = drive_torque(
            runs.layout,
            theta,
            runs.experiments[record.experiment].u[:, iu],
            runs.setting.motion[record.experiment],
        )
        smooth = np.stack([np.convolve(c, taps, mode="same") for c in u.T], -1)
        out.append(smooth[record.samples - record.first])
    return np.concatenate(out)
