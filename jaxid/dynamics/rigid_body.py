"""Rigid-body dynamics of a serial chain: recursive Newton-Euler, composite rigid body, torque
regressor.

Every link carries a frame whose z axis is the axis of its own joint. Vectors are tuples of three
arrays of equal shape, in the frame of the link at hand, and each recursion is one loop over the
joints: `lax.scan` for JAX arrays, a plain loop for NumPy's. All arrays have the joint first and may
have any number of batch axes behind it ([n], or [n samples]); the arithmetic is elementwise, so
that a batch runs as vector code. (Written out joint by joint, XLA recomputes shared terms without
limit.)

The inertia of a link is ten numbers that the torque is linear in, about the ORIGIN of its frame and
in its axes: Ixx Ixy Ixz Iyy Iyz Izz mx my mz m.

Sources: Luh, Walker, Paul 1980 (Newton-Euler); Featherstone, Rigid Body Dynamics Algorithms, 2008
(composite rigid body); Kane's virtual power for the regressor: the torque of joint k is the sum
over links of their partial velocity times wrench.
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


def _rows(a: Any, like: Any) -> tuple[Any, ...]:
    """Columns of an array [n k] as k arrays that broadcast against `like` [n ...]."""
    return tuple(a[:, i].reshape(a.shape[0], *(1,) * (like.ndim - 1)) for i in range(a.shape[1]))


class _Split(NamedTuple):
    """Rates of revolute and of prismatic joints, each zero for the other kind; None where a chain
    has no such joint.
    """

    revolute: Any
    prismatic: Any


def _split(prismatic: Sequence[bool], rate: Any) -> _Split:
    mask = np.array(prismatic, np.float64).reshape(-1, *(1,) * (rate.ndim - 1))
    if not any(prismatic):
        return _Split(rate, None)
    return _Split((1 - mask) * rate, mask * rate)


def _pick(prismatic: Sequence[bool], like: Any) -> Any:
    """1 for a prismatic joint, 0 for a revolute one, [n 1 ...]; None where all are revolute."""
    if not any(prismatic):
        return None
    return np.array(prismatic, np.float64).reshape(-1, *(1,) * (like.ndim - 1)) + 0 * like


def _motion(
    E: Placements, w: Vector, wd: Vector, a: Vector, qd: _Split, qdd: _Split
) -> tuple[Vector, Vector, Vector]:
    """Angular velocity, angular acceleration and acceleration of the origin, from one link to the
    next.
    """
    a = into(E, add(a, add(cross(wd, E.p), cross(w, cross(w, E.p)))))
    w, wd = into(E, w), into(E, wd)
    if qd.prismatic is not None:
        v = 2 * qd.prismatic
        a = a[0] + w[1] * v, a[1] - w[0] * v, a[2] + qdd.prismatic
    wd = wd[0] + w[1] * qd.revolute, wd[1] - w[0] * qd.revolute, wd[2] + qdd.revolute
    return (w[0], w[1], w[2] + qd.revolute), wd, a


def _start(gravity: Sequence[Any], qdd: Any) -> tuple[Vector, Vector, Vector]:
    zero = 0 * qdd[0]
    rest = (zero, zero, zero)
    return rest, rest, (zero - gravity[0], zero - gravity[1], zero - gravity[2])


def inverse_dynamics(
    E: Placements,
    prismatic: Sequence[bool],
    inertia: Float[Any, "n 10"],
    gravity: Sequence[Any],
    qd: Float[Any, "n ..."],
    qdd: Float[Any, "n ..."],
) -> Float[Any, "n ..."]:
    """Joint torque (N m; N at prismatic joints) of a motion, drive inertia and friction excluded.

    `gravity` is the vector of free fall in the base frame, m/s^2, (0, 0, -9.81) for a robot that
    stands upright.
    """

    def outwards(carry, x):
        E, qd, qdd, phi = x
        w, wd, a = carry
        w, wd, a = _motion(E, w, wd, a, qd, qdd)
        h = phi[6:9]
        force = add(scaled(phi[9], a), add(cross(wd, h), cross(w, cross(w, h))))
        moment = add(add(times(phi, wd), cross(w, times(phi, w))), cross(h, a))
        return (w, wd, a), (force, moment)

    def inwards(carry, x):
        E, force, moment, pick = x
        force, moment = add(carry[0], force), add(carry[1], moment)
        tau = moment[2] if pick is None else moment[2] + pick * (force[2] - moment[2])
        before = out_of(E, force)
        return (before, add(out_of(E, moment), cross(E.p, before))), tau

    xs = (E, _split(prismatic, qd), _split(prismatic, qdd), _rows(inertia, qdd))
    start = _start(gravity, qdd + 0 * E.x[0])
    _, (force, moment) = _loop(outwards, start, xs)
    return _loop(inwards, start[:1] * 2, (E, force, moment, _pick(prismatic, qdd)), reverse=True)[1]


def mass_matrix(
    E: Placements, prismatic: Sequence[bool], inertia: Float[Any, "n 10"]
) -> Float[Any, "n n ..."]:
    """Joint space inertia without that of the drives; exactly symmetric."""
    like = E.x[0]
    n = like.shape[0]
    zero = 0 * like[0]
    column = np.eye(n).reshape(n, n, *(1,) * (like.ndim - 1))

    def inwards(carry, x):
        E, phi, own, pick = x
        total, force, moment = carry
        total = tuple(a + b for a, b in zip(total, phi, strict=True))
        _, _, xz, _, yz, zz, hx, hy, _, m = total
        if (
            pick is None
        ):  # force and moment that turn (or shift) everything beyond this joint at unit acceleration
            f, c = (-hy, hx), (xz, yz, zz)
            force = force[0] + own * f[0], force[1] + own * f[1], force[2]
        else:
            keep = 1 - pick
            f, c = (
                (-keep * hy, keep * hx, pick * m),
                (keep * xz + pick * hy, keep * yz - pick * hx, keep * zz),
            )
            force = force[0] + own * f[0], force[1] + own * f[1], force[2] + own * f[2]
        moment = moment[0] + own * c[0], moment[1] + own * c[1], moment[2] + own * c[2]
        row = moment[2] if pick is None else moment[2] + pick * (force[2] - moment[2])
        before = out_of(E, force)
        return (moved(E, total), before, add(out_of(E, moment), cross(E.p, before))), row

    columns = (0 * column[0] * like,) * 3
    carry = ((zero,) * 10, columns, columns)
    upper = _loop(
        inwards, carry, (E, _rows(inertia, like), column, _pick(prismatic, like)), reverse=True
    )[1]
    swap = jnp.swapaxes if not isinstance(upper, np.ndarray) else np.swapaxes
    return upper + swap(upper, 0, 1) - upper * np.eye(n).reshape(n, n, *(1,) * (like.ndim - 1))


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
    prismatic: Sequence[bool],
    gravity: Sequence[Any],
    qd: Float[Any, "n ..."],
    qdd: Float[Any, "n ..."],
) -> Float[Any, "n n 10 ..."]:
    """Y[k, j]: torque of joint k per inertial parameter of link j, so that tau_k = sum_j Y[k, j]
    inertia_j.

    One loop over the links: each carries its motion and the partial velocities of all joints
    (angular `u`, linear `v`), and projects the wrench of its ten unit inertias onto them.
    """
    like = qdd + 0 * E.x[0]
    n = like.shape[0]
    column = np.eye(n).reshape(n, n, *(1,) * (like.ndim - 1))

    def outwards(carry, x):
        (w, wd, a), u, v = carry
        E, qd, qdd, own, pick = x
        w, wd, a = _motion(E, w, wd, a, qd, qdd)
        u, v = into(E, u), into(E, add(v, cross(u, E.p)))
        if pick is None:
            u = u[0], u[1], u[2] + own
        else:
            u, v = (u[0], u[1], u[2] + (1 - pick) * own), (v[0], v[1], v[2] + pick * own)
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
        return ((w, wd, a), u, v), (*turn, *first, inner(v, a))

    columns = (0 * column[0] * like,) * 3
    xs = (
        E,
        _split(prismatic, qd),
        _split(prismatic, qdd),
        column + 0 * like[:, None],
        _pick(prismatic, qdd),
    )
    made = _loop(outwards, (_start(gravity, like), columns, columns), xs)[1]
    # ten arrays [link joint *batch] -> [joint link 10 *batch]
    stack, swap = (
        (np.stack, np.swapaxes) if isinstance(made[0], np.ndarray) else (jnp.stack, jnp.swapaxes)
    )
    return swap(stack(made, 2), 0, 1)


def poses(E: Placements) -> Placements:
    """Frames of the links in the base frame instead of the frame before."""

    def outwards(carry, x):
        here = Placements(
            out_of(carry, x.x),
            out_of(carry, x.y),
            out_of(carry, x.z),
            add(carry.p, out_of(carry, x.p)),
        )
        return here, here

    one, zero = 0 * E.p[0][0] + 1, 0 * E.p[0][0]
    base = Placements((one, zero, zero), (zero, one, zero), (zero, zero, one), (zero, zero, zero))
    return _loop(outwards, base, E)[1]


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
