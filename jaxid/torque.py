"""The settings of inverse dynamics: filtered motion, decimation, and the noise of the torque residual."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.chain import Chain
from jaxid.errors import UsageError
from jaxid.experiment import Dataset, Experiment
from jaxid.lane import Lane, torque_lane
from jaxid.layout import Layout
from jaxid.samples import columns, content_cutoff


#: Fewest rows of the torque equation for each number of a model that decimation may leave.
ROWS = 30


@dataclass(frozen=True)
class TorqueSetting:
    motion: list[np.ndarray]  # per run (q, qd, qdd) [time 3 nq]
    ends: list[int]  # samples to leave out at each end of a run
    decimate: int
    taps: np.ndarray
    noise: np.ndarray  # [nq]
    cutoff_hz: float
    statement: str
    inputs: list[int]  # columns of u and y that the model uses
    outputs: list[int]


def torque_setting(
    dataset: Dataset,
    experiments: Sequence[Experiment],
    chain: Chain,
    noise: np.ndarray,
    cutoff_hz: float | None,
    decimate: int | None,
) -> TorqueSetting:
    """Filter and decimation: the cutoff a tenth of the sampling rate (or where the content of noisy positions ends),
    decimation to 2.5 times less than the cutoff allows, but not below `ROWS` rows of the fit for each number of the model.
    Noise of the residual: that of the input at high frequency (1 N m where the inputs are no torques)."""
    from jaxid.signals import differentiate, filter_ends

    iu, iy = columns(dataset, chain)
    if chain.mechanism.hidden_states:
        raise UsageError(f"{chain.mechanism.name} has an inner state that the measured motion does not show: use output_error")
    iy = [iy[k] for k in chain.joint_outputs]
    if not iy:
        raise UsageError(f"inverse dynamics needs every joint position measured ({', '.join(chain.signature.joints)})")
    first = (dataset.split("fit") or experiments)[0]  # one rule for all splits
    rate = 1 / float(np.median(np.diff(first.t)))
    if cutoff_hz is None:
        content = max(
            content_cutoff(first.t, first.motion()[:, i], s) for i, s in zip(iy, noise[chain.joint_outputs], strict=True)
        )
        cutoff_hz = min(rate / 10, max(content, 2.0))
    if decimate is None:
        kept = sum(len(e.t) for e in dataset.split("fit") or experiments) * chain.nq
        decimate = max(1, min(round(rate / (0.4 * cutoff_hz)), kept // (ROWS * own_numbers(chain))))
    motion, ends = [], []
    statement = ""
    for e in experiments:
        q, qd, qdd, statement = differentiate(e.t, e.motion()[:, iy], cutoff_hz)
        motion.append(np.concatenate([q, qd, qdd], 1))
        ends.append(filter_ends(e.t, cutoff_hz))
    taps = np.ones(1)
    if decimate > 1:
        from scipy.signal import firwin

        taps = np.asarray(firwin(10 * decimate + 1, 0.8 / decimate), np.float64)
        statement += f"; residual low-passed at {0.4 * rate / decimate:.3g} Hz and taken at every {decimate}th sample"
    level, gains = np.ones(chain.nq), drive_gains(chain)
    for j, i in enumerate(iu if chain.direct else []):
        u = gains[j] * np.concatenate([np.diff(e.u[:, i], 3) for e in experiments]) / np.sqrt(20.0)
        white = 1.4826 * float(np.median(np.abs(u)))
        span = gains[j] * float(np.percentile(np.abs(np.concatenate([e.u[:, i] for e in experiments])), 99))
        level[j] = max(white * np.sqrt(np.sum(taps**2)), 1e-3 * span, 1e-12)
    return TorqueSetting(motion, ends, decimate, taps, level, cutoff_hz, statement, iu, iy)


def own_numbers(chain: Chain) -> int:
    """How many numbers of the nominal model a fit determines; candidates of a diagnosis do not count."""
    builtin = {kind.name for kind, _ in chain.mechanism.builtin}
    held = chain.mechanism.held()
    own = [e for e in Layout(chain).entries if e.owner < 0 or chain.effects[e.owner].name in builtin]
    return max(1, sum(not e.spec.fixed and e.name not in held for e in own))


def drive_gains(chain: Chain) -> np.ndarray:
    """What turns each input into joint torque, [nu]: the model's drive gains, 1 where it has none."""
    gains = [np.asarray(e.gain, float) for e in chain.effects if e.name == "drive_gain"]  # pyright: ignore
    return np.prod(gains, 0) if gains else np.ones(max(1, len(chain.signature.inputs)))


def decimated_torque_lane(taps: np.ndarray) -> Lane:
    """`torque_lane` followed by a zero-phase low-pass over time; equal filters share one lane, hence one program."""
    return _decimated(tuple(float(x) for x in taps))


@functools.cache
def _decimated(taps: tuple[float, ...]) -> Lane:
    kernel = np.array(taps)

    def lane(chain, samples, where, start, steps, length, reach, burn):
        missing = torque_lane(chain, samples, where, start, steps, length, reach, burn)
        inside = jnp.arange(length)[:, None] <= where[2] - where[0]
        smooth = jax.vmap(lambda column: jnp.convolve(column, jnp.asarray(kernel), mode="same"), 1, 1)
        return smooth(jnp.where(inside, missing, 0.0))

    lane.taps = kernel  # type: ignore[attr-defined]
    return lane


def measured_torque(dataset: Dataset, runs) -> np.ndarray:
    """Measured joint torque at the residual's samples, through the same low-pass, [samples nq]."""
    taps = getattr(runs.engine.lane, "taps", np.ones(1))
    iu, _ = columns(dataset, runs.layout.chain)
    out, gains = [], drive_gains(runs.layout.chain)
    for number in runs.records:
        record = runs.record(number)
        u = runs.experiments[record.experiment].u[:, iu] * gains
        smooth = np.stack([np.convolve(c, taps, mode="same") for c in u.T], -1)
        out.append(smooth[record.samples - record.first])
    return np.concatenate(out)
