"""What the reproduction of a paper found: claims with the paper's numbers and ours, tables,
sentences and pictures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from jaxid.base.serialise import plain, SCHEMA
from jaxid.base.versions import versions
from jaxid.report.display import page
from jaxid.study.papers.page import reproduction_page


#: What can be said of a claim.
HOLDS, FAILS, PARTLY, UNKNOWN = "holds", "does not hold", "partly", "cannot be checked"


class PaperClaim(NamedTuple):
    """A claim of a paper, its number (empty where it gives none), ours, and what follows; `why`
    where it cannot be checked.
    """

    claim: str
    paper: str
    ours: str
    verdict: str
    why: str = ""


def judged(claim: str, paper: str, ours: str, true: bool, why: str = "") -> PaperClaim:
    """A claim that our numbers decide."""
    return PaperClaim(claim, paper, ours, HOLDS if true else FAILS, why)


class PaperTable(NamedTuple):
    """Rows of text and numbers under the names of their columns."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    note: str = ""

    def to_dict(self) -> dict[str, Any]:
        return {
            "title": self.title,
            "note": self.note,
            "rows": [dict(zip(self.columns, r, strict=True)) for r in self.rows],
        }


class Picture(NamedTuple):
    """What `draw` puts on a figure of this size (inches)."""

    name: str
    caption: str
    size: tuple[float, float]
    draw: Callable[[Figure], object]


class PaperPart(NamedTuple):
    """One experiment of a paper; every sentence of `text` is made from its numbers."""

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[PaperTable, ...] = ()
    pictures: tuple[Picture, ...] = ()
    claims: tuple[PaperClaim, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        return plain(
            {
                "title": self.title,
                "text": self.text,
                "tables": self.tables,
            }
        )


@dataclass(frozen=True)
class Reproduction:
    """A paper done again on a twin: `result.json` and the page. `parts` may be those that were
    finished when it was stopped.
    """

    paper: str
    title: str
    doi: str
    about: str
    budget: str
    parts: tuple[PaperPart, ...]
    wall_time_s: float
    notes: tuple[str, ...] = ()

    @property
    def claims(self) -> tuple[PaperClaim, ...]:
        claims: list[PaperClaim] = []
        for part in self.parts:
            claims += part.claims
        return tuple(claims)

    @property
    def counts(self) -> dict[str, int]:
        """How many claims there are of each verdict."""
        verdicts = [claim.verdict for claim in self.claims]
        return {v: verdicts.count(v) for v in (HOLDS, FAILS, PARTLY, UNKNOWN)}

    @property
    def headline(self) -> str:
        n = self.counts
        compared = len(self.claims) - n[UNKNOWN]
        partly = f", {n[PARTLY]} in part" if n[PARTLY] else ""
        return (
            f"Of {compared} claims that can be compared {n[HOLDS]} hold on the twin{partly},"
            f" {n[FAILS]} do not; {n[UNKNOWN]} cannot be checked."
        )

    def to_dict(self) -> dict[str, Any]:
        return plain(
            {
                "schema": SCHEMA,
                "kind": "reproduction",
                "paper": self.paper,
                "title": self.title,
                "doi": self.doi,
                "about": self.about,
                "budget": self.budget,
                "headline": self.headline,
                "claims": [c._asdict() for c in self.claims],
                "parts": self.parts,
                "notes": self.notes,
                "wall_time_s": self.wall_time_s,
                "versions": versions(),
            }
        )


page.register(Reproduction, reproduction_page)
