"""What drives a robot in a recording: goals, torques, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from jaxid.base.errors import UsageError
from jaxid.base.wording import as_unit, listed


if TYPE_CHECKING:
    from jaxid.data.dataset import Dataset


def without_drive(joint: str, dataset: Dataset) -> str:
    """What is said where no input drives a robot: the names that inputs have to have, and what to
    write for one that is there.
    """
    said = f"nothing drives the robot: add goals ({joint}_cmd) or torques ({joint}_tau) as inputs"
    if not dataset.inputs:
        return f"{said}, or say free = true"
    first = dataset.inputs[0]
    goal = first.unit in ("rad", "m")
    name, unit = (f"{joint}_cmd", first.unit) if goal else (f"{joint}_tau", "N m")
    form = f'role = "input", column = "{first.name}", {as_unit(first.unit, unit)}'
    here = listed(dataset.input_names)
    return f"{said}. Of the inputs here ({here}), if this is one: [channels.{name}] with {form}"


def driven_by(joints: Sequence[str], dataset: Dataset) -> str:
    """What drives the joints: "goal", "torque", or "" for nothing."""
    inputs = set(dataset.input_names)
    driven = {}
    for what, end in (("goal", "_cmd"), ("torque", "_tau")):
        own = [j for j in joints if f"{j}{end}" in inputs]
        if own:
            driven[what] = [j for j in joints if j not in own]
    if len(driven) > 1:
        raise UsageError(
            "both goals (NAME_cmd) and torques (NAME_tau) are inputs: the goal is an input where it"
            " drives the model, and auxiliary where a torque does; give one of them role ="
            ' "auxiliary"'
        )
    for what, lacking in driven.items():
        if lacking:
            end = "_cmd" if what == "goal" else "_tau"
            raise UsageError(
                f"no {what} is recorded of {', '.join(lacking)}: add {lacking[0]}{end}, or take the"
                " joint's output out"
            )
        return what
    return ""
