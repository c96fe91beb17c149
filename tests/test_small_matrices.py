"""Small factorisations against LAPACK, with derivatives, and many at once on two cores."""

from __future__ import annotations

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings

from jaxid.numerics.linalg import eigh, solve, whitening
from jaxid.numerics.precision import float64


def graded(rng: np.random.Generator, n: int) -> np.ndarray:
    """A positive definite matrix whose eigenvalues span many decades, as those of a beam do."""
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return (Q * np.geomspace(1.0, 1e8, n)) @ Q.T


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_against_lapack(seed):
    rng = np.random.default_rng(seed)
    a = graded(rng, 8)
    b = rng.normal(size=(6, 6)) + 1j * rng.normal(size=(6, 6))
    b[0, 0] = 0.0  # needs a pivot
    with float64():
        values, vectors = (np.asarray(x) for x in eigh(jnp.asarray(a)))
        W = np.asarray(whitening(jnp.asarray(a)))
        x = np.asarray(solve(jnp.asarray(b), jnp.eye(6)))
    np.testing.assert_allclose(
        values, np.linalg.eigvalsh(a), rtol=1e-6, atol=1e-7 * values.max() * 1e-8
    )
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(8), atol=1e-13)
    np.testing.assert_allclose(vectors @ np.diag(values) @ vectors.T, a, atol=1e-7)
    np.testing.assert_allclose(W @ a @ W.T, np.eye(8), atol=1e-6)
    assert np.allclose(W, np.tril(W))
    np.testing.assert_allclose(x, np.linalg.inv(b), rtol=1e-9, atol=1e-9)


def test_derivatives_against_differences():
    rng = np.random.default_rng(1)
    a, da = np.diag([1.0, 3.0, 7.0, 20.0, 50.0]) + 0.3, rng.normal(size=(5, 5))
    da = da + da.T

    def f(t):
        values, vectors = eigh(jnp.asarray(a) + t * da)
        return jnp.concatenate(
            [values, (vectors**2).ravel(), solve(jnp.asarray(a) + t * da, jnp.eye(5)).ravel()]
        )

    with float64():
        slope = np.asarray(jax.jvp(f, (0.0,), (1.0,))[1])
        h = 1e-5
        by_hand = (np.asarray(f(h)) - np.asarray(f(-h))) / (2 * h)
    np.testing.assert_allclose(slope, by_hand, rtol=1e-5, atol=1e-8)


def test_large_batches_come_back():
    """Two batched LAPACK solves in one program wait for each other for ever on two cores; these are
    loops of arithmetic.
    """
    a = np.array([graded(np.random.default_rng(k), 8) for k in range(1000)])
    with float64():
        both = jax.jit(
            jax.vmap(lambda a: (eigh(a)[0], solve(a, jnp.eye(8)), solve(a.T, jnp.eye(8))))
        )
        values, x, y = (np.asarray(o) for o in both(jnp.asarray(a)))
    assert np.isfinite(values).all() and np.isfinite(x).all() and np.isfinite(y).all()
