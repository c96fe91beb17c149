"""Joints that a file couples, where a recording shows another one of them than the one that leads
in the file.

A coupling is turned about: whichever of the coupled joints is recorded leads. Along a line numbers
of drives go over by virtual work, torque_lead = ratio torque_follower; along a curve the joint that
is driven leads, and what was recorded of another one goes over to it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from jaxid.base.wording import names_of
from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.robots.tree import Actuator, Coupling, Tree


#: Endings of the channels that drive a joint.
DRIVES = ("_cmd", "_tau")


def led(tree: Tree, dataset: Dataset) -> tuple[Tree, tuple[str, ...]]:
    """(tree in which recorded joints lead those that the file couples to them, what is to be said
    of it).
    """
    outputs = set(dataset.output_names)
    names = set(names_of(dataset.channels))

    def shown(joint):
        return joint in outputs or f"{joint}_qd" in outputs

    notes = []
    for leader in dict.fromkeys(c.leader for c in tree.couplings):
        coupled = [c.follower for c in tree.couplings if c.leader == leader and c.turns]
        recorded = [j for j in (leader, *coupled) if shown(j)]
        driven = [j for j in recorded if _driven(j, names)]
        lead = (*driven, *recorded, leader)[0]
        if lead != leader:
            tree = led_by(tree, lead)
            back = next(c for c in tree.couplings if c.follower == leader)
            notes.append(
                f"{lead} is recorded and stands for {leader}, as the file couples them:"
                f" {_equation(back)}"
            )
    return _with_drives(tree), tuple(notes)


def _equation(c: Coupling) -> str:
    if c.curve is not None:
        return f"{c.follower} along a curve of {c.leader}"
    offset = f"{c.offset:.4g} + " if c.offset else ""
    return f"{c.follower} = {offset}{c.ratio:.4g} {c.leader}"


def led_by(tree: Tree, lead: str) -> Tree:
    """The tree in which a follower leads the joints that it is coupled to. Its own ratio must not
    be 0.
    """
    own = next(c for c in tree.couplings if c.follower == lead)
    back = own.turned()
    couplings = []
    for c in tree.couplings:
        if c is own:
            couplings.append(back)
        elif c.leader == own.leader:
            couplings.append(c.through(back))
        else:
            couplings.append(c)
    return replace(tree, couplings=tuple(couplings))


def led_as(tree: Tree, leads: Sequence[str]) -> Tree:
    """The tree in which these joints lead those that the file couples to them."""
    for joint in leads:
        own = [c for c in tree.couplings if c.follower == joint and c.turns]
        tree = led_by(tree, joint) if own else tree
    return _with_drives(tree)


def _with_drives(tree: Tree) -> Tree:
    """The tree whose leading joints have the drives of joints that follow them, where they have
    none.
    """
    actuators = dict(tree.actuators)
    for c in tree.couplings:
        straight = c.curve is None and c.ratio != 0
        if c.follower in actuators and c.leader not in actuators and straight:
            actuators[c.leader] = _seen_from_leader(actuators[c.follower], c)
    return tree if len(actuators) == len(tree.actuators) else replace(tree, actuators=actuators)


def _seen_from_leader(drive: Actuator, c: Coupling) -> Actuator:
    """A drive of the follower as one of the leader: of a goal, the leader's goal."""
    goal = drive.kind == "position"
    control = sorted((v - c.offset) / c.ratio for v in drive.control) if goal else drive.control
    low, high = sorted(c.ratio * v for v in drive.force)
    return replace(
        drive,
        kp=drive.kp * c.ratio**2,
        kd=drive.kd * c.ratio**2,
        gain=drive.gain * (c.ratio**2 if goal else c.ratio),
        offset=drive.offset * c.ratio,
        force=(low, high),
        control=(control[0], control[1]),
    )


def drives_led(dataset: Dataset, tree: Tree) -> Dataset:
    """The dataset with goals and torques that were recorded of followers as those of the joints
    that lead them, where those have none.
    """
    tree, _ = led(tree, dataset)
    outputs = set(dataset.output_names)
    for c in tree.couplings:
        for end in DRIVES:
            names = set(names_of(dataset.channels))
            straight = c.curve is None and c.ratio != 0
            wanted = straight and (c.leader in outputs or f"{c.leader}_qd" in outputs)
            if wanted and c.follower + end in names and not {c.leader + e for e in DRIVES} & names:
                dataset = _moved(dataset, tree, c, end)
    return dataset


