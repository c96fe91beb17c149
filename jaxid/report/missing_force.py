"""The force that the model lacks: against velocity, position, load and time, its spectrum, and by
regime.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from jaxid.base import wording
from jaxid.report import binned, plot
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.diagnosis.result import Finding, MissingForce, Regime


SHOWN = 6
#: Situations that are drawn, the strongest first.
SITUATIONS = 12
#: Parts of an axis over each of which what noise would show is one number.
PARTS = 30
#: The field of the motion that shows a law of each variable best.
FIELDS = {"speed": "qd", "position": "q", "load": "load", "command": "load"}


def section(
    forces: Sequence[MissingForce], regimes: Sequence[Regime], where: Sequence[Finding] = ()
) -> Section | None:
    """`where`: the findings; the variable that the first of a joint is a law of is drawn first."""
    most: dict[str, float] = {}
    for force in forces:
        most[force.joint] = max(most.get(force.joint, -np.inf), supplied(force))
    joints = sorted(most, key=lambda joint: -most[joint])
    told_by = {w.channel: w.variable for w in reversed(where)}
    pictures = []
    for i, joint in enumerate(joints[:SHOWN]):
        own = [f for f in forces if f.joint == joint]
        variable = told_by.get(joint, "")
        pictures.append(
            (f"Joint {joint}", picture(own, f"force-{i}", variable), law_sentence(own, variable))
        )
    strongest = sorted(regimes, key=lambda r: -r.strength)[:SITUATIONS]
    if not pictures and not strongest:
        return None
    return Section(
        "missing_force.html",
        {
            "pictures": pictures,
            "hidden": max(0, len(joints) - SHOWN),
            "regimes": regime_picture(strongest) if strongest else None,
            "weaker": len(regimes) - len(strongest),
        },
    )


def supplied(force: MissingForce) -> float:
    """How much the named effects change at a joint: joints without news come last."""
    return float(np.nanstd(plot.series(force.before) - plot.series(force.after)))


def law_sentence(forces: Sequence[MissingForce], variable: str) -> str:
    """The two ends of what the named effects supply over the variable that they are a law of; ""
    where nothing is supplied.
    """
    first = forces[0]
    field = FIELDS.get(variable, "")
    unit = {"q": first.q_unit, "qd": first.qd_unit, "load": first.unit}.get(field)
    if unit is None or all(np.array_equal(f.before, f.after) for f in forces):
        return ""
    of, parts = f"a {variable} of " if field == "load" else "", []
    for direction, sign in binned.directions(field):
        law = binned.supplied(forces, field, sign)
        if len(law.x) > 1:
            at = sorted((int(np.argmin(law.mean)), int(np.argmax(law.mean))))
            values = [(wording.number(law.mean[k], 2), wording.number(law.x[k], 2)) for k in at]
            ends = [f"{force} {first.unit} at {of}{place} {unit}" for force, place in values]
            parts.append(
                f"{f'moving {direction}, ' if direction else ''}from {ends[0]} to {ends[1]}"
            )
    comma = "," if field != "qd" else ""
    return f"The named effects supply{comma} {'; '.join(parts)}." if parts else ""


def picture(forces: Sequence[MissingForce], name: str, variable: str = ""):
    """All recordings of one joint: the force as means against speed, position and load (first that
    which shows a law of this `variable` best), without and with the named effects; over time and as
    a spectrum that of the longest recording.
    """
    longest = max(forces, key=lambda f: len(f.t))
    unit = longest.unit
    against = _against(forces, longest, variable)
    added = any(not np.array_equal(f.before, f.after) for f in forces)
    bounds = plot.limits(*(plot.series(f.before) for f in forces), quantile=0.005)

    kinds = ["before", "after"] if added else ["before"]

    def draw(figure):
        panels, over_time, spectrum_axes = layout(figure, kinds, len(against))
        level, points = None, plot.points(figure)
        for kind, row in zip(kinds, panels, strict=True):
            for axes, (field, title) in zip(row, against.items(), strict=True):
                binned.draw(axes, forces, field, kind, law=added and kind == "before")
                axes.set_xlabel(title)
            if kind == "before":
                level = _level(row)
            still = "still " if kind == "after" else ""
            for axes in row:
                if level:
                    axes.set_ylim(level)
                if axes.get_subplotspec().is_first_col() or plot.narrow(figure):
                    axes.set_ylabel(f"{still}missing ({plot.unit(unit)})")
        drawn = [(longest.before, plot.VERMILLION), (longest.after, plot.BLUE)][: len(kinds)]
        for force, color in drawn:
            thinned = plot.thin(longest.t, plot.series(force), points)
            over_time.plot(*thinned, color=color, linewidth=0.9)
        draw_noise(over_time, longest.t, plot.series(longest.floor), points // 4)
        over_time.set_xlabel(f"time in {plot.label(wording.run_words(longest.experiment))} (s)")
        over_time.set_ylabel(f"missing ({plot.unit(unit)})")
        over_time.margins(x=0)
        if bounds:
            over_time.set_ylim(bounds)
        draw_spectrum(spectrum_axes, longest)
        plot.legend(figure, legend(over_time, added, len(against) > 1), 3)

    return plot.svg(name, (plot.WIDE, 7.6 if added else 5.4), draw, 1.9 * (len(against) + 2) + 0.8)


def _against(
    forces: Sequence[MissingForce], longest: MissingForce, variable: str
) -> dict[str, str]:
    """Field -> title of what the force is drawn against: what varies, the `variable` first."""
    load = "command" if variable == "command" else "load"
    titles = {
        "qd": f"velocity ({plot.unit(longest.qd_unit)})",
        "q": f"position ({plot.unit(longest.q_unit)})",
        "load": f"{load} ({plot.unit(longest.unit)})",
    }
    against = {}
    for field in sorted(titles, key=lambda field: field != FIELDS.get(variable)):
        if any(np.ptp(getattr(f, field)) > 0 for f in forces):
            against[field] = titles[field]
    return against


def _level(row: Sequence[Axes]) -> Any:
    """Limits of what is drawn in a row."""
    lines: list[Any] = []
    for axes in row:
        lines += axes.get_lines()
    return plot.limits(*(line.get_ydata() for line in lines), quantile=0.0)


def layout(figure, kinds: Sequence[str], count: int):
    """Axes [kind][field] of the means, one over time, one of the spectrum; on phones a field is a
    row, before beside after.
    """
    if plot.narrow(figure):
        rows = figure.add_gridspec(count + 2, 1)
        by_field = [
            rows[k].subgridspec(1, len(kinds)).subplots(sharey=True, squeeze=False)[0]
            for k in range(count)
        ]
        by_kind = list(map(list, zip(*by_field, strict=True))) or [[] for _ in kinds]
        return by_kind, figure.add_subplot(rows[-2]), figure.add_subplot(rows[-1])
    rows = figure.add_gridspec(len(kinds) + 1, 1)
    panels = [
        rows[i].subgridspec(1, max(1, count)).subplots(sharey=True, squeeze=False)[0][:count]
        for i in range(len(kinds))
    ]
    last = rows[-1].subgridspec(1, 3)
    return panels, figure.add_subplot(last[:2]), figure.add_subplot(last[2])


def legend(axes, added: bool, both: bool) -> list:
    def mark(style, color, label, **more):
        return axes.plot([], [], style, color=color, label=label, **more)[0]

    out = [mark("o", plot.VERMILLION, "missing, 95 % interval (hollow: seen too seldom)", ms=5)]
    out += [mark("^", plot.ORANGE, "the same moving backwards", ms=5)] if both else []
    if added:
        out.append(mark("-", plot.BLUE, "supplied by the named effects; below: left over"))
    return [
        *out,
        axes.axhspan(0, 0, color=plot.GREY, alpha=0.3, label="noise, ±2 standard deviations"),
    ]


def draw_noise(axes, x: np.ndarray, floor: np.ndarray, parts: int = PARTS) -> None:
    """A band of two standard deviations of what noise alone would show, over equal parts of the
    axis.
    """
    edges = np.linspace(np.min(x), np.max(x), parts + 1)
    part = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, parts - 1)
    count = np.bincount(part, minlength=parts)
    with np.errstate(invalid="ignore"):  # nothing of the motion in a part: no band there
        level = 2 * np.sqrt(np.bincount(part, floor**2, parts) / count)
    axes.stairs(level, edges, baseline=-level, fill=True, color=plot.GREY, alpha=0.3, linewidth=0)


def draw_spectrum(axes, force: MissingForce) -> None:
    drawn = [(force.before, plot.VERMILLION)]
    if not np.array_equal(force.before, force.after):
        drawn.append((force.after, plot.BLUE))
    for series, color in drawn:
        frequency, density = spectrum(force.t, series)
        if len(frequency):
            axes.plot(frequency, density, color=color, linewidth=1.2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(f"spectrum ({plot.unit(force.unit)}/√Hz)")
    axes.margins(x=0)
    plot.plain_log(axes.xaxis)
    plot.plain_log(axes.yaxis)


def spectrum(t: np.ndarray, series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and amplitude density (unit/√Hz) by Welch's method, on samples interpolated
    to even steps.
    """
    t, series = np.asarray(t, float), plot.series(series)
    good = np.isfinite(series)
    t, series = t[good], series[good]
    n = len(t)
    if n < 64 or not t[-1] > t[0]:
        return np.zeros(0), np.zeros(0)
    step = (t[-1] - t[0]) / (n - 1)
    even = np.interp(t[0] + step * np.arange(n), t, series)
    length = n // 4
    window = np.hanning(length)
    starts = range(0, n - length + 1, max(1, length // 2))
    parts = np.stack([even[s : s + length] for s in starts])
    parts = (parts - parts.mean(axis=1, keepdims=True)) * window
    power = np.mean(np.abs(np.fft.rfft(parts, axis=1)) ** 2, axis=0) * 2 * step / np.sum(window**2)
    frequency = np.fft.rfftfreq(length, step)
    positive = (frequency > 0) & (power > 0)
    frequency, power = frequency[positive], power[positive]
    if len(frequency) < 2:
        return np.zeros(0), np.zeros(0)
    # Bins of equal width on the logarithmic axis: even ones would crowd its right end and starve
    # its left.
    bins = np.digitize(frequency, np.geomspace(frequency[0], frequency[-1], 120))
    count = np.bincount(bins)
    filled = count > 0
    mean = [np.bincount(bins, weights)[filled] / count[filled] for weights in (frequency, power)]
    return mean[0], np.sqrt(mean[1])


def regime_picture(regimes: Sequence[Regime]):
    """How strong the missing force is in each regime of each joint, against the whole recording;
    where no named effect tells it apart from the noise, beside what a perfect model would show.
    """
    guessed = any(r.supplied is None for r in regimes)
    labels = [
        (plot.label(r.joint, 20), plot.label(wording.regime_words(r.regime), 30)) for r in regimes
    ]
    lines = 1 + (max(len(a) + len(b) for a, b in labels) > 24)

    def draw(figure):
        axes = figure.add_subplot()
        axes.grid(False, axis="y")
        for i, r in enumerate(regimes):
            strength, (low, high) = plot.drawable(r.strength), map(plot.drawable, r.null)
            axes.barh(i, strength, height=0.6, color=plot.VERMILLION if r.stands_out else plot.GREY)
            end = strength
            if r.supplied is None:
                axes.plot(
                    [low, high], [i, i], color=plot.BLACK, linewidth=2.5, solid_capstyle="butt"
                )
                end = max(strength, high)
            axes.annotate(
                wording.number(r.strength, 2),
                (end, i),
                xytext=(6, 0),
                textcoords="offset points",
                va="center",
            )
        axes.axvline(1.0, color=plot.BLACK, linestyle=(0, (4, 2)), linewidth=1.1)
        between = ",\n" if plot.narrow(figure) and lines > 1 else ", "
        axes.set_yticks(range(len(regimes)), [between.join(label) for label in labels])
        axes.set_ylim(len(regimes) - 0.4, -0.6)
        axes.tick_params(axis="y", length=0)
        ends: list[float] = []
        for r in regimes:
            ends.append(r.strength)
            if r.supplied is None:
                ends += r.null[1:]
        axes.set_xlim(0, 1.12 * max([1.0, *map(plot.drawable, ends)]))
        axes.set_xlabel("missing force there, as a multiple of that over the whole recording (rms)")
        handles = [
            axes.barh([0], [0], color=plot.VERMILLION, label="stronger than elsewhere"),
            axes.barh([0], [0], color=plot.GREY, label="as elsewhere, or weaker"),
        ]
        if guessed:
            handles += axes.plot(
                [],
                [],
                color=plot.BLACK,
                linewidth=2.5,
                label="what a perfect model would show (95 %)",
            )
        plot.legend(figure, handles, 3)

    height = 1.0 + 0.3 * len(regimes)
    return plot.svg(
        "regimes", (plot.WIDE, height), draw, 1.2 + (0.3 + 0.12 * (lines - 1)) * len(regimes)
    )
