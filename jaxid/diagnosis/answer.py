"""One search answered: what it found, judged by all data, with its numbers and pictures."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from jaxid.base.stopping import Interrupted
from jaxid.conventions.play import read_twice
from jaxid.diagnosis import how_far as shrinking
from jaxid.diagnosis.account import (
    effect_estimates,
    fit_of,
    notes_of,
    ranked,
    traces,
    where_it_lies,
)
from jaxid.diagnosis.belief import Belief
from jaxid.diagnosis.believable import doubts
from jaxid.diagnosis.claim import Claim, Judge
from jaxid.diagnosis.hypothesis import candidates, SearchResult
from jaxid.diagnosis.jitter import Scatter
from jaxid.diagnosis.library_search import search_library
from jaxid.diagnosis.next_experiment import advice, rivals_of
from jaxid.diagnosis.question import SearchOutcome, SearchRequest
from jaxid.diagnosis.reasons import NotBelievable, Remark, Stopped
from jaxid.diagnosis.result import Diagnosis, Which
from jaxid.diagnosis.simulated import worth
from jaxid.diagnosis.unseen import BlindSpots, BlindSpotSearch
from jaxid.diagnosis.verdict import Verdict
from jaxid.fitting.lost_runs import growth
from jaxid.fitting.per_joint import per_joint, with_effects
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.result import EffectEstimate, Fit
from jaxid.problem.binding import JITTER
from jaxid.problem.residual import InverseDynamics
from jaxid.problem.trust import told


@dataclass(frozen=True)
class Answered:
    """A diagnosis, the search that it tells of, and what that was asked."""

    diagnosis: Diagnosis
    searched: SearchOutcome
    request: SearchRequest

    def growth(self) -> float:
        """How much a difference at the start of a run grows within it; 0 where no run is simulated
        freely.
        """
        if not self.request.residual.free_run:
            return 0.0
        nominal = self.searched.search.settled or (self.searched.search.nominal,)
        return growth(self.searched.bench, nominal[0].theta)


def answered(request: SearchRequest, scatter: Scatter | None = None) -> Answered:
    """Searches, and judges what was found. `scatter`: what the time stamps do. On Ctrl-C after the
    search `Interrupted` carries the answer without what was left to do.
    """
    began, asked = time.perf_counter(), request
    binding = request.binding.by_windows(request.residual.window)
    request = replace(request, binding=binding)
    request.say("nominal fit", binding.chain.mechanism.name)
    searched = _searched(request, began)
    request.say("how far", "report data")
    bench, search = searched.bench, searched.search
    judge = Judge(bench, request.residual, search, request.still, scatter)
    claim, nominal = judge.claim(), judge.nominal
    named, final = claim.named, claim.final
    estimates = effect_estimates(bench.binding, final, named)
    nominal_fit, final_fit = _fits(request, searched, claim, began)
    verdict, against = _believed(request, claim.verdict, estimates, final_fit)
    how_far = replace(
        claim.how_far, per_joint=with_effects(nominal_fit.per_joint, final_fit.per_joint)
    )
    stated = search.stands if named and search.stands else nominal
    findings, pictures, rows = where_it_lies(
        bench, stated, final, verdict.name, estimates, request.question.seed
    )
    ranking = ranked(search)
    if scatter:
        ranking = [*scatter.ranked(bench, request.residual, search.nominal), *ranking]
    verdict, looked, stopped = _blind_spots(request, searched, verdict)
    pair = search.rivals
    if verdict.name == "none":
        pair = (search.nominal, looked.rival) if looked.rival else None
    rivals = None if pair is None else rivals_of(bench, pair)
    mates = search.confusable if named else []
    belief = search.believed(bool(named))
    if belief is None:
        belief = Belief({}, worth=worth([search.nominal, *search.tried], search.chosen))
    which = Which(
        verdict=verdict.name,
        effects=estimates if named else (),
        confusable_with=tuple(EffectEstimate(c.effect, c.location) for c in mates),
        ranking=tuple(ranking),
        text=verdict.text,
        doubts=against,
        belief=belief,
    )
    advised = advice(
        verdict=verdict.name,
        named=[c.effect for c in named],
        mates=[c.effect for c in mates],
        rivals=rivals,
        unseen=looked.unseen,
        repeated=judge.repeated,
        still=request.still,
        read_twice=read_twice(bench.binding.dataset),
    )
    dataset = bench.binding.dataset
    found = Diagnosis(
        model=bench.binding.chain.mechanism.name,
        dataset=dataset.name,
        dataset_sha256=dataset.sha256,
        seed=request.question.seed,
        residual=request.residual.name,
        where=findings,
        which=which,
        how_far=how_far,
        next_experiment=advised,
        wall_time_s=time.perf_counter() - began,
        nominal=nominal_fit,
        final=final_fit,
        traces=traces(bench, request.residual, nominal, final, named),
        missing_force=pictures,
        regimes=rows,
        notes=(*dataset.notes, *notes_of(bench.binding, final_fit, searched.compile_time)),
        unseen=looked.unseen,
        rivals=rivals,
        trust=told(bench.binding),
        accuracy=dataset.accuracy,
    )
    if stopped:
        raise Interrupted(found) from stopped
    return Answered(found, searched, asked)


def _searched(request: SearchRequest, began: float) -> SearchOutcome:
    """By the request's own search, or by the one over all of the library."""
    known = request.question.known
    if request.search is None:

        def offer(bench: ProblemBuilder, nominal: Fit, search: SearchResult) -> Diagnosis:
            return so_far(request, bench, nominal, search, began)

        return SearchOutcome(*search_library(request, offer))
    bench = ProblemBuilder(request.binding, request.step, differences=1, together=True)
    # What WHERE asks in the end is compiled while the search goes on.
    bench.compile_ahead(InverseDynamics(decimate=1), request.binding.theta, request.binding.free)

    def keep(fit, now):
        known.offer(lambda: so_far(request, bench, fit(), now, began))

    return request.search(bench, keep)


