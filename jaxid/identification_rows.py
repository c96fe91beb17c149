"""The torque equation of a serial arm as rows: measured motion in, filtered columns and filtered torque out.

tau = Y_b pi + friction, with pi the base parameters. Positions are filtered without phase and differentiated; the columns are
built from that motion and pass the same low-pass as the torque (both sides alike, so the filter does not bias the estimate).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxid.base_parameters import BaseParameters, torque_columns
from jaxid.chain import Chain
from jaxid.errors import UsageError
from jaxid.experiment import Dataset, Experiment
from jaxid.samples import columns
from jaxid.signals import differentiate, filter_ends, zero_phase


#: sign(qd) is tanh(qd / REST) here: at rest, measured velocity is noise and friction may take any value.
REST = 0.01


class Law(NamedTuple):
    """A friction law linear in its levels: parameter ids (and how their unit goes with speed) and the columns they multiply."""

    name: str
    parameters: tuple[tuple[str, str], ...]
    nonlinear: bool = False


LAWS: dict[str, Law] = {
    "linear": Law("linear", (("F_c", "{F}"), ("F_v", "{F} s/{X}"), ("offset", "{F}"))),
    "power": Law("power", (("F_c", "{F}"), ("F_v", "{F} (s/{X})^exponent"), ("offset", "{F}")), True),
    "stribeck": Law(
        "stribeck", (("F_c", "{F}"), ("F_v", "{F} s/{X}"), ("offset", "{F}"), ("F_s", "{F}"), ("F_3", "{F} (s/{X})^3"))
    ),
}


def power(qd: Any, exponent: np.ndarray) -> Any:
    """|qd|^exponent sign(qd), the law of `power_law_friction`."""
    return qd * (qd * qd + 1e-6) ** ((exponent - 1) / 2)


def friction_columns(law: Law, qd: Any, exponent: np.ndarray) -> Any:
    """Values [samples k n] of the k columns of a law at each joint's velocity [samples n], NumPy's or JAX."""
    xp: Any = np if isinstance(qd, np.ndarray) else jnp
    dry = xp.tanh(qd / REST)
    if law.name == "power":
        return xp.stack([dry, power(qd, exponent), xp.ones_like(qd)], 1)
    parts = [dry, qd, xp.ones_like(qd)]
    if law.name == "stribeck":
        parts += [dry * xp.exp(-((qd / 0.1) ** 2)), qd**3]
    return xp.stack(parts, 1)


@dataclass(frozen=True)
class Run:
    """One experiment: its motion, the columns of inertia and its torque, filtered and not, in the samples that count."""

    name: str
    split: str
    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    Y: np.ndarray  # [samples n base]
    tau: np.ndarray  # [samples n]
    Y_raw: np.ndarray
    tau_raw: np.ndarray
    every: slice  # the samples whose velocities the filter may use
    kept: slice  # the samples whose rows count
    cutoff_hz: float
    times: np.ndarray  # of `every`

    def filtered(self, x: np.ndarray) -> np.ndarray:
        """Columns [all samples ...] through the low-pass, at the rows that count."""
        return zero_phase(self.times, x.reshape(len(x), -1), self.cutoff_hz).reshape(x.shape)[self.kept]


def read_run(
    dataset: Dataset, e: Experiment, chain: Chain, base: BaseParameters, cutoff_hz: float, motion_hz: float, gains: np.ndarray
) -> Run:
    """Rows of one experiment; `gains` [n] turns its inputs into joint torque."""
    iu, iy = columns(dataset, chain)
    rate = 1 / float(np.median(np.diff(e.t)))
    if cutoff_hz >= rate / 2.5:
        raise UsageError(
            f"experiment {e.name!r} is sampled at {rate:.4g} Hz; a cutoff of {cutoff_hz:g} Hz is too high, give at most "
            f"{rate / 4:.3g}"
        )
    q, qd, qdd, _ = differentiate(e.t, e.motion()[:, iy], min(motion_hz, rate / 2.5))
    arm: Any = chain.mechanism
    Y = torque_columns(arm, q, qd, qdd)[:, :, list(base.kept)]
    tau = e.u[:, iu] * gains
    ends = filter_ends(e.t, cutoff_hz)
    kept = slice(ends, len(e.t) - ends)
    if len(e.t) - 2 * ends < 20:
        raise UsageError(f"experiment {e.name!r} has {len(e.t)} samples, too few for a filter of {cutoff_hz:g} Hz")
    smooth = lambda x: zero_phase(e.t, x.reshape(len(x), -1), cutoff_hz).reshape(x.shape)[kept]
    return Run(
        e.name, e.split, e.t[kept], q, qd, qdd, smooth(Y), smooth(tau), Y[kept], tau[kept], slice(None), kept, cutoff_hz, e.t
    )  # fmt: skip


def full_rows(run: Run, law: Law, exponent: np.ndarray, raw: bool = False) -> np.ndarray:
    """W [samples n base + k n] of a run: inertia, then the law's columns, parameter by parameter over the joints."""
    F = friction_columns(law, run.qd, exponent)
    F = F[run.kept] if raw else run.filtered(F)
    Y = run.Y_raw if raw else run.Y
    count, k, n = F.shape
    W = np.zeros((count, n, Y.shape[2] + k * n))
    W[:, :, : Y.shape[2]] = Y
    joint = np.arange(n)
    for i in range(k):
        W[:, joint, Y.shape[2] + i * n + joint] = F[:, i]
    return W


