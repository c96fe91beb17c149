"""What a verdict rests on: one value for each thing that was found, with the sentence that says it.

Gaps are multiples of the noise, shares are of the gap (1 is all of it).
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.wording import listed, percent, times


@dataclass(frozen=True)
class Reason(abc.ABC):
    """One thing that a verdict rests on."""

    @property
    @abc.abstractmethod
    def sentence(self) -> str: ...


@dataclass(frozen=True)
class Remark(Reason):
    """What another part of the diagnosis found, in its own words."""

    words: str

    @property
    def sentence(self) -> str:
        return self.words


# By fit and validation data.


@dataclass(frozen=True)
class AtTheNoise(Reason):
    @property
    def sentence(self) -> str:
        return "The model reaches the noise floor on data that were not fitted: there is no gap."


@dataclass(frozen=True)
class NothingExplains(Reason):
    gap: float

    @property
    def sentence(self) -> str:
        return f"There is a gap ({times(self.gap)} times the noise), and no effect of the library explains it."


@dataclass(frozen=True)
class Lacks(Reason):
    names: str
    left: float
    claimed: bool = True

    @property
    def sentence(self) -> str:
        lead = "The model lacks" if self.claimed else "Nearest comes"
        return f"{lead} {self.names}; with it {times(self.left)} times the noise is left on validation data."


@dataclass(frozen=True)
class LacksInPart(Reason):
    names: str
    closed: float
    left: float

    @property
    def sentence(self) -> str:
        return (
            f"The model lacks {self.names}, which explains {np.floor(100 * self.closed):.0f} % of the gap on validation data; a "
            f"clear remainder ({times(self.left)} times the noise) stays unexplained."
        )


@dataclass(frozen=True)
class FollowsFitRuns(Reason):
    names: str
    closed: float
    left: float

    @property
    def sentence(self) -> str:
        return (
            f"The model lacks {self.names}: with it the fit runs are followed down to the noise. The validation runs go where "
            f"the fit runs do not: there {percent(self.closed)} of the gap is explained and {times(self.left)} times the noise "
            "is left."
        )


@dataclass(frozen=True)
class NotMost(Reason):
    names: str
    closed: float
    left: float

    @property
    def sentence(self) -> str:
        return (
            f"No effect explains most of the gap: {self.names} explains {percent(self.closed)} of it on validation data and "
            f"leaves {times(self.left)} times the noise."
        )


@dataclass(frozen=True)
class Contributions(Reason):
    """What is left without each of several effects."""

    without: tuple[tuple[str, float], ...]

    @property
    def sentence(self) -> str:
        each = ", ".join(f"without {name} {times(gap)}" for name, gap in self.without)
        return f"What each contributes: {each} times the noise."


@dataclass(frozen=True)
class NearerOnValidation(Reason):
    """Another hypothesis, first in the ranking, that was not chosen."""

    names: str
    closed: float

    @property
    def sentence(self) -> str:
        return (
            f"On validation data alone {self.names} closes {percent(self.closed)} of it; fit and validation data together do not "
            "bear that out."
        )


@dataclass(frozen=True)
class StandsStill(Reason):
    splits: tuple[str, ...]

    @property
    def sentence(self) -> str:
        kept = "choosing and reporting stand" if "report" in self.splits else "choosing stand"
        return (
            f"The data kept for {kept} still: any model predicts them, so that nothing can be judged on them, neither whether "
            "there is a gap nor what would close it."
        )


# By the report data.


@dataclass(frozen=True)
class LittleOnReport(Reason):
    after: float
    retuned: float

    @property
    def sentence(self) -> str:
        return (
            f"On the report data {times(self.after)} times the noise is left with it, {times(self.retuned)} without: that is not "
            "most of what little there is, so it is not claimed."
        )


@dataclass(frozen=True)
class FartherOnReport(Reason):
    after: float
    retuned: float
    before: float

    @property
    def sentence(self) -> str:
        apart = self.before < np.inf and times(self.before) != times(self.retuned)
        stated = f", {times(self.before)} as it was stated" if apart else ""
        return (
            f"On the report data that model is {times(self.after)} times the noise away, {times(self.retuned)} without{stated}: "
            "it is not claimed."
        )


@dataclass(frozen=True)
class LeftOnReport(Reason):
    after: float

    @property
    def sentence(self) -> str:
        return f"On the report data {times(self.after)} times the noise is left."


@dataclass(frozen=True)
class PartOnReport(Reason):
    closed: float

    @property
    def sentence(self) -> str:
        return f"On the report data it explains {percent(self.closed)} of the gap."


@dataclass(frozen=True)
class WithinWhatIsKnown(Reason):
    after: float

    @property
    def sentence(self) -> str:
        return (
            f"The report data are {times(self.after)} times the noise away, but go where fit and validation data leave numbers "
            "of the model open; within what is known of these it holds there too."
        )


@dataclass(frozen=True)
class NextToTheNoise(Reason):
    """An effect that would follow fit and validation data more closely where there was no gap to speak of."""

    names: str
    after: float
    retuned: float

    @property
    def sentence(self) -> str:
        return (
            f"{self.names} would follow fit and validation data more closely, but leaves {times(self.after)} times the noise of "
            f"the report data, {times(self.retuned)} without: not claimed."
        )


@dataclass(frozen=True)
class ReportNotReached(Reason):
    gap: float
    places: tuple[tuple[str, float], ...]

    @property
    def sentence(self) -> str:
        where = listed(f"{times(left)} times the noise in {name}" for name, left in self.places[:3])
        worst = f": beyond that it leaves {where}" if where else ""
        return (
            "The model follows fit and validation data down to the noise, but not the report data: re-tuned it is "
            f"{times(self.gap)} times the noise away there, and what the fit leaves open of its numbers does not account for it"
            f"{worst}. What is missing does not show in the data that were fitted."
        )


# By what is named.


@dataclass(frozen=True)
class NotBelievable(Reason):
    against: tuple[str, ...]

    @property
    def sentence(self) -> str:
        return f"It is not to be believed as it stands: {'; '.join(self.against)}."


@dataclass(frozen=True)
class Stopped(Reason):
    @property
    def sentence(self) -> str:
        return "Stopped before it was known what these recordings would not show."


# By torque, on runs that were not fitted.


@dataclass(frozen=True)
class Undetermined(Reason):
    what: str

    @property
    def sentence(self) -> str:
        return f"The re-tuned model is {self.what}: these data do not determine it, and no effect is named beside it."


@dataclass(frozen=True)
class TorqueAtTheNoise(Reason):
    @property
    def sentence(self) -> str:
        return "The model reaches the noise of the torque on data that were not fitted: there is no gap."


@dataclass(frozen=True)
class NothingPredicts(Reason):
    gap: float

    @property
    def sentence(self) -> str:
        return (
            f"There is a gap ({times(self.gap)} times the noise), and no effect of the library predicts the runs that were not "
            "fitted better."
        )


@dataclass(frozen=True)
class HeldOut(Reason):
    """What is named by torque: `closed` of the gap on the runs that it was not fitted to, `left` on the worst of them; `fitted`
    on the runs that it was fitted to, where that matters."""

    names: Sequence[str]
    closed: float
    left: float
    different: bool = False
    whole: bool = True
    fitted: float = 0.0

    @property
    def sentence(self) -> str:
        what = "What is different in the runs that were not fitted is" if self.different else "The model lacks"
        left = f"{times(self.left)} times the noise is left on held-out data"
        if self.whole:
            fitted = f", {times(self.fitted)} times on the runs that were fitted" if self.fitted else ""
            return f"{what} {listed(self.names)}; with it {left}{fitted}."
        return (
            f"{what} {listed(self.names)}, which explains {percent(self.closed)} of the gap on held-out data; a clear remainder "
            f"stays unexplained: {left}."
        )


@dataclass(frozen=True)
class NotMostHeldOut(Reason):
    names: Sequence[str]
    closed: float
    left: float

    @property
    def sentence(self) -> str:
        return (
            f"No effect explains most of the gap: {listed(self.names)} explains {percent(self.closed)} of it on held-out data; "
            f"{times(self.left)} times the noise is left on held-out data, so that it is not claimed."
        )
