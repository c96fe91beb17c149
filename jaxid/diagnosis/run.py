"""The diagnosis from beginning to end."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable

import jax
import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.interim import Interim
from jaxid.base.stopping import Interrupted
from jaxid.base.wording import times
from jaxid.conventions.play import read_twice
from jaxid.data.dataset import Dataset
from jaxid.data.time_stamps import scattered_stamps, with_scatter
from jaxid.diagnosis import how_far as shrinking, jitter as timing
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
from jaxid.diagnosis.claim import Judge
from jaxid.diagnosis.foreseen import long_free_runs, looked_at
from jaxid.diagnosis.goals.run import (
    begin_simulations,
    dear,
    diagnose_led,
    led,
    Offer,
    TOO_DEAR,
)
from jaxid.diagnosis.hypothesis import candidates, check_asked, possible, SearchResult
from jaxid.diagnosis.last_resort import asked_last, first_asked
from jaxid.diagnosis.next_experiment import advice, rivals_of
from jaxid.diagnosis.reasons import NotBelievable, Remark, Stopped
from jaxid.diagnosis.rest_before import asked_from_rest
from jaxid.diagnosis.result import Diagnosis, Which
from jaxid.diagnosis.search import Searcher
from jaxid.diagnosis.simulated import worth
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.no_name import with_law_of_no_name
from jaxid.diagnosis.torque.reference import ReferenceNumbers
from jaxid.diagnosis.torque.run import diagnose_by_torque
from jaxid.diagnosis.unseen import BlindSpots, BlindSpotSearch
from jaxid.diagnosis.verdict import check_followed, Diverged, standing_still
from jaxid.dynamics import catalogue
from jaxid.dynamics.effect import Effect
from jaxid.fitters import LevenbergMarquardt
from jaxid.fitting.assemble import assemble
from jaxid.fitting.fitter import Minimum, Progress
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.fitting.lost_runs import (
    AN_ARM,
    by_torque,
    by_windows,
    decays,
    DIVERGES,
    growth,
    SENSITIVE,
)
from jaxid.fitting.per_joint import per_joint, with_effects
from jaxid.fitting.problem_builder import default_residual, ProblemBuilder, start_values
from jaxid.fitting.result import EffectEstimate, Fit
from jaxid.problem.binding import bind, Binding, JITTER, resolve_model
from jaxid.problem.residual import InverseDynamics, MultipleShooting, OutputError, Residual
from jaxid.problem.trust import told, trusting
from jaxid.simulation.sample_buffers import STEP


#: Verdict by free runs that are not trusted -> verdicts by windows that take its place.
PREFERRED = {
    "unknown": ("none", "partly", "named"),
    "partly": ("named",),
    "named": ("unknown", "partly", "named"),
}


@dataclasses.dataclass(frozen=True)
class DiagnosisRequest:
    """What is asked of which data, by which residual."""

    binding: Binding
    residual: Residual
    allowed: tuple[str, ...]  # names of effects
    max_effects: int
    seed: int
    progress: Progress | None
    known: Interim  # is told what is known before the end
    still: tuple[
        str, ...
    ] = ()  # of "validation" and "report": what stands still, so that nothing can be judged on it
    search: Callable[[ProblemBuilder, Offer], tuple[Fit, SearchResult]] | None = (
        None  # another search than the one over all of the library
    )
    step: float = STEP  # of its simulations, s


#: Where the user asks for time stamps that scatter.
NOT_SCATTERED = (
    f"{JITTER}: neighbouring readings do not scatter with speed, so that the time stamps do not"
)


def run_diagnosis(
    model: object,
    dataset: Dataset,
    max_effects: int,
    effects: Iterable[str | Effect | type[Effect]] | None,
    without: Iterable[str],
    residual: Residual | None,
    seed: int,
    progress: Progress | None,
    reference: ReferenceNumbers | None = None,
) -> Diagnosis:
    """See `jaxid.diagnose`. On Ctrl-C `Interrupted` carries what is known."""
    asked = None if effects is None else tuple(catalogue.enrolled(e) for e in effects)
    known, without = Interim(), tuple(without)
    try:
        return _run(
            model=model,
            dataset=dataset,
            max_effects=max_effects,
            asked=asked,
            without=without,
            residual=residual,
            seed=seed,
            progress=progress,
            known=known,
            reference=reference,
        )
    except Interrupted:
        raise
    except Diverged as error:
        if residual is not None or not error.by_torque:
            raise
        torque = InverseDynamics()
        found = run_diagnosis(
            model=model,
            dataset=dataset,
            max_effects=max_effects,
            effects=asked,
            without=without,
            residual=torque,
            seed=seed,
            progress=progress,
            reference=reference,
        )
        return dataclasses.replace(found, notes=(*found.notes, error.note))
    except KeyboardInterrupt as stop:  # what is finished is a result too
        raise Interrupted(known.latest()) from stop


def begin_compiling(
    model: object,
    dataset: Dataset,
    effects: Iterable[str | Effect | type[Effect]] | None,
    without: tuple[str, ...],
) -> None:
    """Begins to compile what the diagnosis of a recording under goals simulates first, while others
    look at the recording.
    """
    try:
        nominal = resolve_model(model, dataset, without)
        if not dataset.experiments or not led(nominal):
            return
        allowed = (
            first_asked() if effects is None else tuple(catalogue.enrolled(e) for e in effects)
        )
        binding = bind(
            model, looked_at(nominal, dataset, possible(nominal, allowed, "")), without=without
        )
    except UsageError:  # is said by who needs it
        return
    if not dear(binding):
        begin_simulations(binding)


def _run(
    model: object,
    dataset: Dataset,
    max_effects: int,
    asked: tuple[str, ...] | None,
    without: tuple[str, ...],
    residual: Residual | None,
    seed: int,
    progress: Progress | None,
    known: Interim,
    reference: ReferenceNumbers | None,
) -> Diagnosis:
    began = time.perf_counter()
    allowed = first_asked() if asked is None else asked
    nominal = resolve_model(model, dataset, without)
    if reference is not None:
        residual, dataset = reference.taken(residual, nominal, dataset, goals=led(nominal))
    check_asked(nominal, asked or (), residual.name if residual else "")
    library = possible(nominal, allowed, residual.name if residual else "")
    asked_for = residual.name if residual else ""
    too_long = long_free_runs(nominal, dataset, library, asked_for)
    dataset = looked_at(nominal, dataset, library, asked_for)
    if too_long:
        plain = bind(model, dataset, without=without)
        by_motion = possible(nominal, allowed, InverseDynamics.name)
        found = diagnose_by_torque(plain, by_motion, max_effects, None, seed, reference, progress)
        return dataclasses.replace(found, notes=(*found.notes, too_long))
    if residual is None and led(nominal) and dataset.experiments:
        plain = bind(model, dataset, without=without)

        def answer(wide, names, search, step):
            return _diagnosed(
                DiagnosisRequest(
                    binding=wide,
                    residual=OutputError(),
                    allowed=tuple(names),
                    max_effects=max_effects,
                    seed=seed,
                    progress=progress,
                    known=known,
                    still=(),
                    search=search,
                    step=step,
                )
            )[0]

        if dear(plain):
            by_torque = possible(nominal, allowed, InverseDynamics.name)
            found = diagnose_by_torque(
                plain, by_torque, max_effects, None, seed, reference, progress
            )
            return dataclasses.replace(found, notes=(*found.notes, TOO_DEAR))
        if not standing_still(plain):
            return diagnose_led(
                model=model,
                dataset=dataset,
                binding=plain,
                without=without,
                library=library,
                max_effects=max_effects,
                seed=seed,
                progress=progress,
                answer=answer,
            )
    binding = bind(
        model,
        dataset,
        without=without,
        candidates=() if isinstance(residual, InverseDynamics) else library,
    )
    if not binding.dataset.experiments:
        raise UsageError(
            "a diagnosis needs recorded runs; this dataset holds frequency responses alone: fit it"
        )
    if isinstance(residual, InverseDynamics):
        return diagnose_by_torque(
            binding, library, max_effects, residual.cutoff_hz, seed, reference, progress
        )
    binding = trusting(binding)
    own = residual or default_residual(binding)
    still = standing_still(binding)
    stamps, others = {}, tuple(n for n in allowed if n != JITTER)
    if any(k.name == JITTER for k in library):
        names = binding.chain.signature.output_names
        stamps = {
            c: s for c, s in scattered_stamps(binding.dataset, binding.noise).items() if c in names
        }
    if stamps and not still:
        scatter = timing.Scatter(stamps, binding)
        readings = with_scatter(dataset, stamps, binding.noise)
        stamped = bind(model, readings, without=without, candidates=library).with_stamps(stamps)
        found, _ = _diagnosed(
            DiagnosisRequest(trusting(stamped), own, others, max_effects, seed, progress, known),
            scatter,
        )
        if found.which.verdict == "named":
            return dataclasses.replace(found, wall_time_s=time.perf_counter() - began)
    # Stamps that scatter are noise, which neighbouring readings show or refute: no fit may take
    # something smooth for it.
    question = DiagnosisRequest(
        binding=binding,
        residual=own,
        allowed=allowed if stamps else others,
        max_effects=max_effects,
        seed=seed,
        progress=progress,
        known=known,
        still=still,
    )
    found, grown = _diagnosed(question)
    verdict = found.which.verdict
    doubtful = verdict in ("unknown", "partly") or (
        verdict == "named" and found.how_far.gap_after > LIMITS.remainder
    )
    long_decay = residual is None and doubtful and by_windows(binding) and decays(binding)
    if residual is None and (grown > SENSITIVE or long_decay) and doubtful and not still:
        known.tell(found)
        try:
            again, _ = _diagnosed(
                dataclasses.replace(
                    question, residual=MultipleShooting(), known=Interim(silent=True)
                )
            )
        except Interrupted as stop:
            raise Interrupted(found) from stop
        if again.which.verdict in PREFERRED[verdict]:
            why = f"a difference at the start of a run grows {grown:.2g} times within it"
            why = (
                why if grown > SENSITIVE else "the runs are free swings through several amplitudes"
            )
            left = times(found.how_far.gap_after)
            note = (
                f"{why}, and by free runs the answer was {verdict} with {left} times the noise"
                " left: models are compared over windows, each with its own start"
            )
            found = dataclasses.replace(again, notes=(*again.notes, note))

    def ask(names: tuple[str, ...], data: Dataset = dataset) -> Diagnosis:
        wider = trusting(bind(model, data, without=without, candidates=possible(nominal, names)))
        return _diagnosed(
            dataclasses.replace(question, binding=wider, allowed=names, known=Interim(silent=True))
        )[0]

    if asked is None and not still:
        found = asked_last(found, nominal, own.name, ask)
    if not still and own.free_run:
        found = asked_from_rest(found, binding.dataset, others, ask)
    if not still:
        visible = possible(nominal, allowed, InverseDynamics.name)
        plain = bind(model, dataset, without=without)
        found = with_law_of_no_name(found, plain, visible, max_effects)
    unseen = asked is not None and JITTER in asked and not stamps
    notes = (
        *found.notes,
        *(s.text for s in stamps.values()),
        *((NOT_SCATTERED,) if unseen else ()),
    )
    return dataclasses.replace(found, notes=notes, wall_time_s=time.perf_counter() - began)


def _diagnosed(
    question: DiagnosisRequest, scatter: timing.Scatter | None = None
) -> tuple[Diagnosis, float]:
    """The answer; and how much a difference at the start of a run grows within it. `scatter`: what
    the time stamps do.
    """
    began = time.perf_counter()
    question = dataclasses.replace(
        question, binding=question.binding.by_windows(question.residual.window)
    )
    binding, residual, seed, progress = (
        question.binding,
        question.residual,
        question.seed,
        question.progress,
    )
    if progress:
        progress("nominal fit", 0, 1, binding.chain.mechanism.name)

    if question.search is None:
        bench, nominal_fit, search, compile_time = _search(question)
    else:
        bench = ProblemBuilder(binding, question.step, differences=1, together=True)
        bench.compile_ahead(
            InverseDynamics(decimate=1), binding.theta, binding.free
        )  # what WHERE asks in the end

        def keep(fit, now):
            return question.known.offer(lambda: _so_far(question, bench, fit(), now, began))

        (nominal_fit, search), compile_time = question.search(bench, keep), bench.compile_time()
        binding = bench.binding
    if progress:
        progress("how far", 0, 1, "report data")
    judge = Judge(bench, residual, search, question.still, scatter)
    claim, nominal = judge.claim(), judge.nominal
    verdict, named, final, how_far = claim.verdict, claim.named, claim.final, claim.how_far
    estimates = effect_estimates(binding, final, named)

    def assembled():
        return fit_of(bench, final, residual, seed, compile_time, time.perf_counter() - began)

    final_fit = assembled() if named or question.search is None else nominal_fit
    doubtful = verdict.claims and question.search is None
    against = doubts(estimates, final_fit.covariance) if doubtful else {}
    if against:
        verdict = verdict if len(against) < len(estimates) else verdict.unclaimed()
        verdict = verdict.but("partly", NotBelievable(tuple(dict.fromkeys(against.values()))))
    if search.stands is not None:
        by_joint = per_joint(bench, nominal_fit.scores, before=search.stands.theta)
        nominal_fit = dataclasses.replace(nominal_fit, per_joint=by_joint)
    how_far = dataclasses.replace(
        how_far, per_joint=with_effects(nominal_fit.per_joint, final_fit.per_joint)
    )
    findings, pictures, rows = where_it_lies(
        bench,
        search.stands if named and search.stands else nominal,
        final,
        verdict.name,
        estimates,
        seed,
    )
    ranking = (
        *(scatter.ranked(bench, residual, search.nominal) if scatter else ()),
        *ranked(search),
    )
    looked, pair, stopped = BlindSpots(), search.rivals, None
    if verdict.name in ("none", "unknown") and not question.still:
        pool = candidates(bench, question.allowed) if verdict.name == "none" else []
        try:
            settled = None if search.settled is None else search.settled[0].path
            looked = BlindSpotSearch(bench, residual, search.nominal, settled).look(
                [c for c in pool if c.effect != JITTER]
            )
        except KeyboardInterrupt as stop:
            stopped, verdict = stop, verdict.because(Stopped())
        verdict = verdict.because(*map(Remark, looked.signs))
    if verdict.name == "none":
        pair = (search.nominal, looked.rival) if looked.rival else None
    rivals = None if pair is None else rivals_of(bench, pair)
    mates = search.confusable if named else []
    confusable = tuple(EffectEstimate(c.effect, c.location) for c in mates)
    claimed, belief = estimates if named else (), search.believed(bool(named))
    belief = belief or Belief({}, worth=worth([search.nominal, *search.tried], search.chosen))
    which = Which(verdict.name, claimed, confusable, ranking, verdict.text, against, belief)
    advised = advice(
        verdict=verdict.name,
        named=[c.effect for c in named],
        mates=[c.effect for c in mates],
        rivals=rivals,
        unseen=looked.unseen,
        repeated=judge.repeated,
        still=question.still,
        read_twice=read_twice(binding.dataset),
    )
    found = Diagnosis(
        model=binding.chain.mechanism.name,
        dataset=binding.dataset.name,
        dataset_sha256=binding.dataset.sha256,
        seed=seed,
        residual=residual.name,
        where=findings,
        which=which,
        how_far=how_far,
        next_experiment=advised,
        wall_time_s=time.perf_counter() - began,
        nominal=nominal_fit,
        final=final_fit,
        traces=traces(bench, residual, nominal, final, named),
        missing_force=pictures,
        regimes=rows,
        notes=(*binding.dataset.notes, *notes_of(binding, final_fit, compile_time)),
        unseen=looked.unseen,
        rivals=rivals,
        trust=told(binding),
        accuracy=binding.dataset.accuracy,
    )
    if stopped:
        raise Interrupted(found) from stopped
    return found, growth(bench, nominal.theta) if residual.free_run else 0.0


def _search(question: DiagnosisRequest) -> tuple[ProblemBuilder, Fit, SearchResult, float]:
    """Nominal fit and search, and the bench whose steps no longer matter."""
    began = time.perf_counter()
    binding, residual, seed, progress = (
        question.binding,
        question.residual,
        question.seed,
        question.progress,
    )
    bench = ProblemBuilder(
        binding, differences=1
    )  # hundreds of models, each simulated a few times: tangents would compile longer
    (engine := bench.runs(residual, "fit").engine).compile_ahead(
        "outputs", binding.theta, binding.free
    )
    guesses = start_values(bench, binding.free, seed)
    engine.read_ahead()  # while the nominal model is fitted
    problem = bench.problem(residual, "fit", binding.free, guesses[0])
    fitter = LevenbergMarquardt()
    nominal, log = fitter.path(
        problem, [problem.z(g) for g in guesses], jax.random.key(seed), progress
    )
    if not np.isfinite(nominal.cost):
        raise Diverged(
            "the nominal model cannot be fitted: the simulation diverges at every candidate; give"
            " other start values or bounds",
            by_torque(binding),
            DIVERGES,
        )
    if (
        residual.free_run
        and not nominal.converged
        and by_torque(binding)
        and binding.chain.nq >= AN_ARM
    ):
        check_followed(bench, problem.theta(nominal.z), problem.starts(nominal.z))
    converged, stopped = nominal.converged, nominal.stopped
    nominal = levenberg_marquardt([(problem, nominal.z)], 3, 1e-9)[0]

    def minimum(z: np.ndarray, loss: float) -> Minimum:
        return Minimum(z, loss, converged, stopped, log.evaluations, log.history)

    def first() -> Fit:
        spent = time.perf_counter() - began
        return assemble(
            bench=bench,
            problem=problem,
            result=minimum(nominal.z, nominal.loss),
            residual=residual,
            fitter=fitter.name,
            seed=seed,
            compile_time=0.0,
            wall_time=spent,
        )

    searcher = Searcher(bench, residual, nominal, progress)

    def offer(search):
        return question.known.offer(lambda: _so_far(question, bench, first(), search, began))

    offer(SearchResult(searcher.nominal, searcher.nominal))
    blind = "validation" in question.still  # nothing to choose by
    pool = [] if blind else candidates(bench, question.allowed)
    search = searcher.run(pool, 0 if blind else question.max_effects, offer)
    bench = searcher.bench
    compile_time = sum(b.compile_time() for b in (*searcher.benches, bench))
    path = search.nominal.path
    spent = time.perf_counter() - began
    found = minimum(path.z, search.nominal.fit_loss)
    return (
        bench,
        assemble(
            bench=bench,
            problem=path.problem,
            result=found,
            residual=residual,
            fitter=fitter.name,
            seed=seed,
            compile_time=compile_time,
            wall_time=spent,
        ),
        search,
        compile_time,
    )


def _so_far(
    question: DiagnosisRequest,
    bench: ProblemBuilder,
    nominal: Fit,
    search: SearchResult,
    began: float,
) -> Diagnosis:
    """What is known while effects are still compared: where the gap lies and how wide it is;
    nothing is claimed yet.
    """
    binding, residual = question.binding, question.residual
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
        bench, search.nominal, search.nominal, "unknown", (), question.seed
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
        seed=question.seed,
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
