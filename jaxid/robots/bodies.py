"""Bodies that can exist: mass, centre of mass and lengths of gyration in place of ten numbers that
may contradict each other.

The mass of a body lies about its centre with the covariance G G' (m^2), G lower triangular with a
diagonal >= 0: any such numbers are a body, and every body has such numbers (its pseudo-inertia,
Wensing, Kim, Slotine 2018, is m [[G G' + c c', c], [c', 1]]).
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


#: The ten numbers of a body here; `gyration_xy` is the entry of G in row x and column y.
BODY = (
    "mass",
    "com_x",
    "com_y",
    "com_z",
    "gyration_xx",
    "gyration_yx",
    "gyration_yy",
    "gyration_zx",
    "gyration_zy",
    "gyration_zz",
)
#: Share of the largest second moment by which one may be negative for want of digits.
DIGITS = 1e-6


def ten_numbers(body: Float[Array, "10 n"], anchor: np.ndarray) -> Float[Array, "n 10"]:
    """Ixx Ixy Ixz Iyy Iyz Izz mx my mz m about `anchor` [n 3], a point in the frame of the bodies'
    `BODY` numbers.
    """
    m, cx, cy, cz, xx, yx, yy, zx, zy, zz = body
    x, y, z = cx - anchor[:, 0], cy - anchor[:, 1], cz - anchor[:, 2]
    sxx, syy, szz = xx * xx + x * x, yx * yx + yy * yy + y * y, zx * zx + zy * zy + zz * zz + z * z
    sxy, sxz, syz = xx * yx + x * y, xx * zx + x * z, yx * zx + yy * zy + y * z
    six = [syy + szz, -sxy, -sxz, sxx + szz, -syz, sxx + syy]
    return jnp.stack([m * v for v in (*six, x, y, z, 1.0 + 0 * x)], -1)


def point_mass(x: Any, y: Any, z: Any) -> Float[Array, " 10"]:
    """The ten numbers of 1 kg at a point (m)."""
    xx, xy, xz = y * y + z * z, -x * y, -x * z
    yy, yz, zz = x * x + z * z, -y * z, x * x + y * y
    ten = (xx, xy, xz, yy, yz, zz, x, y, z, 1.0 + 0 * x)
    return jnp.stack([jnp.asarray(value) for value in ten])


def body_of(inertia: np.ndarray, anchor: np.ndarray) -> tuple[np.ndarray, float]:
    """`BODY` numbers of the nearest body to ten numbers about `anchor`, and the least second moment
    that was stated (kg m^2), negative where no body has them.
    """
    xx, xy, xz, yy, yz, zz, hx, hy, hz, m = inertia
    if m <= 0:
        return np.array([0.0, *anchor, *np.zeros(6)]), -float(np.abs(inertia).max())
    I, c = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), np.array([hx, hy, hz]) / m
    S = np.trace(I) / 2 * np.eye(3) - I - m * np.outer(c, c)
    values, vectors = np.linalg.eigh(S)
    least = float(values[0])
    R: np.ndarray = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0) / m)).T, "r")  # type: ignore[assignment]
    G = (R * np.where(np.diag(R) < 0, -1.0, 1.0)[:, None]).T
    return np.array([m, *(c + anchor), G[0, 0], G[1, 0], G[1, 1], G[2, 0], G[2, 1], G[2, 2]]), least


def principal_moments(inertia: np.ndarray) -> np.ndarray:
    """Principal moments about the centre of mass of ten numbers, rising, kg m^2."""
    xx, xy, xz, yy, yz, zz, hx, hy, hz, m = inertia
    I, h = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), np.array([hx, hy, hz])
    if m > 0:
        I = I - (h @ h * np.eye(3) - np.outer(h, h)) / m
    return np.linalg.eigvalsh(I)


def negative(inertia: np.ndarray) -> bool:
    """Whether a mass or a principal moment of inertia of ten numbers is negative."""
    moments = principal_moments(inertia)
    size = max(float(np.abs(moments).max()), 1e-300)
    return bool(inertia[9] < 0 or moments[0] < -DIGITS * size)


def fault(link: str, inertia: np.ndarray) -> str | None:
    """What no body can have in these numbers, with the values; None: nothing."""
    inertia = np.asarray(inertia, np.float64)
    m, moments = float(inertia[9]), principal_moments(inertia)
    if not np.isfinite(inertia).all() or m < 0:
        return f"link {link!r} has a mass of {m:g} kg"
    size = max(float(np.abs(moments).max()), 1e-300)
    if m == 0:
        return (
            None
            if not np.any(inertia)
            else f"link {link!r} has no mass and moments of inertia up to {size:g} kg m^2"
        )
    listed = ", ".join(f"{v:.4g}" for v in moments)
    if moments[0] < -DIGITS * size:
        return f"link {link!r} has a negative principal moment of inertia ({listed} kg m^2)"
    if moments[0] + moments[1] < moments[2] * (1 - DIGITS):
        return (
            f"link {link!r} has principal moments of inertia {listed} kg m^2, of which the largest"
            " exceeds the sum of the others"
        )
    return None


def carrying_node(robot: Any, joint: str) -> int:
    """The node of a robot that carries the body which a joint moves: of a body with several joints
    the last one.
    """
    node = robot.joints.index(joint)
    while node not in robot.carriers:
        node = robot.parent.index(node)
    return node


def one_joint_of_each_body(robot: Any) -> tuple[str, ...]:
    """The joints of a robot that move a body each: of one with several joints the last of those
    that are recorded.
    """
    by_node = {carrying_node(robot, joint): joint for joint in robot.signatures[0].joints}
    return tuple(by_node.values())


def beyond_ends(
    robot: Any, mass: Float[Array, " nq"], beyond: Float[Array, "nq 3"] | None
) -> Float[Array, "n 10"]:
    """Ten numbers at each node of a robot that point masses add, each `beyond` the end of its
    joint's link: the next joint, else the link's centre of mass.
    """
    added = jnp.zeros((len(robot.joints), 10))
    for k, joint in enumerate(robot.signatures[0].joints):
        node = carrying_node(robot, joint)
        place = robot.carriers.index(node)
        ends = [i for i, up in enumerate(robot.parent) if up == node]
        if ends:
            at = [getattr(robot, name)[ends[0]] for name in ("x", "y", "z")]
        else:
            com = zip(BODY[1:4], robot.anchors[place], strict=True)
            at = [getattr(robot, name)[place] - a for name, a in com]
        if beyond is not None:
            at = [value + beyond[k, i] for i, value in enumerate(at)]
        added = added.at[node].add(mass[k] * point_mass(*at))
    return added
