"""The nodes of a robot's tree as the levels of `jaxid.dynamics.rigid_body`, and what its base does.

Nodes of equal depth are one vector. A node stands in the slot of its parent; where a body carries
several, the others take slots of their own, so that a level is the level above it routed by a
matrix of zeros and ones (by nothing, where limbs part at the base alone). Places without a node
hold a massless body on a rigid joint.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.dynamics import rigid_body
from jaxid.dynamics.mechanism import Free
from jaxid.dynamics.rigid_body import (
    add,
    Base,
    cross,
    inner,
    Linkage,
    Placements,
    scaled,
    symmetric,
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
    as three matrices by rows with R(q) = R0 + sin(q) R1 + (1 - cos(q)) R2, origins, the bodies on
    their joints, and bodies (ten numbers) whose weight something else carries.
    """

    R0: tuple[Vector, Vector, Vector]
    R1: tuple[Vector, Vector, Vector]
    R2: tuple[Vector, Vector, Vector]
    p: Vector
    bodies: Linkage
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
        bodies=Linkage(
            turn=parts(hinge),
            slide=parts(sliding) if any(slides) else None,
            inertia=tuple(every[30:40]),
            route=plan.route,
        ),
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
    if body.bodies.slide is None:
        return Placements(x, y, z, body.p)
    along = body.bodies.slide
    return Placements(
        x, y, z, add(body.p, scaled(here, tuple(inner(row, along) for row in body.R0)))
    )  # type: ignore[arg-type]


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
    v, a = spread(plan, qd), spread(plan, qdd)
    tau = rigid_body.inverse_dynamics(E, body.bodies, base, v, a)
    if body.lifted is not None:
        zero = tuple(0.0 * part for part in base.a)
        at_rest = Base(zero, zero, base.a)  # pyright: ignore
        lifted = body.bodies._replace(inertia=body.lifted)
        tau = tau - rigid_body.inverse_dynamics(E, lifted, at_rest, 0 * v, 0 * a)
    return gathered(plan, tau)


def mass_matrix(plan: TreePlan, body: Body, E: Placements) -> Float[Array, "n n"]:
    """Joint space inertia without armature; exactly symmetric."""
    n = len(plan.at)
    at = np.zeros((plan.levels * plan.slots, n))
    at[plan.at, np.arange(n)] = 1.0
    at = at.reshape(plan.levels, plan.slots, n).swapaxes(1, 2)
    upper = rigid_body.mass_matrix(E, body.bodies, at)
    return symmetric(gathered(plan, upper.swapaxes(1, 2)))


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


def poses(plan: TreePlan, E: Placements) -> Placements:
    """Frames of the nodes in the base's frame, components [n]."""
    found = rigid_body.poses(E, plan.route)
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


def outlined(origin: Float[Array, "n 3"], tilt: Any, parent: tuple[int, ...]) -> Any:
    """Origins of the nodes in the base's frame, and the base's own, along the walk of `tour` in the
    world: [places 3]; the base is turned by `tilt` (roll, pitch, yaw).
    """
    R = jnp.stack([jnp.stack(row) for row in turn(*tilt)])
    places = jnp.concatenate([origin, jnp.zeros((1, 3))]) @ R.T
    return places[np.array(tour(parent))]


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
