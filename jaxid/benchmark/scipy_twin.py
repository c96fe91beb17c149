"""Twins integrated by SciPy's `solve_ivp`; standstill begins and ends by its events."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp


class CartPoleTwin:
    """Newton's equations of cart and pole; volts through winding, gear and pinion."""

    def __init__(self, dead_zone: float = 0.0):
        self.dead_zone = dead_zone

    def __call__(self, q, v, u):
        volts = np.sign(u[0]) * max(abs(u[0]) - self.dead_zone, 0.0)
        motor = v[0] / 0.00635 * 3.71
        force = 3.71 * 0.00767 * (volts - 0.00767 * motor) / 2.6 / 0.00635
        mass, length, J = 0.23, 0.33, 0.0335
        M = np.array(
            [[0.82 + mass, mass * length * np.cos(q[1])], [mass * length * np.cos(q[1]), J]]
        )
        cart = force - 3.0 * v[0] + mass * length * np.sin(q[1]) * v[1] ** 2
        return M, np.array([cart, -0.0024 * v[1] - mass * 9.81 * length * np.sin(q[1])])

    def dry(self, speed: float) -> float:
        return 0.6


def motion(plant, t: np.ndarray, u: np.ndarray, q: np.ndarray, v: np.ndarray, delay: float = 0.0):
    """Positions and speeds [time nq] at t; every input holds until the next one, dry friction acts
    on the first joint, which stands still until what pulls at it exceeds its level.
    """
    n = len(q)

    def accelerations(x, command, way):
        M, force = plant(x[:n], x[n:], command)
        if way == 0:
            a = np.zeros(n)
            a[1:] = np.linalg.solve(M[1:, 1:], force[1:]) if n > 1 else ()
            return a, float(force[0] - M[0] @ a)
        force[0] -= way * plant.dry(abs(x[n]))
        return np.linalg.solve(M, force), 0.0

    def next_way(x, command):
        if x[n] != 0:
            return np.sign(x[n])
        held = accelerations(x, command, 0)[1]
        return np.sign(held) if abs(held) > plant.dry(0.0) else 0.0

    edges = np.unique(np.round(np.concatenate([t, t[:-1] + delay]), 9))
    edges = edges[edges <= t[-1] + 1e-9]
    x, out = np.concatenate([q, v]), []
    samples = set(np.round(t, 9))
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        if a in samples:
            out.append(x.copy())
        k = np.searchsorted(t, a - delay + 1e-7) - 1
        command = u[k] if k >= 0 else 0 * u[0]
        while b - a > 1e-10:
            way = next_way(x, command)

            def slope(s, x, w=way, c=command):
                return np.concatenate([x[n:], accelerations(x, c, w)[0]])

            def stop(s, x, w=way, c=command):
                if not w:
                    return plant.dry(0.0) - abs(accelerations(x, c, 0)[1])
                return w * x[n] + (1e-12 if s == start else 0.0)

            start = a
            stop.terminal, stop.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
            end = solve_ivp(slope, (a, b), x, rtol=1e-8, atol=1e-10, first_step=b - a, events=stop)
            a, x = float(end.t[-1]), end.y[:, -1]
            if end.status == 1 and way:
                x[n] = 0.0
            elif end.status == 1:
                x[n] = 1e-9 * np.sign(accelerations(x, command, 0)[1])
    out.append(x.copy())
    states = np.array(out)
    return states[:, :n], states[:, n:]
