"""Rows of the torque equation of several runs: columns times the model's numbers make the torque.

What takes only sums of products can work on `triangles`, a few rows in the place of all of them,
with any weights of the joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


Numbers = Float[np.ndarray, " numbers"]
#: One array a run: of each of its joints one number.
ByJoint = Sequence[Float[np.ndarray, " joints"]]


@dataclass(frozen=True)
class ForceRows:
    """Of each run its columns and its torque; `counts` samples that these rows stand for."""

    columns: tuple[Float[np.ndarray, "samples joints numbers"], ...]
    torque: tuple[Float[np.ndarray, "samples joints"], ...]
    counts: tuple[int, ...]

    @classmethod
    def of(
        cls,
        columns: Sequence[Float[np.ndarray, "samples joints numbers"]],
        torque: Sequence[Float[np.ndarray, "samples joints"]],
    ) -> ForceRows:
        return cls(tuple(columns), tuple(torque), tuple(map(len, torque)))

    @property
    def joints(self) -> int:
        return self.torque[0].shape[1]

    @property
    def size(self) -> int:
        """How many numbers there are."""
        return self.columns[0].shape[2]

    def errors(self, theta: Numbers) -> list[Float[np.ndarray, "samples joints"]]:
        """What the numbers leave of the torque of each run."""
        return [tau - W @ theta for W, tau in zip(self.columns, self.torque, strict=True)]

    def rms(self, theta: Numbers) -> list[Float[np.ndarray, " joints"]]:
        """Root mean square of what the numbers leave of each joint of each run."""
        errors = zip(self.errors(theta), self.counts, strict=True)
        return [np.sqrt(np.sum(e**2, axis=0) / count) for e, count in errors]

    def plain_weights(self) -> list[Float[np.ndarray, " joints"]]:
        """Weights of which all are 1."""
        return [np.ones(self.joints) for _ in self.torque]

    def weighted(self, weights: ByJoint) -> ForceRows:
        """The rows of each joint of each run times its weight."""
        columns = [W * w[:, None] for W, w in zip(self.columns, weights, strict=True)]
        torque = [tau * w for tau, w in zip(self.torque, weights, strict=True)]
        return ForceRows(tuple(columns), tuple(torque), self.counts)

    def beside(self, more: Sequence[Float[np.ndarray, "samples joints more"]]) -> ForceRows:
        """With more columns, of numbers that follow those that are here."""
        pairs = zip(self.columns, more, strict=True)
        columns = [np.concatenate([W, D], axis=2) for W, D in pairs]
        return ForceRows(tuple(columns), self.torque, self.counts)

    def stacked(
        self, weights: ByJoint, at: slice | np.ndarray = slice(None)
    ) -> tuple[Float[np.ndarray, "rows numbers"], Float[np.ndarray, " rows"]]:
        """All rows under each other, those of each joint of each run times its weight; of the
        columns those `at` some places.
        """
        b = np.concatenate([(tau * w).ravel() for tau, w in zip(self.torque, weights, strict=True)])
        A = np.empty((len(b), self.columns[0][0, 0, at].size))
        first = 0
        for W, tau, w in zip(self.columns, self.torque, weights, strict=True):
            part = A[first : first + tau.size].reshape(*tau.shape, -1)
            for joint in range(self.joints):  # one after the other, for memory's sake
                part[:, joint] = W[:, joint, at] * w[joint]
            first += tau.size
        return A, b

    def triangles(self) -> ForceRows:
        """Few rows with the same sums of products: those of each joint brought down to a
        triangle.
        """
        made = [_triangles(W, tau) for W, tau in zip(self.columns, self.torque, strict=True)]
        columns, torque = zip(*made, strict=True)
        return ForceRows(columns, torque, self.counts)


def _triangles(
    W: Float[np.ndarray, "samples joints numbers"], tau: Float[np.ndarray, "samples joints"]
) -> tuple[Float[np.ndarray, "few joints numbers"], Float[np.ndarray, "few joints"]]:
    made = []
    for joint in range(tau.shape[1]):
        both = np.column_stack([W[:, joint], tau[:, joint]])
        made.append(np.linalg.qr(both, mode="r"))
    rows = np.stack(made, axis=1)
    return rows[:, :, :-1], rows[:, :, -1]
