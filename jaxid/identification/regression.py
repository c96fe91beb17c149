"""The torque equation of a serial arm as rows: measured motion in, filtered columns and filtered
torque out.

tau = Y_b pi + friction, with pi the base parameters. Positions are filtered without phase and
differentiated; the columns are built from that motion and pass the same low-pass as the torque
(both sides alike, so the filter does not bias the estimate).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Dataset, Experiment
from jaxid.data.noise import noise_floor
from jaxid.data.signals import differentiate, filter_ends, STRETCH, zero_phase, zero_phase_stretches
from jaxid.dynamics.base_parameters import BaseParameters, torque_columns
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.force.drive import drive_torque
from jaxid.force.motion import moving, refuse_cutoff, rows_every
from jaxid.identification.fourier import harmonic_motion
from jaxid.numerics.linalg import array_module
from jaxid.simulation.sample_buffers import columns


#: sign(qd) is tanh(qd / REST) here: at rest, measured velocity is noise and friction may take any
#: value.
REST = 0.01
#: This many rows of the torque equation are made at once: on the way to one there are five times
#: its numbers.
MADE = 1 << 11


class FrictionLaw(NamedTuple):
    """A friction law linear in its levels: parameter ids (and how their unit goes with speed) and
    the columns they multiply.
    """

    name: str
    parameters: tuple[tuple[str, str], ...]
    nonlinear: bool = False


LAWS: dict[str, FrictionLaw] = {
    "linear": FrictionLaw("linear", (("F_c", "{F}"), ("F_v", "{F} s/{X}"), ("offset", "{F}"))),
    "power": FrictionLaw(
        "power", (("F_c", "{F}"), ("F_v", "{F} (s/{X})^exponent"), ("offset", "{F}")), True
    ),
    "stribeck": FrictionLaw(
        "stribeck",
        (
            ("F_c", "{F}"),
            ("F_v", "{F} s/{X}"),
            ("offset", "{F}"),
            ("F_s", "{F}"),
            ("F_3", "{F} (s/{X})^3"),
        ),
    ),
}


def power(qd: Any, exponent: Float[np.ndarray, " n"]) -> Any:
    """|qd|^exponent sign(qd), the law of `power_law_friction`."""
    return qd * (qd * qd + 1e-6) ** ((exponent - 1) / 2)


def friction_columns(law: FrictionLaw, qd: Any, exponent: Float[np.ndarray, " n"]) -> Any:
    """Values [samples k n] of the k columns of a law at each joint's velocity [samples n], NumPy's
    or JAX.
    """
    xp = array_module(qd)
    dry = xp.tanh(qd / REST)
    if law.name == "power":
        return xp.stack([dry, power(qd, exponent), xp.ones_like(qd)], 1)
    parts = [dry, qd, xp.ones_like(qd)]
    if law.name == "stribeck":
        parts += [dry * xp.exp(-((qd / 0.1) ** 2)), qd**3]
    return xp.stack(parts, 1)


@dataclass(frozen=True)
class RegressionRun:
    """One experiment: its motion and its torque, filtered and not, in the samples that count.

    Of the columns of inertia, hundreds of numbers a sample, only the rows that are solved (`Y`) are
    kept; whatever needs others makes them again, a stretch of samples at a time.
    """

    name: str
    split: str
    t: Float[np.ndarray, " samples"]
    q: Float[np.ndarray, "all n"]  # the motion of all samples
    qd: Float[np.ndarray, "all n"]
    qdd: Float[np.ndarray, "all n"]
    Y: Float[np.ndarray, "rows n base"]  # filtered: every `spacing`-th of the samples that count
    tau: Float[np.ndarray, "samples n"]
    tau_raw: Float[np.ndarray, "samples n"]
    kept: slice  # the samples whose rows count
    cutoff_hz: float
    times: Float[np.ndarray, " all"]
    inertia: Callable[[slice], np.ndarray]  # columns of inertia, unfiltered, of some of all samples
    #: 0 for joints that stand still: their torque says nothing.
    moves: Float[np.ndarray, " n"] = field(default_factory=lambda: np.ones(1))

    def filtered(self, x: Float[np.ndarray, "all n"]) -> Float[np.ndarray, "samples n"]:
        """Series [all samples n] through the low-pass, at the samples that count."""
        out = np.empty((len(self.t), x.shape[1]))
        for at, smooth, _ in self.stretches(x.__getitem__):
            out[at] = smooth
        return out

    def solved(self, rows: Callable[[slice], np.ndarray]) -> Float[np.ndarray, "rows ..."]:
        """Series [all samples n ...] through the low-pass, at the rows that are solved."""
        return np.concatenate([smooth for _, smooth, _ in self.stretches(rows, spacing(self))])

    def stretches(
        self, rows: Callable[[slice], np.ndarray], every: int = 1
    ) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Rows [samples ...] stretch by stretch: (which of the samples that count, filtered,
        unfiltered), `every`-th of them.
        """
        ends = self.kept.start
        for samples, smooth, raw in zero_phase_stretches(
            self.times, rows, self.cutoff_hz, STRETCH >> 2
        ):
            first, last = max(samples.start, ends), min(samples.stop, self.kept.stop)
            first += -(first - ends) % every
            if first < last:
                at = slice(first - samples.start, last - samples.start, every)
                own = (
                    (smooth[at], raw[at]) if every == 1 else (smooth[at].copy(), raw[at].copy())
                )  # no view of the whole
                yield slice(first - ends, last - ends, every), *own


