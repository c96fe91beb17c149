"""The payload as in paper 001 and by the two algorithms that it compares with; all begin with the
unloaded arm's identification.

- `paper001`: equations (7) to (16) as printed. The recursion K = P Y' (X + Y P Y')^-1 over the recorded rows, not filtered,
  from the unloaded arm's parameters (base parameters, F_c, F_v, offset; its exponents kept) with xi = 100, P0 = 10; converged
  once no parameter of the last link has moved by more than 0.005 a sample for 300 samples.
- `algorithm1` (Khalil, Gautier, Lemoine 2007): the torque less that of the unloaded arm on the same motion is the load's ten
  columns at the flange; least squares.
- `algorithm2` (Gaz, De Luca 2017): the same of gravity alone, at rest; mass and centre of mass.

The torque of the unloaded arm on this motion is that of its identified parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.dynamics.base_parameters import BaseParameters, torque_columns
from jaxid.fitting.recursive_least_squares import replay_stretches, Rule
from jaxid.force.covariance import covariance_of_rows, of_joints
from jaxid.force.least_squares import Rows, solve
from jaxid.force.rows import ForceRows
from jaxid.identification.estimators import SEEN, WEAK
from jaxid.identification.online import watched_of
from jaxid.identification.payload import nearest_body, PayloadEstimate
from jaxid.identification.regression import (
    every_row,
    FrictionLaw,
    full_rows,
    LAWS,
    names_of,
    RegressionRun,
    spacing,
)


PAPER = ("paper001", "algorithm1", "algorithm2")
XI, P0 = 100.0, 10.0
#: An arm whose joints are all slower than this rests, rad/s (m/s), as in the paper's static poses.
AT_REST = 0.01


def unloaded(
    before: Mapping[str, Any] | None, method: str, base: BaseParameters, n: int
) -> tuple[FrictionLaw, np.ndarray, np.ndarray]:
    """Friction law, exponents [n] and parameters of the unloaded arm's identification. Raises
    `UsageError` without one.
    """
    if before is None:
        raise UsageError(
            f"method {method} finds a payload from the unloaded arm's parameters: give its"
            " identification as a reference (--reference UNLOADED/identification.json)"
        )
    law = LAWS[str(before.get("friction_law", "linear"))]
    friction = before["friction"]
    known = {e["name"]: e["value"] for e in before["base_parameters"]}
    for name, _ in law.parameters:
        known |= {f"{name}{j + 1}": friction[j][name]["value"] for j in range(n)}
    names = names_of(base, law, n)
    if lacking := [name for name in names if name not in known]:
        raise UsageError(f"the reference is of another arm: it lacks {lacking[0]}")
    exponent = [float(friction[j].get("exponent", {}).get("value", 1.0)) for j in range(n)]
    return law, np.array(exponent), np.array([known[name] for name in names], float)


def as_printed(
    runs: Sequence[RegressionRun],
    law: FrictionLaw,
    exponent: np.ndarray,
    prior: np.ndarray,
    base: BaseParameters,
) -> tuple[np.ndarray, np.ndarray, float | None]:
    """(theta, P, seconds after which the rule was first met or None) over the fit runs."""
    fit = [r for r in runs if r.split == "fit"]

    def rows() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for r in fit:
            for at, _, W in every_row(r, law, exponent):
                yield W, r.tau_raw[at]

    n = fit[0].tau.shape[1]
    theta, P, met = replay_stretches(
        rows(), prior, noise_var=XI, prior_var=P0, watched=watched_of(base, n), rule=Rule()
    )
    step = float(np.median(np.diff(fit[0].t)))
    return theta, P, None if met is None else met * step


def by_algorithm(
    method: str,
    runs: Sequence[RegressionRun],
    arm: Any,
    law: FrictionLaw,
    exponent: np.ndarray,
    theta: np.ndarray,
    spread: np.ndarray,
    gain_std: float,
) -> PayloadEstimate:
    """The payload by Algorithm 1 or 2 from the fit runs; `theta` are the unloaded arm's parameters,
    `spread` their covariance, which counts. Raises `UsageError` where Algorithm 2 finds no poses at
    rest.
    """
    fit = [r for r in runs if r.split == "fit"]
    n = fit[0].tau.shape[1]
    own = slice(11 * (n - 1) + (6 if method == "algorithm2" else 0), 11 * (n - 1) + 10)
    if method == "algorithm2":  # at rest friction may take any value up to its level
        braking = np.repeat([name != "offset" for name, _ in law.parameters], n)
        own_friction = np.where(braking, 0.0, theta[-len(braking) :])
        theta = np.concatenate([theta[: -len(braking)], own_friction])
    columns, torque, carried = [], [], []
    for r in fit:
        W = full_rows(r, law, exponent)
        rest = r.tau[:: spacing(r)] - W @ theta
        Y = r.solved(lambda at, r=r: torque_columns(arm, r.q[at], r.qd[at], r.qdd[at])[:, :, own])
        if method == "algorithm2":
            still = np.all(np.abs(r.qd[r.kept][:: spacing(r)]) < AT_REST, axis=1)
            Y, rest, W = Y[still], rest[still], W[still]
        if len(rest):
            columns.append(Y)
            torque.append(rest)
            carried.append(W.reshape(-1, len(theta)))
    count = own.stop - own.start
    samples = sum(map(len, torque))
    if samples * n < 3 * count:
        raise UsageError(
            "algorithm2 compares torques at rest, and the arm hardly rests here (all joints below"
            f" 0.01 rad/s in {samples} rows): record static poses, or use paper001 or algorithm1"
        )
    rows = ForceRows.of(columns, torque)
    weights = rows.plain_weights()
    A, b = rows.stacked(weights)
    size = np.linalg.norm(A, axis=0)
    if (size <= 0).any() or np.linalg.cond(A / size) > 1e6:
        raise UsageError(
            f"{method} does not find the payload from this motion: it shows some of the load's"
            " numbers only together"
        )
    phi, _ = solve(Rows(A, b), np.zeros(count))
    slope = np.linalg.lstsq(A / size, np.concatenate(carried), rcond=None)[0] / size[:, None]
    own_noise = covariance_of_rows(rows, weights, phi, of_joints, short=SEEN, weak=WEAK).matrix
    covariance = own_noise + slope @ spread @ slope.T
    if count == 10:
        body = nearest_body(phi, np.linalg.inv(covariance))
        return PayloadEstimate(phi, covariance, body, None, gain_std, count)
    whole, wide = np.full(10, np.nan), np.full((10, 10), np.nan)
    whole[10 - count :], wide[10 - count :, 10 - count :] = phi, covariance
    return PayloadEstimate(whole, wide, whole, None, gain_std, count)
