"""What a device may be told and may do: checked for a whole path before any motion, clamped at
every command, compared with every measurement.

They protect against mistakes in a trajectory, not people. Keep the emergency stop in reach.
"""

from __future__ import annotations

import math
from collections.abc import Sequence


class Refused(ValueError):
    """A command that is no number, or of another length; nothing may be sent in its place."""


class Clamp:
    """The last gate before the wire: every command leaves it finite, inside its bounds and one
    small step from the last one.

    `lower`, `upper`, `step` hold one number a joint, in the unit of the command. The first command
    may be one step away from `start`. `count` says how often a command had to be changed.
    """

    def __init__(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        step: Sequence[float],
        start: Sequence[float],
    ):
        if not len(lower) == len(upper) == len(step) == len(start):
            raise Refused("bounds, step and start differ in length")
        if not all(
            a <= b and s > 0 and math.isfinite(x)
            for a, b, s, x in zip(lower, upper, step, start, strict=True)
        ):
            raise Refused("bounds are empty, a step is not above 0, or the start is not a number")
        self.lower, self.upper, self.step = tuple(lower), tuple(upper), tuple(step)
        self.last = tuple(start)
        self.count = 0

    def __call__(self, command: Sequence[float]) -> tuple[float, ...]:
        """The command as it may be sent. Raises `Refused` for NaN, infinity or a wrong length."""
        if len(command) != len(self.lower) or not all(map(math.isfinite, command)):
            raise Refused(
                f"a command must be {len(self.lower)} finite numbers, not {list(command)}"
            )
        sent = []
        for value, low, high, step, last in zip(
            command, self.lower, self.upper, self.step, self.last, strict=True
        ):
            # A start outside the bounds (a robot put there by hand) is led back in steps.
            inside = min(max(value, low), high)
            sent.append(min(max(inside, last - step), last + step))
        self.count += any(abs(a - b) > 1e-12 for a, b in zip(sent, command, strict=True))
        self.last = tuple(sent)
        return self.last
