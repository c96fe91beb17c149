"""Sets of effects as models: each with its numbers by the runs that are fitted, and what it leaves of
the runs that are held out. Which of them are believed is for `weigh` and `claims`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jaxid.diagnosis.torque.algebra import ColumnPrior, Departure, Gram, Solution, solve
from jaxid.diagnosis.torque.library import Unit


@dataclass(frozen=True, eq=False)
class Model:
    """A set of units with its solution on the fit runs, and what it leaves of each block of the
    held-out ones.
    """

    units: tuple[int, ...]
    solution: Solution
    held: np.ndarray
    #: By how much its numbers depart from those of a reference, chi-square units.
    departed: float = 0.0

    @property
    def cost(self) -> float:
        return self.solution.cost

    @property
    def loss(self) -> float:
        return float(self.held.sum()) + self.departed


class Chooser:
    """Sets of units, each solved once."""

    def __init__(
        self,
        units: Sequence[Unit],
        size: int,
        fit: Gram,
        held: Gram,
        known: ColumnPrior,
        start: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        departs: Departure | None = None,
    ):
        """`size` numbers of the nominal model come first among the columns. `departs`: what a
        reference told, whose recording counts beside the held-out runs.
        """
        self.departs = departs
        self.units, self.size, self.fit, self.held = units, size, fit, held
        self.known, self.start, self.lower, self.upper = known, start, lower, upper
        ends = size + np.cumsum([0, *(len(u.fields) for u in units)])
        self.columns = [np.arange(a, b) for a, b in zip(ends, ends[1:], strict=False)]
        self._models: dict[frozenset[int], Model | None] = {}
        self.tried: list[Model] = []

    # ---- models

    @cached_property
    def nominal(self) -> Model:
        found = self.model(())
        assert found is not None
        return found

    def at(self, units: Iterable[int]) -> np.ndarray:
        return np.concatenate([np.arange(self.size), *(self.columns[u] for u in sorted(units))])

    def model(self, units: Iterable[int]) -> Model | None:
        """None where an effect would have to act the wrong way round, or what it leaves is no
        number.
        """
        key = frozenset(units)
        if key not in self._models:
            s = solve(self.fit.total, self.at(key), self.known, self.start, self.lower, self.upper)
            # A number of an effect that its bound holds at nothing is one that is not there.
            dead = bool(key) and any(np.all(s.theta[self._own(key, u)] == 0) for u in key)
            departed = 0.0 if self.departs is None else self.departs(s.theta)
            held = self.held.losses(s.at, s.theta)
            sure = not key or np.isfinite([s.cost, departed, *held]).all()
            found = Model(tuple(sorted(key)), s, held, departed)
            self._models[key] = found if sure and not dead else None
            if self._models[key] is not None:
                self.tried.append(self._models[key])  # type: ignore[arg-type]
        return self._models[key]

    def _own(self, key: frozenset[int], unit: int) -> slice:
        first = self.size + sum(len(self.columns[u]) for u in sorted(key) if u < unit)
        return slice(first, first + len(self.columns[unit]))

    def price(self, units: Iterable[int]) -> float:
        """What the numbers of a set have to be worth on the fit runs."""
        count = sum(
            len(self.columns[u]) - len(self.units[u].hidden) + bool(self.units[u].shape)
            for u in units
        )
        return count * np.log(max(self.fit.rows, 2))

    def different(self, chosen: Model) -> Model:
        """Of a set those units that bring the numbers back to the reference's: what both recordings
        lack is no difference between them. The whole set where that is none of it.
        """
        kept = []
        for u in chosen.units:
            less = self.model([v for v in chosen.units if v != u])
            if less is None or less.departed - chosen.departed > self.price((u,)):
                kept.append(u)
        if not kept:
            return chosen
        return self.model(kept) or chosen

    def lively(self, units: Sequence[int], base: Sequence[int] = ()) -> Model | None:
        """The model of a set, without those of its units that would act the wrong way round; None
        where none is left of what it has beyond `base`.
        """
        while set(units) - set(base):
            if (found := self.model(units)) is not None:
                return found
            s = solve(
                self.fit.total, self.at(units), self.known, self.start, self.lower, self.upper
            )
            key = frozenset(units)
            units = [u for u in units if u in base or np.any(s.theta[self._own(key, u)] != 0)]
            if key == frozenset(units):
                return None
        return None
