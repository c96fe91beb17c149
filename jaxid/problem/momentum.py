"""Angular momentum as a residual: what a robot on a free base keeps, whatever its drives do;
neither torque nor acceleration.

About the centre of mass of all and in the world's axes the angular momentum L(q, qd) is the same at
all times, zero or not. With (p_roll, p_pitch, p_yaw) the rows of the base's angles in M_R qd
(`robots.floating`) and a_i the axes of these angles in the world, p_i = a_i . L. The residual is L
at the measured motion less its mean over the run, N m s, so that the momentum itself need not be
known. It is homogeneous in all inertias: what is known of the base gives the scale.

Where numbers change at a moment (`step_change`: a target is caught) each side of it is a run of its
own, with its own filter and mean: what is caught brings momentum, and its speed jumps. Which moment
that is, `jaxid.fitting.change` finds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Dataset, Experiment
from jaxid.data.signals import filter_ends
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import NumberEffect
from jaxid.dynamics.joint_readings import cutoffs, joint_motion
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.force.torque_filter import evenly
from jaxid.numerics.fast_math import sincos
from jaxid.numerics.precision import float64
from jaxid.problem.residual import (
    InverseDynamics,
    overrides,
    record_of,
    Runs,
    Simulation,
)
from jaxid.robots.bodies import BODY
from jaxid.simulation import sample_buffers as recorded
from jaxid.simulation.batch import BatchSimulator
from jaxid.simulation.rollout import over_time


CHANNELS = tuple((f"momentum_{k}", "N m s") for k in "xyz")
#: Rows come at this many times the cutoff of the motion.
ROWS_PER_CUTOFF = 2.5
#: A change takes no longer than this, s.
INSTANT = 1e-6
#: A side of a moment is looked at where it lasts for this many periods of the cutoff.
SHORTEST = 4.0
#: Samples of a run at which the noise of its momentum is worked out.
LOOKS = 50


def momentum(robot: Any, q: Float[Array, " nq"], qd: Float[Array, " nq"]) -> Float[Array, " 3"]:
    """Angular momentum of a robot on a free base about the centre of mass of all, in the world, N m
    s.
    """
    roll, pitch, yaw = robot.momenta(q, qd)[-3:]
    (sp, cp), (sy, cy) = sincos(q[-2]), sincos(q[-1])
    along = (roll + sp * yaw) / cp
    return jnp.stack([cy * along - sy * pitch, sy * along + cy * pitch, yaw])


def body_at(chain: Chain, t: Array) -> Any:
    """The mechanism as it is at a time."""
    now = chain.present(t, jnp.asarray(INSTANT)) if chain.timed else chain
    return now.body().prepare(None)


def momentum_lane(
    chain: Chain,
    samples: Any,
    where: Any,
    start: Any,
    steps: Any,
    length: int,
    reach: int,
    burn: bool,
) -> Array:
    """L at every sample of one run less its mean over those that count, [length 3]."""
    nq, (begin, _, last, _) = chain.nq, where
    body = body_at(chain, samples.t[begin])  # of all of the run: it lies on one side of a change

    def step(carry: tuple, k: Array) -> tuple[tuple, Array]:
        i = jnp.minimum(begin + k, last)
        return carry, momentum(body, samples.x[i, :nq], samples.x[i, nq : 2 * nq])

    L = over_time(step, (), steps, length, 3)
    k = jnp.arange(length)
    counts = (samples.w[jnp.minimum(begin + k, last), :1] > 0) & (k[:, None] < steps)
    return L - jnp.sum(jnp.where(counts, L, 0.0), 0) / jnp.maximum(jnp.sum(counts), 1)


def filtered(
    dataset: Dataset, e: Experiment, chain: Chain, cutoff: float
) -> tuple[np.ndarray, int, str]:
    """Positions, speeds and accelerations of a run [time 3 nq], how many samples its ends spoil,
    and a sentence.
    """
    _, iy = recorded.columns(dataset, chain)
    q, qd, qdd, said = joint_motion(chain, e.t, e.motion()[:, iy], [cutoff] * chain.nq)
    return np.concatenate([q, qd, qdd], 1), filter_ends(e.t, cutoff), said


def sides(e: Experiment, moment: float | None, cutoff: float | None) -> list[Experiment]:
    """The run before and after a moment; the longer one alone where the other is too short to be
    filtered.
    """
    if moment is None:
        return [e]
    k, least = int(np.searchsorted(e.t, moment)), SHORTEST / (cutoff or np.inf)
    parts = [e.piece(a, b, name=e.name, split=e.split) for a, b in ((0, k), (k, len(e))) if b > a]
    long = [p for p in parts if len(p) > LOOKS and p.duration > least]
    return long or [max(parts, key=len)]


@dataclass(frozen=True)
class Momentum(InverseDynamics):
    """Angular momentum of a robot on a free base: positions filtered without phase at `cutoff_hz`
    (by default where their content ends), differentiated once. At a `moment`, s, its numbers
    change: each side is taken by itself, the later one with noise `later` [3], N m s, where that is
    another one.
    """

    name: ClassVar[str] = "momentum"
    simulation: ClassVar[Simulation] = "momentum"
    moment: float | None = None
    later: tuple[float, ...] = ()

    def rates(self, dataset: Dataset, chain: Chain, noise: np.ndarray) -> tuple[float, float, int]:
        """Samples a second, cutoff in Hz, and each how many-th sample is a row."""
        _, iy = recorded.columns(dataset, chain)
        first = evenly(dataset.to_fit[0])
        rate = (len(first.t) - 1) / first.duration
        parts = sides(first, self.moment, None)  # a jump of speed is not what a side holds
        content = max(max(cutoffs(chain, p.t, p.motion()[:, iy], noise)) for p in parts)
        cutoff = self.cutoff_hz or min(rate / 5, max(content, 0.5))
        return rate, cutoff, self.decimate or max(1, round(rate / (ROWS_PER_CUTOFF * cutoff)))

    def runs(self, dataset, experiments, layout, noise, motions, step=recorded.STEP, shape=(0, 0)):
        chain = layout.chain
        refuse_others(chain)
        if chain.timed and self.moment is None:
            raise UsageError(
                "when a number changes is not known to the residual momentum: jaxid fit finds it,"
                " state it nowhere else"
            )
        parts: list[Experiment] = []
        for e in experiments:
            parts += sides(evenly(e), self.moment, self.cutoff_hz)
        experiments = parts
        rate, cutoff, every = self.rates(dataset, chain, noise)
        measured, ends, texts = zip(
            *(filtered(dataset, e, chain, cutoff) for e in experiments), strict=True
        )
        said = texts[-1]
        level = noise_of(chain, measured, noise[: chain.nq], rate, cutoff)
        samples, positions = recorded.build(
            dataset, experiments, chain, np.ones(chain.nq), 1e9, [*measured], shape[0]
        )
        w = np.zeros((len(samples.w), 3))
        records = []
        for number, e in enumerate(experiments):
            kept = positions[number][ends[number] : len(e.t) - ends[number] : every]
            late = self.moment is not None and self.later and e.t[0] >= self.moment
            w[kept] = 1 / np.array(self.later) if late else 1 / level
            record = record_of(
                number=number,
                e=e,
                p=positions[number],
                a=0,
                b=len(e.t),
                dataset=dataset,
                chain=chain,
                burn=0,
            )
            records.append(
                recorded.Record(
                    **{**record.__dict__, "samples": kept, "free": np.zeros_like(record.free)}
                )
            )
        samples = samples._replace(y=np.zeros_like(w), w=w)
        engine = BatchSimulator(
            layout,
            samples,
            records,
            overrides(layout, experiments, records),
            momentum_lane,
            shape[1],
        )
        text = (
            f"{said}; angular momentum less its mean over the run, at every {every}th sample"
            if every > 1
            else said
        )
        return Runs(
            experiments=tuple(experiments),
            layout=layout,
            channels=CHANNELS,
            noise=level,
            engine=engine,
            records=tuple(range(len(records))),
            heads=(),
            statement=text,
            dataset=dataset,
        )


def refuse_others(chain: Chain) -> None:
    """Raises `UsageError` for a model whose base does not float."""
    tree = getattr(getattr(chain.mechanism, "tree", None), "tree", None)
    if tree is None or not tree.floats:
        raise UsageError(
            'the residual momentum is of a robot on a free base: state [model] robot = "robot.xml"'
            ' (or a URDF) and [model.base] kind = "free"'
        )


def told_by(layout: ParameterVector, free: Sequence[int]) -> list[int]:
    """Those numbers that momentum shows: of bodies. Raises `UsageError` where none is fitted."""
    refuse_others(layout.chain)
    own = [i for i in free if of_a_body(layout, i)]
    if not own:
        raise UsageError(
            "momentum tells of bodies, and no number of one is fitted: name those of the unknown"
            ' body under [model.parameters], as in "mass@LINK" = {}, "com_x@LINK" = {}'
        )
    return own


def of_a_body(layout: ParameterVector, i: int) -> bool:
    """Whether a number of the layout is one of a body, or by how much one changes."""
    e = layout.entries[i]
    if e.owner >= 0 and isinstance(layout.chain.effects[e.owner], NumberEffect):
        return e.field == "size" and e.location.split("@")[0] in BODY
    return e.name.split("@")[0] in BODY


def noise_of(
    chain: Chain, measured: Sequence[np.ndarray], sigma: np.ndarray, rate: float, cutoff: float
) -> np.ndarray:
    """Standard deviation of each component [3] for readings with noise `sigma` [nq], white,
    low-passed and differentiated.
    """
    nq = chain.nq
    speeds = sigma * 2 * np.pi * np.sqrt(2 * cutoff**3 / (3 * rate))
    with float64():
        body = chain.body().prepare(None)
        slope = jax.jit(
            jax.vmap(lambda x: jax.jacfwd(lambda v: momentum(body, x[:nq], v))(x[nq : 2 * nq]))
        )
        x = np.concatenate(list(measured))
        J = np.asarray(slope(jnp.asarray(x[np.linspace(0, len(x) - 1, LOOKS).astype(int)])))
    return np.maximum(np.sqrt(np.mean(np.sum((J * speeds) ** 2, -1), 0)), 1e-12)


def of_the_joints(problem: Any, theta: np.ndarray) -> np.ndarray:
    """Momentum that the motion of the joints alone carries at the rows of a problem [rows 3]: what
    theirs and the base's turning have to balance, for the size of an error.
    """
    runs, nq = problem.runs, problem.runs.layout.chain.nq
    records = [runs.record(r) for r in problem.records]
    most, out = max(len(r.samples) for r in records), []
    with float64():
        chain = runs.layout.model(theta)
        own = jax.jit(
            lambda t, q, v: jax.vmap(lambda q, v, body: momentum(body, q, v), (0, 0, None))(
                q, v, body_at(chain, t)
            )
        )
        for r in records:  # all of one on one side of a change
            x = np.asarray(runs.engine.samples.x)[np.resize(r.samples, most)]
            still = np.concatenate([x[:, nq : 2 * nq - 3], np.zeros((most, 3))], 1)
            L = own(
                jnp.asarray(runs.engine.samples.t[r.offset]),
                jnp.asarray(x[:, :nq]),
                jnp.asarray(still),
            )
            out.append(np.asarray(L)[: len(r.samples)])
    return np.concatenate(out)
