"""A free run under a drive law, to first order about the measured motion.

Of a model that lacks the joint force m along a measured motion z = (q, qd, qdd), the free run q + x
obeys

    M xdd + D xd + S x = m,      x = 0 where nothing is missing,

with M, D, S the derivatives of that missing force: inertia; damping of the law, the friction and
what the speed does; stiffness of the law and of gravity. The law holds x together, so what noise
and a wrong model did before is forgotten, and every column of a torque equation becomes a column of
the free run by one pass over time: no model is simulated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.data.dataset import Experiment
from jaxid.data.signals import spline
from jaxid.diagnosis.torque.rows import TorqueRun
from jaxid.numerics.precision import float64


#: Steps of the loop are no longer than this share of its quickest radian.
FINE = 0.15
#: Columns that one pass takes: what is compiled is compiled once for each of these widths.
WIDTHS = (4, 16, 64, 256)


@dataclass(frozen=True, eq=False)
class Loop:
    """Matrices of the loop at every sample of a run, [time n n]: the step x[k + 1] = P m[k] + Q
    x[k] + R x[k - 1].
    """

    P: np.ndarray
    Q: np.ndarray
    R: np.ndarray

    def free_run(self, force: np.ndarray) -> np.ndarray:
        """Positions [time n k] that forces [time n k] make of it, from rest on the measured
        motion.
        """
        n, k = force.shape[1:]
        out, done = np.empty_like(force), 0
        while done < k:
            width = next((w for w in WIDTHS if w >= k - done), WIDTHS[-1])
            part = force[:, :, done : done + width]
            wide = np.zeros((len(self.P), n, width))
            wide[: len(force), :, : part.shape[2]] = part
            with float64():
                found = np.asarray(_passed(self.P, self.Q, self.R, wide))
            out[:, :, done : done + width] = found[: len(force), :, : part.shape[2]]
            done += width
        return out


@jax.jit
def _passed(P: Any, Q: Any, R: Any, force: Any) -> Any:
    def step(before: Any, now: Any) -> Any:
        (last, x), (P, Q, R, m) = before, now
        return (x, P @ m + Q @ x + R @ last), x

    zero = jnp.zeros(force.shape[1:])
    return jax.lax.scan(step, (zero, zero), (P, Q, R, force))[1]


def loop_of(
    h: float,
    inertia: np.ndarray,
    damping: np.ndarray,
    sticking: np.ndarray,
    stiffness: np.ndarray,
    moves: np.ndarray,
) -> Loop:
    """The loop of matrices [time n n] (`sticking`: slope of dry friction, `moves`: share of a force
    that it leaves, [time n]) at steps h: by Newmark's constant mean acceleration; dry friction
    implicitly, so that a joint that sticks stays where it is.
    """
    stick = np.eye(inertia.shape[1]) * sticking[:, None, :]
    A, half, quarter = inertia / h**2, damping / (2 * h), stiffness / 4
    inverse = np.linalg.inv(A + half + quarter + stick / h)
    return Loop(
        inverse * moves[:, None, :],
        inverse @ (2 * A - 2 * quarter + stick / h),
        -inverse @ (A - half + quarter),
    )


@dataclass(frozen=True, eq=False)
class LoopRun(TorqueRun):
    """A recording whose rows are those of the free run, once the model was linearised along it
    (`loop`).
    """

    loop: Loop | None = None

    def rows(self, x: np.ndarray) -> np.ndarray:
        """Forces [time n k] (or [time n]) as positions of the free run, low-passed, at the rows."""
        return self.sampled(self.free_run(x))

    def at_joint(self, x: np.ndarray, joint: int) -> np.ndarray:
        """Forces [time k] of one joint as rows of all [rows n k]: it moves its neighbours, too."""
        force = np.zeros((len(x), self.q.shape[1], x.shape[1]))
        force[:, joint] = x
        return self.rows(force)

    def free_run(self, x: np.ndarray) -> np.ndarray:
        """Forces [time n k] (or [time n]) as positions of the free run."""
        assert self.loop is not None
        return self.loop.free_run(x[:, :, None] if x.ndim == 2 else x).reshape(x.shape)


class RawRun(TorqueRun):
    """A recording whose rows are the forces themselves, at all samples."""

    def rows(self, x: np.ndarray) -> np.ndarray:
        return x


def refined(e: Experiment, times: int, linear: np.ndarray) -> Experiment:
    """A run at this many times its rate: readings by splines, inputs as they are held (`linear`
    [inputs]).
    """
    t = np.linspace(e.t[0], e.t[-1], times * (len(e.t) - 1) + 1)
    owner = np.minimum(np.arange(len(t)) // times, len(e.t) - 1)
    ramp = np.stack([np.interp(t, e.t, c) for c in e.u.T], 1) if e.u.size else e.u[owner]
    u = np.where(linear, ramp, e.u[owner])

    def take(x):
        return None if x is None else x[owner]

    other = {k: np.interp(t, e.t, v) for k, v in e.auxiliary.items()}
    y = spline(e.t, e.y, t) if times > 1 else e.y
    return replace(
        e,
        t=t,
        u=u,
        y=y,
        auxiliary=other,
        past=None,
        scatter=take(e.scatter),
        left_out=take(e.left_out),
    )


def mean_input(u: np.ndarray, linear: np.ndarray) -> np.ndarray:
    """Inputs [time nu] at the samples: of what is held and jumps there, the mean of both sides."""
    before = np.concatenate([u[:1], u[:-1]])
    return np.where(linear, u, (u + before) / 2)