def outputs_led(dataset: Dataset, tree: Tree) -> Dataset:
    """The dataset with positions that were recorded of joints as those of the joint that is driven,
    where a curve couples them and nobody recorded that one.
    """
    outputs = set(dataset.output_names)
    names = set(names_of(dataset.channels))
    curved = [c for c in tree.couplings if c.curve is not None]
    for leader in dict.fromkeys(c.leader for c in curved):
        own = {c.follower: c for c in tree.couplings if c.leader == leader and c.turns}
        joints = (leader, *own)
        driven = [j for j in joints if _driven(j, names)]
        shown = [j for j in joints if j in outputs]
        if len(driven) == 1 and shown and driven[0] not in names:
            to_leader = None if shown[0] == leader else own[shown[0]].turned()
            from_leader = own.get(driven[0])
            steps = [c for c in (to_leader, from_leader) if c is not None]
            dataset = _read_as(dataset, steps)
    return dataset


def _driven(joint: str, names: Collection[str]) -> bool:
    return any(joint + end in names for end in DRIVES)


def _read_as(dataset: Dataset, steps: Sequence[Coupling]) -> Dataset:
    """The dataset with the output of one joint as that of another, coupled in these steps; its
    noise by the slope in the middle of the recording.
    """
    whole = steps[0] if len(steps) == 1 else steps[1].through(steps[0])
    old, new = whole.leader, whole.follower
    column = dataset.output_names.index(old)
    middle = float(np.median(np.concatenate([e.y[:, column] for e in dataset.experiments])))
    slope = abs(float(whole.as_curve.at(middle)[1]))

    def one(e: Experiment) -> Experiment:
        y = e.y.copy()
        y[:, column] = whole.at(y[:, column])
        return replace(e, y=y, past=e.past_by(one))

    def scaled(size):
        return None if size is None else size * slope

    names = names_of(dataset.channels)
    place = names.index(old)
    channel = dataset.channels[place]
    moved = replace(
        channel,
        name=new,
        noise_std=scaled(channel.noise_std),
        resolution=scaled(channel.resolution),
    )
    note = f"the position of {old} is taken as that of {new}, as the file couples them"
    return replace(
        dataset,
        channels=(*dataset.channels[:place], moved, *dataset.channels[place + 1 :]),
        experiments=tuple(map(one, dataset.experiments)),
        notes=(*dataset.notes, note),
    )


def _moved(dataset: Dataset, tree: Tree, c: Coupling, end: str) -> Dataset:
    """The dataset with one drive's channel as that of the leader."""
    old, new = c.follower + end, c.leader + end
    slides = tree.slides[tree.joint(c.leader)]
    if end == "_cmd":
        unit, scale = ("m" if slides else "rad"), 1 / c.ratio

        def at_leader(x):
            return (x - c.offset) / c.ratio

    else:
        unit, scale = ("N" if slides else "N m"), c.ratio

        def at_leader(x):
            return x * c.ratio

    known = {"rad", "m"} if end == "_cmd" else {"N m", "N"}
    channel = next(channel for channel in dataset.channels if channel.name == old)
    if channel.unit not in known:
        return dataset

    def scaled(size):
        return None if size is None else size * abs(scale)

    moved = replace(
        channel,
        name=new,
        unit=unit,
        noise_std=scaled(channel.noise_std),
        resolution=scaled(channel.resolution),
    )
    column = _column(dataset.inputs, old)

    def one(e: Experiment) -> Experiment:
        u = e.u
        if column is not None:
            u = u.copy()
            u[:, column] = at_leader(u[:, column])
        auxiliary = {}
        for name, values in e.auxiliary.items():
            if name == old:
                auxiliary[new] = at_leader(values)
            else:
                auxiliary[name] = values
        return replace(e, u=u, auxiliary=auxiliary, past=e.past_by(one))

    what = "goal" if end == "_cmd" else "torque"
    note = (
        f"the {what} of {c.follower} is taken as that of {c.leader}, as the file couples them:"
        f" {_equation(c)}"
    )
    at = dataset.channels.index(channel)
    return replace(
        dataset,
        channels=(*dataset.channels[:at], moved, *dataset.channels[at + 1 :]),
        experiments=tuple(map(one, dataset.experiments)),
        notes=(*dataset.notes, note),
    )


def _column(inputs: Sequence[Channel], name: str) -> int | None:
    """Place of an input, None where it is auxiliary."""
    names = names_of(inputs)
    return names.index(name) if name in names else None
