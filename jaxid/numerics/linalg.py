"""Factorisations of small matrices in batches, as loops of arithmetic.

The batched LAPACK calls of XLA share their work out on the thread pool they run on: two of them at
once can wait for each other for ever on a machine with two cores. These do not, and for some ten
rows they are faster too.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Inexact


SWEEPS = 30  # of Jacobi rotations, at most: they converge quadratically, graded matrices of 8 rows within 7, of 64 within 15


@jax.custom_jvp
def solve(a: Inexact[Array, "n n"], b: Inexact[Array, "n m"]) -> Inexact[Array, "n m"]:
    """x of a x = b, by Gauss-Jordan elimination with row pivoting."""
    n = a.shape[0]

    def eliminate(rows: Array, k: Array) -> tuple[Array, None]:
        size = jnp.where(jnp.arange(n) >= k, jnp.abs(rows[:, k]), -1.0)
        p = jnp.argmax(size)
        pivot, other = rows[p], rows[k]
        rows = rows.at[p].set(other).at[k].set(pivot)
        row = pivot / pivot[k]
        return (rows - rows[:, k, None] * row).at[k].set(row), None

    kind = jnp.result_type(a, b)
    both = jnp.concatenate([a.astype(kind), b.astype(kind)], 1)
    return jax.lax.scan(eliminate, both, jnp.arange(n))[0][:, n:]


@solve.defjvp
def _solve_jvp(primals, tangents):
    (a, b), (da, db) = primals, tangents
    x = solve(a, b)
    return x, solve(a, db - da @ x)


def whitening(a: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """W with W a W' = 1 and W lower triangular: the inverse of the Cholesky factor of a positive
    definite matrix.
    """
    n = a.shape[0]

    def eliminate(rows: Array, k: Array) -> tuple[Array, None]:
        row = rows[k] / jnp.sqrt(rows[k, k])
        below = jnp.where(jnp.arange(n) > k, rows[:, k] / row[k], 0.0)
        return (rows - below[:, None] * row).at[k].set(row), None

    return jax.lax.scan(
        eliminate, jnp.concatenate([a, jnp.eye(n, dtype=a.dtype)], 1), jnp.arange(n)
    )[0][:, n:]


def _tournament(n: int) -> np.ndarray:
    """Who sits where after a round in which neighbours 0-1, 2-3, ... met (n even): n - 1 rounds
    bring each pair together once.
    """
    seats = np.arange(n)
    if n > 2:
        seats[2], seats[4::2] = 1, np.arange(2, n - 2, 2)
        seats[1 : n - 1 : 2], seats[n - 1] = np.arange(3, n, 2), n - 2
    return seats


@jax.custom_jvp
def eigh(a: Float[Array, "n n"]) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """Eigenvalues of a symmetric matrix, rising, and its eigenvectors (columns), by Jacobi
    rotations of n / 2 pairs at a time (Brent and Luk 1985); derivatives need distinct eigenvalues.
    """
    n = a.shape[0]
    if n == 1:
        return a[0], jnp.ones_like(a)
    even = n + n % 2  # a last row and column that nothing is coupled with
    wide = jnp.zeros((even, even), a.dtype).at[:n, :n].set(a)
    if even > n:
        wide = wide.at[n, n].set(2 * jnp.max(jnp.sum(jnp.abs(a), 1)) + 1)
    p, q, seats = np.arange(0, even, 2), np.arange(1, even, 2), _tournament(even)
    mates, pairs, sides = seats ^ 1, seats // 2, np.where(seats % 2, 1.0, -1.0)

    def turn(both: Array, c: Array, s: Array) -> Array:
        """Columns rotated by pairs, each then at its next seat."""
        return c[pairs] * both[:, seats] + (sides * s[pairs]) * both[:, mates]

    def meet(both: Array, _: None) -> tuple[Array, None]:
        small = both[p, q]
        theta = (both[q, q] - both[p, p]) / (2 * jnp.where(small == 0, 1.0, small))
        t = jnp.where(theta >= 0, 1.0, -1.0) / (jnp.abs(theta) + jnp.sqrt(theta * theta + 1))
        t = jnp.where(small == 0, 0.0, t)
        c = 1 / jnp.sqrt(1 + t * t)
        both = turn(both, c, t * c)  # of the matrix and of the vectors under it
        return jnp.concatenate([turn(both[:even].T, c, t * c).T, both[even:]]), None

    least = 1e-15 * jnp.max(jnp.abs(a))

    def unsettled(state: tuple[Array, Array]) -> Array:
        beside = jnp.where(np.eye(even, dtype=bool), 0.0, state[1][:even])
        return (state[0] < SWEEPS) & (jnp.max(jnp.abs(beside)) > least)

    both = jnp.concatenate([wide, jnp.eye(even, dtype=a.dtype)])

    def sweep(state):
        return (state[0] + 1, jax.lax.scan(meet, state[1], None, length=even - 1)[0])

    both = jax.lax.while_loop(unsettled, sweep, (jnp.zeros((), int), both))[1]
    values = jnp.diagonal(both[:even])
    order = jnp.argsort(values)[:n]
    return values[order], both[even : even + n][:, order]


@eigh.defjvp
def _eigh_jvp(primals, tangents):
    values, vectors = eigh(primals[0])
    inner = vectors.T @ ((tangents[0] + tangents[0].T) / 2) @ vectors
    gap = values[None] - values[:, None]
    turn = jnp.where(gap == 0, 0.0, inner / jnp.where(gap == 0, 1.0, gap))
    return (values, vectors), (jnp.diagonal(inner), vectors @ turn)


def array_module(array: Any) -> Any:
    """NumPy for its arrays, `jax.numpy` for any others."""
    return np if isinstance(array, np.ndarray) else jnp
