"""Regimes of a motion: when a joint moves slowly, fast, forwards, under load, late."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np


if TYPE_CHECKING:
    from jaxid.diagnosis.missing import Missing


#: Share of the largest speed below which a joint may be standing still.
STANDS = 0.03


def situations(found: Sequence[Missing], joint: int) -> dict[str, list[np.ndarray]]:
    """Masks [runs][time] of all regimes of a joint."""
    of_runs = [regimes(m, joint) for m in found]
    out: dict[str, list[np.ndarray]] = {}
    for masks in of_runs:
        for name in masks:
            out.setdefault(name, [])
    for name, inside in out.items():
        for m, masks in zip(found, of_runs, strict=True):
            nowhere = np.zeros(len(m.q), bool)
            inside.append(masks.get(name, nowhere))
    return out


def regimes(m: Missing, joint: int) -> dict[str, np.ndarray]:
    """Masks over the kept samples of one run and joint: the situations in which a machine can
    be.
    """
    qd, q, qdd = m.qd[:, joint], m.q[:, joint], m.qdd[:, joint]
    speed = np.percentile(np.abs(qd), 99) + 1e-300
    t = m.experiment.t[m.keep]
    v = np.abs(qd) / speed
    moving = v > STANDS
    sign = np.sign(np.where(moving, qd, 0.0))
    filled = _last_nonzero(sign)
    flips = np.flatnonzero(np.diff(filled) != 0)
    near = np.zeros(len(t), bool)
    span = t[-1] - t[0]
    reach = min(0.1, span / 100)
    for f in flips:
        near |= np.abs(t - t[f]) <= reach
    starts = np.flatnonzero(moving[1:] & ~moving[:-1])
    leaving = np.zeros(len(t), bool)
    for f in starts:
        leaving |= (t >= t[f]) & (t <= t[f] + reach)
    a = np.abs(qdd) / (np.percentile(np.abs(qdd), 99) + 1e-300)
    low, high = np.percentile(q, [2, 98])
    out = {
        "standstill": ~moving,
        "breakaway": leaving & ~near,
        "velocity_reversal": near,
        "low_speed": moving & (v < 0.25),
        "high_speed": v > 0.7,
        "forward": sign > 0,
        "backward": sign < 0,
        "high_acceleration": a > 0.6,
        "upper_travel": q > low + 0.8 * (high - low),
        "lower_travel": q < low + 0.2 * (high - low),
        "early": t < t[0] + span / 3,
        "late": t > t[0] + 2 * span / 3,
    }
    u = np.abs(m.load[:, joint])
    top = np.percentile(u, 99)
    if top > 0:
        out["high_load"] = u > 0.7 * top
        out["low_load"] = u < 0.15 * top
    return out


def _last_nonzero(sign: np.ndarray) -> np.ndarray:
    index = np.where(sign != 0, np.arange(len(sign)), 0)
    return sign[np.maximum.accumulate(index)]
