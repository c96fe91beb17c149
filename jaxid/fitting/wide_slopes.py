"""A descent on slopes as wide as the noise, for runs that touch.

A run that touches the ground a step of its simulator earlier gets another push: the residual jumps,
by little and often. Slopes over tiny steps lie between two jumps and lead nowhere. Here they are
differences over as much as moves the residual by about its own size, along the principal directions
of what is known, which averages over the jumps (implicit filtering, Kelley 2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxid.fitting.least_squares import Path, problem_clip
from jaxid.fitting.secant import residuals
from jaxid.problem.problem import FitProblem


#: Half widths of the differences, in what moves the residual by its own root mean square.
WIDTHS = (3.0, 1.0)
#: Shares of the mean curvature that are added to it, one trial each.
DAMPED = (0.0, 0.03, 0.3, 3.0, 30.0)
#: Shares of a step, about each of which so many points are tried at random.
SHARES, SCATTERED = (1.0, 0.5, 0.25), 8
#: Width of the scatter, as a share of that of the differences.
SCATTER = 0.3
#: Points that are tried about where a descent ends beside the noise.
ABOUT = 48
#: Step of the first differences, in typical changes of a number.
TINY = 1e-6
#: A round that gains less than this share is of no account.
SLIGHT = 1e-3
#: Mean squares of noise differ from 1 by so many of their standard deviations at most.
CHANCE = 4.0


class WideDescent:
    """Where a descent stands, and what the last differences told of its surroundings."""

    def __init__(self, problem: FitProblem, z: np.ndarray):
        self.problem = problem
        self.z = problem_clip(problem, z)
        self.rng = np.random.default_rng(0)
        self.simulated = 0
        (self.r,) = self._residuals([self.z])
        self.count = self.r.size - len(problem.known_before(self.z)[0])
        #: d residual / d z over the last differences [samples size].
        self.slopes = np.zeros((self.r.size, problem.size))
        self.curvature: np.ndarray | None = None
        self.gradient: np.ndarray | None = None

    @property
    def squares(self) -> float:
        return _squares(self.r)

    def step(self, width: float) -> float:
        """Takes the best of all points of one round; by how much the sum of squares falls."""
        size = width * max(1.0, float(np.sqrt(self.squares / self.r.size)))
        directions = self._directions()
        ahead = [self.z + size * d for d in directions.T]
        behind = [self.z - size * d for d in directions.T]
        beside = [problem_clip(self.problem, z) for z in (*ahead, *behind)]
        found = self._residuals(beside)
        n = self.problem.size
        slopes = np.zeros((self.r.size, n))
        for k in range(n):
            slopes[:, k] = self._slope(found[k], found[n + k], size)
        gram = slopes.T @ slopes
        pull = slopes.T @ self.r
        back = np.linalg.pinv(directions)
        self.slopes = slopes @ back
        self.curvature = self.slopes.T @ self.slopes
        self.gradient = self.slopes.T @ self.r
        trials = self._trials(directions, gram, pull, size)
        points = [*beside, *trials]
        residual = [*found, *self._residuals(trials)]
        return self._moved(points, residual)

    def look_about(self) -> float:
        """Takes the best of points about where it stands, within what the runs tell before they are
        lost; by how much the sum of squares falls. Where a run touches next is decided there, and
        what comes after a touch that the machine did not make leads elsewhere.
        """
        slopes = self.slopes[self._followed()]
        directions = principal_directions(self.problem, slopes.T @ slopes)
        points = []
        for _ in range(ABOUT):
            aside = directions @ self.rng.normal(size=self.problem.size)
            points.append(problem_clip(self.problem, self.z + aside))
        return self._moved(points, self._residuals(points))

    def _moved(self, points: Sequence[np.ndarray], found: Sequence[np.ndarray]) -> float:
        """Goes to the best of some points, where that is better; by how much."""
        squares = [_squares(r) for r in found]
        best = int(np.argmin(squares))
        gained = self.squares - squares[best]
        if not gained > 0:
            return 0.0
        self.z, self.r = points[best], found[best]
        return gained

    def _followed(self) -> np.ndarray:
        """Which residuals are those of the runs before they leave the noise, and what is known
        without them [samples].
        """
        kept, begin = np.ones(self.r.size, bool), 0
        for record in self.problem.records:
            samples = self.problem.runs.record(record).samples
            end = begin + self.problem.targets[samples].size
            kept[begin:end] = before_lost(self.r[begin:end])
            begin = end
        return kept

    def _slope(self, ahead: np.ndarray, behind: np.ndarray, size: float) -> np.ndarray:
        """By both sides, or by that which does not diverge; 0 where neither says anything."""
        sides = [r for r in (ahead, behind) if np.isfinite(r).all()]
        if len(sides) == 2:
            return (ahead - behind) / (2 * size)
        if not sides:
            return np.zeros_like(self.r)
        sign = 1.0 if sides[0] is ahead else -1.0
        return sign * (sides[0] - self.r) / size

    def path(self, converged: bool) -> Path:
        """The descent as it ended."""
        p = self.problem
        stopped = "tolerance" if converged else "iteration limit"
        return Path(
            problem=p,
            z=self.z,
            cost=self.squares / 2,
            gradient=self.gradient,
            hessian=self.curvature,
            count=self.count,
            converged=converged,
            stopped=stopped,
            history=[],
        )

    def _directions(self) -> np.ndarray:
        if self.curvature is None:
            self.curvature = self._curvature_here()
        return principal_directions(self.problem, self.curvature)

    def _curvature_here(self) -> np.ndarray:
        """By differences over tiny steps, before any others are known."""
        p = self.problem
        h = TINY * p.scale
        h = np.where(self.z + h <= p.upper, h, -h)
        ahead = self._residuals([self.z + step for step in np.diag(h)])
        slopes = np.zeros((self.r.size, self.problem.size))
        for k, r in enumerate(ahead):
            if np.isfinite(r).all():
                slopes[:, k] = (r - self.r) / h[k]
        return slopes.T @ slopes

    def _trials(
        self, directions: np.ndarray, gram: np.ndarray, pull: np.ndarray, size: float
    ) -> list[np.ndarray]:
        n = len(gram)
        mean = max(float(np.trace(gram)) / n, 1e-300)
        steps = [np.linalg.solve(gram + (d + 1e-9) * mean * np.eye(n), pull) for d in DAMPED]
        trials = [self.z - directions @ step for step in steps]
        towards = directions @ steps[1]
        for share in SHARES:
            for _ in range(SCATTERED):
                aside = SCATTER * size * directions @ self.rng.normal(size=n)
                trials.append(self.z - share * towards + aside)
        return [problem_clip(self.problem, z) for z in trials]

    def _residuals(self, points: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Those of the data and of what is known without them."""
        self.simulated += len(points)
        out = []
        for z, r in zip(points, residuals(self.problem, points), strict=True):
            known = self.problem.known_before(z)[0]
            out.append(np.concatenate([r, known]))
        return out


