"""Errors of each joint of a robot: with its file as it stands, re-tuned, and with effects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.fitting.scores import free_runs, scores as scored, torque_scores
from jaxid.robots.yardstick import as_it_stands


def per_joint(
    bench: ProblemBuilder,
    scores: Mapping[str, Mapping[str, Any]],
    residual: Any = None,
    free: Any = (),
    before: np.ndarray | None = None,
) -> tuple[dict[str, Any], ...]:
    """Each joint's error (root mean square) with the file as it stands (simulated with the numbers
    `before`, by default its own) and re-tuned, on every split that was scored: of the free run, or
    of the torque where a `residual` without simulation is given.
    """
    binding = bench.binding
    theta, text = as_it_stands(binding)
    theta = theta if before is None else before
    out = []
    for split, table in scores.items():
        if residual is None:
            stated = scored(
                bench,
                split,
                free_runs(bench, split, [theta], estimate_starts(bench, split, [theta]))[0],
            )
            places = {j: j for j in table}
        else:
            stated = torque_scores(bench, residual, split, theta, free)
            places = dict(zip(table, binding.chain.signature.joints, strict=False))
        out += [
            {
                "joint": places[name],
                "split": split,
                "as_it_stands": stated[name].rmse,
                "retuned": table[name].rmse,
                "unit": table[name].unit,
                "text": text,
            }
            for name in table
            if name in stated and name in places
        ]
    return tuple(out)


def with_effects(
    retuned: tuple[dict[str, Any], ...], final: tuple[dict[str, Any], ...]
) -> tuple[dict[str, Any], ...]:
    """Rows of the re-tuned model beside those of the one with effects, which stand under
    `with_effects`.
    """
    after = {(r["joint"], r["split"]): r["retuned"] for r in final}
    return tuple(r | {"with_effects": after.get((r["joint"], r["split"]))} for r in retuned)
