"""Fitted parameters with uncertainty, unit and bounds."""

from __future__ import annotations

import math
from typing import Any, TYPE_CHECKING

from jaxid.report import text
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.fitting.result import Estimate, Fit


def section(fit: Fit, nominal: Fit | None = None) -> Section | None:
    """The parameters of `fit`, beside those of the nominal model where one is given."""
    before = {} if nominal is None else dict(text.parameter_rows(nominal))
    stated: dict[str, Any] = {}
    for s in fit.stated:
        names = (s.parameter, f"{s.parameter}@{s.joint}", f"{s.parameter}@{s.link}")
        stated |= dict.fromkeys(names, s.stated)
    rows = [
        (name, p, before.get(name), stated.get(name), place(p), text.remark(p))
        for name, p in text.parameter_rows(fit)
    ]
    if not rows:
        return None
    told = any(row[3] is not None for row in rows)
    return Section(
        "parameters.html",
        {
            "rows": rows,
            "compare": nominal is not None,
            "stated": told,
            "together": text.together(fit),
        },
    )


def place(estimate: Estimate) -> float | None:
    """Where the value lies between its bounds, in percent; None where a bound is open."""
    width = estimate.upper - estimate.lower
    if not (math.isfinite(width) and width > 0 and math.isfinite(estimate.value)):
        return None
    return round(100 * min(1.0, max(0.0, (estimate.value - estimate.lower) / width)), 1)
