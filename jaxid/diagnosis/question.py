"""What is asked: by a user of a recording, and of one search over bound data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from jaxid.base.interim import Interim
from jaxid.data.dataset import Dataset
from jaxid.diagnosis.hypothesis import check_asked, possible, SearchResult
from jaxid.diagnosis.last_resort import first_asked
from jaxid.diagnosis.torque.reference import ReferenceNumbers
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Effect
from jaxid.fitting.fitter import Progress
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.result import Fit
from jaxid.problem.binding import bind, Binding
from jaxid.problem.residual import Residual
from jaxid.simulation.sample_buffers import STEP


#: Is told of the nominal fit and of what is known so far: what a run that is stopped keeps.
Offer = Callable[[Callable[[], Fit], SearchResult], None]


@dataclass(frozen=True)
class SearchOutcome:
    """What a search found: the nominal fit, and the bench on which its hypotheses were compared in
    the end. `compile_time`: s.
    """

    bench: ProblemBuilder
    nominal_fit: Fit
    search: SearchResult
    compile_time: float


#: What is found beginning with a bench.
Search = Callable[[ProblemBuilder, Offer], SearchOutcome]


@dataclass(frozen=True)
class DiagnosisQuestion:
    """What a user asks of a model and a recording; see `jaxid.diagnose`.

    `nominal`: the model as it is stated. `asked`: ids of the effects that the user names, None for
    the library. `known`: is told what is known before the end.
    """

    model: object
    nominal: Chain
    dataset: Dataset
    without: tuple[str, ...]
    asked: tuple[str, ...] | None
    residual: Residual | None
    max_effects: int
    seed: int
    progress: Progress | None
    known: Interim
    reference: ReferenceNumbers | None

    def check(self) -> None:
        """Raises `UsageError` where an effect that is named cannot be a candidate."""
        check_asked(self.nominal, self.asked or (), self.residual_name)

    @property
    def residual_name(self) -> str:
        """Empty where none is asked for."""
        return self.residual.name if self.residual else ""

    @property
    def allowed(self) -> tuple[str, ...]:
        """Ids of the effects that may be candidates."""
        return first_asked() if self.asked is None else self.asked

    def library(self, residual: str | None = None) -> list[type[Effect]]:
        """The allowed effects that the model lacks and that a residual can see: the one that is
        asked for, or one of this name.
        """
        seen_by = self.residual_name if residual is None else residual
        return possible(self.nominal, self.allowed, seen_by)

    def bound(
        self, candidates: Sequence[type[Effect]] = (), dataset: Dataset | None = None
    ) -> Binding:
        """The model with candidates, and its recording or another reading of it."""
        read = self.dataset if dataset is None else dataset
        return bind(self.model, read, without=self.without, candidates=candidates)

    def silent(self) -> DiagnosisQuestion:
        """The same question, of which nobody is told before its end."""
        return replace(self, known=Interim(silent=True))


@dataclass(frozen=True)
class SearchRequest:
    """What one search is asked of bound data, by which residual.

    `allowed`: ids of effects. `still`: of "validation" and "report", what stands still, so that
    nothing can be judged on it. `search`: another search than the one over all of the library.
    `step`: of its simulations, s.
    """

    question: DiagnosisQuestion
    binding: Binding
    residual: Residual
    allowed: tuple[str, ...]
    still: tuple[str, ...] = ()
    search: Search | None = None
    step: float = STEP

    def say(self, stage: str, detail: str) -> None:
        """A line of progress."""
        if self.question.progress:
            self.question.progress(stage, 0, 1, detail)
