"""Rigid-body dynamics of a tree of joints: recursive Newton-Euler and composite rigid bodies, level
by level.

Nodes of equal depth are one vector. A node stands in the slot of its parent; where a body carries
several, the others take slots of their own, so that a level is the level above it routed by a
matrix of zeros and ones (by nothing, where limbs part at the base alone). Each recursion is one
`lax.scan` over the levels; places without a node hold a massless body on a rigid joint.

Sources: Luh, Walker, Paul 1980; Featherstone, Rigid Body Dynamics Algorithms, 2008 (composite rigid
body, chapter 6).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.dynamics.mechanism import Free
from jaxid.dynamics.rigid_body import (
    add,
    cross,
    inner,
    into,
    moved,
    out_of,
    Placements,
    scaled,
    times,
    Vector,
)
from jaxid.numerics.fast_math import dot, inverse, sincos


class TreePlan(NamedTuple):
    """Where the nodes of a tree stand: `at` [n] = level * slots + slot; `source` [levels * slots]
    the node there, or n; `route` [levels slots slots] or None.
    """

    levels: int
    slots: int
    at: np.ndarray
    source: np.ndarray
    route: np.ndarray | None

    @property
    def dense(self) -> bool:
        """Whether the nodes fill the places in their own order."""
        return np.array_equal(self.at, np.arange(self.levels * self.slots))


def plan(parent: tuple[int, ...]) -> TreePlan:
    """Levels and slots of a tree whose parents stand before their children."""
    level, slot, taken, slots = [], [], set(), 0
    for k, up in enumerate(parent):
        level.append(0 if up < 0 else level[up] + 1)
        if up >= 0 and up not in taken:
            slot.append(slot[up])
            taken.add(up)
        else:
            slot.append(slots)
            slots += 1
    levels = 1 + max(level, default=0)
    route = np.zeros((levels, slots, slots))
    for k, up in enumerate(parent):
        if up >= 0:
            route[level[k], slot[k], slot[up]] = 1.0
    plain = all(up < 0 or slot[k] == slot[up] for k, up in enumerate(parent))
    at = np.array([a * slots + b for a, b in zip(level, slot, strict=True)], int)
    source = np.full(levels * slots, len(parent))
    source[at] = np.arange(len(parent))
    return TreePlan(levels, slots, at, source, None if plain else route)


def spread(plan: TreePlan, values: Any) -> Any:
    """Numbers of the nodes [... n] at their places [... levels slots], zero where there is no
    node.
    """
    if not plan.dense:
        xp: Any = np if isinstance(values, np.ndarray) else jnp
        values = xp.concatenate([values, 0 * values[..., :1]], -1)[..., plan.source]
    return values.reshape(*values.shape[:-1], plan.levels, plan.slots)


def gathered(plan: TreePlan, places: Any) -> Any:
    """Numbers at the places [levels slots ...] by nodes [n ...]."""
    flat = places.reshape(plan.levels * plan.slots, *places.shape[2:])
    return flat if plan.dense else flat[plan.at]


class Body(NamedTuple):
    """What does not depend on the state, all at the places [levels slots]: frames at the reference
    as three matrices by rows with R(q) = R0 + sin(q) R1 + (1 - cos(q)) R2, origins, axes split by
    kind, inertia (ten), the route, and bodies (ten) whose weight something else carries.
    """

    R0: tuple[Vector, Vector, Vector]
    R1: tuple[Vector, Vector, Vector]
    R2: tuple[Vector, Vector, Vector]
    p: Vector
    turn: Vector  # axis of a hinge, else 0
    slide: Vector | None  # axis of a slide, in the node's frame, else 0; None where no joint slides
    inertia: tuple[Any, ...]
    route: Any
    lifted: tuple[Any, ...] | None = None  # None: nothing carries any weight


def body(
    plan: TreePlan,
    slides: tuple[bool, ...],
    axis: np.ndarray,
    place: Float[Array, "6 n"],
    inertia: Float[Array, "n 10"],
    lifted: np.ndarray | None = None,
) -> Body:
    """`place`: x y z roll pitch yaw of each node in its parent's frame; `axis` [n 3]; `inertia`
    and `lifted` [n 10] about the node's origin.
    """
    (sr, cr), (sp, cp), (sy, cy) = (sincos(place[k]) for k in (3, 4, 5))
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    hinge = np.where(np.array(slides, bool)[:, None], 0.0, axis)
    sliding = axis - hinge
    a = (hinge[:, 0], hinge[:, 1], hinge[:, 2])
    # R0 K and R0 K K of the axis' cross product matrix K: rows times axis
    first = tuple(cross(row, a) for row in rows)
    second = tuple(cross(row, a) for row in first)
    turns = [jnp.asarray(v) for v in chain.from_iterable((*rows, *first, *second))]
    every = spread(plan, jnp.concatenate([jnp.stack(turns), place[:3], inertia.T]))
    empty = 1 - spread(plan, np.ones(len(slides)))
    every = every if plan.dense else every.at[np.array([0, 4, 8])].add(empty)

    def matrix(k):
        return tuple(tuple(every[k + 3 * i + j] for j in range(3)) for i in range(3))

    def parts(v):
        return tuple(spread(plan, v.T.copy()))

    return Body(
        R0=matrix(0),  # pyright: ignore
        R1=matrix(9),  # pyright: ignore
        R2=matrix(18),  # pyright: ignore
        p=tuple(every[27:30]),  # type: ignore[arg-type]
        turn=parts(hinge),
        slide=parts(sliding) if any(slides) else None,
        inertia=tuple(every[30:40]),
        route=plan.route,  # type: ignore[arg-type]
        lifted=None if lifted is None else parts(lifted),
    )


def frames(plan: TreePlan, body: Body, q: Float[Array, " n"]) -> Placements:
    """Frame of each place in the frame before it; `q` from the reference."""
    here = spread(plan, q)
    s, c = sincos(here)
    rows = []
    for a, b, d in zip(body.R0, body.R1, body.R2, strict=True):
        rows.append([r0 + s * r1 + (1 - c) * r2 for r0, r1, r2 in zip(a, b, d, strict=True)])
    x, y, z = ((rows[0][k], rows[1][k], rows[2][k]) for k in range(3))
    if body.slide is None:
        return Placements(x, y, z, body.p)
    along = body.slide
    return Placements(
        x, y, z, add(body.p, scaled(here, tuple(inner(row, along) for row in body.R0)))
    )  # type: ignore[arg-type]


def _routed(route: Any, parts: Any) -> Any:
    """Values of the level above at the slots of their children; `route` None: where they are."""
    return parts if route is None else jax.tree.map(lambda v: dot(route, v), parts)


def _summed(route: Any, parts: Any) -> Any:
    """Sums over the children at the slots of their parents."""
    return parts if route is None else jax.tree.map(lambda v: dot(route.T, v), parts)


class Base(NamedTuple):
    """Motion of the base in its own frame: angular velocity and acceleration, acceleration of its
    origin minus gravity.
    """

    w: Vector
    wd: Vector
    a: Vector


def still(fall: Vector) -> Base:
    """A base at rest in gravity; `fall` the vector of free fall in its frame, m/s^2."""
    zero = 0.0 * fall[0]
    rest = (zero, zero, zero)
    return Base(rest, rest, (zero - fall[0], zero - fall[1], zero - fall[2]))


def inverse_dynamics(
    plan: TreePlan,
    body: Body,
    E: Placements,
    base: Base,
    qd: Float[Array, " n"],
    qdd: Float[Array, " n"],
) -> Float[Array, " n"]:
    """Force or torque at every joint for a motion; armature, damping, friction and springs
    excluded, and the weight of what is lifted.
    """
    tau = _moving(plan, body, E, base, qd, qdd)
    if body.lifted is None:
        return tau
    zero = tuple(0.0 * part for part in base.a)
    at_rest = Base(zero, zero, base.a)  # pyright: ignore
    weight = _moving(plan, body._replace(inertia=body.lifted), E, at_rest, 0 * qd, 0 * qdd)
    return tau - weight


def _moving(
    plan: TreePlan,
    body: Body,
    E: Placements,
    base: Base,
    qd: Float[Array, " n"],
    qdd: Float[Array, " n"],
) -> Float[Array, " n"]:
    """The same, the weight of what is lifted among it."""
    v, a = spread(plan, qd), spread(plan, qdd)

    def outwards(carry, x):
        E, turn, slide, v, a, phi, route = x
        w, wd, acc = _routed(route, carry)
        acc = into(E, add(acc, add(cross(wd, E.p), cross(w, cross(w, E.p)))))
        w, wd = into(E, w), into(E, wd)
        if slide is not None:
            acc = add(acc, add(scaled(a, slide), scaled(2 * v, cross(w, slide))))
        wd = add(wd, add(scaled(a, turn), scaled(v, cross(w, turn))))
        w = add(w, scaled(v, turn))
        h = phi[6:9]
        force = add(scaled(phi[9], acc), add(cross(wd, h), cross(w, cross(w, h))))
        moment = add(add(times(phi, wd), cross(w, times(phi, w))), cross(h, acc))
        return (w, wd, acc), (force, moment)

    def inwards(carry, x):
        E, turn, slide, force, moment, route = x
        force, moment = add(carry[0], force), add(carry[1], moment)
        tau = inner(turn, moment) if slide is None else inner(turn, moment) + inner(slide, force)
        before = out_of(E, force)
        return _summed(route, (before, add(out_of(E, moment), cross(E.p, before)))), tau

    row = jnp.zeros(plan.slots)
    start = jax.tree.map(lambda c: c + row, tuple(base))
    first = None if body.route is None else jnp.asarray(_opened(body.route))
    _, (force, moment) = jax.lax.scan(
        outwards, start, (E, body.turn, body.slide, v, a, body.inertia, first)
    )
    zero = (row, row, row)
    tau = jax.lax.scan(
        inwards, (zero, zero), (E, body.turn, body.slide, force, moment, first), reverse=True
    )[1]
    return gathered(plan, tau)


def _opened(route: np.ndarray) -> np.ndarray:
    """The route with the base's motion going to all slots of the first level."""
    out = route.copy()
    out[0] = np.eye(route.shape[1])
    return out


