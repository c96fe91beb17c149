"""A limb of a robot as the serial arm that `jaxid identify` works on, with its law's torque where
none was recorded.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.robots.chain_table import table_of
from jaxid.robots.channels import goal, torque
from jaxid.robots.match import matched, notes_of, prepared
from jaxid.robots.tree import Tree


def as_arm(model: object, dataset: Dataset) -> tuple[Any, Dataset]:
    """(serial arm, dataset with q1 … and tau1 …) of a robot's recording; other models and their
    datasets as they are.

    Raises `UsageError` where the recorded joints are no chain, naming what to choose.
    """
    from jaxid.models import SerialArm
    from jaxid.robots.match import is_robot

    robot: Any
    robot, dataset = prepared(model, dataset)
    if not is_robot(robot):
        return model, dataset
    chain = matched(robot, dataset)
    mechanism: Any = chain.mechanism
    tree: Tree = mechanism.tree.tree
    if tree.lifted is not None:
        raise UsageError(
            f"{tree.file}: identify takes no robot whose weight the file cancels: take gravcomp "
            "out, or use jaxid fit --residual inverse_dynamics"
        )
    arm = SerialArm(table_of(tree))
    gravity = np.array(tree.gravity)
    if np.any(np.abs(gravity[:2]) > 1e-9):
        raise UsageError(
            f"{tree.file}: gravity is not along z; identify needs an upright world (tilt the base"
            " by [model.base])"
        )
    named = {
        "gravity": float(-gravity[2]),
        **{f"base_{k}": float(getattr(mechanism, f"base_{k}")) for k in ("roll", "pitch")},
    }
    joints = ", ".join(f"{k + 1} {j}" for k, j in enumerate(tree.joints))
    note = f"numbers of parameters are joints: {joints}"
    law = mechanism.drive_law
    said = (note,) if law is None else (note, "torque is what the law asked for")
    order = {f"q{k + 1}": j for k, j in enumerate(tree.joints)}
    spec = replace(
        dataset.stated,
        name="serial_arm",
        geometry=None,
        constants=named,
        parameters={},
        joints=order,
        base={},
    )
    data = replace(_numbered(dataset, tree, law), model=spec)
    return arm, replace(data, notes=(*data.notes, *notes_of(robot, dataset), *said))


def _numbered(dataset: Dataset, tree: Tree, law: Any) -> Dataset:
    """The recorded joints as q1 … with their torques as tau1 …, goals as auxiliary q1_cmd …"""
    channels, torques = [], []
    for k, slides in enumerate(tree.slides, 1):
        channels.append(Channel(f"q{k}", "output", "m" if slides else "rad"))
        torques.append(Channel(f"tau{k}", "input", "N" if slides else "N m"))
    channels += torques
    outputs, inputs = dataset.output_names, dataset.input_names
    iy = [outputs.index(j) for j in tree.joints]

    held = all(c.hold == "zero" for c in dataset.inputs if c.name.endswith("_cmd"))

    def columns(e: Experiment, names: Iterable[str]) -> np.ndarray:
        return e.u[:, [inputs.index(name) for name in names]]

    def one(e: Experiment) -> Experiment:
        y = e.y[:, iy]
        if law is None:
            tau = columns(e, map(torque, tree.joints))
            goals = _recorded_goals(e, tree.joints)
        else:
            wanted = columns(e, map(goal, tree.joints))
            rate = columns(e, law.rates) if law.rates else None
            tau = law.torque(e.t, wanted, y, rate, held)
            goals = {f"q{k}_cmd": column for k, column in enumerate(wanted.T, 1)}
        unread = None if e.left_out is None else e.left_out[:, iy]
        return replace(
            e,
            u=tau,
            y=y,
            left_out=unread,
            auxiliary=goals,
            past=None,
            initial=None,
            scatter=None,
            constants={},
        )

    experiments = tuple(map(one, dataset.experiments))
    goals = []
    for first in experiments[:1]:
        goals += [Channel(name, "auxiliary", "rad") for name in first.auxiliary]
    return replace(dataset, channels=(*channels, *goals), experiments=experiments, controller=None)


def _recorded_goals(e: Experiment, joints: Sequence[str]) -> dict[str, np.ndarray]:
    """The goals that stand beside the torques, as q1_cmd …"""
    recorded = {f"q{k}_cmd": e.auxiliary.get(goal(joint)) for k, joint in enumerate(joints, 1)}
    return {name: values for name, values in recorded.items() if values is not None}
