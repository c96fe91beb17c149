"""Draws of numbers that hang together, within their bounds."""

from __future__ import annotations

import numpy as np

from jaxid.numerics.stated_numbers import inverted
from jaxid.numerics.truncated import positive


#: Draws that are tried at the most for each that is wanted, and at once.
TRIED, AT_ONCE = 4000, 20_000


def draws(
    mean: np.ndarray,
    covariance: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    count: int,
    seed: int = 0,
) -> np.ndarray:
    """At most `count` draws [count n] of a normal distribution (`mean` [n], `covariance` [n n],
    positive semidefinite) that lie within `lower` and `upper` [n]; fewer where hardly any does.

    Draws outside are left out, so that sums and ratios that are known stay as they are.
    """
    rng = np.random.default_rng(seed)
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(positive(covariance) / size / size[:, None])
    root = vectors * np.sqrt(np.maximum(values, 0.0)) * size[:, None]
    kept: list[np.ndarray] = []
    have = tried = 0
    while have < count and tried < TRIED * count:
        x = mean + rng.standard_normal((AT_ONCE, len(mean))) @ root.T
        x = x[np.all((x >= lower) & (x <= upper), axis=1)]
        kept.append(x)
        have, tried = have + len(x), tried + AT_ONCE
    return np.concatenate([np.zeros((0, len(mean))), *kept])[:count]


def beside_the_others(covariance: np.ndarray) -> np.ndarray:
    """Standard deviation [n] of each number with all others as they are."""
    return np.sqrt(1 / np.maximum(np.diag(inverted(covariance)), 1e-300))