def mass_matrix(plan: TreePlan, body: Body, E: Placements) -> Float[Array, "n n"]:
    """Joint space inertia without armature; exactly symmetric."""
    n = len(plan.at)
    own = np.zeros((plan.levels * plan.slots, n))
    own[plan.at, np.arange(n)] = 1.0
    own = own.reshape(plan.levels, plan.slots, n)

    # beside the joints that cause a force
    def column(v):
        return v[:, None]

    def inwards(carry, x):
        E, turn, slide, phi, own, route = x
        total, force, moment = carry
        total = tuple(a + b for a, b in zip(total, phi, strict=True))
        h, m = total[6:9], total[9]
        # force and moment that give everything beyond this joint unit acceleration along it
        f, c = cross(turn, h), times(total, turn)
        if slide is not None:
            f, c = add(f, scaled(m, slide)), add(c, cross(h, slide))
        force = tuple(b + own * column(a) for a, b in zip(f, force, strict=True))
        moment = tuple(b + own * column(a) for a, b in zip(c, moment, strict=True))
        row = inner(tuple(map(column, turn)), moment)  # type: ignore[arg-type]
        row = row if slide is None else row + inner(tuple(map(column, slide)), force)  # type: ignore[arg-type]
        wide = jax.tree.map(column, E)
        before = out_of(wide, force)
        after = add(out_of(wide, moment), cross(wide.p, before))
        return _summed(route, (moved(E, total), before, after)), row

    zero, wide = jnp.zeros(plan.slots), jnp.zeros((plan.slots, n))
    carry = ((zero,) * 10, (wide,) * 3, (wide,) * 3)
    xs = (E, body.turn, body.slide, body.inertia, own, body.route)
    upper = gathered(plan, jax.lax.scan(inwards, carry, xs, reverse=True)[1])
    return upper + upper.T - upper * np.eye(n)


