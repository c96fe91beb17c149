"""Geometry of serial chains: modified and standard Denavit-Hartenberg tables, general placements,
and where the frames are.

One description for all: the geometric parameters of Khalil and Kleinfinger (1986). The frame of
joint j stands in the frame before it at

    Rz(gamma_j) Tz(b_j) Rx(alpha_j) Tx(a_j) Rz(theta_j) Tz(d_j)

with the joint variable added to theta (revolute) or d (prismatic). gamma = b = 0 is the modified
table of Craig and Khalil; with them any placement can be written, so that a URDF and its frames
keep their meaning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxid.base.errors import UsageError
from jaxid.dynamics.rigid_body import about_origin, Placements, poses
from jaxid.numerics.fast_math import sincos


Column = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class ArmTable:
    """A serial chain before any data: geometry [n] in m and rad, inertial parameters [n 10], drive
    inertia [n].

    `tool` [4 4] is the flange or tool in the last link's frame; `joints` the names a URDF gives;
    `lower`, `upper` (rad or m), `velocity` (rad/s or m/s) and `effort` (N m or N) are the maker's
    limits, infinite where unknown; `viscous` and `coulomb` friction (N m s/rad, N m) a start for a
    fit.
    """

    a: np.ndarray
    alpha: np.ndarray
    d: np.ndarray
    theta: np.ndarray
    b: np.ndarray
    gamma: np.ndarray
    prismatic: tuple[bool, ...]
    inertia: np.ndarray
    drive_inertia: np.ndarray
    tool: np.ndarray = field(default_factory=lambda: np.eye(4))
    joints: tuple[str, ...] = ()
    lower: np.ndarray = field(default_factory=lambda: np.zeros(0))
    upper: np.ndarray = field(default_factory=lambda: np.zeros(0))
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(0))
    effort: np.ndarray = field(default_factory=lambda: np.zeros(0))
    viscous: np.ndarray = field(default_factory=lambda: np.zeros(0))
    coulomb: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def n(self) -> int:
        return len(self.prismatic)

    def with_inertia(
        self, inertia: np.ndarray, drive_inertia: np.ndarray | None = None
    ) -> ArmTable:
        """The same chain with other inertial parameters [n 10] (and drive inertia [n])."""
        inertia = np.asarray(inertia, np.float64)
        if inertia.shape != (self.n, 10):
            raise UsageError(
                f"inertial parameters have shape {inertia.shape}; this chain needs ({self.n}, 10)"
            )
        drive = (
            self.drive_inertia if drive_inertia is None else np.asarray(drive_inertia, np.float64)
        )
        return replace(self, inertia=inertia, drive_inertia=drive)

    def placements(self, q: Float[Any, "n ..."]) -> Placements:
        """Frame of each link in the frame before it, in NumPy."""
        return placements(self, self.prismatic, np.asarray(q, np.float64))


def modified_dh(
    a: Column,
    alpha: Column,
    d: Column,
    theta: Column | None = None,
    prismatic: Sequence[bool] | None = None,
    inertia: np.ndarray | None = None,
    drive_inertia: Column | None = None,
    tool: np.ndarray | None = None,
) -> ArmTable:
    """A chain from a modified table (Craig; Khalil): a_{j-1}, alpha_{j-1}, d_j, theta_j, in m and
    rad.

    `theta` and `d` are the offsets of the joint variable. Without inertial parameters the links are
    taken as slender steel-like bodies between their joints: a start for a fit, nothing more. Raises
    `UsageError` for rows of unequal length.
    """
    n = len(a)
    columns = {
        "a": a,
        "alpha": alpha,
        "d": d,
        "theta": theta if theta is not None else np.zeros(n),
        "prismatic": prismatic if prismatic is not None else [False] * n,
        "drive_inertia": drive_inertia if drive_inertia is not None else np.zeros(n),
    }
    wrong = [f"{k} has {len(v)}" for k, v in columns.items() if len(v) != n]
    if wrong or n == 0:
        raise UsageError(
            f"a table of {n} joints needs {n} entries in every column;"
            f" {', '.join(wrong) or 'it is empty'}"
        )
    number = {k: np.asarray(v, np.float64) for k, v in columns.items()}
    table = ArmTable(
        a=number["a"],
        alpha=number["alpha"],
        d=number["d"],
        theta=number["theta"],
        drive_inertia=number["drive_inertia"],
        b=np.zeros(n),
        gamma=np.zeros(n),
        prismatic=tuple(map(bool, columns["prismatic"])),
        inertia=np.zeros((n, 10)),
        tool=np.eye(4) if tool is None else np.asarray(tool, np.float64),
    )
    return table.with_inertia(slender_links(table) if inertia is None else inertia)


def standard_dh(
    a: Column,
    alpha: Column,
    d: Column,
    theta: Column | None = None,
    prismatic: Sequence[bool] | None = None,
    inertia: np.ndarray | None = None,
    drive_inertia: Column | None = None,
) -> ArmTable:
    """The same from a standard table, Rz(theta_j) Tz(d_j) Tx(a_j) Rx(alpha_j) as most makers print
    it.

    Its frames lie at the far end of each link; the chain's lie at the joint, turned about the same
    axes, so `inertia` is about the frames of this chain. The last a and alpha become the tool.
    """
    if len(alpha) != len(a):
        raise UsageError(f"a has {len(a)} entries, alpha {len(alpha)}; one row a joint")
    tool = np.eye(4)
    if len(a):
        c, s = np.cos(alpha[-1]), np.sin(alpha[-1])
        tool = np.array([[1, 0, 0, a[-1]], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])

    def shifted(column):
        return [0.0, *list(column)[:-1]]

    return modified_dh(
        a=shifted(a),
        alpha=shifted(alpha),
        d=d,
        theta=theta,
        prismatic=prismatic,
        inertia=inertia,
        drive_inertia=drive_inertia,
        tool=tool,
    )


def placements(geometry: Any, prismatic: Sequence[bool], q: Any) -> Placements:
    """Frame of each link in the frame before it; `geometry` holds a, alpha, d, theta, b, gamma [n],
    q is [n ...].

    JAX arrays or NumPy's, as q is.
    """
    numeric = isinstance(q, np.ndarray)
    trig = (lambda x: (np.sin(x), np.cos(x))) if numeric else sincos

    def column(v):
        return v.reshape(v.shape[0], *(1,) * (q.ndim - 1))

    as_array = np.asarray if numeric else jnp.asarray
    a, alpha, d, theta, b, gamma = (
        column(as_array(getattr(geometry, k))) for k in ("a", "alpha", "d", "theta", "b", "gamma")
    )
    if any(prismatic):
        slides = column(np.array(prismatic, np.float64))
        theta, d = theta + (1 - slides) * q, d + slides * q
    else:
        theta = theta + q
    (st, ct), (sa, ca), (sg, cg) = trig(theta), trig(alpha), trig(gamma)

    def turn(v):
        return (cg * v[0] - sg * v[1], sg * v[0] + cg * v[1], v[2] + 0 * st)

    x = turn((ct, ca * st, sa * st))
    y = turn((-st, ca * ct, sa * ct))
    z = turn((0 * st, -sa + 0 * st, ca + 0 * st))
    p = turn((a + 0 * st, -sa * d, ca * d))
    return Placements(x, y, z, (p[0], p[1], p[2] + b))


def geometry_of(T: np.ndarray) -> tuple[float, float, float, float, float, float]:
    """(a, alpha, d, theta, b, gamma) of a general placement [4 4], as in the head of this
    module.
    """
    R, p = np.asarray(T, np.float64)[:3, :3], np.asarray(T, np.float64)[:3, 3]
    alpha = float(np.arctan2(np.hypot(R[0, 2], R[1, 2]), R[2, 2]))
    if np.hypot(R[0, 2], R[1, 2]) > 1e-9:
        gamma = float(np.arctan2(R[0, 2], -R[1, 2]))
        theta = float(np.arctan2(R[2, 0], R[2, 1]))
        along = np.cos(gamma) * p[0] + np.sin(gamma) * p[1]
        across = -np.sin(gamma) * p[0] + np.cos(gamma) * p[1]
        d = -across / np.sin(alpha)
        return float(along), alpha, float(d), theta, float(p[2] - np.cos(alpha) * d), gamma
    # Parallel axes: the turn may be split at will; gamma takes the direction of the offset, d
    # nothing.
    alpha = 0.0 if R[2, 2] > 0 else float(np.pi)
    radius = float(np.hypot(p[0], p[1]))
    gamma = float(np.arctan2(p[1], p[0])) if radius > 1e-12 else 0.0
    turned = np.arctan2(R[1, 0], R[0, 0])
    theta = turned - gamma if R[2, 2] > 0 else gamma - turned
    return radius, alpha, 0.0, float(theta), float(p[2]), gamma


def frames(table: Any, prismatic: Sequence[bool], q: Any) -> Placements:
    """Frames of all links in the base frame, components [n ...]."""
    return poses(placements(table, prismatic, q))


def flange(table: ArmTable, q: np.ndarray) -> np.ndarray:
    """Pose [4 4] of the tool in the base frame at joint positions q [n] (forward kinematics)."""
    E = frames(table, table.prismatic, np.asarray(q, np.float64))
    last = np.eye(4)
    for k, column in enumerate((E.x, E.y, E.z, E.p)):
        last[:3, k] = [component[-1] for component in column]
    return last @ table.tool


def free_fall(gravity: Any, roll: Any, pitch: Any) -> tuple[Any, Any, Any]:
    """Gravity vector in the base frame of a base mounted at Ry(pitch) Rx(roll) in the world (z up);
    scalars, SI.
    """
    trig = sincos if isinstance(roll, jnp.ndarray) else lambda x: (np.sin(x), np.cos(x))
    (sr, cr), (sp, cp) = trig(roll), trig(pitch)
    return gravity * sp, -gravity * cp * sr, -gravity * cp * cr


def slender_links(table: ArmTable, per_length: float = 8.0, radius: float = 0.05) -> np.ndarray:
    """Inertial parameters [n 10] of solid rods from each joint to the next (kg per m, m): physical
    start values.
    """
    out = np.zeros((table.n, 10))
    E = table.placements(np.zeros(table.n))
    for j in range(table.n):
        if j + 1 < table.n:
            end = np.array([component[j + 1] for component in E.p])
        else:
            end = np.asarray(table.tool)[:3, 3]
        length = float(np.linalg.norm(end))
        if length < 2 * radius:
            end, length = np.array([0.0, 0.0, 2 * radius]), 2 * radius
        m, u = per_length * length, end / length
        across = m * (radius**2 / 4 + length**2 / 12)
        I = across * np.eye(3) + (m * radius**2 / 2 - across) * np.outer(u, u)
        out[j] = about_origin(m, end / 2, [I[0, 0], I[0, 1], I[0, 2], I[1, 1], I[1, 2], I[2, 2]])
    return out
