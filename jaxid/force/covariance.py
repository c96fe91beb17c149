"""How well rows whose residual has a memory determine numbers: directions that are left open, and
sandwich covariances.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from jaxid.base.computer import cores
from jaxid.force.rows import ByJoint, ForceRows
from jaxid.numerics.truncated import positive


#: A direction of the scaled normal matrix with an eigenvalue below this share of the largest is not
#: determined.
NULL = 1e-12
#: An autocorrelation below that share is lost in the noise.
LOST = 0.05


def null_directions(
    scaled: np.ndarray, kept: np.ndarray
) -> tuple[np.ndarray, tuple[tuple[int, ...], ...]]:
    """Which variables take part in no undetermined direction; and groups tied together (correlation
    above 0.999).
    """
    index = np.flatnonzero(kept)
    identifiable = np.ones(len(kept), bool)
    groups: list[tuple[int, ...]] = []
    if not index.size:
        return identifiable, ()
    values, vectors = np.linalg.eigh(scaled[np.ix_(index, index)])
    null = values <= NULL * values[-1]
    for vector in vectors[:, null].T:
        members = np.flatnonzero(np.abs(vector) > 1e-3)
        identifiable[index[members]] = False
        groups.append(tuple(map(int, index[members])))
    if not null.any():
        inverse = np.linalg.inv(scaled[np.ix_(index, index)])
        d = np.sqrt(np.diag(inverse))
        tied = np.abs(inverse / d / d[:, None]) > 0.999
        seen: set[int] = set()
        for i in range(len(index)):
            members = np.flatnonzero(tied[i])
            if i not in seen and members.size > 1:
                seen.update(map(int, members))
                groups.append(tuple(map(int, index[members])))
    return identifiable, tuple(dict.fromkeys(groups))


def whiteness(series: list[np.ndarray], lags: int = 20) -> tuple[bool, int]:
    """Ljung-Box test at 0.1 %, and the residual's memory in samples (first lag whose correlation is
    lost in the noise).
    """
    from scipy.special import chdtri

    statistic, total, memory = 0.0, 0, 1
    for r in series:
        n = len(r)
        if n < 4 * lags:
            continue
        r = r - r.mean()
        power = float(r @ r)
        if power <= 0:
            continue
        f = np.fft.rfft(r, 2 * n)
        rho = np.fft.irfft(f * np.conj(f))[: n // 2] / power
        statistic += n * float(np.sum(rho[1 : lags + 1] ** 2))
        total += lags
        below = np.flatnonzero(np.abs(rho) < max(0.05, 2 / np.sqrt(n)))
        memory = max(memory, int(below[0]) if below.size else n // 4)
    return total == 0 or bool(statistic < chdtri(total, 0.001)), memory


def long_run(scores: list[tuple[list[int], np.ndarray]], n: int, memory: int) -> np.ndarray:
    """Long-run covariance of the summed scores: Bartlett weights over four times the residual's
    memory.
    """
    from scipy.fft import rfft

    S = np.zeros((n, n))
    for columns, s in scores:
        bandwidth = int(min(4 * memory, len(s) // 3))
        length = transform_length(len(s))
        lags = np.zeros(
            length
        )  # the weights of all lags, whose products are summed as those of spectra
        lags[: bandwidth + 1] = 1 - np.arange(bandwidth + 1) / (bandwidth + 1)
        lags[length - bandwidth :] = lags[bandwidth:0:-1]
        weights = np.real(np.asarray(rfft(lags))) / length
        weights[1 : (length + 1) // 2] *= 2  # those of negative frequencies
        f = np.asarray(rfft(s, length, axis=0, workers=cores()))
        S[np.ix_(columns, columns)] += sum(
            part.T @ (weights[:, None] * part) for part in (np.real(f), np.imag(f))
        )
    values, vectors = np.linalg.eigh((S + S.T) / 2)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def transform_length(n: int) -> int:
    """A short length of Fourier transforms that holds a series of n samples and all its lags."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(2 * n + 1, real=True) or 0)


