"""The first screen of a fit: did it work, and how well does it reproduce the data."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jaxid.base import wording
from jaxid.report import plot, text
from jaxid.report.effect_text import effect_name
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.fitting.result import Fit


def section(fit: Fit, history: bool = True) -> Section:
    rows = []
    for split, channels in {**fit.scores, "windows": fit.windowed}.items():
        rows += [(split, channel, s) for channel, s in channels.items()]
    return Section(
        "fitted.html",
        {
            "fit": fit,
            "headline": headline(fit),
            "effects": wording.listed(effect_name(e) for e in fit.effects),
            "rows": rows,
            "history": history_picture(fit) if history and len(fit.history) > 2 else None,
            "recursion": recursion_picture(fit) if history and len(fit.recursion) > 1 else None,
        },
    )


def headline(fit: Fit) -> str:
    if fit.failed:
        return f"The fit failed: {fit.stopped_because}."
    split = next((s for s in ("validation", "report", "fit") if fit.scores.get(s)), None)
    if split is None:
        return (
            "The fit has converged."
            if fit.converged
            else f"The fit has not converged: {fit.stopped_because}."
        )
    channel, worst = max(fit.scores[split].items(), key=lambda item: item[1].relative_error)
    tail = (
        ""
        if fit.converged
        else f" ({'stalled' if fit.state == 'stalled' else 'not converged'}: {fit.stopped_because})"
    )
    return (
        f"{channel} is reproduced to {wording.number(worst.rmse)} {worst.unit} rms on {split}"
        f" data{tail}."
    )


def history_picture(fit: Fit):
    evaluations, losses = (np.asarray(column, float) for column in zip(*fit.history, strict=True))
    positive = (losses > 0) & (losses < plot.LARGEST)  # beyond, models diverge or nearly do

    def draw(figure):
        axes = figure.add_subplot()
        axes.step(
            *plot.thin(evaluations[positive], losses[positive]), where="post", color=plot.BLUE
        )
        axes.set_yscale("log")
        axes.set_xlabel("evaluations of the loss")
        axes.set_ylabel("best loss so far")
        plot.plain_log(axes.yaxis)

    return plot.svg("history", (plot.WIDE, 2.4), draw) if positive.any() else None


#: Most numbers drawn over the recursions.
DRAWN = 8


def recursion_picture(fit: Fit):
    """Each fitted number over the recursions with its band of two standard deviations."""
    names = list(fit.recursion[0].parameters)[:DRAWN]
    at = np.arange(1, len(fit.recursion) + 1)

    def draw(figure):
        for k, name in enumerate(names):
            axes = figure.add_subplot(len(names), 1, k + 1)
            found = [s.parameters[name] for s in fit.recursion]
            value = np.array([mean for mean, _ in found])
            std = np.array([deviation for _, deviation in found], float)  # nan for None
            axes.fill_between(
                at, value - 2 * std, value + 2 * std, color=plot.BLUE, alpha=0.2, linewidth=0
            )
            axes.plot(at, value, color=plot.BLUE, marker=".")
            axes.set_ylabel(text.one_line(name))
        figure.axes[-1].set_xlabel("recursion")

    return plot.svg("recursion", (plot.WIDE, 0.6 + 1.1 * len(names)), draw)
