"""Runs of a comparison: every fitter and every seed on one problem, one after the other so that
their times are honest.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

import jax
import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.base.interim import Interim
from jaxid.base.stopping import Interrupted
from jaxid.conventions.finding import DataFinding
from jaxid.data.dataset import Dataset
from jaxid.dynamics import catalogue
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.model_file import sha256_of
from jaxid.fitting.comparison import BestKnown, Comparison, FitterRun
from jaxid.fitting.covariance import covariance
from jaxid.fitting.fitter import AbstractFitter, Minimum, Progress, sampling_box
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.fitting.problem_builder import default_residual, ProblemBuilder, start_values
from jaxid.problem.binding import bind, Binding
from jaxid.problem.problem import FitProblem, LOSSES
from jaxid.problem.residual import Residual


#: Evaluations of each run where neither these nor seconds are given.
BUDGET = 10_000
STARTS = ("random", "guess")


def run_comparison(
    model: object,
    dataset: Dataset,
    fitters: Sequence[tuple[str, AbstractFitter]],
    seeds: int,
    budget: int | None,
    seconds: float | None,
    effects: Iterable[str | Effect | type[Effect]],
    without: Iterable[str],
    residual: Residual | None,
    loss: str,
    starts: str,
    tolerance: float,
    seed: int,
    progress: Progress | None,
    data: tuple[DataFinding, ...] = (),
) -> Comparison:
    """The whole of `jaxid.compare`; `fitters` have their labels, `data` is what the check found. On
    Ctrl-C `Interrupted` carries the comparison of the runs that were finished.
    """
    began = time.perf_counter()
    effects = tuple(catalogue.enrolled(e) for e in effects)
    _check_settings(seeds, budget, seconds, loss, starts, tolerance)
    binding = bind(model, dataset, effects=effects, without=without)
    residual = residual or default_residual(binding)
    for label, fitter in fitters:
        wanted = getattr(fitter, "residual_name", None)
        if wanted not in (None, residual.name):
            raise UsageError(
                f"{label} solves {wanted}, not {residual.name}: leave it out or give that residual"
            )
    bench = ProblemBuilder(binding)
    thetas = start_values(bench, binding.free, seed, residual=residual)
    problem = bench.problem(residual, "fit", binding.free, thetas[0], loss=loss)
    guess = problem.z(thetas[0])
    runs: list[tuple[FitterRun, Minimum]] = []
    total = len(fitters) * seeds

    def finished() -> Comparison:
        begins = [guess, *(problem.z(t) for t in thetas[1:])]
        lowest, best = best_known(binding, problem, begins, [m for _, m in runs])
        return Comparison(
            model=binding.chain.mechanism.name,
            dataset=binding.dataset.name,
            dataset_sha256=binding.dataset.sha256,
            effects=effects,
            residual=residual.name,
            loss_name=loss,
            budget=budget,
            limit_s=seconds,
            starts=starts,
            tolerance=tolerance,
            best_loss=lowest,
            best=best,
            runs=tuple(r for r, _ in runs),
            wall_time_s=time.perf_counter() - began,
            notes=(*binding.dataset.notes, f"residual: {problem.runs.statement}"),
            model_sha256=sha256_of(binding.chain.mechanism),
            data=data,
        )

    known = Interim()
    try:
        for label, fitter in fitters:
            for number in range(seed, seed + seeds):
                if progress:
                    progress("compare", len(runs), total, f"{label}, seed {number}")
                start = guess if starts == "guess" else random_start(problem, guess, number)
                runs.append(one_run(problem, fitter, label, start, number, budget, seconds))
                known.offer(finished)
    except KeyboardInterrupt as stop:
        raise Interrupted(finished() if runs else None) from stop
    if progress:
        progress("compare", total, total, "")
    return finished()


def one_run(
    problem: FitProblem,
    fitter: AbstractFitter,
    label: str,
    start: np.ndarray,
    seed: int,
    budget: int | None,
    seconds: float | None,
) -> tuple[FitterRun, Minimum]:
    """One fitter with one seed."""
    limit: dict[str, Any] = {} if seconds is None else {"seconds": seconds}
    began, compiled = time.perf_counter(), problem.compile_time_s
    found = fitter.minimise(problem, [start], jax.random.key(seed), budget, None, **limit)
    wall, compiling = time.perf_counter() - began, problem.compile_time_s - compiled
    spent = max(wall - compiling, 0.0)
    points = [p for p in found.history if np.isfinite(p[1])]
    times = found.seconds
    if len(times) != len(
        found.history
    ):  # a fitter that keeps no clock: evaluations cost the same all along
        times = [spent * n / max(found.evaluations, 1) for n, _ in found.history]
    history = np.array(
        [(n, t, v) for (n, v), t in zip(found.history, times, strict=True)], float
    ).reshape(-1, 3)
    history[:, 2] = np.minimum.accumulate(history[:, 2]) if len(points) else history[:, 2]
    theta = problem.theta(found.z)
    parameters = {problem.runs.layout.names[i]: float(theta[i]) for i in problem.free}
    status = "failed" if found.failed else "converged" if found.converged else "stopped"
    run = FitterRun(
        fitter=label,
        seed=seed,
        status=status,
        stopped_because=found.stopped_because,
        loss=found.loss,
        evaluations=found.evaluations,
        seconds=spent,
        wall_time_s=wall,
        compile_time_s=compiling,
        parameters=parameters,
        history=history,
    )
    return run, found


def random_start(problem: FitProblem, guess: np.ndarray, seed: int) -> np.ndarray:
    """Parameters anywhere in the sampling box; unknown starts of the runs as the data suggest
    them.
    """
    lower, upper = sampling_box(problem, guess)
    z = lower + (upper - lower) * np.random.default_rng(seed).uniform(size=problem.size)
    z[problem.free.size :] = guess[problem.free.size :]
    return z


def _check_settings(
    seeds: int,
    budget: int | None,
    seconds: float | None,
    loss: str,
    starts: str,
    tolerance: float,
) -> None:
    if loss not in LOSSES:
        raise UsageError(f"there is no loss {loss!r}{nearest(loss, LOSSES)}")
    if seeds < 1:
        raise UsageError(f"{seeds} seeds are none; give at least 1")
    if starts not in STARTS:
        raise UsageError(f"starts are {' or '.join(STARTS)}, not {starts!r}")
    if not tolerance > 0:
        raise UsageError(
            f"a tolerance of {tolerance:g} cannot be met; give a share of the best loss above 0,"
            " such as 1e-3"
        )
    if (budget is not None and budget < 1) or (seconds is not None and seconds <= 0):
        raise UsageError("budget and seconds are above 0")


def best_known(
    binding: Binding, problem: FitProblem, guesses: Sequence[np.ndarray], found: Sequence[Minimum]
) -> tuple[float, dict[str, BestKnown]]:
    """The lowest loss that runs or descents from the best of them and from the guesses reach, and
    the parameters there.
    """
    sound = sorted((m for m in found if not m.failed), key=lambda m: m.loss)
    ends = [m.z for m in sound[:3]]
    paths = levenberg_marquardt([(problem, z) for z in (*ends, *guesses)], 40, 1e-10)
    candidates = np.array([*ends, *(p.z for p in paths)])
    losses = problem.losses(candidates)
    z = candidates[int(np.argmin(losses))]
    square = FitProblem(
        problem.runs,
        problem.base,
        problem.free,
        binding.lower,
        binding.upper,
        problem.records,
        scale=binding.scale,
    )
    cov, slope, theta = covariance(square, z), problem.dtheta(z), problem.theta(z)
    best = {}
    for k, i in enumerate(problem.free):
        std = float(cov.std[k] * slope[k])
        entry = binding.layout.entries[i]
        best[entry.name] = BestKnown(
            float(theta[i]),
            std if np.isfinite(std) else None,
            entry.unit,
            float(binding.lower[i]),
            float(binding.upper[i]),
        )
    return float(losses.min()), best
