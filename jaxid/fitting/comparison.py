"""Every fitter on one loss: what was run, and what it says, with intervals."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np

from jaxid.base.display import Displayed, displays
from jaxid.base.serialise import model_digest, plain, SCHEMA
from jaxid.base.versions import versions
from jaxid.conventions.finding import as_data, DataFinding


if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class FitterRun:
    """One fitter with one seed. `seconds` and the times of the history are without compiling;
    `parameters` in their units.
    """

    fitter: str
    seed: int
    status: str  # converged | stopped | failed
    stopped_because: str
    loss: float
    evaluations: int
    seconds: float
    wall_time_s: float
    compile_time_s: float
    parameters: dict[str, float]
    history: np.ndarray  # [points 3]: evaluations, seconds, best loss so far

    def reached(self, target: float) -> tuple[float, float]:
        """Evaluations and seconds until the loss was at most the target; infinite if it never
        was.
        """
        hit = np.flatnonzero(self.history[:, 2] <= target)
        if hit.size:
            return float(self.history[hit[0], 0]), float(self.history[hit[0], 1])
        return (float(self.evaluations), self.seconds) if self.loss <= target else (np.inf, np.inf)


@dataclass(frozen=True)
class Typical:
    """Median of a number over all runs of a fitter, with its 95 % interval by order statistics; a
    run that never reached the target counts as infinite.
    """

    median: float
    lower: float
    upper: float

    def to_dict(self) -> dict[str, Any]:
        return {"median": self.median, "interval_95": [self.lower, self.upper]}


@dataclass(frozen=True)
class Summary:
    """What the runs of one fitter say. Shares come with their 95 % Wilson interval."""

    fitter: str
    runs: int
    successes: int
    success_interval_95: tuple[float, float]
    in_time: int  # successes within the common time
    in_time_interval_95: tuple[float, float]
    evaluations_to_target: Typical
    seconds_to_target: Typical
    expected_evaluations: float  # all evaluations spent over successes: the cost of a success if failures are started again
    loss: Typical
    evaluations: float  # medians of what a run cost
    seconds: float
    compile_time_s: float  # the largest of a run: the first compiles, the others share its programs

    def to_dict(self) -> dict[str, Any]:
        return plain(
            {
                "fitter": self.fitter,
                "runs": self.runs,
                "successes": self.successes,
                "success_interval_95": self.success_interval_95,
                "successes_in_time": self.in_time,
                "success_in_time_interval_95": self.in_time_interval_95,
                "evaluations_to_target": self.evaluations_to_target,
                "seconds_to_target": self.seconds_to_target,
                "expected_evaluations": self.expected_evaluations,
                "loss": self.loss,
                "evaluations": self.evaluations,
                "seconds": self.seconds,
                "compile_time_s": self.compile_time_s,
            }
        )


@dataclass(frozen=True)
class BestKnown:
    """The best known value of a parameter, with its standard deviation there (None where the data
    do not determine it).
    """

    value: float
    std: float | None
    unit: str
    lower: float
    upper: float

    def to_dict(self) -> dict[str, Any]:
        return {
            "value": self.value,
            "std": self.std,
            "unit": self.unit,
            "lower": self.lower,
            "upper": self.upper,
        }


@dataclass(frozen=True, repr=False)
class Comparison(Displayed):
    """Every fitter, every seed, on the same compiled loss with the same budget.

    The target is the best known loss times 1 + `tolerance`; the best known loss is the lowest of
    all runs and of a descent from the best of them and from the start values that the data suggest.
    """

    model: str
    dataset: str
    dataset_sha256: str
    effects: tuple[str, ...]
    residual: str
    loss_name: str
    budget: int | None
    limit_s: float | None
    starts: str  # random | guess
    tolerance: float
    best_loss: float
    best: dict[str, BestKnown]
    runs: tuple[FitterRun, ...]
    wall_time_s: float
    notes: tuple[str, ...] = ()
    model_sha256: str = ""  # of the file of a model of the user's own
    data: tuple[DataFinding, ...] = ()  # what the recording says about itself

    @property
    def target(self) -> float:
        return self.best_loss * (1 + self.tolerance) + 1e-14

    @property
    def common_time(self) -> float:
        """The time at which fitters are compared: as given, else the median of what the runs
        took.
        """
        return (
            self.limit_s
            if self.limit_s is not None
            else float(np.median([r.seconds for r in self.runs] or [0.0]))
        )

    @property
    def fitters(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(r.fitter for r in self.runs))

    def of(self, fitter: str) -> tuple[FitterRun, ...]:
        return tuple(r for r in self.runs if r.fitter == fitter)

    @property
    def table(self) -> tuple[Summary, ...]:
        """One summary a fitter: most successes first, then fewest evaluations for one."""
        rows = [summary(f, self.of(f), self.target, self.common_time) for f in self.fitters]
        return tuple(
            sorted(
                rows, key=lambda s: (-s.successes / s.runs, s.expected_evaluations, s.loss.median)
            )
        )

    def to_frame(self) -> pandas.DataFrame:
        """A row for each run, its parameters as columns. Raises `UsageError` without pandas."""
        from jaxid.base.frames import frame

        columns = (
            "fitter",
            "seed",
            "status",
            "loss",
            "evaluations",
            "seconds",
            "wall_time_s",
            "compile_time_s",
            "stopped_because",
        )
        rows: list[dict[str, Any]] = []
        names: dict[str, float] = {}
        for run in self.runs:
            rows.append({c: getattr(run, c) for c in columns} | run.parameters)
            names |= run.parameters
        return frame(rows, (*columns, *names))

    def to_dict(self) -> dict[str, Any]:
        return plain(
            {
                "schema": SCHEMA,
                "kind": "comparison",
                "model": self.model,
                "effects": self.effects,
                "dataset": self.dataset,
                "dataset_sha256": self.dataset_sha256,
                **model_digest(self.model_sha256),
                "residual": self.residual,
                "loss_name": self.loss_name,
                "budget": self.budget,
                "limit_s": self.limit_s,
                "starts": self.starts,
                "tolerance": self.tolerance,
                "best_loss": self.best_loss,
                "target": self.target,
                "common_time_s": self.common_time,
                "best": self.best,
                "fitters": self.table,
                "runs": [self._row(r) for r in self.runs],
                "wall_time_s": self.wall_time_s,
                **as_data(self.data),
                "notes": self.notes,
                "versions": versions(),
            }
        )

    def _row(self, run: FitterRun) -> dict[str, Any]:
        evaluations, seconds = run.reached(self.target)
        return {
            "dataset": self.dataset,
            "model": self.model,
            "effects": ",".join(self.effects),
            "fitter": run.fitter,
            "seed": run.seed,
            "status": run.status,
            "stopped_because": run.stopped_because,
            "loss": run.loss,
            "evaluations": run.evaluations,
            "wall_time_s": run.wall_time_s,
            "compile_time_s": run.compile_time_s,
            "evaluations_to_target": evaluations if np.isfinite(evaluations) else None,
            "seconds_to_target": seconds if np.isfinite(seconds) else None,
            **run.parameters,
        }

    def save(self, folder: str | Path) -> Path:
        """Writes comparison.json, runs.parquet and report.html, all or none; returns the folder.
        Raises `NotSaved`.
        """
        from jaxid.report.result_files import save

        return save(self, Path(folder)).parent

    def parquet(self) -> bytes:
        """The content of a Parquet file with a row a run."""
        import pyarrow
        import pyarrow.parquet

        buffer = io.BytesIO()
        pyarrow.parquet.write_table(
            pyarrow.Table.from_pylist([self._row(r) for r in self.runs]), buffer
        )
        return buffer.getvalue()

    def plot(self, by: str = "evaluations", ax: Axes | None = None) -> Axes:
        """Draws the convergence of every fitter (median and band from the 10th to the 90th
        percentile of its seeds) over `evaluations` or `seconds`, on new axes or the given ones.
        """
        return displays().picture(self, by, ax)


def summary(fitter: str, runs: tuple[FitterRun, ...], target: float, common_time: float) -> Summary:
    """Statistics of one fitter's runs."""
    reached = np.array([r.reached(target) for r in runs])
    won, in_time = int(np.isfinite(reached[:, 0]).sum()), int(np.sum(reached[:, 1] <= common_time))
    evaluations = np.array([r.evaluations for r in runs])
    spent = float(np.sum(np.where(np.isinf(reached[:, 0]), evaluations, reached[:, 0])))
    return Summary(
        fitter=fitter,
        runs=len(runs),
        successes=won,
        success_interval_95=wilson(won, len(runs)),
        in_time=in_time,
        in_time_interval_95=wilson(in_time, len(runs)),
        evaluations_to_target=typical(reached[:, 0]),
        seconds_to_target=typical(reached[:, 1]),
        expected_evaluations=spent / won if won else np.inf,
        loss=typical(np.array([r.loss for r in runs])),
        evaluations=float(np.median([r.evaluations for r in runs])),
        seconds=float(np.median([r.seconds for r in runs])),
        compile_time_s=max(r.compile_time_s for r in runs),
    )


