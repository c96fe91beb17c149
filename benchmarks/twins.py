"""Twins for the blind cases: six plants with effects that a diagnosis is not told of, in separately
written equations (NumPy).

Nothing here imports the product. Many recordings are integrated side by side with steps of 0.1 ms:
Heun's rule for what is smooth, then dry friction as the impulse that the joints can hold, then the
position by the mean speed. A joint may have a motor of its own behind a spring with play. The arm
swings over the top and takes half these steps: over 4 s it is then off by a third of the noise,
against an adaptive solver with events.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np
from scipy.linalg import expm


Lanes = dict[str, np.ndarray]  # number -> [lanes joints]


@dataclass(frozen=True)
class Plant:
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


def _one(x: float) -> tuple[float, ...]:
    return (x,)


PLANTS: dict[str, Plant] = {
    p.model: p
    for p in (
        Plant(
            "joint",
            (("tau", "N m"),),
            (("q", "rad"),),
            _joint,
            _one(0.35),
            _one(4.0),
            _one(0.06),
            {"J": _one(0.06), "viscous": _one(0.03), "coulomb": _one(0.04), "offset": _one(0.01)},
        ),
        Plant(
            "pendulum",
            (("tau", "N m"),),
            (("q", "rad"),),
            _pendulum,
            _one(0.5),
            _one(4.0),
            _one(0.06),
            {
                "J": _one(0.06),
                "mgl": _one(0.9),
                "viscous": _one(0.03),
                "coulomb": _one(0.04),
                "offset": _one(0.01),
            },
        ),
        Plant(
            "servo",
            (("q_cmd", "rad"),),
            (("q", "rad"),),
            _servo,
            _one(0.6),
            _one(4.0),
            _one(0.007),
            {
                "mass": _one(0.5),
                "armature": _one(0.002),
                "q_offset": _one(0.02),
                "viscous": _one(0.005),
                "coulomb": _one(0.03),
                "k_t": _one(0.12),
                "k_e": _one(0.04),
                "gain": _one(1e-3),
            },
        ),
        Plant(
            "tracker",
            (("tau_theta", "N m"), ("tau_alpha", "N m")),
            (("theta", "rad"), ("alpha", "rad")),
            _tracker,
            (0.8, 0.6),
            (0.4, 0.4),
            (0.2, 0.1),
            {"J": (0.117, 0.1), "viscous": (1.9, 1.495)},
            100,
            8e-4,
            2 * pi / 2**12,
        ),
        Plant(
            "planar_arm",
            (("tau1", "N m"), ("tau2", "N m")),
            (("q1", "rad"), ("q2", "rad")),
            _planar,
            (14.0, 5.0),
            (2.0, 3.0),
            (1.5, 0.17),
            {
                "m": (4.0, 2.5),
                "c": (0.25, 0.2),
                "I": (0.12, 0.05),
                "viscous": (0.6, 0.3),
                "coulomb": (0.8, 0.4),
            },
            200,
            1e-4,
            step=5e-5,
        ),
    )
}

#: What every lane may have besides its plant, and its neutral value.
NEUTRAL: dict[str, float] = {
    "viscous": 0, "coulomb": 0, "offset": 0, "dry_asymmetry": 0, "viscous_asymmetry": 0, "stribeck": 0, "stribeck_speed": 1,
    "load": 0, "drag": 0, "power": 0, "exponent": 1, "spring": 0, "back_emf": 0, "ripple": 0, "ripple_cosine": 0,
    "ripple_order": 1, "uneven": 0, "uneven_cosine": 0, "uneven_order": 1, "shared_viscous": 0, "shared_dry": 0,
    "shared_speed": 1, "lugre": 0, "presliding": 1, "relaxation": 0, "loop": 0, "loop_width": 1, "warm": 0, "warm_time": 1,
    "swing": 0, "swing_frequency": 1, "swing_damping": 0.1, "reflected": 0, "payload": 0, "tilt": 0, "lag": 0, "scale": 0,
    "droop": 0, "limit": 1e9, "dead_zone": 0, "delay": 0, "linear": 0, "compliance": 0, "motor_share": 0.3, "spring_damping": 0,
    "play": 0, "bias": 0, "gain_error": 0, "sensor_lag": 0, "sensor_delay": 0, "jitter": 0, "outside": 0, "outside_hz": 1,
    "outside_from": 0, "outside_until": 1e9, "other_joint": 0, "bent_damping": 0, "later_damping": 0,
}  # fmt: skip


def smooth(p: Lanes, q, v, z: Lanes, time: float) -> np.ndarray:
    """Torque against motion that is continuous in v."""
    f = (
        (p["viscous"] + p["back_emf"]) * v
        + p["viscous_asymmetry"] * abs(v)
        + p["drag"] * abs(v) * v
        + p["offset"]
    )
    f = (
        f
        + p["ripple"] * np.sin(p["ripple_order"] * q)
        + p["ripple_cosine"] * np.cos(p["ripple_order"] * q)
    )
    f = f + p["spring"] * q + p["power"] * (v * v + 1e-6) ** ((p["exponent"] - 1) / 2) * v
    f = f + p["warm"] * z["warm"] * v + p["loop"] * z["loop"] + p["swing"] * z["swing_acceleration"]
    f = f + p["lugre"] * (
        z["lugre"] + p["relaxation"] * (v - abs(v) * z["lugre"]) / p["presliding"]
    )
    if q.shape[1] > 1:
        w = v.sum(1, keepdims=True)
        f = (
            f
            + p["shared_viscous"][:, :1] * w
            + p["shared_dry"][:, :1] * np.tanh(w / p["shared_speed"][:, :1])
        )
        f = f + p["other_joint"] * q[:, ::-1]
    acting = (time >= p["outside_from"]) & (time < p["outside_until"])
    f = f + np.where(acting, p["outside"], 0) * np.sin(2 * pi * p["outside_hz"] * time + 0.4)
    return (
        f
        + p["bent_damping"] * np.sin(3 * q) * v
        + p["later_damping"] * (time > p["outside_from"]) * v
    )


def dry(p: Lanes, q, v, tau) -> tuple[np.ndarray, np.ndarray]:
    """Levels of dry friction backwards and forwards."""
    level = (
        p["coulomb"]
        + p["stribeck"] * np.exp(-((v / p["stribeck_speed"]) ** 2))
        + p["load"] * abs(tau)
    )
    level = (
        level
        + p["uneven"] * np.sin(p["uneven_order"] * q)
        + p["uneven_cosine"] * np.cos(p["uneven_order"] * q)
    )
    return np.maximum(level - p["dry_asymmetry"], 0), np.maximum(level + p["dry_asymmetry"], 0)


def driven(p: Lanes, u: np.ndarray) -> np.ndarray:
    u = (1 + p["scale"]) * u
    u = np.clip(u - p["droop"] * abs(u) * u, -p["limit"], p["limit"])
    return np.sign(u) * np.maximum(abs(u) - p["dead_zone"], 0)


def remember(p: Lanes, z: Lanes, q, v, h: float) -> None:
    """States of effects over a step."""
    path = abs(v) * h / p["presliding"]
    z["lugre"] = np.sign(v) + (z["lugre"] - np.sign(v)) * np.exp(-path)
    grows = z["loop"] * v > 0
    z["loop"] = np.clip(
        z["loop"] + np.where(grows, 1 - abs(z["loop"]), 1.0) * v * h / p["loop_width"], -1, 1
    )
    z["warm"] = v * v + (z["warm"] - v * v) * np.exp(-h / p["warm_time"])
    w = 2 * pi * p["swing_frequency"]
    z["swing_acceleration"] = w * w * (q - z["swing"]) + 2 * p["swing_damping"] * w * (
        v - z["swing_speed"]
    )
    z["swing_speed"] = z["swing_speed"] + h * z["swing_acceleration"]
    z["swing"] = z["swing"] + h * z["swing_speed"]


def fine(u: np.ndarray, p: Lanes, parts: int, h: float) -> np.ndarray:
    """The commands [lanes samples n] on the fine grid [lanes steps n]: held or linear, late."""
    lanes, samples, n = u.shape
    k = np.arange(samples * parts)
    out = np.empty((lanes, k.size, n))
    for lane in range(lanes):
        for j in range(n):
            shifted = np.maximum(k - int(round(float(p["delay"][lane, j]) / h)), 0)
            at = shifted // parts
            held = u[lane, at, j]
            nxt = u[lane, np.minimum(at + 1, samples - 1), j]
            part = (shifted % parts + 0.5) / parts
            out[lane, :, j] = held + p["linear"][lane, j] * (nxt - held) * part
    return out


def recorded(plant: Plant, u: np.ndarray, p: Lanes, rng: np.random.Generator) -> np.ndarray:
    """What the sensors write down [lanes samples ny] under commands u [lanes samples nu], from rest
    at zero.
    """
    p = {
        k: np.broadcast_to(np.asarray(x, float), (len(u), plant.n))
        for k, x in ({**NEUTRAL, **p}).items()
    }
    parts = round(1 / plant.rate / plant.step)
    h = 1 / plant.rate / parts
    q = flexible(u, p, parts, h) if plant.model == "flexible_link" else rigid(plant, u, p, parts, h)
    return sensed(plant, q, p, parts, h, rng)


def rigid(plant: Plant, u: np.ndarray, p: Lanes, parts: int, h: float) -> np.ndarray:
    """Joint positions on the fine grid [lanes steps n], without and with a motor of its own (lanes
    with compliance).
    """
    table = fine(u, p, parts, h)
    lanes, steps, n = table.shape
    q, v, lagged = np.zeros((lanes, n)), np.zeros((lanes, n)), table[:, 0].copy()
    link, dlink = q.copy(), v.copy()
    z = {
        k: np.zeros((lanes, n))
        for k in ("lugre", "loop", "warm", "swing", "swing_speed", "swing_acceleration")
    }
    out = np.empty((lanes, steps, n))
    M0 = plant.matrices(q, v, p)[0]
    soft = p["compliance"] > 0
    seen = 1 / np.linalg.inv(M0)[:, range(n), range(n)]
    motor = np.where(soft, p["motor_share"] * seen, 0.0)
    stiffness = np.where(soft, 1 / np.where(soft, p["compliance"], 1.0), 0.0)
    zeta = np.where(p["play"] > 0, 0.5, p["spring_damping"])
    damping = 2 * zeta * np.sqrt(stiffness * motor * np.maximum(seen - motor, 0) / seen)
    follow = np.where(p["lag"] > 0, np.exp(-h / np.maximum(p["lag"], 1e-12)), 0.0)
    eye = np.eye(n)[None]

    def twist(gap, rate):
        deep = np.maximum(abs(gap) - p["play"] / 2, 0.0) * np.sign(gap)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(p["play"] > 0, np.minimum(abs(deep) / (0.05 * p["play"]), 1.0), 1.0)
        t = stiffness * deep + damping * share * rate
        return np.where(soft & ((p["play"] == 0) | (t * deep > 0)), t, 0.0)

    def acceleration(q, v, link, dlink, tau, time):
        """Of the motors (of the joints where they are stiff) and of the links, the inverse mass on
        the motors' side, and that of the links as friction at stiff joints meets it.
        """
        against = smooth(p, q, v, z, time)
        M, bias = plant.matrices(np.where(soft, link, q), np.where(soft, dlink, v), p)
        M = M + p["reflected"][:, :, None] * eye - motor[:, :, None] * eye
        spring = twist(q - link, v - dlink)
        inverse = np.linalg.inv(M)
        a = np.einsum("lij,lj->li", inverse, np.where(soft, spring, tau - against) - bias)
        own = np.where(soft, (tau - against - spring) / np.where(soft, motor, 1.0), a)
        mobility = np.where(soft[:, :, None], eye / np.where(soft, motor, 1.0)[:, :, None], inverse)
        return (
            own,
            a,
            np.where(soft[:, None, :], eye * mobility, mobility),
            np.where(soft[:, None, :], 0.0, inverse),
        )

    f = np.zeros((lanes, n))
    for k in range(steps):
        out[:, k] = q
        before, lagged = lagged, table[:, k] + (lagged - table[:, k]) * follow
        time, command = k * h, np.where(p["lag"] > 0, (before + lagged) / 2, lagged)
        tau = torque_of(plant, p, driven(p, command), q, v)
        minus, plus = dry(p, q, v, tau)
        a1, b1, first, reach = acceleration(q, v, link, dlink, tau, time)
        held, pulled = (
            a - np.einsum("lij,lj->li", m, f) for a, m in ((a1, first), (b1, reach))
        )  # with the last step's friction
        qa, va = q + h * v + h * h / 2 * held, v + h * held
        la, da = link + h * dlink + h * h / 2 * pulled, dlink + h * pulled
        tau2 = torque_of(plant, p, driven(p, command), qa, va) if plant.model == "servo" else tau
        a2, b2, last, reached = acceleration(qa, va, la, da, tau2, time + h)
        vn, mobility = v + h / 2 * (a1 + a2), (first + last) / 2
        for _ in range(1 if n == 1 else 6):  # from the last step's, so that they go on converging
            for j in range(n):
                now = vn[:, j] - h * (mobility[:, j] * f).sum(1)
                f[:, j] = np.clip(f[:, j] + now / (h * mobility[:, j, j]), -minus[:, j], plus[:, j])
        vn = vn - h * np.einsum("lij,lj->li", mobility, f)
        dn = dlink + h / 2 * (b1 + b2) - h / 2 * np.einsum("lij,lj->li", reach + reached, f)
        link, dlink = link + h / 2 * (dlink + dn), dn
        q, v = q + h / 2 * (v + vn), vn
        remember(p, z, q, v, h)
    return out


def torque_of(plant: Plant, p: Lanes, u, q, v) -> np.ndarray:
    if plant.model != "servo":
        return u
    duty = np.clip(p["gain"] * 400.0 * (u - q), -1, 1)
    return p["k_t"] * 7.4 * duty - p["k_e"] * v


# ---- the flexible link of paper 002


LINK = {
    "E": 5.7002e10,
    "I_m": 0.0053,
    "viscous": 6.3e-3,
    "coulomb": 0.03,
    "alpha": 1.824,
    "beta": 7.6275e-5,
}
PLANTS["flexible_link"] = Plant(
    "flexible_link",
    (("tau", "N m"),),
    (("phi", "rad"), ("tip_acceleration", "m/s^2")),
    _joint,
    (0.15,),
    (8.0,),
    (0.01,),
    {k: (x,) for k, x in LINK.items()},
    500,
    5e-4,
    2 * pi / 2**14,
)
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


# ---- sensors


def sensed(
    plant: Plant, q: np.ndarray, p: Lanes, parts: int, h: float, rng: np.random.Generator
) -> np.ndarray:
    lanes, steps, ny = q.shape
    at = np.arange(0, steps, parts)
    out = np.empty((lanes, at.size, ny))
    for lane in range(lanes):
        for c in range(ny):
            j = min(c, p["bias"].shape[1] - 1)
            own = (
                (lambda name, lane=lane, j=j: float(p[name][lane, j]))
                if c == j
                else (lambda name: NEUTRAL[name])
            )
            x = q[lane, :, c]
            if own("sensor_lag") > 0:
                share, y, slow = 1 - np.exp(-h / own("sensor_lag")), np.empty(steps), x[0]
                for k in range(steps):
                    slow += share * (x[k] - slow)
                    y[k] = slow
                x = y
            when = at * h - own("sensor_delay") + own("jitter") * rng.standard_normal(at.size)
            read = np.interp(when, np.arange(steps) * h, x)
            noise, step = (plant.noise, plant.resolution) if c == j else (0.05, 0.0)
            read = (
                (1 + own("gain_error")) * read + own("bias") + noise * rng.standard_normal(at.size)
            )
            out[lane, :, c] = np.round(read / step) * step if step else read
    return out
