"""What a verdict rests on: one value for each thing that was found, with the sentence that says it.

Gaps are multiples of the noise, shares are of the gap (1 is all of it).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from string import Formatter
from typing import ClassVar

import numpy as np

from jaxid.base.wording import listed, percent, times


class _Words(Formatter):
    """Says values as a form asks: `{gap:times}`, `{closed:percent}`, `{names:listed}`,
    `{closed:floor}` (whole percents).
    """

    SAY: ClassVar = {
        "times": times,
        "percent": percent,
        "listed": listed,
        "floor": lambda x: f"{np.floor(100 * x):.0f} %",
    }

    def format_field(self, value, format_spec):
        return (
            self.SAY[format_spec](value)
            if format_spec in self.SAY
            else super().format_field(value, format_spec)
        )


@dataclass(frozen=True)
class Reason:
    """One thing that a verdict rests on; `form` is its sentence with its fields in brackets."""

    form: ClassVar[str] = ""

    @property
    def sentence(self) -> str:
        return self.said()

    def said(self, form: str | None = None, **more: object) -> str:
        """A form (default: the reason's own) with the fields and `more` in it."""
        return _Words().vformat(self.form if form is None else form, (), {**vars(self), **more})


@dataclass(frozen=True)
class Remark(Reason):
    """What another part of the diagnosis found, in its own words."""

    words: str
    form = "{words}"


# By fit and validation data.


@dataclass(frozen=True)
class AtTheNoise(Reason):
    form = "The model reaches the noise floor on data that were not fitted: there is no gap."


@dataclass(frozen=True)
class WithinAStep(Reason):
    gap: float
    where: ClassVar[str] = "where its counts begin within a step"
    form = (
        "What is left ({gap:times} times the noise) is one offset of an encoder for each run, of at"
        " most half a step: {where}. Less that, the model is at the noise: there is no gap."
    )

    @property
    def sentence(self) -> str:
        return self.said(where=self.where)


@dataclass(frozen=True)
class NothingExplains(Reason):
    gap: float
    form = (
        "There is a gap ({gap:times} times the noise on validation data), and no effect of the"
        " library explains it."
    )


@dataclass(frozen=True)
class CutShort(Reason):
    named: bool
    form = (
        "The search ended early, at what it may simulate or at --seconds: {what}. Leave out effects"
        " that cannot be missing (--effect names the others), and it gets further."
    )

    @property
    def sentence(self) -> str:
        beside = "not all effects were tried beside those that come nearest, or in their place"
        return self.said(what=beside if self.named else "not all pairs of effects were tried")


def _lead(claimed: bool) -> str:
    return "The model lacks" if claimed else "Nearest comes"


@dataclass(frozen=True)
class Lacks(Reason):
    names: str
    left: float
    claimed: bool = True
    form = "{lead} {names}; with it {left:times} times the noise is left on validation data."

    @property
    def sentence(self) -> str:
        return self.said(lead=_lead(self.claimed))


@dataclass(frozen=True)
class LacksInPart(Reason):
    names: str
    closed: float
    left: float
    claimed: bool = True
    form = (
        "{lead} {names}, which explains {closed:floor} of the gap on validation data; a clear"
        " remainder ({left:times} times the noise) stays unexplained."
    )

    @property
    def sentence(self) -> str:
        return self.said(lead=_lead(self.claimed))


@dataclass(frozen=True)
class FollowsFitRuns(Reason):
    names: str
    closed: float
    left: float
    claimed: bool = True
    form = (
        "{lead} {names}: with it the fit runs are followed down to the noise. The validation runs"
        " go where the fit runs do not: there {closed:percent} of the gap is explained and"
        " {left:times} times the noise is left."
    )

    @property
    def sentence(self) -> str:
        return self.said(lead=_lead(self.claimed))


@dataclass(frozen=True)
class NotMost(Reason):
    names: str
    closed: float
    left: float
    form = (
        "No effect explains most of the gap: {names} explains {closed:percent} of it on validation"
        " data and leaves {left:times} times the noise."
    )


@dataclass(frozen=True)
class Contributions(Reason):
    """What is left without each of several effects."""

    without: tuple[tuple[str, float], ...]
    form = "What each contributes: {each} times the noise."

    @property
    def sentence(self) -> str:
        return self.said(
            each=", ".join(f"without {name} {times(gap)}" for name, gap in self.without)
        )


@dataclass(frozen=True)
class NearerOnValidation(Reason):
    """Another hypothesis, first in the ranking, that was not chosen."""

    names: str
    closed: float
    form = (
        "On validation data alone {names} closes {closed:percent} of it; fit and validation data"
        " together do not bear that out."
    )


@dataclass(frozen=True)
class StandsStill(Reason):
    splits: tuple[str, ...]
    form = (
        "The data kept for {kept} still: any model predicts them, so that nothing can be judged on"
        " them, neither whether there is a gap nor what would close it."
    )

    @property
    def sentence(self) -> str:
        return self.said(
            kept="choosing and reporting stand" if "report" in self.splits else "choosing stand"
        )


# By the report data.


@dataclass(frozen=True)
class LittleOnReport(Reason):
    after: float
    retuned: float
    form = (
        "On the report data {after:times} times the noise is left with it, {retuned:times} without:"
        " that is not most of what little there is, so it is not claimed."
    )


@dataclass(frozen=True)
class FartherOnReport(Reason):
    after: float
    retuned: float
    before: float
    form = (
        "On the report data that model is {after:times} times the noise away, {retuned:times}"
        " without{stated}: it is not claimed."
    )

    @property
    def sentence(self) -> str:
        apart = self.before < np.inf and times(self.before) != times(self.retuned)
        return self.said(stated=f", {times(self.before)} as it was stated" if apart else "")


@dataclass(frozen=True)
class LeftOnReport(Reason):
    after: float
    form = "On the report data {after:times} times the noise is left."


@dataclass(frozen=True)
class PartOnReport(Reason):
    closed: float
    form = "On the report data it explains {closed:percent} of the gap."


@dataclass(frozen=True)
class WithinWhatIsKnown(Reason):
    after: float
    form = (
        "The report data are {after:times} times the noise away, but go where fit and validation"
        " data leave numbers of the model open; within what is known of these it holds there too."
    )


@dataclass(frozen=True)
class NextToTheNoise(Reason):
    """An effect that would follow fit and validation data more closely where there was no gap to
    speak of.
    """

    names: str
    after: float
    retuned: float
    form = (
        "{names} would follow fit and validation data more closely, but leaves {after:times} times"
        " the noise of the report data, {retuned:times} without: not claimed."
    )


@dataclass(frozen=True)
class ReportNotReached(Reason):
    gap: float
    places: tuple[tuple[str, float], ...]
    form = (
        "The model follows fit and validation data down to the noise, but not the report data:"
        " re-tuned it is {gap:times} times the noise away there. What the fit leaves open of its"
        " numbers does not account for it{worst}. What is missing does not show in the data that"
        " were fitted."
    )

    @property
    def sentence(self) -> str:
        where = listed(f"{times(left)} times the noise in {name}" for name, left in self.places[:3])
        return self.said(worst=f": beyond that it leaves {where}" if where else "")


# By what is named.


@dataclass(frozen=True)
class NotBelievable(Reason):
    against: tuple[str, ...]
    form = "It is not to be believed as it stands: {what}."

    @property
    def sentence(self) -> str:
        return self.said(what="; ".join(self.against))


@dataclass(frozen=True)
class Stopped(Reason):
    form = "Stopped before it was known what these recordings would not show."


# By torque, on runs that were not fitted.


@dataclass(frozen=True)
class Undetermined(Reason):
    what: str
    form = (
        "The re-tuned model is {what}: these data do not determine it, and no effect is named"
        " beside it."
    )


@dataclass(frozen=True)
class TorqueAtTheNoise(Reason):
    form = (
        "The model reaches the noise of the torque on data that were not fitted: there is no gap."
    )


@dataclass(frozen=True)
class NothingSure(Reason):
    """`data` is what the gap is of."""

    gap: float
    data: str
    form = (
        "There is a gap ({gap:times} times the noise on {data} data), and no effect of the library"
        " is probable enough to be claimed."
    )


@dataclass(frozen=True)
class TorqueHeldOut(Reason):
    """What is named by torque: `closed` at least of the gap on the runs that it was not fitted to,
    `left` at most; `fitted` on the runs that it was fitted to, where that matters. It is what
    is `different` in the runs that were not fitted, or from a `reference`.
    """

    names: Sequence[str]
    closed: float
    left: float
    different: bool = False
    whole: bool = True
    fitted: float = 0.0
    reference: bool = False
    form = (
        "{what} {names:listed}; with it at most {left:times} times the noise is left on held-out"
        " data{more}."
    )
    in_part: ClassVar[str] = (
        "{what} {names:listed}, which explains at least {closed:percent} of the gap on held-out"
        " data; a clear remainder stays unexplained: up to {left:times} times the noise is left."
    )

    @property
    def sentence(self) -> str:
        what = "The model lacks"
        if self.different:
            what = "What is different in the runs that were not fitted is"
        if self.reference:
            what = "What is different from the reference is"
        more = f", {times(self.fitted)} times on the runs that were fitted" if self.fitted else ""
        return self.said(self.form if self.whole else self.in_part, what=what, more=more)


@dataclass(frozen=True)
class NotMostHeldOut(Reason):
    names: Sequence[str]
    closed: float
    left: float
    form = (
        "No effect explains most of the gap on all held-out data: {names:listed} explains"
        " {closed:percent} of it where it explains least, and up to {left:times} times the noise is"
        " left, so that it is not claimed."
    )
