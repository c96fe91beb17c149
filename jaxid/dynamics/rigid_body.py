"""Rigid-body dynamics of a tree of joints: recursive Newton-Euler, composite rigid bodies, torque
regressor. An arm is a tree without branches.

The bodies stand in levels, each joined to one of the level before. Vectors are tuples of three
arrays of equal shape, in the frame of the body at hand, and each recursion is one loop over the
levels: `lax.scan` for JAX arrays, a plain loop for NumPy's. All arrays have the level first. What
stands behind it is worked on elementwise, so that it runs as vector code: nothing or the samples of
an arm ([n], [n samples]), the bodies of one level of a tree ([levels slots]). (Written out joint by
joint, XLA recomputes shared terms without limit.)

The inertia of a body is ten numbers that the torque is linear in, about the ORIGIN of its frame and
in its axes: Ixx Ixy Ixz Iyy Iyz Izz mx my mz m.

Sources: Luh, Walker, Paul 1980 (Newton-Euler); Featherstone, Rigid Body Dynamics Algorithms, 2008
(composite rigid body, chapter 6); Kane's virtual power for the regressor: the torque of joint k is
the sum over links of their partial velocity times wrench.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float


#: The ten inertial parameters of a link, in the order of every array here.
INERTIA = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "mx", "my", "mz", "m")

Vector = tuple[Any, Any, Any]


class Placements(NamedTuple):
    """Frame of each link in the frame before it: columns x, y, z of the rotation and the origin p,
    components [n ...].
    """

    x: Vector
    y: Vector
    z: Vector
    p: Vector


class Linkage(NamedTuple):
    """Joints and what they carry, level by level [n ...]."""

    turn: Vector  # axis of a hinge in the frame of its body, else 0
    slide: Vector | None  # axis of a slide, else 0; None where no joint slides
    inertia: tuple[Any, ...]  # ten numbers
    #: [n slots slots] of zeros and ones: from the slots of the level before. None: slot by slot.
    route: Any = None


class Base(NamedTuple):
    """Motion of the base in its own frame: angular velocity and acceleration, acceleration of its
    origin minus gravity.
    """

    w: Vector
    wd: Vector
    a: Vector


# ---- vectors as tuples of components


def add(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def inner(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def scaled(k: Any, a: Vector) -> Vector:
    return k * a[0], k * a[1], k * a[2]


def into(E: Placements, v: Vector) -> Vector:
    """A vector of the frame before, in the frame of the link."""
    return inner(E.x, v), inner(E.y, v), inner(E.z, v)


def out_of(E: Placements, v: Vector) -> Vector:
    """A vector of the link, in the frame before."""
    return add(scaled(v[0], E.x), add(scaled(v[1], E.y), scaled(v[2], E.z)))


def times(inertia: Sequence[Any], w: Vector) -> Vector:
    """Inertia matrix (the first six numbers) times a vector."""
    xx, xy, xz, yy, yz, zz = inertia[:6]
    return (
        xx * w[0] + xy * w[1] + xz * w[2],
        xy * w[0] + yy * w[1] + yz * w[2],
        xz * w[0] + yz * w[1] + zz * w[2],
    )


def _loop(step: Callable, carry: Any, xs: Any, reverse: bool = False) -> tuple[Any, Any]:
    """`lax.scan`, or the same as a plain loop where everything is NumPy."""
    if not all(isinstance(a, np.ndarray) for a in jax.tree.leaves(xs)):
        return jax.lax.scan(step, carry, xs, reverse=reverse)
    n = len(jax.tree.leaves(xs)[0])
    out: list[Any] = [None] * n
    for j in reversed(range(n)) if reverse else range(n):
        carry, out[j] = step(carry, jax.tree.map(lambda a: a[j], xs))
    return carry, jax.tree.map(lambda *rows: np.stack(rows), *out)


# ---- what the recursions need


def still(fall: Sequence[Any]) -> Base:
    """A base at rest in gravity; `fall` the vector of free fall in its frame, m/s^2: (0, 0, -9.81)
    for a robot that stands upright.
    """
    zero = 0.0 * fall[0]
    rest = (zero, zero, zero)
    return Base(rest, rest, (zero - fall[0], zero - fall[1], zero - fall[2]))


def chain_of(prismatic: Sequence[bool], batch: int, inertia: Any = None) -> Linkage:
    """The bodies of an arm whose joints have the z axes of their frames; `batch` is the number of
    axes behind the joints, `inertia` [n 10] (a regressor needs none).
    """

    def column(values: Any) -> Any:
        return values.reshape(len(prismatic), *(1,) * batch)

    slides = column(np.array(prismatic, np.float64))
    zero = np.zeros_like(slides)
    numbers = () if inertia is None else inertia.T
    return Linkage(
        turn=(zero, zero, 1 - slides),
        slide=(zero, zero, slides) if any(prismatic) else None,
        inertia=tuple(map(column, numbers)),
    )


def each_joint(n: int, batch: int) -> np.ndarray:
    """Which joint stands at which level of an arm: [level joint ...], ones on the diagonal."""
    return np.eye(n).reshape(n, n, *(1,) * batch)


def _rest(E: Placements, *others: Any) -> Any:
    """Zeros of the shape that all arrays have behind the levels."""
    return np.zeros(np.broadcast_shapes(*(a.shape[1:] for a in (E.x[0], *others))))


def _from_level_before(route: Any, parts: Any) -> Any:
    """Values at the slots of the level before [... slots], at the slots of their children."""
    if route is None:
        return parts
    return jax.tree.map(lambda v: jnp.sum(v[..., None, :] * route, -1), parts)


def _to_level_before(route: Any, parts: Any) -> Any:
    """Sums over the children [... slots] at the slots of their parents."""
    if route is None:
        return parts
    return jax.tree.map(lambda v: jnp.sum(v[..., :, None] * route, -2), parts)


def _from_base(route: Any) -> Any:
    """The route with the base's motion going to all slots of the first level."""
    if route is None:
        return None
    out = np.array(route)
    out[0] = np.eye(out.shape[1])
    return out


