"""What a study leaves behind when it is complete: runs.parquet, runs.csv, report.html; and the
figures that they share.
"""

from __future__ import annotations

import csv
import io
import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TYPE_CHECKING

import numpy as np

from jaxid.base.atomic_files import replace_files
from jaxid.base.serialise import SCHEMA
from jaxid.base.wording import one_line
from jaxid.study.machines import kinds
from jaxid.study.plan import Task
from jaxid.study.store import Store


if TYPE_CHECKING:
    from jaxid.study.outcome import Outcome
    from jaxid.study.run import StudyResult


#: Columns of the tables; one per parameter follows.
COLUMNS = (
    "dataset",
    "model",
    "effects",
    "fitter",
    "seed",
    "status",
    "loss",
    "evaluations",
    "wall_time_s",
    "compile_time_s",
)
#: A run has reached the best loss of its problem when it lies within this share of it.
TOLERANCE = 1e-3
#: What a spreadsheet takes for the beginning of a formula.
FORMULA = ("=", "+", "-", "@", "\t", "\r", "'")


@dataclass(frozen=True)
class StudyProblem:
    """What fitters and seeds have in common."""

    dataset: str
    model: str
    effects: tuple[str, ...]
    residual: str

    def __str__(self) -> str:
        parts = [
            f"{self.dataset}, {self.model}",
            *([f"with {', '.join(self.effects)}"] if self.effects else []),
        ]
        return " ".join(parts) + (f" ({self.residual})" if self.residual else "")


@dataclass(frozen=True)
class Ranking:
    """How one fitter did over all problems of a study. A rank counts from 1 within a problem, by
    the median loss.
    """

    fitter: str
    runs: int
    failed: int
    reached: int
    reached_interval_95: tuple[float, float]
    mean_rank: float
    excess: float  # median over its runs of the loss above the best of the problem, as a share
    evaluations: float  # medians of a run
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        from jaxid.base.serialise import finite

        own = vars(self) | {"reached_interval_95": list(self.reached_interval_95)}
        return finite(own)


def problem_of(task: Task) -> StudyProblem:
    return StudyProblem(
        task.label,
        task.system,
        task.effects or (),
        " ".join(filter(None, (task.residual, task.loss))),
    )


def problems(result: StudyResult) -> dict[StudyProblem, list[tuple[Task, Outcome]]]:
    """The fits of a study by what they fitted."""
    out: dict[StudyProblem, list[tuple[Task, Outcome]]] = defaultdict(list)
    for key, outcome in result.outcomes.items():
        task = result.study.tasks[key]
        if task.command == "fit":
            out[problem_of(task)].append((task, outcome))
    return dict(out)


def best_loss(runs: Sequence[tuple[Task, Outcome]]) -> float:
    """The lowest loss of the runs of a problem; infinite where all failed."""
    return min((o.loss for _, o in runs if not o.failed and o.loss is not None), default=np.inf)


def excess(outcome: Outcome, best: float) -> float:
    """How far a run's loss lies above the best, as a share of it; infinite for a run that
    failed.
    """
    if outcome.failed or outcome.loss is None or not np.isfinite(best):
        return np.inf
    return max(0.0, (outcome.loss - best) / max(abs(best), 1e-12))


def rankings(result: StudyResult) -> list[Ranking]:
    """One line a fitter: most runs at the best loss first, then fewest evaluations."""
    from jaxid.fitting.comparison import wilson

    shares: dict[str, list[float]] = defaultdict(list)
    ranks: dict[str, list[float]] = defaultdict(list)
    outcomes: dict[str, list[Outcome]] = defaultdict(list)
    for runs in problems(result).values():
        best = best_loss(runs)
        own: dict[str, list[float]] = defaultdict(list)
        for task, outcome in runs:
            outcomes[task.method].append(outcome)
            own[task.method].append(excess(outcome, best))
        middle = {fitter: _median(values) for fitter, values in own.items()}
        for fitter, values in own.items():
            shares[fitter] += values
            lower = sum(_below(m, middle[fitter]) for m in middle.values())
            equal = sum(_equal(m, middle[fitter]) for m in middle.values())
            ranks[fitter].append(lower + (equal + 1) / 2)
    out = []
    for fitter, values in shares.items():
        reached, n = sum(v <= TOLERANCE for v in values), len(values)
        out.append(
            Ranking(
                fitter=fitter,
                runs=n,
                failed=sum(o.failed for o in outcomes[fitter]),
                reached=reached,
                reached_interval_95=wilson(reached, n),
                mean_rank=float(np.mean(ranks[fitter])),
                excess=_median(values),
                evaluations=_median(
                    [o.evaluations for o in outcomes[fitter] if o.evaluations is not None]
                ),
                seconds=_median(
                    [o.wall_time_s for o in outcomes[fitter] if o.wall_time_s is not None]
                ),
            )
        )
    return sorted(
        out, key=lambda r: (-r.reached / r.runs, np.nan_to_num(r.evaluations, nan=np.inf), r.fitter)
    )


