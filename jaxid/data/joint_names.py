"""The joints of a recording and those of a chain, matched by their names: q1 … become the chain's
first joint and so on.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Channel, Dataset, Experiment


_NUMBERED = re.compile(r"([A-Za-z_]+?)(\d+)((?:_[A-Za-z]+)?)")


def joint_names(mechanism: Any) -> tuple[str, ...]:
    """The names that a chain's file gives its joints, in the order of the chain; none where it has
    no names.
    """
    return tuple(getattr(mechanism, "joint_names", ()))


def names_of_joints(mechanism: Any, dataset: Dataset, count: int) -> tuple[str, ...]:
    """Names of the first `count` joints, by the chain's file or else by the recording; q1 … where
    neither names all of them.
    """
    of_chain = joint_names(mechanism)
    if of_chain:
        return of_chain
    joints = dataset.stated.joints
    channels = tuple(f"q{k}" for k in range(1, count + 1))
    if joints.keys() >= set(channels):
        return tuple(joints[channel] for channel in channels)
    return channels


def in_chain_order(dataset: Dataset, names: Sequence[str]) -> Dataset:
    """The dataset with its numbered channels in the order of the chain's joints `names`, which a
    note says.

    Joints that the chain lacks become auxiliary channels behind them. Without names on either side
    the numbers count, and a note says so where there are more joints than the chain has. Raises
    `UsageError` where the chain's joints are not recorded.
    """
    if not names:
        return dataset
    joints = dataset.stated.joints
    if not joints:
        return _bynumber_of(dataset, names)
    numbers = renumbered(joints, names)
    left = [joints[f"q{old}"] for old, new in numbers.items() if new > len(names)]
    if not left and all(old == new for old, new in numbers.items()):
        return dataset

    def new_name(name):
        return renamed(name, numbers)

    channels = _reordered(dataset.channels, new_name, len(names))
    in_order = sorted(numbers, key=lambda old: numbers[old])
    order = {f"q{numbers[old]}": joints[f"q{old}"] for old in in_order}
    of_chain = list(order.items())[: len(names)]
    note = "joints by name, in the order of the chain: "
    note += ", ".join(f"{channel} = {joint}" for channel, joint in of_chain)
    note += f"; the recording has {', '.join(joints.values())}"
    if left:
        note += f"; left out, for the chain lacks them: {', '.join(left)}"
    controller = dataset.controller
    if controller is not None:
        settings = _settings(controller.settings, numbers, new_name, len(names))
        controller = replace(controller, settings=settings)
    responses = [
        replace(r, input=new_name(r.input), output=new_name(r.output)) for r in dataset.responses
    ]
    return replace(
        dataset,
        channels=channels,
        experiments=tuple(_experiment(e, dataset, channels, new_name) for e in dataset.experiments),
        responses=tuple(responses),
        model=replace(dataset.stated, joints=order),
        controller=controller,
        notes=(*dataset.notes, note),
    )


def _reordered(
    channels: Sequence[Channel], new_name: Callable[[str], str], count: int
) -> tuple[Channel, ...]:
    """Channels under their new names: inputs, outputs, then auxiliary ones, among which are those
    of joints behind the first `count`.
    """
    roles = ("input", "output", "auxiliary")
    moved = []
    for channel in channels:
        name = new_name(channel.name)
        role = "auxiliary" if number_of(name) > count else channel.role
        moved.append(replace(channel, name=name, role=role))
    return tuple(sorted(moved, key=lambda c: (roles.index(c.role), _place(c))))


def renumbered(joints: Mapping[str, str], names: Sequence[str]) -> dict[int, int]:
    """Number of each recorded joint (`joints`: q1 -> its name) -> its number in the chain; those
    that it lacks come behind.
    """
    own = {int(c[1:]): j for c, j in joints.items() if re.fullmatch(r"q\d+", c)}
    plain = [plain_name(j) for j in own.values()]
    found: dict[int, int] = {}
    missing = []
    for place, name in enumerate(names, 1):
        exact = [k for k, j in own.items() if j == name]
        alike = exact or [
            k
            for k, j in own.items()
            if plain_name(j) == plain_name(name) and plain.count(plain_name(name)) == 1
        ]
        if alike:
            found[alike[0]] = place
        else:
            missing.append(name)
    if missing:
        raise UsageError(
            f"the recording has no joint {', '.join(missing)} of the chain {', '.join(names)}; it"
            f" has {', '.join(own.values())}. Name its joints as the chain does under"
            " [model.joints] of dataset.toml, q1 = 'NAME' …, or the chain's end with --tip"
        )
    behind = iter(range(len(names) + 1, len(names) + len(own) + 1))
    return found | {k: next(behind) for k in sorted(own) if k not in found}


def _bynumber_of(dataset: Dataset, names: Sequence[str]) -> Dataset:
    """Without names of the recording: a note where the numbers are all there is, and joints are
    left out.
    """
    more = sorted(
        (
            c.name
            for c in dataset.outputs
            if re.fullmatch(r"q\d+", c.name) and number_of(c.name) > len(names)
        ),
        key=number_of,
    )
    note = "joints by their numbers, for the recording does not name them: " + ", ".join(
        f"q{k} = {n}" for k, n in enumerate(names, 1)
    )
    note += " (name them under [model.joints])"
    note += f"; left out, for the chain has {len(names)} joints: {', '.join(more)}" if more else ""
    return (
        dataset
        if note in dataset.notes or len(names) == 1
        else replace(dataset, notes=(*dataset.notes, note))
    )


def plain_name(name: str) -> str:
    """A name without what drivers put around it: `arm/shoulder_pan_joint`, `Shoulder-Pan`,
    `shoulder_pan.pos`.
    """
    last = name.rpartition("/")[2].lower()
    last = re.sub(r"(\.pos|\.position)$", "", last)
    last = re.sub(r"[_\- ]?joint$|^joint[_\- ](?=[a-z])", "", last)
    return re.sub(r"[^a-z0-9]", "", last)


def number_of(name: str) -> int:
    """The joint of a numbered channel, 0 where it has no number."""
    match = _NUMBERED.fullmatch(name)
    return int(match[2]) if match else 0


def renamed(name: str, numbers: Mapping[int, int]) -> str:
    """A numbered channel under its joint's new number."""
    match = _NUMBERED.fullmatch(name)
    if match is None or int(match[2]) not in numbers:
        return name
    return f"{match[1]}{numbers[int(match[2])]}{match[3]}"


