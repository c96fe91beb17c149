"""Shares and means with their 95 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest, t as student


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


def mean_interval(values: Sequence[float]) -> dict[str, Any] | None:
    """The mean with the interval of Student's t between cases; None of nothing."""
    if not values:
        return None
    mean, count = float(np.mean(values)), len(values)
    reach = 0.0
    if count > 1:
        scatter = float(np.std(values, ddof=1)) / np.sqrt(count)
        reach = float(student.ppf(0.975, count - 1)) * scatter
    return {"value": mean, "interval_95": [mean - reach, mean + reach], "count": count}
