"""Least squares on a force that need not be linear in its numbers: Gauss and Newton between bounds,
by normal equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxid.force.least_squares import NormalEquations, Numbers, solve


#: Steps at most, and how often one is made shorter that leads nowhere.
STEPS, SHORTER = 10, 8
#: By how much a step that leads nowhere is made shorter, and by how much longer the next may be
#: after one that gained more than half of what its slopes promised.
LESS, MORE = 8.0, 4.0
#: A fit is done where a step takes less than that share of the sum of squares, one that the reach
#: cuts off, and one that nothing does.
COARSE, FINE = 1e-2, 1e-3
#: A step whose cost is within that share of what the slopes promise was one of a linear model.
AS_SAID = 1e-3
#: A sum of squares below that is nothing.
NOTHING = 1e-14
#: Steps after which a fit that is hopeless is given up.
PATIENCE = 3

Residual = Float[np.ndarray, "rows joints"]
Slopes = Float[np.ndarray, "rows joints numbers"]


@dataclass(frozen=True)
class Room:
    """Bounds of the numbers and their usual size. A step moves those that are `limited` by no more
    than `reach` times that size; it is infinite for a linear model.
    """

    lower: Numbers
    upper: Numbers
    scale: Numbers
    limited: Bool[np.ndarray, " numbers"]
    reach: float

    def around(self, x: Numbers, reach: float) -> tuple[Numbers, Numbers, Numbers]:
        """Lower and upper end of a step from x, and how far it may go at all."""
        far = np.where(self.limited, reach * self.scale, np.inf)
        return np.maximum(self.lower - x, -far), np.minimum(self.upper - x, far), far

    def share(self, step: Numbers) -> float:
        """The largest limited part of a step, in usual sizes."""
        return float(np.max(np.abs(step / self.scale)[self.limited], initial=0.0))


@dataclass(frozen=True)
class DescentStep:
    """A step that led down: where to, what is left there, how much its slopes promised to leave,
    whether nothing but bounds cut it off, and the reach that it had.
    """

    x: Numbers
    residual: Residual
    cost: float
    promised: float
    whole: bool
    reach: float

    def done(self, before: float) -> bool:
        """Whether a next step can do no better. Where a whole step comes out as the slopes have it,
        they hold there too.
        """
        as_said = self.whole and self.cost <= self.promised * (1 + AS_SAID)
        least = FINE if self.whole else COARSE
        return self.cost < NOTHING or as_said or self.cost > before * (1 - least)


def descend(
    residual: Callable[[Numbers], Residual],
    slopes: Callable[[Numbers, Residual], Slopes],
    start: Numbers,
    room: Room,
    fitted: Bool[np.ndarray, " rows"],
    hopeless: float = np.inf,
) -> tuple[Numbers, Residual, Slopes]:
    """Numbers that leave least of the rows that are `fitted`, with the residual of all rows there
    and the slopes of the last step. A sum of squares above `hopeless` after `PATIENCE` steps ends
    it.
    """
    x, reach = start, room.reach
    left = residual(x)
    cost = float(np.sum(left[fitted] ** 2))
    made = np.zeros((*left.shape, len(x)))
    for number in range(STEPS):
        made = slopes(x, left)
        step = _down(
            residual=residual,
            slopes=made,
            x=x,
            left=left,
            cost=cost,
            room=room,
            reach=reach,
            fitted=fitted,
        )
        if step is None:
            break
        done = step.done(cost)
        good = cost - step.cost > 0.5 * (cost - step.promised)
        reach = step.reach * (MORE if good else 1.0)
        x, left, cost = step.x, step.residual, step.cost
        if done or (number + 1 >= PATIENCE and cost > hopeless):
            break
    return x, left, made


def _down(
    residual: Callable[[Numbers], Residual],
    slopes: Slopes,
    x: Numbers,
    left: Residual,
    cost: float,
    room: Room,
    reach: float,
    fitted: Bool[np.ndarray, " rows"],
) -> DescentStep | None:
    """The step of Gauss and Newton, made shorter until it leads down; None where none does."""
    A, before = slopes[fitted].reshape(-1, x.size), left[fitted].ravel()
    size = np.linalg.norm(A, axis=0)
    unit = 1 / np.where(size > 0, size, 1.0)
    A = A * unit
    equations = NormalEquations.of_rows(A, -before)  # twenty times quicker than a QR
    for _ in range(SHORTER):
        low, high, far = room.around(x, reach)
        found, _ = solve(equations, np.zeros_like(x), low / unit, high / unit)
        trial = np.clip(x + found * unit, room.lower, room.upper)
        there = residual(trial)
        new = float(np.sum(there[fitted] ** 2))
        if new < cost:
            promised = float(np.sum((before + A @ found) ** 2))
            whole = not np.any(np.abs(found * unit) >= 0.999 * far)
            return DescentStep(trial, there, new, promised, whole, reach)
        reach = min(reach, room.share(found * unit)) / LESS
    return None
