"""Laws that are asked last: they take in what many simpler ones do, or have to be searched for."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

from jaxid.base.stopping import Interrupted
from jaxid.base.wording import names_of, times
from jaxid.diagnosis.hypothesis import possible
from jaxid.diagnosis.result import Diagnosis
from jaxid.dynamics import catalogue
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Effect


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


def asked_last(
    found: Diagnosis, nominal: Chain, residual: str, ask: Callable[[tuple[str, ...]], Diagnosis]
) -> Diagnosis:
    """The answer with laws of last resort beside what was named, and with the simpler ones that
    these comprise (`ask` diagnoses with such candidates), where that says more.
    """
    before, late = found.which.verdict, last_resorts(nominal, residual)
    if before not in SAYS_MORE or not late:
        return found
    named, names = [e.effect for e in found.which.effects], names_of(late)
    alike = list(itertools.chain.from_iterable(k.resembles for k in late))
    simpler = names_of(possible(nominal, alike, residual))
    try:
        again = ask(tuple(dict.fromkeys([*named, *names, *simpler])))
    except Interrupted as stop:
        raise Interrupted(found) from stop
    new = {e.effect for e in again.which.effects}.difference(named)
    if again.which.verdict not in SAYS_MORE[before] or not new & {*names, *simpler}:
        return found
    laws = "such laws are asked last, for they take in what many simpler ones do"
    note = (
        f"without {' and '.join(names)} the answer was {before} with"
        f" {times(found.how_far.gap_after)} times the noise left; "
        + (laws if new & {*names} else f"{laws}, and so one of these came up again beside them")
    )
    return dataclasses.replace(again, notes=(*again.notes, note))
