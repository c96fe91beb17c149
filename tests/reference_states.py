"""Separately written equations of effects that have states of their own, without dry friction
(SciPy).

Nothing here imports the product. Each memory adds its states and their rates to those of the
mechanism; everything is integrated together from sample to sample of the held command.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from reference import drive, Plant, Truth


@dataclass(frozen=True)
class Memory:
    """Torque against the motor's motion: `rate(z, q, v)` of `size` states a joint, `torque(z, rate,
    q, v)`.
    """

    size: int
    rate: Callable[..., np.ndarray]
    torque: Callable[..., np.ndarray]


def lugre(level, presliding, relaxation=0.0) -> Memory:
    def rate(z, q, v):
        return (v - abs(v) * z[0]) / presliding

    return Memory(
        1,
        lambda z, q, v: rate(z, q, v)[None],
        lambda z, r, q, v: level * (z[0] + relaxation * r[0]),
    )


def hysteresis(level, width) -> Memory:
    def rate(z, q, v):
        grows = z[0] * v > 0
        return (np.where(grows, 1 - abs(z[0]), 1.0) * v / width)[None]

    return Memory(1, rate, lambda z, r, q, v: level * z[0])


def warm_friction(change, time) -> Memory:
    return Memory(
        1, lambda z, q, v: ((v**2 - z[0]) / time)[None], lambda z, r, q, v: change * z[0] * v
    )


def swinging_mass(inertia, frequency, damping_ratio) -> Memory:
    """States: position and speed of the mass."""
    w = 2 * np.pi * np.asarray(frequency)

    def pull(z, q, v):
        return w * w * (q - z[0]) + 2 * damping_ratio * w * (v - z[1])

    return Memory(
        2, lambda z, q, v: np.stack([z[1], pull(z, q, v)]), lambda z, r, q, v: inertia * r[1]
    )


@dataclass(frozen=True)
class Coupling:
    """A motor with a share of the inertia before a spring with play."""

    compliance: Any
    share: Any
    damping_ratio: Any = 0.0
    play: Any = 0.0

    def __call__(self, plant: Plant, n: int) -> tuple[np.ndarray, Callable[..., np.ndarray]]:
        """Motor inertia, and spring torque of (gap, its rate)."""
        M0 = plant(np.zeros(n), np.zeros(n))[0]
        seen = 1 / np.diag(np.linalg.inv(M0))
        motor = self.share * seen
        k = 1 / np.asarray(self.compliance) * np.ones(n)
        contact = np.any(np.asarray(self.play) > 0)
        zeta = 0.5 if contact else self.damping_ratio
        d = 2 * zeta * np.sqrt(k * motor * (seen - motor) / seen)

        def torque(gap, rate):
            if not contact:
                return k * gap + d * rate
            deep = np.maximum(abs(gap) - self.play / 2, 0.0) * np.sign(gap)
            t = k * deep + d * np.minimum(abs(deep) / (0.05 * self.play), 1.0) * rate
            return np.where(t * deep > 0, t, 0.0)

        return motor, torque


def simulate(
    plant: Plant,
    truth: Truth,
    t: np.ndarray,
    u: np.ndarray,
    at: np.ndarray,
    memories: Sequence[Memory] = (),
    coupling: Coupling | None = None,
    sensor_lag: Any = 0.0,
    longest: float = np.inf,
) -> dict[str, np.ndarray]:
    """From rest at zero; at the times `at`: motor position `q`, acceleration on both sides `qdd`
    [2], lagging reading `y`.
    """
    n = u.shape[1]
    sizes = [m.size for m in memories]
    lagging = np.any(sensor_lag > 0)
    motor, spring = coupling(plant, n) if coupling else (None, None)

    def parts(s):
        return s.reshape(-1, n)

    def rates(torque, s):
        rows = parts(s)
        q, v, out = rows[0], rows[1], [rows[1], None]
        k, against = 2, truth.smooth(rows[0], rows[1])
        for m in memories:
            z = rows[k : k + m.size]
            r = m.rate(z, q, v)
            against = against + m.torque(z, r, q, v)
            out += list(r)
            k += m.size
        if coupling and spring is not None and motor is not None:
            link, dlink = rows[k], rows[k + 1]
            load = spring(q - link, v - dlink)
            M, bias = plant(link, dlink)
            out[1] = (torque - against - load) / motor
            out += [dlink, np.linalg.solve(M - np.diag(motor), load - bias)]
            k += 2
        else:
            M, bias = plant(q, v)
            out[1] = np.linalg.solve(M, torque - against - bias)
        if lagging:
            out.append((q - rows[k]) / sensor_lag)
        return np.concatenate(out)

    count = 2 + sum(sizes) + (2 if coupling else 0) + (1 if lagging else 0)
    s = np.zeros(count * n)
    found = {
        "q": np.zeros((len(at), n)),
        "y": np.zeros((len(at), n)),
        "qdd": np.zeros((len(at), 2, n)),
    }
    for piece in drive(t, u, truth):

        def f(x, s, p=piece):
            return rates(p.torque(x), s)

        run = solve_ivp(
            f,
            (piece.begin, piece.end),
            s,
            "DOP853",
            rtol=1e-10,
            atol=1e-13,
            dense_output=True,
            max_step=longest,
        )
        for i in np.flatnonzero((at >= piece.begin - 1e-12) & (at <= piece.end + 1e-12)):
            x = min(max(at[i], piece.begin), piece.end)
            here = s if x == piece.begin else run.y[:, -1] if x == piece.end else run.sol(x)
            rows = parts(here)
            side = 1 if abs(at[i] - piece.begin) < 1e-12 else 0
            found["q"][i], found["y"][i] = rows[0], rows[-1] if lagging else rows[0]
            found["qdd"][i, side] = rates(piece.torque(x), here).reshape(-1, n)[1]
        s = run.y[:, -1]
    return found
