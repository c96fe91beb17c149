"""Drawing: inline SVG from matplotlib's figures, without pyplot and without leaving its settings
changed.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib
import numpy as np
from markupsafe import escape, Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from jaxid.base.wording import one_line


# Okabe and Ito, told apart by colour-blind readers and in grey; orange and sky are darker, so that
# each has a contrast of 3 to white.
BLACK, ORANGE, SKY, GREEN, BLUE, VERMILLION, PURPLE = (
    "#000000",
    "#bf7e00",
    "#2f95d0",
    "#009e73",
    "#0072b2",
    "#d55e00",
    "#cc79a7",
)
GREY, PALE = "#8c8c8c", "#dddddd"

#: Inches that a picture of a whole page is drawn for, and what it is at most: two stand side by
#: side on a screen, one on a phone, and letters of 9 points are then at least 9 pixels high.
WIDE, NARROW = 9.2, 4.4
LETTER = 0.075  # inches that a letter of 9 points takes, roughly
#: Share of a picture's width left free at its right: letters of a browser are a little wider than
#: those that are measured here.
SPARE = 0.02

LARGEST = 1e12
POINTS = 1500  # drawn of a series, however long it is

_SETTINGS: dict[Any, Any] = {
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "font.size": 9.0,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Helvetica", "Arial"],
    "grid.color": "#e8e8e8",
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "path.simplify": False,  # it would swallow the dots; series are thinned before they are drawn
    "svg.fonttype": "none",
    "text.parse_math": False,  # a channel named `$\frac{1$` is a name
}


def svg(
    name: str,
    size: tuple[float, float],
    draw: Callable[[Figure], object],
    narrow_height: float | None = None,
) -> Markup:
    """What `draw` draws as one SVG element that screens, phones and paper show: `NARROW` inches
    wide at most, and `narrow_height` high where it is narrower than `size` (inches) says. The same
    bytes for the same data.
    """
    wide, height = size
    if wide > NARROW:
        height = narrow_height or height
    return Markup(element(name, (min(wide, NARROW), height), draw))


def element(name: str, size: tuple[float, float], draw: Callable[[Figure], object]) -> str:
    """One SVG element of this size (inches)."""
    with matplotlib.rc_context(), warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # a glyph missing from matplotlib's font: the browser draws the text
        matplotlib.rcdefaults()
        matplotlib.rcParams.update({**_SETTINGS, "svg.hashsalt": name})
        room = ConstrainedLayoutEngine(rect=(0.0, 0.0, 1.0 - SPARE, 1.0))
        figure = Figure(figsize=size, dpi=72, layout=room)  # what SVG counts in
        canvas = FigureCanvasSVG(figure)  # it measures letters
        draw(figure)
        spoken = described(figure)
        _laid_out(figure)
        if narrow(figure) and _wrap_titles(figure):
            _laid_out(figure)
        figure.set_layout_engine("none")
        buffer = io.StringIO()  # not by `savefig`, which would lay it out by drawing it once more
        canvas.print_svg(
            buffer, metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
    source = buffer.getvalue()
    source = source[source.index("<svg") :]
    source = re.sub(r"<metadata>.*?</metadata>", "", source, flags=re.DOTALL)
    source = re.sub(r"<!--.*?-->", "", source, flags=re.DOTALL)
    source = re.sub(r'<g id="[^"]*"(/?)>', r"<g\1>", source)  # the same in every picture of a page
    source = re.sub(r' d="[^"]*"', _shorter, source)
    source = re.sub(r"\n\s*", "\n", source)
    return re.sub(r"<svg ([^>]*)>", lambda found: _spoken(found[1], *spoken), source, count=1)


def _spoken(attributes: str, title: str, description: str) -> str:
    """The opening tag of a picture with what a screen reader says of it."""
    names = f"<title>{escape(title)}</title><desc>{escape(description)}</desc>"
    return f'<svg role="img" aria-label="{escape(title)}" {attributes}>{names}'


def described(figure: Figure) -> tuple[str, str]:
    """A title of a picture, made of what its axes are called, and what it shows: the entries of its
    legends, the ticks that are words.
    """
    titles: dict[str, None] = {}
    shown: dict[str, None] = {}
    for axes in figure.axes:
        across, upward = _on_one_line(axes.get_xlabel()), _on_one_line(axes.get_ylabel())
        both = " over ".join(filter(None, (upward, across)))
        titles |= dict.fromkeys(filter(None, [both]))
        ticks = [*axes.get_yticklabels(), *axes.get_xticklabels()]
        words = [_on_one_line(tick.get_text()) for tick in ticks]
        shown |= dict.fromkeys(word for word in words if any(map(str.isalpha, word)))
        legend = axes.get_legend()
        if legend is not None:
            shown |= dict.fromkeys(_on_one_line(t.get_text()) for t in legend.get_texts())
    for legend in figure.legends:
        shown |= dict.fromkeys(_on_one_line(t.get_text()) for t in legend.get_texts())
    title = "; ".join(titles) or "picture"
    return title, f"{title}. Shown: {', '.join(shown)}." if shown else f"{title}."


def _on_one_line(label: str) -> str:
    return " ".join(one_line(label.replace("\n", " ")).split())


def narrow(figure: Figure) -> bool:
    """Whether a picture is drawn for a phone."""
    return figure.get_figwidth() <= NARROW


def points(figure: Figure) -> int:
    """How many samples of a series a picture shows."""
    return int(POINTS * figure.get_figwidth() / WIDE)


def legend(
    figure: Figure, handles: Sequence[Any], columns: int, where: Any = "outside upper left"
) -> None:
    """A legend outside the axes in at most this many columns: as many as fit."""
    longest = max(len(str(h.get_label())) for h in handles)
    fit = int(figure.get_figwidth() // (LETTER * longest + 0.5))
    figure.legend(handles=handles, loc=where, ncols=max(1, min(columns, fit)))


def _laid_out(figure: Figure) -> None:
    """Places axes and legends so that all of their letters have room."""
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.execute(figure)


def _wrap_titles(figure: Figure) -> bool:
    """Axis titles in as many lines as their axes need; whether any needs more than one."""
    wrapped = False
    for axes in figure.axes:
        box = axes.get_window_extent()
        for title, set_title, length in (
            (axes.get_xlabel(), axes.set_xlabel, box.width),
            (axes.get_ylabel(), axes.set_ylabel, box.height),
        ):
            letters = max(12, int(length / figure.dpi / LETTER))
            if max(map(len, title.split("\n"))) > letters:
                set_title(filled(title, letters))
                wrapped = True
    return wrapped


def filled(title: str, letters: int) -> str:
    """A title in lines of at most this many letters, where it allows that: it breaks at blanks and
    behind the underscores of names, and units stay whole (`unit`).
    """
    parts = re.findall(r"[^ \n_]*_+|[^ \n_]+ ?|[ \n]", title)
    lines = [""]
    for part in parts:
        if lines[-1] and len(f"{lines[-1]}{part}".rstrip(" ")) > letters:
            lines.append("")
        lines[-1] += part.replace("\n", " ")
    return "\n".join(line.rstrip(" ") for line in lines)


def _shorter(path: re.Match[str]) -> str:
    return re.sub(r"(\.\d\d)\d+", r"\1", path[0]).replace(" \n", "\n")


def drawable(value: float) -> float:
    """A length for a bar: a model that diverged has a gap that no axis can hold (its label still
    tells).
    """
    return float(np.clip(np.nan_to_num(value, nan=0.0), -LARGEST, LARGEST))


def series(values: np.ndarray) -> np.ndarray:
    """A series that an axis can hold; what is not a number stays a gap in the line."""
    return np.clip(np.asarray(values, float), -LARGEST, LARGEST)


def label(text: object, length: int = 60) -> str:
    """A name from a file, fit to stand in a picture."""
    line = one_line(text)
    return line if len(line) <= length else line[: length - 1] + "…"


def unit(text: object) -> str:
    """A unit, fit to stand in a picture: its blanks do not break."""
    return label(text, 20).replace(" ", "\u00a0")


def with_unit(name: str, of: str) -> str:
    """An axis title: `q (rad)`."""
    return f"{label(name)} ({unit(of)})" if of else label(name)


def thin(t: np.ndarray, y: np.ndarray, points: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """At most about `points` samples that keep the lowest and highest of every stretch; samples not
    finite are gaps.
    """
    t, y = np.asarray(t, float), np.asarray(y, float)
    n = len(y)
    if n <= points:
        return t, y
    edges = np.linspace(0, n, points // 2 + 1).astype(int)
    keep = np.empty((len(edges) - 1, 2), int)
    for i, (start, end) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        part = y[start:end]
        low, high = (
            np.where(np.isfinite(part), part, np.inf),
            np.where(np.isfinite(part), part, -np.inf),
        )
        keep[i] = start + np.sort([int(np.argmin(low)), int(np.argmax(high))])
    index = np.unique(keep)
    return t[index], y[index]


def dots(
    axes: Axes, x: np.ndarray, y: np.ndarray, color: str, size: float = 1.8, alpha: float = 0.5
) -> None:
    """Many points as one path: a marker each would make the page some ten times larger."""
    gap = np.full(len(x), np.nan)
    # A length of nothing is not drawn by every browser; a millionth of the axis is.
    step = 1e-6 * (float(np.ptp(x)) or 1.0)
    axes.plot(
        np.stack([x, x + step, gap], axis=1).ravel(),
        np.stack([y, y, gap], axis=1).ravel(),
        color=color,
        linewidth=size,
        solid_capstyle="round",
        alpha=alpha,
    )


def limits(*series: np.ndarray, quantile: float = 0.002) -> tuple[float, float] | None:
    """Axis limits that leave out the outermost fifth of a percent at each side, so that one spike
    hides nothing.
    """
    values = np.concatenate([np.ravel(s) for s in series]) if series else np.zeros(0)
    values = values[np.isfinite(values)]
    if not len(values):
        return None
    low, high = np.quantile(values, [quantile, 1 - quantile])
    margin = 0.06 * (high - low) or abs(high) * 0.1 or 1.0
    return float(low - margin), float(high + margin)


def plain_log(axis) -> None:
    """Numbers on a logarithmic axis written out (the usual powers of ten would need math text)."""
    decades, most = _decades(axis), _room(axis)
    if decades < 0.5:
        axis.set_major_locator(MaxNLocator(4))
    else:
        parts = (1.0, 2.0, 5.0) if decades < 2.5 and 3 * decades < most else (1.0,)
        axis.set_major_locator(LogLocator(10.0, subs=parts, numticks=most))
    axis.set_major_formatter(
        FuncFormatter(lambda v, _: f"{v:g}" if 1e-3 <= v < 1e5 else f"{v:.0e}")
    )
    axis.set_minor_formatter(NullFormatter())


def _room(axis) -> int:
    """Numbers that an axis has room for, if each is as long as `1e-05`."""
    if axis.axis_name == "y":
        return 12
    inches = axis.axes.get_window_extent().width / axis.get_figure().dpi
    return int(np.clip(inches / (6 * LETTER), 3, 12))


def _decades(axis) -> float:
    low, high = axis.get_view_interval()
    return float(np.log10(high / low)) if low > 0 else 10.0
