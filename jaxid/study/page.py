"""The page of a study: what was run, how the fitters did, what was named, what failed and why."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxid.base import wording
from jaxid.base.wording import listed, one_line
from jaxid.report import comparison_text, plot, write_page
from jaxid.report.compared import COLORS, LOWEST, MARKERS
from jaxid.report.page import render, Section
from jaxid.study.machines import CommonNumber, Kind, kinds


if TYPE_CHECKING:
    from jaxid.study.outcome import Outcome
    from jaxid.study.plan import Task
    from jaxid.study.run import StudyResult
    from jaxid.study.tables import StudyProblem


#: Problems that are drawn and listed; a study may have thousands.
MOST = 24
RIGHT = 1e6  # where runs that failed are drawn, as a multiple of the best loss


def section(result: StudyResult) -> Section:
    from jaxid.study import tables

    problems = tables.problems(result)
    shown = dict(sorted(problems.items(), key=lambda item: -_spread(item[1]))[:MOST])
    fitters = [r.fitter for r in tables.rankings(result)]
    return Section(
        "studied.html",
        {
            "name": result.study.name,
            "description": result.study.description,
            "headline": headline(result),
            "ranking": [ranking_row(r) for r in tables.rankings(result)],
            "tolerance": wording.percent(tables.TOLERANCE),
            "left_out": len(problems) - len(shown),
            "losses": (
                plot.svg(
                    "losses", (9.2, 1.1 + 0.42 * len(shown)), lambda f: _losses(shown, fitters, f)
                )
                if shown
                else None
            ),
            "seconds": (
                plot.svg("seconds", (9.2, 2.8), lambda f: _seconds(result, fitters, f))
                if shown
                else None
            ),
            "problems": [(str(p), *problem_row(runs)) for p, runs in shown.items()],
            "verdicts": [
                (str(p), _counted(v), _counted(n))
                for p, v, n in tables.verdicts(result)[: 10 * MOST]
            ],
            "kinds": [(title_of(k), list(map(machine_row, k.numbers))) for k in kinds(result)],
            "failures": tables.failures(result)[:MOST],
            "notes": result.notes,
            "store": str(result.study.store),
        },
    )


def title_of(kind: Kind) -> str:
    """`5 machines of arm, with dead_zone@tau`."""
    beside = f", with {listed(kind.effects)}" if kind.effects else ""
    return f"{len(kind.machines)} machines of {one_line(kind.model)}{beside}"


def machine_row(number: CommonNumber) -> list[str]:
    """A number of a kind of machines: name, mean, spread, range of a further one, which differ."""
    low, high = number.interval_95
    told = "machines are equal, as far as the data tell"
    if number.differs:
        machine = number.furthest
        told = f"machines differ; furthest: {one_line(machine)}"
        told += f", {wording.number(number.each[machine][0], 4)}"
    return [
        one_line(number.name),
        wording.value_with_std(number, unit=False),
        wording.number(number.spread, 2),
        f"{wording.number(low, 3)} to {wording.number(high, 3)}",
        one_line(number.unit),
        told,
    ]


def headline(result: StudyResult) -> str:
    s = result.status
    done = f"{s.done} of {s.total} tasks have a result"
    return f"{done}, {s.failed} failed." if s.failed else f"{done}."


def ranking_row(r) -> list[str]:
    """The cells that terminal and report share."""
    low, high = r.reached_interval_95
    return [
        wording.one_line(r.fitter),
        f"{r.reached}/{r.runs} ({100 * low:.0f} to {100 * high:.0f} %)",
        wording.number(r.mean_rank, 3),
        "∞" if np.isinf(r.excess) else wording.percent(r.excess) if r.excess > 0 else "0 %",
        comparison_text.count(r.evaluations) if np.isfinite(r.evaluations) else "–",
        wording.number(r.seconds, 2) if np.isfinite(r.seconds) else "–",
        str(r.failed),
    ]


def _spread(runs) -> float:
    """Problems on which fitters differ come first."""
    from jaxid.study.tables import best_loss, excess

    best = best_loss(runs)
    return float(np.mean([min(excess(o, best), RIGHT) for _, o in runs]))


def problem_row(runs) -> tuple[str, list[tuple[str, str]]]:
    """The best loss of a problem, and of each parameter the middle and the range from the 10th to
    the 90th percentile of the runs that reached it.
    """
    from jaxid.study.tables import best_loss, excess, TOLERANCE

    best = best_loss(runs)
    values: dict[str, list[float]] = {}
    for _, outcome in runs:
        if excess(outcome, best) > TOLERANCE:
            continue
        for name, value in (outcome.parameters or {}).items():
            values.setdefault(name, [])
            if value is not None:
                values[name].append(value)
    ranges = [(name, _range_text(found)) for name, found in values.items() if found]
    return (wording.number(best, 4) if np.isfinite(best) else "none"), ranges


def _range_text(values: Sequence[float]) -> str:
    low, middle, high = np.percentile(values, [10, 50, 90])
    if high - low <= 1e-6 * abs(middle):
        return wording.number(middle, 4)
    return f"{wording.number(middle, 4)} ({wording.number(low, 4)} to {wording.number(high, 4)})"


def _counted(counts) -> str:
    """`named 3×, unknown 1×`; a single one without its count."""
    if counts.total() == 1:
        return next(iter(counts)) or "–"
    return ", ".join(f"{name or '–'} {n}×" for name, n in counts.most_common(6))


def _losses(
    shown: dict[StudyProblem, list[tuple[Task, Outcome]]], fitters: list[str], figure
) -> None:
    from jaxid.study.tables import best_loss, excess, TOLERANCE

    axes = figure.add_subplot()
    points: dict[str, list[tuple[float, float]]] = {fitter: [] for fitter in fitters}
    for k, runs in enumerate(shown.values()):
        best = best_loss(runs)
        for task, o in runs[:: max(1, len(runs) // plot.POINTS)]:
            line = k + 0.7 * ((fitters.index(task.method) + 0.5) / len(fitters) - 0.5)
            x = float(np.clip(excess(o, best), LOWEST, RIGHT))
            points[task.method].append((x, line + 0.25 / len(fitters) * np.sin(7.0 * task.seed)))
    for j, (fitter, own) in enumerate(points.items()):
        color, marker = COLORS[j % len(COLORS)], MARKERS[(j // len(COLORS)) % len(MARKERS)]
        x, y = np.array(own).reshape(-1, 2).T
        axes.scatter(
            x,
            y,
            s=12,
            marker=marker,
            color=color,
            alpha=0.7,
            linewidths=0,
            label=plot.label(fitter, 20),
        )
    axes.axvline(TOLERANCE, color=plot.GREY, linestyle="--", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_yticks(range(len(shown)), [plot.label(str(p), 40) for p in shown])
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.set_xlabel("loss above the best, as a share of it (at the right edge: failed)")
    plot.plain_log(axes.xaxis)
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside upper center", ncols=min(8, len(fitters))
    )


def _seconds(result: StudyResult, fitters: list[str], figure) -> None:
    left, right = figure.subplots(1, 2)
    for axes, field, title in (
        (left, "wall_time_s", "seconds of a task"),
        (right, "evaluations", "evaluations of a run"),
    ):
        for j, fitter in enumerate(fitters):
            values = [
                getattr(o, field)
                for k, o in result.outcomes.items()
                if result.study.tasks[k].command == "fit"
                and result.study.tasks[k].method == fitter
                and getattr(o, field)
            ]
            if values:
                x = np.quantile(values, np.linspace(0, 1, min(len(values), 200)))
                label = plot.label(fitter, 20)
                axes.step(
                    x,
                    (np.arange(len(x)) + 1) / len(x),
                    where="post",
                    color=COLORS[j % len(COLORS)],
                    label=label,
                )
        axes.set_xscale("log")
        plot.plain_log(axes.xaxis)
        axes.set_xlabel(title)
        axes.set_ylim(0, 1.02)
    left.set_ylabel("share of runs")
    figure.legend(
        *right.get_legend_handles_labels(),
        loc="outside upper center",
        ncols=min(8, max(1, len(fitters))),
    )


def study_page(result: StudyResult, table: bytes) -> str:
    """The page of a study, whose results are the `table` runs.csv."""
    return render(f"{one_line(result.study.name)}: study", [section(result)], "runs.csv", table)


def write_study(result: StudyResult, path: str | Path) -> Path:
    """Writes the page of a study (whole or not at all) and returns its path; raises `NotSaved`."""
    from jaxid.study.tables import csv_text, table_rows

    return write_page(study_page(result, csv_text(*table_rows(result)).encode()), path)
