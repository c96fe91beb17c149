"""Recursive least squares on the torque of a serial arm, sample by sample: paper 001, equations (8)
to (11).

With K = P Y' (X + Y P Y')^-1, theta <- theta + K (tau - Y theta), P <- P - K Y P, and X the
variance of the torque noise (the paper's xi, which it calls a forgetting factor but never divides P
by), the result is ridge regression: it minimises sum |tau - Y theta|^2 / X + |theta - prior|^2 /
P0. A true forgetting factor is an option.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import UsageError
from jaxid.dynamics.rigid_body import chain_of, regressor, still
from jaxid.fitting.recursive_least_squares import RecursiveState, refuse_forgetting, ridge_rls, Rule
from jaxid.identification.payload import payload_of, PayloadEstimate, published_rows
from jaxid.identification.regression import REST
from jaxid.numerics.precision import float64


def watched_of(base: Any, n: int) -> tuple[int, ...]:
    """Positions of the last link's base parameters; those that stand alone, where an arm has such
    (the paper's rule).
    """
    names = base.names
    found = [
        i for i in range(len(names)) if names[i].endswith(str(n)) and not names[i].startswith("Ia")
    ]
    alone = [i for i in found if np.count_nonzero(base.K[i]) == 1] if n >= 3 else []
    return tuple(alone or found)


def regressor_row(
    arm: Any, kept: np.ndarray, q: Array, qd: Array, qdd: Array, exponent: Array
) -> Float[Array, "n p"]:
    """Columns of base parameters, then F_c, F_v, offset of each joint, at one sample."""
    n = q.shape[0]
    bodies = chain_of(arm.prismatic, batch=q.ndim - 1)
    Y = regressor(arm.placements(q), bodies, still(arm.free_fall()), qd, qdd)
    Y = jnp.concatenate([Y, (jnp.eye(n) * qdd[:, None])[:, :, None]], 2).reshape(n, 11 * n)[:, kept]
    power = qd * (qd * qd + 1e-6) ** ((exponent - 1) / 2)
    return jnp.concatenate([Y, jnp.diag(jnp.tanh(qd / REST)), jnp.diag(power), jnp.eye(n)], 1)


@functools.cache
def _program(structure, shapes, kept: tuple[int, ...], watched: tuple[int, ...]):
    """The compiled update of arms of one structure: (numbers, packed state, sample) -> packed
    state. All numbers of the arm and the settings come in one array, and so do the state and the
    sample: few arguments, little overhead.
    """

    def update(numbers, packed, sample):
        leaves, at = [], 0
        for shape in shapes:
            size = int(np.prod(shape))
            leaves.append(numbers[at : at + size].reshape(shape))
            at += size
        n = sample.shape[1]
        exponent, noise_var = numbers[at : at + n], numbers[at + n : at + 2 * n]
        forgetting, change = numbers[at + 2 * n], numbers[at + 2 * n + 1]
        q, qd, qdd, tau = sample
        Y = regressor_row(
            jax.tree.unflatten(structure, leaves), np.array(kept), q, qd, qdd, exponent
        )
        return _packed(
            ridge_rls(_unpacked(packed), Y, tau, noise_var, forgetting, np.array(watched), change)
        )

    return jax.jit(update)


def _packed(state: RecursiveState) -> Array:
    """P row by row, theta, still, seen: p^2 + p + 2 numbers."""
    counts = jnp.stack([state.still, state.seen]).astype(state.P.dtype)
    return jnp.concatenate([state.P.ravel(), state.theta, counts])


def _unpacked(packed: Any) -> RecursiveState:
    p = int((packed.size - 2) ** 0.5)  # p^2 + p + 2 numbers
    return RecursiveState(packed[p * p : -2], packed[: p * p].reshape(p, p), packed[-2], packed[-1])


class OnlineIdentification:
    """Streams samples into the recursion: `update(q, qd, qdd, tau)` after each, `theta`, `std`,
    `converged`, `payload()`.

    `prior` [p] is the estimate to begin with (base parameters, then F_c, F_v, offset by joint:
    `names`), usually that of the unloaded arm; `prior_var` its variance (one number or [p], the
    paper's P0 = 10), `noise_var` the torque noise's (one number or [n], the paper's xi = 100).
    Motion may be the commanded one, as in the paper.
    """

    def __init__(
        self,
        arm: Any,
        prior: np.ndarray | None = None,
        *,
        exponent: np.ndarray | float = 1.0,
        noise_var: np.ndarray | float = 100.0,
        prior_var: np.ndarray | float = 10.0,
        forgetting: float = 1.0,
        rule: Rule = Rule(),
    ):
        refuse_forgetting(forgetting)
        self.arm, self.base, self.rule = arm, arm.base(), rule
        n, p = len(arm.prismatic), len(self.base.kept) + 3 * len(arm.prismatic)
        self.names = list(self.base.names)
        for kind in ("F_c", "F_v", "offset"):
            self.names += [f"{kind}{j + 1}" for j in range(n)]
        self.prior = np.zeros(p) if prior is None else np.asarray(prior, np.float64)
        if self.prior.shape != (p,):
            raise UsageError(
                f"the prior has shape {self.prior.shape}; this arm has {p} parameters"
                f" ({self.names[0]} … {self.names[-1]})"
            )
        with float64():

            def full(v, k):
                return jnp.asarray(np.broadcast_to(np.asarray(v, np.float64), k))

            leaves, structure = jax.tree.flatten(arm)
            shapes = tuple(map(np.shape, leaves))
            settings = [
                np.broadcast_to(exponent, n),
                np.broadcast_to(noise_var, n),
                [forgetting, rule.change],
            ]
            numbers = np.concatenate(
                [np.ravel(np.asarray(a, np.float64)) for a in (*leaves, *settings)]
            )
            self.watched = watched_of(self.base, n)
            self._update = _program(
                structure, shapes, tuple(map(int, self.base.kept)), self.watched
            )
            self._numbers = jnp.asarray(numbers)
            zero = jnp.zeros(())
            self._state = _packed(
                RecursiveState(jnp.asarray(self.prior), jnp.diag(full(prior_var, p)), zero, zero)
            )
        self.converged_at: int | None = None
        self._sample = np.zeros((4, n))

    def update(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, tau: np.ndarray) -> None:
        """One sample: joint motion [n] (rad, m and their rates) and torque [n]. Nothing recompiles
        after the first.
        """
        self._sample = np.array((q, qd, qdd, tau), np.float64)
        with float64():
            self._state = self._update(self._numbers, self._state, self._sample)

    def rehearse(self) -> None:
        """The last sample's update once more, its result thrown away. A computer that has slept
        until a sample comes takes up to twice as long for its update; a loop with a deadline
        rehearses just before (`benchmarks/ur10_speed.py`).
        """
        with float64():
            self._update(self._numbers, self._state, self._sample).block_until_ready()

    @property
    def state(self) -> RecursiveState:
        """As NumPy arrays; waits for the last update."""
        return _unpacked(np.asarray(self._state))

    def check(self) -> bool:
        """Whether the rule has been met; remembers at which sample it first was. Waits for the last
        update.
        """
        if self.converged_at is None and int(self.state.still) > self.rule.samples:
            self.converged_at = int(self.state.seen)
        return self.converged_at is not None

    @property
    def theta(self) -> np.ndarray:
        return np.asarray(self.state.theta)

    @property
    def covariance(self) -> np.ndarray:
        """P: the covariance of theta if the noise is white with `noise_var` and the prior's
        variance is `prior_var`.
        """
        return np.asarray(self.state.P)

    def payload(self, gain_std: float = 0.0) -> PayloadEstimate:
        """The load that the estimate has more than its prior, by all rows and by those of the
        paper.
        """
        p = len(self.base.kept)
        return payload_of(
            self.theta[:p] - self.prior[:p], self.covariance[:p, :p], self.base, gain_std
        )

    def published_mass(self) -> float | None:
        """Mass by equations (12) and (13) of paper 001; None for an arm that lacks their rows."""
        found = published_rows(
            self.theta[: len(self.base.kept)] - self.prior[: len(self.base.kept)], self.base
        )
        return None if found is None else float(found[9])