def _next(E: Placements, bodies: Linkage, motion: Base, qd: Any, qdd: Any) -> Base:
    """Motion of a body from that of the one before; rates and accelerations of its joint."""
    w, wd, a = motion
    a = into(E, add(a, add(cross(wd, E.p), cross(w, cross(w, E.p)))))
    w, wd = into(E, w), into(E, wd)
    if bodies.slide is not None:
        coriolis = cross(w, scaled(2 * qd, bodies.slide))
        a = add(a, add(scaled(qdd, bodies.slide), coriolis))
    rate = scaled(qd, bodies.turn)
    wd = add(wd, add(scaled(qdd, bodies.turn), cross(w, rate)))
    return Base(add(w, rate), wd, a)


def _along(bodies: Linkage, force: Vector, moment: Vector) -> Any:
    """What a joint carries of a force and a moment."""
    if bodies.slide is None:
        return inner(bodies.turn, moment)
    return inner(bodies.turn, moment) + inner(bodies.slide, force)


# ---- the recursions


def inverse_dynamics(
    E: Placements,
    bodies: Linkage,
    base: Base,
    qd: Float[Any, "n ..."],
    qdd: Float[Any, "n ..."],
) -> Float[Any, "n ..."]:
    """Joint torque (N m; N where a joint slides) of a motion, drive inertia and friction
    excluded.
    """

    def outwards(carry, x):
        E, bodies, qd, qdd = x
        carry = _from_level_before(bodies.route, carry)
        w, wd, a = _next(E, bodies, carry, qd, qdd)
        phi = bodies.inertia
        h = phi[6:9]
        force = add(scaled(phi[9], a), add(cross(wd, h), cross(w, cross(w, h))))
        moment = add(add(times(phi, wd), cross(w, times(phi, w))), cross(h, a))
        return Base(w, wd, a), (force, moment)

    def inwards(carry, x):
        E, bodies, force, moment = x
        force, moment = add(carry[0], force), add(carry[1], moment)
        tau = _along(bodies, force, moment)
        before = out_of(E, force)
        beyond = before, add(out_of(E, moment), cross(E.p, before))
        return _to_level_before(bodies.route, beyond), tau

    zero = _rest(E, qd, qdd)
    start = jax.tree.map(lambda component: component + zero, base)
    opened = bodies._replace(route=_from_base(bodies.route))
    _, (force, moment) = _loop(outwards, start, (E, opened, qd, qdd))
    none = (zero, zero, zero)
    return _loop(inwards, (none, none), (E, opened, force, moment), reverse=True)[1]


