"""Estimators of the torque equation W theta = tau, and the exponents of friction by variable
projection.

`ls` ordinary; `wls` each joint of each run weighted by its own residual (Gautier 1997); `tls` total
least squares, columns that hold noise of the motion in errors, exact ones not (Van Huffel and
Vandewalle 1991); `iv` instruments from the commanded motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.force.covariance import long_run, null_directions, whiteness


#: A column shorter than this share of the longest shows nothing but rounding.
SEEN = 1e-6
#: Directions of the scaled columns weaker than this share of the strongest are not determined by
#: the data.
WEAK = 1e-6
EXPONENT = (0.1, 1.5)


@dataclass(frozen=True)
class LinearEstimate:
    """Parameters with covariance and what the data do not determine."""

    theta: np.ndarray
    covariance: np.ndarray
    identifiable: np.ndarray
    condition: float
    condition_scaled: float
    white: bool
    memory: int


Blocks = Sequence[tuple[np.ndarray, np.ndarray]]  # per run W [samples n p], tau [samples n]


def stacked(
    blocks: Blocks, weights: Sequence[np.ndarray], columns: slice | np.ndarray = slice(None)
) -> tuple[np.ndarray, np.ndarray]:
    """All rows, each joint of each run times its weight [n]; of W some columns."""
    b = np.concatenate([(tau * w).ravel() for (_, tau), w in zip(blocks, weights, strict=True)])
    out, at = np.empty((len(b), blocks[0][0][0, 0, columns].size)), 0
    for (W, tau), w in zip(blocks, weights, strict=True):
        part = out[at : at + tau.size].reshape(*tau.shape, -1)
        for j in range(tau.shape[1]):  # one after the other, for memory's sake
            part[:, j] = W[:, j, columns] * w[j]
        at += tau.size
    return out, b


def least_squares(W: np.ndarray, b: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """min |W theta - b|; a direction that the data do not determine stays where `prior` is."""
    size = np.linalg.norm(W, axis=0)
    size = np.where(size > SEEN * max(float(size.max()), 1e-300), size, np.inf)
    return prior + np.linalg.lstsq(W / size, b - W @ prior, rcond=WEAK)[0] / size


@dataclass(frozen=True)
class Triangles:
    """The rows of all runs, each joint's brought down to a triangle: as good as all of them for
    whatever takes only sums of their products, at any weights of the joints.
    """

    of: tuple[np.ndarray, ...]  # per run [n k p + 1]: Q' [W tau] of each joint
    counts: tuple[int, ...]  # rows of a joint, per run

    @classmethod
    def made(cls, blocks: Blocks) -> Triangles:
        def one(W, tau, j):
            return np.linalg.qr(np.column_stack([W[:, j], tau[:, j]]), mode="r")

        found = [np.stack([one(W, tau, j) for j in range(W.shape[1])]) for W, tau in blocks]
        return cls(tuple(found), tuple(len(W) for W, _ in blocks))

    def stacked(self, weights: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Few rows in the place of `stacked` ones."""
        R = np.concatenate(
            [
                (R * w[:, None, None]).reshape(-1, R.shape[2])
                for R, w in zip(self.of, weights, strict=True)
            ]
        )
        return R[:, :-1], R[:, -1]

    def joint_weights(self, theta: np.ndarray) -> list[np.ndarray]:
        """1 / rms residual of each joint of each run."""
        left = [
            np.sum((R @ np.append(theta, -1.0)) ** 2, 1) / n
            for R, n in zip(self.of, self.counts, strict=True)
        ]
        return [1 / np.maximum(np.sqrt(square), 1e-9) for square in left]


