"""What is left of a normal distribution inside a box: the posterior of numbers that have bounds.

A normal distribution that is cut off at bounds is no normal one. Its first two moments are taken by
expectation propagation (Minka 2001; of boxes Cunningham, Hennig, Lacoste-Julien 2011): each bounded
number takes up a rank-one term that narrows it, so that the covariance stays positive semidefinite
whatever the bounds are.
"""

from __future__ import annotations

import functools

import numpy as np


#: A bound that lies this many standard deviations away cuts nothing off.
FAR = 8.0
#: Sweeps over the bounded numbers, and the change of a mean, in standard deviations, that ends
#: them.
SWEEPS, SETTLED = 200, 1e-6
#: Nodes of the quadrature, and the logarithm of the density, below its largest, from which it is
#: nothing.
NODES, NOTHING = 64, 40.0


def moments_within(a: float, b: float) -> tuple[float, float]:
    """Mean and variance of a standard normal variable between a and b (infinite where there is no
    bound).
    """
    nodes, weights = _quadrature()
    nearest = min(max(0.0, a), b)
    reach = np.sqrt(nearest**2 + 2 * NOTHING)
    low, high = max(a, -reach), min(b, reach)
    x = (low + high) / 2 + (high - low) / 2 * nodes
    density = weights * np.exp((nearest**2 - x**2) / 2)
    share = density / density.sum()
    mean = float(share @ x)
    return mean, float(share @ (x - mean) ** 2)


def square_beyond(push: float) -> float:
    """Mean square of a standard normal variable that is cut off below 0 and pushed against that
    bound by so much, the slope of minus the logarithm of its density there; 1 without a push.
    """
    nodes, weights = _quadrature()
    reach = float(np.sqrt(2 * NOTHING))
    if push > 0:
        reach = min(reach, NOTHING / push)
    x = reach / 2 * (1 + nodes)
    density = weights * np.exp(-max(push, 0.0) * x - x**2 / 2)
    return float(density @ x**2 / density.sum())


def pushed(covariance: np.ndarray, at: np.ndarray, push: np.ndarray) -> np.ndarray:
    """A covariance [n n] where numbers `at` stand at a bound, each with a slope `push` of minus the
    logarithm of the density there: their own mean squares from the bound, and with them what trades
    for them.
    """
    out = covariance.copy()
    for k, slope in zip(at, push, strict=True):
        own = out[k, k]
        if own > 0:
            share = square_beyond(float(slope * np.sqrt(own)))
            # Of what is all but known rounding may have left a correlation beyond 1.
            most = np.sqrt(np.maximum(np.diag(out), 0.0) * own)
            across = np.clip(out[k], -most, most)
            out = out - (1 - min(share, 1.0)) * np.outer(across, across) / own
    return positive(out)


@functools.cache
def _quadrature() -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(NODES)


def within_bounds(
    covariance: np.ndarray, mean: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean [n] and covariance [n n] of a normal distribution between `lower` and `upper` [n]
    (infinite where there is none).

    The covariance is positive semidefinite if the given one is, and nowhere wider.
    """
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    near = (mean - lower < FAR * std) | (upper - mean < FAR * std)
    at = np.flatnonzero(near & (std > 0) & (lower < upper))
    if not at.size:
        return mean, covariance
    unit = std[at]
    C = covariance[np.ix_(at, at)] / unit / unit[:, None]
    low, high = (lower - mean)[at] / unit, (upper - mean)[at] / unit
    narrowed, pulled = _terms(C, low, high)
    root = np.sqrt(narrowed)
    across = covariance[:, at] / unit * root
    inner = np.linalg.inv(np.eye(len(at)) + C * root * root[:, None])
    inner = (inner + inner.T) / 2
    inside = covariance - across @ inner @ across.T
    moved = mean + inside[:, at] / unit @ pulled
    # Rounding in a direction that is all but known may have led astray: then the box is left aside.
    narrower = np.all(np.diag(inside) <= np.diag(covariance) * (1 + 1e-6))
    in_box = np.all((moved >= lower - std) & (moved <= upper + std))
    return (moved, positive(inside)) if narrower and in_box else (mean, covariance)


def positive(matrix: np.ndarray) -> np.ndarray:
    """The matrix without what rounding left of negative eigenvalues, in units of its diagonal."""
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2 / size / size[:, None])
    if values[0] >= 0:
        return (matrix + matrix.T) / 2
    clean = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return (clean + clean.T) / 2 * size * size[:, None]


def _terms(C: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Precision and precision times mean [n] of the term that each bounded number takes up, about a
    mean of 0.
    """
    n = len(C)
    precision, shift = np.zeros(n), np.zeros(n)
    S, mean = C.copy(), np.zeros(n)
    for _ in range(SWEEPS):
        before = mean.copy()
        for k in range(n):
            _take_up(k, S, mean, precision, shift, low[k], high[k])
        root = np.sqrt(precision)
        inner = np.linalg.inv(np.eye(n) + C * root * root[:, None])
        S = C - (C * root) @ inner @ (C * root).T
        S = (S + S.T) / 2
        mean = S @ shift
        if np.all(np.abs(mean - before) <= SETTLED):
            break
    return precision, shift


def _take_up(
    k: int,
    S: np.ndarray,
    mean: np.ndarray,
    precision: np.ndarray,
    shift: np.ndarray,
    low: float,
    high: float,
) -> None:
    """The term of number k anew, beside those of all others; changes S, mean, precision and shift
    in place.
    """
    own = S[k, k]
    rest = 1 / own - precision[k]
    if not own > 0 or not rest > 0:
        return
    variance = 1 / rest
    centre = variance * (mean[k] / own - shift[k])
    std = np.sqrt(variance)
    m, v = moments_within((low - centre) / std, (high - centre) / std)
    v = min(max(v, 1e-12), 1.0) * variance
    m = centre + std * m
    wanted = max(1 / v - rest, 0.0)
    more = wanted - precision[k]
    precision[k], shift[k] = wanted, m / v - centre / variance
    column = S[:, k].copy()
    S -= more / (1 + more * own) * np.outer(column, column)
    mean[:] = S @ shift
