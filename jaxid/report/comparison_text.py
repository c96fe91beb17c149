"""What a comparison of fitters says on a terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from jaxid.base.wording import (
    listed,
    number,
    one_line,
    percent,
    short,
    table,
    wrapped,
)
from jaxid.conventions.finding import data_lines


if TYPE_CHECKING:
    from jaxid.fitting.comparison import Comparison, Typical


def comparison_headline(c: Comparison) -> str:
    """Which fitter reached the target most reliably, at which cost."""
    table = c.table
    best = table[0]
    if not best.successes:
        return f"No fitter came within {percent(c.tolerance)} of the best known loss."
    equal = [s for s in table if s.successes * best.runs == best.successes * s.runs]
    others = (
        f", like {listed(s.fitter for s in equal[1:])} (at no less cost)" if len(equal) > 1 else ""
    )
    return (
        f"{best.fitter} reached the best known loss in {best.successes} of {best.runs}"
        f" runs{others}."
    )


def comparison_setting(c: Comparison) -> str:
    """What was the same for all."""
    limits = [f"{c.budget} evaluations"] if c.budget is not None else []
    limits += [f"{short(c.limit_s)} s"] if c.limit_s is not None else []
    return (
        f"Every fitter on {c.residual}, {c.loss_name.replace('_', ' ')}, with at most"
        f" {' and '.join(limits)} a run, from"
        f" {'random starts within the bounds' if c.starts == 'random' else 'the start that the data suggest'}."
        f" The target is {number(c.target, 5)}: the best known loss {number(c.best_loss, 5)} plus"
        f" {percent(c.tolerance)}."
    )


def comparison_rows(c: Comparison) -> list[list[str]]:
    """One line a fitter: the cells of the table that terminal and report share."""
    rows = []
    for s in c.table:
        low, high = s.success_interval_95
        rows.append(
            [
                one_line(s.fitter),
                f"{s.successes}/{s.runs} ({100 * low:.0f} to {100 * high:.0f} %)",
                f"{s.in_time}/{s.runs}",
                spread(s.evaluations_to_target),
                spread(s.seconds_to_target),
                count(s.expected_evaluations),
                number(s.loss.median, 4),
                count(s.evaluations),
                number(s.seconds, 2),
            ]
        )
    return rows


def spread(t: Typical) -> str:
    """`410 (380 to 520)`, with ∞ for what was never reached."""
    return (
        f"{count(t.median)} ({count(t.lower)} to {count(t.upper)})"
        if math.isfinite(t.median) or math.isfinite(t.lower)
        else "∞"
    )


def count(value: float) -> str:
    """A count or a time, three digits."""
    return "∞" if math.isinf(value) else f"{value:.0f}" if value >= 100 else number(value, 2)


def comparison_text(c: Comparison) -> str:
    """Headline and table of a comparison."""
    header = (
        "fitter",
        "reached",
        f"in {number(c.common_time, 2)} s",
        "evaluations to target",
        "seconds to target",
        "per success",
        "median loss",
        "evaluations",
        "seconds",
    )
    parts = [
        *map(wrapped, data_lines(c.data)),
        wrapped(f"{c.dataset}, model {c.model}: {comparison_headline(c)}"),
        wrapped(comparison_setting(c)),
        table(header, comparison_rows(c)),
        f"{len(c.runs)} runs in {number(c.wall_time_s)} s",
    ]
    return "\n".join(parts)