def exponent_slopes(run: Run, law: Law, theta: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    """Derivative of the torque by each joint's exponent, [samples n n], filtered."""
    n = run.qd.shape[1]
    p = len(theta) - len(law.parameters) * n
    slope = theta[p + n : p + 2 * n] * power(run.qd, exponent) * np.log(run.qd**2 + 1e-6) / 2
    return run.filtered(slope)[:, :, None] * np.eye(n)


def spacing(run: Run) -> int:
    """Every how many samples a row says something new: four times the cutoff."""
    rate = 1 / float(np.median(np.diff(run.t)))
    return max(1, int(rate / (4 * run.cutoff_hz)))


def names_of(base: BaseParameters, law: Law, n: int) -> list[str]:
    """Names of the columns of `full_rows`."""
    return [*base.names, *(f"{p}{j + 1}" for p, _ in law.parameters for j in range(n))]


def instruments(dataset: Dataset, e: Experiment, chain: Chain, base: BaseParameters, run: Run) -> Run:
    """The same run along the commanded motion `q1_cmd …`, which holds no noise of the measurement."""
    joints = chain.signature.joints
    commands = [f"{j}_cmd" for j in joints]
    missing = [c for c in commands if c not in e.auxiliary]
    if missing:
        raise UsageError(
            f"method iv takes its instruments from the commanded motion; experiment {e.name!r} has no channel {missing[0]} "
            f"(auxiliary channels {commands[0]} … {commands[-1]}, rad). Record it, or use --method wls"
        )
    q = np.stack([e.auxiliary[c] for c in commands], 1)
    qd = np.gradient(q, e.t, axis=0)
    qdd = np.gradient(qd, e.t, axis=0)
    Y = torque_columns(chain.mechanism, q, qd, qdd)[:, :, list(base.kept)]
    smooth = zero_phase(e.t, Y.reshape(len(Y), -1), run.cutoff_hz).reshape(Y.shape)[run.kept]
    return Run(**{**run.__dict__, "q": q, "qd": qd, "qdd": qdd, "Y": smooth, "Y_raw": Y[run.kept]})


def concatenated(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Rows of several runs, [rows columns] or [rows]."""
    return np.concatenate([p.reshape(-1, p.shape[2]) if p.ndim == 3 else p.ravel() for p in parts])
