"""Fits once model and data are bound: one, or the same with many seeds."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast, TYPE_CHECKING

import jax
import numpy as np

from jaxid.base.interim import Interim
from jaxid.base.stopping import Interrupted
from jaxid.fitting.assemble import assemble
from jaxid.fitting.change import fit_change, noticed
from jaxid.fitting.effect_starts import probe_starts
from jaxid.fitting.ending import looked_again
from jaxid.fitting.fitter import AbstractFitter, Minimum, Progress
from jaxid.fitting.least_squares import levenberg_marquardt, problem_clip
from jaxid.fitting.lost_runs import believed, growth, SENSITIVE
from jaxid.fitting.problem_builder import (
    default_residual,
    descend_over_stretches,
    ProblemBuilder,
    start_values,
    touches,
)
from jaxid.fitting.result import Fit
from jaxid.fitting.reweighting import reweighed
from jaxid.fitting.scale_free import refuse_scale_free
from jaxid.fitting.settings import label_of
from jaxid.fitting.wide_slopes import descend_widely
from jaxid.problem.binding import Binding
from jaxid.problem.problem import FitProblem
from jaxid.problem.residual import Residual
from jaxid.problem.step_error import step_error, STEP_SHARE
from jaxid.simulation import sample_buffers as samples


if TYPE_CHECKING:
    from jaxid.problem.momentum import Momentum


#: A fit that took less is soon made again: nothing is saved before its end.
WORTH_SAVING_S = 5.0
#: Iterations and tolerance of a fit of how runs begin.
BEGINNINGS = (30, 1e-4)
#: Rounds of a descent over contacts.
ROUNDS = 40


def fit_binding(
    binding: Binding,
    fitter: AbstractFitter,
    residual: Residual | None,
    loss: str,
    seed: int,
    budget: int | None,
    progress: Progress | None,
) -> Fit:
    """The whole of `jaxid.fit` once model and data are bound."""
    momenta = None
    if residual is not None and residual.momenta:
        momenta = cast("Momentum", residual)
    if momenta is not None and binding.chain.timed:
        return fit_change(binding, fitter, momenta, loss, seed, budget, progress)
    known, benches = Interim(after=WORTH_SAVING_S), ProblemBuilders(binding)

    def fitted(residual: Residual | None, begin: np.ndarray | None, spent: int) -> Fit:
        left = None if budget is None else max(1, budget - spent)
        return fit_seeds(
            binding=binding,
            fitter=fitter,
            residual=residual,
            loss=loss,
            seeds=[seed],
            budget=left,
            progress=progress,
            benches=benches,
            known=known,
            begin=begin,
            reweigh=True,
        )[0]

    try:
        fit = fitted(residual, None, 0)
        if momenta is not None:
            return noticed(binding, momenta, fit)
        free = residual is None and default_residual(binding).free_run and loss == "sum_of_squares"
        if not free or (budget is not None and fit.evaluations >= budget):
            return fit

        def again(*what: Any) -> Fit:
            known.tell(fit)
            return fitted(*what)

        return believed(benches.of(samples.STEP), fit, fitter, again)
    except KeyboardInterrupt as stop:
        raise Interrupted(known.latest()) from stop


def fit_seeds(
    binding: Binding,
    fitter: AbstractFitter,
    residual: Residual | None,
    loss: str,
    seeds: Sequence[int],
    budget: int | None,
    progress: Progress | None = None,
    benches: ProblemBuilders | None = None,
    known: Interim | None = None,
    begin: np.ndarray | None = None,
    reweigh: bool = False,
) -> list[Fit]:
    """A fit of each seed, the same as each alone. What does not depend on the seed is done once,
    and fitters take all seeds in the same batches where they can; each fit states its share of the
    time. `benches` keeps runs from call to call. `known` is told of a fit before it is refined.
    `begin`: numbers to begin with in place of guesses. `reweigh`: several channels are weighed by
    what the model leaves of them where their noises differ much from that.
    """
    began = time.perf_counter()
    benches = ProblemBuilders(binding) if benches is None else benches
    compiled = benches.compile_time()
    run = _SeedRun(
        binding=binding,
        residual=residual or default_residual(binding),
        loss=loss,
        budget=budget,
        progress=progress,
        benches=benches,
        known=known,
        label=label_of(fitter),
        began=began,
        notes={seed: [] for seed in seeds},
    )
    # where each seed's coarser step ended
    level: dict[int, np.ndarray | None] = dict.fromkeys(seeds, begin)
    step = samples.STEP
    while level:
        level = run.fit(fitter, level, step)
        step = step / 2
        fitter = fitter.nearby()
    if reweigh and fitter.linearises and loss == "sum_of_squares":
        for seed in list(run.ended):
            run.reweigh(seed, fitter, begin)
    share = 1 / len(seeds)
    fits = [run.assembled(seed, *run.ended[seed]) for seed in seeds]
    compiling = share * (benches.compile_time() - compiled)
    wall = share * (time.perf_counter() - began)
    return [replace(fit, compile_time_s=compiling, wall_time_s=wall) for fit in fits]


@dataclass
class _SeedRun:
    """The fits of several seeds on their way: notes of each, and where it has `ended` by now."""

    binding: Binding
    residual: Residual
    loss: str
    budget: int | None
    progress: Progress | None
    benches: ProblemBuilders
    known: Interim | None
    label: str
    began: float
    notes: dict[int, list[str]]
    ended: dict[int, tuple[ProblemBuilder, FitProblem, Minimum]] = field(default_factory=dict)

    @property
    def simulated(self) -> bool:
        return not self.residual.torques and bool(self.binding.dataset.split("fit"))

    def fit(
        self, fitter: AbstractFitter, level: Mapping[int, np.ndarray | None], step: float
    ) -> dict[int, np.ndarray | None]:
        """Fits at one step, from guesses or from where `level` says; the seeds that a finer step
        would move, and where they are.
        """
        bench = self.benches.of(step)
        jobs = self._jobs(bench, fitter, level)
        found = fitter.minimise_each(jobs, self.budget, self.progress)
        if touches(self.binding) and self.simulated and self.loss == "sum_of_squares":
            found = [
                self._over_contacts(job[0], result) for job, result in zip(jobs, found, strict=True)
            ]
        elif step == samples.STEP:  # a finer one begins where the coarser one has ended
            note = "stopped before its end was looked at from beside it"
            for seed, job, result in zip(level, jobs, found, strict=True):
                self._offer(seed, bench, job[0], result, note)
            found = looked_again(jobs, found, fitter, self.budget, self.progress)
        finer: dict[int, np.ndarray | None] = {}
        for seed, job, result in zip(level, jobs, found, strict=True):
            self.ended[seed] = bench, job[0], result
            theta = self._refined(seed, step)
            if theta is not None:
                finer[seed] = theta
        return finer

    def _jobs(
        self, bench: ProblemBuilder, fitter: AbstractFitter, level: Mapping[int, np.ndarray | None]
    ) -> list[tuple[FitProblem, list[np.ndarray], Any]]:
        """(problem, starts, key) of each seed; one problem for all that begin alike."""
        binding, residual = self.binding, self.residual
        # Cores compile side by side: what descents run while start values are found, what is asked
        # of their end while they run.
        engine = bench.runs(residual, "fit").engine if self.simulated else None
        if engine and fitter.linearises:
            engine.compile_ahead("tangents", binding.theta, binding.free)
        jobs, common = [], {}
        for seed, theta in level.items():
            if theta is None:
                guesses = self.benches.starts(bench, residual, self.loss, seed)
            else:
                guesses = [theta]
            key = guesses[0].tobytes()
            if key not in common:
                common[key] = bench.problem(
                    residual, "fit", binding.free, guesses[0], loss=self.loss
                )
            problem = common[key]
            if residual.torques:
                refuse_scale_free(problem, problem.z(guesses[0]))
            begun = [self._begun(bench, problem, g) for g in guesses]
            jobs.append((problem, begun, jax.random.key(seed)))
        if engine:
            engine.compile_ahead("outputs", binding.theta, binding.free)
        return jobs

    def _begun(self, bench: ProblemBuilder, problem: FitProblem, guess: np.ndarray) -> np.ndarray:
        """The search vector at a guess of the numbers. Where something touches, a run that begins
        a little off touches elsewhere, and numbers would be moved for that: free runs are fitted
        over one stretch after the other, of others how they begin is fitted first.
        """
        if not touches(self.binding) or self.residual.torques:
            return problem.z(guess)
        if self.residual.free_run and self.loss == "sum_of_squares":
            every = range(len(problem.records))
            path, _ = descend_over_stretches(bench, "fit", problem.free, guess, every)
            return problem_clip(problem, path.z)
        alone = bench.problem(self.residual, "fit", [], guess, loss=self.loss)
        (path,) = levenberg_marquardt([(alone, alone.z(guess))], *BEGINNINGS)
        return problem.z(guess, alone.starts(path.z))

    def _over_contacts(self, problem: FitProblem, result: Minimum) -> Minimum:
        """The end of a search over runs that touch, from where it was led by slopes that jump."""
        path, spent = descend_widely(problem, result.z, ROUNDS)
        if not path.loss < result.loss:
            return result
        evaluations = result.evaluations + spent
        return replace(
            result,
            z=path.z,
            loss=path.loss,
            converged=path.converged,
            stopped_because=path.stopped,
            stalled=False,
            evaluations=evaluations,
            history=[*result.history, (evaluations, path.loss)],
            seconds=[*result.seconds, *result.seconds[-1:]],
        )

    def _refined(self, seed: int, step: float) -> np.ndarray | None:
        """The numbers of a fit that half the step would move; None for one that is done."""
        bench, problem, result = self.ended[seed]
        if result.failed or not self.simulated or step <= samples.STEP / 8:
            return None
        half = self.benches.of(step / 2)
        if half is bench:
            return None  # samples are closer than either step
        moved = step_error(problem, result.z, half.runs(self.residual, "fit"))
        if not moved > STEP_SHARE:
            return None
        theta = problem.theta(result.z)
        if self.residual.free_run and growth(bench, theta) > SENSITIVE:
            self.notes[seed].append(
                "runs that forget how they began are not refined: every step shows another one"
            )
            return None
        note = f"stopped before it was refined with steps of {step / 2:.3g} s"
        self._offer(seed, bench, problem, result, note)
        self.notes[seed].append(
            f"halving the step moved the simulation by {moved:.2g} of the noise or gap:"
            f" refitted at {step / 2:.3g} s"
        )
        return theta

    def reweigh(self, seed: int, fitter: AbstractFitter, begin: np.ndarray | None) -> None:
        """Weighs the channels by what the model leaves of them, where that ends better."""
        bench, problem, result = self.ended[seed]
        guesses = []
        if begin is None:
            starts = self.benches.starts(bench, self.residual, self.loss, seed)
            guesses = [problem.z(g) for g in starts]
        key = jax.random.key(seed)
        note = "stopped before channels were weighed by what the model leaves of them"
        self._offer(seed, bench, problem, result, note)
        other = reweighed(problem, result, guesses, key, fitter, self.budget, self.progress)
        if other is None:
            return
        jobs = [(other.problem, [], key)]
        again = looked_again(jobs, [other.found], fitter, self.budget, self.progress)[0]
        self.ended[seed] = bench, other.problem, again
        self.notes[seed].append(other.note)

    def _offer(
        self, seed: int, bench: ProblemBuilder, problem: FitProblem, result: Minimum, note: str
    ) -> None:
        """Has what is known by now kept, in case that this does not come to its end."""
        if not self.known or result.failed:
            return
        spent = time.perf_counter() - self.began
        self.known.offer(lambda: self.assembled(seed, bench, problem, result, spent, note))

    def assembled(
        self,
        seed: int,
        bench: ProblemBuilder,
        problem: FitProblem,
        result: Minimum,
        spent: float = 0.0,
        *notes: str,
    ) -> Fit:
        return assemble(
            bench=bench,
            problem=problem,
            result=result,
            residual=self.residual,
            fitter=self.label,
            seed=seed,
            compile_time=0.0,
            wall_time=spent,
            notes=[*self.notes[seed], *notes],
        )


class ProblemBuilders:
    """Benches of a binding by step, and the start values on them, each made once."""

    def __init__(self, binding: Binding):
        self.binding = binding
        self._benches: dict[float, ProblemBuilder] = {}
        self._starts: dict[tuple[str, str], list[np.ndarray]] = {}

    def of(self, step: float) -> ProblemBuilder:
        """The bench of a step; one for all steps that make no difference."""
        own = self.binding.chain.mechanism.own_step
        step = step if own is None else own
        if step not in self._benches:
            every = [e.whole for e in self.binding.dataset.experiments]
            same = (
                bench
                for made, bench in self._benches.items()
                if samples.divided_alike(every, made, step)
            )
            sides = int(touches(self.binding))  # tangents through contacts compile for minutes
            self._benches[step] = next(same, None) or ProblemBuilder(self.binding, step, sides)
        return self._benches[step]

    def starts(
        self, bench: ProblemBuilder, residual: Residual, loss: str, seed: int
    ) -> list[np.ndarray]:
        """Start values, best first, and those of added effects; no guess depends on the seed."""
        key = repr(residual), loss
        if key not in self._starts:
            guesses = start_values(bench, self.binding.free, seed, residual=residual)
            if residual.momenta:
                return self._starts.setdefault(key, guesses)
            problem = bench.problem(residual, "fit", self.binding.free, guesses[0], loss=loss)
            self._starts[key] = [*guesses, *probe_starts(bench, problem, guesses[0])]
            bench.forget_long(residual)
        return self._starts[key]

    def compile_time(self) -> float:
        once = {id(bench): bench for bench in self._benches.values()}
        return sum(bench.compile_time() for bench in once.values())
