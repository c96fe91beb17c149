"""What is recorded beside the goals and torques of joints: the goals' own rates, and how the base
moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.data.signals import content_cutoff, differentiate
from jaxid.robots.tree import Tree


ANGLES = ("roll", "pitch", "yaw")
#: Share of a base's sway that no reading of it is better than.
FINE = 1e-4


def as_inputs(dataset: Dataset, names: Sequence[str]) -> Dataset:
    """The dataset with these auxiliary channels as inputs."""
    before = dataset.input_names
    chosen = set(names) - set(before)
    if not chosen:
        return dataset
    moved, order = [], []
    for c in dataset.channels:
        channel = replace(c, role="input") if c.name in chosen else c
        moved.append(channel)
        if channel.role == "input":
            order.append(c.name)

    def one(e: Experiment) -> Experiment:
        columns = dict(zip(before, e.u.T, strict=True)) | e.auxiliary
        rest = {k: v for k, v in e.auxiliary.items() if k not in chosen}
        u = np.stack([columns[name] for name in order], 1)
        return replace(e, u=u, auxiliary=rest, past=e.past_by(one))

    experiments = tuple(map(one, dataset.experiments))
    return replace(dataset, channels=tuple(moved), experiments=experiments)


def left_out(dataset: Dataset, names: Sequence[str]) -> Dataset:
    """The dataset without these channels."""
    gone = set(names)
    iu = [i for i, c in enumerate(dataset.inputs) if c.name not in gone]
    iy = [i for i, c in enumerate(dataset.outputs) if c.name not in gone]

    def cut(a):
        return None if a is None else a[:, iy]

    def one(e: Experiment) -> Experiment:
        return replace(
            e,
            u=e.u[:, iu],
            y=e.y[:, iy],
            scatter=cut(e.scatter),
            left_out=cut(e.left_out),
            auxiliary={k: v for k, v in e.auxiliary.items() if k not in gone},
            initial=(
                None if e.initial is None else {k: v for k, v in e.initial.items() if k not in gone}
            ),
            past=e.past_by(one),
        )

    kept = tuple(c for c in dataset.channels if c.name not in gone)
    return replace(dataset, channels=kept, experiments=tuple(map(one, dataset.experiments)))


def with_rates(dataset: Dataset, tree: Tree) -> Dataset:
    """The dataset with the channels that [controller] reference_velocity names as inputs, where
    goals drive.

    Raises `UsageError` for one that is not recorded.
    """
    if dataset.controller is None:
        return dataset
    stated = dataset.controller.settings.get("reference_velocity")
    inputs = set(dataset.input_names)
    goals = {f"{joint}_cmd" for joint in tree.joints}
    if stated in (None, "none", "difference") or goals.isdisjoint(inputs):
        return dataset
    joints = [j for j in tree.leading if f"{j}_cmd" in inputs]
    have = [c.name for c in dataset.channels if c.role != "output"]
    for name in (names := rates_of(stated, joints)):
        if name not in have:
            raise UsageError(
                "[controller] reference_velocity: the recording has no channel"
                f' {name!r}{nearest(name, have)}; give it role = "auxiliary", or write'
                ' reference_velocity = "none"'
            )
    return as_inputs(dataset, names)


def rates_of(stated: object, joints: Sequence[str]) -> tuple[str, ...]:
    """Channels of the goals' rates: a name with `*` for the joint's, a list in the order of the
    joints, or a table by joint.
    """
    if isinstance(stated, Mapping) and set(joints) <= set(stated):
        return tuple(str(stated[j]) for j in joints)
    if isinstance(stated, Sequence) and not isinstance(stated, str) and len(stated) == len(joints):
        return tuple(map(str, stated))
    if isinstance(stated, str) and ("*" in stated or len(joints) == 1):
        return tuple(stated.replace("*", j) for j in joints)
    raise UsageError(
        f'[controller]: reference_velocity is {stated!r}; it is "none", "difference", or channels:'
        " a name with * for that of the "
        f"joint, a list of {len(joints)} (in the order {', '.join(joints)}), or a table by joint"
    )


def base_channels(dataset: Dataset, tree: Tree) -> list[str]:
    """The recorded angles of the base; a joint of the file that has such a name is that joint."""
    angles = {f"base_{k}" for k in ANGLES} - set(tree.joints) - set(tree.held)
    return [c.name for c in dataset.channels if c.name in angles]


def rides(dataset: Dataset) -> bool:
    """Whether the base moves as it was measured: the dataset has gone through `with_base`."""
    return any(c.name == "base_yaw_qdd" and c.role == "input" for c in dataset.channels)


def with_base(dataset: Dataset, tree: Tree) -> Dataset:
    """The dataset with the motion of a prescribed base as inputs: its angles as recorded, 0 where
    they are not, and their rates and accelerations through a low-pass without phase. Raises
    `UsageError` for a channel that is no angle, and where the file has a joint of the name that
    such an input gets.
    """
    kind = dataset.stated.base.get("kind", "fixed")
    recorded = base_channels(dataset, tree)
    if not recorded or rides(dataset) or kind == "free":
        return dataset
    if kind != "prescribed":
        note = (
            f'{", ".join(recorded)} recorded and not used: [model.base] kind = "prescribed" lets'
            " the base move so"
        )
        return dataset if note in dataset.notes else replace(dataset, notes=(*dataset.notes, note))
    _refuse_base(dataset, tree, recorded)
    own = set(dataset.input_names) & set(recorded)
    kept = [i for i, c in enumerate(dataset.inputs) if c.name not in own]
    read = _reader(dataset, own)

    def one(e: Experiment) -> Experiment:
        motion = np.zeros((len(ANGLES), 3, len(e.t)))  # [angle, order of derivative, time]
        for k, angle in enumerate(ANGLES):
            if f"base_{angle}" in recorded:
                motion[k] = _motion(e.t, read(e, f"base_{angle}"))
        columns = motion.transpose(2, 1, 0).reshape(len(e.t), -1)
        rest = {k: v for k, v in e.auxiliary.items() if k not in recorded}
        u = np.concatenate([e.u[:, kept], columns], 1)
        return replace(e, u=u, auxiliary=rest, past=e.past_by(one))

    ride: list[Channel] = []
    for end, unit in {"": "rad", "_qd": "rad/s", "_qdd": "rad/s^2"}.items():
        ride += [Channel(f"base_{k}{end}", "input", unit, hold="linear") for k in ANGLES]
    channels = (*(c for c in dataset.channels if c.name not in recorded), *ride)
    note = f"the base turns about its origin as recorded ({', '.join(recorded)})"
    return replace(
        dataset,
        channels=channels,
        experiments=tuple(map(one, dataset.experiments)),
        notes=(*dataset.notes, note),
    )


def _refuse_base(dataset: Dataset, tree: Tree, recorded: Sequence[str]) -> None:
    for c in dataset.channels:
        if c.name in recorded and (c.unit != "rad" or c.role == "output"):
            raise UsageError(
                f'{c.name} is the angle of the base: give it role = "auxiliary" and unit = "rad"'
                ' (or "deg")'
            )
    taken = [f"base_{k}" for k in ANGLES if f"base_{k}" in tree.joints]
    if taken:
        raise UsageError(
            f"{tree.file}: a joint is called {taken[0]!r}, which is the name of an angle of a base"
            " that moves: rename it"
        )


def _reader(dataset: Dataset, inputs: set[str]) -> Callable[[Experiment, str], np.ndarray]:
    names = dataset.input_names
    return lambda e, name: e.u[:, names.index(name)] if name in inputs else e.auxiliary[name]


def _motion(t: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Angle, rate and acceleration, [3 time], through a low-pass above which the angle has no
    content.
    """
    noise = max(
        float(np.std(np.diff(angle, 3))) / np.sqrt(20.0), FINE * float(np.ptp(angle)), 1e-12
    )
    smooth, rate, acceleration = differentiate(t, angle[:, None], content_cutoff(t, angle, noise))[
        :3
    ]
    return np.stack([smooth[:, 0], rate[:, 0], acceleration[:, 0]])
