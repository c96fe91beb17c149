"""Laws that are asked last: they take in what many simpler ones do, or have to be searched for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from jaxid import catalogue
from jaxid.diagnosis.hypothesis import possible
from jaxid.diagnosis.result import Diagnosis
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Effect
from jaxid.runtime import Interrupted
from jaxid.wording import times


#: Verdict without such laws -> verdicts with them that take its place.
SAYS_MORE = {"unknown": ("partly", "named"), "partly": ("named",)}
#: Most places of such a law: each is simulated at all of its probes.
FEW_PLACES = 16


def first_asked() -> tuple[str, ...]:
    """What a diagnosis asks that was given no candidates."""
    return tuple(n for n in catalogue.effect_names() if not catalogue.effect_class(n).last_resort)


def last_resorts(nominal: Chain, residual: str) -> list[type[Effect]]:
    """Those that a model can take, and has few places for."""
    late = [n for n in catalogue.effect_names() if catalogue.effect_class(n).last_resort]
    return [k for k in possible(nominal, late, residual) if len(nominal.offers(k)) <= FEW_PLACES]


def asked_last(found: Diagnosis, nominal: Chain, residual: str, ask: Callable[[tuple[str, ...]], Diagnosis]) -> Diagnosis:
    """The answer with laws of last resort beside what was named (`ask` diagnoses with these candidates), where that says more."""
    before, late = found.which.verdict, last_resorts(nominal, residual)
    if before not in SAYS_MORE or not late:
        return found
    names = tuple(k.name for k in late)
    try:
        again = ask((*dict.fromkeys(e.effect for e in found.which.effects), *names))
    except Interrupted as stop:
        raise Interrupted(found) from stop
    if again.which.verdict not in SAYS_MORE[before] or not {e.effect for e in again.which.effects} & set(names):
        return found
    note = (
        f"without {' and '.join(names)} the answer was {before} with {times(found.how_far.gap_after)} times the noise left; such "
        "laws are asked last, for they take in what many simpler ones do"
    )
    return dataclasses.replace(again, notes=(*again.notes, note))
