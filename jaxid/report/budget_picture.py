"""The budget of a gap as a picture: what each step closes, down to what is left."""

from __future__ import annotations

import textwrap
from dataclasses import replace
from typing import TYPE_CHECKING

from jaxid.base import wording
from jaxid.report import plot


if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jaxid.diagnosis.budget import Step
    from jaxid.diagnosis.result import Diagnosis


#: What each step is called, and its colour.
STEPS = {
    "stated": ("as stated", plot.VERMILLION),
    "numbers": ("numbers re-tuned", plot.ORANGE),
    "effects": ("with the missing effect", plot.BLUE),
    "any_free_law": ("with any free law", plot.SKY),
}
#: How dark what a step closes is beside what it leaves.
CLOSED = 0.3
#: Characters of a line of a label: longer ones leave no room for the bars.
LABEL = 28


def gap_picture(diagnosis: Diagnosis):
    """A waterfall of the gap from the model as stated to what is left, against the noise."""
    bars = len(_drawn(diagnosis))
    return plot.svg(
        "gap",
        (plot.WIDE, 0.62 + 0.42 * bars),
        lambda figure: draw_gap(figure.add_subplot(), diagnosis),
    )


def _drawn(diagnosis: Diagnosis) -> list[Step]:
    """The steps. Re-tuned numbers that leave what they found are none; where no numbers are stated
    they are the first.
    """
    steps = [step for step in diagnosis.budget if step.step in STEPS]
    stated, retuned, *others = steps
    if wording.times(stated.gap) != wording.times(retuned.gap):
        return steps
    first = stated if diagnosis.final.stated else replace(retuned, closes=None)
    return [first, *others]


def draw_gap(axes: Axes, diagnosis: Diagnosis) -> Axes:
    """The same on Axes. Each bar is what a step leaves; pale beyond it is what it closes."""
    steps = _drawn(diagnosis)
    noise = diagnosis.how_far.noise_floor
    floor = noise if 0 < noise < plot.LARGEST else 1.0
    gaps = [plot.drawable(step.gap) for step in steps]
    longest = max([floor, *gaps])
    logarithmic = longest > 15 * floor
    axes.grid(False, axis="y")
    if logarithmic:
        axes.set_xscale("log")
    start = floor if logarithmic else 0.0
    for i, (step, gap) in enumerate(zip(steps, gaps, strict=True)):
        color = STEPS[step.step][1]
        axes.barh(i, gap - start, left=start, color=color, height=0.62)
        before = gaps[i - 1] if i else gap
        if before > gap:
            axes.barh(i, before - gap, left=gap, color=color, height=0.62, alpha=CLOSED)
        axes.annotate(
            _told(step),
            (max(before, gap, start), i),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontweight="bold",
            color="#000000",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
        )
    axes.axvline(floor, color=plot.BLACK, linestyle=(0, (4, 2)), linewidth=1.2)
    axes.annotate(
        "noise", (floor, -0.52), xytext=(4, 0), textcoords="offset points", va="bottom", ha="left"
    )
    axes.set_yticks(range(len(steps)), [_name(step) for step in steps])
    axes.set_ylim(len(steps) - 0.5, -0.85)
    low = min([floor, *(gap for gap in gaps if 0 < gap < floor)])
    if logarithmic:
        axes.set_xlim(low / 1.25, longest * (longest / floor) ** 0.25)
    else:
        axes.set_xlim(0.0, 1.3 * longest)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    scale = " (logarithmic)" if logarithmic else ""
    axes.set_xlabel(f"times the noise{scale}")
    if logarithmic:
        plot.plain_log(axes.xaxis)
    return axes


def _name(step: Step) -> str:
    name = STEPS[step.step][0]
    return textwrap.fill(f"{name} over {step.law}", LABEL) if step.law else name


def _told(step: Step) -> str:
    """`345, closes 96.0 %`."""
    gap = wording.times(step.gap)
    if step.closes is None:
        return gap
    if step.closes < 0:
        return f"{gap}, further off"
    return f"{gap}, closes {wording.percent(step.closes)}"
