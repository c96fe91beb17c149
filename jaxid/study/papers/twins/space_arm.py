"""A plane two-joint arm on a base that stands or floats, written apart from the library: Lagrange's
equations by matrices of bodies, and Stribeck friction. Paper 000's own equations are lost; these
are the numbers that stand in for its tables.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float


BODY = {"m2": 40.0, "hx": 20.0, "hy": 4.0, "I2": 18.0}
FRICTION = {"F_c": (1.5, 1.0), "F_s": (2.4, 1.7), "v_s": (0.06, 0.05), "F_v": (2.0, 1.2)}
LINK = {"l1": 1.2, "I1": 3.0, "m1": 5.0, "c1": 0.5}
#: Every number of the model by its id.
NUMBERS = dict(BODY)
for _name, (_first, _second) in FRICTION.items():
    NUMBERS |= {f"{_name}1": _first, f"{_name}2": _second}
Motion = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def path(seed: int, seconds: float = 20.0, rate: float = 20.0) -> Motion:
    """Five harmonics of 0.1 Hz a joint: t [time], q, qd, qdd [time 2]."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate) + 1) / rate
    w = 2 * np.pi * 0.1 * np.arange(1, 6)
    a, b = rng.normal(size=(2, 5, 2)) * 0.5 / np.arange(1, 6)[:, None]
    s, c, wide = np.sin(np.outer(t, w)), np.cos(np.outer(t, w)), w[:, None]
    return t, s @ a + c @ b, c @ (a * wide) - s @ (b * wide), -s @ (a * wide**2) - c @ (b * wide**2)


def mass_matrix(
    q: Float[np.ndarray, "time 2"],
    base: tuple[float, float] | None,
    body: Mapping[str, float] = BODY,
) -> Float[np.ndarray, "time 2 2"]:
    """From the Jacobians of the bodies; `base` (kg, kg m^2) floats freely, None stands still."""
    a, b = q[:, 0], q[:, 0] + q[:, 1]
    n = len(q)

    def spin(x, y):
        return np.stack([-y, x], 1)

    first = np.broadcast_to([0.6, 0.2], (n, 2))
    link = np.stack([np.cos(a), np.sin(a)], 1)
    last = (
        np.stack(
            [
                body["hx"] * np.cos(b) - body["hy"] * np.sin(b),
                body["hx"] * np.sin(b) + body["hy"] * np.cos(b),
            ],
            1,
        )
        / body["m2"]
    )
    columns = np.zeros((n, 2, 5))  # of a point's velocity by base x, y, turn, q1, q2

    def kinetic(
        m: float,
        inertia: float,
        turns: tuple[int, ...],
        arm: np.ndarray,
        levers: dict[int, np.ndarray],
    ) -> np.ndarray:
        J = columns.copy()
        J[:, 0, 0] = J[:, 1, 1] = 1.0
        for k, r in {2: arm, **levers}.items():
            J[:, :, k] = spin(r[:, 0], r[:, 1])
        W = np.zeros(5)
        W[list(turns)] = 1.0
        return m * np.einsum("nki,nkj->nij", J, J) + inertia * np.outer(W, W)

    elbow, centre = LINK["l1"] * link, LINK["c1"] * link
    own1 = LINK["I1"] - LINK["m1"] * LINK["c1"] ** 2
    own2 = body["I2"] - (body["hx"] ** 2 + body["hy"] ** 2) / body["m2"]
    M = kinetic(LINK["m1"], own1, (2, 3), first + centre, {3: centre})
    M = M + kinetic(body["m2"], own2, (2, 3, 4), first + elbow + last, {3: elbow + last, 4: last})
    if base is None:
        return M[:, 3:, 3:]
    M[:, 0, 0] += base[0]
    M[:, 1, 1] += base[0]
    M[:, 2, 2] += base[1]
    return M[:, 3:, 3:] - np.swapaxes(M[:, :3, 3:], 1, 2) @ np.linalg.solve(
        M[:, :3, :3], M[:, :3, 3:]
    )


def torque(
    motion: Motion,
    base: tuple[float, float] | None = None,
    body: Mapping[str, float] = BODY,
    friction: Mapping[str, tuple[float, float]] | None = FRICTION,
) -> Float[np.ndarray, "time 2"]:
    """Lagrange's equations of qd' M qd / 2, derivatives of M by central differences, and
    friction.
    """
    _, q, qd, qdd = motion
    M, h = mass_matrix(q, base, body), 1e-6
    slopes = [
        (mass_matrix(q + h * e, base, body) - mass_matrix(q - h * e, base, body)) / (2 * h)
        for e in np.eye(2)
    ]
    rate = slopes[0] * qd[:, :1, None] + slopes[1] * qd[:, 1:, None]
    pull = np.stack([np.einsum("ni,nij,nj->n", qd, s, qd) for s in slopes], 1) / 2
    rigid = np.einsum("nij,nj->ni", M, qdd) + np.einsum("nij,nj->ni", rate, qd) - pull
    if friction is None:
        return rigid
    F = {k: np.array(v) for k, v in friction.items()}
    dry = F["F_c"] + (F["F_s"] - F["F_c"]) * np.exp(-((qd / F["v_s"]) ** 2))
    return rigid + dry * np.sign(qd) + F["F_v"] * qd


def cut(motion: Motion, size: int) -> list[Motion]:
    """Consecutive blocks of this many samples."""
    blocks = []
    for first in range(0, len(motion[0]) - size + 1, size):
        block = slice(first, first + size)
        blocks.append(tuple(x[block] for x in motion))
    return blocks
