"""The diagnosis from beginning to end: which way answers a question."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from jaxid.base.errors import UsageError
from jaxid.base.interim import Interim
from jaxid.base.stopping import Interrupted
from jaxid.data.dataset import Dataset
from jaxid.diagnosis.answer import answered
from jaxid.diagnosis.foreseen import long_free_runs, looked_at
from jaxid.diagnosis.free_runs import diagnose_by_free_runs
from jaxid.diagnosis.goals.run import begin_simulations, dear, diagnose_led, led, TOO_DEAR
from jaxid.diagnosis.hypothesis import possible
from jaxid.diagnosis.last_resort import first_asked
from jaxid.diagnosis.question import DiagnosisQuestion, Search, SearchRequest
from jaxid.diagnosis.result import Diagnosis
from jaxid.diagnosis.torque.reference import ReferenceNumbers
from jaxid.diagnosis.torque.run import diagnose_by_torque
from jaxid.diagnosis.verdict import Diverged, standing_still
from jaxid.dynamics import catalogue
from jaxid.dynamics.effect import Effect
from jaxid.fitting.fitter import Progress
from jaxid.problem.binding import bind, Binding, resolve_model
from jaxid.problem.residual import InverseDynamics, OutputError, Residual


TOUCHES = (
    "[model] contacts = true: a diagnosis simulates contacts where goals drive every joint through"
    " a law, and compares the runs themselves. Here leave contacts out of [model]: a diagnosis then"
    " looks at the parts of the runs in which nothing touches"
)

NO_RUNS = "a diagnosis needs recorded runs; this dataset holds frequency responses alone: fit it"


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
    asked = None if effects is None else tuple(map(catalogue.enrolled, effects))
    known, without = Interim(), tuple(without)

    def question(by: Residual | None) -> DiagnosisQuestion:
        return _question(
            model=model,
            dataset=dataset,
            without=without,
            asked=asked,
            residual=by,
            max_effects=max_effects,
            seed=seed,
            progress=progress,
            known=known,
            reference=reference,
        )

    try:
        try:
            return _answered(question(residual))
        except Diverged as error:
            if residual is not None or not error.by_torque:
                raise
            found = _answered(question(InverseDynamics()))
            return _noted(found, error.note)
    except Interrupted:
        raise
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
        allowed = first_asked()
        if effects is not None:
            allowed = tuple(map(catalogue.enrolled, effects))
        read = looked_at(nominal, dataset, possible(nominal, allowed, ""))
        binding = bind(model, read, without=without)
    except UsageError:  # is said by who needs it
        return
    if not dear(binding):
        begin_simulations(binding)


def _question(
    model: object,
    dataset: Dataset,
    without: tuple[str, ...],
    asked: tuple[str, ...] | None,
    residual: Residual | None,
    max_effects: int,
    seed: int,
    progress: Progress | None,
    known: Interim,
    reference: ReferenceNumbers | None,
) -> DiagnosisQuestion:
    nominal = resolve_model(model, dataset, without)
    if reference is not None:
        residual, dataset = reference.taken(residual, nominal, dataset, goals=led(nominal))
    question = DiagnosisQuestion(
        model=model,
        nominal=nominal,
        dataset=dataset,
        without=without,
        asked=asked,
        residual=residual,
        max_effects=max_effects,
        seed=seed,
        progress=progress,
        known=known,
        reference=reference,
    )
    question.check()
    return question


def _answered(question: DiagnosisQuestion) -> Diagnosis:
    """By the first way that can answer; where that is not the usual one, it says why."""
    nominal, library = question.nominal, question.library()
    by = question.residual_name
    too_long = long_free_runs(nominal, question.dataset, library, by)
    question = replace(question, dataset=looked_at(nominal, question.dataset, library, by))
    if not question.dataset.experiments:
        raise UsageError(NO_RUNS)
    touches = nominal.mechanism.touches
    if touches and (question.residual is not None or not led(nominal)):
        raise UsageError(TOUCHES)
    if isinstance(question.residual, InverseDynamics):
        return _by_torque(question, question.bound(), question.residual.cutoff_hz)
    if too_long and not touches:
        return _noted(_by_torque(question, question.bound()), too_long)
    if led(nominal) and question.residual is None:
        plain = question.bound()
        if dear(plain) and not touches:
            return _noted(_by_torque(question, plain), TOO_DEAR)
        if not standing_still(plain):
            return _under_goals(question, plain)
    return diagnose_by_free_runs(question)


def _by_torque(
    question: DiagnosisQuestion, plain: Binding, cutoff_hz: float | None = None
) -> Diagnosis:
    """By the torque that the measured motion of a binding without candidates needs."""
    return diagnose_by_torque(
        binding=plain,
        kinds=question.library(InverseDynamics.name),
        max_effects=question.max_effects,
        cutoff_hz=cutoff_hz,
        seed=question.seed,
        reference=question.reference,
        progress=question.progress,
    )


def _under_goals(question: DiagnosisQuestion, plain: Binding) -> Diagnosis:
    """By simulations under the law that goals drive a robot through."""

    def answer(wide: Binding, names: Sequence[str], search: Search, step: float) -> Diagnosis:
        request = SearchRequest(
            question=question,
            binding=wide,
            residual=OutputError(),
            allowed=tuple(names),
            search=search,
            step=step,
        )
        return answered(request).diagnosis

    return diagnose_led(
        model=question.model,
        dataset=question.dataset,
        binding=plain,
        without=question.without,
        library=question.library(),
        max_effects=question.max_effects,
        seed=question.seed,
        progress=question.progress,
        answer=answer,
    )


def _noted(found: Diagnosis, note: str) -> Diagnosis:
    return replace(found, notes=(*found.notes, note))