#: A joint that a law holds so tightly that it swings by more than sqrt(2) rad in a step is taken to
#: be so much heavier; twice as tightly held, the step would run away from it.
LIGHTEST = 0.5


def middle_step(
    matrices: Callable[[Any, Any], tuple[Any, Any]],
    h: Any,
    x: tuple[Any, Any],
    tau: Any,
    qd: Any,
    slope: Any,
    stiffness: Any,
) -> tuple[Free, Any, Any]:
    """`Mechanism.damped` of a rigid mechanism with these `matrices` of (q, qd), by its forces in
    the middle of the step alone: second order, and one evaluation where the scheme of Runge and
    Kutta takes four.
    """
    q, v = x
    M, bias = matrices(q + h / 2 * v, qd)
    D, push = (
        (jnp.diag(slope), slope * (v - qd)) if slope.ndim == 1 else (slope, dot(slope, v - qd))
    )
    unresolved = jnp.maximum(LIGHTEST * h * h * stiffness - jnp.sum(M * np.eye(len(v)), -1), 0.0)
    A = h * inverse(M + h / 2 * D + jnp.diag(unresolved))
    w = v + dot(A, tau - bias - push)
    return Free(w, A, q + h / 2 * (v + w)), w, A


def poses(plan: TreePlan, E: Placements, route: Any) -> Placements:
    """Frames of the nodes in the base's frame, components [n]."""

    def outwards(carry, x):
        E, route = x
        up = _routed(route, carry)
        here = Placements(
            out_of(up, E.x), out_of(up, E.y), out_of(up, E.z), add(up.p, out_of(up, E.p))
        )
        return here, here

    one, zero = jnp.ones(plan.slots), jnp.zeros(plan.slots)
    start = Placements((one, zero, zero), (zero, one, zero), (zero, zero, one), (zero, zero, zero))
    found = jax.lax.scan(outwards, start, (E, None if route is None else _opened(route)))[1]
    return jax.tree.map(lambda v: gathered(plan, v), found)


