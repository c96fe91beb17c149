"""What a robot under goals may lack, proposed along its measured motion: numbers of the model, sets
of effects with theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxid.data.dataset import Dataset
from jaxid.diagnosis.goals.bodies import shifts_body
from jaxid.diagnosis.goals.limits import limits_shown
from jaxid.diagnosis.goals.study import LedStudy
from jaxid.diagnosis.hypothesis import Candidate, candidates
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque.algebra import better, BLOCKS, gram, Weights
from jaxid.diagnosis.torque.answer import of_model
from jaxid.diagnosis.torque.choose import Chooser, Model
from jaxid.diagnosis.torque.library import MOMENT, Unit
from jaxid.dynamics.effect import BodyEffect, Effect, InputEffect, JointEffect, OutputEffect
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.binding import Binding


#: This many sets are simulated: where dry friction turns about at other instants, first order ranks
#: and does not decide.
FIRST = 3
#: So often a search that finds nothing is begun anew, by the noise that its best set leaves.
ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Proposal:
    """A set of units with the numbers of each, and the model's own (of the whole layout of the
    nominal model).
    """

    units: tuple[Unit, ...]
    numbers: tuple[np.ndarray, ...]
    theta: np.ndarray


def shown(kind: type[Effect]) -> bool:
    """Whether an effect is a column along a measured motion under goals: it acts on the way from
    the goal to the joint, at the joint or in the mechanism, and has no motion of its own.
    """
    if issubclass(kind, BodyEffect):
        return shifts_body(kind)
    if issubclass(kind, InputEffect):
        return not kind.stated_as  # what the dataset states is settled before
    if issubclass(kind, OutputEffect):
        return kind.is_offset()
    return issubclass(kind, JointEffect)


def proposals(study: LedStudy, most: int) -> tuple[Proposal, list[Proposal]]:
    """The nominal model, and sets of effects, the chosen one first; none where nothing predicts the
    held-out runs better.
    """
    asked = LinearisedSearch(study, study.theta, most)
    bare = _proposal(study, asked.chooser, asked.chooser.nominal)
    if asked.at_noise(asked.chooser.nominal):
        return bare, []
    chooser, chosen = asked.searched()
    if not chosen.units:
        # Re-tuning for an effect that is missing can lead the numbers far away: now along the free
        # run of what was stated.
        chooser, chosen = LinearisedSearch(study, study.binding.theta, most).searched()
    first = [chosen] if chosen.units else []
    limits = [
        Proposal((u,), (np.ones(1),), study.binding.theta.copy()) for u in limits_shown(study)[:1]
    ]
    return (
        bare,
        [
            *limits,
            *(_proposal(study, chooser, m) for m in [*first, *_next(chooser, chosen)]),
        ][:FIRST],
    )


class LinearisedSearch:
    """Every effect as columns along the free run of numbers theta, and the search among them."""

    def __init__(self, study: LedStudy, theta: np.ndarray, most: int):
        self.study, self.most = study, most
        self.fit, self.held = study.of("fit"), study.of("validation") or study.of("fit")
        self.rows, white = study.rows_with_effects(theta)
        self.chooser = self._by(white)

    def _by(self, white: Weights) -> Chooser:
        return self.study.chooser(self.rows, white, self.fit, self.held, self.most, self.at_noise)

    def at_noise(self, m: Model) -> bool:
        answer = of_model(self.study, self.rows, m)
        joints = range(len(self.study.noise))
        return all(
            not answer.gap(which, j) > LIMITS.seen
            for which in (self.fit, self.held)
            for j in joints
        )

    def searched(self) -> tuple[Chooser, Model]:
        """What is chosen, by the noise that the best set leaves where nothing is by that of the
        re-tuned model: a large effect that is missing makes the noise by which it is judged.
        """
        chooser = self.chooser
        chosen = chooser.run()
        for _ in range(ROUNDS):
            best = min(chooser.tried, key=lambda m: m.loss)
            if chosen.units or not best.units:
                break
            chooser = self._by(self.study.weights_of(self.rows, best.solution))
            chosen = chooser.run()
        return chooser, chosen


def _next(chooser: Chooser, chosen: Model) -> list[Model]:
    """Of each effect alone the set that is worth most on the fit runs and no worse on the held-out
    ones, best first.
    """

    def worth(m):
        return chooser.nominal.cost - m.cost - chooser.price(m.units)

    found: dict[str, Model] = {}
    for m in sorted(chooser.tried, key=worth, reverse=True):
        kinds = {chooser.units[u].effect for u in m.units}
        if len(kinds) == 1 and m is not chosen and worth(m) > 0 and m.loss <= chooser.nominal.loss:
            found.setdefault(kinds.pop(), m)
    return list(found.values())


def _proposal(study: LedStudy, chooser: Chooser, m: Model) -> Proposal:
    theta, p = study.theta.copy(), study.plant.size
    theta[study.plant.free] = np.clip(m.solution.theta[:p], study.lower, study.upper)
    own = tuple(chooser.units[u] for u in m.units)
    ends = np.cumsum([len(u.fields) for u in own])[:-1]
    return Proposal(
        own, tuple(np.split(m.solution.theta[chooser.size :], ends)) if own else (), theta
    )


def with_other_hold(dataset: Dataset) -> Dataset:
    """The dataset with goals that go the other way from sample to sample: held, or along a line."""
    other = {"zero": "linear", "linear": "zero"}
    return replace(
        dataset,
        channels=tuple(
            replace(c, hold=other.get(c.hold, c.hold)) if c.role == "input" else c
            for c in dataset.channels
        ),
    )


def goes_the_other_way(stated: LedStudy, other: LedStudy) -> bool:
    """Whether the re-tuned model follows goals better, in the fit and in the held-out runs, that go
    from sample to sample in the other way than is stated: a log of a goal says when it was asked,
    not what the drive made of it in between.
    """
    if not stated.of("validation"):
        return False
    held: list[np.ndarray] = []
    white, g = None, None
    for study in (stated, other):
        rows = study.made(study.theta, [])
        white = white or study.weights(rows)
        both = [
            gram(*study.some(rows, which), white, BLOCKS)
            for which in (study.of("fit"), study.of("validation"))
        ]
        at, numbers = study.solved(
            rows, white
        )  # without clocks, which would stand in for half of a sample
        held += [part.losses(at, numbers) for part in both]
        g = both[1]
    fitted, kept = (held[0], held[2]), (held[1], held[3])
    assert g is not None
    total, worst = better(*kept, g)
    return bool(total > LIMITS.sure and worst > 0 and fitted[1].sum() < fitted[0].sum())


def candidates_of(bench: ProblemBuilder, s: Proposal) -> list[Candidate]:
    """The candidates of a bench that a set asks for, each with the numbers that its unit shows."""
    kinds = {e.name: e for e in bench.binding.chain.effects}
    pool = {(c.effect, c.location): c for c in candidates(bench, [u.effect for u in s.units])}
    out = []
    for u in s.units:
        c = pool.get((u.effect, u.location.partition(" and ")[0]))
        if c is not None:
            hidden = [
                f for f in getattr(kinds[u.effect], "moments", ()) if f"{MOMENT}{f}" not in u.fields
            ]
            fields = {i: bench.binding.layout.entries[i].field for i in c.index}
            out.append(replace(c, index=tuple(i for i in c.index if fields[i] not in hidden)))
    return out


def kinds_of(sets: Sequence[Proposal]) -> list[str]:
    return list(dict.fromkeys(u.effect for s in sets for u in s.units))


def as_vector(binding: Binding, nominal: Sequence[str], s: Proposal) -> np.ndarray:
    """The numbers of a proposal in the layout of a binding; `nominal`: the names of the numbers
    that `s.theta` has.
    """
    theta, layout = binding.theta.copy(), binding.layout
    for name, value in zip(nominal, s.theta, strict=True):
        theta[layout.index(name)] = value
    for u, numbers in zip(s.units, s.numbers, strict=True):
        place = u.location.partition(" and ")[0]
        own = dict(u.shape) | dict(zip(u.fields, map(float, numbers), strict=True))
        own |= {
            f.removeprefix(MOMENT): v / own["mass"]
            for f, v in own.items()
            if f.startswith(MOMENT) and own["mass"]
        }
        for i in layout.of_effect(u.effect, place):
            if (field := layout.entries[i].field) in own:
                theta[i] = np.clip(own[field], binding.lower[i], binding.upper[i])
    return theta
