"""The shortest account: a robot's file as it stands, with one number or one effect changed and
nothing re-tuned.

Numbers that are free to move take up what is missing: centres of mass an encoder that is off,
dampings a late goal. Where MuJoCo's run of the file explains a recording but for one thing, that
one is named before any number of the file is doubted. What MuJoCo makes of the file and jaxid does
not is taken off the readings: the file is judged as its owner runs it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jaxid.base.wording import listed
from jaxid.diagnosis.belief import Belief
from jaxid.diagnosis.goals.changes import changes, StatedDifference
from jaxid.diagnosis.goals.difference import by_its_steps, Difference, difference
from jaxid.diagnosis.goals.floor import (
    Between,
    joint_numbers,
    made_by_steps,
)
from jaxid.diagnosis.goals.gains import held_gains
from jaxid.diagnosis.goals.own_run import stepped_changes, steps_as_its_file
from jaxid.diagnosis.goals.propose import as_vector, candidates_of, Proposal
from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.goals.single_changes import belief_of
from jaxid.diagnosis.goals.study import LedStudy
from jaxid.diagnosis.hypothesis import Candidate, Hypothesis, SearchResult
from jaxid.diagnosis.selection import indistinct, joint_loss
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.dynamics.effect import Effect
from jaxid.fitting.fitter import Progress
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.binding import Binding


class Alone:
    """Single changes by simulation: each fitted by itself, with all else as it stands."""

    def __init__(self, decider: Decider, plain: Binding, theta: np.ndarray):
        """`plain`: the binding without candidates, whose free numbers stand as they are in
        theta.
        """
        wide = decider.bench.binding
        self.decider, self.names, self.theta = decider, plain.layout.names, wide.theta.copy()
        self.stated = dict(zip(plain.layout.names, plain.theta, strict=True))
        for name, value in zip(plain.layout.names, theta, strict=True):
            self.theta[wide.layout.index(name)] = value

        def in_wide(index):
            return frozenset(wide.layout.index(self.names[i]) for i in index)

        self.gains = in_wide(held_gains(plain))
        self.own = in_wide(plain.free) | self.gains
        decider.asked = self.own
        self.stands = decider.refit((), self.theta)
        self.tried: list[Hypothesis] = []
        self._asked: list[Hypothesis] = []
        self.as_likely: Hypothesis | None = (
            None  # the re-tuned model, where the data do not tell it from what was found
        )
        self.instead: Hypothesis | None = (
            None  # what was found, where that model takes no more numbers
        )

    def enough(self, found: Sequence[StatedDifference]) -> list[Hypothesis]:
        """Those that leave no more than the noise: the fewest numbers that leave next to nothing
        more than any, by the evidence for each; a number of the model stands before an effect that
        the data do not tell from it.
        """
        wide, out = self.decider.bench.binding, []
        for change in found:
            theta = as_vector(wide, self.names, change.proposal)
            own = candidates_of(self.decider.bench, change.proposal)
            for i in change.index:
                kind, _, place = self.names[i].partition("@")
                own.append(Candidate(kind, place, (wide.layout.index(self.names[i]),)))
            if own:
                out.append(self.decider.refit(own, theta, self.stands.path))
        out = [h for h in out if np.isfinite(joint_loss(h))]
        if out and not any(map(self.decider.at_noise, out)):
            nearest = min(out, key=joint_loss)
            out = [self.decider.polished(h) if h is nearest else h for h in out]
        self.tried = [h for h in out if not self.of_numbers(h)]
        self._asked = out
        good = [h for h in out if self.decider.at_noise(h)]
        least = min(map(joint_loss, good), default=0.0)
        near = [h for h in good if joint_loss(h) < LIMITS.alike * max(1.0, least)]
        fewest = min(map(self.numbers, near), default=0)
        few = [h for h in near if self.numbers(h) == fewest]
        told = min(map(self.evidence, few), default=0.0) + LIMITS.decisive  # what is as likely

        def order(h):
            return (
                h not in few,
                h not in near,
                not (self.of_numbers(h) and not self.of_law(h) and self.evidence(h) < told),
                self.evidence(h),
            )

        return sorted(good, key=order)

    def nearest_numbers(self) -> Hypothesis | None:
        """The change of the file's numbers that leaves least."""
        of_file = [h for h in self._asked if self.of_numbers(h) and not self.of_law(h)]
        return min(of_file, key=joint_loss, default=None)

    def of_numbers(self, h: Hypothesis) -> bool:
        return not self.own.isdisjoint(h.index)

    def of_law(self, h: Hypothesis) -> bool:
        """Whether gains are changed, which whoever wrote the law knows best."""
        return not self.gains.isdisjoint(h.index)

    def searched(self, nominal: Hypothesis, enough: Sequence[Hypothesis]) -> SearchResult:
        """The first of those that are enough, with what passes for it; `nominal` is re-tuned
        without it, and is enough where it is as likely by no more numbers, or likelier for all that
        these cost.
        """
        tried = list(self.tried)
        chosen = self.decider.thinned(self.stands, enough[0], tried)
        more = self.evidence(nominal) - self.evidence(chosen)
        if self.decider.at_noise(nominal) and more < LIMITS.decisive:
            self.as_likely = nominal
            as_few = self.numbers(nominal) <= self.numbers(chosen)
            if as_few or more < -LIMITS.decisive:
                self.instead = chosen
                return SearchResult(nominal, nominal, tried, stands=self.stands)
        others = [
            h
            for h in self._as_few(chosen, enough[1:])
            if not self.of_numbers(h) and indistinct(chosen, h)
        ]
        mates = [c for h in others for c in h.effects if c not in chosen.effects]
        return SearchResult(
            nominal,
            chosen,
            tried,
            mates,
            None,
            len({c.effect for c in chosen.effects}) > 1,
            stands=self.stands,
            belief=belief_of(self, [self.stands, *self._asked], [chosen, nominal]),
        )

    def told(self, h: Hypothesis) -> list[int]:
        """Which numbers of what is changed (all of the file's where no effect is) the fit runs tell
        from what they were, by what each costs (Schwarz 1978).
        """
        p, H = h.path.problem, h.path.hessian
        changed = set(h.index) or self.own
        at = [k for k, i in enumerate(p.free) if i in changed]
        if H is None or not at:
            return [int(p.free[k]) for k in at]
        if not np.isfinite(H).all():
            return []
        size = np.sqrt(np.maximum(np.diag(H), 1e-300))
        variance = np.diag(np.linalg.pinv(H / size / size[:, None], hermitian=True)) / size**2
        d = h.path.z[at] - p.z(self.theta)[at]
        surely = d**2 > np.log(h.path.count) * h.fit_inflation * variance[at]
        return [int(p.free[k]) for k, sure in zip(at, surely, strict=True) if sure]

    def numbers(self, h: Hypothesis) -> int:
        """How many of them a change takes: a load on the axis of a joint is as well one of the link
        before it, whatever further numbers describe either.
        """
        return max(len(h.effects), len(self.told(h)))

    def evidence(self, h: Hypothesis) -> float:
        """Sum of squares of fit and validation runs over the noise, and what its numbers cost."""
        count = h.path.count + h.validation.count
        return joint_loss(h) * count + self.numbers(h) * float(np.log(count))

    def _as_few(self, h: Hypothesis, others: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Those that take no more numbers than `h`."""
        return [x for x in others if self.numbers(x) <= self.numbers(h)]

    def _numbers_of(self, h: Hypothesis) -> list[int]:
        """Those that a change moves: what the fit runs tell from what they were, else all."""
        return self.told(h) or [i for c in h.effects for i in c.index]

    def said(self, enough: Sequence[Hypothesis]) -> str:
        """What other single changes do as much as the first: those that a verdict does not name by
        itself.
        """
        if self.instead is not None:
            either = " and ".join(map(str, self.instead.effects))
            return (
                f"With all numbers as they stand {either} would account for the gap as well, by no"
                " fewer changes."
            )
        layout, first = self.decider.bench.binding.layout, enough[0]

        def stated(i):
            return self.stated[layout.names[i]]

        def value(i, h):
            return (
                f"{layout.names[i]} {h.theta[i] - self.theta[i] + stated(i):.3g}"
                f" {layout.entries[i].unit} (stated {stated(i):.3g})"
            )

        own_numbers = [h for h in self._as_few(first, enough) if self.of_numbers(h)][:1]
        if self.of_numbers(first):
            own = listed([value(i, first) for i in self._numbers_of(first)])
            alike = [
                h
                for h in self._as_few(first, enough)
                if not self.of_numbers(h) and indistinct(first, h)
            ]
            more = (
                f" So would {' or '.join(' and '.join(map(str, h.effects)) for h in alike)}."
                if alike
                else ""
            )
            return f"One change of the file accounts for the gap: {own}.{more}"
        text = "All numbers of the file stand as they are."
        if self.as_likely is not None:
            own = listed([value(i, self.as_likely) for i in self.told(self.as_likely)])
            return f"{text} Re-tuned numbers would account for the gap as well: {own}."
        told = [listed([value(i, h) for c in h.effects for i in c.index]) for h in own_numbers]
        return (
            f"{text} Without it {' or '.join(told)} would come to the noise too, but not as near."
            if told
            else text
        )


class AsStated:
    """What the file explains as MuJoCo runs it: by itself, or with a single change."""

    def __init__(
        self,
        bench: ProblemBuilder,
        study: LedStudy,
        kinds: Sequence[type[Effect]],
        between: Between,
    ):
        """`bench` of the model without candidates, `between` of its fit runs."""
        self.plain, self.bench, self.study = bench.binding, bench, study
        self.taken = difference(bench, {"fit": between})
        if self.taken is not None and not np.all(
            self.taken.floor <= np.maximum(between.left, self.plain.sigma)
        ):
            # The difference is known less well than what the file leaves: nothing shows beside it.
            self.taken = None
        #: Whether it explains the recording by itself.
        self.stands = self.taken is not None and self.taken.accounts(self.plain)
        self.exact = steps_as_its_file(self.plain)
        self.stepped: Difference | None = None
        self.made_by_steps: list[np.ndarray] | None = None
        self.changes: list[StatedDifference] = []
        if self.taken is not None and not self.stands:
            self._ask_columns(self.taken, kinds)
        self.alone: Alone | None = None
        self.enough: list[Hypothesis] = []

    def _ask_columns(self, taken: Difference, kinds: Sequence[type[Effect]]) -> None:
        """Which single changes columns of first order hold likeliest."""
        if self.exact:
            self.stepped, self.changes = taken, stepped_changes(self.plain, kinds)
            return
        self.stepped = by_its_steps(self.bench, self.study, taken)
        if self.stepped is None:
            return
        apart = self.stepped.by_split["fit"].apart
        self.changes = changes(self.plain, kinds, apart, self.stepped.theta)
        self.made_by_steps = made_by_steps(self.bench)

    def ask(self, made: Callable[[np.ndarray], ProblemBuilder], progress: Progress | None) -> None:
        """Simulates the changes; `made(floor)` makes a bench with their effects as candidates."""
        if self.stepped is None or not self.changes:
            return
        self._compare(self.stepped, self.changes, made, progress)
        nearest = self.alone.nearest_numbers() if self.alone is not None else None
        if nearest is not None and not self.exact:
            self._with_their_run(nearest, made, progress)

    def _compare(
        self,
        taken: Difference,
        asked: Sequence[StatedDifference],
        made: Callable[[np.ndarray], ProblemBuilder],
        progress: Progress | None,
    ) -> None:
        """Simulates changes with this difference taken off the readings."""
        bench = taken.off(made(taken.floor))
        decider = Decider(bench, self.plain.layout.names, None, progress, 0, 1 + len(asked))
        self.alone = Alone(decider, self.plain, taken.theta)
        self.enough = self.alone.enough(asked)

    def _with_their_run(
        self,
        found: Hypothesis,
        made: Callable[[np.ndarray], ProblemBuilder],
        progress: Progress | None,
    ) -> None:
        """Changed numbers of joints once more, with MuJoCo's run of the file that has them: its dry
        friction creeps by what the friction is, and its steps by the damping. They are the answer
        where they come to the noise so, and nothing explains the recording surely better.
        """
        assert self.alone is not None and self.stepped is not None
        wide, names = self.alone.decider.bench.binding.layout, self.plain.layout.names
        index = [names.index(wide.names[i]) for i in found.index]
        theta = self.plain.theta.copy()
        theta[index] = found.theta[list(found.index)] - self.alone.theta[list(found.index)]
        theta[index] += self.plain.theta[index]
        numbers = joint_numbers(self.plain, theta, index)
        if sum(map(len, numbers.values())) < len(index):
            return
        plain = difference(self.bench, {}, theta, numbers)
        taken = plain and by_its_steps(self.bench, self.study, plain, numbers)
        if taken is None:
            return
        begin = taken.theta.copy()
        stands = begin.copy()
        stands[index] += self.plain.theta[index] - theta[index]
        before = self.stepped, self.alone, self.enough
        told = min(map(self.alone.evidence, self.enough), default=np.inf) + LIMITS.decisive
        self.stepped = replace(taken, theta=stands)
        change = StatedDifference(Proposal((), (), begin), tuple(index))
        self._compare(self.stepped, [change], made, progress)
        if not any(self.alone.evidence(h) < told for h in self.enough):
            self.stepped, self.alone, self.enough = before

    @property
    def explains(self) -> bool:
        return self.stands or bool(self.enough)

    @property
    def lacks(self) -> bool:
        """Whether an effect is what it lacks, and not another value of a number."""
        return (
            self.alone is not None
            and bool(self.enough)
            and not self.alone.of_numbers(self.enough[0])
        )

    @property
    def gains(self) -> list[str]:
        """Names of the law's gains whose other value is what explains the recording."""
        if self.alone is None or not self.enough:
            return []
        layout = self.alone.decider.bench.binding.layout
        return [layout.names[i] for i in self.enough[0].index if i in self.alone.gains]

    @property
    def begin(self) -> np.ndarray:
        """Numbers of the model as they stand, but for those that explain the recording: gains, and
        where simulations take the file's own steps any.
        """
        theta = self.plain.theta.copy()
        if self.exact and self.alone is not None and self.enough and not self.lacks:
            names, found = self.alone.decider.bench.binding.layout.names, self.enough[0]
            for i in found.index:
                theta[self.plain.layout.index(names[i])] = found.theta[i]
        for name in self.gains:
            wide = self.alone.decider.bench.binding.layout.index(name)  # type: ignore[union-attr]
            theta[self.plain.layout.index(name)] = self.enough[0].theta[wide]
        return theta

    @property
    def difference(self) -> Difference:
        """What is taken off the readings."""
        found = self.stepped if self.enough else self.taken
        assert found is not None
        return found

    @property
    def doubts(self) -> dict[str, float]:
        """What steps of the simulation make of numbers that are re-tuned. With which steps a
        recording was made is not known, and a robot has none.
        """
        pairs = zip(self.plain.layout.names, self.difference.theta, self.plain.theta, strict=True)
        moved = {name: float(there - here) for name, there, here in pairs if there != here}
        if self.made_by_steps is None:
            return moved
        by_steps = self.study.taken_up(self.made_by_steps, self.plain.free, clocks=False)[0]
        names = dict.fromkeys([*moved, *by_steps])
        return {
            name: float(np.hypot(moved.get(name, 0.0), by_steps.get(name, 0.0))) for name in names
        }

    def decided(self, decider: Decider, nominal: Hypothesis) -> SearchResult:
        """From the re-tuned model: the effect that alone is lacking, or none where numbers account
        for it.
        """
        if self.alone is not None and self.lacks:
            return self.alone.searched(nominal, self.enough)
        plain = SearchResult(nominal, nominal, belief=Belief({}, none=1.0))
        found = decider.with_what_the_file_lacks(plain)
        return found if self.alone is None else replace(found, stands=self.alone.stands)

    def said(self) -> str:
        return self.alone.said(self.enough) if self.alone is not None and self.enough else ""