def _place(channel: Channel) -> tuple[str, int, str]:
    match = _NUMBERED.fullmatch(channel.name)
    return (match[1], int(match[2]), match[3]) if match else (channel.name, 0, "")


def _experiment(
    e: Experiment, dataset: Dataset, channels: Sequence[Channel], new_name: Any
) -> Experiment:
    """One run with its columns under their new names."""
    columns = {new_name(c.name): e.u[:, i] for i, c in enumerate(dataset.inputs)}
    columns |= {new_name(c.name): e.y[:, i] for i, c in enumerate(dataset.outputs)}
    columns |= {new_name(k): v for k, v in e.auxiliary.items()}

    def of(role):
        return [c.name for c in channels if c.role == role]

    def stack(names):
        return np.stack([columns[n] for n in names], 1) if names else np.zeros((len(e.t), 0))

    old = {new_name(c.name): i for i, c in enumerate(dataset.outputs)}

    def by_output(a):
        return None if a is None else a[:, [old[n] for n in of("output")]]

    initial = None
    if e.initial is not None:
        known = set(columns)
        initial = {
            new_name(k): v
            for k, v in e.initial.items()
            if k not in known or new_name(k) in of("output")
        }
    return replace(
        e,
        u=stack(of("input")),
        y=stack(of("output")),
        auxiliary={n: columns[n] for n in of("auxiliary")},
        initial=initial,
        past=e.past_by(lambda past: _experiment(past, dataset, channels, new_name)),
        scatter=by_output(e.scatter),
        left_out=by_output(e.left_out),
    )


def _settings(
    settings: Mapping[str, Any],
    numbers: Mapping[int, int],
    new_name: Callable[[str], str],
    count: int,
) -> dict[str, Any]:
    """A law's gains in the order of the chain, its channels under their new names."""
    olds = sorted(numbers)
    places = [olds.index(old) for old in sorted(olds, key=lambda old: numbers[old])[:count]]

    def moved(value: Any) -> Any:
        if isinstance(value, str):
            return new_name(value)
        if isinstance(value, list) and len(value) == len(olds):
            return [moved(value[place]) for place in places]
        return value

    return {key: moved(value) for key, value in settings.items()}
