"""Couplings of joints by a curve: a polynomial of the file, its inverse, or several of these in
turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np


#: Points of a table from which an inverse begins, and steps of Newton's method after it: a table of
#: this many is off by 1e-4 of the range at most, which each step squares.
POINTS, NEWTON = 129, 3
#: A slope of less than this share of the largest is none: there the curve cannot be turned about.
FLAT = 1e-3


@dataclass(frozen=True)
class Polynomial:
    """y = c0 + c1 x + c2 x^2 + ..., for x between `low` and `high`; with `inverse` x of y."""

    coefficients: tuple[float, ...]
    low: float = -np.inf
    high: float = np.inf
    inverse: bool = False

    @property
    def straight(self) -> bool:
        return not any(self.coefficients[2:])

    @property
    def turns(self) -> bool:
        """Whether one x belongs to each y."""
        if self.straight:
            return self.coefficients[1] != 0
        if not np.isfinite([self.low, self.high]).all():
            return False
        slope = _derivative(self.coefficients, np.linspace(self.low, self.high, POINTS))[1]
        return bool(
            np.abs(slope).min() > FLAT * np.abs(slope).max() and np.ptp(np.sign(slope)) == 0
        )

    def turned(self) -> Polynomial:
        """The inverse; of a line another line."""
        if not self.straight:
            return replace(self, inverse=not self.inverse)
        offset, ratio = self.coefficients[:2]
        return Polynomial((-offset / ratio, 1 / ratio))

    def at(self, x: Any) -> tuple[Any, Any, Any]:
        """Value, slope and second derivative."""
        if not self.inverse:
            return _derivative(self.coefficients, x)
        y, x = x, self._begin(x)
        for _ in range(NEWTON):
            value, slope, _ = _derivative(self.coefficients, x)
            x = x - (value - y) / slope
        _, slope, bend = _derivative(self.coefficients, x)
        return x, 1 / slope, -bend / slope**3

    def _begin(self, y: Any) -> Any:
        x = np.linspace(self.low, self.high, POINTS)
        table = _derivative(self.coefficients, x)[0]
        if table[0] > table[-1]:
            x, table = x[::-1], table[::-1]
        interpolated = np.interp if isinstance(y, float | np.ndarray) else jnp.interp
        return interpolated(y, table, x)


def _derivative(coefficients: Sequence[float], x: Any) -> tuple[Any, Any, Any]:
    """A polynomial, its first and its second derivative, by Horner's rule."""
    value = slope = bend = 0.0 * x
    for c in reversed(coefficients):
        bend = bend * x + 2 * slope
        slope = slope * x + value
        value = value * x + c
    return value, slope, bend


@dataclass(frozen=True)
class Curve:
    """q_follower of q_leader: `pieces` one after the other. `about` is the position of the leader
    at which numbers that have to be one for all positions are taken.
    """

    pieces: tuple[Polynomial, ...]
    about: float

    def at(self, q: Any) -> tuple[Any, Any, Any]:
        """Position of the follower, and its first and second derivative by the leader's."""
        value, slope, bend = q, 1.0 + 0.0 * q, 0.0 * q
        for piece in self.pieces:
            value, first, second = piece.at(value)
            bend = second * slope**2 + first * bend
            slope = first * slope
        return value, slope, bend

    @property
    def turns(self) -> bool:
        return all(piece.turns for piece in self.pieces)

    def turned(self) -> Curve:
        """q_leader of q_follower."""
        pieces = tuple(piece.turned() for piece in reversed(self.pieces))
        return Curve(pieces, float(self.at(self.about)[0]))

    def tangent(self) -> tuple[float, float]:
        """(offset, ratio) of the line that touches it."""
        value, slope, _ = self.at(self.about)
        return float(value - slope * self.about), float(slope)
