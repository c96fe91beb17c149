"""The model that a dataset states: its links from the text of a file, or a robot."""

from __future__ import annotations

import re
from typing import Any

from jaxid.base.errors import DatasetError, DatasetProblem, UsageError
from jaxid.data.dataset import Dataset, Geometry, ModelSpec, ParameterPrior
from jaxid.data.schema import Document, Places
from jaxid.data.schema_model import ModelEntry, PriorEntry
from jaxid.robots.arm_table import arm_table


def model_spec(entry: ModelEntry) -> ModelSpec:
    return ModelSpec(
        name="robot" if entry.robot is not None else entry.name,
        without=tuple(entry.without),
        free=entry.free,
        constants={k: float(v) for k, v in entry.constants.items()},
        parameters={k: prior_of(p) for k, p in entry.parameters.items()},
        joints=dict(entry.joints),
        base={} if entry.base is None else entry.base.model_dump(exclude_unset=True),
        trust=entry.trust,
        simulator=entry.simulator,
        contacts=entry.contacts,
    )


def prior_of(entry: PriorEntry) -> ParameterPrior:
    return ParameterPrior(**entry.model_dump())


def geometry_of(
    document: Document, places: Places, open_text: Any, problems: list[DatasetProblem]
) -> Geometry | None:
    """The links that `[model]` states; a URDF is read from the folder and kept as text."""
    entry = document.model
    if entry is None or (entry.urdf is None and entry.dh is None and entry.robot is None):
        return None
    if entry.robot is not None:
        return robot_geometry(entry, places, open_text, problems)
    if entry.dh is not None:
        columns = entry.dh.model_dump(exclude={"convention"}, exclude_none=True)
        return Geometry(convention=entry.dh.convention, columns=columns)
    assert entry.urdf is not None
    key = ("model", "urdf")
    needs = places.problem(
        key, "a URDF needs a folder", "Give the model as SerialArm.from_urdf(...)"
    )
    if (text := _text(entry.urdf, key, open_text, needs, problems)) is None:
        return None
    geometry = Geometry(urdf=text, file=entry.urdf, tip=entry.tip, root=entry.root)
    try:
        arm_table(geometry)
    except UsageError as error:
        said = str(error)
        wrong = next((name for name in ("tip", "root") if name in said), "urdf")
        problems.append(places.problem(("model", wrong), said, "Correct it"))
        return None
    return geometry


def _text(
    name: str,
    key: tuple[str, str],
    open_text: Any,
    needs: DatasetProblem,
    problems: list[DatasetProblem],
) -> str | None:
    """The text of a file that `[model]` names; where there is none, `needs` or what is wrong with
    it joins the problems.
    """
    text = needs if open_text is None else open_text(name, key)
    if isinstance(text, DatasetProblem):
        problems.append(text)
        return None
    return text


def as_robot_entry(document: Document, open_text: Any) -> ModelEntry | None:
    """The model; a `serial_arm` whose `urdf` is an MJCF, or whose goals are recorded under a stated
    law and no input is, is read as a robot.
    """
    entry = document.model
    if entry is None or entry.urdf is None:
        return entry
    robot = entry.model_copy(update={"name": None, "urdf": None, "robot": entry.urdf})
    if open_text is not None and entry.urdf.endswith((".xml", ".mjcf")):
        text = open_text(entry.urdf, ("model", "urdf"))
        if isinstance(text, str) and re.search(r"<\s*mujoco\b", text):
            return robot
    inputs = any(channel.role == "input" for channel in document.channels.values())
    goals = any(name.endswith("_cmd") for name in document.channels)
    driven = document.controller is not None and goals and not inputs and not entry.free
    return robot if driven else entry


def robot_geometry(
    entry: ModelEntry, places: Places, open_text: Any, problems: list[DatasetProblem]
) -> Geometry | None:
    """The robot's file as text, if it can be read as a robot."""
    from jaxid.robots.match import robot_of
    from jaxid.robots.mjcf_text import expanded

    assert entry.robot is not None
    key = ("model", "robot")
    needs = places.problem(
        key, "a robot's file needs a folder", "Give the model as Robot.from_mjcf(...)"
    )
    if (text := _text(entry.robot, key, open_text, needs, problems)) is None:
        return None
    try:
        if not str(entry.robot).lower().endswith(".urdf"):
            text = expanded(open_text.path(entry.robot), text)
        robot_of(text, str(entry.robot), entry.tip)
    except UsageError as error:
        problems.append(places.problem(key, str(error), "Correct the file, or name another"))
        return None
    return Geometry(
        robot=text, file=str(entry.robot), tip=entry.tip, path=str(open_text.path(entry.robot))
    )


def as_robot(dataset: Dataset, places: Places) -> Dataset:
    """The dataset under the names of its robot's joints. Raises `DatasetError` where they do not go
    together.
    """
    from jaxid.robots.match import prepared

    try:
        robot: Any
        robot, dataset = prepared(None, dataset)
        robot.matched(dataset)
    except UsageError as error:
        raise DatasetError(
            [
                places.problem(
                    ("model",), str(error), "Correct [model], [controller] or the channels"
                )
            ]
        ) from None
    return dataset


def joints_of(geometry: Geometry | None) -> tuple[str, ...]:
    """The joints of an arm that a URDF states, in the order of its chain; none where it has no
    names.
    """
    return arm_table(geometry).joints if geometry is not None and geometry.urdf else ()