@dataclass(frozen=True)
class RowCovariance:
    """What rows determine of the numbers they are columns of. `condition` of the weighted columns,
    `condition_scaled` of these at equal lengths; `groups` of numbers that are tied together;
    `white` residuals, or their `memory` in rows.
    """

    matrix: Float[np.ndarray, "numbers numbers"]
    identifiable: Bool[np.ndarray, " numbers"]
    groups: tuple[tuple[int, ...], ...]
    condition: float
    condition_scaled: float
    white: bool
    memory: int


def sandwich(
    slope: Float[np.ndarray, "numbers numbers"],
    middle: Float[np.ndarray, "numbers numbers"],
    least: Float[np.ndarray, "numbers numbers"],
    weak: float,
) -> Float[np.ndarray, "numbers numbers"]:
    """slope^-1 middle slope^-T, positive semidefinite, with standard deviations nowhere below those
    that `least` makes in the place of `middle`. Directions of the slope weaker than the share
    `weak` of the strongest count as known.
    """
    inverse = np.linalg.pinv(slope, rcond=weak)
    made = inverse @ middle @ inverse.T
    return positive(no_narrower(made, np.diag(inverse @ least @ inverse.T)))


#: Share of the least variance below which a variance is rounding.
SMALLEST = 1e-12


def no_narrower(
    covariance: Float[np.ndarray, "numbers numbers"], least: Float[np.ndarray, " numbers"]
) -> Float[np.ndarray, "numbers numbers"]:
    """A covariance with variances of at least `least`; its correlations stay."""
    own = np.diag(covariance)
    told = own > SMALLEST * least  # of less than that, correlations are rounding
    stretch = np.sqrt(np.maximum(1.0, least / np.where(told, own, np.inf)))
    wider = np.where(told & told[:, None], covariance, 0.0) * stretch * stretch[:, None]
    return wider + np.diag(np.where(told, 0.0, least))


@dataclass(frozen=True)
class RowNoise:
    """What numbers leave of weighted rows, and the columns (or instruments) that it makes scores
    with, in units of `scale`.
    """

    columns: ForceRows
    weights: ByJoint
    scale: Float[np.ndarray, " numbers"]
    errors: Sequence[Float[np.ndarray, "samples joints"]]
    told: int  # numbers that the rows tell

    @cached_property
    def series(self) -> list[Float[np.ndarray, " samples"]]:
        """The residual of each joint of each run."""
        return list(itertools.chain.from_iterable(e.T for e in self.errors))

    @cached_property
    def white_and_memory(self) -> tuple[bool, int]:
        return whiteness(self.series)

    @property
    def count(self) -> int:
        return sum(map(len, self.series))

    @property
    def freedom(self) -> int:
        return max(1, self.count - len(self.scale))

    def flat(self, variances: Sequence[float]) -> Float[np.ndarray, "numbers numbers"]:
        """Covariance of the scores where each joint of each run has white noise of a variance."""
        each = np.split(np.sqrt(variances), len(self.weights))
        weights = [w * std for w, std in zip(self.weights, each, strict=True)]
        return _products(self.columns, self.columns, weights, self.scale)

    def slow(self) -> Float[np.ndarray, "numbers numbers"]:
        """The long-run covariance of the scores themselves (Newey and West 1987)."""
        numbers, scores = list(range(len(self.scale))), []
        for Z, e, w in zip(self.columns.columns, self.errors, self.weights, strict=True):
            scores.append((numbers, np.einsum("tj,tjk->tk", e * w, Z) / self.scale))
        _, memory = self.white_and_memory
        return long_run(scores, len(numbers), memory) * self.count / self.freedom


Scores = tuple[Float[np.ndarray, "numbers numbers"], Float[np.ndarray, "numbers numbers"]]


