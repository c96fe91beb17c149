"""The page of a paper that was done again: claims first, then each experiment with its tables and
pictures.
"""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from jaxid.base.serialise import json_bytes
from jaxid.base.wording import number, one_line, wrapped
from jaxid.report import plot
from jaxid.report.page import render, Section


if TYPE_CHECKING:
    from jaxid.study.papers.result import PaperPart, PaperTable, Reproduction


def reproduction_page(result: Reproduction) -> str:
    """The page of a paper that was done again."""
    return render(
        f"Paper {result.paper}: {one_line(result.title)}",
        [section(result)],
        "result.json",
        json_bytes(result),
    )


def section(result: Reproduction) -> Section:
    """Claims and experiments."""
    return Section(
        "reproduced.html",
        {
            "r": result,
            "parts": list(map(_part, result.parts)),
            "seconds": number(result.wall_time_s, 3),
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
    if value is None:
        return "–", False
    if isinstance(value, float):
        return number(value, 4), True
    return str(value), type(value) is int


def lines(result: Reproduction) -> str:
    """Headline and claims for a terminal."""
    rows = [(c.verdict, c.claim, c.paper or "–", c.ours or c.why) for c in result.claims]
    return "\n".join(
        [
            wrapped(
                f"Paper {result.paper}, {result.title} ({result.budget} budget): {result.headline}"
            ),
            *(wrapped(f"{v}: {c}. Paper: {p}. Here: {o}", "- ", "  ") for v, c, p, o in rows),
            f"{result.wall_time_s:.0f} s",
        ]
    )