def mass_matrix(E: Placements, bodies: Linkage, at: np.ndarray) -> Float[Any, "n joints ..."]:
    """Joint space inertia without that of the drives, at and above its diagonal: force at each
    place per acceleration of each joint. `at` [n joints ...]: 1 where a joint stands.
    """

    def inwards(carry, x):
        E, bodies, at = x
        total, force, moment = carry
        total = tuple(a + b for a, b in zip(total, bodies.inertia, strict=True))
        h, m = total[6:9], total[9]
        # force and moment that give everything beyond this joint unit acceleration along it
        f, c = cross(bodies.turn, h), times(total, bodies.turn)
        if bodies.slide is not None:
            f, c = add(f, scaled(m, bodies.slide)), add(c, cross(h, bodies.slide))
        force, moment = add(force, scaled(at, f)), add(moment, scaled(at, c))
        row = _along(bodies, force, moment)
        before = out_of(E, force)
        beyond = moved(E, total), before, add(out_of(E, moment), cross(E.p, before))
        return _to_level_before(bodies.route, beyond), row

    zero = _rest(E)
    none = np.zeros((at.shape[1], *zero.shape))
    carry = ((zero,) * len(INERTIA), (none,) * 3, (none,) * 3)
    return _loop(inwards, carry, (E, bodies, at), reverse=True)[1]


def symmetric(upper: Float[Any, "n n ..."]) -> Float[Any, "n n ..."]:
    """A matrix from its entries at and above the diagonal, exactly symmetric."""
    n = upper.shape[0]
    diagonal = np.eye(n).reshape(n, n, *(1,) * (upper.ndim - 2))
    return upper + upper.swapaxes(0, 1) - upper * diagonal


def moved(E: Placements, inertia: Any) -> tuple[Any, ...]:
    """Ten numbers of a body, from a link's frame to the frame before (Steiner, for a frame that
    need not be central).
    """
    xx, xy, xz, yy, yz, zz, *h, m = inertia
    Ix, Iy, Iz = (out_of(E, row) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    h = out_of(E, (h[0], h[1], h[2]))
    p = E.p
    # R I R' row by row, and the parts of a moved origin: 2 (p.h) 1 - p h' - h p' + m ((p.p) 1 - p
    # p')
    g = add(h, scaled(m / 2, p))
    trace = 2 * inner(p, g)

    def entry(i: int, j: int) -> Any:
        turned = E.x[i] * Ix[j] + E.y[i] * Iy[j] + E.z[i] * Iz[j]
        shift = p[i] * g[j] + g[i] * p[j]
        return turned + (trace - shift if i == j else -shift)

    six = (entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2))
    return (*six, *add(h, scaled(m, p)), m + 0 * six[0])


