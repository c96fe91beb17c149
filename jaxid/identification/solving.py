"""One friction law of a serial arm fitted to its fit runs, by each of the methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxid.dynamics.base_parameters import BaseParameters, standard_values
from jaxid.dynamics.chain import Chain
from jaxid.force.covariance import covariance_of_rows, of_joints, RowCovariance
from jaxid.force.rows import ByJoint, ForceRows, Numbers
from jaxid.identification import estimators
from jaxid.identification.bodies import constrained
from jaxid.identification.recursive import recursive
from jaxid.identification.regression import (
    exponent_slopes,
    FrictionLaw,
    full_rows,
    power,
    RegressionRun,
    spacing,
)
from jaxid.identification.trust import spread_of


#: Exponents are searched at most so often, until none moves by more than this.
SEARCHES, SETTLED = 3, 1e-3
#: Parameters of friction that always brake.
LEVELS = ("F_c", "F_v")


@dataclass(frozen=True)
class LawFit:
    """Numbers of one law, base parameters first, with exponents and the weights of each joint of
    each fit run; `bodies` [11 joints] standard parameters of bodies that can exist, where the
    method finds them. The covariance is of the numbers, then of the exponents that were searched.
    """

    theta: Numbers
    exponent: Float[np.ndarray, " joints"]
    weights: ByJoint
    covariance: RowCovariance
    bodies: np.ndarray | None = None


@dataclass(frozen=True)
class LawProblem:
    """What a law is fitted to: the arm, its fit runs, and the numbers that its model states. With
    `spread`, standard deviations of these, they count as known.
    """

    law: FrictionLaw
    fit: Sequence[RegressionRun]
    arm: Any
    base: BaseParameters
    standard: Float[np.ndarray, " standard"]
    prior: Numbers
    spread: Numbers | None = None

    @property
    def joints(self) -> int:
        return len(self.arm.prismatic)

    def rows(self, runs: Sequence[RegressionRun], exponent: np.ndarray) -> ForceRows:
        """Rows of some runs at these exponents; those of a joint that stands still are nothing."""
        columns = [full_rows(r, self.law, exponent) * r.moves[:, None] for r in runs]
        torque = [r.tau[:: spacing(r)] * r.moves for r in runs]
        return ForceRows.of(columns, torque)


def law_problem(
    law: FrictionLaw,
    runs: Sequence[RegressionRun],
    chain: Chain,
    base: BaseParameters,
    trust: float | None = None,
) -> LawProblem:
    """`trust`: to within how many times their size the model's own numbers are known (see
    `spread_of`); None: not at all.
    """
    arm: Any = chain.mechanism
    fit = [r for r in runs if r.split == "fit"]
    standard = standard_values(arm, base.standard)
    friction = np.zeros(len(law.parameters) * len(arm.prismatic))
    prior = np.concatenate([base.values(standard), friction])
    spread = None if trust is None else trust * spread_of(base, prior, law, fit)
    return LawProblem(law, fit, arm, base, standard, prior, spread)


def fit_law(
    problem: LawProblem,
    method: str,
    by: Sequence[RegressionRun] | None = None,
    kept: Float[np.ndarray, " joints"] | None = None,
) -> LawFit:
    """The law by a method of `jaxid.identify`; `by` fit runs along the commanded motion, the
    instruments of `iv`; `kept` exponents are not searched.
    """
    searched = problem.law.nonlinear and kept is None
    exponent = np.ones(problem.joints) if kept is None else kept
    rows = problem.rows(problem.fit, exponent)
    theta, weights = estimators.weighted(rows, problem.prior, problem.spread)
    for _ in range(SEARCHES if searched else 0):
        before, positive = exponent, method == "constrained"
        exponent = _exponents(problem, rows, weights, before, positive)
        rows = problem.rows(problem.fit, exponent)
        theta, weights = estimators.weighted(rows, problem.prior, problem.spread)
        if np.abs(exponent - before).max() < SETTLED:
            break
    if method == "ls":
        weights = rows.plain_weights()
    instruments = problem.rows(by, exponent) if method == "iv" and by is not None else None
    bodies = None
    if method == "constrained":
        theta, bodies = _of_bodies(problem, rows, weights)
    elif method != "wls":
        theta = _by_method(problem, method, rows, weights, theta, exponent, instruments)
    covariance = _covariance(problem, rows, weights, theta, exponent, instruments, searched)
    return LawFit(theta, exponent, weights, covariance, bodies)


def _by_method(
    problem: LawProblem,
    method: str,
    rows: ForceRows,
    weights: ByJoint,
    theta: Numbers,
    exponent: np.ndarray,
    instruments: ForceRows | None,
) -> Numbers:
    """Numbers by a method, of one that is not known here those of weighted least squares."""
    if method == "ls":
        return estimators.least_squares(*rows.triangles().stacked(weights), problem.prior)
    if method == "tls":
        noise = _column_noise(problem.fit, weights, rows.size)
        return estimators.total(*rows.stacked(weights), noise, problem.prior)
    if method == "rls":
        return recursive(problem.fit, problem.law, exponent, weights, problem.prior)
    if instruments is not None:
        Z, _ = instruments.stacked(weights)
        return estimators.instrumental(*rows.stacked(weights), Z, problem.prior)
    return theta


def _of_bodies(
    problem: LawProblem, rows: ForceRows, weights: ByJoint
) -> tuple[Numbers, np.ndarray]:
    """Numbers of bodies that can exist with friction that brakes, and their standard
    parameters.
    """
    names = np.repeat([name for name, _ in problem.law.parameters], problem.joints)
    A, b = rows.stacked(weights)
    return constrained(
        A,
        b,
        base=problem.base,
        prior=problem.standard.reshape(problem.joints, 11),
        levels=np.isin(names, LEVELS),
        drives=problem.arm.motor_side,
    )


def _covariance(
    problem: LawProblem,
    rows: ForceRows,
    weights: ByJoint,
    theta: Numbers,
    exponent: np.ndarray,
    instruments: ForceRows | None,
    searched: bool,
) -> RowCovariance:
    """Of the numbers, then of exponents that were searched: columns are the torque's derivatives
    by these.
    """
    if searched:
        slopes = [exponent_slopes(r, problem.law, theta, exponent) for r in problem.fit]
        rows = rows.beside(slopes)
        instruments = None if instruments is None else instruments.beside(slopes)
        theta = np.concatenate([theta, np.zeros(len(exponent))])
    information = None
    if problem.spread is not None:
        known = np.zeros(len(theta))
        known[: len(problem.spread)] = problem.spread**-2.0
        information = np.diag(known)
    return covariance_of_rows(
        rows,
        weights,
        theta,
        of_joints,
        instruments=instruments,
        information=information,
        short=estimators.SEEN,
        weak=estimators.WEAK,
    )


def _exponents(
    problem: LawProblem,
    rows: ForceRows,
    weights: ByJoint,
    start: Float[np.ndarray, " joints"],
    positive: bool,
) -> Float[np.ndarray, " joints"]:
    """Exponents at these weights; `positive` keeps F_c and F_v from being negative."""
    n, p = problem.joints, len(problem.base.kept)
    dry, viscous = np.arange(p, p + n), np.arange(p + n, p + 2 * n)
    levels = rows.stacked(weights, dry)[0] if positive else np.zeros((0, 0))

    def columns(exponent: np.ndarray) -> np.ndarray:
        parts = []
        for r, w in zip(problem.fit, weights, strict=True):
            F = r.solved(lambda at, qd=r.qd: power(qd[at], exponent))
            parts.append((F[:, :, None] * np.eye(n) * w[:, None]).reshape(-1, n))
        moving = np.concatenate(parts)
        return np.concatenate([levels, moving], axis=1) if positive else moving

    moving = np.concatenate([dry, viscous]) if positive else viscous
    others = np.setdiff1d(np.arange(rows.size), moving)
    fixed, b = rows.stacked(weights, others)
    return estimators.project_exponents(fixed, b, columns, start, positive)


def _column_noise(
    fit: Sequence[RegressionRun], weights: ByJoint, size: int
) -> Float[np.ndarray, " all"]:
    """One standard deviation of each column's error and of the torque's: what lies above the
    cutoff, as if it were white. Friction columns count as exact: what they hold above the cutoff
    are reversals.
    """
    p = fit[0].Y.shape[2]
    square, count = np.zeros(size + 1), 0
    for r, w in zip(fit, weights, strict=True):
        for _, Y, Y_raw in r.stretches(r.inertia):
            square[:p] += np.sum(((Y_raw - Y) * w[:, None]) ** 2, (0, 1))
        square[-1] += np.sum(((r.tau_raw - r.tau) * w) ** 2)
        count += r.tau.size
    return np.sqrt(square / count)
