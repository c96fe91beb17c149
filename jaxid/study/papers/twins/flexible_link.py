"""The flexible link of paper 002, written apart from the library: textbook beam elements, dense
matrices, matrix exponential.
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import scipy.linalg


#: Published best answer of differential evolution (paper 002, Table 2).
DE: dict[str, Any] = {
    "E": 5.7002e10,
    "I_m": 0.0053,
    "alpha": 1.824,
    "beta": 7.6275e-5,
    "v": 6.3016e-4,
    "tau_c": 0.1071,
}
OWN: dict[str, Any] = {k: v for k, v in DE.items() if k not in ("v", "tau_c")}
L, THICK, WIDE, RHO, PAYLOAD = 0.197, 0.001, 0.0266, 6404.3, 0.09466
AREA, SECOND = WIDE * THICK, WIDE * THICK**3 / 12


# ---- an implementation of its own: textbook elements, dense matrices


def elements(n: int = 4, J_p: float = 0.0):
    """(M_psi, K_psi per unit of E, coupling, rigid inertia without hub, geometric stiffness)."""
    le, size = L / n, 2 * n + 2
    M, K, G = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))
    Me = (
        RHO
        * AREA
        * le
        / 420
        * np.array(
            [
                [156, 22 * le, 54, -13 * le],
                [22 * le, 4 * le**2, 13 * le, -3 * le**2],
                [54, 13 * le, 156, -22 * le],
                [-13 * le, -3 * le**2, -22 * le, 4 * le**2],
            ]
        )
    )
    Ke = (
        SECOND
        / le**3
        * np.array(
            [
                [12, 6 * le, -12, 6 * le],
                [6 * le, 4 * le**2, -6 * le, 2 * le**2],
                [-12, -6 * le, 12, -6 * le],
                [6 * le, 2 * le**2, -6 * le, 4 * le**2],
            ]
        )
    )
    xi, weight = np.polynomial.legendre.leggauss(8)
    for e in range(n):
        part = slice(2 * e, 2 * e + 4)
        M[part, part] += Me
        K[part, part] += Ke
        for point, w in zip((xi + 1) / 2, weight / 2 * le, strict=True):
            x = (e + point) * le
            slope = (
                np.array(
                    [
                        6 * point**2 - 6 * point,
                        le * (1 - 4 * point + 3 * point**2),
                        6 * point - 6 * point**2,
                        le * (3 * point**2 - 2 * point),
                    ]
                )
                / le
            )
            G[part, part] += (
                w * (PAYLOAD * L + RHO * AREA * (L**2 - x**2) / 2) * np.outer(slope, slope)
            )
    rigid = np.zeros(
        size
    )  # a rotation by one radian: u = x, slope 1, which the cubics hold exactly
    rigid[0::2], rigid[1::2] = np.arange(n + 1) * le, 1.0
    M[-2, -2] += PAYLOAD
    M[-1, -1] += J_p
    return M[2:, 2:], K[2:, 2:], (M @ rigid)[2:], rigid @ M @ rigid, G[2:, 2:]


def full(E=DE["E"], I_m=DE["I_m"], alpha=DE["alpha"], beta=DE["beta"], *, n=4):
    """M, C, K of (phi, psi)."""
    Mp, Kp, c, J, _ = elements(n)
    size = len(c) + 1
    M, C, K = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))
    M[0, 0], M[0, 1:], M[1:, 0], M[1:, 1:] = I_m + J, c, c, Mp
    K[1:, 1:] = E * Kp
    C[1:, 1:] = alpha * Mp + beta * E * Kp
    return M, C, K


def zero_order_hold(
    u: np.ndarray, h: float, parts: int, v: float, tau_c: float, *body: float
) -> np.ndarray:
    """(phi, tip acceleration) by the matrix exponential of all states, with Coulomb friction
    projected at every fine step.
    """
    M, C, K = full(*body)
    C[0, 0] += v
    W = np.linalg.inv(M)
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-W @ K, -W @ C]])
    B = np.append(np.zeros(n), W[:, 0])
    F = scipy.linalg.expm(np.block([[A, B[:, None]], [np.zeros((1, 2 * n + 1))]]) * h / parts)
    Ad, Bd = F[:-1, :-1], F[:-1, -1]
    x, out = np.zeros(2 * n), []
    for torque in u:
        for k in range(parts):
            free = Ad @ x + Bd * torque
            f = np.clip(free[n] / Bd[n], -tau_c, tau_c)
            if k == 0:
                xd = A @ x + B * (torque - f)
                out.append([x[0], L * xd[n] + xd[2 * n - 2]])
            x = free - Bd * f
    return np.array(out)


def pulses(t: np.ndarray) -> np.ndarray:
    return np.where(t < 0.1, 0.5, 0.0) + np.where((t >= 0.7) & (t < 0.8), -0.45, 0.0)


def direct(f: np.ndarray, v: float = DE["v"]) -> np.ndarray:
    M, C, K = full()
    C[0, 0] += v
    c = np.zeros(9)
    c[0], c[7] = L, 1.0
    return np.array(
        [-(w**2) * c @ np.linalg.solve(K - w**2 * M + 1j * w * C, np.eye(9)[0]) for w in 2 * pi * f]
    )
