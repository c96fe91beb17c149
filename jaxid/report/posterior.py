"""The posterior of a fit: a table of its numbers, a corner plot, and the chains."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from jaxid.base.wording import one_line
from jaxid.report import plot
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.fitting.posterior import Posterior


#: Most numbers in the corner plot, and cells along an axis of one of its panels.
DRAWN, CELLS = 6, 24
#: Shares of the draws that the lines of a panel enclose: one and two standard deviations of a
#: normal distribution in the plane.
ENCLOSED = (0.865, 0.393)
COLORS = (plot.BLUE, plot.VERMILLION, plot.GREEN, plot.PURPLE)


def section(posterior: Posterior | None) -> Section | None:
    """The section of a page; None where nothing was drawn."""
    if posterior is None:
        return None
    names = list(posterior.parameters)[:DRAWN]
    return Section(
        "posterior.html",
        {
            "posterior": posterior,
            "shown": len(names),
            "corner": corner_picture(posterior, names),
            "chains": chains_picture(posterior, names),
        },
    )


def corner(figure: Figure, posterior: Posterior, names: list[str]) -> None:
    """Each number's draws on the diagonal, each pair's below it."""
    count = len(names)
    grid = figure.subplots(count, count, squeeze=False)
    for row, own in enumerate(names):
        for column, other in enumerate(names):
            axes = grid[row, column]
            if column > row:
                axes.remove()
                continue
            if column == row:
                _alone(axes, posterior.draws[own].ravel())
            else:
                _pair(axes, posterior.draws[other].ravel(), posterior.draws[own].ravel())
            axes.tick_params(labelsize=8)
            axes.locator_params(nbins=3)
            if row == count - 1:
                unit = posterior.parameters[other].unit
                axes.set_xlabel(plot.with_unit(other, unit), fontsize=8)
            if column == 0 and row > 0:
                axes.set_ylabel(plot.with_unit(own, posterior.parameters[own].unit), fontsize=8)


def _alone(axes: Axes, values: np.ndarray) -> None:
    axes.hist(values, bins=CELLS, color=plot.SKY, edgecolor=plot.BLUE, linewidth=0.4)
    axes.set_yticks([])
    for bound in np.quantile(values, [0.025, 0.975]):
        axes.axvline(bound, color=plot.BLACK, linewidth=0.8, linestyle="--")


def _pair(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return
    counted, across, upward = np.histogram2d(x, y, bins=CELLS)
    middle_x, middle_y = (across[1:] + across[:-1]) / 2, (upward[1:] + upward[:-1]) / 2
    levels = sorted({_level(counted, share) for share in ENCLOSED})
    highest = counted.max() * (1 + 1e-9)
    if levels[-1] < highest:
        colors = ["#c6dcec", "#6aa5cd"][-len(levels) :]
        axes.contourf(middle_x, middle_y, counted.T, levels=[*levels, highest], colors=colors)
    axes.contour(middle_x, middle_y, counted.T, levels=levels, colors=plot.BLUE, linewidths=0.8)


def _level(counted: np.ndarray, share: float) -> float:
    """The count above which cells hold this share of all draws."""
    sorted_cells = np.sort(counted.ravel())[::-1]
    held = np.cumsum(sorted_cells) / counted.sum()
    return float(max(sorted_cells[np.searchsorted(held, share)], 0.5))


def corner_picture(posterior: Posterior, names: list[str]) -> Markup:
    side = min(plot.WIDE, 1.0 + 1.6 * len(names))
    return plot.svg(
        "corner", (side, 0.8 * side), lambda figure: corner(figure, posterior, names), plot.NARROW
    )


def corner_file(posterior: Posterior) -> bytes:
    """The corner plot as a PNG."""
    names = list(posterior.parameters)[:DRAWN]
    side = 1.5 + 1.8 * len(names)
    figure = Figure(figsize=(side, side), layout="constrained")
    FigureCanvasAgg(figure)
    corner(figure, posterior, names)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=120)
    return buffer.getvalue()


def chains_picture(posterior: Posterior, names: list[str]) -> Markup:
    """The draws of each chain in order: chains that agree lie over each other."""

    def draw(figure: Figure) -> None:
        grid = figure.subplots(len(names), 1, squeeze=False, sharex=True)
        for axes, name in zip(grid[:, 0], names, strict=True):
            for k, chain in enumerate(posterior.draws[name]):
                x, y = plot.thin(np.arange(len(chain)), chain, 200)
                axes.plot(x, y, color=COLORS[k % len(COLORS)], linewidth=0.6, alpha=0.8)
            axes.set_ylabel(plot.label(one_line(name), 24), fontsize=8)
        grid[-1, 0].set_xlabel("draw")

    return plot.svg("chains", (plot.WIDE, 0.5 + 0.9 * len(names)), draw)
