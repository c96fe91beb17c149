"""Effects that a user adds to a model, by their texts."""

from __future__ import annotations

from jaxid.base.errors import nearest, UsageError
from jaxid.dynamics import catalogue
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.parameter_vector import ParameterVector


def parse_effect(
    text: str | Effect | type[Effect], chain: Chain
) -> tuple[type[Effect], str | None]:
    """`dead_zone@tau`, or `dead_zone` where it has one place. One that the model comprises only
    where a fit holds some of its numbers, which it then fits (at all places, where none is named).
    """
    name, _, place = catalogue.enrolled(text).partition("@")
    kind = catalogue.effect_class(name, chain.mechanism)
    places = chain.offers(kind)
    if not places:
        able = ", ".join(_missing(chain)) or "none"
        raise UsageError(f"{name} has no place in {chain.mechanism.name}, which can take: {able}")
    held = chain.mechanism.held() if any(e.name == name for e in chain.effects) else frozenset()
    layout = ParameterVector(chain)
    frees = bool(held) and any(layout.names[i] in held for i in layout.of_effect(name))
    if name in chain.contents and not frees:
        raise UsageError(
            f"{name} is part of {chain.mechanism.name} already: it is fitted without being"
            " asked for"
        )
    if place and place not in places:
        raise UsageError(f"{name} cannot act at {place!r}{nearest(place, places)}")
    if not place and len(places) > 1 and not frees:
        raise UsageError(
            f"{name} can act at {', '.join(places)}: say where, as in {name}@{places[0]}"
        )
    return kind, place or None


def _missing(chain: Chain) -> list[str]:
    """Effects that a chain has a place for and does not have."""
    kinds = [catalogue.effect_class(name) for name in catalogue.effect_names()]
    return [k.name for k in kinds if k.name not in chain.contents and chain.offers(k)]
