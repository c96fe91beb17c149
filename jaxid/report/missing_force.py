"""The force that the model lacks: against velocity, position, load and time, its spectrum, and by regime."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxid import wording
from jaxid.report import binned, plot
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.diagnosis.result import Finding, MissingForce, Regime


SHOWN = 6
#: Parts of an axis over each of which what noise would show is one number.
PARTS = 30
#: The field of the motion that shows a law of each variable best.
FIELDS = {"speed": "qd", "position": "q", "load": "load", "command": "load"}


def section(forces: Sequence[MissingForce], regimes: Sequence[Regime], where: Sequence[Finding] = ()) -> Section | None:
    """`where`: the findings; the variable that the first of a joint is a law of is drawn first."""
    joints = list(dict.fromkeys(f.joint for f in forces))
    most = {
        j: max(float(np.nanstd(plot.series(f.before) - plot.series(f.after))) for f in forces if f.joint == j) for j in joints
    }
    joints.sort(key=lambda j: -most[j])
    told_by = {w.channel: FIELDS.get(w.variable, "") for w in reversed(where)}
    pictures = []
    for i, joint in enumerate(joints[:SHOWN]):
        own = [f for f in forces if f.joint == joint]
        pictures.append((f"Joint {joint}", picture(own, f"force-{i}", told_by.get(joint, ""))))
    strongest = sorted(regimes, key=lambda r: -r.strength)[:30]
    if not pictures and not strongest:
        return None
    return Section(
        "missing_force.html",
        {
            "pictures": pictures,
            "hidden": max(0, len(joints) - SHOWN),
            "regimes": regime_picture(strongest) if strongest else None,
        },
    )


def supplied(force: MissingForce) -> float:
    """How much the named effects change at a joint: joints without news come last."""
    return float(np.nanstd(plot.series(force.before) - plot.series(force.after)))


def picture(forces: Sequence[MissingForce], name: str, first: str = ""):
    """All recordings of one joint: the force as means against speed, position and load (`first`: the field that comes first),
    without and with the named effects; over time and as a spectrum that of the longest recording."""
    longest = max(forces, key=lambda f: len(f.t))
    unit = longest.unit
    against = [
        ("qd", f"velocity ({plot.label(longest.qd_unit, 20)})"),
        ("q", f"position ({plot.label(longest.q_unit, 20)})"),
        ("load", f"load ({plot.label(unit, 20)})"),
    ]
    against = [(field, title) for field, title in against if any(np.ptp(getattr(f, field)) > 0 for f in forces)]
    against.sort(key=lambda a: a[0] != first)
    added = any(not np.array_equal(f.before, f.after) for f in forces)
    bounds = plot.limits(*(plot.series(f.before) for f in forces), quantile=0.005)

    def draw(figure):
        rows, level = figure.add_gridspec(3 if added else 2, 1), None
        for row, which in enumerate(["before", "after"] if added else ["before"]):
            panels = rows[row].subgridspec(1, max(1, len(against))).subplots(sharey=True, squeeze=False)[0]
            for axes, (field, title) in zip(panels, against, strict=False):
                binned.draw(axes, forces, field, which, law=added and which == "before")
                axes.set_xlabel(title)
            panels[0].set_ylabel(f"{'still ' if which == 'after' else ''}missing ({plot.label(unit, 20)})")
            if which == "before":
                level = plot.limits(*(line.get_ydata() for axes in panels for line in axes.get_lines()), quantile=0.0)
            if level:
                panels[0].set_ylim(level)
        last = rows[-1].subgridspec(1, 3)
        over_time, spectrum_axes = figure.add_subplot(last[:2]), figure.add_subplot(last[2])
        over_time.plot(*plot.thin(longest.t, plot.series(longest.before)), color=plot.VERMILLION, linewidth=0.9)
        if added:
            over_time.plot(*plot.thin(longest.t, plot.series(longest.after)), color=plot.BLUE, linewidth=0.9)
        draw_noise(over_time, longest.t, plot.series(longest.floor), 400)
        over_time.set_xlabel(f"time in {plot.label(longest.experiment)} (s)")
        over_time.set_ylabel(f"missing ({plot.label(unit, 20)})")
        over_time.margins(x=0)
        if bounds:
            over_time.set_ylim(bounds)
        draw_spectrum(spectrum_axes, longest)
        handles = legend(over_time, added, len(against) > 1)
        figure.legend(handles=handles, loc="outside upper left", ncols=3, fontsize=8.5)

    return plot.svg(name, (9.2, 7.6 if added else 5.4), draw)


def legend(axes, added: bool, both: bool) -> list:
    mark = lambda style, color, label, **more: axes.plot([], [], style, color=color, label=label, **more)[0]
    out = [mark("o", plot.VERMILLION, "missing, mean and 95 % interval", ms=5)]
    out += [mark("^", plot.ORANGE, "the same moving backwards", ms=5)] if both else []
    if added:
        out.append(mark("-", plot.BLUE, "supplied by the named effects; below: left over"))
    return [*out, axes.axhspan(0, 0, color=plot.GREY, alpha=0.3, label="noise, ±2 standard deviations")]


def draw_noise(axes, x: np.ndarray, floor: np.ndarray, parts: int = PARTS) -> None:
    """A band of two standard deviations of what noise alone would show, over equal parts of the axis."""
    edges = np.linspace(np.min(x), np.max(x), parts + 1)
    part = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, parts - 1)
    count = np.bincount(part, minlength=parts)
    with np.errstate(invalid="ignore"):  # nothing of the motion in a part: no band there
        level = 2 * np.sqrt(np.bincount(part, floor**2, parts) / count)
    axes.stairs(level, edges, baseline=-level, fill=True, color=plot.GREY, alpha=0.3, linewidth=0)


def draw_spectrum(axes, force: MissingForce) -> None:
    for series, color in ((force.before, plot.VERMILLION), (force.after, plot.BLUE)):
        frequency, density = spectrum(force.t, series)
        if len(frequency):
            axes.plot(frequency, density, color=color, linewidth=1.2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(f"spectrum ({plot.label(force.unit, 20)}/√Hz)")
    axes.margins(x=0)
    plot.plain_log(axes.xaxis)
    plot.plain_log(axes.yaxis)


def spectrum(t: np.ndarray, series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and amplitude density (unit/√Hz) by Welch's method, on samples interpolated to even steps."""
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
    # Bins of equal width on the logarithmic axis: even ones would crowd its right end and starve its left.
    bins = np.digitize(frequency, np.geomspace(frequency[0], frequency[-1], 120))
    count = np.bincount(bins)
    filled = count > 0
    mean = [np.bincount(bins, weights)[filled] / count[filled] for weights in (frequency, power)]
    return mean[0], np.sqrt(mean[1])


