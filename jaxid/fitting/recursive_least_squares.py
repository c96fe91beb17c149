"""Recursive least squares."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import UsageError
from jaxid.numerics.precision import float64


class RecursiveState(NamedTuple):
    """State of the recursion: estimate, its matrix P, and how long the last link's parameters have
    stood still.
    """

    theta: Float[Array, " p"]
    P: Float[Array, "p p"]
    still: Array  # samples in a row
    seen: Array  # samples so far


class Rule(NamedTuple):
    """Convergence: no watched parameter moves by more than `change` a sample for more than
    `samples` of them.
    """

    change: float = 0.005
    samples: int = 300


def ridge_rls(
    state: RecursiveState,
    Y: Float[Array, "n p"],
    tau: Float[Array, " n"],
    noise_var: Float[Array, " n"],
    forgetting: Any = 1.0,
    watched: Any = slice(None),
    change: float = Rule().change,
) -> RecursiveState:
    """One sample (pure; jit and scan it). `noise_var` [n] (N m)^2; `forgetting` in (0, 1], 1
    forgets nothing.

    With X + Y P Y' = L L' and V = P Y' L'^-1, K (tau - Y theta) = V L^-1 (tau - Y theta) and K Y P
    = V V', so P stays symmetric.
    """
    P = state.P / forgetting
    PY = P @ Y.T
    columns, errors = _whitened(jnp.diag(noise_var) + Y @ PY, [*PY.T], [*(tau - Y @ state.theta)])
    step = sum((e * v for e, v in zip(errors, columns, strict=True)), jnp.zeros(()))
    P = P - sum((v[:, None] * v[None] for v in columns), jnp.zeros(()))
    still = jnp.where(jnp.max(jnp.abs(step[watched])) < change, state.still + 1, 0)
    return RecursiveState(state.theta + step, P, still, state.seen + 1)


def _whitened(S: Float[Array, "n n"], *rows: Sequence[Array]) -> list[list[Array]]:
    """L^-1 times lists of n rows, with S = L L', written out: in one sample's time calls of LAPACK
    would be dear.
    """
    n, L = S.shape[0], {}
    for i in range(n):
        for j in range(i + 1):
            rest = S[i, j] - sum(L[i, k] * L[j, k] for k in range(j))
            L[i, j] = jnp.sqrt(rest) if i == j else rest / L[j, j]
    out: list[list[Array]] = [[] for _ in rows]
    for given, made in zip(rows, out, strict=True):
        for i in range(n):
            made.append((given[i] - sum(L[i, k] * made[k] for k in range(i))) / L[i, i])
    return out


@functools.partial(jax.jit, static_argnums=(6,))
def _replayed(state, Y, tau, noise_var, forgetting, change, watched):
    def step(state, sample):
        Y, tau = sample
        state = ridge_rls(state, Y, tau, noise_var, forgetting, np.array(watched, int), change)
        return state, state.still

    return jax.lax.scan(step, state, (Y, tau))


def replay(
    Y: np.ndarray, tau: np.ndarray, prior: np.ndarray, **settings: Any
) -> tuple[np.ndarray, np.ndarray, int | None]:
    """The recursion over recorded rows Y [time n p] and torque [time n]: see `replay_stretches`."""
    return replay_stretches([(Y, tau)], prior, **settings)


def replay_stretches(
    rows: Iterable[tuple[np.ndarray, np.ndarray]],
    prior: np.ndarray,
    *,
    noise_var: np.ndarray | float = 100.0,
    prior_var: np.ndarray | float = 10.0,
    forgetting: float = 1.0,
    watched: tuple[int, ...] = (),
    rule: Rule = Rule(),
) -> tuple[np.ndarray, np.ndarray, int | None]:
    """The recursion over recorded rows, stretches of Y [time n p] and torque [time n] in their
    order: estimate [p], P [p p], and the number of samples after which the rule was first met for
    the `watched` parameters (None: never, or none watched).
    """
    refuse_forgetting(forgetting)

    def full(v, k):
        return jnp.asarray(np.broadcast_to(np.asarray(v, np.float64), k))

    with float64():
        zero = jnp.zeros((), jnp.int32)
        state = RecursiveState(
            jnp.asarray(prior, float), jnp.diag(full(prior_var, prior.size)), zero, zero
        )
        run: Any = _replayed
        count, met = 0, None
        for Y, tau in rows:
            numbers = full(noise_var, tau.shape[1]), np.float64(forgetting), np.float64(rule.change)
            state, still = run(state, jnp.asarray(Y), jnp.asarray(tau), *numbers, watched or (0,))
            found = np.flatnonzero(np.asarray(still) > rule.samples)
            met = count + int(found[0]) + 1 if met is None and watched and found.size else met
            count += len(tau)
        return np.asarray(state.theta), np.asarray(state.P), met


def refuse_forgetting(forgetting: float) -> None:
    if not 0 < forgetting <= 1:
        raise UsageError(
            f"forgetting is {forgetting:g}; it lies above 0 and at most at 1 (1 forgets nothing)"
        )