def read_run(
    dataset: Dataset,
    e: Experiment,
    chain: Chain,
    base: BaseParameters,
    cutoff_hz: float,
    motion_hz: float,
    fourier: bool = False,
) -> RegressionRun:
    """Rows of one experiment. `fourier`: rates by its harmonics."""
    iu, iy = columns(dataset, chain)
    rate = 1 / float(np.median(np.diff(e.t)))
    refuse_cutoff(e, rate, cutoff_hz)
    if fourier:
        q, qd, qdd = harmonic_motion(e.t, e.motion()[:, iy], min(motion_hz, rate / 2.5))
    else:
        q, qd, qdd, _ = differentiate(e.t, e.motion()[:, iy], min(motion_hz, rate / 2.5))
    tau = drive_torque(ParameterVector(chain), None, e.u[:, iu], np.concatenate([q, qd], 1))
    ends = filter_ends(e.t, cutoff_hz)
    kept = slice(ends, len(e.t) - ends)
    if len(e.t) - 2 * ends < 20:
        raise UsageError(
            f"experiment {e.name!r} has {len(e.t)} samples, too few for a filter of"
            f" {cutoff_hz:g} Hz"
        )
    smooth = zero_phase(e.t, tau, cutoff_hz)[kept]
    floor = noise_floor(dataset)
    noise = np.array([floor[dataset.outputs[i].name].std for i in iy])
    run = RegressionRun(
        name=e.name,
        split=e.split,
        t=e.t[kept],
        q=q,
        qd=qd,
        qdd=qdd,
        Y=np.zeros((0, 0, 0)),
        tau=smooth,
        tau_raw=tau[kept],
        kept=kept,
        cutoff_hz=cutoff_hz,
        times=e.t,
        inertia=lambda _: tau,
        moves=moving(e.motion()[:, iy], noise).astype(float),
    )
    return _with_inertia(run, chain, base, q, qd, qdd)


def held_joints(runs: Sequence[RegressionRun]) -> list[str]:
    """Sentences about joints that stand still in every run."""
    still = ~np.any([r.moves for r in runs], axis=0)
    return [
        f"joint {j + 1} stands still in every run: its torque says nothing and has no weight"
        for j in np.flatnonzero(still)
    ]


def _with_inertia(
    run: RegressionRun,
    chain: Chain,
    base: BaseParameters,
    q: np.ndarray,
    qd: np.ndarray,
    qdd: np.ndarray,
) -> RegressionRun:
    """The run along a motion [all samples n]."""
    index = list(base.kept)

    def made(at: slice) -> np.ndarray:
        first, last, _ = at.indices(len(q))
        out = np.empty((last - first, q.shape[1], len(index)))
        for a in range(first, last, MADE):
            some = slice(a, min(last, a + MADE))
            out[a - first : some.stop - first] = torque_columns(
                chain.mechanism, q[some], qd[some], qdd[some]
            )[:, :, index]
        return out

    if len(q) <= STRETCH >> 2:
        every = made(slice(None))
        run = replace(run, q=q, qd=qd, qdd=qdd, inertia=every.__getitem__)
    else:
        run = replace(run, q=q, qd=qd, qdd=qdd, inertia=made)
    return replace(run, Y=run.solved(run.inertia))


