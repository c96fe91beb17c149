"""Time stamps that scatter, before physics: where a recording shows it, readings count by what
their stamps make of them, and the search runs on that. It holds if then nothing, or what the
library can name, is missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxid.base.wording import times
from jaxid.data.time_stamps import Stamps
from jaxid.diagnosis.evidence import held_out
from jaxid.diagnosis.hypothesis import Candidate, Hypothesis
from jaxid.diagnosis.reasons import Remark
from jaxid.diagnosis.result import Ranked
from jaxid.diagnosis.verdict import Verdict
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.binding import Binding, JITTER
from jaxid.problem.residual import Residual


@dataclass(frozen=True)
class Scatter:
    """What the time stamps of some channels do, and the binding whose readings all count alike."""

    stamps: dict[str, Stamps]
    alike: Binding

    def effects(self) -> tuple[Candidate, ...]:
        def index(channel):
            return tuple(self.alike.layout.of_effect(JITTER, channel))

        return tuple(Candidate(JITTER, channel, index(channel)) for channel in self.stamps)

    def verdict(self, verdict: Verdict) -> Verdict:
        """Of the search by readings that count as their stamps make them, with what the stamps
        do.
        """
        found = "; ".join(s.text for s in self.stamps.values())
        stamps = Remark(f"{found[0].upper()}{found[1:]}.")
        if verdict.name == "none":
            rest = Remark(
                "Beside that the model lacks nothing: what is left is that noise, on data that were"
                " not fitted."
            )
            return Verdict("named", (stamps, rest))
        return Verdict(verdict.name, (stamps, *verdict.reasons))

    def bench(self, like: ProblemBuilder) -> ProblemBuilder:
        """For comparison: the bench on which all readings count alike."""
        return ProblemBuilder(self.alike, like.step, like.differences)

    def ranked(
        self, bench: ProblemBuilder, residual: Residual, h: Hypothesis
    ) -> tuple[Ranked, ...]:
        """The scatter of all channels as one hypothesis over that of readings which count alike, at
        the same numbers.
        """
        alike = self.bench(bench)
        weights, before = (
            bench.runs(residual, "validation").weights,
            alike.runs(residual, "validation").weights,
        )
        seen = weights > 0
        wider = 2 * float(np.sum(np.log(before[seen] / weights[seen])))
        held = held_out(alike, "validation", [h.theta], residual)[0]

        def squares(held):
            return float(sum(np.sum(r**2) for r in held.residual))

        evidence = (squares(held) - squares(h.validation) - wider) / 2
        gap = float(np.sqrt(max(h.validation.loss, 0.0)))
        text = f"validation gap {times(gap)} times the noise that the stamps make"
        return tuple(
            Ranked(c.effect, c.location, gap, float(h.bic), evidence, f"{c}: {text}")
            for c in self.effects()
        )
