"""On which rate the law of a recording brakes, where [controller] does not say: kd may act on the joint's own rate, as in
MuJoCo and Isaac, or on the goal's less the joint's. A law that is read the wrong way looks like a delay of kd / kp, damping and a
heavier joint, so both readings are simulated, and a delay beside the first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxid.conventions.finding import DataFinding
from jaxid.conventions.limits import ALIKE, GONE
from jaxid.data.dataset import Dataset
from jaxid.problem.binding import Binding
from jaxid.wording import times


#: Where the reading stands, and what it is where it is not stated.
KEY, DEFAULT, OTHER = "reference_velocity", "difference", "none"
DELAY = "input_delay"


def is_open(binding: Binding, data: Dataset) -> bool:
    """Whether goals drive through a law whose kd acts, and [controller] leaves open on which rate."""
    law = data.controller
    if law is None or law.kind not in ("pd", "pid") or getattr(binding.chain.mechanism, "drive_law", None) is None:
        return False
    kd = law.settings.get("kd", 0.0)
    gains = kd.values() if isinstance(kd, dict) else np.ravel(kd)  # type: ignore[arg-type]
    return KEY not in law.settings and law.settings.get("sample_time") != 0 and any(float(x) > 0 for x in gains)


def read_as(data: Dataset, reading: str) -> Dataset:
    """The dataset whose law is said to be of that reading."""
    assert data.controller is not None
    return replace(data, controller=replace(data.controller, settings={**data.controller.settings, KEY: reading}))


def law_reading(
    data: Dataset, gap: Callable[[Dataset, tuple[str, ...]], float | None], places: tuple[str, ...]
) -> DataFinding | None:
    """What the other reading of an open law explains: decisive where neither the law as it is read nor a delay of its goals (at
    `places`) beside it comes near. `gap`: what a dataset and more effects leave, times the noise."""
    before, after = gap(data, ()), gap(read_as(data, OTHER), ())
    if before is None or after is None or after > GONE * before or before <= ALIKE:
        return None
    late = gap(data, tuple(f"{DELAY}@{place}" for place in places))
    decisive = late is None or after <= GONE * late
    beside = "" if late is None else f", {times(late)} with a delay of the goals beside it"
    text = (
        f"The law's kd seems to act on the joint's own rate, not on the goal's less the joint's: {times(after)} times the noise "
        f"is left so, {times(before)} as [controller] is read{beside}."
    )
    return DataFinding(
        "law", "controller", None, text, f'{KEY} = "{OTHER}"', gap_before=before, gap_if_mended=after, decisive=decisive,
        same_as=() if decisive else tuple((DELAY, place) for place in places),
        headline="the law's kd acts on the joint's own rate; everything below takes it so",
    )  # fmt: skip
