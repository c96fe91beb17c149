"""A study in words, for the terminal."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from jaxid.base import wording
from jaxid.report import text


if TYPE_CHECKING:
    from jaxid.study.outcome import Outcome
    from jaxid.study.plan import Study
    from jaxid.study.run import Status, StudyProgress, StudyResult


#: Lines of a table on the terminal.
LINES = 30


def status_text(study: Study, outcomes: dict[str, Outcome], status: Status) -> str:
    """One sentence and one line for each dataset, model and fitter."""
    head = (
        f"{study.name}: {status.done} of {status.total} tasks done, {status.failed} failed,"
        f" {status.running} running"
    )
    return "\n".join([head, _progress_table(study, outcomes)])


def progress_text(p: StudyProgress) -> str:
    """The live table."""
    total, n = len(p.study.tasks), len(p.outcomes)
    rate = p.new / max(p.seconds, 1e-9)
    left = f", {duration((total - n) / rate)} left" if p.new else ""
    failed = sum(o.failed for o in p.outcomes.values())
    head = (
        f"{p.study.name}: {n} of {total} tasks done, {failed} failed, {p.running} running,"
        f" {duration(p.seconds)}{left}"
    )
    return "\n".join([head, _progress_table(p.study, p.outcomes)])


def _progress_table(study: Study, outcomes: dict[str, Outcome]) -> str:
    total: Counter[tuple[str, str, str]] = Counter()
    seen: dict[tuple[str, str, str], Counter[str]] = defaultdict(Counter)
    for key, task in study.tasks.items():
        line = task.label, task.system, task.method if task.command == "fit" else "diagnose"
        total[line] += 1
        if key in outcomes:
            seen[line][outcomes[key].status] += 1
    rows = []
    for line, count in total.items():
        own = seen[line]
        states = ", ".join(f"{n} {status}" for status, n in own.most_common())
        rows.append(
            (
                own.total() == count,
                [*(_short(name) for name in line), f"{own.total()}/{count}", states],
            )
        )
    rows.sort(key=lambda row: row[0])  # what is not finished first
    lines = [cells for _, cells in rows[:LINES]]
    more = f"\n… and {len(rows) - LINES} more lines" if len(rows) > LINES else ""
    return wording.table(("dataset", "model", "fitter", "done", "status"), lines) + more


def _short(name: str) -> str:
    name = text.one_line(name)
    return name if len(name) <= 40 else f"{name[:37]}..."


def duration(seconds: float) -> str:
    minutes, hours = seconds / 60, seconds / 3600
    if seconds < 90:
        return f"{seconds:.0f} s"
    return (
        f"{minutes:.0f} min"
        if minutes < 90
        else f"{hours:.1f} h"
        if hours < 48
        else f"{hours / 24:.1f} days"
    )


def result_text(result: StudyResult) -> str:
    """What was done, the ranking of the fitters, what was named, and where it stands."""
    from jaxid.study import tables
    from jaxid.study.page import ranking_row

    s = result.status
    parts = [
        f"{result.study.name}: {s.done} of {s.total} tasks have a result, {s.failed} failed"
        f" ({result.new} run now, in {duration(result.seconds)})"
    ]
    if rows := tables.rankings(result):
        header = (
            "fitter",
            "at the best loss",
            "mean rank",
            "median excess",
            "evaluations",
            "seconds",
            "failed",
        )
        parts.append(wording.table(header, [ranking_row(r) for r in rows]))
    if diagnosed := tables.verdicts(result)[:LINES]:
        header = ("diagnosed", "verdicts", "named")

        def counted(c):
            return ", ".join(f"{name or '-'} {n}" for name, n in c.most_common(4))

        parts.append(
            wording.table(
                header, [[_short(str(p)), counted(v), counted(n)] for p, v, n in diagnosed]
            )
        )
    for status, reason, count, which, _ in tables.failures(result)[:5]:
        parts.append(
            wording.wrapped(
                f"{count} {status}: {reason.splitlines()[0] if reason else 'no reason'} ({which})"
            )
        )
    if result.complete:
        parts.append(f"runs.parquet, runs.csv and report.html are in {result.study.store}")
    return "\n".join(parts)
