"""A recording answered by simulation: free runs, windows where these cannot be trusted, and what
is asked last.
"""

from __future__ import annotations

import time
from dataclasses import replace

from jaxid.base.stopping import Interrupted
from jaxid.base.wording import times
from jaxid.data.dataset import Dataset
from jaxid.data.time_stamps import scattered_stamps, Stamps, with_scatter
from jaxid.diagnosis.answer import Answered, answered
from jaxid.diagnosis.hypothesis import possible
from jaxid.diagnosis.jitter import Scatter
from jaxid.diagnosis.last_resort import asked_last
from jaxid.diagnosis.question import DiagnosisQuestion, SearchRequest
from jaxid.diagnosis.rest_before import asked_from_rest
from jaxid.diagnosis.result import Diagnosis
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.no_name import with_law_of_no_name
from jaxid.diagnosis.verdict import standing_still
from jaxid.fitting.lost_runs import by_windows, decays, SENSITIVE
from jaxid.fitting.problem_builder import default_residual
from jaxid.problem.binding import Binding, JITTER
from jaxid.problem.residual import InverseDynamics, MultipleShooting
from jaxid.problem.trust import trusting


#: Verdict by free runs that are not trusted -> verdicts by windows that take its place.
PREFERRED = {
    "unknown": ("none", "partly", "named"),
    "partly": ("named",),
    "named": ("unknown", "partly", "named"),
}
#: Where the user asks for time stamps that scatter.
NOT_SCATTERED = (
    f"{JITTER}: neighbouring readings do not scatter with speed, so that the time stamps do not"
)


def diagnose_by_free_runs(question: DiagnosisQuestion) -> Diagnosis:
    """By simulations of the runs from their starts."""
    began = time.perf_counter()
    library = question.library()
    binding = trusting(question.bound(library))
    others = tuple(name for name in question.allowed if name != JITTER)
    request = SearchRequest(
        question=question,
        binding=binding,
        residual=question.residual or default_residual(binding),
        allowed=others,
        still=standing_still(binding),
    )
    stamps = {}
    if any(kind.name == JITTER for kind in library):
        stamps = _scattered(binding)
    if stamps and not request.still:
        found = _by_scattered_stamps(request, stamps)
        if found.which.verdict == "named":
            return replace(found, wall_time_s=time.perf_counter() - began)
    # Stamps that scatter are noise, which neighbouring readings show or refute: no fit may take
    # something smooth for it.
    if stamps:
        request = replace(request, allowed=question.allowed)
    first = answered(request)
    found = first.diagnosis
    if not request.still:
        found = _by_windows(first)
        found = _asked_further(request, found, others)
    asked_in_vain = question.asked is not None and JITTER in question.asked and not stamps
    notes = [*found.notes, *(s.text for s in stamps.values())]
    if asked_in_vain:
        notes.append(NOT_SCATTERED)
    return replace(found, notes=tuple(notes), wall_time_s=time.perf_counter() - began)


def _scattered(binding: Binding) -> dict[str, Stamps]:
    """What the time stamps of output channels do, where a recording shows it."""
    outputs = binding.chain.signature.output_names
    found = scattered_stamps(binding.dataset, binding.noise)
    return {channel: stamps for channel, stamps in found.items() if channel in outputs}


def _by_scattered_stamps(request: SearchRequest, stamps: dict[str, Stamps]) -> Diagnosis:
    """With readings that count by what their stamps make of them."""
    question, binding = request.question, request.binding
    readings = with_scatter(question.dataset, stamps, binding.noise)
    stamped = question.bound(question.library(), readings).with_stamps(stamps)
    scattered = replace(request, binding=trusting(stamped))
    return answered(scattered, Scatter(stamps, binding)).diagnosis


def _by_windows(first: Answered) -> Diagnosis:
    """The answer by windows, each with its own start, where free runs leave doubts, cannot be
    trusted, and windows say more; else the first answer.
    """
    request, found = first.request, first.diagnosis
    question, verdict = request.question, found.which.verdict
    left_over = verdict == "named" and found.how_far.gap_after > LIMITS.far
    if question.residual is not None or not (verdict in ("unknown", "partly") or left_over):
        return found
    grown = first.growth()
    if grown > SENSITIVE:
        why = f"a difference at the start of a run grows {grown:.2g} times within it"
    elif by_windows(request.binding) and decays(request.binding):
        why = "the runs are free swings through several amplitudes"
    else:
        return found
    question.known.tell(found)
    windows = replace(request, question=question.silent(), residual=MultipleShooting())
    try:
        again = answered(windows).diagnosis
    except Interrupted as stop:
        raise Interrupted(found) from stop
    if again.which.verdict not in PREFERRED[verdict]:
        return found
    note = (
        f"{why}, and by free runs the answer was {verdict} with {times(found.how_far.gap_after)}"
        " times the noise left: models are compared over windows, each with its own start"
    )
    return replace(again, notes=(*again.notes, note))


def _asked_further(request: SearchRequest, found: Diagnosis, others: tuple[str, ...]) -> Diagnosis:
    """With laws that are asked last, with commands before the runs, and with what a law of no name
    depends on, where these say more.
    """
    question, nominal = request.question, request.question.nominal

    def ask(names: tuple[str, ...], dataset: Dataset | None = None) -> Diagnosis:
        wider = trusting(question.bound(possible(nominal, names), dataset))
        further = replace(request, question=question.silent(), binding=wider, allowed=names)
        return answered(further).diagnosis

    if question.asked is None:
        found = asked_last(found, nominal, request.residual.name, ask)
    if request.residual.free_run:
        found = asked_from_rest(found, request.binding.dataset, others, ask)
    visible = question.library(InverseDynamics.name)
    return with_law_of_no_name(found, question.bound(), visible, question.max_effects)
