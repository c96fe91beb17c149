"""Weighted normal equations, block by block: sums of products of columns and target.

Every row of a joint has the same weight. The residual's own spectrum (an autoregression) must not
weigh: what a model lacks is slow and large, so that it would count little, and the frequencies
beyond the motion much, in which columns are the noise of readings; numbers would be drawn to
nothing, which makes what is left slower still.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.repeats import shrunk
from jaxid.diagnosis.torque.rows import TorqueRun
from jaxid.force import least_squares
from jaxid.force.least_squares import in_units_of_diagonal, NormalEquations, WEAK


#: Rounds in which the size of what is left and the weight of rows of which less is known settle.
ROUNDS = 5
#: Held-out rows are compared in this many blocks.
BLOCKS = 24


@dataclass(frozen=True)
class Weights:
    """What is left of each joint's torque [n], N m, how many rows share one piece of it [n], and a
    root of the covariance of the first columns' numbers from run to run [k r].
    """

    size: np.ndarray
    memory: np.ndarray
    spread: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def share(self, unsure: np.ndarray) -> np.ndarray:
        """What a row counts for [samples n] whose torque is known to within `unsure` only, N m."""
        return 1 / np.sqrt(1 + (unsure / self.size) ** 2)

    def __call__(self, x: np.ndarray, moves: np.ndarray, unsure: np.ndarray) -> np.ndarray:
        """Rows [samples n k] in units of what is left, so that sums of squares count what is
        independent; those of joints that stand still count for nothing.
        """
        return x * (self.share(unsure) * moves / self.size / np.sqrt(self.memory))[:, :, None]

    def count(self, moves: np.ndarray, unsure: np.ndarray) -> float:
        """How many independent rows those of a run are worth."""
        return float(np.sum(self.share(unsure) ** 2 * moves / self.memory))


def weighted(
    residuals: Sequence[np.ndarray], moves: Sequence[np.ndarray], unsure: Sequence[np.ndarray]
) -> Weights:
    """Of residuals [samples n] of several runs, which joints move in them [n], and to within what
    they are known [samples n].
    """
    n = residuals[0].shape[1]
    size, memory = np.ones(n), np.ones(n)
    for j in range(n):
        own = [(r[:, j], u[:, j]) for r, m, u in zip(residuals, moves, unsure, strict=True) if m[j]]
        if not own:
            continue
        r, u = (np.concatenate(x) for x in zip(*own, strict=True))
        size[j] = max(np.sqrt(np.mean(r**2)), 1e-12)
        for _ in range(ROUNDS):
            share = 1 / (1 + (u / size[j]) ** 2)
            size[j] = max(np.sqrt(np.sum(share * r**2) / np.sum(share)), 1e-12)
        memory[j] = memory_of([r / np.hypot(size[j], u) for r, u in own])
    return Weights(size, memory)


def memory_of(series: Sequence[np.ndarray]) -> float:
    """1 + 2 sum of the autocorrelation of some series up to the first lag where it is lost."""
    power, found = sum(float(r @ r) for r in series), 1.0
    lost = LIMITS.two_sigma / np.sqrt(max(1, sum(map(len, series))))
    for lag in range(1, max(map(len, series)) // 3 + 1):
        share = sum(float(r[lag:] @ r[:-lag]) for r in series) / max(power, 1e-300)
        if share < lost:
            break
        found += 2 * share
    return found


@dataclass(frozen=True)
class Gram:
    """Sums of products of weighted columns and, last, the target: of blocks [blocks p + 1 p + 1],
    their runs; rows that are independent; whether repeats tell the noise, so that sums of squares
    are chi-square.
    """

    blocks: np.ndarray
    owner: np.ndarray
    rows: float
    repeated: bool
    total: np.ndarray = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "total", self.blocks.sum(0))

    def losses(self, at: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Sum of squares of each block [blocks] for numbers theta of the columns `at`."""
        full = np.append(at, self.blocks.shape[1] - 1)
        v = np.append(-theta, 1.0)
        return np.einsum("bij,i,j->b", self.blocks[:, full[:, None], full], v, v)

    def scores(self, at: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Half the slope of each block's sum of squares by the numbers of the columns `at` [blocks
        at].
        """
        return self.blocks[:, at, -1] - self.blocks[:, at[:, None], at] @ theta


def gram(
    runs: Sequence[TorqueRun],
    rows: Sequence[np.ndarray],
    unsure: Sequence[np.ndarray],
    weights: Weights,
    blocks: int,
) -> Gram:
    """Of rows [samples n p + 1] of some runs, known to within `unsure` [samples n], cut into about
    this many blocks of equal length.
    """
    made = [weights(x, r.moves, u) for x, r, u in zip(rows, runs, unsure, strict=True)]
    length = max(1, sum(map(len, made)) // blocks)
    parts, owner = [], []
    for k, x in enumerate(made):
        for piece in np.array_split(x, max(1, round(len(x) / length))):
            flat = piece.reshape(-1, piece.shape[2])
            parts.append(shrunk(flat.T @ flat, weights.spread))
            owner.append(k)
    count = sum(weights.count(r.moves, u) for r, u in zip(runs, unsure, strict=True))
    return Gram(np.array(parts), np.array(owner), count, weights.spread.size > 0)


@dataclass(frozen=True)
class ColumnPrior:
    """What is known of columns beforehand: information matrix [p p] about `mean` [p]."""

    information: np.ndarray
    mean: np.ndarray


@dataclass(frozen=True)
class Departure:
    """What another recording told of the numbers of some columns: information [k k] about `mean`
    [k], of the columns `at` [k].
    """

    at: np.ndarray
    information: np.ndarray
    mean: np.ndarray

    def __call__(self, theta: np.ndarray) -> float:
        """By how much the numbers of all columns depart from that, chi-square units."""
        apart = theta[self.at] - self.mean
        return float(apart @ self.information @ apart)


def departure(known: ColumnPrior, inside: np.ndarray) -> Departure:
    """Of the numbers `inside` [p], whatever the other ones are: these may drift between two
    recordings.
    """
    told = np.diag(known.information) > 0
    at, others = np.flatnonzero(inside & told), np.flatnonzero(~inside & told)
    P = known.information
    across = P[np.ix_(at, others)]
    least = np.linalg.pinv(P[np.ix_(others, others)], hermitian=True)
    return Departure(at, P[np.ix_(at, at)] - across @ least @ across.T, known.mean[at])


@dataclass(frozen=True)
class Solution:
    """Least squares of some columns: numbers, what is known of them, and what is left (priors
    included).
    """

    at: np.ndarray
    theta: np.ndarray
    cost: float
    bound: np.ndarray  # which numbers a bound holds
    information: np.ndarray

    @cached_property
    def spread(self) -> tuple[np.ndarray, np.ndarray]:
        """Covariance, and which numbers are determined."""
        return _spread(self.information, ~self.bound)


def solve(
    g: np.ndarray,
    at: np.ndarray,
    known: ColumnPrior,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> Solution:
    """Numbers of the columns `at` of a sum of products g [p + 1 p + 1] with what is known
    beforehand [p], within bounds [p].
    """
    at = np.asarray(at, int)
    H0, b0 = g[np.ix_(at, at)], g[at, -1]
    P = known.information[np.ix_(at, at)]
    H, b = H0 + P, b0 + P @ known.mean[at]
    theta, held = least_squares.solve(NormalEquations(H, b), start[at], lower[at], upper[at])
    rest = float(g[-1, -1] - 2 * b0 @ theta + theta @ H0 @ theta)
    prior = float((theta - known.mean[at]) @ P @ (theta - known.mean[at]))
    return Solution(at, theta, rest + prior, held, H)


def _spread(H: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance, and which numbers take part in no direction that the data leave open."""
    out, determined = np.full(H.shape, np.nan), np.zeros(len(H), bool)
    S, size = in_units_of_diagonal(H[np.ix_(free, free)])
    if not len(S):
        return out, determined
    values, vectors = np.linalg.eigh(S)
    open_ = values < 100 * WEAK
    inverse = (vectors / np.maximum(values, WEAK)) @ vectors.T / size / size[:, None]
    out[np.ix_(free, free)] = inverse
    determined[free] = np.isfinite(size) & (np.sum(vectors[:, open_] ** 2, 1) < 1e-3)
    return out, determined


def better(before: np.ndarray, after: np.ndarray, g: Gram) -> tuple[float, float]:
    """By how many standard errors the sums of squares of the blocks of g fall, in all and in the
    run where that is least.

    Where repeats tell the noise that is the root of the chi-square. Else blocks tell, by their
    logarithms: an effect that acts in few blocks is seen in these, and no single block decides.
    What falls so but not in sum does not count.
    """
    gain = np.log(np.maximum(before, 1e-300) / np.maximum(after, 1e-300))

    def errors(inside: np.ndarray) -> float:
        less = float((before - after)[inside].sum())
        if g.repeated:
            return float(np.sign(less) * np.sqrt(abs(less)))
        found = _errors(gain[inside])
        return found if less > 0 else min(found, 0.0)

    return errors(g.owner >= 0), min(
        (errors(g.owner == k) for k in np.unique(g.owner)), default=0.0
    )


def _errors(gain: np.ndarray) -> float:
    if len(gain) < 2:
        return float(np.sign(gain.sum()))
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), 1e-300))
