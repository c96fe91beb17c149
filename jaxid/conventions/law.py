"""On which rate the law of a recording brakes, where [controller] does not say: kd may act on the
joint's own rate, as in MuJoCo and Isaac, or on the goal's less the joint's. A law that is read the
wrong way looks like a delay of kd / kp, damping and a heavier joint, so both readings are
simulated, and a delay beside the first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from jaxid.base.wording import times
from jaxid.conventions.finding import DataFinding
from jaxid.conventions.limits import ALIKE, GONE
from jaxid.data.dataset import Dataset
from jaxid.models.effects import InputDelay
from jaxid.problem.binding import Binding


#: Where the reading stands, and what it is besides the one that is taken where it is not stated.
KEY, OTHER = "reference_velocity", "none"
DELAY = InputDelay.name


def is_open(binding: Binding, data: Dataset) -> bool:
    """Whether goals drive through a law that takes the goal's rate off the joint's, and
    [controller] does not say so.
    """
    law, stated = getattr(binding.chain.mechanism, "drive_law", None), data.controller
    return (
        law is not None
        and stated is not None
        and KEY not in stated.settings
        and law.rate
        and any(law.kd)
    )


def read_as(data: Dataset, reading: str) -> Dataset:
    """The dataset whose law is said to be of that reading."""
    assert data.controller is not None
    return replace(
        data,
        controller=replace(data.controller, settings={**data.controller.settings, KEY: reading}),
    )


def law_reading(
    data: Dataset, gap: Callable[[Dataset, tuple[str, ...]], float | None], places: tuple[str, ...]
) -> DataFinding | None:
    """What the other reading of an open law explains: decisive where neither the law as it is read
    nor a delay of its goals (at `places`) beside it comes near. `gap`: what a dataset and more
    effects leave, times the noise.
    """
    before = gap(data, ())
    if before is None or before <= ALIKE:
        return None
    after = gap(read_as(data, OTHER), ())
    if after is None or after > GONE * before:
        return None
    late = gap(data, tuple(f"{DELAY}@{place}" for place in places))
    decisive = late is None or after <= GONE * late
    beside = "" if late is None else f", {times(late)} with a delay of the goals beside it"
    text = (
        "The law's kd seems to act on the joint's own rate, not on the goal's less the joint's:"
        f" {times(after)} times the noise is left so, {times(before)} as [controller] is"
        f" read{beside}."
    )
    return DataFinding(
        "law",
        "controller",
        None,
        text,
        f'{KEY} = "{OTHER}"',
        gap_before=before,
        gap_if_mended=after,
        decisive=decisive,
        same_as=() if decisive else tuple((DELAY, place) for place in places),
        headline="the law's kd acts on the joint's own rate; everything below takes it so",
    )
