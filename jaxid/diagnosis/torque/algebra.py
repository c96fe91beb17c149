"""Whitened normal equations: each joint's residual through its own autoregression, then sums of products, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from jaxid.diagnosis.torque.rows import Run


#: Order of the autoregression of a joint's residual.
ORDER = 3
#: A direction of the scaled columns in which the data say less than this share of what they say elsewhere stays where it was.
WEAK = 1e-9
#: Held-out rows are compared in so many blocks.
BLOCKS = 24


@dataclass(frozen=True)
class Whitening:
    """Autoregression [n ORDER] and innovation [n] of each joint's residual."""

    coefficients: np.ndarray
    scale: np.ndarray

    def __call__(self, x: np.ndarray, moves: np.ndarray) -> np.ndarray:
        """Rows [samples n k] whitened, [samples - ORDER n k]; those of joints that stand still count for nothing."""
        out = x[ORDER:].copy()
        for lag in range(1, ORDER + 1):
            out -= self.coefficients[:, lag - 1, None] * x[ORDER - lag : len(x) - lag]
        return out * (moves / self.scale)[:, None]


def whitening(residuals: Sequence[np.ndarray], moves: Sequence[np.ndarray], floor: np.ndarray) -> Whitening:
    """Of residuals [samples n] of several runs, by Yule and Walker; innovations are no less than `floor` [n]."""
    n = residuals[0].shape[1]
    a, scale = np.zeros((n, ORDER)), np.ones(n)
    for j in range(n):
        own = [r[:, j] for r, m in zip(residuals, moves, strict=True) if m[j]]
        if not own:
            continue
        power = np.array([sum(float(r[k:] @ r[: len(r) - k]) for r in own) for k in range(ORDER + 1)])
        power /= sum(map(len, own))
        if power[0] <= 0:
            scale[j] = floor[j]
            continue
        R = power[np.abs(np.subtract.outer(range(ORDER), range(ORDER)))] + 1e-9 * power[0] * np.eye(ORDER)
        a[j] = np.linalg.solve(R, power[1:])
        variance = max(power[0] - float(a[j] @ power[1:]), 0.0)
        scale[j] = max(np.sqrt(variance), 1e-6 * np.sqrt(power[0]), floor[j] * np.sqrt(max(variance / power[0], 1e-6)), 1e-12)
    return Whitening(a, scale)


