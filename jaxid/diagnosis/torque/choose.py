"""Which effects: proposed by the runs that are fitted, accepted by runs that are held out, taken
back where not needed.

One rule decides every step: of two sets of effects the smaller stands, unless the larger predicts
the held-out runs better by several of its own standard errors (blocks against blocks), worse in
none of them, and is worth its numbers on the fit runs too. Of what stands in the end the smallest
set is taken that predicts them as well, to within one standard error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.algebra import better, ColumnPrior, Departure, Gram, Solution, solve
from jaxid.diagnosis.torque.library import Unit


#: This many sets of a kind go before the held-out runs.
HEARD = 16
#: Most laws of one joint.
LAWS = 3


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


Enough = Callable[[Model], bool]


def explained(H: np.ndarray, b: np.ndarray) -> tuple[float, np.ndarray]:
    """Sum of squares that columns with these products explain, and their strengths."""
    values, vectors = np.linalg.eigh(H)
    seen = values > LIMITS.shows_itself
    along = vectors[:, seen].T @ b
    return float(np.sum(along**2 / values[seen])), vectors[:, seen] @ (along / values[seen])


class Chooser:
    """The search over sets of units."""

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
        most: int,
        by_joint: Callable[[Solution], np.ndarray] | None = None,
        enough: Enough = lambda model: False,
        departs: Departure | None = None,
    ):
        """`size` numbers of the nominal model come first among the columns; `most` kinds of effects
        may be named. `by_joint`: what a solution leaves of each block and joint of the held-out
        runs. Nothing is added to a model that is `enough`. `departs`: what a reference told, whose
        recording counts beside the held-out runs.
        """
        self.by_joint, self.enough, self.departs = by_joint, enough, departs
        self.units, self.size, self.fit, self.held, self.most = units, size, fit, held, most
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

    def _better(self, small: Model, large: Model) -> tuple[float, float]:
        """By how many standard errors the larger set predicts better, in all and in the worst run.

        Numbers that are free to move take in a load, and predict with it as well as without. The
        reference tells these apart: what they depart from it by is a loss of its recording.
        """
        total, worst = better(small.held, large.held, self.held)
        if self.departs is None:
            return total, worst
        fall = np.sign(total) * total**2 + small.departed - large.departed
        return float(np.sign(fall) * np.sqrt(abs(fall))), worst

    def accepted(self, small: Model, large: Model) -> bool:
        """Whether the larger set stands."""
        total, worst = self._better(small, large)
        more = self.price(large.units) - self.price(small.units)
        return (
            total > LIMITS.sure
            and worst > -LIMITS.missed
            and small.cost - large.cost > max(more, 0.0)
        )

    def missed(self, small: Model, large: Model) -> bool:
        """Whether what the larger set has more of would be missed."""
        more = self.price(large.units) - self.price(small.units)
        total, _ = self._better(small, large)
        return total > LIMITS.missed and small.cost - large.cost > max(more, 0.0)

    # ---- search

    def run(self) -> Model:
        chosen, seen = self.nominal, set[tuple[int, ...]]()
        while (
            chosen.units not in seen
            and len(self._kinds(chosen.units)) < self.most
            and not self.enough(chosen)
        ):
            seen.add(
                chosen.units
            )  # what is added and what is taken back could follow each other for ever
            found = [m for m in self._wider(chosen) if self.accepted(chosen, m)]
            if not found:
                break
            chosen = self._thinned(min(found, key=lambda m: m.loss))
            chosen = self._exchanged(chosen)
        return self._short(self._thinned(chosen))

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

    def _kinds(self, units: Iterable[int]) -> set[str]:
        """What counts as one: a law at all its joints; a pair or a body."""
        return {self.units[u].effect for u in units}

    def beside(self, units: Iterable[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sums of products of all columns, and with the target, once a set is projected out;
        columns in units of their size.
        """
        at, p = self.at(units), len(self.fit.total) - 1
        H = self.fit.total[:p, :p] + self.known.information
        b = self.fit.total[:p, -1] + self.known.information @ self.known.mean
        size = np.sqrt(np.maximum(np.diag(H), 0.0))
        size = np.where(size > 0, size, 1.0)
        H, b = H / size / size[:, None], b / size
        inside = np.linalg.solve(
            H[np.ix_(at, at)] + 1e-9 * np.eye(len(at)), np.column_stack([H[at], b[at]])
        )
        return H - H[:, at] @ inside[:, :-1], b - H[:, at] @ inside[:, -1], size

    def gains(self, units: Iterable[int]) -> np.ndarray:
        """What each unit alone would explain of the fit runs beside a set, nothing where it has
        nothing of its own.
        """
        out, (H, b, _) = np.zeros(len(self.units)), self.beside(units)
        for k, own in enumerate(self.columns):
            if k not in units and np.any(np.diag(H)[own] > LIMITS.shows_itself):
                out[k] = explained(H[np.ix_(own, own)], b[own])[0]
        return out

    def _best_shapes(self, units: Iterable[int]) -> dict[tuple[str, str], tuple[float, int]]:
        """Of each effect at each place the shape that explains most, for places where it is not
        yet.
        """
        taken, out = {self.units[u].place for u in units}, {}
        for k, gain in enumerate(self.gains(units)):
            place = self.units[k].place
            if gain > 0 and place not in taken and gain > out.get(place, (0.0, -1))[0]:
                out[place] = gain, k
        return out

    def _wider(self, chosen: Model) -> list[Model]:
        """The set with one effect more at one place, or at all of its places."""
        found = self._best_shapes(chosen.units)
        carried = {
            self.units[u].effect for u in chosen.units if np.all(np.isfinite(self.units[u].spread))
        }
        found = {p: f for p, f in found.items() if p[0] not in carried}  # one body at one link
        singles = [k for _, k in sorted(found.values(), reverse=True)][:HEARD]
        sets = [(*chosen.units, k) for k in singles]
        for effect in dict.fromkeys(e for e, _ in found):
            every = [k for (e, _), (_, k) in found.items() if e == effect]
            lone = all(len(self.units[k].joints) == 1 for k in every)
            sets += [(*chosen.units, *every)] if lone and len(every) > 1 else []
        return [m for s in sets if (m := self.lively(s, chosen.units)) is not None]

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

    def _thinned(self, chosen: Model) -> Model:
        """Without what is not missed, the least missed first."""
        while chosen.units:
            less = [
                m
                for u in chosen.units
                if (m := self.model([v for v in chosen.units if v != u])) is not None
            ]
            needless = [m for m in less if not self.missed(m, chosen)]
            if not needless:
                return chosen
            chosen = min(needless, key=lambda m: m.loss)
        return chosen

    def _short(self, best: Model) -> Model:
        """The smallest set that predicts the held-out runs as the best one does: at every joint
        within one standard error of its loss, over blocks (Breiman et al. 1984). Paired with the
        best one a gain by a hair shows; on a further run it would not.
        """
        if self.by_joint is None or len(best.units) < 2:
            return best
        losses = self.by_joint(best.solution)
        limit, chosen = losses.sum(0) + np.sqrt(len(losses)) * losses.std(0, ddof=1), best
        while len(chosen.units) > 1:
            less = [
                m
                for u in chosen.units
                if (m := self.model([v for v in chosen.units if v != u])) is not None
            ]
            within = [m for m in less if np.all(self.by_joint(m.solution).sum(0) <= limit)]
            if not within:
                break
            chosen = min(within, key=lambda m: m.loss)
        return chosen

    def _exchanged(self, chosen: Model) -> Model:
        """Every joint's laws exchanged for whatever set of up to `LAWS` of them explains more,
        joint by joint.
        """
        joints = sorted({u.joints[0] for u in self.units if len(u.joints) == 1})
        for j in joints:
            sets = self._laws_of(chosen, j)
            found = [m for s in sets if (m := self.model(s)) is not None]
            surer = [m for m in found if self.accepted(chosen, m)]
            if surer:
                chosen = min(surer, key=lambda m: m.loss)
        return chosen

    def _laws_of(self, chosen: Model, joint: int) -> list[tuple[int, ...]]:
        """The sets of laws at a joint that explain most of the fit runs for their size, beside what
        stands elsewhere.
        """

        def here(u):
            return self.units[u].joints == (joint,)

        others = tuple(u for u in chosen.units if not here(u))
        kinds, room = self._kinds(others), self.most
        best = {
            p: k
            for p, (_, k) in self._best_shapes(others).items()
            if self.units[k].joints == (joint,)
        }
        pool = sorted({*best.values(), *(u for u in chosen.units if here(u))})
        H, b, size = self.beside(others)
        out: list[tuple[float, tuple[int, ...]]] = []
        for count in range(1, LAWS + 1):
            for s in combinations(pool, count):
                effects = [self.units[u].effect for u in s]
                if len(set(effects)) < count or len(kinds | set(effects)) > room:
                    continue
                own = np.concatenate([self.columns[u] for u in s])
                gain, strength = explained(H[np.ix_(own, own)], b[own])
                if np.all(strength / size[own] >= np.concatenate([self.units[u].least for u in s])):
                    out.append((gain - self.price(s), (*others, *s)))
        return [s for _, s in sorted(out, reverse=True)[:HEARD]]
