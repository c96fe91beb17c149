"""Fits of limbs that do not move each other, one by one, put together as one result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from jaxid.data.dataset import Dataset
from jaxid.fitting.result import Covariance, Estimate, Fit, Score
from jaxid.robots.origin import joined


def together(fits: Sequence[Fit], dataset: Dataset) -> Fit:
    """One result of the fits of all limbs."""
    first = fits[0]
    weight = np.array(list(map(_channels, fits)), float)
    scores: dict[str, dict[str, Score]] = {}
    parameters: dict[str, Estimate] = {}
    windowed: dict[str, Score] = {}
    notes: dict[str, None] = {}
    for fit in fits:
        parameters |= fit.parameters
        windowed |= fit.windowed
        notes |= dict.fromkeys(fit.notes)
        for split, table in fit.scores.items():
            scores.setdefault(split, {}).update(table)
    failed = [f for f in fits if f.failed]
    unfinished = [f for f in fits if not f.converged]
    stopped = [*failed, *unfinished, first][0]
    return replace(
        first,
        effects=_one_after_another(f.effects for f in fits),
        converged=not unfinished,
        failed=bool(failed),
        stopped_because=stopped.stopped_because,
        loss=float(np.sum(weight * [f.loss for f in fits]) / weight.sum()),
        parameters=parameters,
        scores=scores,
        windowed=windowed,
        evaluations=sum(f.evaluations for f in fits),
        wall_time_s=sum(f.wall_time_s for f in fits),
        compile_time_s=sum(f.compile_time_s for f in fits),
        dataset=dataset.name,
        dataset_sha256=dataset.sha256,
        notes=(*notes, f"{len(fits)} limbs that do not move each other were fitted one by one"),
        correlated=_one_after_another(f.correlated for f in fits),
        history=_one_after_another(f.history for f in fits),
        traces=_one_after_another(f.traces for f in fits),
        theta=np.zeros(0),
        stated=_one_after_another(f.stated for f in fits),
        per_joint=_one_after_another(f.per_joint for f in fits),
        robot=joined([f.robot for f in fits]),
        covariance=_side_by_side(fits),
    )


def _channels(fit: Fit) -> int:
    """How many channels a fit is scored by, at least 1."""
    return max(1, len(next(iter(fit.scores.values()), {})))


def _one_after_another(parts: Iterable[Sequence[Any]]) -> tuple[Any, ...]:
    return tuple(chain.from_iterable(parts))


def _side_by_side(fits: Sequence[Fit]) -> Covariance | None:
    own = [f.covariance for f in fits if f.covariance is not None]
    if len(own) < len(fits):
        return None
    names = _one_after_another(c.names for c in own)
    return Covariance(names, np.asarray(block_diag(*(c.matrix for c in own))))


def each(
    limbs: Sequence[tuple[Any, Dataset]], work: Callable[[Any, Dataset], Fit], dataset: Dataset
) -> Fit:
    """The work done for each limb, put together."""
    fits = [work(robot, data) for robot, data in limbs]
    return together(fits, dataset) if len(fits) > 1 else fits[0]
