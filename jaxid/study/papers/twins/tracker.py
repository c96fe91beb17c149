"""The tracker of paper 003, written apart from the library: its equations (4, corrected), (5) and
(6), integrated by SciPy.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp


#: Published answer of the genetic algorithm (Table 4).
GA = {"J_theta": 0.117, "J_alpha": 0.1, "b_theta": 1.9, "b_alpha": 1.495}
#: Measured torque of the motors (Table 1): V, N m.
TABLE = ((0.0, 0.0), (1.68, 0.0), (2.4, 0.0882), (3.6, 0.1176))
M, MC, L, U, R, G = 0.043, 0.103, 0.26, 0.036, 0.09, 9.81
#: What the geometry alone gives of J_alpha.
GEOMETRIC = M * L**2 / 3 + MC * U**2


def formula(volts: np.ndarray) -> np.ndarray:
    """Torque by (6)."""
    return 0.1 * np.sign(volts) * np.maximum(np.abs(volts) - 1.68, 0)


def table(volts: np.ndarray) -> np.ndarray:
    """Torque by Table 1, straight between its points and beyond the last one along its last
    piece.
    """
    v, tau = np.array(TABLE).T
    beyond = np.maximum(np.abs(volts) - v[-1], 0) * (tau[-1] - tau[-2]) / (v[-1] - v[-2])
    return np.sign(volts) * (np.interp(np.abs(volts), v, tau) + beyond)


def run(
    u: Float[np.ndarray, "time 2"],
    t: Float[np.ndarray, " time"],
    motors=formula,
    rotor: float = 0.0,
) -> Float[np.ndarray, "time 2"]:
    """theta, alpha under voltages that hold between samples, from rest at 0; `rotor` is the part of
    J_alpha that only tilts.
    """
    k, J, own = M * L + 2 * MC * U, GA["J_alpha"], GA["J_alpha"] - rotor

    def field(time, x, T):
        _, al, w, v = x
        s, cosine = np.sin(al), np.cos(al)
        bend = k * R * s - 2 * own * s * cosine
        yaw = GA["J_theta"] + (M + MC) * R**2 - k * R * cosine + own * cosine**2
        load = (M * L / 2 + MC * U) * G * cosine
        return [
            w,
            v,
            (T[0] - bend * v * w - GA["b_theta"] * w) / yaw,
            (T[1] + bend * w * w / 2 - GA["b_alpha"] * v - load) / J,
        ]

    torque, x, out = motors(u), np.zeros(4), [np.zeros(2)]
    edges = [0, *(np.flatnonzero(np.any(np.diff(u, axis=0) != 0, 1)) + 1), len(t) - 1]
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        part = solve_ivp(
            field, (t[a], t[b]), x, "LSODA", t[a : b + 1], args=(torque[a],), rtol=1e-9, atol=1e-11
        )
        out += list(part.y[:2, 1:].T)
        x = part.y[:, -1]
    return np.array(out)