@dataclass(frozen=True)
class Gram:
    """Sums of products of whitened columns and, last, the target: of blocks [blocks p + 1 p + 1], their runs, rows in all."""

    blocks: np.ndarray
    owner: np.ndarray
    rows: int
    total: np.ndarray = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "total", self.blocks.sum(0))

    def losses(self, at: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Sum of squares of each block [blocks] for numbers theta of the columns `at`."""
        full = np.append(at, self.blocks.shape[1] - 1)
        v = np.append(-theta, 1.0)
        return np.einsum("bij,i,j->b", self.blocks[:, full[:, None], full], v, v)

    def scores(self, at: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Half the slope of each block's sum of squares by the numbers of the columns `at` [blocks at]."""
        return self.blocks[:, at, -1] - self.blocks[:, at[:, None], at] @ theta


def gram(runs: Sequence[Run], rows: Sequence[np.ndarray], white: Whitening, blocks: int) -> Gram:
    """Of rows [samples n p + 1] of some runs, cut into about so many blocks of equal length."""
    made = [white(x, r.moves) for x, r in zip(rows, runs, strict=True)]
    length = max(1, sum(map(len, made)) // blocks)
    parts, owner = [], []
    for k, x in enumerate(made):
        for piece in np.array_split(x, max(1, round(len(x) / length))):
            flat = piece.reshape(-1, piece.shape[2])
            parts.append(flat.T @ flat)
            owner.append(k)
    return Gram(np.array(parts), np.array(owner), sum(x.shape[0] * int(r.moves.sum()) for x, r in zip(made, runs, strict=True)))


@dataclass(frozen=True)
class Known:
    """What is known of columns beforehand: information matrix [p p] about `mean` [p]."""

    information: np.ndarray
    mean: np.ndarray


@dataclass(frozen=True)
class Solution:
    """Least squares of some columns: numbers, what is known of them, and what is left (priors included)."""

    at: np.ndarray
    theta: np.ndarray
    cost: float
    bound: np.ndarray  # which numbers a bound holds
    information: np.ndarray

    @cached_property
    def spread(self) -> tuple[np.ndarray, np.ndarray]:
        """Covariance, and which numbers are determined."""
        return _spread(self.information, ~self.bound)


def solve(g: np.ndarray, at: np.ndarray, known: Known, start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Solution:
    """Numbers of the columns `at` of a sum of products g [p + 1 p + 1] with what is known beforehand [p], within bounds [p]."""
    at = np.asarray(at, int)
    H0, b0 = g[np.ix_(at, at)], g[at, -1]
    P = known.information[np.ix_(at, at)]
    H, b = H0 + P, b0 + P @ known.mean[at]
    theta, held = start[at].copy(), np.zeros(len(at), bool)
    for _ in range(6):
        free = ~held
        theta[free] = _within(H, b, theta, free)
        low, high = theta < lower[at] - 1e-12, theta > upper[at] + 1e-12
        out = (low | high) & free
        if not out.any():
            break
        theta = np.clip(theta, lower[at], upper[at])
        held |= out
    rest = float(g[-1, -1] - 2 * b0 @ theta + theta @ H0 @ theta)
    prior = float((theta - known.mean[at]) @ P @ (theta - known.mean[at]))
    return Solution(at, theta, rest + prior, held, H)


def _scaled(H: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    size = np.sqrt(np.maximum(np.diag(H), 0.0))
    size = np.where(size > 0, size, np.inf)
    return H / size / size[:, None], size


def _within(H: np.ndarray, b: np.ndarray, theta: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Numbers that are free, the others held; directions that the data leave open stay where theta has them."""
    F = H[np.ix_(free, free)]
    rest = b[free] - H[np.ix_(free, ~free)] @ theta[~free] - F @ theta[free]
    S, size = _scaled(F)
    return theta[free] + np.linalg.solve(S + WEAK * np.eye(len(S)), rest / size) / size if len(S) else theta[free]


def _spread(H: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance, and which numbers take part in no direction that the data leave open."""
    out, determined = np.full(H.shape, np.nan), np.zeros(len(H), bool)
    S, size = _scaled(H[np.ix_(free, free)])
    if not len(S):
        return out, determined
    values, vectors = np.linalg.eigh(S)
    open_ = values < 100 * WEAK
    inverse = (vectors / np.maximum(values, WEAK)) @ vectors.T / size / size[:, None]
    out[np.ix_(free, free)] = inverse
    determined[free] = np.isfinite(size) & (np.sum(vectors[:, open_] ** 2, 1) < 1e-3)
    return out, determined


def better(before: np.ndarray, after: np.ndarray, owner: np.ndarray) -> tuple[float, float]:
    """By how many standard errors the sums of squares of blocks fall, in all and in the run where that is least.

    Logarithms are compared: an effect that acts in few blocks is seen in these, and no single block decides. What falls so but
    not in sum does not count."""
    gain = np.log(np.maximum(before, 1e-300) / np.maximum(after, 1e-300))

    def errors(inside: np.ndarray) -> float:
        found = _errors(gain[inside])
        return found if before[inside].sum() > after[inside].sum() else min(found, 0.0)

    return errors(owner >= 0), min((errors(owner == k) for k in np.unique(owner)), default=0.0)


def _errors(gain: np.ndarray) -> float:
    if len(gain) < 2:
        return float(np.sign(gain.sum()))
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), 1e-300))
