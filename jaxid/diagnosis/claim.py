"""From a search to what is claimed: each set of data may withdraw what does not hold on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxid.diagnosis import how_far as shrinking
from jaxid.diagnosis.evidence import held_out, knowledge
from jaxid.diagnosis.hypothesis import Candidate, Hypothesis, SearchResult
from jaxid.diagnosis.jitter import Scatter
from jaxid.diagnosis.left_open import left_open_in
from jaxid.diagnosis.reasons import (
    CutShort,
    NextToTheNoise,
    ReportNotReached,
    StandsStill,
    WithinWhatIsKnown,
)
from jaxid.diagnosis.result import HowFar
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.verdict import astray, Gaps, judge, upheld, Verdict
from jaxid.fitting.problem_builder import ProblemBuilder, touches
from jaxid.problem.residual import Residual


@dataclass(frozen=True)
class Claim:
    """A verdict, the effects that it names, the model with them, and how far the gap shrinks."""

    verdict: Verdict
    named: tuple[Candidate, ...]
    final: Hypothesis
    how_far: HowFar


class Judge:
    """Judges a search by all that was recorded. `still`: of "validation" and "report" what stands
    still; `scatter`: what time stamps do.
    """

    def __init__(
        self,
        bench: ProblemBuilder,
        residual: Residual,
        search: SearchResult,
        still: Sequence[str] = (),
        scatter: Scatter | None = None,
    ):
        self.bench, self.residual, self.search, self.still, self.scatter = (
            bench,
            residual,
            search,
            tuple(still),
            scatter,
        )
        self.nominal, self.end = search.settled or (search.nominal, search.chosen)
        self.alike = scatter.bench(bench) if scatter else bench
        self.before, self.note = shrinking.model_before(bench.binding, self.nominal.theta)
        if search.stands is not None:
            self.before = search.stands.theta
        self.repeated = any(n.source == "repeatability" for n in bench.binding.noise.values())
        self.reports = bool(bench.binding.experiments("report")) and "report" not in self.still

    def claim(self) -> Claim:
        """What is claimed by all sets of data."""
        # A zero of each run's own: what is compared has to be the outputs of free runs.
        names = self.bench.binding.chain.signature.output_names if self.residual.free_run else []
        counted = np.array(
            [self.bench.binding.noise[n].source == "quantisation" for n in names], bool
        )
        verdict, stamps = judge(self.search, counted), ()
        if self.search.cut_short:
            verdict = verdict.because(CutShort(bool(self.search.chosen.effects)))
        if self.scatter:
            verdict, stamps = self.scatter.verdict(verdict), self.scatter.effects()
        if "validation" in self.still:
            return self._claim(Verdict("unknown", (StandsStill(self.still),)))
        found = self._claim(
            verdict, (*stamps, *self.search.chosen.effects) if verdict.claims else ()
        )
        if self.reports and found.named:
            found = self._named_on_report(found)
        return (
            self._none_on_report(found) if self.reports and found.verdict.name == "none" else found
        )

    def _claim(self, verdict: Verdict, named: tuple[Candidate, ...] = ()) -> Claim:
        final = self.end if named else self.nominal
        far = shrinking.measure(
            bench=self.bench,
            residual=self.residual,
            before=self.before,
            retuned=self.nominal.theta,
            after=final.theta,
            verdict=verdict.name,
            note=self.note,
            alike=self.alike,
            still=self.still,
        )
        return Claim(verdict, named, final, far)

    def _named_on_report(self, found: Claim) -> Claim:
        """What the report data leave of a verdict that names effects."""
        judged, several = found.verdict, self.search.several
        # What is asked beside the model as it stands is compared with that: more numbers take up
        # what one says.
        other = (
            found.how_far.gap_retuned if self.search.stands is None else found.how_far.gap_before
        )
        gaps = Gaps(found.how_far.gap_before, other, found.how_far.gap_after)
        verdict = upheld(judged, gaps, several)
        # Unless the model follows the fit runs and what they leave open can account for it, where
        # it is not better without; what is `partly` there has to hold as it is.
        if judged.name == "named" != verdict.name and gaps.retuned > LIMITS.near:
            within = upheld(judged, self._within_what_is_known(gaps, found.final), several)
            if within.name != judged.name:
                verdict = within
            elif gaps.after < min(gaps.retuned, gaps.before):
                verdict = within.because(WithinWhatIsKnown(gaps.after))
        if verdict.name == judged.name:
            return replace(found, verdict=verdict)
        if verdict.claims:
            return self._claim(verdict, found.named)
        plain = judge(SearchResult(self.search.nominal, self.search.nominal))
        if plain.name == "none":  # the gap was one next to the noise
            names = " and ".join(map(str, self.search.chosen.effects))
            verdict = plain.because(NextToTheNoise(names, gaps.after, gaps.retuned))
        return self._claim(verdict)

    def _within_what_is_known(self, gaps: Gaps, final: Hypothesis) -> Gaps:
        """Gaps on report data, where each model's numbers are known no better than the fit and
        validation data leave them.
        """
        told = [knowledge(h.path) for h in (self.nominal, final)]
        follow = [None, final.path if final.fit_loss <= LIMITS.near**2 else None]
        seen = held_out(
            self.bench, "report", [self.nominal.theta, final.theta], self.residual, told, follow
        )
        return Gaps(gaps.before, *(float(np.sqrt(max(held.loss, 0.0))) for held in seen))

    def _none_on_report(self, found: Claim) -> Claim:
        """`none` is said only where the report data are at the noise too, in every run and
        direction.
        """
        far = found.how_far
        if not astray(far.per_run, far.per_regime, far.gap_retuned):
            return found
        # Scatter between repeated runs is taken up whole by a refit to report runs: that would show
        # nothing.
        path = found.final.path
        within = held_out(
            self.bench,
            "report",
            [found.final.theta],
            self.residual,
            [knowledge(path)],
            [None if self.repeated else path],
        )[0]
        room = 0.0
        if touches(self.bench.binding):
            room = left_open_in(self.bench, found.final, "report")
        runs, regimes = shrinking.parts(self.bench, self.residual, "report", within)
        places = astray(runs, regimes, within.gap_settled, room)
        if not places and within.gap_settled**2 <= LIMITS.near**2 + room:
            return found
        return self._claim(Verdict("unknown", (ReportNotReached(far.gap_retuned, tuple(places)),)))
