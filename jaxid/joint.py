"""Dry friction at the joints over one step, with true sticking.

Given the velocity that each joint would reach without dry friction and the compliance of the mechanism at the joints (the
Delassus matrix A = d qd / d tau over the step), find the dry torque `lam` that opposes motion:
lam = +level_plus while sliding forwards, -level_minus while sliding backwards, anything in between while sticking
(Moreau's time-stepping). One joint is solved in closed form; several by projected Gauss-Seidel.

A joint that reaches zero velocity inside the step slides for the fraction f of the step, then sticks or leaves from zero
for the remaining 1 - f; its path over the step is that of both parts. That keeps the step second order through stick-slip
and the event time differentiable.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


#: Gauss-Seidel stops when no dry torque changes by more than what makes this fraction of the step's largest velocity change.
TOLERANCE = 1e-12
SWEEPS = 100

Vector = Float[Array, " nq"]


def soft(x: Array, minus: Array, plus: Array) -> Array:
    """x moved towards zero by `plus` from above and `minus` from below."""
    return x - jnp.clip(x, -minus, plus)


def _slide_or_stick(v0: Array, free: Array, minus: Array, plus: Array) -> tuple[Array, Array]:
    """End velocity of one joint, and what its mean velocity over the step differs from the mean of both ends.

    `minus`, `plus` are the velocity changes that the dry levels can make over the step.
    """
    direction = jnp.sign(v0)
    v1 = free - jnp.where(v0 > 0, plus, jnp.where(v0 < 0, -minus, 0.0))
    f = v0 / jnp.where(v0 == v1, 1.0, v0 - v1)
    slides = v1 * direction > 0
    w = jnp.where(slides, v1, (1 - f) * soft(free - v0, minus, plus))
    return w, jnp.where(slides, 0.0, -((1 - f) * v0 + f * w) / 2)


def _smoothed(v0: Array, free: Array, minus: Array, plus: Array, eps: float) -> tuple[Array, Array]:
    """The same with the law tanh(v / eps) at the middle velocity, by Newton from the saturated law."""
    b = (v0 + free) / 2
    r = jnp.where(b > 0, plus, minus) / 2
    m = jnp.where(jnp.abs(b) <= eps + r, b / (1 + r / eps), soft(b, r, r))
    for _ in range(4):
        th = jnp.tanh(m / eps)
        m = m - (m + r * th - b) / (1 + r * (1 - th * th) / eps)
    return 2 * m - v0, jnp.zeros_like(v0)


def solve_dry(
    v0: Vector,
    free: Vector,
    A: Float[Array, "nq nq"],
    level_minus: Vector,
    level_plus: Vector,
    lam: Vector,
    smoothing_velocity: float,
) -> tuple[Vector, Vector, Vector]:
    """Dry torques, end velocities, and the correction of the mean velocity over the step for joints that reversed or stopped.

    `v0` velocity at the start of the step, `free` at its end without dry friction, `lam` the prediction that Gauss-Seidel
    starts from. `smoothing_velocity` 0 means true sticking: a sticking joint gets velocity exactly 0.0.
    """
    nq = v0.shape[0]

    def law(v0: Array, free: Array, minus: Array, plus: Array) -> tuple[Array, Array]:
        if smoothing_velocity == 0:
            return _slide_or_stick(v0, free, minus, plus)
        return _smoothed(v0, free, minus, plus, smoothing_velocity)

    def sweep(old: Vector) -> tuple[Vector, Vector, Vector]:
        lam, w, mean = list(old), list(free), list(free)
        for j in range(nq):
            alone = free[j] - sum((A[j, k] * lam[k] for k in range(nq) if k != j), jnp.zeros(()))
            w[j], mean[j] = law(v0[j], alone, A[j, j] * level_minus[j], A[j, j] * level_plus[j])
            lam[j] = (alone - w[j]) / A[j, j]
        return jnp.stack(lam), jnp.stack(w), jnp.stack(mean)

    first = sweep(lam)
    if nq == 1:
        return first

    scale = jnp.max(jnp.abs(free - v0)) + 1e-300

    def unsettled(carry):
        count, _, change = carry
        return (count < SWEEPS) & (change > TOLERANCE * scale)

    def again(carry):
        count, old, _ = carry
        new = sweep(old[0])
        return count + 1, new, jnp.max(jnp.abs(jnp.diagonal(A) * (new[0] - old[0])))

    return jax.lax.while_loop(unsettled, again, (1, first, jnp.full((), jnp.inf)))[1]
