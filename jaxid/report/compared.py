"""The page of a comparison: one table and three pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jaxid.base import wording
from jaxid.base.errors import UsageError
from jaxid.fitting.comparison import along
from jaxid.report import comparison_text, plot
from jaxid.report.figures import legend, new_axes
from jaxid.report.page import Section


if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jaxid.fitting.comparison import BestKnown, Comparison


COLORS = (
    plot.BLUE,
    plot.VERMILLION,
    plot.GREEN,
    plot.ORANGE,
    plot.PURPLE,
    plot.SKY,
    plot.BLACK,
    plot.GREY,
)
DASHES, MARKERS = ("-", "--", "-.", ":"), ("o", "^", "s", "D")
#: Shares of the best loss below this are drawn at it.
LOWEST = 1e-9
#: A loss this many times the best known is that of a run that has not yet found a simulation that
#: holds.
DIVERGED = 1e9


def section(c: Comparison) -> Section:
    return Section(
        "compared.html",
        {
            "c": c,
            "effects": wording.listed(c.effects),
            "headline": comparison_text.comparison_headline(c),
            "setting": comparison_text.comparison_setting(c),
            "common_time": wording.number(c.common_time, 2),
            "rows": comparison_text.comparison_rows(c),
            "convergence": plot.svg(
                "convergence", (plot.WIDE, 3.6), lambda figure: _convergence(c, figure)
            ),
            "scatter": (
                plot.svg(
                    "scatter",
                    (plot.WIDE, 1.1 + 0.52 * len(c.best)),
                    lambda figure: _scatter(c, figure),
                )
                if c.best
                else None
            ),
            "cost": plot.svg("cost", (plot.WIDE, 3.2), lambda figure: _cost(c, figure)),
        },
    )


def style(c: Comparison, fitter: str) -> tuple[str, str, str]:
    """Colour, dash and marker of a fitter."""
    k = c.fitters.index(fitter)
    turn = (k // len(COLORS)) % len(DASHES)
    return COLORS[k % len(COLORS)], DASHES[turn], MARKERS[turn]


def excess(c: Comparison, loss: np.ndarray) -> np.ndarray:
    """Loss above the best known as a share of it, within what an axis holds."""
    return np.clip((loss - c.best_loss) / max(abs(c.best_loss), 1e-12), LOWEST, plot.LARGEST)


def comparison_picture(c: Comparison, by: str = "evaluations", ax: Axes | None = None) -> Axes:
    """Convergence of every fitter over `evaluations` or `seconds`, on new axes or the given ones."""
    axes = new_axes() if ax is None else ax
    draw_convergence(c, axes, by)
    legend(axes, len(c.fitters))
    return axes


def draw_convergence(c: Comparison, axes: Axes, by: str) -> None:
    """Median and band of every fitter over `evaluations` or `seconds`."""
    if by not in ("evaluations", "seconds"):
        raise UsageError(f"a comparison is drawn by evaluations or seconds, not {by!r}")
    column = 0 if by == "evaluations" else 1
    for fitter in c.fitters:
        runs = c.of(fitter)
        ends = np.concatenate([r.history[[0, -1], column] for r in runs])
        ends = ends[ends > 0]
        if not ends.size:
            continue
        grid = np.geomspace(max(min(ends), 1e-4), max(ends) * (1 + 1e-9), 160)
        curves = np.array([excess(c, along(r, grid, column)) for r in runs])
        low, middle, high = np.percentile(curves, [10, 50, 90], axis=0)
        seen = middle < DIVERGED
        if not seen.any():
            continue
        low, middle, high = (
            low[seen],
            middle[seen],
            np.minimum(high[seen], np.max(curves[curves < DIVERGED])),
        )
        color, dash, _ = style(c, fitter)
        axes.fill_between(grid[seen], low, high, step="post", color=color, alpha=0.12, linewidth=0)
        axes.step(
            grid[seen],
            middle,
            where="post",
            color=color,
            linestyle=dash,
            label=plot.label(fitter, 20),
        )
    axes.axhline(c.tolerance, color=plot.GREY, linestyle="--", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(
        "evaluations of the loss" if by == "evaluations" else "seconds (without compiling)"
    )
    axes.set_ylabel("loss above the best known")
    plot.plain_log(axes.xaxis)
    plot.plain_log(axes.yaxis)


def _convergence(c: Comparison, figure) -> None:
    left, right = figure.subplots(1, 2, sharey=True)
    draw_convergence(c, left, "evaluations")
    draw_convergence(c, right, "seconds")
    right.set_ylabel("")
    plot.legend(figure, left.get_legend_handles_labels()[0], 8, "outside upper center")


def width(known: BestKnown) -> float:
    """The unit in which a parameter's distance from the best known is drawn."""
    return (
        known.std
        if known.std
        else (
            max(known.upper - known.lower, 1e-300)
            if np.isfinite(known.upper - known.lower)
            else 1.0
        )
    )


