"""Many searches on one problem, and what they look like: the same loss and bounds for every method
and seed.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from jaxid.fitting.fitter import AbstractFitter, Minimum
from jaxid.fitting.population import AbstractPopulation
from jaxid.problem.problem import FitProblem
from jaxid.report import plot
from jaxid.report.compared import COLORS, DIVERGED
from jaxid.study.papers.result import Picture


class Searched(NamedTuple):
    """The runs of one method, a seed each; `seconds` of a run, with its share of compiling."""

    label: str
    found: tuple[Minimum, ...]
    seconds: float
    numbers: dict[str, float]  # of the best run

    @property
    def losses(self) -> Float[np.ndarray, " seeds"]:
        return np.array([f.loss for f in self.found])

    @property
    def best(self) -> Minimum:
        return self.found[int(np.argmin(self.losses))]

    @property
    def evaluations(self) -> int:
        return int(np.median([f.evaluations for f in self.found]))

    def reached(self, goal: float) -> list[int]:
        """Evaluations of the runs that came to the goal, when they did."""
        counts = []
        for found in self.found:
            there = [n for n, loss in found.history if loss <= goal]
            counts += there[:1]
        return counts


def race(
    problem: FitProblem,
    methods: Mapping[str, AbstractFitter],
    seeds: Sequence[int],
    budget: int | None = None,
) -> list[Searched]:
    """Every method with every seed. Populations begin in the whole bounds, no start among their
    members; what needs a start gets a random one there, the same for all with one seed.
    """
    out = []
    for label, method in methods.items():
        began = time.perf_counter()
        jobs = []
        for seed in seeds:
            starts = []
            if not isinstance(method, AbstractPopulation):
                starts = [random_start(problem, seed)]
            jobs.append((problem, starts, jax.random.key(seed)))
        found = tuple(method.minimise_each(jobs, budget))
        spent = (time.perf_counter() - began) / len(seeds)
        out.append(
            Searched(label, found, spent, numbers_of(problem, min(found, key=lambda f: f.loss).z))
        )
    return out


def random_start(problem: FitProblem, seed: int) -> Float[np.ndarray, " size"]:
    return problem.lower + (problem.upper - problem.lower) * np.random.default_rng(seed).uniform(
        size=problem.size
    )


def numbers_of(problem: FitProblem, z: np.ndarray) -> dict[str, float]:
    """The fitted numbers at z, by name."""
    theta = problem.theta(z)
    return {problem.runs.layout.names[i]: float(theta[i]) for i in problem.free}


def mean_sd(values: np.ndarray, digits: int = 2) -> str:
    """`0.0174 ± 0.0015`: mean and standard deviation, to the digits that this leaves."""
    if len(values) < 2:
        return f"{np.mean(values):.{digits + 1}g}"
    mean, sd = float(np.mean(values)), float(np.std(values, ddof=1))
    if not sd > 0:
        return f"{mean:.{digits + 1}g} ± 0"
    places = max(0, digits - 1 - int(np.floor(np.log10(sd))))
    return f"{mean:.{places}f} ± {sd:.{places}f}"


def in_order(numbers: Mapping[str, float], names: Iterable[str]) -> list[float]:
    """The numbers by their names, as the cells of a row."""
    return [numbers[name] for name in names]


def course(
    name: str, caption: str, runs: Sequence[Searched], ylabel: str, factor: float = 1.0
) -> Picture:
    """Median of the best loss so far over evaluations, with the band of all seeds."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for run, color in zip(runs, COLORS, strict=False):
            histories = [np.array(f.history).T for f in run.found]
            grid = np.unique(np.concatenate([counts for counts, _ in histories]))
            curves = factor * np.array([np.interp(grid, *history) for history in histories])
            seen = curves.max(0) < DIVERGED  # before a simulation held there is nothing to draw
            grid, curves = grid[seen], curves[:, seen]
            axes.fill_between(
                grid, curves.min(0), curves.max(0), color=color, alpha=0.13, linewidth=0
            )
            axes.plot(grid, np.median(curves, 0), color=color, label=run.label)
        axes.set(xscale="log", yscale="log", xlabel="evaluations of the loss", ylabel=ylabel)
        plot.plain_log(axes.xaxis)
        plot.plain_log(axes.yaxis)
        plot.legend(figure, axes.get_legend_handles_labels()[0], 8, "outside upper center")

    return Picture(name, caption, (9.2, 3.8), draw)


def dispersion(
    name: str, caption: str, runs: Sequence[Searched], xlabel: str, factor: float = 1.0
) -> Picture:
    """A dot a run, a line a method."""

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        for row, (run, color) in enumerate(zip(runs, COLORS, strict=False)):
            shift = np.linspace(-0.2, 0.2, len(run.found)) if len(run.found) > 1 else np.zeros(1)
            axes.scatter(
                factor * run.losses, row + shift, s=16, color=color, alpha=0.75, linewidths=0
            )
            axes.plot(
                [factor * np.mean(run.losses)] * 2, [row - 0.3, row + 0.3], color=color, linewidth=2
            )
        axes.set(xscale="log", xlabel=xlabel, ylim=(len(runs) - 0.5, -0.5))
        axes.set_yticks(range(len(runs)), [run.label for run in runs])
        plot.plain_log(axes.xaxis)

    return Picture(name, caption, (9.2, 0.9 + 0.42 * len(runs)), draw)


def lines(
    name: str,
    caption: str,
    panels: Sequence[tuple[str, str, Mapping[str, tuple[np.ndarray, np.ndarray]]]],
    **axis: str,
) -> Picture:
    """Panels (x label, y label, curves by label) side by side; a label has one colour, the first of
    all is drawn as measured.
    """
    labels: list[str] = []
    for _, _, curves in panels:
        labels += [label for label in curves if label not in labels]

    def draw(figure: Figure) -> None:
        grid = np.atleast_1d(np.asarray(figure.subplots(1, len(panels))))
        for axes, (xlabel, ylabel, curves) in zip(grid, panels, strict=True):
            for label, (x, y) in curves.items():
                k = labels.index(label)
                color, width = (plot.BLACK, 1.8) if k == 0 else (COLORS[(k - 1) % len(COLORS)], 1.1)
                axes.plot(*plot.thin(x, plot.series(y)), color=color, linewidth=width, label=label)
            axes.set(xlabel=xlabel, ylabel=ylabel, **axis)
            if axis.get("yscale") == "log":
                plot.plain_log(axes.yaxis)
        plot.legend(figure, grid[0].get_legend_handles_labels()[0], 8, "outside upper center")

    return Picture(name, caption, (9.2, 3.4), draw)
