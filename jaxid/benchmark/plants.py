"""Plants of the blind cases, in separately written equations (NumPy): nothing here imports the
product.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np


Lanes = dict[str, np.ndarray]  # number -> [lanes joints]


@dataclass(frozen=True)
class TwinPlant:
    """`matrices(q, v, numbers)` -> mass matrix [lanes n n] and bias [lanes n]; magnitudes of
    torque, speed and angle; what is nominal (numbers of the plant and of its friction).
    """

    model: str
    inputs: tuple[tuple[str, str], ...]
    outputs: tuple[tuple[str, str], ...]
    matrices: Callable[[np.ndarray, np.ndarray, Lanes], tuple[np.ndarray, np.ndarray]]
    torque: tuple[float, ...]
    speed: tuple[float, ...]
    inertia: tuple[float, ...]
    nominal: dict[str, tuple[float, ...]]
    rate: int = 200
    noise: float = 3e-4
    resolution: float = 2 * pi / 2**14
    step: float = 1e-4

    @property
    def n(self) -> int:
        return len(self.torque)


# ---- plants


def _joint(q, v, p):
    return p["J"][:, :, None], 0 * q


def _pendulum(q, v, p):
    return p["J"][:, :, None], p["mgl"] * np.sin(q + p["tilt"])


def _servo(q, v, p):
    J = p["mass"] * 0.1**2 + p["armature"] + p["payload"] * 0.1**2
    return J[:, :, None], (p["mass"] + p["payload"]) * 9.81 * 0.1 * np.sin(q - p["q_offset"])


def _tracker(q, v, p):
    """Equations (4, corrected) and (5); a payload is a point at the end of the rod."""
    m, mc, l, c, R, g = 0.043, 0.103, 0.26, 0.036, 0.09, 9.81
    extra = p["payload"][:, 1]
    k, J = m * l + 2 * mc * c + 2 * extra * l, p["J"][:, 1] + extra * l * l
    s, cosine = np.sin(q[:, 1]), np.cos(q[:, 1])
    yaw = p["J"][:, 0] + (m + mc + extra) * R**2 - k * R * cosine + J * cosine**2
    bend = k * R * s - 2 * J * s * cosine
    M = np.zeros((len(q), 2, 2))
    M[:, 0, 0], M[:, 1, 1] = yaw, J
    pull = (m * l / 2 + mc * c + extra * l) * g * cosine
    return M, np.stack([bend * v[:, 0] * v[:, 1], -bend / 2 * v[:, 0] ** 2 + pull], 1)


def _planar(q, v, p):
    """Two links by virtual power; payloads are points at the ends of the links."""
    l1, l2, g = 0.5, 0.4, 9.81
    a, b = q[:, 0], q[:, 0] + q[:, 1]
    w1, w2 = v[:, 0], v[:, 0] + v[:, 1]
    gx, gy = g * np.sin(p["tilt"][:, 0]), g * np.cos(p["tilt"][:, 0])
    M, bias = np.zeros((len(q), 2, 2)), np.zeros((len(q), 2))
    for link, mass, c, own in (
        (0, p["m"][:, 0], p["c"][:, 0], p["I"][:, 0]),
        (1, p["m"][:, 1], p["c"][:, 1], p["I"][:, 1]),
        (0, p["payload"][:, 0], l1, 0.0),
        (1, p["payload"][:, 1], l2, 0.0),
    ):
        if link == 0:
            jx, jy, turn = [c * np.cos(a), 0 * a], [c * np.sin(a), 0 * a], (1.0, 0.0)
            ax, ay = -c * np.sin(a) * w1**2, c * np.cos(a) * w1**2
        else:
            jx, jy = (
                [l1 * np.cos(a) + c * np.cos(b), c * np.cos(b)],
                [l1 * np.sin(a) + c * np.sin(b), c * np.sin(b)],
            )
            ax = -l1 * np.sin(a) * w1**2 - c * np.sin(b) * w2**2
            ay = l1 * np.cos(a) * w1**2 + c * np.cos(b) * w2**2
            turn = (1.0, 1.0)
        for i in (0, 1):
            bias[:, i] += mass * (jx[i] * (ax + gx) + jy[i] * (ay + gy))
            for j in (0, 1):
                M[:, i, j] += mass * (jx[i] * jx[j] + jy[i] * jy[j]) + own * turn[i] * turn[j]
    return M, bias


PLANTS: dict[str, TwinPlant] = {
    "joint": TwinPlant(
        model="joint",
        inputs=(("tau", "N m"),),
        outputs=(("q", "rad"),),
        matrices=_joint,
        torque=(0.35,),
        speed=(4.0,),
        inertia=(0.06,),
        nominal={"J": (0.06,), "viscous": (0.03,), "coulomb": (0.04,), "offset": (0.01,)},
    ),
    "pendulum": TwinPlant(
        model="pendulum",
        inputs=(("tau", "N m"),),
        outputs=(("q", "rad"),),
        matrices=_pendulum,
        torque=(0.5,),
        speed=(4.0,),
        inertia=(0.06,),
        nominal={
            "J": (0.06,),
            "mgl": (0.9,),
            "viscous": (0.03,),
            "coulomb": (0.04,),
            "offset": (0.01,),
        },
    ),
    "servo": TwinPlant(
        model="servo",
        inputs=(("q_cmd", "rad"),),
        outputs=(("q", "rad"),),
        matrices=_servo,
        torque=(0.6,),
        speed=(4.0,),
        inertia=(0.007,),
        nominal={
            "mass": (0.5,),
            "armature": (0.002,),
            "q_offset": (0.02,),
            "viscous": (0.005,),
            "coulomb": (0.03,),
            "k_t": (0.12,),
            "k_e": (0.04,),
            "gain": (1e-3,),
        },
    ),
    "tracker": TwinPlant(
        model="tracker",
        inputs=(("tau_theta", "N m"), ("tau_alpha", "N m")),
        outputs=(("theta", "rad"), ("alpha", "rad")),
        matrices=_tracker,
        torque=(0.8, 0.6),
        speed=(0.4, 0.4),
        inertia=(0.2, 0.1),
        nominal={"J": (0.117, 0.1), "viscous": (1.9, 1.495)},
        rate=100,
        noise=8e-4,
        resolution=2 * pi / 2**12,
    ),
    "planar_arm": TwinPlant(
        model="planar_arm",
        inputs=(("tau1", "N m"), ("tau2", "N m")),
        outputs=(("q1", "rad"), ("q2", "rad")),
        matrices=_planar,
        torque=(14.0, 5.0),
        speed=(2.0, 3.0),
        inertia=(1.5, 0.17),
        nominal={
            "m": (4.0, 2.5),
            "c": (0.25, 0.2),
            "I": (0.12, 0.05),
            "viscous": (0.6, 0.3),
            "coulomb": (0.8, 0.4),
        },
        rate=200,
        noise=1e-4,
        step=5e-5,
    ),
}

#: The flexible link of paper 002.
LINK = {
    "E": 5.7002e10,
    "I_m": 0.0053,
    "viscous": 6.3e-3,
    "coulomb": 0.03,
    "alpha": 1.824,
    "beta": 7.6275e-5,
}
PLANTS["flexible_link"] = TwinPlant(
    model="flexible_link",
    inputs=(("tau", "N m"),),
    outputs=(("phi", "rad"), ("tip_acceleration", "m/s^2")),
    matrices=_joint,
    torque=(0.15,),
    speed=(8.0,),
    inertia=(0.01,),
    nominal={k: (x,) for k, x in LINK.items()},
    rate=500,
    noise=5e-4,
    resolution=2 * pi / 2**14,
)

#: What every lane may have besides its plant, and its neutral value.
_ZERO = """
viscous coulomb offset dry_asymmetry viscous_asymmetry stribeck load drag power spring back_emf
ripple ripple_cosine uneven uneven_cosine shared_viscous shared_dry lugre relaxation loop warm swing
reflected payload tilt lag scale droop dead_zone delay linear compliance spring_damping play bias
gain_error sensor_lag sensor_delay jitter outside outside_from other_joint bent_damping
later_damping
"""
_ONE = """
stribeck_speed exponent ripple_order uneven_order shared_speed presliding loop_width warm_time
swing_frequency outside_hz
"""
NEUTRAL: dict[str, float] = {
    **dict.fromkeys(_ZERO.split(), 0.0),
    **dict.fromkeys(_ONE.split(), 1.0),
    "swing_damping": 0.1,
    "limit": 1e9,
    "motor_share": 0.3,
    "outside_until": 1e9,
}
