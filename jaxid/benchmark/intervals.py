"""Shares and means with their 95 % intervals, and how both are written."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest, t as student


#: How far cases scatter before any is seen; it weighs as one case.
PRIOR_SCATTER = 0.5


def wilson(hits: Sequence[bool]) -> dict[str, Any] | None:
    """The share of hits with Wilson's interval; None of nothing."""
    if not hits:
        return None
    found = binomtest(sum(hits), len(hits)).proportion_ci(method="wilson")
    value = sum(hits) / len(hits)
    return {
        "value": value,
        "interval_95": [float(found.low), float(found.high)],
        "count": len(hits),
    }


def mean_interval(
    values: Sequence[float], least: float = -np.inf, most: float = np.inf
) -> dict[str, Any] | None:
    """The mean of values between `least` and `most` with its interval; None of nothing.

    The variance has a scaled inverse chi-squared prior of one degree of freedom, so the mean has
    Student's t of as many degrees as there are cases (Gelman, Bayesian Data Analysis, 3.3). One
    case, or several that are alike, are thus no certainty.
    """
    if not values:
        return None
    mean, count = float(np.mean(values)), len(values)
    squares = float(np.sum((np.asarray(values) - mean) ** 2))
    variance = (PRIOR_SCATTER**2 + squares) / count
    reach = float(student.ppf(0.975, count)) * float(np.sqrt(variance / count))
    interval = [max(mean - reach, least), min(mean + reach, most)]
    return {"value": mean, "interval_95": interval, "count": count}


def cell(value: Any, blank: str = "") -> str:
    """A measure as a table has it: a share or mean with its interval, or a number."""
    if value is None:
        return blank
    if not isinstance(value, dict):
        return f"{value:.3g}"
    low, high = value["interval_95"]
    return f"{value['value']:.2f} ({low:.2f} to {high:.2f})"
