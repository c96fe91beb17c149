"""Damping of a joint and the gain kd of its law: one number, where both brake the same speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxid.base.wording import number, unit_after, value_with_std
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.fitting.result import Estimate
from jaxid.fitting.scores import free_runs
from jaxid.fitting.stated import StatedNumber
from jaxid.numerics.stated_numbers import REFUTED
from jaxid.problem.binding import Binding


def said_as_one(
    bench: ProblemBuilder, theta: np.ndarray, rows: Sequence[StatedNumber]
) -> tuple[StatedNumber, ...]:
    """The rows, with kd + damping in place of a damping that is refuted beside a kd that was held,
    where another kd would move the joints as well. `theta`: numbers of the fitted model.
    """
    out: list[StatedNumber] = []
    for row in rows:
        kd = _held_kd(bench, row)
        if kd is None or not _as_well(bench, theta, row, kd):
            out.append(row)
            continue
        out += [_open(row), _sum(row, float(bench.binding.theta[kd]))]
    return tuple(out)


def _held_kd(bench: ProblemBuilder, row: StatedNumber) -> int | None:
    """Position of a kd that was held beside a damping that is stated and refuted."""
    binding = bench.binding
    law = getattr(binding.chain.mechanism, "drive_law", None)
    if law is None or row.parameter != "damping" or not (row.refuted and row.stated > 0):
        return None
    name = f"kd@{row.joint}"
    if name not in binding.layout.names:
        return None
    kd = binding.layout.index(name)
    return kd if kd not in binding.free and binding.theta[kd] > 0 else None


def _as_well(bench: ProblemBuilder, theta: np.ndarray, row: StatedNumber, kd: int) -> bool:
    """Whether the free runs are the same with the damping as stated and another kd: what lies
    nearer than chance takes all samples together is not told apart. A kd cannot be negative.
    """
    binding, other = bench.binding, theta.copy()
    damping = binding.layout.index(f"damping@{row.joint}")
    other[kd] += theta[damping] - row.stated
    other[damping] = row.stated
    if not other[kd] > 0:
        return False
    armature = binding.layout.index(f"armature@{row.joint}")
    before, after = (_by_steps(binding, x[damping], x[kd]) for x in (theta, other))
    if armature in binding.free:
        other[armature] += before - after
    starts = estimate_starts(bench, "fit", [theta])
    both = np.concatenate([starts, starts])
    here, there = free_runs(bench, "fit", [theta, other], both)
    apart = [(a - b) / binding.sigma for a, b in zip(here, there, strict=True)]
    return bool(sum(float(np.sum(x**2)) for x in apart) < REFUTED**2)


def _by_steps(binding: Binding, damping: float, kd: float) -> float:
    """What the simulated steps make an inertia appear to be more."""
    steps = binding.chain.mechanism.first_order_steps
    return 0.0 if steps is None else steps.inertia(damping, kd)


def _open(row: StatedNumber) -> StatedNumber:
    text = (
        f"damping of {row.joint} as stated can be neither confirmed nor refuted by itself: the "
        "law brakes the same speed, and the data tell only kd + damping"
    )
    return replace(row, deviation=None, text=text)


def _sum(row: StatedNumber, kd: float) -> StatedNumber:
    unit = unit_after(row.unit)
    whole = Estimate(kd + row.fitted, row.std, row.unit, 0.0, math.inf)
    text = (
        f"kd + damping of {row.joint}: {value_with_std(whole)}, stated {number(kd)} + "
        f"{number(row.stated)}{unit} ({number(abs(row.deviation or 0.0), 2)} standard deviations): "
        "the law brakes the joint's own speed, and the data tell only the sum"
    )
    return replace(
        row,
        parameter=f"kd + damping of {row.joint}",
        stated=kd + row.stated,
        fitted=kd + row.fitted,
        text=text,
        beside=None if row.beside is None else kd + row.beside,
    )
