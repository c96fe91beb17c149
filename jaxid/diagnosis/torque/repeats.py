"""What repeats of a run differ by, in the numbers of the model: warmth, lubrication, another day.

A run's rows scatter about the model by their own noise, and by what all numbers are off in that run
alone: random effects (Laird and Ware 1982, whose EM steps these are). What a law explains beyond
that, it explains in spite of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxid.data.repeats import repeats


if TYPE_CHECKING:
    from jaxid.diagnosis.torque.algebra import Solution, Weights
    from jaxid.diagnosis.torque.study import TorqueRows, TorqueStudy

#: Where the likeliest covariance is looked for first: one share of each number, in units of what is
#: left of a row.
SHARES = np.concatenate([[0.0], np.geomspace(1e-4, 100.0, 121)])
#: Steps of expectation and maximisation from there.
STEPS = 60


def spread_between(
    study: TorqueStudy, rows: TorqueRows, weights: Weights, solution: Solution
) -> np.ndarray:
    """A root of the covariance of the nominal model's numbers from repeat to repeat [plant.size k]:
    the likeliest one for what repeats that are not kept for the report differ by. No column where
    nothing is repeated, or repeats differ by their noise.
    """
    size = np.abs(solution.theta[: study.plant.size])
    parts: list[_Apart] = []
    for group in _groups(study):
        parts += _apart(study, rows, weights, solution, group)
    if not parts:
        return np.zeros((len(size), 0))
    count = sum(part.count for part in parts)
    at_share = []
    for share in SHARES:
        root = np.diag(share * size)
        at_share.append(np.sum([part.squares(root) for part in parts], 0))
    found = np.array(at_share)
    variance = found[:, 0] / count  # of a row's noise, the likeliest one beside each share
    best = int(np.argmin(count * np.log(np.maximum(variance, 1e-300)) + found[:, 1]))
    if best == 0:
        return np.zeros((len(size), 0))
    scaled = [part.scaled(size) for part in parts]
    covariance, noise = SHARES[best] ** 2 * variance[best] * np.eye(len(size)), variance[best]
    for _ in range(STEPS):
        moments = [part.expected(covariance, noise) for part in scaled]
        covariance = np.mean([m for m, _ in moments], 0)
        noise = sum(rest for _, rest in moments) / count
    values, vectors = np.linalg.eigh(covariance)
    return size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def shrunk(products: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Sums of products [p + 1 p + 1] of one run's rows, weighed by the covariance that numbers with
    this spread [k r] make of them (Woodbury): columns of these numbers come first.
    """
    own = spread.T @ products[: len(spread)]
    return products - own.T @ np.linalg.solve(
        np.eye(len(own)) + own[:, : len(spread)] @ spread, own
    )


def _groups(study: TorqueStudy) -> list[list[int]]:
    place = {r.experiment.name: k for k, r in enumerate(study.runs)}
    kept = [e for e in study.binding.dataset.seen if e.name in place]
    groups = []
    for group in repeats(kept):
        groups.append([place[e.name] for e in group])
    return groups


@dataclass(frozen=True)
class _Apart:
    """Sums of products of the columns of the model's numbers [k k], with what the residual of a
    repeat is off the mean of all [k], and of that with itself; how many of its rows are
    independent.
    """

    products: np.ndarray
    target: np.ndarray
    power: float
    count: float

    def scaled(self, size: np.ndarray) -> _Apart:
        """With numbers in units of `size` [k]."""
        return _Apart(
            self.products * size * size[:, None], self.target * size, self.power, self.count
        )

    def squares(self, spread: np.ndarray) -> tuple[float, float]:
        """Sum of squares weighed by the covariance that numbers with this spread make, and the
        logarithm of its determinant.
        """
        inside, b = (
            np.eye(spread.shape[1]) + spread.T @ self.products @ spread,
            spread.T @ self.target,
        )
        return self.power - float(b @ np.linalg.solve(inside, b)), float(
            np.linalg.slogdet(inside)[1]
        )

    def expected(self, covariance: np.ndarray, noise: float) -> tuple[np.ndarray, float]:
        """Second moment of the numbers, and sum of squares of the noise, given the rows."""
        gain = np.linalg.solve(
            np.eye(len(covariance)) + covariance @ self.products / noise, covariance
        )
        mean = gain @ self.target / noise
        rest = (
            self.power
            - 2 * mean @ self.target
            + mean @ self.products @ mean
            + np.sum(self.products * gain)
        )
        return np.outer(mean, mean) + gain, float(rest)


def _apart(
    study: TorqueStudy, rows: TorqueRows, weights: Weights, s: Solution, group: Sequence[int]
) -> list[_Apart]:
    length, p = min(len(rows.rows[k]) for k in group), study.plant.size
    left = np.array([rows.residual(k, s.at, s.theta)[:length] for k in group])
    columns = np.mean([rows.rows[k][:length, :, :p] for k in group], 0)
    off = (left - left.mean(0)) * np.sqrt(len(group) / (len(group) - 1))
    out = []
    for k, d in zip(group, off, strict=True):
        unsure, moves = study.unsure[k][:length], study.runs[k].moves
        both = weights(np.concatenate([columns, d[:, :, None]], 2), moves, unsure).reshape(
            -1, p + 1
        )
        g = both.T @ both
        out.append(_Apart(g[:p, :p], g[:p, p], float(g[p, p]), weights.count(moves, unsure)))
    return out