def wilson(successes: int, runs: int) -> tuple[float, float]:
    """95 % interval of a success rate (Wilson 1927)."""
    z, p = 1.959964, successes / runs
    middle, half = (
        p + z * z / (2 * runs),
        z * np.sqrt(p * (1 - p) / runs + z * z / (4 * runs * runs)),
    )
    low, high = (middle - half) / (1 + z * z / runs), (middle + half) / (1 + z * z / runs)
    return (0.0 if successes == 0 else float(low)), (1.0 if successes == runs else float(high))


def typical(values: np.ndarray) -> Typical:
    """Median and its interval by order statistics: at least 95 % where there are 6 values or more,
    else all that there is.
    """
    from scipy.stats import binom

    x = np.sort(values)
    n = len(x)
    k = max(0, int(np.sum(binom.cdf(np.arange(n), n, 0.5) <= 0.025)) - 1)
    middle = x[(n - 1) // 2 : n // 2 + 1]
    return Typical(
        float(middle[-1] if np.isinf(middle).any() else np.mean(middle)),
        float(x[k]),
        float(x[n - 1 - k]),
    )


def along(run: FitterRun, at: np.ndarray, column: int) -> np.ndarray:
    """Best loss of a run after this many evaluations (column 0) or seconds (1); infinite before its
    first.
    """
    x, loss = run.history[:, column], run.history[:, 2]
    index = np.searchsorted(x, at, side="right") - 1
    return np.where(index < 0, np.inf, loss[np.maximum(index, 0)])
