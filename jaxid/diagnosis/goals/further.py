"""What is still missing beside effects that simulations bore out, proposed along the free run of
the model that has them.

First order about a model that lacks something large says little of what is smaller. Where the model
with what was found is not at the noise, effects are asked once more, to first order about its own
free run, as a step of Gauss and Newton is taken again where it led.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxid.diagnosis.belief import Belief, joined_beliefs
from jaxid.diagnosis.goals.asked import GoalsQuestion
from jaxid.diagnosis.goals.own_run import without_steps
from jaxid.diagnosis.goals.propose import (
    as_vector,
    candidates_of,
    kinds_of,
    LinearisedSearch,
    Proposal,
    ProposedSets,
)
from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.goals.study import LedStudy
from jaxid.diagnosis.hypothesis import Candidate, key_of, SearchResult
from jaxid.dynamics.catalogue import effect_class
from jaxid.dynamics.effect import OutputEffect
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.problem.binding import Binding


def with_what_is_still_missing(
    ask: GoalsQuestion, decider: Decider, search: SearchResult
) -> tuple[Decider, SearchResult]:
    """The search with further effects beside those chosen, until the noise is reached, nothing more
    is borne out or as many effects stand as may; and the decider whose simulations it is of.
    """
    while _leaves_more(ask, decider, search):
        wider = _once_more(ask, decider, search)
        if wider is None:
            break
        decider, search = wider
    return decider, search


def _leaves_more(ask: GoalsQuestion, decider: Decider, search: SearchResult) -> bool:
    chosen = search.chosen
    if not chosen.effects or decider.at_noise(chosen):
        return False
    return len(_kinds(chosen.effects)) < ask.max_effects


def _kinds(effects: Sequence[Candidate]) -> list[str]:
    return list(dict.fromkeys(c.effect for c in effects))


def _once_more(
    ask: GoalsQuestion, decider: Decider, search: SearchResult
) -> tuple[Decider, SearchResult] | None:
    """The search with what is borne out beside what it chose; None where nothing is."""
    kept = _kinds(search.chosen.effects)
    base = _with_chosen(ask, decider, search, kept)
    theta = _carried(search.chosen.theta, decider.bench.binding.layout, base)
    others = [kind for kind in ask.kinds if kind.name not in kept]
    study = LedStudy(without_steps(base), others, begin=theta)
    linearised = LinearisedSearch(study, theta, ask.max_effects - len(kept))
    proposed = linearised.searched(Proposal((), (), theta))
    if not proposed.sets:
        return None
    return _borne_out(ask, decider, search, base, proposed)


def _with_chosen(
    ask: GoalsQuestion, decider: Decider, search: SearchResult, kept: Sequence[str]
) -> Binding:
    """The model with what was chosen among its own free numbers; those of a reading are no forces
    along a motion, and stay.
    """
    base, names = ask.known(kept), decider.bench.binding.layout.names
    free = set(base.free)
    for c in search.chosen.effects:
        if not issubclass(effect_class(c.effect, base.chain.mechanism), OutputEffect):
            free |= {base.layout.index(names[i]) for i in c.index}
    return replace(base, free=sorted(free))


def _borne_out(
    ask: GoalsQuestion,
    decider: Decider,
    search: SearchResult,
    base: Binding,
    proposed: ProposedSets,
) -> tuple[Decider, SearchResult] | None:
    """What simulations bear out of the sets that were proposed beside what stands."""
    before = decider.bench.binding.layout
    kept = _kinds(search.chosen.effects)
    bench = ask.made(ask.known([*kept, *kinds_of(proposed.sets)], proposed.inflation))
    wide = bench.binding
    wider = replace(
        decider,
        bench=bench,
        names=base.layout.names,
        slopes=None,
        total=decider.done + 2 + len(proposed.sets),
        sure=dict(decider.sure),
    )
    nominal = wider.refit((), _carried(search.nominal.theta, before, wide))
    standing = [_moved(c, before, wide.layout) for c in search.chosen.effects]
    theta = _carried(search.chosen.theta, before, wide)
    stands = wider.refit(standing, theta, nominal.path)
    tried = [stands]
    for s in proposed.sets:
        own = [*standing, *candidates_of(bench, s)]
        tried.append(wider.refit(own, as_vector(wide, base.layout.names, s), stands.path))
    best = max(tried, key=lambda h: np.nan_to_num(wider.gained(stands, h), nan=-np.inf))
    if best is stands:
        return None
    chosen = wider.thinned(nominal, wider.reweighed(best), tried)
    if key_of(chosen.effects) <= key_of(standing):
        return None
    more = wider.certain([c for c in chosen.effects if c not in standing])
    found = SearchResult(
        nominal=nominal,
        chosen=chosen,
        tried=[*search.tried, *tried],
        confusable=list(dict.fromkeys([*search.confusable, *proposed.instead(more)])),
        several=len(_kinds(chosen.effects)) > 1,
        belief=_believed(search.belief, proposed.belief(more)).at_most(wider.sure),
    )
    return wider, found


def _believed(before: Belief | None, more: Belief) -> Belief:
    return more if before is None else joined_beliefs([before, more]) or more


def _carried(theta: np.ndarray, layout: ParameterVector, into: Binding) -> np.ndarray:
    """Numbers of one layout in another one, those that it lacks as they are there."""
    out, own = into.theta.copy(), dict(zip(layout.names, theta, strict=True))
    for i, name in enumerate(into.layout.names):
        out[i] = own.get(name, out[i])
    return out


def _moved(c: Candidate, before: ParameterVector, after: ParameterVector) -> Candidate:
    """A candidate by its numbers' positions in another layout."""
    return replace(c, index=tuple(after.index(before.names[i]) for i in c.index))
