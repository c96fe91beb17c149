"""Named effects in words: their names, places and numbers, what they are, what to check."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from jaxid.base.wording import by_effect, listed, one_line, value_with_std
from jaxid.diagnosis.alike import alike
from jaxid.diagnosis.cause import words


if TYPE_CHECKING:
    from jaxid.diagnosis.alike import AlikeEffects
    from jaxid.diagnosis.result import Which
    from jaxid.fitting.result import EffectEstimate


def effect_name(effect: EffectEstimate) -> str:
    return one_line(f"{effect.effect} at {effect.location}")


#: This many places of one effect are named in a headline.
PLACES = 3


def alike_words(group: AlikeEffects) -> str:
    """`input_delay at q1_cmd and q2_cmd alike (delay 0.0118 ± 0.0004 s)`: a name, its places, and
    the numbers that they share.
    """
    if len(group.locations) == 1:
        return effect_with_parameters(group.common)
    inside = parameters_of(group.common)
    places = named_places(group.locations)
    said = f"{one_line(group.common.effect)} at {places} alike"
    return said + (f" ({inside})" if inside else "")


def named_places(places: Sequence[str]) -> str:
    """Their names, or how many they are."""
    if len(places) > PLACES:
        return f"{len(places)} places"
    return listed(map(one_line, places))


def at_places(effects: Sequence[EffectEstimate]) -> str:
    """`dead zone at tau1 and tau2 and backlash at q1`: every effect once, with its places, or how
    many they are.
    """
    places = by_effect((e.effect, e.location) for e in effects)
    return listed(
        f"{one_line(effect).replace('_', ' ')} at {named_places(at)}"
        for effect, at in places.items()
    )


def parameters_of(effect: EffectEstimate) -> str:
    return ", ".join(
        f"{one_line(name)} {value_with_std(p)}" for name, p in effect.parameters.items()
    )


def effect_with_parameters(effect: EffectEstimate) -> str:
    """`dead_zone at tau (width 0.312 ± 0.004 N m)`."""
    inside = parameters_of(effect)
    return effect_name(effect) + (f" ({inside})" if inside else "")


def meaning(which: Which) -> list[str]:
    """What the named effects are, in plain words; with the place of each where they are several."""
    if which.verdict not in ("named", "partly"):
        return []
    said: dict[str, list[str]] = {}
    for group in alike(which.effects):
        told = words(group.common, "plain")
        if not told:
            continue
        doubtful = str(group.common) in which.doubts
        told = f"If so: {told[:1].lower()}{told[1:]}" if doubtful else told
        said.setdefault(told, []).extend(map(one_line, group.locations))
    if len(which.effects) == 1:
        return list(said)
    return [f"{_of_places(at, len(which.effects))}: {told}" for told, at in said.items()]


def _of_places(at: Sequence[str], every: int) -> str:
    """`q1 and q2`; `All 12 places alike` where there are more than are named."""
    if len(at) <= PLACES:
        return listed(at)
    return f"All {len(at)} places alike" if len(at) == every else f"{len(at)} places alike"


def to_check(which: Which) -> list[str]:
    """What to look for at the machine."""
    told = (
        [words(e, "check") for e in which.effects] if which.verdict in ("named", "partly") else []
    )
    return [
        f"At the machine: {check[:1].lower()}{check[1:]}" for check in dict.fromkeys(told) if check
    ]


def lacks(which: Which, said: Callable[[Sequence[EffectEstimate]], str], same: str = "") -> str:
    """What the model lacks, and what may be the `same`; what is not to be believed as it stands is
    no more than possible.
    """
    sure = [e for e in which.effects if str(e) not in which.doubts]
    perhaps = [e for e in which.effects if str(e) in which.doubts]
    if not sure:
        return f"Something is missing, and {said(perhaps)} may be part of it."
    possible = f", perhaps {said(perhaps)}" if perhaps else ""
    rest = ", and something more that no known effect explains" if which.verdict == "partly" else ""
    return f"The model lacks {said(sure)}{same}{possible}{rest}."
