"""A number of the model that changes during the recording."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.effect import NumberEffect
from jaxid.dynamics.parameter import DURATION, Moment, NUMBER, param, Quantity


class StepChange(NumberEffect):
    """A number that jumps at one moment of every run: a target that is captured, a load that is
    dropped, a part that breaks.

    Position and speed of the joints go on without a jump: what is picked up moves as the joint
    does. By the momentum of a robot on a free base speeds may jump, for each side of the moment is
    taken by itself. It is asked last by a diagnosis, for its moment has to be searched.
    """

    name: ClassVar[str] = "step_change"
    equation: ClassVar[str] = (
        "p -> p + size for t >= time; in the step that holds `time`, by the share of it that is left"
    )
    signature: ClassVar[str] = (
        "a residual that is noise before one moment and none of it after, in every regime of the"
        " motion"
    )
    source: ClassVar[str] = (
        "textbook: change point; paper 000, section 1 (a target that is captured)"
    )
    excitation: ClassVar[str] = (
        "the same motion before and after the event, twice as long as what determines the number"
        " once"
    )
    axis: ClassVar[str] = "time"
    seen: ClassVar[str] = "from {time} on"
    plain: ClassVar[str] = "At {time} something changed for good: the number named gains {size}."
    check: ClassVar[str] = (
        "Look in the log or the video for what happened then: a load picked up or lost, a part that"
        " broke."
    )
    last_resort: ClassVar[bool] = True
    export_law: ClassVar = (
        "a file has one value for all of a run, and holds that of before: for the robot as it is"
        " since then add size"
    )
    size: Array = param(
        0.0,
        -10 * NUMBER,
        10 * NUMBER,
        scale=0.1 * NUMBER,
        unit="{p}",
        meaning="what the number gains",
    )
    time: Array = param(
        1.0,
        Moment(0.0),
        Moment(1.0),
        scale=0.02 * DURATION,
        unit="s",
        meaning="when, on the recording's own clock and within it",
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = tuple(
        {"size": 0.3 * NUMBER, "time": Moment(share)}
        for share in (0.1, 0.2, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.8, 0.9)
    )

    def __call__(self, values, t, h):
        return values + self.size * jnp.clip((t + h - self.time) / h, 0.0, 1.0)
