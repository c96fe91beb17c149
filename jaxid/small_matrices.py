"""Factorisations of small matrices in batches, as loops of arithmetic.

The batched LAPACK calls of XLA share their work out on the thread pool they run on: two of them at once can wait for each other
for ever on a machine with two cores. These do not, and for some ten rows they are faster too.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Inexact


SWEEPS = 10  # of Jacobi rotations; they converge quadratically, graded matrices within 7


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
    """W with W a W' = 1 and W lower triangular: the inverse of the Cholesky factor of a positive definite matrix."""
    n = a.shape[0]

    def eliminate(rows: Array, k: Array) -> tuple[Array, None]:
        row = rows[k] / jnp.sqrt(rows[k, k])
        below = jnp.where(jnp.arange(n) > k, rows[:, k] / row[k], 0.0)
        return (rows - below[:, None] * row).at[k].set(row), None

    return jax.lax.scan(eliminate, jnp.concatenate([a, jnp.eye(n, dtype=a.dtype)], 1), jnp.arange(n))[0][:, n:]


@jax.custom_jvp
def eigh(a: Float[Array, "n n"]) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """Eigenvalues of a symmetric matrix, rising, and its eigenvectors (columns), by cyclic Jacobi rotations; derivatives need
    distinct eigenvalues."""
    n = a.shape[0]
    pairs = np.tile(np.array([(p, q) for p in range(n) for q in range(p + 1, n)]), (SWEEPS, 1))

    def rotate(both: Array, pair: Array) -> tuple[Array, None]:
        p, q = pair
        small = both[p, q]
        theta = (both[q, q] - both[p, p]) / (2 * jnp.where(small == 0, 1.0, small))
        t = jnp.where(theta >= 0, 1.0, -1.0) / (jnp.abs(theta) + jnp.sqrt(theta * theta + 1))
        t = jnp.where(small == 0, 0.0, t)
        c = 1 / jnp.sqrt(1 + t * t)
        s = t * c
        one, two = both[:, p], both[:, q]  # of the matrix and of the vectors under it
        both = both.at[:, p].set(c * one - s * two).at[:, q].set(s * one + c * two)
        one, two = both[p], both[q]
        return both.at[p].set(c * one - s * two).at[q].set(s * one + c * two), None

    if n == 1:
        return a[0], jnp.ones_like(a)
    both = jax.lax.scan(rotate, jnp.concatenate([a, jnp.eye(n, dtype=a.dtype)]), jnp.asarray(pairs))[0]
    values = jnp.diagonal(both[:n])
    order = jnp.argsort(values)
    return values[order], both[n:][:, order]


@eigh.defjvp
def _eigh_jvp(primals, tangents):
    values, vectors = eigh(primals[0])
    inner = vectors.T @ ((tangents[0] + tangents[0].T) / 2) @ vectors
    gap = values[None] - values[:, None]
    turn = jnp.where(gap == 0, 0.0, inner / jnp.where(gap == 0, 1.0, gap))
    return (values, vectors), (jnp.diagonal(inner), vectors @ turn)
