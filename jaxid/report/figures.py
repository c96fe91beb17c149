"""Single plots for notebooks: each draws on the Axes it is given, or on new ones, and returns them;
none calls `show`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.base.wording import names_of
from jaxid.report import plot
from jaxid.report.budget_picture import draw_gap
from jaxid.report.traces import colors, run_of


if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jaxid.data.dataset import Dataset
    from jaxid.diagnosis.result import Diagnosis, MissingForce
    from jaxid.fitting.profiles import Profile
    from jaxid.fitting.result import Fit, Trace


def new_axes(width: float = 7.0, height: float = 3.2) -> Axes:
    from matplotlib import pyplot

    return pyplot.subplots(figsize=(width, height), layout="constrained")[1]


def pick(kind: str, name: str | None, among: Sequence[str]) -> str:
    """The one asked for, or the first. Raises `UsageError` where there is none of that name."""
    if not among:
        raise UsageError(f"there is no {kind} to plot")
    if name is None:
        return among[0]
    if name not in among:
        raise UsageError(f"there is no {kind} {name!r}{nearest(name, among)}")
    return name


def legend(ax: Axes, count: int) -> None:
    """Above the axes, where it covers no data."""
    ax.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=min(4, count),
        frameon=False,
        fontsize=8.5,
        borderaxespad=0.2,
    )


def dataset(data: Dataset, channel: str | None = None, ax: Axes | None = None) -> Axes:
    names = names_of((*data.outputs, *data.inputs)) + [
        c.name for c in data.channels if c.role == "auxiliary"
    ]
    channel = pick("channel", channel, names if data.experiments else [])
    unit = next(c.unit for c in data.channels if c.name == channel)
    ax = new_axes() if ax is None else ax
    palette = (
        plot.BLUE,
        plot.VERMILLION,
        plot.GREEN,
        plot.ORANGE,
        plot.PURPLE,
        plot.SKY,
        plot.BLACK,
    )
    shown = 0
    for e, color in zip(
        data.experiments, palette * (1 + len(data.experiments) // len(palette)), strict=False
    ):
        columns = {
            **{c.name: e.y[:, i] for i, c in enumerate(data.outputs)},
            **{c.name: e.u[:, i] for i, c in enumerate(data.inputs)},
            **e.auxiliary,
        }
        if channel in columns:
            ax.plot(
                *plot.thin(e.t, columns[channel]),
                color=color,
                lw=1.1,
                label=f"{plot.label(e.name, 30)} ({e.split})",
            )
            shown += 1
    ax.set(xlabel="time (s)", ylabel=plot.with_unit(channel, unit))
    legend(ax, shown)
    return ax


def trace(t: Trace, ax: Axes | None = None) -> Axes:
    ax = new_axes() if ax is None else ax
    measured = plot.series(t.measured)
    rests = {label: measured - plot.series(s) for label, s in t.simulated.items()}
    for (label, rest), color in zip(rests.items(), colors(list(rests)), strict=True):
        ax.plot(*plot.thin(t.t, rest), color=color, lw=1.0, label=plot.label(label))
    if 0 < t.noise < plot.LARGEST:
        ax.axhspan(
            -2 * t.noise,
            2 * t.noise,
            color=plot.GREY,
            alpha=0.35,
            lw=0,
            label="noise, ±2 standard deviations",
        )
    if bounds := plot.limits(*rests.values()):
        ax.set_ylim(bounds)
    ax.set(
        xlabel=f"time in {plot.label(run_of(t))} (s)",
        ylabel=f"measured − model, {plot.with_unit(t.channel, t.unit)}",
    )
    legend(ax, len(rests) + 1)
    return ax


def fit(result: Fit, channel: str | None = None, ax: Axes | None = None) -> Axes:
    last = {"fit": 0, "validation": 1, "report": 2}
    channel = pick("channel", channel, list(dict.fromkeys(t.channel for t in result.traces)))
    t = max((t for t in result.traces if t.channel == channel), key=lambda t: last.get(t.split, -1))
    ax = new_axes() if ax is None else ax
    ax.plot(*plot.thin(t.t, plot.series(t.measured)), color=plot.BLACK, lw=2.0, label="measured")
    for (label, series), color in zip(t.simulated.items(), colors(list(t.simulated)), strict=True):
        ax.plot(*plot.thin(t.t, plot.series(series)), color=color, lw=1.1, label=plot.label(label))
    ax.set(
        xlabel=f"time in {plot.label(run_of(t))} (s)",
        ylabel=plot.with_unit(t.channel, t.unit),
    )
    legend(ax, 1 + len(t.simulated))
    return ax


def diagnosis(result: Diagnosis, ax: Axes | None = None) -> Axes:
    ax = new_axes(7.0, 1.9) if ax is None else ax
    return draw_gap(ax, result)


def missing_force(force: MissingForce, after: bool = False, ax: Axes | None = None) -> Axes:
    from matplotlib.colors import Normalize

    ax = new_axes(5.2, 3.8) if ax is None else ax
    # One colour scale for both pictures, so that what is left looks as small as it is.
    bounds = plot.limits(plot.series(force.before), quantile=0.01)
    span = max(map(abs, bounds)) if bounds else 1.0
    values = plot.series(force.after if after else force.before)
    step = max(1, len(values) // 4000)
    dots = ax.scatter(
        force.q[::step],
        force.qd[::step],
        c=values[::step],
        s=5,
        lw=0,
        cmap="PuOr",
        norm=Normalize(-span, span),
        rasterized=True,
    )
    figure = ax.get_figure()
    assert figure is not None
    what = "still missing with the effect" if after else "missing in the nominal model"
    figure.colorbar(dots, ax=ax, label=f"force {what} ({plot.unit(force.unit)})")
    ax.set(
        xlabel=f"position of {plot.with_unit(force.joint, force.q_unit)}",
        ylabel=f"velocity ({plot.unit(force.qd_unit)})",
        facecolor="#f2f2f2",
    )
    return ax


def profile(result: Profile, ax: Axes | None = None) -> Axes:
    ax = new_axes(4.4, 3.0) if ax is None else ax
    rise = np.clip(result.rise, 0, plot.LARGEST)
    ax.plot(result.values, rise, "o-", color=plot.BLUE, ms=4, lw=1.4)
    ax.axhline(result.threshold, color=plot.VERMILLION, ls="--", lw=1.1)
    ax.annotate(
        "95 %",
        (1.0, result.threshold),
        xycoords=("axes fraction", "data"),
        xytext=(3, 0),
        textcoords="offset points",
        color=plot.VERMILLION,
        va="center",
        fontsize=8.5,
    )
    ends = [e for e in result.interval if e is not None]
    for end in ends:
        ax.axvline(end, color=plot.GREY, ls=":", lw=1.1)
    ax.set(
        xlabel=plot.with_unit(result.name, result.unit),
        ylabel="rise of −2 log likelihood",
        ylim=(-0.03 * 3 * result.threshold, 3 * result.threshold),
    )
    return ax