def full_rows(
    run: RegressionRun, law: FrictionLaw, exponent: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "rows n numbers"]:
    """W [rows n base + k n] of the rows of a run that are solved: inertia, then the law's columns,
    parameter by parameter over the joints.
    """

    def F(at):
        return friction_columns(law, run.qd[at], exponent)

    return _joined(run.Y, run.solved(F))


def every_row(
    run: RegressionRun, law: FrictionLaw, exponent: np.ndarray
) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """W of all samples that count, stretch by stretch: (which samples, filtered, unfiltered)."""

    def F(at):
        return friction_columns(law, run.qd[at], exponent)

    pairs = zip(run.stretches(run.inertia), run.stretches(F), strict=True)
    for (at, Y, Y_raw), (_, smooth, raw) in pairs:
        yield at, _joined(Y, smooth), _joined(Y_raw, raw)


def _joined(Y: np.ndarray, F: np.ndarray) -> np.ndarray:
    count, k, n = F.shape
    W = np.zeros((count, n, Y.shape[2] + k * n))
    W[:, :, : Y.shape[2]] = Y
    joint = np.arange(n)
    for i in range(k):
        W[:, joint, Y.shape[2] + i * n + joint] = F[:, i]
    return W


def torques(
    run: RegressionRun, laws: Sequence[tuple[FrictionLaw, np.ndarray, np.ndarray]]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Torque of each (law, theta, exponent) at the samples that count, filtered and not, each
    [samples n].

    It is linear in the columns, so it is filtered in their place.
    """
    count, n = run.q.shape
    p = run.Y.shape[2]
    whole = [np.empty((count, n)) for _ in laws]
    for a in range(0, count, MADE):
        at = slice(a, min(count, a + MADE))
        Y = run.inertia(at)
        for out, (law, theta, exponent) in zip(whole, laws, strict=True):
            F = friction_columns(law, run.qd[at], exponent)
            out[at] = Y @ theta[:p] + np.einsum("skn,kn->sn", F, theta[p:].reshape(-1, n))
    while whole:
        tau = whole.pop(0)
        yield run.filtered(tau), tau[run.kept]


def exponent_slopes(
    run: RegressionRun,
    law: FrictionLaw,
    theta: Float[np.ndarray, " numbers"],
    exponent: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "rows n n"]:
    """Derivative of the torque by each joint's exponent at the rows that are solved, [rows n n],
    filtered.
    """
    n = run.qd.shape[1]
    p = len(theta) - len(law.parameters) * n

    def slope(qd):
        return theta[p + n : p + 2 * n] * power(qd, exponent) * np.log(qd**2 + 1e-6) / 2

    return run.solved(lambda at: slope(run.qd[at]))[:, :, None] * np.eye(n)


def spacing(run: RegressionRun) -> int:
    """Every how many samples a row is solved."""
    return rows_every(1 / float(np.median(np.diff(run.t))), run.cutoff_hz)


def names_of(base: BaseParameters, law: FrictionLaw, n: int) -> list[str]:
    """Names of the columns of `full_rows`."""
    names = list(base.names)
    for parameter, _ in law.parameters:
        names += [f"{parameter}{joint + 1}" for joint in range(n)]
    return names


def instruments(
    dataset: Dataset, e: Experiment, chain: Chain, base: BaseParameters, run: RegressionRun
) -> RegressionRun:
    """The same run along the commanded motion `q1_cmd …`, which holds no noise of the
    measurement.
    """
    joints = chain.signature.joints
    commands = [f"{j}_cmd" for j in joints]
    missing = [c for c in commands if c not in e.auxiliary]
    if missing:
        raise UsageError(
            f"method iv takes its instruments from the commanded motion; experiment {e.name!r} has"
            f" no channel {missing[0]} (auxiliary channels {commands[0]} … {commands[-1]}, rad)."
            " Record it, or use --method wls"
        )
    q = np.stack([e.auxiliary[c] for c in commands], 1)
    qd = np.gradient(q, e.t, axis=0)
    qdd = np.gradient(qd, e.t, axis=0)
    return _with_inertia(run, chain, base, q, qd, qdd)
