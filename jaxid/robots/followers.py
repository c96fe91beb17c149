"""Joints that a file couples, where a recording shows another one of them than the one that leads
in the file.

A coupling q_follower = offset + ratio q_leader is turned about: whichever of the coupled joints is
recorded leads. Numbers of drives go over by virtual work: torque_lead = ratio torque_follower.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.robots.tree import Actuator, Coupling, Tree


#: Endings of the channels that drive a joint.
DRIVES = ("_cmd", "_tau")


def drives_of(joint: str) -> list[str]:
    """The channels that drive a joint."""
    return [joint + end for end in DRIVES]


def led(tree: Tree, dataset: Dataset) -> tuple[Tree, tuple[str, ...]]:
    """(tree in which recorded joints lead those that the file couples to them, what is to be said
    of it).
    """
    outputs = {c.name for c in dataset.outputs}
    names = {c.name for c in dataset.channels}

    def shown(joint):
        return joint in outputs or f"{joint}_qd" in outputs

    notes = []
    for leader in dict.fromkeys(c.leader for c in tree.couplings):
        coupled = [c.follower for c in tree.couplings if c.leader == leader and c.ratio != 0]
        recorded = [j for j in (leader, *coupled) if shown(j)]
        driven = [j for j in recorded if not names.isdisjoint(drives_of(j))]
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
    offset = f"{c.offset:.4g} + " if c.offset else ""
    return f"{c.follower} = {offset}{c.ratio:.4g} {c.leader}"


def led_by(tree: Tree, lead: str) -> Tree:
    """The tree in which a follower leads the joints that it is coupled to. Its own ratio must not
    be 0.
    """
    own = next(c for c in tree.couplings if c.follower == lead)
    back = Coupling(own.leader, lead, -own.offset / own.ratio, 1 / own.ratio)
    couplings = []
    for c in tree.couplings:
        if c is own:
            couplings.append(back)
        elif c.leader == own.leader:
            couplings.append(
                Coupling(c.follower, lead, c.offset + c.ratio * back.offset, c.ratio * back.ratio)
            )
        else:
            couplings.append(c)
    return replace(tree, couplings=tuple(couplings))


def led_as(tree: Tree, leads: Sequence[str]) -> Tree:
    """The tree in which these joints lead those that the file couples to them."""
    for joint in leads:
        own = [c for c in tree.couplings if c.follower == joint and c.ratio != 0]
        tree = led_by(tree, joint) if own else tree
    return _with_drives(tree)


def _with_drives(tree: Tree) -> Tree:
    """The tree whose leading joints have the drives of joints that follow them, where they have
    none.
    """
    actuators = dict(tree.actuators)
    for c in tree.couplings:
        if c.follower in actuators and c.leader not in actuators and c.ratio != 0:
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
    outputs = {c.name for c in dataset.outputs}
    for c in tree.couplings:
        for end in DRIVES:
            names = {channel.name for channel in dataset.channels}
            wanted = c.ratio != 0 and (c.leader in outputs or f"{c.leader}_qd" in outputs)
            if wanted and c.follower + end in names and not {c.leader + e for e in DRIVES} & names:
                dataset = _moved(dataset, tree, c, end)
    return dataset


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
        return replace(e, u=u, auxiliary=auxiliary, past=None if e.past is None else one(e.past))

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
    names = [c.name for c in inputs]
    return names.index(name) if name in names else None
