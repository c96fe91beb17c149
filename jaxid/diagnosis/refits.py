"""Models refitted with sets of effects, kept with what they predict, on steps of simulation that no
longer matter against the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from jaxid.diagnosis.evidence import held_out, knowledge, together
from jaxid.diagnosis.hypothesis import Candidate, Hypothesis, key_of
from jaxid.diagnosis.prior_pull import moved_to, put_back
from jaxid.diagnosis.proposals import promising, Proposal
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.least_squares import levenberg_marquardt, Path
from jaxid.fitting.many_starts import successive_halving
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import Residual
from jaxid.problem.step_error import defects, step_error, STEP_SHARE


#: How often the step may be halved, and how often its defect is worked out anew for a chosen
#: hypothesis.
HALVINGS, CORRECTIONS = 3, 2
#: Iterations and tolerance of a descent to the end, of that of a nominal model to which something
#: better is compared, and of what is brought up to date.
THOROUGH, BRIEF, RENEWED = (20, 1e-8), (6, 1e-5), (10, 1e-7)
#: Hypotheses that left up to this much more than the chosen one are brought up to date.
CLOSE = 1.5


class Refits:
    """All that was fitted of one model and recording.

    `known` holds the hypotheses by their sets of effects, as they were fitted last; `earlier` those
    that were fitted before the data were corrected for the step. `bench` has the steps of the
    search, `accurate` steps that no longer matter, and `coarser` are benches that were left behind.
    """

    def __init__(self, bench: ProblemBuilder, residual: Residual, nominal: Path):
        self.bench, self.accurate, self.residual = bench, bench, residual
        self.coarser: list[ProblemBuilder] = []
        self.base_free = list(nominal.problem.free)
        (self.nominal,) = self.hypotheses([((), nominal)])
        self.known: dict[frozenset[str], Hypothesis] = {frozenset(): self.nominal}
        self.earlier: dict[frozenset[str], Hypothesis] = {}

    @property
    def benches(self) -> list[ProblemBuilder]:
        """The first one has the steps of the search, less their defects for what was chosen."""
        return [*self.coarser, self.bench]

    def problem(self, effects: Sequence[Candidate], theta: np.ndarray) -> FitProblem:
        """The model's numbers and those of effects free, all others as in theta."""
        free = list(self.base_free)
        for c in effects:
            free += c.index
        return self.bench.problem(self.residual, "fit", free, theta)

    def hypotheses(self, found: Sequence[tuple[tuple[Candidate, ...], Path]]) -> list[Hypothesis]:
        """Fitted models with what they make of the validation runs."""
        if not found:
            return []
        paths = [path for _, path in found]
        thetas = [path.problem.theta(path.z) for path in paths]
        # Only what fits as well as the best, and almost down to the noise, may turn out to be right
        # elsewhere.
        lowest = min(path.loss for path in paths)
        most = min(lowest / LIMITS.half, LIMITS.far)
        follow = [path if path.loss <= most else None for path in paths]
        told = list(map(knowledge, paths))
        predicted = held_out(self.bench, "validation", thetas, self.residual, told, follow)
        out = []
        for (effects, path), theta, held in zip(found, thetas, predicted, strict=True):
            out.append(Hypothesis(effects, theta, path, held))
        return out

    # ---- refits of sets

    def refit(self, sets: Sequence[Proposal], like: Hypothesis | None = None) -> list[Hypothesis]:
        """Refits each set of effects from its starts (full parameter vectors), all in one batch,
        the runs begun as in `like` or the nominal model; best start of each.
        """
        if not sets:
            return []
        begun = (like or self.nominal).path
        starts = begun.problem.starts(begun.z)
        groups = []
        for effects, thetas in promising(self.nominal.path, sets):
            problem = self.problem(effects, thetas[0])
            groups.append([(problem, problem.z(theta, starts)) for theta in thetas])
        ends = successive_halving(groups, 20, 1e-6)
        fitted = [(effects, end) for (effects, _), end in zip(sets, ends, strict=True)]
        return [self._kept(h) for h in self.hypotheses(fitted)]

    def _kept(self, h: Hypothesis) -> Hypothesis:
        """The hypothesis, or how it was known before where it fits better so."""
        key = key_of(h.effects)
        before = self.known.get(key)
        if before is not None and before.effects == h.effects and before.fit_loss < h.fit_loss:
            h = before
        self.known[key] = h
        return h

    # ---- steps of the simulation

    def refined(self, chosen: Hypothesis) -> Hypothesis:
        """The chosen hypothesis descended to the end, with steps so fine that they no longer matter
        against the noise: what the step leaves behind would look like another effect. The search
        itself stays on its steps: what finer ones add to the chosen hypothesis is taken off the
        data.
        """
        to_the_end = chosen.effects or chosen.fit_loss < LIMITS.far
        chosen = self.descended(chosen, THOROUGH if to_the_end else BRIEF)
        self._halve_steps(chosen)
        if self.accurate is self.bench:
            return chosen
        # Of the nominal model, which the chosen one is compared with.
        self.accurate.compile_ahead(self.residual, self.nominal.theta, self.base_free)
        for _ in range(CORRECTIONS):
            self._take_off(chosen)
            chosen = self.descended(chosen)
        self.nominal = self.descended(self.nominal, BRIEF) if chosen.effects else chosen
        self.earlier |= self.known
        self.known = {frozenset(): self.nominal, key_of(chosen.effects): chosen}
        return chosen

    def _halve_steps(self, h: Hypothesis) -> None:
        """Until what they leave behind no longer matters."""
        before = np.nan
        for _ in range(HALVINGS):
            bench = self.accurate
            problem = bench.problem(self.residual, "fit", h.path.problem.free, h.theta)
            finer = replace(bench, step=bench.step / 2, defects={})
            error = step_error(problem, _z(problem, h), finer.runs(self.residual, "fit"))
            if error <= STEP_SHARE:
                return
            self.accurate = finer
            # As it goes on falling, half of what is allowed is left.
            if error * error <= STEP_SHARE / 2 * before:
                return
            before = error

    def _take_off(self, h: Hypothesis) -> None:
        """Sets the defects of the bench's steps, as this hypothesis has them."""
        for split in ("fit", "validation"):
            problem = self.bench.problem(self.residual, split, [], h.theta)
            starts = h.path.problem.starts(h.path.z) if split == "fit" else None
            if split == "validation" and self.residual.free_run:
                starts = estimate_starts(self.bench, split, [h.theta])[0]
            finer = self.accurate.runs(self.residual, split)
            left_behind = defects(problem, problem.z(h.theta, starts), finer)
            self.bench.take_off(self.residual, split, left_behind)

    def settled(self, chosen: Hypothesis) -> Hypothesis:
        """The chosen hypothesis and the nominal model on the accurate bench itself."""
        if self.accurate is self.bench:
            return chosen
        self.coarser.append(self.bench)
        self.bench = self.accurate
        if not chosen.effects:
            (self.nominal,) = self.all_descended([self.nominal], THOROUGH)
            return self.nominal
        self.nominal, chosen = self.all_descended([self.nominal, chosen], THOROUGH)
        return chosen

    def descended(self, h: Hypothesis, descent: tuple[int, float] = THOROUGH) -> Hypothesis:
        """The hypothesis at its minimum on the bench as it is now."""
        return self.all_descended([h], descent)[0]

    def all_descended(
        self, hypotheses: Sequence[Hypothesis], descent: tuple[int, float]
    ) -> list[Hypothesis]:
        """Several of them in one batch."""
        jobs = []
        for h in hypotheses:
            problem = self.problem(h.effects, h.theta)
            jobs.append((problem, _z(problem, h)))
        ends = levenberg_marquardt(jobs, *descent)
        fitted = [(h.effects, end) for h, end in zip(hypotheses, ends, strict=True)]
        found = self.hypotheses(fitted)
        for h in found:
            self.known[key_of(h.effects)] = h
        return found

    def renew(self, keys: Sequence[frozenset[str]], chosen: frozenset[str]) -> None:
        """Brings hypotheses that were close to the chosen one before the data were corrected for
        the step up to date.
        """
        if chosen not in self.earlier:
            return
        most = CLOSE * self.earlier[chosen].fit_loss
        old = [self.earlier[k] for k in keys if k in self.earlier and k not in self.known]
        close = [h for h in old if h.fit_loss <= most]
        if close:
            self.all_descended(close, RENEWED)

    # ---- what the fit runs leave open

    def put_back(self, h: Hypothesis) -> Hypothesis:
        """The hypothesis with those of the model's own numbers where the user put them that the
        data leave open.
        """
        if not h.effects:
            return h
        on_quick_steps = partial(self.benches[0].problem, self.residual, "fit")
        path = put_back(h.path, self.bench.binding.theta, self.base_free, on_quick_steps)
        if path is h.path:
            return h
        (after,) = self.hypotheses([(h.effects, path)])
        return after if _as_near(after, h) else h

    def taught(self, h: Hypothesis) -> Hypothesis:
        """What the fit runs leave open, as the validation runs have it, for a model that follows
        the fit runs.
        """
        theta = self._as_validation_runs_have_it(h)
        if theta is None:
            return h
        path = moved_to(h.path, theta)
        if path is h.path:
            return h
        (after,) = self.hypotheses([(h.effects, path)])
        nearer = after.validation.gap < h.validation.gap
        return after if nearer and _as_near(after, h) else h

    def _as_validation_runs_have_it(self, h: Hypothesis) -> np.ndarray | None:
        """Numbers fitted to fit and validation runs at once; None where that says nothing new."""
        if h.fit_loss > LIMITS.far:
            return None
        held = h.validation
        if held.theta is not None:
            return held.theta
        left_open = held.gap**2 > LIMITS.alike * held.loss
        if not left_open or not self.residual.free_run:
            return None
        quick = self.benches[0]
        starts = estimate_starts(quick, "validation", [h.theta])
        end = together(quick, "validation", [h.path], starts)[0]
        return end.problem.theta(end.z)


def _as_near(other: Hypothesis, h: Hypothesis) -> bool:
    """Whether it leaves as much of validation runs, as well as the noise is known."""
    return other.validation.loss < h.validation.loss * LIMITS.alike


def _z(problem: FitProblem, h: Hypothesis, theta: np.ndarray | None = None) -> np.ndarray:
    """Search variables at a hypothesis's numbers, or at others, with its starts of runs."""
    starts = h.path.problem.starts(h.path.z)
    return problem.z(h.theta if theta is None else theta, starts)
