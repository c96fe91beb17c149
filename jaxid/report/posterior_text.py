"""The posterior of a fit on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxid.base.wording import number, paragraph, table, unit_after


if TYPE_CHECKING:
    from jaxid.fitting.posterior import Posterior


def posterior_lines(posterior: Posterior | None) -> list[str]:
    """Whether the chains agree, and what they say of each number."""
    if posterior is None:
        return []
    rows = []
    for name, m in posterior.parameters.items():
        low, high = m.interval_95
        middle = f"{number(low, 4)} to {number(high, 4)}{unit_after(m.unit)}"
        effective = number(min(m.ess_bulk, m.ess_tail))
        rows.append((name, number(m.mean, 4), number(m.std), middle, number(m.r_hat), effective))
    titles = ("posterior of", "mean", "std", "middle 95 %", "R-hat", "effective draws")
    said = [posterior.statement]
    if posterior.noise_factor > 1.05:
        factor = number(posterior.noise_factor)
        said.append(f"the noise counts {factor} times as stated: the residual shows more than it")
    return [table(titles, rows), *(paragraph("posterior", [line]) for line in said)]
