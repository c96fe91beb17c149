"""Makes docs/_static/walk.svg, the picture of docs/walk.md:

python docs/make_walk.py
"""

from __future__ import annotations

from pathlib import Path

from jaxid.report import plot


#: Stops of a sample and of a number: the package, and what happens there.
SAMPLE = (
    ("data", "CSV → Dataset"),
    ("conventions", "what it says\nabout itself"),
    ("simulation", "arrays on\nfixed steps"),
    ("problem", "Residual"),
    ("diagnosis", "where, which,\nhow far"),
    ("report", "page and\nsentences"),
)
NUMBER = (
    ("api", "fit"),
    ("dynamics", "Layout:\nnumbers ↔ Chain"),
    ("fitting", "fitters ask\nfor many z"),
    ("problem", "Problem:\nz → theta"),
    ("simulation", "Engine:\nlanes on cores"),
    ("dynamics", "Chain.advance:\none step"),
)


def draw(figure) -> None:
    axes = figure.subplots()
    axes.set_axis_off()
    axes.set(xlim=(-0.55, 5.55), ylim=(-0.62, 1.7))
    for y, name, stops, colour in (
        (1.0, "a sample", SAMPLE, plot.BLUE),
        (0.0, "a number", NUMBER, plot.VERMILLION),
    ):
        axes.plot([0, 5], [y, y], color=colour, lw=2, zorder=1)
        axes.annotate(
            "", (5.3, y), (5.0, y), arrowprops={"arrowstyle": "->", "color": colour, "lw": 2}
        )
        axes.text(-0.5, y + 0.46, name, color=colour, weight="bold", va="bottom")
        for x, (package, what) in enumerate(stops):
            axes.plot(x, y, "o", color=colour, ms=8, zorder=3)
            axes.text(x, y + 0.13, package, ha="center", va="bottom", family="monospace")
            axes.text(x, y - 0.13, what, ha="center", va="top", linespacing=1.15)
    axes.plot([3, 3], [0.3, 0.72], color=plot.BLACK, lw=1, ls=(0, (2, 2)), zorder=0)


def main() -> None:
    target = Path(__file__).parent / "_static" / "walk.svg"
    target.write_text(plot.element("walk", (9.5, 3.2), draw), encoding="utf-8")


if __name__ == "__main__":
    main()
