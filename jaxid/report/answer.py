"""The first screen: where, which, how far, and one picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxid import wording
from jaxid.report import plot, text
from jaxid.report.budget_text import budget_sentence, headline_of_unknown
from jaxid.report.other_numbers import first_of_all, other_numbers, other_places
from jaxid.report.page import Section


if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jaxid.diagnosis.result import Diagnosis, Finding, HowFar
    from jaxid.fitting.result import EffectEstimate


def section(diagnosis: Diagnosis) -> Section:
    which, how_far = diagnosis.which, diagnosis.how_far
    return Section(
        "answer.html",
        {
            "diagnosis": diagnosis,
            "headline": headline(diagnosis),
            "stated": text.stated_sentences(diagnosis.final.stated, which.effects),
            "where": where_card(diagnosis),
            "which": which_card(diagnosis),
            "far": far_card(diagnosis),
            "remark": how_far.text[:1].upper() + how_far.text[1:],
            "picture": (
                None
                if which.verdict == "none" or not text.measured(how_far)
                else gap_picture(how_far, which.verdict)
            ),
            "effects_added": bool(which.effects),
            "channels": [(name, how_far.per_channel[name]) for name in text.telling(how_far)],
            "measured": (
                f"Measured on {how_far.split} data, {_used(how_far)}. "
                if text.measured(how_far)
                else ""
            ),
        },
    )


def _used(how_far: HowFar) -> str:
    report = how_far.split == "report"
    return (
        "which were neither fitted nor used for choosing"
        if report
        else "which were not fitted, but chose the effect"
    )


def words(effect: EffectEstimate) -> str:
    return f"{effect.effect.replace('_', ' ')} at {effect.location}"


def headline(diagnosis: Diagnosis) -> str:
    which = diagnosis.which
    if not text.measured(diagnosis.how_far):
        return "Nothing can be judged: the data kept for it stand still."
    if which.verdict == "none":
        return other_numbers(diagnosis) or "Nothing is missing: the model reaches the noise."
    if which.verdict == "unknown":
        return headline_of_unknown(diagnosis)
    return text.lacks(
        which,
        text.at_places,
        ", or an effect that looks the same in these data" if which.confusable_with else "",
    )


def where_card(diagnosis: Diagnosis) -> tuple[str, list[str]]:
    if not text.measured(diagnosis.how_far):
        return "Not measured", ["The data kept for it could not be compared."]
    if diagnosis.which.verdict != "none" and not diagnosis.where:
        return "In no one place", [
            "No joint, direction or time holds more of it than chance would put there."
        ]
    if other_numbers(diagnosis):
        return other_places(diagnosis)
    if diagnosis.which.verdict == "none":
        return "Nowhere above the noise", ["What the simulation misses is no more than noise."]
    first = diagnosis.where[0]
    sentences = [text.where_sentence(f) for f in diagnosis.where[:2]]
    told = diagnosis.which.verdict == "named" or wording.percent(first.share_of_gap) in sentences[0]
    if first.text and not told:  # a sentence of its own may leave these out
        sentences.insert(
            1,
            f"{wording.percent(first.share_of_gap)} of the gap,"
            f" {wording.times(first.times_noise_floor)} times the noise.",
        )
    return place(first), sentences


def place(finding: Finding) -> str:
    """`q, low speed`; where it lies in no regime, what it is a law of."""
    how = wording.regime_words(finding.regime)
    if finding.regime in ("everywhere", "time_window") and finding.variable:
        how = "always" if finding.variable == "time" else f"by {finding.variable}"
    return f"{finding.location}, {how}"


def _nothing_named(diagnosis: Diagnosis) -> tuple[str, list[str]]:
    which = diagnosis.which
    fact = "None" if which.verdict == "none" else "Unknown"
    sentences = [first_of_all(diagnosis, which.text or text.which_sentence(which))]
    hidden = [u for u in diagnosis.unseen if u.moved and not u.absorbed]
    if hidden:
        many = f"{len(hidden)} effects" if len(hidden) > 1 else "one effect"
        sentences.append(
            f"Other motions may show more: {many} could hide in these recordings (below)."
        )
    return fact, [s for s in sentences if s]


def which_card(diagnosis: Diagnosis) -> tuple[str, list[str]]:
    which = diagnosis.which
    if which.verdict in ("none", "unknown"):
        return _nothing_named(diagnosis)
    sentences = text.meaning(which)
    for effect in which.effects:
        prefix = f"{words(effect)}: " if len(which.effects) > 1 else ""
        inside = ", ".join(
            f"{name} {text.value_with_std(p)}" for name, p in effect.parameters.items()
        )
        if inside:
            sentences.append(prefix + inside)
    if which.verdict == "partly":
        sentences.append("A clear remainder is left that no known effect explains.")
    own = which.verdict == "named" and len(which.effects) == 1  # said above
    sentences += [*text.to_check(which), text.confusable_sentence(which), "" if own else which.text]
    perhaps = "Perhaps " if len(which.doubts) == len(which.effects) else ""
    return f"{perhaps}{text.at_places(which.effects)}", [s for s in sentences if s]


def far_card(diagnosis: Diagnosis) -> tuple[str, list[str]]:
    how_far, verdict = diagnosis.how_far, diagnosis.which.verdict
    if not text.measured(how_far):
        fact = "Not measured"
    elif how_far.shrinkage is None or not diagnosis.which.effects:
        last = (
            how_far.gap_retuned
            if verdict == "none"
            else how_far.gap_after
            if diagnosis.which.effects
            else how_far.gap_before
        )
        fact = f"{wording.times(last)} × the noise"
    else:
        share = wording.percent(how_far.shrinkage)
        fact = f"{share[:1].upper()}{share[1:]} of the gap closed"
    sentences = [budget_sentence(diagnosis), text.how_far_sentence(how_far, verdict)]
    if how_far.shrinkage is None or verdict == "unknown":
        sentences.append(text.shrinkage_sentence(how_far, verdict))
    elif how_far.shrinkage_interval_95 is None:
        if how_far.interval_reason:
            sentences.append(
                f"No interval: {how_far.interval_reason.rstrip('.').removeprefix('no interval: ')}."
            )
    else:
        sentences.append(text.further_run(how_far))
    return fact, [s for s in sentences if s]


def gap_picture(how_far: HowFar, verdict: str):
    """Bars of the gap before, after retuning and after adding the effect, against the noise."""
    bars = 3 if verdict in ("named", "partly") else 2
    return plot.svg(
        "gap",
        (plot.WIDE, 0.62 + 0.42 * bars),
        lambda figure: draw_gap(figure.add_subplot(), how_far, verdict),
    )


def draw_gap(axes: Axes, how_far: HowFar, verdict: str) -> Axes:
    """The same on Axes."""
    bars = [
        ("as stated", how_far.gap_before, plot.VERMILLION),
        ("re-tuned", how_far.gap_retuned, plot.ORANGE),
    ]
    if verdict in ("named", "partly"):
        bars.append(("with the missing effect", how_far.gap_after, plot.BLUE))
    floor = how_far.noise_floor if 0 < how_far.noise_floor < plot.LARGEST else 1.0
    longest = max([floor, *(plot.drawable(gap) for _, gap, _ in bars)])
    logarithmic = longest > 15 * floor
    axes.grid(False, axis="y")
    if logarithmic:
        axes.set_xscale("log")
    start = floor if logarithmic else 0.0
    for i, (_, exact, color) in enumerate(bars):
        gap = plot.drawable(exact)
        axes.barh(i, gap - start, left=start, color=color, height=0.62)
        axes.annotate(
            wording.times(exact),
            (max(gap, start), i),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontweight="bold",
            color="#000000",
        )
    axes.axvline(floor, color=plot.BLACK, linestyle=(0, (4, 2)), linewidth=1.2)
    axes.annotate(
        "noise", (floor, -0.52), xytext=(4, 0), textcoords="offset points", va="bottom", ha="left"
    )
    axes.set_yticks(range(len(bars)), [name for name, _, _ in bars])
    axes.set_ylim(len(bars) - 0.5, -0.85)
    low = min([floor, *(gap for _, gap, _ in bars if 0 < gap < floor)])
    axes.set_xlim(
        *(
            (low / 1.25, longest * (longest / floor) ** 0.1)
            if logarithmic
            else (0.0, 1.12 * longest)
        )
    )
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.set_xlabel(
        f"gap on {how_far.split} data, in multiples of the noise"
        + (" (logarithmic)" if logarithmic else "")
    )
    if logarithmic:
        plot.plain_log(axes.xaxis)
    return axes
