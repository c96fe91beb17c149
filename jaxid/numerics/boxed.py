"""Least squares in a box from normal equations, in NumPy."""

from __future__ import annotations

import numpy as np


#: A direction of the scaled columns in which the data say less than this share of what they say
#: elsewhere stays where it was.
WEAK = 1e-9


def within_box(
    H: np.ndarray, b: np.ndarray, start: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The minimum of x'Hx / 2 - b'x in a box, and which numbers a bound holds: the primal method of
    active sets (Nocedal and Wright, Numerical Optimization, 2006, 16.5), from a start, which
    directions that H leaves open keep.
    """
    x, held = np.clip(start, lower, upper), np.zeros(len(start), bool)
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    for _ in range(10 + 3 * len(x)):
        free = ~held
        step = np.zeros_like(x)
        step[free] = _within(H, b, x, free) - x[free]
        room = np.where(step > 0, upper - x, np.where(step < 0, x - lower, np.inf))
        share = room / np.maximum(np.abs(step), 1e-300)
        if (k := int(np.argmin(share))) < len(x) and share[k] < 1:
            x = np.clip(x + share[k] * step, lower, upper)
            x[k], held[k] = (upper if step[k] > 0 else lower)[k], True
            continue
        x = np.clip(x + step, lower, upper)
        inwards = np.where(x <= lower, 1.0, -1.0) * (b - H @ x) / size
        wrong = np.where(held & (lower < upper), inwards, 0.0)
        if not wrong.max(initial=0.0) > 1e-9 * np.sqrt(max(float(b @ x), 1e-300)):
            break
        held[int(np.argmax(wrong))] = False
    return x, held


def scaled(H: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H in units of its diagonal, and the square roots of that, infinite where it is 0."""
    size = np.sqrt(np.maximum(np.diag(H), 0.0))
    size = np.where(size > 0, size, np.inf)
    return H / size / size[:, None], size


def _within(H: np.ndarray, b: np.ndarray, theta: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Numbers that are free, the others held; directions that the data leave open stay where theta
    has them.
    """
    F = H[np.ix_(free, free)]
    rest = b[free] - H[np.ix_(free, ~free)] @ theta[~free] - F @ theta[free]
    S, size = scaled(F)
    return (
        theta[free] + np.linalg.solve(S + WEAK * np.eye(len(S)), rest / size) / size
        if len(S)
        else theta[free]
    )
