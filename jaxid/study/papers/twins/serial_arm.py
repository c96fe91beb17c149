"""Torques of an arm with turning joints, by the recursion of Newton and Euler, written apart from
the library.
"""

from __future__ import annotations

import numpy as np


GRAVITY = 9.81


def torques(
    alpha: np.ndarray,
    a: np.ndarray,
    d: np.ndarray,
    bodies: np.ndarray,
    drives: np.ndarray,
    motion: tuple[np.ndarray, ...],
) -> np.ndarray:
    """Torques [time joints] of a motion (q, qd, qdd), each [time joints], on a base that stands
    upright.

    `alpha`, `a`, `d` [joints] of the modified Denavit-Hartenberg table; `bodies` [joints 10] as xx,
    xy, xz, yy, yz, zz, hx, hy, hz, m about the origins of the links; `drives` [joints] inertias
    that turn with the joints.
    """
    q, qd, qdd = motion
    count, joints = q.shape
    z = np.array([0.0, 0.0, 1.0])
    spin, turn = np.zeros((count, 3)), np.zeros((count, 3))
    pull = np.tile([0.0, 0.0, GRAVITY], (count, 1))  # a base at rest is as one that falls upwards
    frames, forces, moments = [], [], []
    for j in range(joints):
        R, p = _frame(alpha[j], a[j], d[j], q[:, j])

        def into(v, R=R):
            return np.einsum("nji,nj->ni", R, v)

        pull = into(pull + np.cross(turn, p) + np.cross(spin, np.cross(spin, p)))
        before = into(spin)
        turn = into(turn) + qdd[:, j, None] * z + np.cross(before, qd[:, j, None] * z)
        spin = before + qd[:, j, None] * z
        xx, xy, xz, yy, yz, zz, *h, m = bodies[j]
        inertia, h = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), np.array(h)
        forces.append(m * pull + np.cross(turn, h) + np.cross(spin, np.cross(spin, h)))
        moments.append(turn @ inertia + np.cross(spin, spin @ inertia) + np.cross(h, pull))
        frames.append((R, p))
    out = np.zeros_like(q)
    for j in reversed(range(joints)):
        if j + 1 < joints:
            R, p = frames[j + 1]
            force = np.einsum("nij,nj->ni", R, forces[j + 1])
            forces[j] += force
            moments[j] += np.einsum("nij,nj->ni", R, moments[j + 1]) + np.cross(p, force)
        out[:, j] = moments[j][:, 2] + drives[j] * qdd[:, j]
    return out


def _frame(alpha: float, a: float, d: float, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation [time 3 3] of a link in the one before it, and its origin [3] there."""
    c, s, ca, sa = np.cos(q), np.sin(q), np.cos(alpha), np.sin(alpha)
    R = np.zeros((len(q), 3, 3))
    R[:, 0, 0], R[:, 0, 1] = c, -s
    R[:, 1, 0], R[:, 1, 1], R[:, 1, 2] = s * ca, c * ca, -sa
    R[:, 2, 0], R[:, 2, 1], R[:, 2, 2] = s * sa, c * sa, ca
    return R, np.array([a, -sa * d, ca * d])
