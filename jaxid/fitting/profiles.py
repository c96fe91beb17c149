"""Intervals that do not rest on a parabola: profile likelihood and bootstrap, each all at once in
batches of lanes.

The covariance of `jaxid.fitting.covariance` is the first answer; a profile shows where it misleads
(a bound, a bent valley, a parameter that the data do not determine), a bootstrap where residuals
are neither white nor Gaussian.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxid.base.display import displays
from jaxid.fitting.covariance import covariance, CovarianceEstimate
from jaxid.fitting.least_squares import levenberg_marquardt, Path
from jaxid.fitting.noise_model import Autoregression
from jaxid.problem.problem import FitProblem, rows


if TYPE_CHECKING:
    from matplotlib.axes import Axes


#: Samples that a resampled series runs before it counts.
BURN_IN = 1000

#: Steps of a profile to either side, in standard deviations.
STEPS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)


@dataclass(frozen=True)
class Profile:
    """Rise of -2 log likelihood over its minimum along one parameter, all others fitted anew at
    each of its values.

    An end of the interval is None where the rise stays below the threshold up to the last value
    looked at: the data do not bound the parameter on that side (`at_bound` tells whether that value
    is its bound).
    """

    name: str
    values: np.ndarray
    rise: np.ndarray
    threshold: float
    interval: tuple[float | None, float | None]
    at_bound: tuple[bool, bool]
    unit: str = ""

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draws the profile with its threshold and the ends of the interval, on new axes or the
        given ones.
        """
        return displays().picture(self, ax)


def profile_likelihood(
    problem: FitProblem, z: np.ndarray, parameters: Sequence[str] | None = None, level: float = 0.95
) -> dict[str, Profile]:
    """Profiles of parameters (by name; default all) around the minimum z of a sum of squares.

    Steps are fractions of the parameter's own standard deviation, so a parameter known to a
    millionth gets as good a profile as one known to a half. All parameters and both sides are one
    batch at every step, each starting where the last ended. The noise is that of the problem, or
    what the residuals at the minimum show if that is more, with their correlation counted: a model
    that misses the data gets wider intervals.
    """
    from scipy.stats import chi2

    names = problem.names[: problem.free.size]
    chosen = names if parameters is None else list(parameters)
    cov = covariance(problem, z)
    # The quadratic rise of one standard deviation, so that stated and profiled widths mean the same
    # noise.
    base = levenberg_marquardt([(problem, z)], 3, 1e-12)[0]
    threshold = float(chi2.ppf(level, 1))
    tracks = []
    for name in chosen:
        k = names.index(name)
        std, scale = _width(problem, cov, base, k)
        tracks += [Track(problem, k, side, std, scale, base.z, base.cost) for side in (-1, 1)]
    for step in STEPS:
        going = [t for t in tracks if t.goes_on(threshold)]
        if not going:
            break
        jobs = [t.job(step) for t in going]
        for track, path in zip(going, levenberg_marquardt(jobs, 12, 1e-9), strict=True):
            track.take(path.z, path.cost)
    sides = zip(tracks[::2], tracks[1::2], strict=True)
    return {
        name: _profile(problem, base.z, name, left, right, threshold)
        for name, (left, right) in zip(chosen, sides, strict=True)
    }


def _width(problem: FitProblem, cov: CovarianceEstimate, base: Path, k: int) -> tuple[float, float]:
    """The first step of a profile, and how much wider the noise is than the problem's."""
    curvature = base.hessian
    assert curvature is not None
    others = np.delete(np.arange(problem.size), k)
    bend = (
        curvature[k, k]
        - curvature[k, others]
        @ np.linalg.pinv(curvature[np.ix_(others, others)], rcond=1e-12)
        @ curvature[others, k]
    )
    std = cov.std[k]
    if not np.isfinite(std):
        return float(0.02 * (problem.upper - problem.lower)[k]), 1.0
    if not std > 0:
        std = 0.02 * (problem.upper - problem.lower)[k]
    return float(std), max(float(std**2 * bend), 1.0) if bend > 0 else 1.0


def _profile(
    problem: FitProblem, z: np.ndarray, name: str, left: Track, right: Track, threshold: float
) -> Profile:
    """Both sides of a parameter in its own unit."""
    k = left.k
    position = int(problem.free[k])

    def unit(v: float) -> float:
        return float(np.exp(v)) if problem.log[k] else float(v)

    own = problem.theta(z)[position]
    assert abs(unit(z[k]) - own) <= 1e-9 * max(1.0, abs(own))
    low, high = left.crossing(threshold), right.crossing(threshold)
    values = [*reversed(left.values[1:]), *right.values]
    return Profile(
        name,
        np.array([unit(v) for v in values]),
        np.array([*reversed(left.rise[1:]), *right.rise]),
        threshold,
        (None if low is None else unit(low), None if high is None else unit(high)),
        (left.ended, right.ended),
        problem.runs.layout.entries[position].unit,
    )


