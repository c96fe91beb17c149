"""Recorded runs as the arrays that a simulation walks through.

Simulation happens at the data's own times: each sampling interval is divided into equal steps no
longer than `step`, so irregular sampling and finer steps are data, not another program. All runs
lie behind one another in one buffer; a record (a whole run or a window of one) is an offset and a
count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Dataset, Experiment
from jaxid.dynamics.chain import Chain


#: Longest step of the fixed-step scan, s. Step halving checks the final answer of every fit.
STEP = 2.5e-3
#: Steps of the inner loop over time: a lane runs to the end of its last one.
BLOCK = 64
#: A run of more steps is long: see `jaxid.simulation.windows`.
LONG = 1 << 17
#: More steps than that of a run, and this many from each sample to the next, are refused.
ENDLESS, APART = 1e6, 100


class Samples(NamedTuple):
    """Buffers over all steps of all runs. `w` is 1 / noise at a sample and 0 between; `x` the
    smoothed measured motion.
    """

    t: Any  # [n]
    h: Any  # [n]
    u: Any  # [n nu] mean input over the step, stated hold
    other: Any  # [n nu] the same under the other hold
    total: Any  # [n nu] integral of u from the run's beginning to the step's
    y: Any  # [n ny]
    w: Any  # [n ny]
    x: Any  # [n k] measured motion where a residual needs it: (q, qd) or (q, qd, qdd)


@dataclass(frozen=True)
class Record:
    """A stretch of one run: steps offset ... offset + count of the buffer, run bounds first ...
    last, start state.
    """

    experiment: int
    offset: int
    count: int
    first: int
    last: int
    lead: int  # steps before the offset that effects with states follow the measured motion
    q0: np.ndarray
    qd0: np.ndarray
    free: np.ndarray  # [2 nq] which of (q0, qd0) are unknown
    samples: np.ndarray  # buffer positions of the samples it holds


def bucket(n: int, smallest: int = 1024) -> int:
    """n rounded up to a power of two, so that runs of other lengths meet the same compiled program;
    of long ones, whose padding would take much memory, to a multiple of LONG.
    """
    return max(smallest, 1 << (int(n) - 1).bit_length()) if n <= LONG else -(-int(n) // LONG) * LONG


def refuse_endless(experiments: Sequence[Experiment], step: float) -> None:
    """Raises `UsageError` where samples lie so far apart that a simulation would hardly end."""
    for e in experiments:
        between = np.diff(e.t) / step
        if between.sum() > ENDLESS and between.sum() > APART * len(e.t):
            median = float(np.median(np.diff(e.t)))
            raise UsageError(
                f"experiment {e.name!r}, step {median:.4g} s: is t in ms? A simulation takes steps"
                f" of {1e3 * step:.3g} ms, here {between.sum():.3g}. Give t in seconds; samples"
                " that are so far apart indeed do not show how a mechanism moves"
            )


def columns(dataset: Dataset, chain: Chain) -> tuple[list[int], list[int]]:
    """Positions of the model's inputs and outputs among the dataset's channels."""
    inputs = dataset.input_names
    outputs = dataset.output_names
    measured = [outputs.index(n) for n, _ in chain.signature.outputs]
    if dataset.stated.free:
        return [], measured
    return [inputs.index(n) for n, _ in chain.signature.inputs], measured


def pieces(e: Experiment, step: float) -> np.ndarray:
    """Into how many steps each sampling interval is divided."""
    return np.maximum(1, np.ceil(np.diff(e.t) / step * (1 - 1e-6)).astype(int))


def step_count(e: Experiment, step: float) -> int:
    """Buffer positions that a run takes."""
    return int(pieces(e, step).sum()) + 1


def divided_alike(experiments: Sequence[Experiment], step: float, other: float) -> bool:
    """Whether two steps divide every sampling interval into the same number: the simulations are
    then the same.
    """
    return all(np.array_equal(pieces(e, step), pieces(e, other)) for e in experiments)


def build(
    dataset: Dataset,
    experiments: Sequence[Experiment],
    chain: Chain,
    noise: np.ndarray,
    step: float = STEP,
    measured: Sequence[np.ndarray] | None = None,
    size: int = 0,
) -> tuple[Samples, list[np.ndarray]]:
    """Buffers for these runs, and per run the positions of its samples.

    `noise` is one standard deviation per output [ny]; `measured` the smoothed motion of each run at
    its samples [time k]; `size` the least size of the buffers, so that other runs share one
    program.
    """
    iu, iy = columns(dataset, chain)
    linear = np.array([dataset.inputs[i].hold == "linear" for i in iu], bool)
    nu = len(chain.signature.inputs)
    parts: list[list[np.ndarray]] = [[] for _ in Samples._fields]
    positions, first = [], 0
    for number, e in enumerate(experiments):
        dt = np.diff(e.t)
        divided = pieces(e, step)
        owner = np.repeat(np.arange(dt.size), divided)
        start = np.concatenate([[0], np.cumsum(divided)])
        inside = np.arange(owner.size) - start[owner]
        h = (dt / divided)[owner]
        t = e.t[owner] + inside * h
        n = owner.size + 1
        u = np.zeros((len(e.t), nu)) if not iu else e.u[:, iu]
        # MuJoCo's step takes a command as it is at its beginning, others take its mean.
        within = inside if chain.mechanism.own_step is not None else inside + 0.5
        zero, slope = u[:-1][owner], (u[1:] - u[:-1])[owner]
        ramp = zero + (within / divided[owner])[:, None] * slope
        stated, other = (
            np.where(linear, ramp, zero) if iu else zero,
            np.where(linear, zero, ramp) if iu else zero,
        )
        total = np.concatenate([np.zeros((1, nu)), np.cumsum(stated * h[:, None], 0)])
        y, w = np.zeros((n, len(iy))), np.zeros((n, len(iy)))
        y[start] = e.y[:, iy]
        w[start] = 1 / e.noise(noise, iy)
        x = np.zeros((n, 0))
        if measured is not None:
            m = measured[number]
            x = np.append(
                m[:-1][owner] + (inside / divided[owner])[:, None] * np.diff(m, axis=0)[owner],
                m[-1:],
                0,
            )

        def tail(a):
            return np.concatenate([a, a[-1:]])

        for part, a in zip(
            parts,
            (np.append(t, e.t[-1]), tail(h), tail(stated), tail(other), total, y, w, x),
            strict=True,
        ):
            part.append(a)
        positions.append(first + start)
        first += n
    size = bucket(max(first, size))
    arrays = []
    for name, part in zip(Samples._fields, parts, strict=True):
        a = np.concatenate(part)
        fill = np.ones if name == "h" else np.zeros
        arrays.append(np.concatenate([a, fill((size - len(a), *a.shape[1:]))]))
    return Samples(*arrays), positions
