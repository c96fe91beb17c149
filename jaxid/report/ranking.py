"""Every candidate after its refit, best first."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxid import wording
from jaxid.report import plot
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.diagnosis.result import Ranked, Which


BARS, ROWS = 12, 60


def section(which: Which) -> Section | None:
    if not which.ranking:
        return None
    named = {(e.effect, e.location) for e in which.effects}
    confusable = {(e.effect, e.location) for e in which.confusable_with}
    kind = lambda key: "named" if key in named else "confusable" if key in confusable else ""
    rows = [(r, kind((r.effect, r.location))) for r in which.ranking]
    return Section(
        "ranking.html",
        {
            "rows": [(r, kind, r.text.removeprefix(f"{r.effect} at {r.location}: ")) for r, kind in rows[:ROWS]],
            "hidden": max(0, len(rows) - ROWS),
            "picture": picture(rows[:BARS]),
            "bars": min(BARS, len(rows)),
            "total": len(rows),
        },
    )


def picture(rows: list[tuple[Ranked, str]]):
    """Bars of the validation gap; the noise is 1."""
    gaps = [plot.drawable(r.validation_gap) for r, _ in rows]
    logarithmic = max(gaps) > 30 and min(gaps) > 0
    palette = {"named": plot.BLUE, "confusable": plot.SKY, "": "#b5b5b5"}
    meaning = {"named": "named", "confusable": "cannot be told from it", "": "other"}

    def draw(figure):
        axes = figure.add_subplot()
        axes.grid(False, axis="y")
        if logarithmic:
            axes.set_xscale("log")
        start = 1.0 if logarithmic else 0.0
        for i, (r, kind) in enumerate(rows):
            axes.barh(i, gaps[i] - start, left=start, color=palette[kind], height=0.66)
            axes.annotate(
                wording.number(r.validation_gap),
                (max(gaps[i], start), i),
                xytext=(5, 0),
                textcoords="offset points",
                va="center",
                fontsize=8.5,
            )
        axes.axvline(1.0, color=plot.BLACK, linestyle=(0, (4, 2)), linewidth=1.1)
        axes.set_yticks(range(len(rows)), [plot.label(f"{r.effect} at {r.location}", 44) for r, _ in rows])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        high = max(1.0, *gaps)
        axes.set_xlim((min(start, *gaps) / 1.2, 1.6 * high) if logarithmic else (0, 1.12 * high))
        axes.set_xlabel("gap on validation data after the refit, in multiples of the noise (dashed: the noise)")
        if logarithmic:
            plot.plain_log(axes.xaxis)
        present = [kind for kind in palette if any(k == kind for _, k in rows)]
        handles = [axes.barh([0], [0], color=palette[kind], label=meaning[kind]) for kind in present]
        figure.legend(handles=handles, loc="outside upper left", ncols=3, fontsize=8.5)

    return plot.svg("ranking", (9.2, 1.0 + 0.27 * len(rows)), draw)
