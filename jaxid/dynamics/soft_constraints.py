"""Dry friction, stops and contacts as MuJoCo has them: soft constraints on the acceleration.

A row of a joint wants the acceleration `target` and gives way by its `compliance` R (rad/s^2 per
N m). Dry friction opposes what exceeds its target, (a - target) / R, up to its level; a stop pushes
away from itself alone, and so does each edge of the pyramid that stands for the friction cone of a
contact, along its own row J of all joints. The accelerations a of all joints solve

    M a = force - friction(a) + stops(a) + J' contacts(J a),

whose right side falls with a: the minimum of a convex function that is quadratic piece by piece.
Newton's method with an exact search along each direction finds it in a few steps, to rounding. The
derivative is that of the piece in which it ends.

Source: MuJoCo's documentation, chapter Computation, "Constraint model" and "Solver parameters".
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.numerics.fast_math import dot, inverse


#: Most steps of Newton; three are usual. So many are tried whole before any is measured.
MOST, WHOLE = 60, 8
#: Accelerations that change by less than this share of themselves have been found.
ROUNDING = 1e-13
#: Least compliance, rad/s^2 per N m.
HARDEST = 1e-15
#: Where a stop is that does not exist, rad or m.
FAR = 1e9

Vector = Float[Array, " n"]


class Slip(NamedTuple):
    """How dry friction gives way: a joint that it holds loses its speed at `rate` (1/s), and
    `share` is its compliance over the inverse inertia of the joint.
    """

    rate: Any
    share: Any


class Stops(NamedTuple):
    """Ends of joints, [n] each, FAR where there is none, and how they give way: `stiffness` (1/s^2)
    and `rate` (1/s) towards the end, from a distance of `margin` on; the impedance rises from
    `softest` to `hardest` over `width` beyond it, with `midpoint` and `power` of that curve.
    """

    lower: Any
    upper: Any
    margin: Any
    stiffness: Any
    rate: Any
    softest: Any
    hardest: Any
    width: Any
    midpoint: Any
    power: Any


class Constraints(NamedTuple):
    """Constraints of n joints [n]: dry friction with its levels against motion backwards (`minus`)
    and forwards (`plus`), and one stop each. `side` is 1 where the stop pushes forwards, -1
    backwards, 0 where there is none.
    """

    target: Any
    compliance: Any
    minus: Any
    plus: Any
    side: Any
    stop_target: Any
    stop_compliance: Any


class Edges(NamedTuple):
    """Edges of the pyramids of m contacts: `rows` [m n] of a force of 1 along each, which pushes
    where its acceleration is less than `target` [m], and gives way by `compliance` [m]. A row of
    zeros with a target below 0 is an edge of nothing that touches.
    """

    rows: Any
    target: Any
    compliance: Any


class _Piece(NamedTuple):
    """Which quadratic an acceleration lies in, [n] each: whether friction holds, slides forwards or
    backwards, and whether the stop pushes; [m] whether an edge of a contact does, which is () where
    nothing can touch.
    """

    holds: Array
    forwards: Array
    backwards: Array
    pushes: Array
    touches: Any = ()


def rows_of(
    q: Vector,
    qd: Vector,
    minus: Vector,
    plus: Vector,
    slip: Slip,
    stops: Stops | None,
    weight: Vector,
) -> Constraints:
    """Constraints at positions q and speeds qd [n], with these levels of dry friction (N m, N);
    `weight` is the inverse inertia of each joint in the file's reference pose.
    """
    compliance = jnp.maximum(slip.share * weight, HARDEST)
    if stops is None:
        none = jnp.zeros_like(q)
        side, stop_target, stop_compliance = none, none, jnp.ones_like(q)
    else:
        side, stop_target, stop_compliance = _stop(q, qd, stops, weight)
    return Constraints(
        target=-slip.rate * qd,
        compliance=compliance,
        minus=minus,
        plus=plus,
        side=side,
        stop_target=stop_target,
        stop_compliance=stop_compliance,
    )


def _stop(q: Vector, qd: Vector, stops: Stops, weight: Vector) -> tuple[Vector, Vector, Vector]:
    """(side, target, compliance) of the nearer stop of each joint."""
    lower_is_nearer = q - stops.lower < stops.upper - q
    side = jnp.where(lower_is_nearer, 1.0, -1.0)
    distance = side * (q - jnp.where(lower_is_nearer, stops.lower, stops.upper))
    beyond = distance - stops.margin
    reached = beyond < 0
    share = impedance(beyond, stops)
    target = -stops.rate * side * qd - stops.stiffness * share * beyond
    compliance = jnp.maximum((1 - share) / share * weight, HARDEST)
    return (
        jnp.where(reached, side, 0.0),
        jnp.where(reached, target, 0.0),
        jnp.where(reached, compliance, 1.0),
    )


def impedance(beyond: Vector, stops: Any) -> Vector:
    """How much of an ideal stop (or contact) one is that is reached so far; `stops` has what
    `Stops` says of its impedance.
    """
    flat = (stops.softest == stops.hardest) | (stops.width <= HARDEST)
    x = jnp.clip(jnp.abs(beyond) / jnp.where(flat, 1.0, stops.width), 0.0, 1.0)
    m, p = stops.midpoint, stops.power
    first = m * (jnp.minimum(x, m) / m) ** p
    second = 1 - (1 - m) * ((1 - jnp.maximum(x, m)) / (1 - m)) ** p
    rising = stops.softest + jnp.where(x <= m, first, second) * (stops.hardest - stops.softest)
    return jnp.where(flat, (stops.softest + stops.hardest) / 2, rising)


def constrained(
    M: Float[Array, "n n"],
    force: Vector,
    rows: Constraints,
    guess: Vector,
    edges: Edges | None = None,
) -> tuple[Vector, Vector]:
    """Accelerations [n] of joints with the inertia M under a force, and the force that dry friction
    opposes to it; `guess` is where the search begins, and changes nothing in what it finds.
    """
    found = _search(*jax.lax.stop_gradient((M, force, rows, guess, edges)))
    piece = _piece(rows, found, edges)
    acceleration = _solved(M, force, rows, piece, edges)
    opposed = jnp.clip((acceleration - rows.target) / rows.compliance, -rows.minus, rows.plus)
    return acceleration, opposed


def _search(
    M: Array, force: Vector, rows: Constraints, guess: Vector, edges: Edges | None
) -> Vector:
    """An acceleration in the piece of the solution. Whole steps mostly find it, and cost less."""

    def newton(a):
        piece = _piece(rows, a, edges)
        b = _solved(M, force, rows, piece, edges)
        there = _piece(rows, b, edges)
        pairs = zip(jax.tree.leaves(piece), jax.tree.leaves(there), strict=True)
        return b, jnp.all(jnp.stack([jnp.all(x == y) for x, y in pairs]))

    def whole(carry):
        count, a, _ = carry
        return count + 1, *newton(a)

    def again(carry):
        count, a, _ = carry
        b, stays = newton(a)
        best = _best(M, force, rows, a, b - a, edges)
        step = (b - a) * jnp.where(stays, 1.0, best)
        small = jnp.max(jnp.abs(step)) <= ROUNDING * jnp.max(jnp.abs(a))
        return count + 1, a + step, stays | small

    def unsettled(most):
        return lambda carry: (carry[0] < most) & ~carry[2]

    tried = jax.lax.while_loop(unsettled(WHOLE), whole, (0, guess, jnp.zeros((), bool)))
    return jax.lax.while_loop(unsettled(MOST), again, tried)[1]


def _piece(rows: Constraints, a: Vector, edges: Edges | None) -> _Piece:
    slack = jax.lax.stop_gradient((a - rows.target) / rows.compliance)
    pushes = (rows.side != 0) & (rows.side * a < rows.stop_target)
    forwards, backwards = slack >= rows.plus, slack <= -rows.minus
    touches = () if edges is None else dot(edges.rows, a) < edges.target
    return _Piece(~(forwards | backwards), forwards, backwards & ~forwards, pushes, touches)


def _solved(
    M: Array, force: Vector, rows: Constraints, piece: _Piece, edges: Edges | None
) -> Vector:
    """Where the quadratic of a piece is least."""
    held = jnp.where(piece.holds, 1 / rows.compliance, 0.0)
    pushed = jnp.where(piece.pushes, 1 / rows.stop_compliance, 0.0)
    total = force + held * rows.target + pushed * rows.side * rows.stop_target
    total = total - jnp.where(piece.forwards, rows.plus, 0.0)
    total = total + jnp.where(piece.backwards, rows.minus, 0.0)
    curvature = M + jnp.diag(held + pushed)
    if edges is not None:
        hard = jnp.where(piece.touches, 1 / edges.compliance, 0.0)
        total = total + dot(edges.rows.T, hard * edges.target)
        curvature = curvature + dot(edges.rows.T * hard, edges.rows)
    return dot(inverse(curvature), total)


def _best(
    M: Array, force: Vector, rows: Constraints, a: Vector, d: Vector, edges: Edges | None
) -> Array:
    """How many times d leads from a to the least value along it. The slope is linear between the
    places where a joint or an edge goes over into another piece.
    """
    along, slope = dot(M, a) - force, dot(M, d)
    parts = [
        _crossing(rows.target + rows.plus * rows.compliance - a, d),
        _crossing(rows.target - rows.minus * rows.compliance - a, d),
        _crossing(rows.side * rows.stop_target - a, d),
        jnp.array([0.0, 1.0]),
    ]
    short = rising = jnp.zeros(0)
    if edges is not None:
        short, rising = edges.target - dot(edges.rows, a), dot(edges.rows, d)
        parts.append(_crossing(short, rising))
    places = jnp.concatenate(parts)
    there = a + places[:, None] * d
    opposed = jnp.clip((there - rows.target) / rows.compliance, -rows.minus, rows.plus)
    pushing = jnp.maximum(rows.stop_target - rows.side * there, 0.0) / rows.stop_compliance
    forces = along + places[:, None] * slope + opposed - rows.side * pushing
    slopes = jnp.sum(d * forces, -1)
    if edges is not None:
        pressed = jnp.maximum(short - places[:, None] * rising, 0.0) / edges.compliance
        slopes = slopes - jnp.sum(rising * pressed, -1)
    low = jnp.max(jnp.where(slopes <= 0, places, 0.0))
    high = jnp.min(jnp.where(slopes > 0, places, jnp.inf))
    at_low = jnp.max(jnp.where((places == low) & (slopes <= 0), slopes, -jnp.inf))
    at_high = jnp.min(jnp.where(places == high, slopes, jnp.inf))
    bounded = jnp.isfinite(high) & jnp.isfinite(at_low)
    share = -at_low / jnp.where(bounded, at_high - at_low, 1.0)
    within = low + share * (jnp.where(bounded, high, low) - low)
    return jnp.where(bounded, within, jnp.maximum(low, 1.0))


def _crossing(distance: Array, rate: Array) -> Array:
    """Where a distance is gone at a rate, 0 where it never is."""
    found = distance / jnp.where(rate == 0, 1.0, rate)
    return jnp.where((rate != 0) & (found > 0), found, 0.0)