def principal_directions(p: FitProblem, curvature: np.ndarray) -> np.ndarray:
    """Principal directions of what is known, each as long as moves the residual by the noise, or as
    a typical change of a number where nothing is known [size size].
    """
    scaled = p.scale[:, None] * curvature * p.scale
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    return p.scale[:, None] * vectors / np.sqrt(np.maximum(values, 1.0))


def descend_widely(
    p: FitProblem, z: np.ndarray, rounds: int, slight: float = SLIGHT
) -> tuple[Path, int]:
    """A descent from z, and how many times the runs were simulated. Ends after so many rounds, or
    where one of each width gains no more than the share `slight`; one, where it is at the noise.
    """
    descent = WideDescent(p, z)
    if not p.size:
        return descent.path(True), descent.simulated
    idle = 0
    for k in range(rounds):
        if not np.isfinite(descent.squares):
            break
        before = descent.squares
        gained = descent.step(WIDTHS[k % len(WIDTHS)])
        idle = idle + 1 if gained <= slight * before else 0
        if idle and is_noise(descent.squares, descent.count):
            idle = len(WIDTHS)
        if idle == len(WIDTHS):
            if is_noise(descent.squares, descent.count):
                break
            before = descent.squares
            if descent.look_about() <= slight * before:
                break
            idle = 0
    return descent.path(idle == len(WIDTHS)), descent.simulated


def is_noise(squares: float, count: int) -> bool:
    """Whether the squares of so many residuals sum up to no more than chance makes of noise."""
    return bool(squares <= _most_of_noise(count))


def before_lost(r: np.ndarray) -> np.ndarray:
    """Which residuals of a run, in the order of time, come before it leaves the noise [samples]."""
    with np.errstate(all="ignore"):
        sums = np.cumsum(r**2)
    noise = sums <= _most_of_noise(np.arange(1, r.size + 1))
    return np.logical_and.accumulate(noise)


def _most_of_noise(count: Any) -> Any:
    """What the squares of so many residuals of noise sum up to at most."""
    return count + CHANCE * np.sqrt(2 * count)


def _squares(r: np.ndarray) -> float:
    """The sum of squares, infinite where a run diverged."""
    with np.errstate(all="ignore"):
        found = float(r @ r)
    return found if np.isfinite(found) else np.inf
