"""Probabilities of what is missing: of sets of effects, of each effect at each place, of families.

Every hypothesis is a set of effects at places. What it leaves of data that were not fitted to it
is its evidence, and probabilities are sums over sets. No model of a machine reaches the noise, so
that what is left counts as a discrepancy of unknown size that lies in few directions: a law that is
missing comes again at every pass of the same motion, and many samples of it are not many witnesses.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np


Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class EvidenceRule:
    """The constants of the rule, chosen by log score on tuning twins.

    `directions`: how many directions of the data of one channel a discrepancy has. `per_number`:
    what each number of an effect costs. `log_prior`: logarithm of what an effect at a place has
    beforehand against its absence. `free_prior`, `free_room`: the same of a free law, and how much
    of what its numbers could have been otherwise it pays for (see `room`). `sure`: a probability
    from which an effect is claimed; `possible`: one from which it is said to be possible; `share`:
    the least share of the gap of its place that a claim has to be worth.
    """

    directions: float = 16.0
    per_number: float = 0.5
    log_prior: float = -5.0
    free_prior: float = -4.0
    free_room: float = 0.7
    sure: float = 0.95
    possible: float = 0.3
    share: float = 0.01

    @property
    def log_odds(self) -> float:
        """Log evidence that a claim needs."""
        return float(np.log(self.sure / (1 - self.sure)))


RULE = EvidenceRule()


def log_evidence(left: np.ndarray, rows: np.ndarray, directions: np.ndarray | float) -> np.ndarray:
    """Log evidence [sets channels] of what sets leave of the data.

    `left [sets channels]`: sums of squares in units of the noise, divided by how many rows share
    one piece of noise. `rows [channels]`: how many independent rows there are. `directions`: of the
    discrepancy, [sets channels] or what spreads to it.

    A discrepancy is normal with a variance that is not known, in `directions` of the directions,
    and the noise is in all of them; that variance is profiled. Just above the noise this is the
    plain likelihood. Far above it only the share of the gap that is closed counts. Below it nothing
    is left to explain: the noise is not known so well. A sum that is no number has no evidence.
    """
    left = np.asarray(left, float)
    nu = np.broadcast_to(np.asarray(directions, float), left.shape)
    with np.errstate(invalid="ignore"):
        found = -nu / 2 * np.log1p(np.maximum(left - rows, 0.0) / nu)
    return np.where(np.isfinite(left), found, -np.inf)


def room(
    gain: np.ndarray, left: np.ndarray, numbers: np.ndarray, directions: np.ndarray | float
) -> np.ndarray:
    """What the numbers of a free law cost by what they could have been otherwise: half the
    logarithm of what is known of each after the data over before (Occam's factor).

    `gain`: what the law takes from the sum of squares beside what else is in its set, `left`: what
    is left beyond the noise, of the same shape. A law that carries the whole gap is taken to be
    that large beforehand, so that it costs much; one that mends what an effect leaves costs little.
    """
    count = np.maximum(numbers, 1)
    signal = directions * np.maximum(gain, 0.0) / ((np.maximum(left, 0.0) + directions) * count)
    return np.asarray(numbers) / 2 * np.log1p(signal)


def normalised(log_weights: np.ndarray) -> np.ndarray:
    """Probabilities [sets] that go as the exponentials of `log_weights [sets]`. What is no number
    has none; where nothing has any, all is with the first set, which claims nothing.
    """
    weights = np.where(np.isnan(log_weights), -np.inf, np.asarray(log_weights, float))
    top = weights.max()
    if not np.isfinite(top):
        return np.eye(len(weights))[0]
    raised = np.exp(weights - top)
    return raised / raised.sum()


@dataclass(frozen=True)
class SetMember:
    """One unit of a set: what it is called, where it acts, how many numbers it has, how many shapes
    of the same effect share its prior, and whether it is a free law.
    """

    name: str
    place: str
    numbers: int
    shapes: int = 1
    free: bool = False


def log_prior(
    sets: Sequence[Sequence[int]], units: Sequence[SetMember], rule: EvidenceRule = RULE
) -> np.ndarray:
    """Log prior [sets] of sets of `units`, given by their indices, less the price of the numbers of
    effects.
    """
    each = np.array([_log_prior(u, rule) for u in units])
    return np.array([each[list(s)].sum() for s in sets], float)


def _log_prior(unit: SetMember, rule: EvidenceRule) -> float:
    if unit.free:
        return rule.free_prior
    return rule.log_prior - float(np.log(unit.shapes)) - rule.per_number * unit.numbers


@dataclass(frozen=True)
class Probabilities:
    """Of `sets` of units, the empty one among them: `weights [sets]`, which sum to one."""

    units: tuple[SetMember, ...]
    sets: tuple[tuple[int, ...], ...]
    weights: np.ndarray = field(repr=False)

    @property
    def best(self) -> tuple[int, ...]:
        """The most probable set."""
        return self.sets[int(np.argmax(self.weights))]

    @property
    def none(self) -> float:
        """That nothing is missing of all that was asked."""
        return self.of(lambda unit: True, absent=True)

    def of(self, holds: Callable[[SetMember], bool], absent: bool = False) -> float:
        """That a set has a unit of which `holds(unit)`; `absent`: that it has none."""
        wanted = np.array([holds(unit) for unit in self.units], bool)
        inside = [np.any(wanted[list(s)]) for s in self.sets]
        chosen = np.array(inside, bool) ^ absent
        # A sum of shares may end a rounding beyond one.
        return float(np.clip(self.weights[chosen].sum(), 0.0, 1.0))

    def summed(self, key: Callable[[SetMember], Key]) -> dict[Key, float]:
        """For each value of `key(unit)` the probability that a unit of that value is there."""
        out: dict[Key, float] = {}
        for s, weight in zip(self.sets, self.weights, strict=True):
            for value in {key(self.units[u]) for u in s}:
                out[value] = out.get(value, 0.0) + float(weight)
        return {value: min(p, 1.0) for value, p in out.items()}

    @property
    def places(self) -> dict[tuple[str, str], float]:
        """(effect, place) -> probability that it is there, in whatever shape."""
        return self.summed(lambda unit: (unit.name, unit.place))
