"""The shortest account: a robot's file as it stands, with one number or one effect changed and
nothing re-tuned.

Numbers that are free to move take up what is missing: centres of mass an encoder that is off,
dampings a late goal. Where the file's run explains a recording but for one thing, that one is named
before any number of the file is doubted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jaxid.base.wording import listed
from jaxid.diagnosis.belief import Belief
from jaxid.diagnosis.goals.changes import StatedDifference
from jaxid.diagnosis.goals.gains import held_gains
from jaxid.diagnosis.goals.own_run import FileRun
from jaxid.diagnosis.goals.propose import as_vector, candidates_of, Proposal
from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.goals.single_changes import belief_of
from jaxid.diagnosis.hypothesis import Candidate, Hypothesis, SearchResult
from jaxid.diagnosis.selection import indistinct, joint_loss
from jaxid.diagnosis.thresholds import LIMITS
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
        #: The single change of effects that leaves least; None where none was asked.
        self.nearest: StatedDifference | None = None
        self.as_likely: Hypothesis | None = (
            None  # the re-tuned model, where the data do not tell it from what was found
        )
        self.instead: Hypothesis | None = (
            None  # what was found, where that model takes no more numbers
        )

    def enough(self, found: Sequence[StatedDifference]) -> list[Hypothesis]:
        """Those that leave no more than the noise: the fewest numbers that leave next to nothing
        more than any, by the evidence for each; a number of the model stands before an effect that
        the data do not tell from it, and a law that ended as another one after all.
        """
        wide, out = self.decider.bench.binding, []
        for change in found:  # masses, which a fit holds, may be asked too
            self.own |= {wide.layout.index(self.names[i]) for i in change.index}
        self.decider.asked = self.own
        least_left = np.inf
        for change in found:
            theta = as_vector(wide, self.names, change.proposal)
            own = candidates_of(self.decider.bench, change.proposal)
            for i in change.index:
                kind, _, place = self.names[i].partition("@")
                own.append(Candidate(kind, place, (wide.layout.index(self.names[i]),)))
            if not own:
                continue
            h = self.decider.refit(own, theta, self.stands)
            out.append(h)
            if h.at_noise:
                self.decider.most = LIMITS.left**2
            if not change.index and joint_loss(h) < least_left:
                self.nearest, least_left = change, joint_loss(h)
        self.decider.most = np.inf
        out = [h for h in out if np.isfinite(joint_loss(h))]
        if out and not any(h.at_noise for h in out):
            nearest = min(out, key=joint_loss)
            out = [self.decider.polished(h) if h is nearest else h for h in out]
        self.tried = [h for h in out if not self.of_numbers(h)]
        self._asked = out
        good = [h for h in out if h.at_noise]
        least = min(map(joint_loss, good), default=0.0)
        near = [h for h in good if joint_loss(h) < LIMITS.alike * max(1.0, least)]
        fewest = min(map(self.numbers, near), default=0)
        few = [h for h in near if self.numbers(h) == fewest]
        told = min(map(self.evidence, few), default=0.0) + LIMITS.decisive  # what is as likely

        def order(h):
            return (
                self.ends_as_another(h),
                h not in few,
                h not in near,
                not (self.of_numbers(h) and not self.of_law(h) and self.evidence(h) < told),
                self.evidence(h),
            )

        return sorted(good, key=order)

    def of_numbers(self, h: Hypothesis) -> bool:
        return not self.own.isdisjoint(h.index)

    def ends_as_another(self, h: Hypothesis) -> bool:
        """Whether a number of an effect ended at its bound, where its law is another one: bristles
        that give over no distance are dry friction. At zero, and as the whole of a share, an effect
        is what it says.
        """
        p = h.path.problem
        free = len(p.free)
        z, lower, upper = h.path.z[:free], p.lower[:free], p.upper[:free]
        near = 1e-9 * np.maximum(np.abs(z), p.scale[:free])
        ended = (z - lower <= near) | (upper - z <= near)
        share = (lower == 0.0) & (upper == 1.0)
        of_effects = np.isin(p.free, list(set(h.index) - self.own))
        return bool((ended & of_effects & ~share & (h.theta[p.free] != 0.0)).any())

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
        if nominal.at_noise and more < LIMITS.decisive:
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

    def said(self, enough: Sequence[Hypothesis], verdict: str) -> str:
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
            own = h.theta[i] - self.theta[i] + stated(i)
            unit = layout.entries[i].unit
            unit = "" if unit == "1" else unit
            parts = (layout.names[i], f"{own:.3g}", unit, f"(stated {stated(i):.3g})")
            return " ".join(filter(None, parts))

        own_numbers = [h for h in self._as_few(first, enough) if self.of_numbers(h)][:1]
        if self.of_numbers(first):
            own = listed([value(i, first) for i in self._numbers_of(first)])
            others = [h for h in self._as_few(first, enough) if not self.of_numbers(h)]
            alike = [" and ".join(map(str, h.effects)) for h in others if indistinct(first, h)]
            return one_change(own, alike, verdict)
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
    """What the file explains as it is simulated: by itself, or with a single change."""

    def __init__(
        self,
        bench: ProblemBuilder,
        run: FileRun,
        proposed: Callable[[], list[StatedDifference]],
    ):
        """`bench` of the model without candidates, and what the file's run in it leaves;
        `proposed()` are the single changes that are likeliest.
        """
        self.plain = bench.binding
        #: Whether it explains the recording by itself.
        self.stands = run.accounts(self.plain)
        #: Which single changes are simulated.
        self.changes: list[StatedDifference] = []
        if not self.stands:
            self.changes = proposed()
        self.alone: Alone | None = None
        self.enough: list[Hypothesis] = []

    def ask(self, made: Callable[[], ProblemBuilder], progress: Progress | None) -> None:
        """Simulates the changes; `made()` makes a bench with their effects as candidates."""
        if not self.changes:
            return
        decider = Decider(made(), self.plain.layout.names, progress, 0, 1 + len(self.changes))
        self.alone = Alone(decider, self.plain, self.plain.theta)
        self.enough = self.alone.enough(self.changes)

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
    def nearest(self) -> Proposal | None:
        """The effects that explain most where all else stands as stated, as a set to be asked
        beside numbers that are re-tuned.
        """
        if self.alone is None or self.alone.nearest is None:
            return None
        return self.alone.nearest.proposal

    @property
    def gains(self) -> list[str]:
        """Names of the law's gains whose other value is what explains the recording."""
        if self.alone is None or not self.enough:
            return []
        held = {self.alone.decider.bench.binding.layout.names[i] for i in self.alone.gains}
        return [name for name in self.moved if name in held]

    @property
    def moved(self) -> list[str]:
        """Names of the numbers of the model whose other values explain the recording."""
        if self.alone is None or not self.enough or self.lacks:
            return []
        layout = self.alone.decider.bench.binding.layout
        return [layout.names[i] for i in self.enough[0].index]

    @property
    def begin(self) -> np.ndarray | None:
        """Numbers of the model with those changed that explain the recording; None where none do.
        The re-tuned model holds this one, and a descent from afar may not find it.
        """
        if self.alone is None or not self.enough or self.lacks:
            return None
        wide = self.alone.decider.bench.binding.layout
        return np.array([self.enough[0].theta[wide.index(n)] for n in self.plain.layout.names])

    def decided(self, decider: Decider, nominal: Hypothesis) -> SearchResult:
        """From the re-tuned model: the effect that alone is lacking, or none where numbers account
        for it.
        """
        if self.alone is not None and self.lacks:
            return self.alone.searched(nominal, self.enough)
        plain = SearchResult(nominal, nominal, belief=Belief({}, none=1.0))
        found = decider.with_what_the_file_lacks(plain)
        return found if self.alone is None else replace(found, stands=self.alone.stands)

    def said(self, verdict: str) -> str:
        """What the text of a verdict leaves out."""
        if self.alone is None or not self.enough:
            return ""
        return self.alone.said(self.enough, verdict)


def one_change(own: str, alike: Sequence[str], verdict: str) -> str:
    """That numbers of the file with their values (`own`) are what it lacks, as would be what is
    `alike`; with `unknown`, once they were re-tuned, they are only what comes nearest.
    """
    if verdict == "unknown":
        return f"One change of the file comes nearest: {own}."
    text = f"One change of the file accounts for the gap: {own}."
    return f"{text} So would {' or '.join(alike)}." if alike else text
