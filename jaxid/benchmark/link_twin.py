"""The flexible link of paper 002: Hermite elements, exponentials of all states, dry friction
projected at every step (NumPy).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from jaxid.benchmark.laws import driven, dry, fine, remember, smooth
from jaxid.benchmark.plants import Lanes


LONG, AREA, SECOND, RHO, TIP = 0.197, 0.0266 * 0.001, 0.0266 * 0.001**3 / 12, 6404.3, 0.09466


def link_matrices(payload: float, n: int = 4):
    """Hermite elements: M, K per E, coupling to the hub's turn, inertia about the hub, geometric
    stiffness per phid^2.
    """
    le, size = LONG / n, 2 * n + 2
    M, K, G = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))
    points, weights = np.polynomial.legendre.leggauss(8)
    tip = TIP + payload
    for e in range(n):
        part = slice(2 * e, 2 * e + 4)
        for s, w in zip((points + 1) / 2, weights / 2 * le, strict=True):
            N = np.array(
                [
                    1 - 3 * s**2 + 2 * s**3,
                    le * (s - 2 * s**2 + s**3),
                    3 * s**2 - 2 * s**3,
                    le * (s**3 - s**2),
                ]
            )
            slope = (
                np.array(
                    [
                        6 * s**2 - 6 * s,
                        le * (1 - 4 * s + 3 * s**2),
                        6 * s - 6 * s**2,
                        le * (3 * s**2 - 2 * s),
                    ]
                )
                / le
            )
            bend = np.array([12 * s - 6, le * (6 * s - 4), 6 - 12 * s, le * (6 * s - 2)]) / le**2
            x = (e + s) * le
            M[part, part] += w * RHO * AREA * np.outer(N, N)
            K[part, part] += w * SECOND * np.outer(bend, bend)
            G[part, part] += (
                w * (tip * LONG + RHO * AREA * (LONG**2 - x**2) / 2) * np.outer(slope, slope)
            )
    turn = np.zeros(size)
    turn[0::2], turn[1::2] = np.arange(n + 1) * le, 1.0
    M[-2, -2] += tip
    return M[2:, 2:], K[2:, 2:], (M @ turn)[2:], float(turn @ M @ turn), G[2:, 2:]


def flexible(u: np.ndarray, p: Lanes, parts: int, h: float) -> np.ndarray:
    """Hub angle and tip acceleration on the fine grid: exponentials of all states, dry friction
    projected at every step.
    """
    table = fine(u, p, parts, h)[:, :, 0]
    lanes, steps = table.shape
    A, B, Bt = [], [], []
    for i in range(lanes):
        Mp, Kp, c, J, _ = link_matrices(float(p["payload"][i, 0]))
        size = len(c) + 1
        M, C, K = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))
        M[0, 0], M[0, 1:], M[1:, 0], M[1:, 1:] = p["I_m"][i, 0] + p["reflected"][i, 0] + J, c, c, Mp
        K[1:, 1:] = p["E"][i, 0] * Kp
        C[1:, 1:] = p["alpha"][i, 0] * Mp + p["beta"][i, 0] * p["E"][i, 0] * Kp
        W = np.linalg.inv(M)
        a = np.block([[np.zeros((size, size)), np.eye(size)], [-W @ K, -W @ C]])
        b = np.append(np.zeros(size), W[:, 0])
        F = expm(np.block([[a, b[:, None]], [np.zeros((1, 2 * size + 1))]]) * h)
        A.append(F[:-1, :-1])
        B.append(F[:-1, -1])
        tip = LONG * a[size] + a[2 * size - 2], LONG * b[size] + b[2 * size - 2]
        Bt.append(np.append(tip[0], tip[1]))
    A, B, Bt = np.array(A), np.array(B), np.array(Bt)
    n = A.shape[1] // 2
    x, lagged = np.zeros((lanes, 2 * n)), table[:, :1].copy()
    z = {
        k: np.zeros((lanes, 1))
        for k in ("lugre", "loop", "warm", "swing", "swing_speed", "swing_acceleration")
    }
    follow = np.where(p["lag"] > 0, np.exp(-h / np.maximum(p["lag"], 1e-12)), 0.0)
    out = np.empty((lanes, steps, 2))
    for k in range(steps):
        before, lagged = lagged, table[:, k : k + 1] + (lagged - table[:, k : k + 1]) * follow
        tau = driven(p, np.where(p["lag"] > 0, (before + lagged) / 2, lagged))
        q, v = x[:, :1], x[:, n : n + 1]
        minus, plus = dry(p, q, v, tau)
        net = tau - smooth(p, q, v, z, k * h)
        free = np.einsum("lij,lj->li", A, x) + B * net
        f = np.clip(free[:, n : n + 1] / B[:, n : n + 1], -minus, plus)
        out[:, k, 0] = q[:, 0]
        out[:, k, 1] = np.einsum("li,li->l", Bt[:, :-1], x) + Bt[:, -1] * (net - f)[:, 0]
        x = free - B * f
        remember(p, z, x[:, :1], x[:, n : n + 1], h)
    return out