def of_joints(noise: RowNoise) -> Scores:
    """Each joint of each run by the long-run variance of its own residual, over the freedom that
    the numbers leave it; no standard deviation below that of the scores themselves. For tens of
    numbers, which take much of the slow part of a short record's residual.
    """
    _, memory = noise.white_and_memory
    times = [correlation_time([r - r.mean()], memory) for r in noise.series]
    pairs = list(zip(noise.series, times, strict=True))
    independent = sum(len(r) / time for r, time in pairs)
    freedom = max(0.1, 1 - noise.told / independent)
    variances = [float(np.mean(r**2)) * time / freedom for r, time in pairs]
    return noise.flat(variances), noise.slow()


def of_scores(noise: RowNoise) -> Scores:
    """The scores themselves where residuals have a memory; no standard deviation below that of
    white ones of their size. For few numbers.
    """
    variance = sum(float(r @ r) for r in noise.series) / noise.freedom
    flat = noise.flat([variance] * len(noise.series))
    white, _ = noise.white_and_memory
    return (flat if white else noise.slow()), flat


def covariance_of_rows(
    rows: ForceRows,
    weights: ByJoint,
    theta: Float[np.ndarray, " numbers"],
    scores: Callable[[RowNoise], Scores],
    *,
    instruments: ForceRows | None = None,
    information: Float[np.ndarray, "numbers numbers"] | None = None,
    short: float = 0.0,
    weak: float = 1e-5,
) -> RowCovariance:
    """Covariance of numbers theta that solve weighted rows, Z'(A theta - b) = 0 with instruments Z
    in the place of A, beside `information` on them. `scores`: what covariance the residual gives
    Z'(A theta - b), and what it does at least. A column shorter than the share `short` of the
    longest tells nothing, a direction weaker than the share `weak` of the strongest is open.
    """
    A, _ = rows.triangles().stacked(weights)
    length = np.linalg.norm(A, axis=0)
    seen = length > short * max(float(length.max()), 1e-300)
    scale = np.where(seen, length, 1.0)
    square = (A / scale).T @ (A / scale)
    identifiable, groups = null_directions(square, seen)
    plain = np.linalg.svd(A[:, seen], compute_uv=False)
    scaled = np.linalg.svd(A[:, seen] / scale[seen], compute_uv=False)

    Z = rows if instruments is None else instruments
    errors = [e * w for e, w in zip(rows.errors(theta), weights, strict=True)]
    noise = RowNoise(Z, weights, scale, errors, told=int(seen.sum()))
    middle, least = scores(noise)
    slope = square if instruments is None else _products(Z, rows, weights, scale)
    if information is not None:
        told = information / scale / scale[:, None]
        slope, middle = slope + told, middle + told
    white, memory = noise.white_and_memory
    return RowCovariance(
        matrix=sandwich(slope, middle, least, weak**2) / scale / scale[:, None],
        identifiable=identifiable & seen,
        groups=groups,
        condition=float(plain[0] / plain[-1]),
        condition_scaled=float(scaled[0] / scaled[-1]),
        white=white,
        memory=memory,
    )


def correlation_time(
    series: Sequence[Float[np.ndarray, " rows"]], most: int, lost: float = LOST
) -> float:
    """How many rows share one piece of noise: 1 + 2 sum of the autocorrelation of some series up to
    the first lag where less than `lost` is left of it, at most `most` lags and a third of a series.
    """
    power = sum(float(r @ r) for r in series)
    if power <= 0:
        return 1.0
    found = 1.0
    for lag in range(1, min(most, max(map(len, series)) // 3) + 1):
        share = sum(float(r[lag:] @ r[:-lag]) for r in series) / power
        if share < lost:
            break
        found += 2 * share
    return found


def _products(
    left: ForceRows, right: ForceRows, weights: ByJoint, scale: Float[np.ndarray, " numbers"]
) -> Float[np.ndarray, "numbers numbers"]:
    """Sums of products of weighted columns, over the squares of the scale."""
    out = np.zeros((len(scale), len(scale)))
    for Z, W, w in zip(left.columns, right.columns, weights, strict=True):
        for joint in range(left.joints):
            factor = w[joint] / scale
            out += (Z[:, joint] * factor).T @ (W[:, joint] * factor)
    return out
