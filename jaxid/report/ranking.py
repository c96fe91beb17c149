"""The candidates that were tried, after their refits, best first."""

from __future__ import annotations

from typing import TYPE_CHECKING

from markupsafe import Markup

from jaxid.base import wording
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

    def kind(key):
        return "named" if key in named else "confusable" if key in confusable else ""

    rows = [(r, kind((r.effect, r.location))) for r in which.ranking]

    def told(r):
        return r.text.split(": ", 1)[-1]

    return Section(
        "ranking.html",
        {
            "rows": [(r, kind, told(r)) for r, kind in rows[:ROWS]],
            "hidden": max(0, len(rows) - ROWS),
            "rounds": [
                round_of(own, beside, k) for k, (beside, own) in enumerate(rounds(rows).items())
            ],
            "above": (
                [kind for _, kind in rows].index("named")
                if any(kind == "named" for _, kind in rows)
                else 0
            ),
        },
    )


def rounds(rows: list[tuple[Ranked, str]]) -> dict[tuple[str, ...], list[tuple[Ranked, str]]]:
    """Rows by what each was tried beside; drawn are those of a round in which several were tried,
    or one was named.
    """
    groups: dict[tuple[str, ...], list[tuple[Ranked, str]]] = {}
    for row in rows:
        groups.setdefault(tuple(sorted(row[0].beside)), []).append(row)
    told = {}
    for beside, own in groups.items():
        if len(own) > 2 or not beside or "named" in {kind for _, kind in own}:
            told[beside] = own
    return dict(sorted(told.items(), key=lambda pair: len(pair[0])))


def round_of(
    own: list[tuple[Ranked, str]], beside: tuple[str, ...], number: int
) -> tuple[str, Markup]:
    """Caption and picture of the candidates of one round, the named ones first."""
    shown = sorted(own[:BARS], key=lambda row: row[1] != "named")
    caption = f"Beside {wording.listed(beside)}" if beside else "Alone"
    caption += f": the best {len(shown)} of {len(own)}" if len(own) > len(shown) else ""
    return caption, picture(shown, f"ranking-{number + 1}")


def picture(rows: list[tuple[Ranked, str]], name: str) -> Markup:
    """Bars of the validation gap; the noise is 1."""
    gaps = [plot.drawable(r.validation_gap) for r, _ in rows]
    logarithmic = max(gaps) > 30 and min(gaps) > 0
    palette = {"named": plot.BLUE, "confusable": plot.SKY, "": plot.GREY}
    meaning = {"named": "named", "confusable": "cannot be told from it", "": "other"}

    def draw(figure):
        axes = figure.add_subplot()
        at = "\nat " if plot.narrow(figure) else " at "
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
            )
        axes.axvline(1.0, color=plot.BLACK, linestyle=(0, (4, 2)), linewidth=1.1)
        axes.set_yticks(
            range(len(rows)),
            [f"{plot.label(r.effect, 30)}{at}{plot.label(r.location, 20)}" for r, _ in rows],
        )
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        high = max(1.0, *gaps)
        axes.set_xlim((min(start, *gaps) / 1.2, 1.6 * high) if logarithmic else (0, 1.12 * high))
        axes.set_xlabel("gap on validation data after the refit, times the noise (dashed)")
        if logarithmic:
            plot.plain_log(axes.xaxis)
        shown = {kind for _, kind in rows}
        present = [kind for kind in palette if kind in shown]
        handles = [
            axes.barh([0], [0], color=palette[kind], label=meaning[kind]) for kind in present
        ]
        plot.legend(figure, handles, 3)

    return plot.svg(name, (plot.WIDE, 1.0 + 0.27 * len(rows)), draw, 1.2 + 0.4 * len(rows))
