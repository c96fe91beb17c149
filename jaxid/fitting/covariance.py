"""How well the data determine the parameters: covariance, directions that they do not determine,
parameters at a bound.

White residuals: cov = s^2 (J'J)^-1. Coloured ones (any model error, any disturbance with a memory):
the sandwich (J'J)^-1 S (J'J)^-1 with S the covariance of the scores J'r, the wider of two: that of
stationary noise with a memory (`jaxid.fitting.noise_model`), and the long-run covariance of the
scores themselves (Newey and West 1987, Bartlett weights; the bandwidth covers the residual's own
correlation time), which also holds for a model error that follows the motion. Ordinary
least-squares intervals are too narrow there by large factors.

All numbers have one covariance: of a normal distribution about the minimum that is cut off at the
bounds (`jaxid.numerics.truncated`), in units in which sums and ratios are straight lines. A
direction that the data leave open is as wide as the bounds. What is pushed against a bound has its
mean square from there, and frees the others by as much.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from jaxid.fitting.noise_model import (
    Autoregression,
    autoregressions,
    RecordResidual,
    score_covariance,
    student,
)
from jaxid.force.covariance import long_run, no_narrower, NULL, null_directions, whiteness
from jaxid.numerics.truncated import positive, pushed, within_bounds
from jaxid.problem.problem import FitProblem, rows


@dataclass(frozen=True)
class CovarianceEstimate:
    """`std` per entry of z (nan where not determined), correlation groups as positions in z. With
    few independent samples a standard deviation is stated so wide that 1.96 of them still hold 95 %
    (Student's t).
    """

    matrix: np.ndarray
    std: np.ndarray
    identifiable: np.ndarray
    at_bound: np.ndarray
    groups: tuple[tuple[int, ...], ...]
    white: bool
    statement: str
    noise: tuple[Autoregression, ...] = ()  # of each column, where residuals are coloured
    widened: float = 1.0  # by Student's t
    gradient: np.ndarray | None = None  # J'r and J'J
    hessian: np.ndarray | None = None
    precision: np.ndarray | None = None  # J'J with what is known beforehand
    by_data: np.ndarray | None = None  # the matrix without priors


def covariance(problem: FitProblem, z: np.ndarray, inflation: float = 1.0) -> CovarianceEstimate:
    """Covariance of z at a minimum (search scale). Variances of priors were made smaller by
    `inflation`, to count beside residuals that are as much larger than their noise.
    """
    n = problem.size
    span = problem.upper - problem.lower
    near = 1e-9 * np.maximum(
        np.abs(z), problem.scale
    )  # a descent ends exactly at a bound, up to rounding
    at_bound = (z - problem.lower <= near) | (problem.upper - z <= near)
    H, slope, S_white, count = np.zeros((n, n)), np.zeros(n), 0.0, 0
    parts: list[RecordResidual] = []
    scores: list[tuple[list[int], np.ndarray]] = []
    series: list[np.ndarray] = []
    broken = np.zeros(n, bool)
    for part in rows([(problem.precise(), z)]):
        finite = np.isfinite(part.J).all(
            (0, 1)
        )  # a derivative that a run leaves undefined tells nothing
        broken[np.array(part.z_columns, int)[~finite]] = True
        part = part._replace(J=np.where(finite, part.J, 0.0))
        if problem.by_windows:
            part = part._replace(
                J=_beside_its_start(part.J, np.array(part.z_columns), problem.free.size, at_bound)
            )
        J = part.J.reshape(part.r.size, len(part.z_columns))
        index = np.ix_(part.z_columns, part.z_columns)
        H[index] += J.T @ J
        slope[part.z_columns] += part.r.ravel() @ J
        S_white += float(np.sum(part.r**2))
        count += part.r.size
        scores.append((part.z_columns, np.einsum("tc,tck->tk", part.r, part.J)))
        series += list(part.r.T)
        whole = np.zeros((*part.r.shape, n))
        whole[:, :, part.z_columns] = part.J
        parts.append(RecordResidual(part.r, whole))
        del part, J, finite  # a long record's Jacobian is large: not more than one beside its copy

    r, J = problem.known_before(z)  # knows no model error: counts as it is
    slope, prior, H_data = slope + J.T @ r, J.T @ J, H
    H = H + prior
    scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
    scaled = H / scale / scale[:, None]
    blind = (np.diag(H) <= 1e-300) | broken  # no sample reacts to it
    inside = ~(at_bound & (np.arange(n) < problem.free.size)) & ~blind
    identifiable, groups = null_directions(
        scaled, inside
    )  # what stands at a bound is known there: it frees the others
    if (at_bound & ~blind).any():
        identifiable[at_bound] &= null_directions(scaled, ~blind)[0][at_bound]
    identifiable &= ~blind

    white, memory = whiteness(series)
    dof = max(1, count - int(inside.sum()))
    s2 = max(S_white / dof, 1e-300)
    noise, widened = (), 1.0
    if not white:
        noise = tuple(autoregressions(parts, _held(scaled, scale, inside)))
        widened = student(parts, noise, int(inside.sum()))

    bounds = np.diag(_known_by_bounds(problem, z))

    def spread_of(prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Covariance of z with so much known beforehand, and the inverse curvature."""
        inverse = _inverse(H_data + prior + bounds)
        known = inflation * prior + bounds
        least = inverse @ (max(s2, 1.0) * H_data + known) @ inverse
        if white:
            return positive(least), inverse
        spread = inverse @ (score_covariance(parts, noise) * widened**2 + known) @ inverse
        slow = inverse @ (long_run(scores, n, memory) * count / dof + known) @ inverse
        # Never narrower than white residuals of that size.
        floor = np.maximum(np.diag(slow), np.diag(least))
        return positive(no_narrower(spread, floor)), inverse

    spread, inverse = spread_of(prior)
    alone = np.where(
        inside, np.diag(_beside_bounds(spread, at_bound & ~blind & ~inside)), np.diag(spread)
    )
    identifiable &= ~(
        np.sqrt(alone) > span
    )  # determined in name only: the interval is wider than the bounds
    at = np.flatnonzero(at_bound & ~inside & ~blind)
    matrix = one_sided(problem, z, spread, np.diag(inverse), slope, at)
    by_data = matrix
    if prior.any():
        own, inverse = spread_of(np.zeros_like(prior))
        by_data = one_sided(problem, z, own, np.diag(inverse), slope, at)
    std = np.sqrt(np.diag(matrix))
    std[~identifiable] = np.nan
    statement = (
        "residuals are white: standard deviations from the Gauss-Newton matrix"
        if white
        else f"residuals are coloured (memory {memory} samples): standard deviations count it"
    )
    return CovarianceEstimate(
        matrix=matrix,
        std=std,
        identifiable=identifiable,
        at_bound=at_bound,
        groups=groups,
        white=white,
        statement=statement,
        noise=noise,
        widened=widened,
        gradient=slope,
        hessian=H,
        precision=H_data + prior + bounds,
        by_data=by_data,
    )


def widened_by(known: CovarianceEstimate, more: np.ndarray) -> CovarianceEstimate:
    """The same with so much more covariance of z [n n]."""
    assert known.by_data is not None
    wider = _of(known, known.matrix + more)
    return replace(wider, by_data=known.by_data + more)


def without_priors(known: CovarianceEstimate) -> CovarianceEstimate:
    """The same by the data alone: whether they refute a number that somebody states is not to be
    judged by that statement, nor by another one that looks the same to the data.
    """
    return known if known.by_data is None else _of(known, known.by_data)


def _of(known: CovarianceEstimate, matrix: np.ndarray) -> CovarianceEstimate:
    """The same with another covariance of z [n n]."""
    std = np.sqrt(np.diag(matrix))
    std[~known.identifiable] = np.nan
    return replace(known, matrix=matrix, std=std)


def one_sided(
    problem: FitProblem,
    z: Float[np.ndarray, " numbers"],
    spread: Float[np.ndarray, "numbers numbers"],
    least: Float[np.ndarray, " numbers"],
    slope: Float[np.ndarray, " numbers"],
    at: Int[np.ndarray, " bounded"],
) -> Float[np.ndarray, "numbers numbers"]:
    """A covariance of z within its bounds: of a normal distribution that is cut off there. Numbers
    `at` a bound that they are pushed against (`slope` of the loss, half that of the sum of squares;
    `least`, the diagonal of its inverse curvature) have their mean square from there, and free the
    others by as much.
    """
    outwards = np.where(z - problem.lower <= problem.upper - z, slope, -slope)[at]
    push = np.maximum(outwards, 0.0) * least[at] / np.maximum(np.diag(spread)[at], 1e-300)
    return _within_bounds(problem, z, pushed(spread, at, push))


def _room(problem: FitProblem, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far z [n] may go down and up to its bounds, as a straight line goes in the numbers
    themselves: what trades for each other keeps a sum or a ratio of these, and no sum of
    logarithms.
    """
    down, up = problem.lower - z, problem.upper - z
    log = np.zeros(z.size, bool)
    log[: problem.free.size] = problem.log
    return np.where(log, np.expm1(np.where(log, down, 0.0)), down), np.where(
        log, np.expm1(np.where(log, up, 0.0)), up
    )


def _known_by_bounds(problem: FitProblem, z: np.ndarray) -> np.ndarray:
    """What bounds alone tell of each number [n], as a precision: no more than that it lies within
    them.
    """
    down, up = _room(problem, z)
    width = up - down
    return np.where(np.isfinite(width) & (width > 0), 1 / np.maximum(width, 1e-150) ** 2, 0.0)


def _within_bounds(problem: FitProblem, z: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Mean squares and products of what z is off by, [n n]: of a normal distribution about z, cut
    off at the bounds.
    """
    down, up = _room(problem, z)
    bounded = np.arange(z.size) < problem.free.size
    lower = np.where(bounded, np.minimum(down, 0.0), -np.inf)
    upper = np.where(bounded, np.maximum(up, 0.0), np.inf)
    mean, matrix = within_bounds(spread, np.zeros(z.size), lower, upper)
    return positive(matrix + np.outer(mean, mean))


def _beside_bounds(spread: np.ndarray, held: np.ndarray) -> np.ndarray:
    """The covariance of the others where those that are `held` stay at their bounds, [n n]."""
    at = np.flatnonzero(held)
    if not at.size:
        return spread
    own = np.linalg.pinv(spread[np.ix_(at, at)], hermitian=True)
    return spread - spread[:, at] @ own @ spread[at]


def _held(scaled: np.ndarray, scale: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """The inverse of the Gauss-Newton matrix over what is inside, with zeros elsewhere, [n n]."""
    out, index = np.zeros_like(scaled), np.flatnonzero(inside)
    if index.size:
        at = np.ix_(index, index)
        out[at] = _pseudo_inverse(scaled[at]) / scale[index] / scale[index][:, None]
    return out


def _inverse(H: np.ndarray) -> np.ndarray:
    """The inverse of a positive semidefinite matrix; a direction of nothing has what rounding would
    make of it.
    """
    scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
    values, vectors = np.linalg.eigh(H / scale / scale[:, None])
    least = len(H) * np.finfo(float).eps * values[-1]
    return (vectors / np.maximum(values, least)) @ vectors.T / scale / scale[:, None]


def _beside_its_start(
    J: np.ndarray, columns: np.ndarray, free: int, at_bound: np.ndarray
) -> np.ndarray:
    """A window's Jacobian [samples channels size] with what its own start could do as well taken
    out of the parameters' columns (Frisch and Waugh 1933). The covariance of the parameters stays
    the same, but no longer needs the inverse of a matrix in which a window that forgets its start
    has two all but equal columns; that of the starts is the one with the parameters known.
    """
    flat = J.reshape(-1, J.shape[-1]).copy()
    own = (columns >= free) & ~at_bound[columns]
    size = np.linalg.norm(flat, axis=0)
    own &= size > 1e-150
    if own.any():
        U, s, _ = np.linalg.svd(flat[:, own] / size[own], full_matrices=False)
        Q = U[:, s > 1e-10 * s[0]]
        rest = flat[:, columns < free]
        flat[:, columns < free] = rest - Q @ (Q.T @ rest)
    return flat.reshape(J.shape)


def _pseudo_inverse(a: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(a)
    good = values > NULL * values[-1]
    return (vectors[:, good] / values[good]) @ vectors[:, good].T
