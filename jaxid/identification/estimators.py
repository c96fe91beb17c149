"""Estimators of the torque equation W theta = tau, and the exponents of friction by variable
projection.

`ls` ordinary; `wls` each joint of each run weighted by its own residual (Gautier 1997); `tls` total
least squares, columns that hold noise of the motion in errors, exact ones not (Van Huffel and
Vandewalle 1991); `iv` instruments from the commanded motion.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from jaxid.force.covariance import correlation_time, whiteness
from jaxid.force.least_squares import Rows, solve
from jaxid.force.rows import ByJoint, ForceRows, Numbers


#: A column shorter than this share of the longest shows nothing but rounding.
SEEN = 1e-6
#: Directions of the scaled columns weaker than this share of the strongest are not determined by
#: the data.
WEAK = 1e-6
EXPONENT = (0.1, 1.5)
#: Weights are found again at most so often, until none changes by more than this share.
ROUNDS, STILL = 8, 1e-3
#: The smallest residual that weighs, N m.
LEAST = 1e-9


def least_squares(
    A: Float[np.ndarray, "rows numbers"], b: Float[np.ndarray, " rows"], prior: Numbers
) -> Numbers:
    """min |A theta - b|; a direction that the data do not determine stays where `prior` is."""
    return solve(Rows(A, b, WEAK, SEEN), prior)[0]


def weighted(
    rows: ForceRows, prior: Numbers, spread: Numbers | None = None
) -> tuple[Numbers, list[Float[np.ndarray, " joints"]]]:
    """Weighted least squares and the weights of each joint of each run, found again until they
    stand still. `spread`: standard deviations with which the prior is known; rows then count as
    many as are independent.
    """
    few = rows.triangles()
    weights = rows.plain_weights()
    theta = least_squares(*few.stacked(weights), prior)
    share = weights if spread is None else independent_share(rows, theta)
    for _ in range(ROUNDS):
        before, weights = weights, _by_residual(few, theta, share)
        equations = Rows(*few.stacked(weights), WEAK, SEEN)
        if spread is not None:
            equations = equations.known(prior, spread)
        theta, _ = solve(equations, prior)
        pairs = zip(weights, before, strict=True)
        if all(np.allclose(new, old, rtol=STILL) for new, old in pairs):
            break
    return theta, weights


def _by_residual(
    rows: ForceRows, theta: Numbers, share: ByJoint
) -> list[Float[np.ndarray, " joints"]]:
    """A share over what theta leaves of each joint of each run, rms."""
    left = [np.maximum(rms, LEAST) for rms in rows.rms(theta)]
    return [own / rms for own, rms in zip(share, left, strict=True)]


def independent_share(rows: ForceRows, theta: Numbers) -> list[Float[np.ndarray, " joints"]]:
    """Root of the share of the rows of each joint of each run that are independent, by what theta
    leaves of them.
    """
    out = []
    for left in rows.errors(theta):
        memory = whiteness(list(left.T))[1]
        times = [correlation_time([r - r.mean()], memory) for r in left.T]
        out.append(1 / np.sqrt(times))
    return out


def total(
    W: Float[np.ndarray, "rows numbers"],
    b: Float[np.ndarray, " rows"],
    noise: Float[np.ndarray, " all"],
    prior: Numbers,
) -> Numbers:
    """Mixed total least squares; `noise` [numbers + 1] is one standard deviation of each column's
    error and, last, of b's.

    Columns without error are eliminated exactly; the rest, each in units of its error, by the
    smallest singular vector. Where that vector does not hold b (the columns depend on each other
    more than b on them) plain least squares is returned.
    """
    theta = least_squares(W, b, prior)
    exact = noise[:-1] <= 1e-6 * np.linalg.norm(W, axis=0) / np.sqrt(len(W))
    if exact.all() or noise[-1] <= 0:
        return theta
    A, B = W[:, exact], np.column_stack([W[:, ~exact], b])
    Q = np.linalg.qr(A)[0]
    scale = noise[np.append(~exact, True)]
    rest = (B - Q @ (Q.T @ B)) / scale
    v = np.linalg.svd(np.linalg.qr(rest)[1])[2][-1]
    if abs(v[-1]) < 1e-9:
        return theta
    theta[~exact] = -v[:-1] / v[-1] / scale[:-1] * scale[-1]
    theta[exact] = least_squares(A, b - W[:, ~exact] @ theta[~exact], np.zeros(A.shape[1]))
    return theta


def instrumental(
    W: Float[np.ndarray, "rows numbers"],
    b: Float[np.ndarray, " rows"],
    Z: Float[np.ndarray, "rows numbers"],
    prior: Numbers,
) -> Numbers:
    """Z'W theta = Z'b in the two-stage form: W projected onto the columns of Z."""
    return solve(Rows.projected(W, b, Z, WEAK, SEEN), prior)[0]


def project_exponents(
    fixed: Float[np.ndarray, "rows fixed"],
    b: Float[np.ndarray, " rows"],
    moving: Callable[[Float[np.ndarray, " joints"]], Float[np.ndarray, "rows moving"]],
    start: Float[np.ndarray, " joints"],
    positive: bool = False,
) -> Float[np.ndarray, " joints"]:
    """Exponents of friction by variable projection (Golub and Pereyra 1973): for each trial all
    linear parameters are solved for, so that only the exponents are searched. `fixed` columns do
    not depend on them, `moving(exponents)` do; `positive` keeps the levels of the latter from being
    negative.
    """
    from scipy.optimize import least_squares as search

    size = np.linalg.norm(fixed, axis=0)
    scale = np.where(size > 0, size, np.inf)
    _, s, V = np.linalg.svd(np.linalg.qr(fixed, mode="r") / scale)
    strong = s > WEAK * s[0]
    Q = fixed @ (V[strong].T / s[strong] / scale[:, None])
    rest = b - Q @ (Q.T @ b)

    def residual(exponents: np.ndarray) -> np.ndarray:
        own = moving(exponents)
        own = own - Q @ (Q.T @ own)
        least = np.zeros(own.shape[1]) if positive else None
        levels, _ = solve(Rows(own, rest), np.zeros(own.shape[1]), least)
        return rest - own @ levels

    found = search(
        residual,
        np.clip(start, 0.15, 1.45),
        bounds=EXPONENT,
        diff_step=1e-4,
        xtol=1e-6,
        ftol=1e-9,
        x_scale=0.2,
    )
    return found.x
