"""Forces of the effects, drives and commands of the twins (NumPy), side by side in lanes."""

from __future__ import annotations

from math import pi

import numpy as np

from jaxid.benchmark.plants import Lanes, TwinPlant


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


def torque_of(plant: TwinPlant, p: Lanes, u, q, v) -> np.ndarray:
    if plant.model != "servo":
        return u
    duty = np.clip(p["gain"] * 400.0 * (u - q), -1, 1)
    return p["k_t"] * 7.4 * duty - p["k_e"] * v
