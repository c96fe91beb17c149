"""The page of a paper that was done again: claims first, then each experiment with its tables and
pictures.
"""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from jaxid import wording
from jaxid.report import plot
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.study.papers.result import PaperPart, PaperTable, Reproduction


def section(result: Reproduction) -> Section:
    return Section(
        "reproduced.html",
        {
            "r": result,
            "parts": list(map(_part, result.parts)),
            "seconds": wording.number(result.wall_time_s, 3),
        },
    )


def _part(part: PaperPart) -> dict[str, Any]:
    return {
        "title": part.title,
        "text": part.text,
        "tables": list(map(_table, part.tables)),
        "pictures": [(p.caption, plot.svg(p.name, p.size, p.draw)) for p in part.pictures],
    }


def _table(t: PaperTable) -> dict[str, Any]:
    rows = [list(map(cell, row)) for row in t.rows]
    return {"title": t.title, "note": t.note, "columns": t.columns, "rows": rows}


def cell(value: Any) -> tuple[str, bool]:
    """How a cell is written, and whether it is a number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return ("–" if value is None else str(value)), False
    return (str(value) if isinstance(value, int) else wording.number(float(value), 4)), True


def lines(result: Reproduction) -> str:
    """Headline and claims for a terminal."""
    rows = [(c.verdict, c.claim, c.paper or "–", c.ours or c.why) for c in result.claims]
    return "\n".join(
        [
            wording.wrapped(
                f"Paper {result.paper}, {result.title} ({result.budget} budget): {result.headline}"
            ),
            *(
                wording.wrapped(f"{v}: {c}. Paper: {p}. Here: {o}", "- ", "  ")
                for v, c, p, o in rows
            ),
            f"{result.wall_time_s:.0f} s",
        ]
    )