def regime_picture(regimes: Sequence[Regime]):
    """Each regime's strength against the band that noise alone would give."""
    known = any(r.supplied is not None for r in regimes)

    def draw(figure):
        axes = figure.add_subplot()
        axes.grid(False, axis="y")
        for i, r in enumerate(regimes):
            low, high = map(plot.drawable, r.null)
            strength = plot.drawable(r.strength)
            axes.barh(i, high - low, left=low, height=0.6, color=plot.PALE)
            mark, color = ("o", plot.VERMILLION) if r.stands_out else ("D", plot.GREY)
            if r.supplied is not None:
                axes.plot([plot.drawable(r.ratio)], [i], "|", color=plot.BLACK, markersize=11)
            axes.plot([strength], [i], mark, color=color, markersize=6)
            axes.annotate(
                wording.number(r.strength),
                (max(strength, high, plot.drawable(r.ratio)), i),
                xytext=(8, 0),
                textcoords="offset points",
                va="center",
                fontsize=8.5,
            )
        axes.set_yticks(
            range(len(regimes)),
            [f"{plot.label(r.joint, 20)}, {plot.label(wording.regime_words(r.regime), 30)}" for r in regimes],
        )
        axes.set_ylim(len(regimes) - 0.4, -0.6)
        axes.set_xlim(0, 1.12 * max([1e-3, *(plot.drawable(x) for r in regimes for x in (r.strength, r.ratio, r.null[1]))]))
        axes.set_xlabel("rms of the missing force in the regime / rms over all samples")
        handles = [
            *axes.plot([], [], "o", color=plot.VERMILLION, label="stands out"),
            *axes.plot([], [], "D", color=plot.GREY, label="does not"),
            *(axes.plot([], [], "|", color=plot.BLACK, markersize=11, label="with the noise in it") if known else ()),
            axes.barh([0], [0], color=plot.PALE, label="what a perfect model would show (95 %)"),
        ]
        figure.legend(handles=handles, loc="outside upper left", ncols=4, fontsize=8.5)

    return plot.svg("regimes", (9.2, 1.0 + 0.3 * len(regimes)), draw)
