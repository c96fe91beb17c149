"""Goals that a joint seems to come before: they may be recorded late, or the drive follows their
rate, which is no matter of the recording.
"""

from __future__ import annotations

from dataclasses import replace

from jaxid.base.wording import times
from jaxid.conventions.finding import DataFinding
from jaxid.models.effects import VelocityFeedforward
from jaxid.problem.binding import Binding


def before_its_goal(binding: Binding, finding: DataFinding) -> bool:
    """Whether a finding says that a joint moves before the goal that leads it."""
    if finding.kind != "row_shift" or finding.value is None or finding.value <= 0:
        return False
    return finding.channel in binding.chain.offers(VelocityFeedforward)


def or_led(finding: DataFinding, before: float, after: float, led: float) -> DataFinding:
    """The finding as a question beside the effect. Gaps by simulation are multiples of the noise:
    as recorded, mended, and with the effect.
    """
    text = (
        f"{finding.text} A drive that follows the rate of its goal moves early too:"
        f" {times(led)} times the noise is left with {VelocityFeedforward.name}, {times(after)}"
        f" with {finding.channel} taken earlier, {times(before)} as recorded. Nothing is shifted."
    )
    return replace(
        finding,
        text=text,
        gap_before=before,
        gap_if_mended=after,
        decisive=False,
        same_as=(*finding.same_as, (VelocityFeedforward.name, finding.channel)),
    )
