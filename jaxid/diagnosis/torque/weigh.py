"""Which sets of effects and free laws, each with its probability.

One or two joints are asked together. Of more, each joint is asked beside what stands elsewhere,
then what acts on several of them. Last, whatever stands is asked against anything else in its
place, since numbers of the model couple the joints.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from jaxid.diagnosis.probability import (
    EvidenceRule,
    log_evidence,
    log_prior,
    normalised,
    Probabilities,
    room,
    RULE,
    SetMember,
)
from jaxid.diagnosis.torque.free_laws import OVER
from jaxid.diagnosis.torque.held_out import ColumnsBeside, HeldOutRows
from jaxid.diagnosis.torque.library import Unit


#: Most units of one set that is asked at once.
MOST = 3
#: Sets that are followed from one size to the next, by few and by many directions.
BEAM = 10
#: Sets of one size that are judged on held-out blocks.
HEARD = 400
#: Times that all joints are asked at most, each beside what the others have.
SWEEPS = 3
#: Joints that are asked together.
TOGETHER = 2
#: Logarithm beyond which odds are as good as certain.
LARGEST = 50.0


@dataclass(frozen=True, eq=False)
class Asked:
    """Units that were asked together, beside others: what sets of them are worth."""

    units: tuple[int, ...]
    found: Probabilities
    #: Sums of squares [sets] of the joints that judged.
    left: np.ndarray

    @property
    def best(self) -> tuple[int, ...]:
        return tuple(self.units[u] for u in self.found.best)


class Question:
    """Which of the `asked` units stand beside those of `base`, as the rows of `joints` say."""

    def __init__(
        self,
        scales: Scales,
        base: Iterable[int],
        asked: Sequence[int],
        joints: Sequence[int],
        directions: float,
    ):
        self.scales, self.asked, self.joints = scales, list(asked), list(joints)
        self.directions = directions
        columns = [scales.columns[u] for u in self.asked]
        ends = np.cumsum([0, *map(len, columns)])
        self.own = [np.arange(a, b) for a, b in zip(ends, ends[1:], strict=False)]
        beside = np.concatenate([np.arange(scales.size), *(scales.columns[u] for u in base)])
        self.algebra: ColumnsBeside = scales.data.beside(
            beside.astype(int), np.concatenate([*columns, []]).astype(int)
        )
        self.hypotheses = scales.hypotheses(self.asked)
        self.signed = [scales.units[u].least >= 0 for u in self.asked]

    def places(self, s: Iterable[int]) -> frozenset[tuple[str, str]]:
        """Effects and places of a set."""
        return frozenset((self.hypotheses[u].name, self.hypotheses[u].place) for u in s)

    def judged(self, sets: Sequence[tuple[int, ...]]) -> tuple[np.ndarray, np.ndarray]:
        """Log evidence with prior and price [sets], and sums of squares [sets]."""
        left, costs = self.left(sets), np.zeros(len(sets))
        for which, columns in self._by_size(sets):
            costs[which] = self.algebra.costs(columns)
        costs += 2 * self.scales.rule.free_room * self._room(sets, left)
        left, rows = left[:, self.joints], self.scales.data.rows[self.joints]
        found = log_evidence(left, rows, self.directions).sum(1) - costs / 2
        return found + log_prior(sets, self.hypotheses, self.scales.rule), left.sum(1)

    def _room(self, sets: Sequence[tuple[int, ...]], left: np.ndarray) -> np.ndarray:
        """What free laws cost in sets [sets] that leave `left` [sets n]."""
        free = np.array([h.free for h in self.hypotheses], bool)
        which = [i for i, s in enumerate(sets) if np.any(free[list(s)])]
        out = np.zeros(len(sets))
        if not which:
            return out
        plain = [self._without_free(sets[i]) for i in which]
        each = {s: k for k, s in enumerate(dict.fromkeys(plain))}
        without = self.left(list(each))[[each[s] for s in plain]]
        numbers = np.zeros_like(without)
        for row, i in enumerate(which):
            for u in sets[i]:
                joint = self.scales.units[self.asked[u]].joints[0]
                numbers[row, joint] += free[u] * self.hypotheses[u].numbers
        rows = self.scales.data.rows
        beyond = np.maximum(left[which] - rows, 0.0)
        gain = np.maximum(without - rows, 0.0) - beyond
        out[which] = room(gain, beyond, numbers, self.directions).sum(1)
        return out

    def _without_free(self, s: Sequence[int]) -> tuple[int, ...]:
        return tuple(u for u in s if not self.hypotheses[u].free)

    def left(self, sets: Sequence[tuple[int, ...]]) -> np.ndarray:
        """Sums of squares [sets n] of every joint, as multiples of the noise."""
        out = np.zeros((len(sets), len(self.scales.data.joints)))
        for which, columns in self._by_size(sets):
            out[which] = self.algebra.left(columns)
        return out

    def allowed(self, sets: Sequence[tuple[int, ...]]) -> tuple[np.ndarray, np.ndarray]:
        """Whether every number acts the way round that physics allows [sets], and what sets explain
        of all rows [sets].
        """
        inside, gain = np.ones(len(sets), bool), np.zeros(len(sets))
        for which, columns in self._by_size(sets):
            theta = self.algebra.numbers(columns)
            signed = np.array([self._signs(sets[int(i)]) for i in which], bool)
            inside[which] = np.all(~signed.reshape(theta.shape) | (theta >= 0), axis=1)
            gain[which] = self.algebra.explained(columns)
        return inside, gain

    def _signs(self, s: Iterable[int]) -> np.ndarray:
        """Which numbers of a set may not be negative."""
        return np.concatenate([*(self.signed[u] for u in s), []])

    def _by_size(self, sets: Sequence[tuple[int, ...]]) -> Iterable[tuple[np.ndarray, np.ndarray]]:
        """Which sets have as many columns as each other, and these columns [sets k]."""
        each = np.array([len(own) for own in self.own])
        sizes = np.array([each[list(s)].sum() for s in sets], int)
        for size in np.unique(sizes):
            which = np.flatnonzero(sizes == size)
            columns = [self._columns(sets[int(i)]) for i in which]
            yield which, np.array(columns, int).reshape(len(which), size)

    def _columns(self, s: Iterable[int]) -> np.ndarray:
        return np.concatenate([*(self.own[u] for u in s), []])

    def answered(self, most: int) -> Asked:
        """The search from nothing, one unit more at a time."""
        every: list[tuple[int, ...]] = [()]
        first, left = self.judged([()])
        weights, squares = [first], [left]
        beam: list[tuple[int, ...]] = [()]
        for _ in range(most):
            wider = self._wider(beam)
            if not wider:
                break
            found, left = self.judged(wider)
            every += wider
            weights.append(found)
            squares.append(left)
            beam = self._leading(wider, found, left)
        units = tuple(self.hypotheses)
        probabilities = Probabilities(units, tuple(every), normalised(np.concatenate(weights)))
        return Asked(tuple(self.asked), probabilities, np.concatenate(squares))

    def _wider(self, beam: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
        """Sets with one unit more, those that explain most for their price."""
        found: dict[tuple[int, ...], None] = {}
        for s in beam:
            taken = self.places(s)
            for u, h in enumerate(self.hypotheses):
                if (h.name, h.place) not in taken:
                    found[tuple(sorted((*s, u)))] = None
        sets = list(found)
        if not sets:
            return []
        inside, gain = self.allowed(sets)
        worth = gain + 2 * log_prior(sets, self.hypotheses, self.scales.rule)
        order = np.argsort(-np.where(inside, worth, -np.inf), kind="stable")
        return [sets[i] for i in order[:HEARD] if inside[i]]

    def _leading(
        self, sets: Sequence[tuple[int, ...]], found: np.ndarray, left: np.ndarray
    ) -> list[tuple[int, ...]]:
        """Those that go on: the best by few directions, then by the sums of squares themselves, one
        shape of each set of effects.
        """
        kept: dict[frozenset[tuple[str, str]], tuple[int, ...]] = {}
        for order, most in ((-found, BEAM), (left, 2 * BEAM)):
            for i in np.argsort(order, kind="stable"):
                if len(kept) >= most:
                    break
                kept.setdefault(self.places(sets[i]), sets[i])
        return list(kept.values())


@dataclass(frozen=True, eq=False)
class Scales:
    """Rows of some runs with the columns of all units, ready to be asked. `size` columns are those
    that every set has.
    """

    data: HeldOutRows
    units: Sequence[Unit]
    size: int
    rule: EvidenceRule = RULE

    @cached_property
    def columns(self) -> list[np.ndarray]:
        ends = self.size + np.cumsum([0, *(len(u.fields) for u in self.units)])
        return [np.arange(a, b) for a, b in zip(ends, ends[1:], strict=False)]

    def hypotheses(self, asked: Sequence[int]) -> list[SetMember]:
        """What the units `asked` are for the rule: shapes of one effect share its prior."""
        counts: dict[tuple[str, str], int] = {}
        for u in asked:
            place = self.units[u].place
            counts[place] = counts.get(place, 0) + self.units[u].tried
        out = []
        for u in asked:
            unit = self.units[u]
            numbers = len(unit.fields) - len(unit.hidden)
            shapes, free = counts[unit.place], unit.effect in OVER
            out.append(SetMember(unit.effect, unit.location, numbers, shapes, free))
        return out

    @cached_property
    def alive(self) -> list[int]:
        """Units that act at all in these rows."""
        diagonal = np.diag(self.data.total)
        return [u for u, own in enumerate(self.columns) if np.any(diagonal[own] > 0)]

    @cached_property
    def moving(self) -> list[int]:
        """Joints of which rows count."""
        return [int(j) for j in np.flatnonzero(self.data.rows > 0)]

    def groups(self) -> list[tuple[list[int], list[int]]]:
        """Units that are asked together, and the joints whose rows judge them."""
        if len(self.moving) <= TOGETHER:
            return [(self.alive, self.moving)]
        alone: dict[int, list[int]] = {j: [] for j in self.moving}
        several = []
        for u in self.alive:
            joints = self.units[u].joints
            if len(joints) == 1 and joints[0] in alone:
                alone[joints[0]].append(u)
            elif len(joints) > 1:
                several.append(u)
        groups = [(units, [joint]) for joint, units in alone.items() if units]
        return [*groups, (several, self.moving)] if several else groups

    def directions(self, joints: Sequence[int]) -> float:
        """Of a discrepancy at each of these joints: those of many joints are no independent
        witnesses.
        """
        together = len(joints) > TOGETHER
        return self.rule.directions / len(joints) if together else self.rule.directions


@dataclass(frozen=True, eq=False)
class Weighed:
    """What was found: units of the most probable set, free laws among them, and probabilities."""

    scales: Scales
    asked: tuple[Asked, ...]
    best: tuple[int, ...]
    #: (effect, place) -> probability.
    places: dict[tuple[str, str], float]
    #: Unit that stands -> what was asked elsewhere, with the probability that it acts instead.
    swaps: dict[int, dict[int, float]] = field(default_factory=dict)


def weigh(scales: Scales, most: int = MOST) -> Weighed:
    """Asks all units of some rows, up to `most` of them at once."""
    groups = scales.groups()
    if len(groups) < 2:
        return _summed(scales, _swept(scales, groups, most))
    # What acts on several joints may do what a law at each of them does: either is asked first.
    orders = [groups, groups[::-1]] if len(groups[-1][1]) > 1 else [groups]
    found = [_summed(scales, _swept(scales, order, most)) for order in orders]
    worth = [_worth(weighed) for weighed in found]
    weighed = found[int(np.argmax(worth))]
    return _coupled(weighed)


def _swept(scales: Scales, groups: Sequence[tuple[list[int], list[int]]], most: int) -> list[Asked]:
    """Each group of units, asked beside what stands of the others."""
    answers: dict[int, Asked] = {}
    for _ in range(SWEEPS if len(groups) > 1 else 1):
        before = dict(answers)
        for k, (units, joints) in enumerate(groups):
            base = _standing(a for i, a in answers.items() if i != k)
            question = Question(scales, base, units, joints, scales.directions(joints))
            answers[k] = question.answered(most)
        if before and _standing(before.values()) == _standing(answers.values()):
            break
    return list(answers.values())


def _standing(answers: Iterable[Asked]) -> list[int]:
    """Units of the most probable sets."""
    out: list[int] = []
    for answer in answers:
        out += answer.best
    return out


def _summed(scales: Scales, found: Sequence[Asked]) -> Weighed:
    places: dict[tuple[str, str], float] = {}
    for a in found:
        places |= a.found.places
    best = tuple(sorted(_standing(found)))
    return Weighed(scales, tuple(found), best, places)


def _worth(weighed: Weighed) -> float:
    """Log evidence of all that stands, with its prior and price."""
    scales = weighed.scales
    question = Question(scales, [], weighed.best, scales.moving, scales.rule.directions)
    found, _ = question.judged([tuple(range(len(weighed.best)))])
    return float(found[0])


def _coupled(weighed: Weighed) -> Weighed:
    """The same once each unit that stands has been asked against anything elsewhere in its
    place.
    """
    scales, places = weighed.scales, dict(weighed.places)
    swaps: dict[int, dict[int, float]] = {}
    rivals = _best_shapes(weighed)
    exchange = _Exchange(scales, weighed.best, rivals)
    for u in weighed.best:
        group = next(a.units for a in weighed.asked if u in a.units)
        odds = exchange.odds(u, [v for v in rivals if v not in group])
        place = scales.units[u].place
        shared = places[place] / (1.0 + places[place] * sum(odds.values()))
        places[place] = shared
        swaps[u] = {v: shared * against for v, against in odds.items()}
        for v, p in swaps[u].items():
            other = scales.units[v].place
            places[other] = max(places.get(other, 0.0), p)
    return replace(weighed, places=places, swaps=swaps)


class _Exchange:
    """The set that stands, with one of its units in exchange for another one."""

    def __init__(self, scales: Scales, best: Sequence[int], rivals: Sequence[int]):
        asked = [*best, *rivals]
        self.scales = scales
        self.index = {u: i for i, u in enumerate(asked)}
        self.whole = tuple(range(len(best)))
        moving, rule = scales.moving, scales.rule
        self.question = Question(scales, [], asked, moving, rule.directions)

    def odds(self, unit: int, rivals: Sequence[int]) -> dict[int, float]:
        """For each rival, the odds that it acts and the unit does not, against that the unit acts,
        with or without the rival.
        """
        out: dict[int, float] = {}
        several = [v for v in rivals if self._several(unit, v)]
        alone = [v for v in rivals if v not in several]
        for some, joints in ((alone, self.scales.moving[:1]), (several, self.scales.moving)):
            if some:
                self.question.directions = self.scales.directions(joints)
                out |= self._odds(unit, some)
        return out

    def _several(self, *units: int) -> bool:
        return max(len(self.scales.units[u].joints) for u in units) > TOGETHER

    def _odds(self, unit: int, rivals: Sequence[int]) -> dict[int, float]:
        less = tuple(i for i in self.whole if i != self.index[unit])
        swapped = [(*less, self.index[v]) for v in rivals]
        more = [(*self.whole, self.index[v]) for v in rivals]
        inside, _ = self.question.allowed(swapped)
        found, _ = self.question.judged([self.whole, *swapped, *more])
        count = len(rivals)
        with_unit = np.logaddexp(found[0], found[1 + count :])
        against = np.where(inside, found[1 : 1 + count], -np.inf) - with_unit
        against = np.clip(np.nan_to_num(against, nan=-LARGEST), -LARGEST, LARGEST)
        return dict(zip(rivals, np.exp(against).tolist(), strict=True))


def _best_shapes(weighed: Weighed) -> list[int]:
    """Of each effect at each place that does not stand, the shape that was most probable where it
    was asked.
    """
    scales = weighed.scales
    taken = {scales.units[u].place for u in weighed.best}
    best: dict[tuple[str, str], tuple[float, int]] = {}
    for a in weighed.asked:
        weight = np.zeros(len(a.units))
        for s, x in zip(a.found.sets, a.found.weights, strict=True):
            weight[list(s)] += x
        for u, x in zip(a.units, weight, strict=True):
            place = scales.units[u].place
            if place not in taken and x > best.get(place, (-1.0, -1))[0]:
                best[place] = float(x), u
    return [u for _, u in best.values()]
