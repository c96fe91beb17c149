"""What is claimed: by fit and validation data, and only as far as it holds on the report data too.

One principle: a verdict is a sentence about every set of data. `named` and `partly` say that with
the effects the model comes nearer to the data than without them, as stated or re-tuned; `none` says
that it is at the noise. Fit and validation data choose; the report data, which choose nothing,
withdraw what does not hold on them. A wrong name costs a user more than an honest `unknown`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.wording import listed, percent, placed
from jaxid.diagnosis.belief import Belief
from jaxid.diagnosis.breakdown import Share
from jaxid.diagnosis.budget import closed as share_closed
from jaxid.diagnosis.evidence import level
from jaxid.diagnosis.hypothesis import Hypothesis, SearchResult
from jaxid.diagnosis.probability import RULE
from jaxid.diagnosis.reasons import (
    AtTheNoise,
    Contributions,
    FartherOnReport,
    FollowsFitRuns,
    Lacks,
    LacksInPart,
    LeftOnReport,
    LittleOnReport,
    NearerOnValidation,
    NothingExplains,
    NotMost,
    PartOnReport,
    Reason,
    Remark,
    WithinAStep,
)
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.lost_runs import FOLLOWS, LOST
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.scores import free_runs, scored, scores
from jaxid.problem.binding import Binding
from jaxid.simulation.sample_buffers import columns


class Diverged(UsageError):
    """No free run of the nominal model stays finite, or near the recording; `by_torque` says
    whether it can be compared without one, and `note` why that was done.
    """

    def __init__(self, message: str, by_torque: bool, note: str):
        super().__init__(message)
        self.by_torque, self.note = by_torque, note


@dataclass(frozen=True)
class Verdict:
    """What is claimed (`named`, `partly`, `none`, `unknown`), and what it rests on, in the order in
    which it was found.
    """

    name: str
    reasons: tuple[Reason, ...] = ()

    @property
    def claims(self) -> bool:
        """Whether effects are named."""
        return self.name in ("named", "partly")

    @property
    def text(self) -> str:
        return " ".join(reason.sentence for reason in self.reasons)

    def but(self, name: str, *reasons: Reason) -> Verdict:
        """Another one, by what was found since."""
        return Verdict(name, (*self.reasons, *reasons))

    def unclaimed(self) -> Verdict:
        """The same, as what comes nearest in place of what the model lacks."""

        def plainer(r):
            return replace(r, claimed=False) if getattr(r, "claimed", False) else r

        return Verdict(self.name, tuple(map(plainer, self.reasons)))

    def because(self, *reasons: Reason) -> Verdict:
        """The same, by more."""
        return self.but(self.name, *reasons)


class Gaps(NamedTuple):
    """What the model as stated, re-tuned and with the effects leaves, in multiples of the noise."""

    before: float
    retuned: float
    after: float


#: Effects that are mentioned as possible at most.
MENTIONED = 4
#: Half a step of an encoder, in standard deviations of what rounding to its steps does.
HALF_A_STEP = np.sqrt(3.0)
#: Mean square that such zeros leave at most beside the noise.
MOST_OF_ZEROS = 1 + HALF_A_STEP**2


def judge(search: SearchResult, counted: np.ndarray | None = None) -> Verdict:
    """By fit and validation data. `counted [ny]` says which outputs are read in steps and have no
    noise beside them.
    """
    nominal, chosen = search.nominal, search.chosen
    gap = float(np.sqrt(max(nominal.validation.loss, nominal.fit_loss)))
    if counted is not None and counted.any() and _within_a_step(nominal, gap, counted):
        return Verdict("none", (WithinAStep(gap),))
    if not chosen.effects:
        return _nothing_chosen(search, gap)
    if not np.isfinite([chosen.validation.loss, chosen.fit_loss]).all():
        return Verdict("unknown", (NothingExplains(gap),))
    return _chosen(search)


def _nothing_chosen(search: SearchResult, gap: float) -> Verdict:
    nominal, hints = search.nominal, possible(search.belief)
    if nominal.at_noise:
        return Verdict("none", (AtTheNoise(), *hints))
    return Verdict("unknown", (NothingExplains(gap), *_nearer(search), *hints))


def _chosen(search: SearchResult) -> Verdict:
    """Of effects that were chosen: `named` where they reach the noise or close most of the gap."""
    nominal, chosen = search.nominal, search.chosen
    names, each = placed(map(str, chosen.effects)), _contributions(search)
    left = float(np.sqrt(max(chosen.validation.loss, 1.0)))
    closed = share_closed(nominal.validation.loss, chosen.validation.loss)
    followed = share_closed(nominal.fit_loss, chosen.fit_loss)
    fits = followed >= LIMITS.named or chosen.fit_loss <= LIMITS.left**2
    # Several that leave more than the noise may together only come close to something else.
    several_leave_much = search.several and max(left, np.sqrt(chosen.fit_loss)) > LIMITS.left
    if chosen.validation_at_noise or (closed >= LIMITS.named and fits and not several_leave_much):
        return Verdict("named", (Lacks(names, left), *each))
    # What is claimed with a probability need not account for most of a gap.
    if closed > 0:
        return Verdict("partly", (LacksInPart(names, closed, left), *each))
    if chosen.fit_loss <= level(chosen.path.count) < nominal.fit_loss:
        return Verdict("partly", (FollowsFitRuns(names, closed, left),))
    return Verdict("unknown", (NotMost(names, closed, left), *_nearer(search)))


def _contributions(search: SearchResult) -> tuple[Reason, ...]:
    if not search.without:
        return ()
    return (Contributions(tuple((str(c), gap) for c, gap in search.without)),)


def _within_a_step(model: Hypothesis, gap: float, counted: np.ndarray) -> bool:
    """Whether a model that leaves a `gap` is at the noise on fit and validation runs, where each
    counted output [ny] of a run has a zero of its own within half a step.
    """
    if not level(model.validation.count) < gap**2 <= MOST_OF_ZEROS:
        return False
    for residual in (model.residuals, model.validation.settled):
        left = []
        for r in residual:
            zero = np.clip(r.mean(0), -HALF_A_STEP, HALF_A_STEP)
            left.append(((r - np.where(counted, zero, 0.0)) ** 2).ravel())
        squares = np.concatenate(left)
        if squares.mean() > level(squares.size):
            return False
    return True


def _nearer(search: SearchResult) -> tuple[Reason, ...]:
    """What comes nearest to the validation data where it is not what was chosen, as the ranking
    shows it.
    """
    tried = []
    for h in search.tried:
        if h.effects and np.isfinite([h.validation.loss, h.fit_loss]).all():
            tried.append(h)
    top: Hypothesis | None = min(tried, key=lambda h: h.validation.loss, default=None)
    before = search.nominal.validation.loss
    if top is None or top.validation.loss >= min(search.chosen.validation.loss, before):
        return ()
    share = share_closed(before, top.validation.loss)
    return (NearerOnValidation(placed(map(str, top.effects)), share),)


def possible(belief: Belief | None) -> tuple[Reason, ...]:
    """What is not sure enough to be claimed, where nothing is."""
    likely = [] if belief is None else belief.possible(RULE.possible)
    if not likely:
        return ()
    names = [f"{effect} at {place}" for effect, place, _ in likely[:MENTIONED]]
    return (Remark(f"Possible: {listed(names)}."),)


def upheld(verdict: Verdict, gaps: Gaps, several: bool = False) -> Verdict:
    """A verdict that names effects (`several` of them) once the report data have been seen."""
    before, retuned, after = gaps
    farther = verdict.but("unknown", FartherOnReport(after, retuned, before))
    if not after < np.inf or np.isnan(retuned):  # a gap that is no number bears nothing out
        return farther
    closed = share_closed(retuned**2, after**2)
    room = retuned**2 > LIMITS.alike  # beyond what is known of the noise
    nearer = after < retuned
    as_near = not room and after**2 <= LIMITS.alike * retuned**2
    near_noise = retuned <= LIMITS.near and (nearer or as_near)
    if not near_noise and not after < np.minimum(retuned, before):
        return farther
    if verdict.name != "named":
        return verdict
    if near_noise:
        if room and closed < LIMITS.half:
            return verdict.unclaimed().but("unknown", LittleOnReport(after, retuned))
        return verdict
    if several and after > LIMITS.left:
        return verdict.but("partly", LeftOnReport(after))
    if closed < (LIMITS.named if after > LIMITS.left else LIMITS.half):
        return verdict.but("partly", PartOnReport(closed))
    return verdict


def astray(
    runs: Sequence[Share], regimes: Sequence[Share], whole: float, room: float = 0.0
) -> list[tuple[str, float]]:
    """Where the re-tuned model is not near the noise on report data, worst first: (run, or
    direction of a joint, times the noise); `whole` is what all of them leave, `room` the mean
    square over the noise that is left open.
    """
    most = math.sqrt(LIMITS.left**2 + room)
    found = [(s.part, s.retuned) for s in runs]
    for s in regimes:
        if s.part in ("forward", "backward"):
            found.append((f"{s.joint} moving {s.part}s", s.retuned))
    if not found:
        found = [("all report runs", whole)]
    far = [(place, gap) for place, gap in found if not gap <= most]
    return sorted(far, key=lambda place: -np.nan_to_num(place[1], nan=np.inf))


def check_followed(bench: ProblemBuilder, theta: np.ndarray, starts: np.ndarray) -> None:
    """Raises `Diverged` where a descent that did not end left free runs that do not follow the
    recording: no effect can be seen beside that.
    """
    runs = free_runs(bench, "fit", [theta], starts[None])[0]
    off = max(score.nrmse for score in scores(bench, "fit", runs).values())
    if not off <= FOLLOWS:
        note = LOST.format(percent(off))
        raise Diverged(f"{note}; give other start values or bounds", True, note)


def standing_still(binding: Binding) -> tuple[str, ...]:
    """Of "validation" and "report" those splits in which no run moves and no input changes: every
    model predicts them.
    """
    inputs, outputs = columns(binding.dataset, binding.chain)
    out = []
    for split in ("validation", "report"):
        runs = binding.experiments(split)
        moves = False
        for e in runs:
            keep = scored(e, split)
            scatter = np.std(e.y[keep][:, outputs], axis=0)
            moves |= bool(np.any(scatter > LIMITS.two_sigma * binding.sigma))
            moves |= _changes(e.u[keep][:, inputs])
        if runs and not moves:
            out.append(split)
    return tuple(out)


def _changes(u: np.ndarray) -> bool:
    """Whether any input [time inputs] does more than scatter from sample to sample."""
    if len(u) < 2:
        return False
    from_sample_to_sample = np.std(np.diff(u, axis=0), axis=0) / np.sqrt(2)
    rounding = 1e-12 * np.abs(u).max(0)
    changes = np.std(u, axis=0) > LIMITS.two_sigma * from_sample_to_sample + rounding
    return bool(np.any(changes))
