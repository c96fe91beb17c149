"""A fit while data arrive: `jaxid fit --window N`, `--forgetting L`.

The runs to fit come in blocks (`in_blocks`). With a window each recursion fits the last N blocks
anew. Without one it fits the new block alone, beside what the blocks before it say of the
parameters, which is carried on as R and e of |R (theta - mean) + e|^2 and counts `forgetting` times
less with every block (the square-root information filter: Bierman, Factorization Methods for
Discrete Sequential Estimation, 1977). Either way a recursion costs the same, however long the
recording. Of a model that is linear in its parameters that is recursive least squares, exactly; of
another one earlier blocks are known by their slopes where they were fitted.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.wording import names_of
from jaxid.data.dataset import Dataset
from jaxid.fitting.assemble import assemble
from jaxid.fitting.covariance import covariance
from jaxid.fitting.fitter import AbstractFitter, Minimum, Progress
from jaxid.fitting.population import AbstractPopulation
from jaxid.fitting.problem_builder import default_residual, start_values
from jaxid.fitting.result import Fit
from jaxid.fitting.run import ProblemBuilders
from jaxid.fitting.sequential import carried, follow, stretches
from jaxid.fitting.settings import label_of
from jaxid.problem.binding import Binding
from jaxid.problem.objective import rows
from jaxid.problem.problem import FitProblem, NumberPrior
from jaxid.problem.residual import Residual
from jaxid.simulation import sample_buffers as samples


#: A dataset of fewer fit runs is cut in time into about this many blocks.
BLOCKS = 20
#: A block has at least this many samples.
SHORTEST = 20
#: Generations of a population in each recursion after the first: "five loops suffice" (paper 000).
GENERATIONS = 5


@dataclass(frozen=True)
class RecursionSettings:
    """How a fit goes along its blocks: `window` blocks at a time, or all of them at `forgetting`;
    `block_s` seconds long.
    """

    window: int | None = None
    forgetting: float = 1.0
    block_s: float | None = None

    def __post_init__(self):
        if self.window is not None and self.window < 1:
            raise UsageError(f"a window of {self.window} blocks holds nothing; give at least 1")
        if not 0 < self.forgetting <= 1:
            raise UsageError(
                f"forgetting is {self.forgetting:g}; it lies above 0 and at most at 1 (1 forgets"
                " nothing)"
            )
        if self.block_s is not None and not self.block_s > 0:
            raise UsageError(f"blocks of {self.block_s:g} s hold nothing")


@dataclass(frozen=True)
class RecursionStep:
    """One recursion: the last time of its block (s, of the run it is from), its loss, and the
    numbers with their standard deviations (None where they are not determined).
    """

    block: str
    t: float
    loss: float
    evaluations: int
    wall_time_s: float
    parameters: dict[str, tuple[float, float | None]]

    def to_dict(self) -> dict[str, Any]:
        numbers = {k: {"value": v, "std": s} for k, (v, s) in self.parameters.items()}
        return {**vars(self), "parameters": numbers}


def in_blocks(dataset: Dataset, block_s: float | None = None) -> Dataset:
    """The dataset with its fit runs cut in time into blocks of `block_s` seconds; without, into
    about `BLOCKS` where there are fewer runs than that. Other splits stay. A block begins in
    motion, and what remembers begins anew in it.
    """
    dataset = dataset.with_splits()
    fit = dataset.split("fit")
    if not fit or (block_s is None and len(fit) >= BLOCKS):
        return dataset
    length = block_s or sum(e.duration for e in fit) / BLOCKS
    out = []
    for e in dataset.experiments:
        if e.split != "fit":
            out.append(e)
            continue
        count = max(1, min(round(e.duration / length), len(e) // SHORTEST))
        edges = np.searchsorted(e.t, e.t[0] + e.duration / count * np.arange(1, count)).tolist()
        cuts = [0, *edges, len(e)]
        for k, (a, b) in enumerate(zip(cuts[:-1], cuts[1:], strict=True)):
            out.append(
                e if count == 1 else e.piece(a, b, name=f"{e.name}#block{k + 1}", split="fit")
            )
    return replace(dataset, experiments=tuple(out))


def absorbed(
    known: NumberPrior, problem: FitProblem, z: np.ndarray, forgetting: float = 1.0
) -> NumberPrior:
    """What the data of a problem, linearised at z, and what was known before say together, times
    `forgetting`. Unknown starts of its runs are eliminated, not carried on.
    """
    n, size = problem.free.size, problem.size
    values = problem.theta(z)[problem.free]
    R: Any = np.zeros((0, size + 1))
    slope = np.ones(size)
    slope[:n] = problem.dtheta(z)
    order = [*range(n, size), *range(n)]  # starts first: the triangle below them is free of them
    for part in rows([(problem, z)], pieces=True):
        J = np.zeros((part.r.size, size))
        J[:, part.z_columns] = part.J.reshape(part.r.size, -1)
        R = np.linalg.qr(
            np.concatenate([R, np.column_stack([(J / slope)[:, order], part.r.ravel()])]), "r"
        )
    own = R[
        min(size - n, len(R)) : size, size - n :
    ]  # below the starts; of fewer rows than columns what there is
    weight = np.sqrt(forgetting)
    before = np.column_stack([known.R, known.R @ (values - known.mean) + known.e])
    both: Any = weight * np.linalg.qr(np.concatenate([before, own]), "r")
    both = np.concatenate([both, np.zeros((max(0, n - len(both)), n + 1))])[:n]
    return NumberPrior(values, both[:, :n], both[:, n])


def fit_recursively(
    binding: Binding,
    fitter: AbstractFitter,
    residual: Residual | None,
    loss: str,
    seed: int,
    budget: int | None,
    progress: Progress | None,
    recursion: RecursionSettings,
) -> Fit:
    """The whole of `jaxid.fit` with a window or forgetting; `binding` is on a dataset in blocks.
    The result is the last recursion's, with all of them under `recursion`. `budget` bounds the
    first recursion, which searches the whole space.
    """
    began = time.perf_counter()
    residual = residual or default_residual(binding)
    if recursion.window is None and loss != "sum_of_squares":
        raise UsageError(
            "what earlier blocks say is carried on in squares: use sum_of_squares, or a window,"
            f" with {loss}"
        )
    blocks = binding.dataset.split("fit")
    if len(blocks) < 2:
        raise UsageError(
            f"a recursion needs at least two blocks of {SHORTEST} samples, and the fit data give"
            f" {len(blocks)}: state shorter ones (--block)"
        )
    benches = ProblemBuilders(binding)
    bench = benches.of(samples.STEP)
    guesses = start_values(bench, binding.free, seed, [0])
    whole = bench.problem(residual, "fit", binding.free, guesses[0], loss=loss)
    if whole.pieces != len(blocks):
        raise UsageError(
            f"{residual.name} divides runs by itself: use output_error or inverse_dynamics with a"
            " window or forgetting"
        )
    found: list[tuple[Any, Any]] = []

    def problems() -> Iterator[Any]:
        if recursion.window is not None:
            for part in stretches(whole, 1, recursion.window, recursion.forgetting):
                found.append((part, None))
                yield part
            return
        known = whole.known
        for k in range(whole.pieces):
            part = whole.part([k], [1.0])
            found.append((part.knowing(known), None))
            yield found[-1][0]
            known = absorbed(known, part, found[-1][1].z, recursion.forgetting)

    steps: list[RecursionStep] = []
    last = began
    for minimum in followed(fitter, problems(), guesses, jax.random.key(seed), budget):
        problem = found[-1][0]
        found[-1] = problem, minimum
        if minimum.failed:
            break
        now, e = time.perf_counter(), blocks[len(steps)]
        numbers = estimates_of(problem, minimum)
        steps.append(
            RecursionStep(
                e.name, float(e.t[-1]), minimum.loss, minimum.evaluations, now - last, numbers
            )
        )
        last = now
        if progress:
            progress(fitter.name, len(steps), len(blocks), f"loss {minimum.loss:.6g}")
    problem, minimum = found[-1]
    total = replace(minimum, evaluations=sum(m.evaluations for _, m in found))
    notes = [statement(recursion, len(blocks))]
    if recursion.window is None:
        notes.append("standard deviations take the residuals of earlier blocks as white")
    if binding.chain.has_states():
        notes.append(
            "what remembers the motion (delays, springs, sensors) begins anew in every block"
        )
    fit = assemble(
        bench=bench,
        problem=problem,
        result=total,
        residual=residual,
        fitter=label_of(fitter),
        seed=seed,
        compile_time=benches.compile_time(),
        wall_time=0.0,
        notes=notes,
    )
    return replace(fit, recursion=tuple(steps), wall_time_s=time.perf_counter() - began)


def statement(recursion: RecursionSettings, count: int) -> str:
    """What the numbers of such a fit are of."""
    if recursion.window is not None:
        weighed = (
            ""
            if recursion.forgetting == 1
            else f", each block {recursion.forgetting:g} times the one after it"
        )
        return (
            f"{count} recursions; each fits its last {recursion.window} blocks{weighed}; the"
            " numbers are the last one's"
        )
    forgets = (
        "nothing is forgotten"
        if recursion.forgetting == 1
        else f"what is known counts {recursion.forgetting:g} times as much with every block"
    )
    return (
        f"{count} recursions of one block each, what earlier blocks say carried on ({forgets}); the"
        " numbers are the last one's"
    )


def followed(
    fitter: AbstractFitter,
    problems: Iterator[FitProblem],
    guesses: list[np.ndarray],
    key: Any,
    budget: int | None,
) -> Iterator[Minimum]:
    """The best of each problem in turn: `sequential.follow` of a population, else a search from
    where the last one ended.
    """
    first = next(problems)
    starts = [first.z(g) for g in guesses]

    def again() -> Iterator[FitProblem]:
        yield first
        yield from problems

    if isinstance(fitter, AbstractPopulation):
        yield from follow(fitter, again(), starts, key, GENERATIONS, budget)
        return
    single = replace(fitter, restarts=0) if "restarts" in set(names_of(fields(fitter))) else fitter
    z, names = starts[0], first.names
    for number, problem in enumerate(again()):
        own = starts if number == 0 else [carried(z[None], names, problem)[0]]
        minimum = (single if number else fitter).minimise(
            problem, own, jax.random.fold_in(key, number), budget
        )
        z, names = minimum.z, problem.names
        yield minimum


def estimates_of(problem: FitProblem, minimum: Minimum) -> dict[str, tuple[float, float | None]]:
    """Name -> (value, standard deviation) of the fitted numbers."""
    cov = covariance(problem, minimum.z)
    theta, slope = problem.theta(minimum.z), problem.dtheta(minimum.z)
    estimates = {}
    for k, i in enumerate(problem.free):
        std = float(cov.std[k] * slope[k]) if np.isfinite(cov.std[k]) else None
        estimates[problem.names[k]] = (float(theta[i]), std)
    return estimates