def turn(roll: Any, pitch: Any, yaw: Any) -> tuple[tuple[Any, ...], ...]:
    """Rows of Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, cr), (sp, cp), (sy, cy) = (sincos(jnp.asarray(a)) for a in (roll, pitch, yaw))
    return (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )


def falling(angles: Any, gravity: Float[Array, " 3"], tilt: Any = None) -> tuple[Any, ...]:
    """`gravity`, a vector of free fall in the world, in the frame of a base turned by its roll,
    pitch and yaw, and by a `tilt` (angle, axis) further.
    """
    R = turn(*angles)
    x, y, z = R
    fall: Any = tuple(x[k] * gravity[0] + y[k] * gravity[1] + z[k] * gravity[2] for k in range(3))
    if tilt is not None:  # v cos - (axis x v) sin + axis (axis . v) (1 - cos)
        angle, axis = tilt
        sine, cosine = sincos(angle)
        along, across = (
            scaled((1 - cosine) * inner(axis, fall), axis),
            scaled(-sine, cross(axis, fall)),
        )
        fall = add(scaled(cosine, fall), add(along, across))
    return fall


def angular_velocity(angles: Float[Array, " 3"], rates: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Of a frame turned by Rz(yaw) Ry(pitch) Rx(roll), in itself."""
    (sr, cr), (sp, cp) = sincos(angles[0]), sincos(angles[1])
    roll, pitch, yaw = rates
    return jnp.stack([roll - yaw * sp, pitch * cr + yaw * sr * cp, yaw * cr * cp - pitch * sr])


def tour(parent: tuple[int, ...]) -> list[int]:
    """Nodes in the order of a walk out along every limb and back; -1, the base, begins and ends
    it.
    """
    walk: list[int] = [-1]

    def visit(node: int) -> None:
        for k, up in enumerate(parent):
            if up == node:
                walk.append(k)
                visit(k)
                walk.append(node)

    visit(-1)
    return walk
