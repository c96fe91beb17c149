"""Linear least squares from a start and within bounds.

`NormalEquations` hold sums of products of columns and target: quick, and all that a search over
many columns needs. `Rows` hold rows themselves (or a triangle of as many), which keep twice the
digits. `solve` takes either.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


#: A direction of the scaled columns in which products say less than this share of what they say
#: elsewhere stays where it was.
WEAK = 1e-9
#: The same of rows, whose digits are not squared.
WEAK_ROWS = 1e-10
#: A bound lets a number go where the slope there, in units of what the fit explains, is steeper.
INWARDS = 1e-9

Numbers = Float[np.ndarray, " numbers"]


class LinearEquations(abc.ABC):
    """Abstract: what is known of `min |A x - b|` for numbers x."""

    @abc.abstractmethod
    def minimum(self, x: Numbers, free: Bool[np.ndarray, " numbers"]) -> Float[np.ndarray, " free"]:
        """The best numbers where x is `free`, the others held; directions that are left open stay
        where x has them.
        """

    @abc.abstractmethod
    def descent(self, x: Numbers) -> Numbers:
        """Half the steepest descent of the sum of squares at x: A'(b - A x)."""

    @property
    @abc.abstractmethod
    def sizes(self) -> Numbers:
        """Lengths of the columns of A."""

    @abc.abstractmethod
    def explained(self, x: Numbers) -> float:
        """b'A x, of the best numbers the square of what they explain."""


@dataclass(frozen=True)
class NormalEquations(LinearEquations):
    """`matrix` A'A and `right` A'b, with what is known beforehand added to both."""

    matrix: Float[np.ndarray, "numbers numbers"]
    right: Numbers

    @classmethod
    def of_rows(
        cls, A: Float[np.ndarray, "rows numbers"], b: Float[np.ndarray, " rows"]
    ) -> NormalEquations:
        return cls(A.T @ A, A.T @ b)

    def beside(
        self, information: Float[np.ndarray, "numbers numbers"], mean: Numbers
    ) -> NormalEquations:
        """With what is known beforehand: information about `mean`."""
        return NormalEquations(self.matrix + information, self.right + information @ mean)

    def minimum(self, x, free):
        own = self.matrix[np.ix_(free, free)]
        scaled, size = in_units_of_diagonal(own)
        if not len(scaled):
            return x[free]
        held = self.matrix[np.ix_(free, ~free)] @ x[~free]
        rest = self.right[free] - held - own @ x[free]
        regular = scaled + WEAK * np.eye(len(scaled))
        return x[free] + np.linalg.solve(regular, rest / size) / size

    def descent(self, x):
        return self.right - self.matrix @ x

    def explained(self, x):
        return float(self.right @ x)

    @property
    def sizes(self):
        return np.sqrt(np.maximum(np.diag(self.matrix), 1e-300))


@dataclass(frozen=True)
class Rows(LinearEquations):
    """`A` and `b` themselves. A direction of the scaled columns weaker than the share `weak` of the
    strongest is left open, and so is a column shorter than the share `short` of the longest.
    """

    A: Float[np.ndarray, "rows numbers"]
    b: Float[np.ndarray, " rows"]
    weak: float = WEAK_ROWS
    short: float = 0.0

    @classmethod
    def projected(
        cls,
        A: Float[np.ndarray, "rows numbers"],
        b: Float[np.ndarray, " rows"],
        Z: Float[np.ndarray, "rows instruments"],
        weak: float = WEAK_ROWS,
        short: float = 0.0,
    ) -> Rows:
        """Z'A x = Z'b in the two-stage form: A and b projected onto the columns of instruments."""
        size = np.linalg.norm(Z, axis=0)
        scaled = Z / np.where(size > 0, size, 1.0)
        Q, strength, _ = np.linalg.svd(scaled, full_matrices=False)
        Q = Q[:, strength > weak * strength[0]]
        return cls(Q.T @ A, Q.T @ b, weak, short)

    def known(self, mean: Numbers, std: Numbers) -> Rows:
        """With a row for each number: known beforehand to be `mean`, to within `std`."""
        A, b = np.concatenate([self.A, np.diag(1 / std)]), np.concatenate([self.b, mean / std])
        return Rows(A, b, self.weak, self.short)

    def minimum(self, x, free):
        size = np.linalg.norm(self.A[:, free], axis=0)
        shortest = max(self.short * float(self.sizes.max()), 1e-300)
        size = np.where(size > shortest, size, np.inf)
        rest = self.b - self.A @ x
        return x[free] + np.linalg.lstsq(self.A[:, free] / size, rest, rcond=self.weak)[0] / size

    def descent(self, x):
        return self.A.T @ (self.b - self.A @ x)

    def explained(self, x):
        return float(self.b @ (self.A @ x))

    @property
    def sizes(self):
        return np.linalg.norm(self.A, axis=0)


def solve(
    equations: LinearEquations,
    start: Numbers,
    lower: Numbers | None = None,
    upper: Numbers | None = None,
) -> tuple[Numbers, Bool[np.ndarray, " numbers"]]:
    """The best numbers within bounds, and which of them a bound holds: the primal method of active
    sets (Nocedal and Wright, Numerical Optimization, 2006, 16.5), from a start, which directions
    that are left open keep.
    """
    count = len(start)
    low = np.full(count, -np.inf) if lower is None else lower
    high = np.full(count, np.inf) if upper is None else upper
    x, held = np.clip(start, low, high), np.zeros(count, bool)
    size = np.maximum(equations.sizes, 1e-150)
    for _ in range(10 + 3 * count):
        step = np.zeros_like(x)
        step[~held] = equations.minimum(x, ~held) - x[~held]
        room = np.where(step > 0, high - x, np.where(step < 0, x - low, np.inf))
        share = room / np.maximum(np.abs(step), 1e-300)
        first = int(np.argmin(share)) if count else 0
        if count and share[first] < 1:
            x = np.clip(x + share[first] * step, low, high)
            bound = high if step[first] > 0 else low
            x[first], held[first] = bound[first], True
            continue
        x = np.clip(x + step, low, high)
        inwards = np.where(x <= low, 1.0, -1.0) * equations.descent(x) / size
        wrong = np.where(held & (low < high), inwards, 0.0)
        least = INWARDS * np.sqrt(max(equations.explained(x), 1e-300))
        if not wrong.max(initial=0.0) > least:
            break
        held[int(np.argmax(wrong))] = False
    return x, held


def in_units_of_diagonal(
    matrix: Float[np.ndarray, "numbers numbers"],
) -> tuple[Float[np.ndarray, "numbers numbers"], Numbers]:
    """A matrix in units of its diagonal, and the square roots of that, infinite where it is 0."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    size = np.where(size > 0, size, np.inf)
    return matrix / size / size[:, None], size
