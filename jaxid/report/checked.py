"""What a recording says about itself: the page of `jaxid check`, and the part of every other page
that says it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from jaxid.base import wording
from jaxid.conventions import words
from jaxid.conventions.finding import data_lines
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.conventions.finding import Checked, DataFinding


def section(checked: Checked) -> Section:
    """All findings, and that there are none."""
    return _section(
        checked.findings, words.headline(checked), checked.dataset, checked.model, checked.notes
    )


def before(findings: Sequence[DataFinding]) -> Section | None:
    """What was found in a recording before an answer; None where nothing was, or only asked."""
    if not any(f.applied or f.decisive for f in findings):
        return None
    return _section(
        findings,
        " ".join(data_lines(findings)) or "Found in the recording, and not applied",
        "",
        "",
        (),
    )


def asked(findings: Sequence[DataFinding]) -> Section | None:
    """Questions about a recording, after an answer; None where there are none, or where they stand
    with what was found.
    """
    if not findings or before(findings):
        return None
    return _section(findings, "Questions about the recording", "", "", ())


def _section(findings, headline: str, dataset: str, model: str, notes) -> Section:
    return Section(
        "checked.html",
        {
            "headline": headline,
            "dataset": dataset,
            "model": model,
            "rows": [(f, _state(f), _gap(f), f.line.splitlines(), _same(f)) for f in findings],
            "notes": notes,
            "mending": any(f.line or _gap(f) for f in findings),
        },
    )


def _state(f: DataFinding) -> str:
    return "applied" if f.applied else "found, not applied" if f.decisive else "question"


def _gap(f: DataFinding) -> str:
    if f.gap_before is None or f.gap_if_mended is None:
        return ""
    return f"{wording.times(f.gap_before)} to {wording.times(f.gap_if_mended)}"


def _same(f: DataFinding) -> str:
    return wording.listed(f"{kind} of {channel}" for kind, channel in f.same_as[:6])