def _scatter(c: Comparison, figure) -> None:
    axes = figure.add_subplot()
    names, fitters = list(c.best), c.fitters
    for k, name in enumerate(names):
        known = c.best[name]
        for j, fitter in enumerate(fitters):
            runs = c.of(fitter)
            x = np.clip(
                [(r.parameters[name] - known.value) / width(known) for r in runs],
                -plot.LARGEST,
                plot.LARGEST,
            )
            y = np.full(len(runs), k + 0.7 * ((j + 0.5) / len(fitters) - 0.5))
            won = np.array([r.loss <= c.target for r in runs])
            color, _, marker = style(c, fitter)
            axes.scatter(
                x[won],
                y[won],
                s=13,
                marker=marker,
                color=color,
                linewidths=0,
                alpha=0.8,
                label=plot.label(fitter, 20) if not k else None,
            )
            axes.scatter(
                x[~won],
                y[~won],
                s=13,
                marker=marker,
                facecolors="none",
                edgecolors=color,
                linewidths=0.8,
            )
    axes.set_xscale("symlog", linthresh=1.0)
    axes.axvline(0, color=plot.GREY, linewidth=0.8)
    axes.set_yticks(
        range(len(names)),
        [
            plot.label(f"{n} = {wording.number(c.best[n].value)} {c.best[n].unit}", 40)
            for n in names
        ],
    )
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlabel("distance from the best known value, in its standard deviations")
    axes.xaxis.set_major_formatter(lambda v, _: f"{v:g}" if abs(v) < 1e5 else f"{v:.0e}")
    plot.legend(figure, axes.get_legend_handles_labels()[0], 8, "outside upper center")


def _cost(c: Comparison, figure) -> None:
    left, right = figure.subplots(1, 2, sharey=True)
    for fitter in c.fitters:
        runs = c.of(fitter)
        color, _, marker = style(c, fitter)
        y = excess(c, np.array([r.loss for r in runs]))
        left.scatter(
            [max(r.evaluations, 1) for r in runs],
            y,
            s=14,
            marker=marker,
            color=color,
            alpha=0.75,
            linewidths=0,
            label=plot.label(fitter, 20),
        )
        right.scatter(
            [max(r.seconds, 1e-4) for r in runs],
            y,
            s=14,
            marker=marker,
            color=color,
            alpha=0.75,
            linewidths=0,
        )
    for axes, title in (
        (left, "evaluations of a run"),
        (right, "seconds of a run (without compiling)"),
    ):
        axes.axhline(c.tolerance, color=plot.GREY, linestyle="--", linewidth=0.8)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(title)
        plot.plain_log(axes.xaxis)
        plot.plain_log(axes.yaxis)
    left.set_ylabel("loss above the best known")
    plot.legend(figure, left.get_legend_handles_labels()[0], 8, "outside upper center")