def _median(values: Sequence[float]) -> float:
    """The middle value, the upper of two where one is infinite."""
    x = np.sort(np.array(values, float))
    if not x.size:
        return np.nan
    middle = x[(x.size - 1) // 2 : x.size // 2 + 1]
    return float(middle[-1] if np.isinf(middle).any() else middle.mean())


def _equal(a: float, b: float) -> bool:
    return a == b or abs(a - b) <= 1e-9


def _below(a: float, b: float) -> bool:
    return a < b and not _equal(a, b)


def verdicts(result: StudyResult) -> list[tuple[StudyProblem, Counter[str], Counter[str]]]:
    """Of each problem that was diagnosed: how often each verdict came, and each set of named
    effects.
    """
    out: dict[StudyProblem, tuple[Counter[str], Counter[str]]] = {}
    for key, o in result.outcomes.items():
        task = result.study.tasks[key]
        if task.command == "diagnose":
            verdict, named = out.setdefault(problem_of(task), (Counter(), Counter()))
            verdict[o.verdict if not o.failed else o.status] += 1
            if o.verdict in ("named", "partly"):
                named[" and ".join(o.named)] += 1
    return [(p, *counts) for p, counts in out.items()]


def failures(result: StudyResult) -> list[tuple[str, str, int, str, str]]:
    """(status, reason, how many, which tasks, the end of the first one's log), most frequent
    first.
    """
    found: dict[tuple[str, str], list[str]] = defaultdict(list)
    logs: dict[tuple[str, str], str] = {}
    for key, o in result.outcomes.items():
        if o.failed:
            task = result.study.tasks[key]
            found[o.status, o.reason].append(f"{problem_of(task)}, {task.method}, seed {task.seed}")
            logs.setdefault((o.status, o.reason), o.log)
    ordered = sorted(found.items(), key=lambda item: -len(item[1]))
    return [(*what, len(who), _some(who), logs[what]) for what, who in ordered]


def _some(names: Sequence[str], most: int = 3) -> str:
    rest = len(names) - most
    return "; ".join(names[:most]) + (f"; and {rest} more" if rest > 0 else "")


# ---- files


def table_rows(result: StudyResult) -> tuple[list[dict[str, Any]], list[str]]:
    """A row a task in the study's order, and the names of all parameters. A diagnosis states the
    effects that it names.
    """
    rows, names = [], {}
    for key, o in result.outcomes.items():
        task = result.study.tasks[key]
        parameters = dict(o.parameters or {})
        names |= dict.fromkeys(parameters)
        rows.append(
            {
                "dataset": task.label,
                "model": task.system,
                "effects": ",".join(task.effects or () if task.command == "fit" else o.named),
                "fitter": task.method,
                "seed": task.seed,
                "status": o.status,
                "loss": o.loss,
                "evaluations": o.evaluations,
                "wall_time_s": o.wall_time_s,
                "compile_time_s": o.compile_time_s,
                **{name: value for name, value in parameters.items() if name not in COLUMNS},
            }
        )
    return rows, [name for name in names if name not in COLUMNS]


def write_tables(result: StudyResult, store: Store) -> None:
    """Writes runs.parquet, runs.csv, report.html and, of several machines of a kind, machines.json
    into the store's folder, all or none.

    Raises `NotSaved` where they cannot be written; the results themselves are in the store.
    """
    from jaxid.study.page import study_page

    rows, names = table_rows(result)
    text = csv_text(rows, names).encode()
    page = study_page(result, text).encode()
    files = {"runs.parquet": _parquet(rows, names), "runs.csv": text, "report.html": page}
    found = kinds(result)
    if found:
        content = {"schema": SCHEMA, "kind": "machines", "kinds": [k.to_dict() for k in found]}
        files["machines.json"] = json.dumps(content, indent=1, allow_nan=False).encode()
    replace_files(store.folder, files)


def _parquet(rows: list[dict[str, Any]], names: Sequence[str]) -> bytes:
    import pyarrow
    import pyarrow.parquet

    text, whole = ("dataset", "model", "effects", "fitter", "status"), ("seed", "evaluations")

    kinds = dict.fromkeys((*COLUMNS, *names), pyarrow.float64())
    kinds |= dict.fromkeys(text, pyarrow.string()) | dict.fromkeys(whole, pyarrow.int64())
    schema = pyarrow.schema(list(kinds.items()))
    plain = []
    for row in rows:
        plain.append({name: _encodable(value) for name, value in row.items()})
    buffer = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(plain, schema), buffer)
    return buffer.getvalue()


def _encodable(value: Any) -> Any:
    """Text as UTF-8 can hold it (a path may hold lone surrogates)."""
    return value.encode("utf-8", "replace").decode() if isinstance(value, str) else value


def csv_text(rows: list[dict[str, Any]], names: Sequence[str]) -> str:
    """The table for a spreadsheet: text without control characters, and with a ' before what would
    be read as a formula. Numbers are written so that they are read back to the last bit.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer)
    columns = [*COLUMNS, *names]
    writer.writerow([cell(name) for name in columns])
    for row in rows:
        writer.writerow([cell(row.get(name)) for name in columns])
    return buffer.getvalue()


def cell(value: Any) -> str:
    """One cell of the spreadsheet."""
    if value is None:
        return ""
    if isinstance(value, str):
        value = one_line(value)
        return f"'{value}" if value.lstrip().startswith(FORMULA) else value
    return repr(value)
