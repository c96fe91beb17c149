"""What is still missing beside what simulations bore out.

First order about a model that lacks something large says little of what is smaller. Where the model
with what was found is not at the noise, effects are asked once more, to first order about its own
free run, as a step of Gauss and Newton is taken again where it led. Where joints turn about under
dry friction, columns along a motion may leave more than all that is missing. What they do not show
is asked by simulating every effect.
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
from jaxid.diagnosis.goals.touching import effects_by_runs
from jaxid.diagnosis.hypothesis import Candidate, SearchResult
from jaxid.dynamics.catalogue import effect_class
from jaxid.dynamics.effect import Effect, OutputEffect
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.problem.binding import Binding


def with_what_is_still_missing(
    ask: GoalsQuestion, decider: Decider, search: SearchResult
) -> tuple[Decider, SearchResult]:
    """The search with further effects beside those chosen, until the noise is reached, nothing more
    is borne out or as many effects stand as may; and the decider whose simulations it is of. Among
    columns laws of no name compete, among simulations none: what the latter alone have proposed
    stands where it leads to the noise.
    """
    by_columns, stands = True, (decider, search)
    while _leaves_more(ask, decider, search):
        base = _with_chosen(ask, decider, search)
        wider = _more_by_columns(ask, decider, search, base)
        if wider is None:
            by_columns = False
            wider = _more_by_runs(ask, decider, search, base)
        if wider is None:
            break
        decider, search = wider
        if by_columns:
            stands = wider
    return (decider, search) if decider.at_noise(search.chosen) else stands


def _leaves_more(ask: GoalsQuestion, decider: Decider, search: SearchResult) -> bool:
    if decider.at_noise(search.chosen):
        return False
    return len(_kinds(search.chosen.effects)) < ask.max_effects


def _kinds(effects: Sequence[Candidate]) -> list[str]:
    return list(dict.fromkeys(c.effect for c in effects))


def _others(ask: GoalsQuestion, search: SearchResult) -> list[type[Effect]]:
    """Effects that were not chosen."""
    kept = _kinds(search.chosen.effects)
    return [kind for kind in ask.kinds if kind.name not in kept]


def _more_by_columns(
    ask: GoalsQuestion, decider: Decider, search: SearchResult, base: Binding
) -> tuple[Decider, SearchResult] | None:
    """The search with what columns propose beside what it chose and simulations bear out; None
    where that is nothing. Beside nothing columns were asked before.
    """
    kept = _kinds(search.chosen.effects)
    if not kept:
        return None
    theta = _carried(search.chosen.theta, decider.bench.binding.layout, base)
    study = LedStudy(without_steps(base), _others(ask, search), begin=theta)
    linearised = LinearisedSearch(study, theta, ask.max_effects - len(kept))
    proposed = linearised.searched(Proposal((), (), theta))
    return _borne_out(ask, decider, search, base, proposed)


def _more_by_runs(
    ask: GoalsQuestion, decider: Decider, search: SearchResult, base: Binding
) -> tuple[Decider, SearchResult] | None:
    """The same of the effects that leave least beside what stands, by simulation."""
    if ask.progress:
        ask.progress("simulated", decider.done, decider.total, "every effect at one size")
    chosen, before, kinds = search.chosen, decider.bench.binding, _others(ask, search)
    every = [*_kinds(chosen.effects), *(kind.name for kind in kinds)]
    bench = ask.made(ask.known(every, before.inflation))
    problem, layout = chosen.path.problem, bench.binding.layout
    sets = effects_by_runs(
        bench=bench,
        plain=base,
        kinds=kinds,
        theta=_carried(chosen.theta, before.layout, bench.binding),
        free=[layout.index(before.layout.names[i]) for i in problem.free],
        starts=problem.starts(chosen.path.z),
    )
    bare = Proposal((), (), base.theta)
    proposed = ProposedSets(bare, tuple(sets), inflation=before.inflation)
    return _borne_out(ask, decider, search, base, proposed)


def _with_chosen(ask: GoalsQuestion, decider: Decider, search: SearchResult) -> Binding:
    """The model with what was chosen among its own free numbers; those of a reading are no forces
    along a motion, and stay.
    """
    base = ask.known(_kinds(search.chosen.effects))
    names = decider.bench.binding.layout.names
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
    if not proposed.sets:
        return None
    before = decider.bench.binding.layout
    kept = _kinds(search.chosen.effects)
    places = [(c.effect, c.location) for c in search.chosen.effects]
    bench = ask.made(ask.known([*kept, *kinds_of(proposed.sets)], proposed.inflation))
    wide = bench.binding
    wider = replace(
        decider,
        bench=bench,
        names=base.layout.names,
        slopes=None,
        total=decider.done + 2 + len(proposed.sets),
        sure={},
    )
    nominal = wider.refit((), _carried(search.nominal.theta, before, wide))
    standing = [_moved(c, before, wide.layout) for c in search.chosen.effects]
    stands = nominal
    if standing:
        theta = _carried(search.chosen.theta, before, wide)
        stands = wider.refit(standing, theta, nominal.path)
    tried = []
    for s in proposed.sets:
        own = [*standing, *candidates_of(bench, s)]
        tried.append(wider.refit(own, as_vector(wide, base.layout.names, s), stands.path))
    best = max(tried, key=lambda h: np.nan_to_num(wider.gained(stands, h), nan=-np.inf))
    if not wider.gained(stands, best) > 0:
        return None
    wider.compared(best, tried)
    chosen = wider.thinned(nominal, wider.reweighed(best), tried)
    found = [c for c in chosen.effects if c not in standing]
    rivals = wider.rivals(chosen, tried)
    if not found or not all(wider.claimed(c, rivals) for c in found):
        return None
    more = wider.certain(found)
    told = {place: p for place, p in wider.sure.items() if place not in places}
    belief = proposed.belief(more)
    belief = replace(belief, places=told | belief.places)
    alike = [*search.confusable, *proposed.instead(more), *rivals]
    wider_search = SearchResult(
        nominal=nominal,
        chosen=chosen,
        tried=[*search.tried, stands, *tried],
        confusable=list(dict.fromkeys(alike)),
        several=len(_kinds(chosen.effects)) > 1,
        belief=_believed(search.belief, belief).at_most(wider.sure),
    )
    return wider, wider_search


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
