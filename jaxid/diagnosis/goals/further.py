"""What is still missing beside what simulations bore out.

First order about a model that lacks something large says little of what is smaller. Where the model
with what was found is not at the noise, effects are asked once more, to first order about its own
free run, as a step of Gauss and Newton is taken again where it led. Where joints turn about under
dry friction, columns along a motion may leave more than all that is missing. What they do not show
is asked by simulating every effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxid.diagnosis.belief import Belief, joined_beliefs
from jaxid.diagnosis.goals.asked import GoalsQuestion
from jaxid.diagnosis.goals.compared import ComparedSets, places_of
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
from jaxid.diagnosis.hypothesis import Candidate, Hypothesis, SearchResult
from jaxid.dynamics.catalogue import effect_class
from jaxid.dynamics.effect import OutputEffect
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.problem.binding import Binding


@dataclass(frozen=True)
class _Further:
    """What asking beside what stands told: a search, and the decider whose simulations it is of;
    whether more was borne out.
    """

    decider: Decider
    search: SearchResult
    found: bool = False


def with_what_is_still_missing(
    ask: GoalsQuestion, decider: Decider, search: SearchResult
) -> tuple[Decider, SearchResult]:
    """The search with further effects beside those chosen, until the noise is reached, nothing more
    is borne out or as many effects stand as may; and the decider whose simulations it is of. Among
    columns laws of no name compete, among simulations none: what the latter alone have proposed
    stands where it leads to the noise.
    """
    last = surely = _Further(decider, search)
    by_columns = True
    while _leaves_more(ask, last):
        asked = _more_by_columns(ask, last)
        if not asked.found and _leaves_more(ask, asked):
            asked = _more_by_runs(ask, asked)
            by_columns = by_columns and not asked.found
        last = asked
        if by_columns:
            surely = last
        if not last.found:
            break
    end = last if last.search.chosen.at_noise else surely
    return end.decider, end.search


def _leaves_more(ask: GoalsQuestion, so_far: _Further) -> bool:
    if so_far.search.chosen.at_noise:
        return False
    return len(_kinds(so_far.search.chosen.effects)) < ask.max_effects


def _kinds(effects: Sequence[Candidate]) -> list[str]:
    return list(dict.fromkeys(c.effect for c in effects))


def _more_by_columns(ask: GoalsQuestion, so_far: _Further) -> _Further:
    """What columns propose beside what was chosen and simulations bear out. Beside nothing columns
    were asked before.
    """
    decider, search = so_far.decider, so_far.search
    kept = _kinds(search.chosen.effects)
    if not kept:
        return replace(so_far, found=False)
    base = _with_chosen(ask, decider, search)
    theta = _carried(search.chosen.theta, decider.bench.binding.layout, base)
    standing = places_of(search.chosen.effects)
    study = LedStudy(without_steps(base), ask.kinds, begin=theta, standing=standing)
    linearised = LinearisedSearch(study, theta, ask.max_effects - len(kept))
    proposed = linearised.searched(Proposal((), (), theta))
    return _borne_out(ask, so_far, base, proposed)


def _more_by_runs(ask: GoalsQuestion, so_far: _Further) -> _Further:
    """The same of the effects that leave least beside what stands, by simulation."""
    decider, search = so_far.decider, so_far.search
    if ask.progress:
        ask.progress("simulated", decider.done, decider.total, "every effect at one size")
    base = _with_chosen(ask, decider, search)
    chosen, before = search.chosen, decider.bench.binding
    every = [*_kinds(chosen.effects), *(kind.name for kind in ask.kinds)]
    bench = ask.made(ask.known(every, before.inflation))
    problem, layout = chosen.path.problem, bench.binding.layout
    sets = effects_by_runs(
        bench=bench,
        plain=base,
        kinds=ask.kinds,
        theta=_carried(chosen.theta, before.layout, bench.binding),
        free=[layout.index(before.layout.names[i]) for i in problem.free],
        starts=problem.starts(chosen.path.z),
        standing=places_of(chosen.effects),
    )
    bare = Proposal((), (), base.theta)
    proposed = ProposedSets(bare, tuple(sets), inflation=before.inflation)
    return _borne_out(ask, so_far, base, proposed)


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
    ask: GoalsQuestion, so_far: _Further, base: Binding, proposed: ProposedSets
) -> _Further:
    """What simulations bear out of the sets that were proposed beside what stands."""
    decider, search = so_far.decider, so_far.search
    if not proposed.sets:
        return _nothing(so_far, proposed, {})
    before = decider.bench.binding.layout
    kept = _kinds(search.chosen.effects)
    bench = ask.made(ask.known([*kept, *kinds_of(proposed.sets)], proposed.inflation))
    wide = bench.binding
    wider = replace(
        decider,
        bench=bench,
        names=base.layout.names,
        total=decider.done + 2 + len(proposed.sets),
        sure={},
        compared=ComparedSets(),
    )
    nominal = wider.refit((), _carried(search.nominal.theta, before, wide))
    standing = [_moved(c, before, wide.layout) for c in search.chosen.effects]
    stands = nominal
    if standing:
        theta = _carried(search.chosen.theta, before, wide)
        stands = wider.refit(standing, theta, nominal)
    tried = []
    for s in proposed.sets:
        own = [*standing, *candidates_of(bench, s)]
        tried.append(wider.refit(own, as_vector(wide, base.layout.names, s), stands))
    best = wider.best_of(stands, tried)
    if best is stands:
        return _as_it_stands(so_far, wider, nominal, stands, proposed)
    nominal, chosen = wider.confirmed(nominal, best, tried)
    found = [c for c in chosen.effects if c not in standing]
    rivals = wider.rivals(chosen, tried)
    if not found or not all(wider.compared.claimed(c, rivals) for c in found):
        return _nothing(so_far, proposed, wider.sure)
    more = wider.certain(found)
    belief = wider.compared.with_families(proposed.belief(more), found, rivals)
    belief = replace(belief, places=_by_simulation(search, wider.sure) | belief.places)
    alike = [*search.confusable, *proposed.instead(more), *rivals]
    wider_search = SearchResult(
        nominal=nominal,
        chosen=chosen,
        tried=[*search.tried, stands, *tried],
        confusable=list(dict.fromkeys(alike)),
        several=len(_kinds(chosen.effects)) > 1,
        belief=_believed(search, belief).at_most(wider.sure),
    )
    return _Further(wider, wider_search, found=True)


def _as_it_stands(
    so_far: _Further,
    wider: Decider,
    nominal: Hypothesis,
    stands: Hypothesis,
    proposed: ProposedSets,
) -> _Further:
    """Where nothing beside what stands is better than that: its descent went on, and may have come
    to the noise.
    """
    asked = _nothing(so_far, proposed, wider.sure)
    if not stands.at_noise:
        return asked
    wider.sure |= so_far.decider.certain(stands.effects)
    return replace(
        asked, decider=wider, search=replace(asked.search, nominal=nominal, chosen=stands)
    )


def _nothing(
    so_far: _Further, proposed: ProposedSets, sure: Mapping[tuple[str, str], float]
) -> _Further:
    """Where nothing more is borne out: `sure` is how probable simulations make what they asked."""
    search = so_far.search
    asked = proposed.weighed is not None or bool(proposed.sets)
    if search.belief is None or not asked:
        return replace(so_far, found=False)
    told = proposed.belief({})
    told = replace(told, places=_by_simulation(search, sure) | told.places).at_most(sure)
    belief = search.belief.asked_again(told, places_of(search.chosen.effects))
    return _Further(so_far.decider, replace(search, belief=belief))


def _by_simulation(
    search: SearchResult, sure: Mapping[tuple[str, str], float]
) -> dict[tuple[str, str], float]:
    """How probable simulations make what does not stand."""
    standing = places_of(search.chosen.effects)
    return {place: p for place, p in sure.items() if place not in standing}


def _believed(search: SearchResult, more: Belief) -> Belief:
    if search.belief is None:
        return more
    again = search.belief.asked_again(more, places_of(search.chosen.effects))
    joined = joined_beliefs([search.belief, more]) or more
    return replace(joined, places=again.places, free_law=again.free_law)


def _carried(theta: np.ndarray, layout: ParameterVector, into: Binding) -> np.ndarray:
    """Numbers of one layout in another one, those that it lacks as they are there."""
    out, own = into.theta.copy(), dict(zip(layout.names, theta, strict=True))
    for i, name in enumerate(into.layout.names):
        out[i] = own.get(name, out[i])
    return out


def _moved(c: Candidate, before: ParameterVector, after: ParameterVector) -> Candidate:
    """A candidate by its numbers' positions in another layout."""
    return replace(c, index=tuple(after.index(before.names[i]) for i in c.index))
