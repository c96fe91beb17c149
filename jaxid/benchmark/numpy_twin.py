"""Twins for the blind cases: six plants with effects that a diagnosis is not told of, in separately
written equations (NumPy).

Nothing here imports the product. Many recordings are integrated side by side with steps of 0.1 ms:
Heun's rule for what is smooth, then dry friction as the impulse that the joints can hold, then the
position by the mean speed. A joint may have a motor of its own behind a spring with play. The arm
swings over the top and takes half these steps: over 4 s it is then off by a third of the noise,
against an adaptive solver with events.
"""

from __future__ import annotations

import numpy as np

from jaxid.benchmark.laws import driven, dry, fine, remember, smooth, torque_of
from jaxid.benchmark.link_twin import flexible
from jaxid.benchmark.plants import Lanes, NEUTRAL, TwinPlant


def recorded(plant: TwinPlant, u: np.ndarray, p: Lanes, rng: np.random.Generator) -> np.ndarray:
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


def rigid(plant: TwinPlant, u: np.ndarray, p: Lanes, parts: int, h: float) -> np.ndarray:
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


def sensed(
    plant: TwinPlant, q: np.ndarray, p: Lanes, parts: int, h: float, rng: np.random.Generator
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
