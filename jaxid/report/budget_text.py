"""The budget of a gap in words: where re-tuned numbers close most of it, that is said first."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxid.base.wording import percent
from jaxid.diagnosis.budget import closed_by_numbers, MOST
from jaxid.report.other_numbers import moved_numbers


if TYPE_CHECKING:
    from jaxid.diagnosis.result import Diagnosis


def by_numbers(diagnosis: Diagnosis) -> str:
    """`Re-tuned numbers close 99.6 % of the gap as stated`; empty where they do not close most of
    it.
    """
    share = closed_by_numbers(diagnosis.budget)
    if share < MOST:
        return ""
    return f"Re-tuned numbers close {percent(share)} of the gap as stated"


def budget_sentence(diagnosis: Diagnosis) -> str:
    """What re-tuned numbers close, and what effects close of the rest; empty where numbers do not
    close most, or nothing is left for an effect.
    """
    head = by_numbers(diagnosis)
    if not head or diagnosis.which.verdict == "none":
        return ""
    added = [step for step in diagnosis.budget if step.step == "effects"]
    if not added or added[0].closes is None or added[0].closes <= 0:
        return f"{head}."
    single = len(diagnosis.which.effects) == 1
    what = "the effect closes" if single else "the effects close"
    return f"{head}; {what} {percent(added[0].closes)} of what is left then."


def headline_of_unknown(diagnosis: Diagnosis) -> str:
    """The headline where no effect is named."""
    head = by_numbers(diagnosis)
    if not head:
        return "There is a gap that no known effect explains."
    rest = "What is left then no known effect explains."
    moved = moved_numbers(diagnosis)
    if not moved:
        return f"{head}. {rest}"
    closed = percent(closed_by_numbers(diagnosis.budget))
    return f"With {moved}, {closed} of the gap as stated is closed. {rest}"
