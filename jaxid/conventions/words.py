"""Findings about a recording in words, for the terminal and the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxid.base import wording
from jaxid.base.wording import one_line


if TYPE_CHECKING:
    from jaxid.conventions.finding import Checked, DataFinding


def finding_text(f: DataFinding) -> str:
    """A finding with what it does to the gap and the line that mends it."""
    parts = [f"{f.kind}: {one_line(f.text)}"]
    if f.gap_before is not None and f.gap_if_mended is not None:
        parts.append(
            f"The gap goes from {wording.times(f.gap_before)} to {wording.times(f.gap_if_mended)}"
            " times the noise."
        )
    if f.same_as:
        same = wording.listed(f"{kind} of {channel}" for kind, channel in f.same_as[:6])
        parts.append(f"These data cannot tell it from {one_line(same)}.")
    if f.line:
        place = (
            "under [[experiments]]"
            if f.kind in ("not_at_rest", "does_not_move")
            else f"under [channels.{f.channel}]"
        )
        place = {"time_unit": "at the top", "law": "under [controller]"}.get(f.kind, place)
        said = "; ".join(one_line(line) for line in f.line.split("\n"))
        parts.append(f"In dataset.toml, {one_line(place)}: {said}")
    return " ".join(parts)


def headline(checked: Checked) -> str:
    """The answer in one sentence."""
    applied = [f for f in checked.findings if f.decisive]
    if not checked.findings and not checked.model:
        return "Nothing found in the samples themselves; no model was asked."
    if not checked.findings:
        if checked.notes:
            return "Nothing found in what was compared; see the notes."
        return "Nothing found: the recording contradicts neither itself nor the model."
    if not checked.usable:
        return "The recording cannot be used as it is."
    if not applied:
        count = len(checked.findings)
        return f"Nothing is decisive; {count} question{'s' * (count > 1)}."
    return " ".join(f"{f.headline.split(';')[0]}." for f in applied)


def checked_text(checked: Checked) -> str:
    """About ten lines for the terminal."""
    of = f", model {one_line(checked.model)}" if checked.model else ""
    parts = [wording.wrapped(f"{one_line(checked.dataset)}{of}: {headline(checked)}")]
    for f in checked.findings:
        label = "FOUND" if f.decisive or f.kind in ("time_unit",) else "ASKED"
        parts.append(wording.paragraph(label, [finding_text(f)]))
    return "\n".join([*parts, *(wording.paragraph("note", [n]) for n in checked.notes)])