def _fits(
    request: SearchRequest, searched: SearchOutcome, claim: Claim, began: float
) -> tuple[Fit, Fit]:
    """The nominal model and the final one, with the torque errors of each joint."""
    bench, search, nominal_fit = searched.bench, searched.search, searched.nominal_fit
    final_fit = nominal_fit
    if claim.named or request.search is None:
        final_fit = fit_of(
            bench=bench,
            h=claim.final,
            residual=request.residual,
            seed=request.question.seed,
            compile_time=searched.compile_time,
            wall_time=time.perf_counter() - began,
        )
    if search.stands is not None:
        by_joint = per_joint(bench, nominal_fit.scores, before=search.stands.theta)
        nominal_fit = replace(nominal_fit, per_joint=by_joint)
    return nominal_fit, final_fit


def _believed(
    request: SearchRequest,
    verdict: Verdict,
    estimates: Sequence[EffectEstimate],
    final_fit: Fit,
) -> tuple[Verdict, dict[str, str]]:
    """The verdict without what is said against the size of an effect; and that, by effect."""
    if not verdict.claims or request.search is not None:
        return verdict, {}
    against = doubts(estimates, final_fit.covariance)
    if not against:
        return verdict, {}
    if len(against) == len(estimates):
        verdict = verdict.unclaimed()
    reasons = tuple(dict.fromkeys(against.values()))
    return verdict.but("partly", NotBelievable(reasons)), against


def _blind_spots(
    request: SearchRequest, searched: SearchOutcome, verdict: Verdict
) -> tuple[Verdict, BlindSpots, KeyboardInterrupt | None]:
    """What the recordings would not show where nothing is named, the verdict with the signs of it,
    and the interruption of that.
    """
    if verdict.name not in ("none", "unknown") or request.still:
        return verdict, BlindSpots(), None
    bench, search = searched.bench, searched.search
    pool = candidates(bench, request.allowed) if verdict.name == "none" else []
    settled = None if search.settled is None else search.settled[0].path
    looking = BlindSpotSearch(bench, request.residual, search.nominal, settled)
    try:
        looked = looking.look([c for c in pool if c.effect != JITTER])
    except KeyboardInterrupt as stop:
        return verdict.because(Stopped()), BlindSpots(), stop
    return verdict.because(*map(Remark, looked.signs)), looked, None


def so_far(
    request: SearchRequest,
    bench: ProblemBuilder,
    nominal: Fit,
    search: SearchResult,
    began: float,
) -> Diagnosis:
    """What is known while effects are still compared: where the gap lies and how wide it is;
    nothing is claimed yet.
    """
    binding, residual, seed = request.binding, request.residual, request.question.seed
    before, note = shrinking.model_before(binding, search.nominal.theta)
    how_far = shrinking.measure(
        bench=bench,
        residual=residual,
        before=before,
        retuned=search.nominal.theta,
        after=search.nominal.theta,
        verdict="unknown",
        note=note,
        alike=bench,
    )
    findings, pictures, rows = where_it_lies(
        bench, search.nominal, search.nominal, "unknown", (), seed
    )
    ranking = tuple(ranked(search))
    text = (
        f"Stopped before the effects of the library were compared: {len(ranking) or 'none'} had"
        " been."
    )
    return Diagnosis(
        model=binding.chain.mechanism.name,
        dataset=binding.dataset.name,
        dataset_sha256=binding.dataset.sha256,
        seed=seed,
        residual=residual.name,
        where=findings,
        which=Which("unknown", (), (), ranking, text),
        how_far=how_far,
        next_experiment="Let the diagnosis run to its end.",
        wall_time_s=time.perf_counter() - began,
        nominal=nominal,
        final=nominal,
        traces=traces(bench, residual, search.nominal, search.nominal, ()),
        missing_force=pictures,
        regimes=rows,
        notes=binding.dataset.notes,
    )
