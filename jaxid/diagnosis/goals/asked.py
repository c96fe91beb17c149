"""What is asked of a robot that goals drive, and the models that are made for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from jaxid.data.dataset import Dataset
from jaxid.diagnosis.goals.gains import freed, known_loosely, with_room
from jaxid.diagnosis.goals.study import loop_step
from jaxid.diagnosis.question import Search
from jaxid.diagnosis.result import Diagnosis
from jaxid.dynamics.effect import Effect
from jaxid.fitting.fitter import Progress
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.binding import bind, Binding
from jaxid.simulation.sample_buffers import STEP


#: Steps that take the place of a file's are so many times shorter than those of a fit: these leave
#: a quarter of the noise behind, which counts against right numbers.
FINER = 2
#: Makes of a binding with candidates, names of effects, a search and the step of its simulations
#: the diagnosis.
Answer = Callable[[Binding, Sequence[str], Search, float], Diagnosis]


@dataclass(frozen=True)
class GoalsQuestion:
    """What is asked of which recording, and in which steps it is simulated."""

    model: object
    dataset: Dataset
    without: tuple[str, ...]
    kinds: Sequence[type[Effect]]
    max_effects: int
    step: float
    answer: Answer
    progress: Progress | None

    def about(self, dataset: Dataset) -> GoalsQuestion:
        """The same question about a recording that is read otherwise, in steps that suit it."""
        other = replace(self, dataset=dataset)
        binding = other.bound()
        step = simulated_step(binding)
        if binding.chain.mechanism.own_step is None:
            step /= FINER
        return replace(other, step=step)

    def bound(self, names: Sequence[str] = (), gains: Sequence[str] = ()) -> Binding:
        """The model with effects of these names as candidates and these gains fitted."""
        asked = [k for k in self.kinds if k.name in names]
        wide = bind(self.model, self.dataset, without=self.without, candidates=asked)
        return freed(with_room(wide), gains)

    def known(self, names: Sequence[str] = (), inflation: float = 1.0) -> Binding:
        """The model with effects of these names as candidates, its numbers known as they are
        trusted.
        """
        return known_loosely(self.bound(names), inflation)

    def made(self, binding: Binding) -> ProblemBuilder:
        return ProblemBuilder(binding, self.step, differences=1, together=True)


def simulated_step(binding: Binding) -> float:
    """The longest step of the simulations, s."""
    own = binding.chain.mechanism.own_step
    return max(STEP, loop_step(binding)) if own is None else own
