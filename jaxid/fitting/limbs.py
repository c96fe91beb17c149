"""Fits of limbs that do not move each other, one by one, put together as one result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from jaxid.data.dataset import Dataset
from jaxid.fitting.result import Covariance, Fit, Score
from jaxid.robots.origin import joined


def together(fits: Sequence[Fit], dataset: Dataset) -> Fit:
    """One result of the fits of all limbs."""
    first = fits[0]
    weight = np.array([max(1, len(next(iter(f.scores.values()), {}))) for f in fits], float)
    scores: dict[str, dict[str, Score]] = {}
    for f in fits:
        for split, table in f.scores.items():
            scores.setdefault(split, {}).update(table)
    windows = {k: v for f in fits for k, v in f.windowed.items()}
    stopped = next((f for f in fits if f.failed), next((f for f in fits if not f.converged), first))
    notes = dict.fromkeys(n for f in fits for n in f.notes)
    return replace(
        first,
        effects=tuple(e for f in fits for e in f.effects),
        converged=all(f.converged for f in fits),
        failed=any(f.failed for f in fits),
        stopped_because=stopped.stopped_because,
        loss=float(np.sum(weight * [f.loss for f in fits]) / weight.sum()),
        parameters={k: v for f in fits for k, v in f.parameters.items()},
        scores=scores,
        windowed=windows,
        evaluations=sum(f.evaluations for f in fits),
        wall_time_s=sum(f.wall_time_s for f in fits),
        compile_time_s=sum(f.compile_time_s for f in fits),
        dataset=dataset.name,
        dataset_sha256=dataset.sha256,
        notes=(*notes, f"{len(fits)} limbs that do not move each other were fitted one by one"),
        correlated=tuple(g for f in fits for g in f.correlated),
        history=tuple(h for f in fits for h in f.history),
        traces=tuple(t for f in fits for t in f.traces),
        theta=np.zeros(0),
        stated=tuple(r for f in fits for r in f.stated),
        per_joint=tuple(r for f in fits for r in f.per_joint),
        robot=joined([f.robot for f in fits]),
        covariance=_side_by_side(fits),
    )


def _side_by_side(fits: Sequence[Fit]) -> Covariance | None:
    own = [f.covariance for f in fits if f.covariance is not None]
    if len(own) < len(fits):
        return None
    return Covariance(
        tuple(n for c in own for n in c.names), np.asarray(block_diag(*(c.matrix for c in own)))
    )


def each(
    limbs: Sequence[tuple[Any, Dataset]], work: Callable[[Any, Dataset], Fit], dataset: Dataset
) -> Fit:
    """The work done for each limb, put together."""
    fits = [work(robot, data) for robot, data in limbs]
    return together(fits, dataset) if len(fits) > 1 else fits[0]
