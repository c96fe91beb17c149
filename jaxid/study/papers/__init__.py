"""The four papers this library began with, done again: one module each, on twins written apart from
the library.

Nobody's recordings of the four rigs are published, so nothing here claims agreement with them. What
is compared: which parameters come back, how the algorithms rank, and how large the published
differences are beside the scatter of our own runs.
"""

from __future__ import annotations

import importlib
import time
from typing import Any, NamedTuple

from jaxid.base.errors import nearest, UsageError
from jaxid.base.interim import Interim
from jaxid.base.stopping import Interrupted
from jaxid.fitting.fitter import Progress
from jaxid.study.papers.result import Reproduction


BUDGETS = ("small", "full")


class Paper(NamedTuple):
    """A paper; `module` has `study(size) -> Iterator[Part]`, in `parts` parts, and its `SIZES` by
    budget.
    """

    title: str
    doi: str
    module: str
    parts: int
    about: str


PAPERS = {
    "000": Paper(
        "Recursive differential evolution for a space manipulator",
        "10.5772/63935",
        "space_manipulator",
        5,
        "The public copies of this paper have lost all equations, table values and figures: the"
        " plane two-joint arm, the Stribeck law, bounds, trajectory and the algorithm's details are"
        " this library's reading of its words.",
    ),
    "001": Paper(
        "Online identification of a payload by parameter difference (UR10)",
        "10.1017/S026357472400105X",
        "payload",
        4,
        "The twin has the paper's kinematics, friction and noise level, with the bodies nearest to"
        " its Table VI that can exist (the printed inertias belong to no body); its excitation"
        " coefficients and drive gains are lost.",
    ),
    "002": Paper(
        "Parameters of a flexible link by evolutionary algorithms",
        "10.3390/machines12060409",
        "flexible_link",
        4,
        "The twin is a separately written finite-element model at the paper's own answer, under a"
        " pulse that turns it by the 80 degrees of the published version; amplitudes, rates and"
        " noise are not in the paper.",
    ),
    "003": Paper(
        "Parameters of a vision-based target tracker by a genetic algorithm",
        "10.5829/ije.2018.31.03c.11",
        "tracker",
        5,
        "The twin integrates the paper's equations, the missing length of (4) put in, at the"
        " paper's own answer; levels, durations and rate of its input, its bounds and its"
        " generations are not in the text.",
    ),
}


def reproduce(paper: str, budget: str = "small", progress: Progress | None = None) -> Reproduction:
    """One paper, whole: its experiments on a twin, its claims beside our numbers.

    `budget`: small (minutes on two cores) or full (the paper's settings throughout, more seeds).
    Raises `UsageError` for an unknown paper or budget, and `Interrupted` with the parts that were
    finished.
    """
    if paper not in PAPERS:
        raise UsageError(
            f"there is no paper {paper!r}{nearest(paper, PAPERS)}; there is {', '.join(PAPERS)}"
        )
    if budget not in BUDGETS:
        raise UsageError(
            f"there is no budget {budget!r}{nearest(budget, BUDGETS)}; there is"
            f" {' and '.join(BUDGETS)}"
        )
    known = PAPERS[paper]
    module: Any = importlib.import_module(f"jaxid.study.papers.{known.module}")
    began, parts, interim = time.perf_counter(), [], Interim()

    def finished() -> Reproduction:
        return Reproduction(
            paper,
            known.title,
            known.doi,
            known.about,
            budget,
            tuple(parts),
            time.perf_counter() - began,
        )

    try:
        for part in module.study(module.SIZES[budget]):
            parts.append(part)
            interim.offer(finished)
            if progress:
                progress("reproduce", len(parts), known.parts, part.title)
    except KeyboardInterrupt as stop:
        raise Interrupted(finished() if parts else None) from stop
    return finished()
