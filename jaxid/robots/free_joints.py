"""Joints that nothing drives: a leg's guide, a boom, a pole on a cart.

The file has actuators, and none for such a joint; the recording has no goal for it. It moves freely
under a law of zeros, along a goal that does nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TYPE_CHECKING

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.wording import listed
from jaxid.robots.channels import goal
from jaxid.robots.tree import Tree


if TYPE_CHECKING:
    from jaxid.data.dataset import Dataset, Experiment
    from jaxid.robots.drives import DriveLaw


#: What a law of a joint that nothing drives has in place of numbers.
NONE = {
    "kp": 0.0,
    "kd": 0.0,
    "ki": 0.0,
    "gain": 1.0,
    "lowest": -np.inf,
    "highest": np.inf,
    "offset": 0.0,
    "delay": 0.0,
    "lag": 0.0,
    "control": (-np.inf, np.inf),
}


def free_joints(tree: Tree, dataset: Dataset) -> list[str]:
    """Joints of a tree that are recorded, and that neither the file nor goals drive where goals
    drive others.
    """
    inputs, outputs = dataset.input_names, set(dataset.output_names)
    if not tree.actuators or not any(goal(j) in inputs for j in tree.actuators):
        return []
    still = [j for j in tree.driven if j not in tree.actuators and j in outputs]
    return [j for j in still if goal(j) not in inputs or not _commanded(dataset, inputs, goal(j))]


def _commanded(dataset: Dataset, inputs: Sequence[str], channel: str) -> bool:
    """Whether an input is ever other than zero."""
    at = inputs.index(channel)
    return any(np.any(run.u[:, at]) for run in dataset.experiments)


def with_free_joints(dataset: Dataset, tree: Tree) -> Dataset:
    """The dataset with a goal of zeros for each joint that moves freely, and a note."""
    lacking = [j for j in free_joints(tree, dataset) if goal(j) not in dataset.input_names]
    if not lacking:
        return dataset
    units = {c.name: c.unit for c in dataset.outputs}
    like = next(c for c in dataset.inputs if c.name.removesuffix("_cmd") in tree.actuators)
    added = [replace(like, name=goal(j), unit=units[j]) for j in lacking]

    def one(e: Experiment) -> Experiment:
        zeros = np.zeros((len(e.u), len(lacking)))
        return replace(e, u=np.concatenate([e.u, zeros], 1), past=e.past_by(one))

    note = f"{listed(lacking)}: {tree.file} has no actuator there, so it moves freely"
    return replace(
        dataset,
        channels=(*dataset.channels, *added),
        experiments=tuple(map(one, dataset.experiments)),
        notes=(*dataset.notes, note),
    )


def beside_free_joints(
    tree: Tree, dataset: Dataset, law_of: Callable[[list[str]], DriveLaw]
) -> DriveLaw:
    """The law of all joints that lead; `law_of` makes that of those which are driven.

    Raises `UsageError` where goals come with rates and a joint moves freely.
    """
    free = free_joints(tree, dataset)
    joints = tree.driven
    driven = [j for j in joints if j not in free]
    law = law_of(driven)
    if not free:
        return law
    if law.rates:
        raise UsageError(
            f"[controller] reference_velocity: {free[0]} moves freely, and goals that come with"
            ' rates need one for each joint: write reference_velocity = "none"'
        )
    own = {joint: k for k, joint in enumerate(driven)}
    numbers: dict[str, Any] = {}
    for name, none in NONE.items():
        stated = getattr(law, name)
        if stated:
            numbers[name] = tuple([_of(stated, own, j, none) for j in joints])
    return replace(law, **numbers)


def _of(stated: Sequence[Any], own: Mapping[str, int], joint: str, none: Any) -> Any:
    """A number of a joint's law, `none` where it has no law."""
    return stated[own[joint]] if joint in own else none
