"""Single changes of a robot's file, along its free run: which alone would explain a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxid.diagnosis.goals.gains import freed, held_gains
from jaxid.diagnosis.goals.propose import Proposal
from jaxid.diagnosis.goals.study import LedStudy
from jaxid.diagnosis.torque.algebra import ColumnPrior, gram, solve, Weights
from jaxid.diagnosis.torque.library import Unit
from jaxid.dynamics.effect import Effect
from jaxid.problem.binding import Binding


#: This many effects at one place, half as many at all of their places, half as many numbers, and as
#: many by other weights, are simulated: where dry friction turns about, first order is rough.
FIRST = 4


@dataclass(frozen=True, eq=False)
class StatedDifference:
    """What alone is different from the model as it stands: effects of one kind, or numbers of the
    model (`index`, in its layout); with the values of both.
    """

    proposal: Proposal
    index: tuple[int, ...] = ()

    @property
    def place(self) -> tuple[object, ...]:
        return self.index or tuple(u.place for u in self.proposal.units)


def changes(
    binding: Binding, kinds: Sequence[type[Effect]], theta: np.ndarray
) -> list[StatedDifference]:
    """Single changes of a model whose other numbers stand as they are in `theta`, likeliest first:
    an effect at one of its places or at all of them, a number of the model or of its law, one of
    all its joints, or the centre of mass of a link.
    """
    runs, theta = binding.experiments("fit"), theta.copy()
    b = replace(binding, dataset=replace(binding.dataset, experiments=tuple(runs)), theta=theta)
    gains = set(held_gains(b))
    b = freed(b, [b.layout.names[i] for i in gains])
    study = LedStudy(b, kinds, begin=theta.copy())  # not re-tuned
    rows, by_left = study.rows_with_effects(theta)
    p = study.plant.size
    stands = np.arange(p), theta[study.plant.free]
    every = [
        np.concatenate(
            [x[:, :, :p], x[:, :, rows.size : -1], rows.residual(k, *stands)[:, :, None]], 2
        )
        for k, x in enumerate(rows.rows)
    ]
    out: dict[tuple[object, ...], StatedDifference] = {}
    for white in (Weights(study.noise, np.ones(len(study.noise))), by_left):
        g = gram(study.runs, every, study.unsure, white, 1).total
        effects = _of_effects(g, study, rows.units, p)
        single, several = (
            [pair for pair in effects if (len(pair[1].proposal.units) > 1) == many]
            for many in (False, True)
        )
        numbers = _of_numbers(g, study)
        of_law = [pair for pair in numbers if gains.issuperset(pair[1].index)]
        own = [pair for pair in numbers if gains.isdisjoint(pair[1].index)]
        for found, most in (
            (own, FIRST // 2),
            (of_law, FIRST // 2),
            (single, FIRST),
            (several, FIRST // 2),
        ):
            likeliest = sorted(found, key=lambda pair: pair[0])[:most]
            out |= {c.place: c for _, c in likeliest if c.place not in out}
    return list(out.values())


def _of_numbers(g: np.ndarray, study: LedStudy) -> list[tuple[float, StatedDifference]]:
    """What is left by the best value of each number or group of numbers, and that."""
    b, free = study.binding, study.plant.free
    groups: dict[tuple[str, str], list[int]] = {}
    for k, i in enumerate(free):
        kind, _, place = b.layout.names[i].partition("@")
        groups.setdefault((kind, place), []).append(k)
        groups.setdefault(("com", place) if kind.startswith("com_") else (kind, ""), []).append(k)
    out = []
    for at in dict.fromkeys(map(tuple, groups.values())):
        index = [free[k] for k in at]
        cost, moved = _alone(
            g, at, b.lower[index] - b.theta[index], b.upper[index] - b.theta[index]
        )
        theta = b.theta.copy()
        theta[index] += moved
        out.append((cost, StatedDifference(Proposal((), (), theta), tuple(index))))
    return out


def _of_effects(
    g: np.ndarray, study: LedStudy, every: Sequence[Unit], first: int
) -> list[tuple[float, StatedDifference]]:
    """The same of effects, each with the best of its shapes."""
    ends = first + np.cumsum([0, *(len(u.fields) for u in every)])
    best: dict[tuple[str, str], tuple[float, int, np.ndarray]] = {}
    for k, u in enumerate(every):
        cost, numbers = _alone(g, range(ends[k], ends[k + 1]), u.least, u.most)
        if np.any(numbers != 0) and not cost >= best.get(u.place, (np.inf,))[0]:
            best[u.place] = cost, k, numbers
    theta = study.binding.theta
    out = [
        (cost, StatedDifference(Proposal((every[k],), (numbers,), theta)))
        for cost, k, numbers in best.values()
    ]
    for effect in dict.fromkeys(e for e, _ in best):
        own = [k for (e, _), (_, k, _) in best.items() if e == effect]
        if len(own) > 1:
            at = [range(ends[k], ends[k + 1]) for k in own]
            low, high = (
                np.concatenate([getattr(every[k], side) for k in own]) for side in ("least", "most")
            )
            cost, numbers = _alone(g, np.concatenate(at), low, high)
            parts = np.split(numbers, np.cumsum([len(x) for x in at])[:-1])
            out.append(
                (
                    cost,
                    StatedDifference(Proposal(tuple(every[k] for k in own), tuple(parts), theta)),
                )
            )
    return out


def _alone(
    g: np.ndarray, at: Sequence[int] | np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[float, np.ndarray]:
    """What the columns `at` alone leave, and their numbers."""
    size = len(g) - 1
    low_, high_ = np.full(size, -np.inf), np.full(size, np.inf)
    low_[list(at)], high_[list(at)] = low, high
    s = solve(
        g,
        np.asarray(at, int),
        ColumnPrior(np.zeros((size, size)), np.zeros(size)),
        np.zeros(size),
        low_,
        high_,
    )
    return s.cost, s.theta
