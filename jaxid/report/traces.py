"""Measured and simulated motion, and what is left between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxid.base.wording import run_words
from jaxid.report import plot
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.fitting.result import Trace


SHOWN = 6
_ORDER = {"report": 0, "validation": 1, "fit": 2}


def run_of(trace: Trace) -> str:
    """The run of a trace, with what its data were for: `run_1 (report data)`."""
    own = trace.experiment.removesuffix(f"#{trace.split}")
    return run_words(f"{own}#{trace.split}")


def section(traces: Sequence[Trace]) -> Section | None:
    """Report data first; at most six pictures."""
    if not traces:
        return None
    ordered = sorted(traces, key=lambda trace: _ORDER.get(trace.split, 3))
    pictures = [
        (
            f"{t.channel} in {run_of(t)}",
            picture(t, f"trace-{i}"),
        )
        for i, t in enumerate(ordered[:SHOWN])
    ]
    return Section(
        "traces.html",
        {
            "pictures": pictures,
            "hidden": max(0, len(traces) - SHOWN),
            "windows": ordered[0].windows,
        },
    )


def colors(labels: Sequence[str]) -> list[str]:
    """The first model red, the last one blue, others between."""
    if len(labels) == 1:
        return [plot.BLUE]
    middle = [plot.ORANGE, plot.GREEN, plot.PURPLE, plot.SKY]
    return [plot.VERMILLION, *(middle[i % 4] for i in range(len(labels) - 2)), plot.BLUE]


def picture(trace: Trace, name: str):
    labels = list(trace.simulated)

    measured = plot.series(trace.measured)

    def draw(figure):
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[4, 3])
        points = plot.points(figure)
        handles = above.plot(
            *plot.thin(trace.t, measured, points), color=plot.BLACK, linewidth=1.8, label="measured"
        )
        rests = []
        for label, color in zip(labels, colors(labels), strict=True):
            series = plot.series(trace.simulated[label])
            handles += above.plot(
                *plot.thin(trace.t, series, points), color=color, label=plot.label(label)
            )
            rest = measured - series
            rests.append(rest)
            below.plot(*plot.thin(trace.t, rest, points), color=color, linewidth=1.0)
        if 0 < trace.noise < plot.LARGEST:
            band = below.axhspan(
                -2 * trace.noise, 2 * trace.noise, color=plot.GREY, alpha=0.35, linewidth=0
            )
            band.set_label("noise, ±2 standard deviations")
            handles.append(band)
        below.axhline(0.0, color=plot.BLACK, linewidth=0.6)
        # A model that runs away must not flatten the measurement into a line.
        span = (
            float(np.ptp(measured[np.isfinite(measured)])) if np.isfinite(measured).any() else 1.0
        )
        bounds = plot.limits(
            measured, *(plot.series(s) for s in trace.simulated.values()), quantile=0.0
        )
        if bounds and span > 0:
            low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
            above.set_ylim(max(bounds[0], low - 2 * span), min(bounds[1], high + 2 * span))
        if rest_limits := plot.limits(*rests):
            below.set_ylim(rest_limits)
        above.set_ylabel(plot.with_unit(trace.channel, trace.unit))
        below.set_ylabel(f"measured − model\n({plot.unit(trace.unit)})")
        below.set_xlabel("time (s)")
        if len(trace.t) > 1:
            below.set_xlim(float(trace.t[0]), float(trace.t[-1]))
        figure.align_ylabels()
        plot.legend(figure, handles, 4)

    return plot.svg(name, (plot.WIDE, 4.5), draw)