class Track:
    """One side of a profile on its way out."""

    def __init__(
        self,
        problem: FitProblem,
        k: int,
        side: int,
        std: float,
        scale: float,
        z: np.ndarray,
        cost: float,
    ):
        self.problem, self.k, self.side, self.std, self.scale, self.cost = (
            problem,
            k,
            side,
            std,
            scale,
            cost,
        )
        self.values, self.rise, self.points, self.ended = [float(z[k])], [0.0], [z], False

    def goes_on(self, threshold: float) -> bool:
        return not self.ended and self.rise[-1] <= 1.5 * threshold

    def job(self, step: float) -> tuple[FitProblem, np.ndarray]:
        """The problem with the parameter held a step further out, and where the others went so far
        as its start.
        """
        p, k = self.problem, self.k
        bound = p.lower[k] if self.side < 0 else p.upper[k]
        value = self.values[0] + self.side * step * self.std
        if (bound - value) * self.side <= 0:
            value, self.ended = bound, True
        share = (
            (value - self.values[-1]) / (self.values[-1] - self.values[-2])
            if len(self.values) > 1
            else 0.0
        )
        drift = (
            share * (self.points[-1] - self.points[-2])
            if len(self.values) > 1
            else np.zeros(p.size)
        )
        guess = np.clip(self.points[-1] + drift, p.lower, p.upper)
        guess[k] = value
        self.values.append(float(value))
        free = np.delete(p.free, k)
        base = p.base.copy()
        base[p.free[k]] = np.exp(value) if p.log[k] else value
        low, high, scale = p.whole
        held = FitProblem(p.runs, base, free, low, high, p.records, scale=scale, priors=p.priors)
        held.targets, held.weights = p.targets, p.weights
        return held, np.delete(guess, k)

    def take(self, z: np.ndarray, cost: float) -> None:
        self.points.append(np.insert(z, self.k, self.values[-1]))
        self.rise.append(
            max(0.0, 2 * (cost - self.cost)) / self.scale if np.isfinite(cost) else np.inf
        )

    def crossing(self, threshold: float) -> float | None:
        """Where the rise passes the threshold: linear in its square root, which is a line for a
        parabola.
        """
        root, goal = np.sqrt(self.rise), np.sqrt(threshold)
        above = np.flatnonzero(root >= goal)
        if not above.size:
            return None
        i = int(above[0])
        if not np.isfinite(root[i]):
            return self.values[i]
        share = (goal - root[i - 1]) / (root[i] - root[i - 1])
        return self.values[i - 1] + share * (self.values[i] - self.values[i - 1])


@dataclass(frozen=True)
class Bootstrap:
    """Refits of resampled recordings: `samples` [replicas parameters] in the parameters' units, one
    column a name.
    """

    names: tuple[str, ...]
    samples: np.ndarray
    memory: float  # samples that share one piece of noise
    failed: int

    @property
    def std(self) -> dict[str, float]:
        return {
            n: float(s) for n, s in zip(self.names, np.std(self.samples, 0, ddof=1), strict=True)
        }

    def interval(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Percentile interval of each parameter."""
        low, high = np.quantile(self.samples, [(1 - level) / 2, (1 + level) / 2], axis=0)
        return {n: (float(a), float(b)) for n, a, b in zip(self.names, low, high, strict=True)}


def bootstrap(problem: FitProblem, z: np.ndarray, replicas: int = 200, seed: int = 0) -> Bootstrap:
    """Bootstrap of the residuals at the minimum z of a sum of squares, all refits as one batch.

    Coloured residuals are taken for stationary noise with a memory (`jaxid.fitting.noise_model`):
    its innovations are resampled and run through it anew (the sieve of Bühlmann 1997), scaled up
    where a record holds few independent ones. White residuals are resampled themselves. All columns
    of a sample stay together.
    """
    parts = list(rows([(problem, z)]))
    cov = covariance(problem, z)
    seen = sum(np.count_nonzero(p.r, axis=0) for p in parts)
    count = np.maximum(1, seen)
    noise = cov.noise or [Autoregression(np.zeros(0), np.nan)] * len(count)
    first = max(len(n.ar) for n in noise)
    innovations = []
    for part in parts:
        whitened = [n.whitened(r) for n, r in zip(noise, part.r.T, strict=True)]
        innovations.append(np.stack(whitened, 1)[first:])
    size = np.sqrt(sum(np.sum(e**2, 0) for e in innovations) / count)
    if cov.noise:
        scale = cov.widened * np.array([n.innovation for n in noise]) / np.maximum(size, 1e-300)
    else:
        scale = np.full(len(count), np.sqrt(count.sum() / max(count.sum() - problem.size, 1)))
    rng = np.random.default_rng(seed)
    predicted = problem.predictions(z)
    jobs = []
    for _ in range(replicas):
        targets = problem.targets.copy()
        for part, e, y in zip(parts, innovations, predicted, strict=True):
            at = problem.runs.record(part.record).samples
            drawn = (e - e.mean(0))[rng.integers(0, len(e), len(at) + BURN_IN)]
            coloured = [n.coloured(d)[BURN_IN:] for n, d in zip(noise, drawn.T, strict=True)]
            series = np.stack(coloured, 1)
            targets[at] = y - scale * series / np.where(part.w > 0, part.w, np.inf)
        jobs.append((problem.with_targets(targets), z))
    paths = levenberg_marquardt(jobs, 8, 1e-8)
    good = [p.z for p in paths if np.isfinite(p.cost)]
    memory = max(n.memory() for n in noise) if cov.noise else 1.0
    theta = np.array([problem.theta(p)[problem.free] for p in good])
    return Bootstrap(tuple(problem.names[: problem.free.size]), theta, memory, replicas - len(good))