def weighted(
    blocks: Blocks, prior: np.ndarray, rounds: int = 8, spread: np.ndarray | None = None
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Weighted least squares and its weights, repeated until the weights stand still. `spread`:
    standard deviations [p] with which the prior is known; rows then count as many as are
    independent.
    """
    rows = Triangles.made(blocks)
    weights = [np.ones(W.shape[1]) for W, _ in blocks]
    known = np.zeros((0, len(prior))) if spread is None else np.diag(1 / spread)

    def solved(weights: Sequence[np.ndarray]) -> np.ndarray:
        W, b = rows.stacked(weights)
        return least_squares(np.concatenate([W, known]), np.concatenate([b, known @ prior]), prior)

    theta = least_squares(*rows.stacked(weights), prior)
    share = (
        [np.ones(W.shape[1]) for W, _ in blocks] if spread is None else _independent(blocks, theta)
    )
    for _ in range(rounds):
        new = [w * s for w, s in zip(rows.joint_weights(theta), share, strict=True)]
        still = all(np.allclose(a, b, rtol=1e-3) for a, b in zip(new, weights, strict=True))
        weights = new
        theta = solved(weights)
        if still:
            break
    return theta, weights


def _independent(blocks: Blocks, theta: np.ndarray) -> list[np.ndarray]:
    """Root of the share of the rows of each joint of each run that are independent, by what theta
    leaves of them.
    """
    out = []
    for W, tau in blocks:
        left = tau - W @ theta
        memory = whiteness(list(left.T))[1]
        out.append(1 / np.sqrt([_correlation_time(r, memory) for r in left.T]))
    return out


def total(W: np.ndarray, b: np.ndarray, noise: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Mixed total least squares; `noise` [columns + 1] is one standard deviation of each column's
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
    Q = np.linalg.qr(A)[0] if exact.any() else np.zeros((len(W), 0))
    scale = noise[np.append(~exact, True)]
    rest = (B - Q @ (Q.T @ B)) / scale
    v = np.linalg.svd(np.linalg.qr(rest)[1])[2][-1]
    if abs(v[-1]) < 1e-9:
        return theta
    out = theta.copy()
    out[~exact] = -v[:-1] / v[-1] / scale[:-1] * scale[-1]
    out[exact] = np.linalg.lstsq(A, b - W[:, ~exact] @ out[~exact], rcond=WEAK)[0]
    return out


def instrumental(W: np.ndarray, b: np.ndarray, Z: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Z'W theta = Z'b in the two-stage form: W projected onto the columns of Z."""
    scale = np.linalg.norm(Z, axis=0)
    Q, size, _ = np.linalg.svd(Z / np.where(scale > 0, scale, 1.0), full_matrices=False)
    Q = Q[:, size > WEAK * size[0]]
    return least_squares(Q.T @ W, Q.T @ b, prior)


def estimate(
    blocks: Blocks,
    weights: Sequence[np.ndarray],
    theta: np.ndarray,
    by: Blocks | None = None,
    slopes: Sequence[np.ndarray] | None = None,
    spread: np.ndarray | None = None,
) -> LinearEstimate:
    """Covariance at theta; `by` are instruments, `spread` [p] what is known beforehand.

    Rows that follow each other hold the same noise, so each joint counts with the long-run variance
    of its own residual, over the freedom that the parameters leave it. Where the sandwich of Newey
    and West (1987) is wider, its standard deviations count; alone it is too narrow here, for tens
    of parameters take much of the slow part of a short record's residual.

    `slopes` per run [samples n k]: derivatives of the torque by k nonlinear parameters, which
    follow theta in the covariance.
    """
    if slopes is not None:

        def wider(W, D):
            return np.concatenate([W, D], 2)

        blocks = [(wider(W, D), tau) for (W, tau), D in zip(blocks, slopes, strict=True)]
        by = (
            None
            if by is None
            else [(wider(W, D), tau) for (W, tau), D in zip(by, slopes, strict=True)]
        )
        theta = np.concatenate([theta, np.zeros(slopes[0].shape[2])])
    W, _ = Triangles.made(blocks).stacked(weights)
    size = np.linalg.norm(W, axis=0)
    seen = size > SEEN * max(float(size.max()), 1e-300)
    scale = np.where(seen, size, 1.0)
    values = np.linalg.svd(W[:, seen] / scale[seen], compute_uv=False)
    plain = np.linalg.svd(W[:, seen], compute_uv=False)
    G = square = (W / scale).T @ (W / scale)
    if by is not None:
        pairs = zip(by, blocks, weights, strict=True)
        G = sum(
            (C[:, j] * (w[j] / scale)).T @ (A[:, j] * (w[j] / scale))
            for (C, _), (A, _), w in pairs
            for j in range(len(w))
        )
    identifiable, _ = null_directions(square, seen)
    series, scores = [], []
    index = list(range(W.shape[1]))
    for (A, tau), (C, _), w in zip(blocks, by or blocks, weights, strict=True):
        r = (tau - A @ theta) * w
        series += list(r.T)
        scores.append((index, np.einsum("tj,tjk->tk", r * w, C) / scale))
    white, memory = whiteness(series)
    count = sum(s.size for s in series)
    n = blocks[0][1].shape[1]
    times = [_correlation_time(s, memory) for s in series]
    free = sum(
        s.size / k for s, k in zip(series, times, strict=True)
    )  # rows that are worth something of their own
    freedom = max(0.1, 1 - int(seen.sum()) / free)
    middle = np.zeros_like(G)
    for k, (C, _) in enumerate(by or blocks):
        for j in range(n):
            s, w = series[n * k + j], weights[k][j]
            A = C[:, j] * w / scale
            middle += float(np.mean(s**2)) * times[n * k + j] / freedom * (A.T @ A)
    if spread is not None:
        told = np.zeros(len(scale))
        told[: len(spread)] = (spread * scale[: len(spread)]) ** -2.0
        G, middle = G + np.diag(told), middle + np.diag(told)
    inverse = np.linalg.pinv(G, rcond=WEAK**2)
    cov = inverse @ middle @ inverse.T
    wide = (
        np.diag(inverse @ long_run(scores, len(index), memory) @ inverse.T)
        * count
        / max(1, count - len(index))
    )
    stretch = np.sqrt(np.maximum(1.0, wide / np.maximum(np.diag(cov), 1e-300)))
    cov = cov * stretch * stretch[:, None] / scale / scale[:, None]
    return LinearEstimate(
        theta,
        cov,
        identifiable & seen,
        float(plain[0] / plain[-1]),
        float(values[0] / values[-1]),
        white,
        memory,
    )


def _correlation_time(r: np.ndarray, memory: int) -> float:
    """How many rows share one piece of noise: 1 + 2 sum of the autocorrelation up to the first lag
    where it is lost.
    """
    r = r - r.mean()
    power = float(r @ r)
    if power <= 0:
        return 1.0
    rho = (
        np.array([float(r[k:] @ r[: len(r) - k]) for k in range(1, min(memory, len(r) // 3) + 1)])
        / power
    )
    lost = np.flatnonzero(rho < 0.05)
    return 1.0 + 2.0 * float(np.sum(rho[: lost[0]] if lost.size else rho))


def project_exponents(
    fixed: np.ndarray,
    b: np.ndarray,
    moving: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    positive: bool = False,
) -> np.ndarray:
    """Exponents of friction by variable projection (Golub and Pereyra 1973): for each trial all
    linear parameters are solved for, so that only the exponents are searched. `fixed` columns do
    not depend on them, `moving(exponents)` do; `positive` keeps the levels of the latter from being
    negative.
    """
    from scipy.optimize import least_squares as search, nnls

    size = np.linalg.norm(fixed, axis=0)
    scale = np.where(size > 0, size, np.inf)
    _, s, V = np.linalg.svd(np.linalg.qr(fixed, mode="r") / scale)
    strong = s > WEAK * s[0]
    Q = fixed @ (V[strong].T / s[strong] / scale[:, None])
    rest = b - Q @ (Q.T @ b)

    def residual(exponents: np.ndarray) -> np.ndarray:
        V = moving(exponents)
        V = V - Q @ (Q.T @ V)
        return rest - V @ (
            nnls(V, rest)[0] if positive else np.linalg.lstsq(V, rest, rcond=1e-9)[0]
        )

    return search(
        residual,
        np.clip(start, 0.15, 1.45),
        bounds=EXPONENT,
        diff_step=1e-4,
        xtol=1e-6,
        ftol=1e-9,
        x_scale=0.2,
    ).x
