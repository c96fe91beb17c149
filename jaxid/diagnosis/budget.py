"""A budget of the gap: as stated, numbers re-tuned, effects added, what is left, and what any free
law at the joints could still close.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TYPE_CHECKING

import numpy as np


if TYPE_CHECKING:
    from jaxid.diagnosis.result import HowFar
    from jaxid.fitting.stated import StatedNumber


#: Verdicts that add effects to the model.
WITH_EFFECTS = ("named", "partly")
#: Share of the gap that re-tuned numbers close, beyond which that is the first thing to say.
MOST = 0.9


@dataclass(frozen=True)
class Step:
    """A model, and the gap that it leaves on held-out runs, in multiples of the noise.

    `closes` is the share of the mean square above the noise that it takes from the step before,
    None where that has no size. `of` are the stated numbers that re-tuning moves, `rms` what is
    left of each output, (value, unit), `law` what a free law at a joint is a law of ("" where no
    one variable stands out).
    """

    step: str  # stated, numbers, effects, left, any_free_law
    gap: float
    closes: float | None = None
    of: tuple[str, ...] = ()
    rms: dict[str, tuple[float, str]] = field(default_factory=dict)
    law: str = ""

    def to_dict(self) -> dict[str, Any]:
        content: dict[str, Any] = {"step": self.step, "gap": self.gap}
        if self.step in ("numbers", "effects"):
            content["closes"] = self.closes
        if self.step == "numbers":
            content["of"] = list(self.of)
        if self.step == "left":
            content["rms"] = {name: list(value) for name, value in self.rms.items()}
        if self.step == "any_free_law":
            content["law"] = self.law
        return content


def budget(
    how_far: HowFar, stated: Sequence[StatedNumber], verdict: str, law: str = ""
) -> tuple[Step, ...]:
    """The steps from the model as stated to what no free law at the joints could close; `stated`
    are the numbers with which it began, `law` what a law of no name depends on.
    """
    before, retuned = how_far.gap_before, how_far.gap_retuned
    robot = bool(how_far.per_joint)
    moved = tuple(_name(number, robot) for number in stated if number.refuted)
    steps = [
        Step("stated", before),
        Step("numbers", retuned, closes=_share_closed(before, retuned), of=moved),
    ]
    left = retuned
    if verdict in WITH_EFFECTS:
        left = how_far.gap_after
        steps.append(Step("effects", left, closes=_share_closed(retuned, left)))
    steps.append(Step("left", left, rms=_rms(how_far, verdict)))
    if how_far.ceiling is not None:
        share = min(max(how_far.ceiling, 0.0), 1.0)
        reached = math.hypot(math.sqrt(share), math.sqrt(1 - share) * retuned)
        steps.append(Step("any_free_law", min(reached, max(left, 1.0)), law=law))
    return tuple(steps)


def closed_by_numbers(steps: Sequence[Step]) -> float:
    """Share of the gap as stated that re-tuned numbers close; 0 where that has no size."""
    return next(step.closes or 0.0 for step in steps if step.step == "numbers")


def _name(number: StatedNumber, robot: bool) -> str:
    """Its id: `viscous1`, on a robot `damping@elbow`; of what two numbers come to, their words."""
    if not robot or "@" in number.parameter or " " in number.parameter:
        return number.parameter
    return f"{number.parameter}@{number.place}" if number.place else number.parameter


def _share_closed(before: float, after: float) -> float | None:
    """Of the mean square above the noise; negative where the gap grows."""
    with np.errstate(over="ignore"):
        squares = np.square([before, max(after, 1.0)])
    if before <= 1 or not np.isfinite(squares).all():
        return None
    return float(shrink(*squares))


def shrink(before: float, after: float) -> float:
    """Share of the gap that is closed; arguments are mean squares in units of the noise."""
    return 1 - (after - 1) / (before - 1)


def closed(before: float, after: float) -> float:
    """The same as a part of the whole, 0 to 1: 0 where nothing is closed, or where there is no
    gap.
    """
    share = shrink(before, after) if before > 1 else 0.0
    return float(np.clip(np.nan_to_num(share, nan=0.0), 0.0, 1.0))


def _rms(how_far: HowFar, verdict: str) -> dict[str, tuple[float, str]]:
    found = {}
    for name, gap in how_far.per_channel.items():
        value = gap.rmse_after if verdict in WITH_EFFECTS else gap.rmse_retuned
        found[name] = (value, gap.unit)
    return found