def regressor(
    E: Placements,
    bodies: Linkage,
    base: Base,
    qd: Float[Any, "n ..."],
    qdd: Float[Any, "n ..."],
) -> Float[Any, "n n 10 ..."]:
    """Y[k, j]: torque of joint k per inertial parameter of link j, so that tau_k = sum_j Y[k, j]
    inertia_j. For arms.

    One loop over the links: each carries its motion and the partial velocities of all joints
    (angular `u`, linear `v`), and projects the wrench of its ten unit inertias onto them.
    """
    zero = _rest(E, qd, qdd)
    n = len(qd)

    def outwards(carry, x):
        motion, u, v = carry
        E, bodies, qd, qdd, at = x
        w, wd, a = _next(E, bodies, motion, qd, qdd)
        u, v = into(E, u), into(E, add(v, cross(u, E.p)))
        u = add(u, scaled(at, bodies.turn))
        if bodies.slide is not None:
            v = add(v, scaled(at, bodies.slide))
        t = cross(u, w)

        def both(i, j):
            return u[i] * wd[j] + u[j] * wd[i] + t[i] * w[j] + t[j] * w[i]

        turn = (
            u[0] * wd[0] + t[0] * w[0],
            both(0, 1),
            both(0, 2),
            u[1] * wd[1] + t[1] * w[1],
            both(1, 2),
            u[2] * wd[2] + t[2] * w[2],
        )
        first = add(cross(v, wd), add(cross(cross(v, w), w), cross(a, u)))
        return (Base(w, wd, a), u, v), (*turn, *first, inner(v, a))

    start = jax.tree.map(lambda component: component + zero, base)
    none = (np.zeros((n, *zero.shape)),) * 3
    xs = (E, bodies, qd, qdd, each_joint(n, zero.ndim))
    made = _loop(outwards, (start, none, none), xs)[1]
    # ten arrays [link joint *batch] -> [joint link 10 *batch]
    stack = np.stack if isinstance(made[0], np.ndarray) else jnp.stack
    return stack(made, 2).swapaxes(0, 1)


def poses(E: Placements, route: Any = None) -> Placements:
    """Frames of the links in the base frame instead of the frame before."""

    def outwards(carry, x):
        E, route = x
        up = _from_level_before(route, carry)
        here = Placements(
            out_of(up, E.x),
            out_of(up, E.y),
            out_of(up, E.z),
            add(up.p, out_of(up, E.p)),
        )
        return here, here

    zero = _rest(E)
    one = zero + 1
    base = Placements((one, zero, zero), (zero, one, zero), (zero, zero, one), (zero, zero, zero))
    return _loop(outwards, base, (E, _from_base(route)))[1]


def pseudo_inertia(inertia: np.ndarray) -> np.ndarray:
    """[... 10] as the matrices [... 4 4] that are positive definite exactly for bodies that can
    exist: [[tr(I) / 2 - I, h], [h', m]] (Wensing, Kim, Slotine 2018).
    """
    inertia = np.asarray(inertia, np.float64)
    xx, xy, xz, yy, yz, zz, hx, hy, hz, m = np.moveaxis(inertia, -1, 0)
    half = (xx + yy + zz) / 2
    rows = [
        [half - xx, -xy, -xz, hx],
        [-xy, half - yy, -yz, hy],
        [-xz, -yz, half - zz, hz],
        [hx, hy, hz, m],
    ]
    return np.stack([np.stack(r, -1) for r in rows], -2)


def about_origin(mass: Any, com: Any, central: Any) -> np.ndarray:
    """Ten numbers from mass (kg), centre of mass [3] (m) and inertia about it (kg m^2: Ixx Ixy Ixz
    Iyy Iyz Izz).
    """
    m, c = float(mass), np.asarray(com, np.float64)
    xx, xy, xz, yy, yz, zz = np.asarray(central, np.float64)
    x, y, z = c
    six = [
        xx + m * (y * y + z * z),
        xy - m * x * y,
        xz - m * x * z,
        yy + m * (x * x + z * z),
        yz - m * y * z,
        zz + m * (x * x + y * y),
    ]
    return np.array([*six, *(m * c), m])
