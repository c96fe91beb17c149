"""Rows and clocks: by how many rows the inputs are late against the motion, and whether that grows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jaxid.conventions.missing_force import ForceFit, Motion


#: A delay is one of whole rows if it is known so well (rows) and lies so close to them.
KNOWN, CLOSE = 0.12, 0.25
SURE = 6.0  # standard deviations
#: A clock's drift moves the input by at least so many rows within a run.
DRIFT = 0.7
MOST_ROWS, MOST_DRIFT = 6.0, 0.02


@dataclass(frozen=True)
class Late:
    """By how many rows an input stands later than it acts, and how fast that grows (s/s), with standard deviations."""

    rows: float
    std: float
    drift: float
    drift_std: float


def lateness(fit: ForceFit, m: Motion) -> tuple[list[Late], Motion]:
    """Of each input, beside any law of the joint's own motion (what a model lacks there is no delay); and the motion without."""
    nu, nq, size = len(m.mix), fit.nq, len(fit.free)
    late: list[Late] = []
    for _ in range(4):
        fitted = fit.fit(replace(m, held=np.zeros(len(m.held), bool)))
        theta = fit.binding.theta.copy()
        theta[fit.free] = fitted.x[:size]
        weight, base = m.weight / fit.norm(m), fit.missing(theta, m)
        own = _own_laws(m) * weight[..., None]
        parts = [fitted.slopes[..., :size]]
        for j in range(nq):
            laws = np.zeros((*weight.shape, own.shape[2]))
            laws[:, j] = own[:, j]
            parts.append(laws)
        columns = []
        for k in range(nu):
            pushed = replace(m, rows=m.rows + 0.05 * (np.arange(nu) == k))
            columns.append((fit.missing(theta, pushed) - base) * weight / 0.05)
        growing = [c * ((m.since - m.since.mean()) / m.step)[:, None] for c in columns]
        whole = replace(fitted, slopes=np.concatenate([*parts, np.stack([*columns, *growing], -1)], -1))
        first = whole.slopes.shape[-1] - 2 * nu
        steps = [fit.spread(whole, m, first + k) for k in range(2 * nu)]
        good = lambda pair, most: float(np.clip(pair[0], -most, most)) if np.isfinite(pair[1]) else 0.0
        drift = np.array([good(p, MOST_DRIFT) for p in steps[nu:]])
        sure = together(m.drift + drift, np.array([s for _, s in steps[nu:]])) is not None
        change = drift if sure else -m.drift
        rows = np.array([good(p, 2.0) for p in steps[:nu]]) - change * m.since.mean() / m.step
        late = [Late(float(m.rows[k] + rows[k]), steps[k][1], float(m.drift[k] + change[k]), steps[nu + k][1]) for k in range(nu)]
        m = replace(m, rows=np.clip(m.rows + rows, -MOST_ROWS, MOST_ROWS), drift=m.drift + change)
    return late, m


def together(values: np.ndarray, stds: np.ndarray) -> tuple[float, float] | None:
    """Mean and standard deviation of what several inputs say, where that is surely not zero and they agree."""
    known = np.isfinite(stds) & (stds > 0)
    if not known.any():
        return None
    weight = np.where(known, 1 / np.where(known, stds, 1.0) ** 2, 0.0)
    mean, std = float(np.sum(weight * values) / weight.sum()), float(1 / np.sqrt(weight.sum()))
    agree = bool(np.all(np.abs(values - mean)[known] <= 3 * stds[known] + 0.02 * abs(mean)))
    return (mean, std) if agree and abs(mean) > SURE * std else None


def _own_laws(m: Motion) -> np.ndarray:
    """Any force of the joint's own motion [rows nq laws], whatever its sign."""
    parts = [np.ones_like(m.q), m.q, m.qd, m.qdd, np.sign(m.qd), m.qd * np.abs(m.qd), np.sin(m.q), np.cos(m.q)]
    return np.stack([a / max(1e-300, float(np.sqrt(np.mean(a**2)))) for a in map(m.mean, parts)], -1)
