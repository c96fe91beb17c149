"""Arithmetic that XLA's CPU compiler turns into vector code.

Measured: float64 `sin` and `cos` are one scalar library call an element and are copied into every
consumer; batched `@` of small matrices is not fused; a cheap value with many readers is recomputed
in each. Inside a simulation step use these instead.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.numerics.reverse import reversible


def fence(x: Float[Array, ...]) -> Float[Array, ...]:
    """x unchanged, but computed once however many readers it has (a division is not copied into
    consumers).
    """
    return x if reversible() else _fenced(x)


@jax.custom_jvp
def _fenced(x: Float[Array, ...]) -> Float[Array, ...]:
    return x / (1 + 0 * x)


@_fenced.defjvp
def _fenced_jvp(primals, tangents):
    return _fenced(primals[0]), _fenced(
        tangents[0]
    )  # not linear as it is written: reverse mode could not pass it


def dot(a: Float[Array, "n m"], x: Float[Array, ...]) -> Float[Array, ...]:
    """Matrix times vector or matrix as products and sums."""
    return jnp.sum(a * x, -1) if x.ndim == 1 else jnp.sum(a[:, :, None] * x[None], 1)


def inverse(a: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Inverse of a small matrix whose leading minors are positive (a mass matrix, 1 + compliance
    times slopes): closed form up to two rows, Gauss-Jordan elimination beyond, in a loop and
    without pivots, which batched LAPACK calls cannot match.
    """
    if a.shape[-1] == 1:
        return 1 / a
    if a.shape[-1] == 2:
        (p, q), (r, s) = a
        return jnp.stack([jnp.stack([s, -q]), jnp.stack([-r, p])]) / (p * s - q * r)
    n = a.shape[-1]

    def eliminate(rows: Array, k: Array) -> tuple[Array, None]:
        row = rows[k] / rows[k, k]
        return (rows - rows[:, k, None] * row).at[k].set(row), None

    return jax.lax.scan(
        eliminate, jnp.concatenate([a, jnp.eye(n, dtype=a.dtype)], 1), jnp.arange(n)
    )[0][:, n:]


# Minimax coefficients of sin(r)/r and cos(r) on |r| <= pi/4 (the classical ones of fdlibm's kernel
# functions).
_SIN = (
    1.58969099521155010221e-10,
    -2.50507602534068634195e-08,
    2.75573137070700676789e-06,
    -1.98412698298579493134e-04,
    8.33333333332248946124e-03,
    -1.66666666666666324348e-01,
)
_COS = (
    -1.13596475577881948265e-11,
    2.08757232129817482790e-09,
    -2.75573143513906633035e-07,
    2.48015872894767294178e-05,
    -1.38888888888741095749e-03,
    4.16666666666666019037e-02,
)
# pi/2 in three parts with trailing zeros, so that k * part is exact for |k| < 2^20.
_PI_2 = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)


@jax.custom_jvp
def sincos(x: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
    """(sin x, cos x) by arithmetic alone; absolute error below 3e-16 for |x| < 1e5. Call it once on
    a whole vector.
    """
    k = jnp.round(x * (2 / jnp.pi))
    r = ((x - k * _PI_2[0]) - k * _PI_2[1]) - k * _PI_2[2]
    z = r * r
    s, c = _SIN[0], _COS[0]
    for a, b in zip(_SIN[1:], _COS[1:], strict=True):
        s, c = s * z + a, c * z + b
    s, c = r + r * z * s, 1 - z / 2 + z * z * c
    quadrant = k - 4 * jnp.floor(k / 4)
    odd = (quadrant == 1) | (quadrant == 3)
    sine = jnp.where(odd, c, s) * jnp.where(quadrant >= 2, -1.0, 1.0)
    cosine = jnp.where(odd, s, c) * jnp.where((quadrant == 1) | (quadrant == 2), -1.0, 1.0)
    return sine, cosine


@sincos.defjvp
def _sincos_jvp(primals, tangents):
    s, c = sincos(primals[0])
    return (s, c), (c * tangents[0], -s * tangents[0])


def sin(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return sincos(x)[0]


def cos(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return sincos(x)[1]
