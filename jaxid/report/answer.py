"""The first screen: where, which, how far, and one picture."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple, TYPE_CHECKING

from jaxid.base import wording
from jaxid.diagnosis.alike import alike
from jaxid.report import effect_text, text
from jaxid.report.budget_picture import gap_picture
from jaxid.report.budget_text import budget_sentence, headline_of_unknown
from jaxid.report.other_numbers import first_of_all, other_numbers, other_places
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.diagnosis.result import ChannelGap, Diagnosis, Finding, HowFar


#: Most words of a card, its fact and its question included; words of the longest question.
WORDS, QUESTION = 60, 6
#: Where a sentence ends and another begins.
_BETWEEN = re.compile(r"(?<=[.!?]) (?=[A-Z])")
#: An effect of more numbers than these has them under what to write.
NUMBERS = 4
QUESTIONS = {"where": "Where", "which": "Which effect", "far": "How far"}


class Card(NamedTuple):
    """A fact with the sentences that a card has room for, and those that stand below the cards."""

    shown: tuple[str, list[str]]
    more: list[str]


def short(fact: str, sentences: Sequence[str]) -> Card:
    """A card of at most `WORDS` words; its first sentence stands there in any case."""
    single: list[str] = []
    for said in sentences:
        single += _BETWEEN.split(said if said.endswith((".", "!", "?")) else f"{said}.")
    shown: list[str] = []
    count = QUESTION + len(fact.split())
    for k, sentence in enumerate(single):
        count += len(sentence.split())
        if k and count > WORDS:
            return Card((fact, shown), single[k:])
        shown.append(sentence)
    return Card((fact, shown), [])


def section(diagnosis: Diagnosis) -> Section:
    which, how_far = diagnosis.which, diagnosis.how_far
    cards = {
        "where": short(*where_card(diagnosis)),
        "which": short(*which_card(diagnosis)),
        "far": short(*far_card(diagnosis)),
    }
    return Section(
        "answer.html",
        {
            "diagnosis": diagnosis,
            "headline": headline(diagnosis),
            "left_out": text.left_out_sentences(diagnosis.notes),
            "stated": text.stated_sentences(diagnosis.final.stated, which.effects),
            "where": cards["where"].shown,
            "which": cards["which"].shown,
            "far": cards["far"].shown,
            "more": [(QUESTIONS[k], card.more) for k, card in cards.items() if card.more],
            "remark": text.sentence(how_far.text) if how_far.text else "",
            "picture": (
                None
                if which.verdict == "none" or not text.measured(how_far)
                else gap_picture(diagnosis)
            ),
            "effects_added": bool(which.effects),
            "channels": _channels(how_far),
            "measured": (
                f"Measured on {how_far.split} data, {_used(how_far)}. "
                if text.measured(how_far)
                else ""
            ),
        },
    )


def _channels(how_far: HowFar) -> list[tuple[str, ChannelGap]]:
    """The outputs; none where each is a joint: these have a table of their own."""
    joints = {row["joint"] for row in how_far.per_joint}
    if joints.issuperset(how_far.per_channel):
        return []
    return [(name, how_far.per_channel[name]) for name in text.telling(how_far)]


def _used(how_far: HowFar) -> str:
    report = how_far.split == "report"
    return (
        "which were neither fitted nor used for choosing"
        if report
        else "which were not fitted, but chose the effect"
    )


def headline(diagnosis: Diagnosis) -> str:
    which = diagnosis.which
    if not text.measured(diagnosis.how_far):
        return "Nothing can be judged: the data kept for it stand still."
    if which.verdict == "none":
        return other_numbers(diagnosis) or "Nothing is missing: the model reaches the noise."
    if which.verdict == "unknown":
        return headline_of_unknown(diagnosis)
    return effect_text.lacks(
        which,
        effect_text.at_places,
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
    sentences = effect_text.meaning(which)
    groups = alike(which.effects)
    for group in groups:
        numbers = group.common.parameters
        inside = effect_text.parameters_of(group.common) if len(numbers) <= NUMBERS else ""
        prefix = ""
        if len(which.effects) > 1:
            kind = group.common.effect.replace("_", " ")
            prefix = f"{kind} at {effect_text.named_places(group.locations)}: "
        if inside:
            sentences.append(prefix + inside)
    if which.verdict == "partly":
        sentences.append("A clear remainder is left that no known effect explains.")
    own = which.verdict == "named" and len(which.effects) == 1  # said above
    sentences += [
        *effect_text.to_check(which),
        text.confusable_sentence(which),
        "" if own else which.text,
    ]
    perhaps = "Perhaps " if len(which.doubts) == len(which.effects) else ""
    return f"{perhaps}{effect_text.at_places(which.effects)}", [s for s in sentences if s]


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
