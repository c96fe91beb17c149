"""Dry friction at the joints over one step, with true sticking.

Given the velocity that each joint would reach without dry friction and the compliance of the
mechanism at the joints (the Delassus matrix A = d qd / d tau over the step), find the dry torque
`lam` that opposes motion: lam = +level_plus while sliding forwards, -level_minus while sliding
backwards, anything in between while sticking (Moreau's time-stepping). One joint is solved in
closed form; several by projected Gauss-Seidel, and once more with the sticking joints eliminated
where another one reverses.

A joint that reaches zero velocity inside the step slides for the fraction f of the step, then
sticks or leaves from zero for the remaining 1 - f; its path over the step is that of both parts.
That keeps the step second order through stick-slip and the event time differentiable.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxid.numerics.fast_math import dot, inverse
from jaxid.numerics.reverse import reversible


#: Gauss-Seidel stops when no dry torque changes by more than what makes this fraction of the step's
#: largest velocity change.
TOLERANCE = 1e-12
SWEEPS = 100
#: Squares of velocities below it underflow, and with them the derivative of a quotient: 0 / 0 where
#: a joint has come to rest.
_SMALLEST = 2.0**-500

Vector = Float[Array, " nq"]
Solved = tuple[Vector, Vector, Vector]


def soft(x: Array, minus: Array, plus: Array) -> Array:
    """x moved towards zero by `plus` from above and `minus` from below."""
    return x - jnp.clip(x, -minus, plus)


def _slide_or_stick(v0: Array, free: Array, minus: Array, plus: Array) -> tuple[Array, Array]:
    """End velocity of one joint, and what its mean velocity over the step differs from the mean of
    both ends.

    `minus`, `plus` are the velocity changes that the dry levels can make over the step.
    """
    direction = jnp.sign(v0)
    v1 = free - jnp.where(v0 > 0, plus, jnp.where(v0 < 0, -minus, 0.0))
    change = v0 - v1
    slides = v1 * direction > 0
    # Where it slides on f is not asked for, and must not be infinite: reverse mode would make 0 *
    # inf of it.
    f = v0 / jnp.where(slides | (jnp.abs(change) < _SMALLEST), 1.0, change)
    w = jnp.where(slides, v1, (1 - f) * soft(free - v0, minus, plus))
    return w, jnp.where(slides, 0.0, -((1 - f) * v0 + f * w) / 2)


def _smoothed(v0: Array, free: Array, minus: Array, plus: Array, eps: float) -> tuple[Array, Array]:
    """The same with the law tanh(v / eps) at the middle velocity, by Newton from the saturated
    law.
    """
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
    """Dry torques, end velocities, and the correction of the mean velocity over the step for joints
    that reversed or stopped.

    `v0` velocity at the start of the step, `free` at its end without dry friction, `lam` the
    prediction that Gauss-Seidel starts from. `smoothing_velocity` 0 means true sticking: a sticking
    joint gets velocity exactly 0.0.
    """
    if reversible() and v0.shape[0] > 1:
        return _implicit(smoothing_velocity, (v0, free, A, level_minus, level_plus), lam)[0]
    return _solve(v0, free, A, level_minus, level_plus, lam, smoothing_velocity)[0]


def _sweeping(
    v0: Vector, level_minus: Vector, level_plus: Vector, smoothing_velocity: float
) -> Callable[[Vector, Array, Vector], Solved]:
    """One sweep of Gauss-Seidel, (free, A, old torques) -> new ones, end velocities, corrections of
    the mean velocity.
    """
    nq = v0.shape[0]

    def law(j: int, alone: Array, a: Array) -> tuple[Array, Array]:
        if smoothing_velocity == 0:
            return _slide_or_stick(v0[j], alone, a * level_minus[j], a * level_plus[j])
        return _smoothed(v0[j], alone, a * level_minus[j], a * level_plus[j], smoothing_velocity)

    def sweep(free: Vector, A: Array, old: Vector) -> Solved:
        lam, w, mean = list(old), list(free), list(free)
        for j in range(nq):
            alone = free[j] - sum((A[j, k] * lam[k] for k in range(nq) if k != j), jnp.zeros(()))
            w[j], mean[j] = law(j, alone, A[j, j])
            lam[j] = (alone - w[j]) / A[j, j]
        return jnp.stack(lam), jnp.stack(w), jnp.stack(mean)

    return sweep


def _pinned(
    sweep: Callable[[Vector, Array, Vector], Solved],
    free: Vector,
    A: Array,
    old: Vector,
    held: Bool[Array, " nq"],
) -> Solved:
    """A sweep with the joints that are `held` at rest eliminated: what holds them answers at
    once.
    """
    nq = free.shape[0]
    both = held[:, None] & held[None, :]
    hold = jnp.where(
        both, inverse(jnp.where(both, A, jnp.eye(nq))), 0.0
    )  # what a velocity of the held joints takes
    others = jnp.where(held[:, None], jnp.eye(nq), A - dot(A, dot(hold, A)))
    new, w, mean = sweep(
        jnp.where(held, 0.0, free - dot(A, dot(hold, free))), others, jnp.where(held, 0.0, old)
    )
    new = jnp.where(held, dot(hold, free - dot(A, jnp.where(held, 0.0, new))), new)
    return new, jnp.where(held, 0.0, w), jnp.where(held, 0.0, mean)


def _solve(
    v0: Vector,
    free: Vector,
    A: Float[Array, "nq nq"],
    level_minus: Vector,
    level_plus: Vector,
    lam: Vector,
    smoothing_velocity: float,
) -> tuple[Solved, Bool[Array, " nq"], Bool[Array, ""]]:
    """`solve_dry`, the joints that were eliminated at last, and whether any were."""
    nq = v0.shape[0]
    sweep = _sweeping(v0, level_minus, level_plus, smoothing_velocity)
    first = sweep(free, A, lam)
    none = jnp.zeros(nq, bool), jnp.zeros((), bool)
    if nq == 1:
        return first, *none

    scale = jnp.max(jnp.abs(free - v0)) + 1e-300
    diagonal = jnp.stack([A[j, j] for j in range(nq)])

    def unsettled(carry):
        count, _, change = carry
        return (count < SWEEPS) & (change > TOLERANCE * scale)

    def again(carry):
        count, old, _ = carry
        new = sweep(free, A, old[0])
        return count + 1, new, jnp.max(jnp.abs(diagonal * (new[0] - old[0])))

    change = jnp.max(jnp.abs(diagonal * (first[0] - lam)))  # none where all slide on as predicted
    solved = jax.lax.while_loop(unsettled, again, (1, first, change))[1]
    if smoothing_velocity != 0:
        return solved, *none

    # A joint that reverses moves the torque that holds a sticking one within the step, so one mean
    # torque for both parts of the step would be wrong to first order. With the sticking joints
    # eliminated (what holds them answers at once), the others see the mechanism as it is while
    # those are held.
    def pinned(carry):
        count, old, held, _, _ = carry
        new, w, mean = _pinned(sweep, free, A, old[0], held)
        slips = held & ((new > level_plus) | (new < -level_minus))
        new = jnp.where(slips, jnp.clip(new, -level_minus, level_plus), new)
        change = jnp.where(jnp.any(slips), jnp.inf, jnp.max(jnp.abs(diagonal * (new - old[0]))))
        return count + 1, (new, w, mean), held & ~slips, change, jnp.any(slips)

    held = (v0 == 0) & (solved[1] == 0)
    turns = jnp.any(held) & jnp.any(solved[2] != 0)
    start = (0, solved, held, jnp.where(turns, jnp.inf, 0.0), turns)
    end = jax.lax.while_loop(
        lambda c: (c[0] < SWEEPS) & ((c[3] > TOLERANCE * scale) | c[4]), pinned, start
    )
    return end[1], end[2], turns


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _implicit(eps: float, given: tuple[Array, ...], lam: Vector) -> tuple[Solved, Array, Array]:
    """`_solve` with the derivative of the solution, which does not depend on where the sweeps
    began.
    """
    v0, free, A, level_minus, level_plus = given
    return _solve(v0, free, A, level_minus, level_plus, lam, eps)


@_implicit.defjvp
def _implicit_jvp(eps, primals, tangents):
    """Of torques x = S(x, given), which one more sweep S leaves as they are: dx = (1 - dS/dx)^-1
    dS/dgiven.
    """
    given, lam = primals
    solved, held, turns = _implicit(eps, given, lam)

    def again(x: Vector, given: tuple[Array, ...]) -> Solved:
        v0, free, A, minus, plus = given
        sweep = _sweeping(v0, minus, plus, eps)
        plain = sweep(free, A, x)
        if eps != 0:
            return plain
        return jax.tree.map(partial(jnp.where, turns), _pinned(sweep, free, A, x, held), plain)

    by_x = jax.jacfwd(again)(solved[0], given)
    _, moved = jax.jvp(lambda given: again(solved[0], given), (given,), (tangents[0],))
    # Lower triangular times a matrix of positive leading minors: no pivots are needed.
    dx = dot(inverse(jnp.eye(lam.shape[0]) - by_x[0]), moved[0])
    along = tuple(m + dot(J, dx) for m, J in zip(moved[1:], by_x[1:], strict=True))
    none = (np.zeros(held.shape, jax.dtypes.float0), np.zeros(turns.shape, jax.dtypes.float0))
    return (solved, held, turns), ((dx, *along), *none)
