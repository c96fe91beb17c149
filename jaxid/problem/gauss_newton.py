"""Curvature of losses that are no sums of squares, as of reweighted least squares."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.problem.objective import AbstractProblem, Linear, linearise, rows


def gauss_newton_model(
    jobs: Sequence[tuple[AbstractProblem, np.ndarray]], share: float = 1.0
) -> list[Linear]:
    """`linearise` for any loss: twice the loss, its gradient, and the curvature of the reweighted
    least-squares problem that has the same gradient (Lawson's reweighting: e^2 / |e| for absolute
    values, |e_c|^2 / |e|_c for the norm of a channel).
    """
    if all(p.loss_name == "sum_of_squares" for p, _ in jobs):
        return [_mean(at) for at in linearise(jobs, share)]
    sums = [_ChannelSums(len(p.data.norm), p.size) for p, _ in jobs]
    with np.errstate(all="ignore"):
        for part in rows(jobs, share, pieces=True):
            absolute = jobs[part.job][0].loss_name == "sum_of_abs"
            for c in range(part.r.shape[1]):
                seen = part.w[:, c] > 0
                w = part.w[seen, c]
                e, J = part.r[seen, c] / w, part.J[seen, c] / w[:, None]
                sums[part.job].add(c, e, J, w, part.z_columns, absolute)
            sums[part.job].count += part.r.size
        for (p, _), own in zip(jobs, sums, strict=True):
            if p.loss_name == "sum_of_norms":
                own.take_norms(p.data.norm)
    return [own.linear() for own in sums]


def _mean(at: Linear) -> Linear:
    n = max(1, at.count)
    return Linear(2 * at.cost / n, 2 * at.gradient / n, 2 * at.hessian / n, at.count)


class _ChannelSums:
    """Loss, gradient and curvature of each channel, summed over the rows of a problem."""

    def __init__(self, channels: int, size: int):
        self.cost = np.zeros(channels)
        self.gradient = np.zeros((channels, size))
        self.hessian = np.zeros((channels, size, size))
        self.count = 0

    def add(
        self,
        c: int,
        e: np.ndarray,
        J: np.ndarray,
        w: np.ndarray,
        columns: Sequence[int],
        absolute: bool,
    ) -> None:
        """Adds errors e [rows] of a channel, their derivatives J by some columns and weights w."""
        if absolute:
            # A residual within a twentieth of the noise counts as that large: the weight stays
            # finite.
            weight = 1 / np.maximum(np.abs(e), 0.05 / w)
            loss, pull = np.sum(np.abs(e)), np.sign(e)
        else:
            weight, loss, pull = np.ones_like(e), e @ e, e
        self.cost[c] += loss
        self.gradient[c, columns] += pull @ J
        self.hessian[c][np.ix_(columns, columns)] += (J * weight[:, None]).T @ J

    def take_norms(self, norm: np.ndarray) -> None:
        """Sums of squares become the norms of the channels."""
        scale = 1 / np.sqrt(np.maximum(self.cost * norm, 1e-300))
        self.cost = np.sqrt(self.cost / np.maximum(norm, 1e-300))
        self.gradient = self.gradient * scale[:, None]
        self.hessian = self.hessian * scale[:, None, None]

    def linear(self) -> Linear:
        return Linear(
            2 * float(self.cost.sum()), self.gradient.sum(0), self.hessian.sum(0), self.count
        )
