"""Which effects of a robot under goals look the same, and which its own numbers take up: to first
order, from the columns that a diagnosis compares, without a simulation for each.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from jaxid.diagnosis.goals.propose import shown
from jaxid.diagnosis.goals.study import LedStudy
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.dynamics.effect import Effect
from jaxid.problem.binding import Binding


def alike_under_goals(
    binding: Binding, library: Sequence[type[Effect]]
) -> tuple[dict[tuple[str, str], float], list[frozenset[tuple[str, str]]], list[str]]:
    """(effect, place) -> the share of its change that re-tuning the model's numbers leaves; pairs
    that are alike; effects that have a motion of their own and are not compared. `binding` has no
    candidates.
    """
    kinds = [k for k in library if shown(k)]
    study = LedStudy(binding, kinds)
    rows, _ = study.rows_with_effects(study.theta)

    def flat(parts):
        return np.concatenate([x.reshape(-1, x.shape[2]) for x in parts])

    own = _span(flat([x[:, :, : rows.size] for x in rows.rows]))
    left: dict[tuple[str, str], float] = {}
    rest: dict[tuple[str, str], list[np.ndarray]] = {}
    for u in rows.units:
        column = flat(u.columns)
        place = (u.effect, u.location)
        beside = column - own @ (own.T @ column)
        share = float(np.linalg.norm(beside) / max(float(np.linalg.norm(column)), 1e-300))
        left[place] = max(left.get(place, 0.0), share)
        rest.setdefault(place, []).append(beside)
    seen = [p for p in left if left[p] > LIMITS.equivalent]
    pairs = [
        frozenset(pair)
        for pair in itertools.combinations(seen, 2)
        if _alike(*(rest[p] for p in pair))
    ]
    return left, pairs, sorted(k.name for k in library if not shown(k))


def _span(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of columns [n k], those that are nearly others left out."""
    size = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    return u[:, s > 1e-6 * s[0]] if s.size else np.zeros((len(columns), 0))


def _alike(a: Sequence[np.ndarray], b: Sequence[np.ndarray]) -> bool:
    """Whether each shape of one is what some shape of the other can do, and the other way round."""

    def inside(x, y):
        return np.linalg.norm(x - (q := _span(y)) @ (q.T @ x)) < LIMITS.equivalent * np.linalg.norm(
            x
        )

    return all(any(inside(x, y) for y in b) for x in a) and all(
        any(inside(y, x) for x in a) for y in b
    )
