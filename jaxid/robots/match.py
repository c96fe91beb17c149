"""A robot and a recording: channels by the joints' names, joints that were not recorded, and what
drives the others.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.base.wording import as_unit, names_of
from jaxid.data.dataset import Dataset, Experiment, Geometry, ModelSpec
from jaxid.data.joint_names import plain_name
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.joint_readings import with_speeds
from jaxid.dynamics.parameter import with_fields
from jaxid.robots import stops
from jaxid.robots.beside import as_inputs, left_out, rides, with_base, with_rates
from jaxid.robots.contacts import free_of_contact, ground_of
from jaxid.robots.drive_inputs import driven_by, without_drive
from jaxid.robots.drives import asked_for_contacts, law_of, simulator_of, stepped
from jaxid.robots.file_step import beyond_its_step
from jaxid.robots.floating import floating, refuse_unmeasured, wanted
from jaxid.robots.followers import drives_led, led, outputs_led
from jaxid.robots.free_joints import with_free_joints
from jaxid.robots.ground import Ground
from jaxid.robots.mjcf_text import expanded
from jaxid.robots.recorded_joints import held_at, POSE as POSE, refuse_unknown
from jaxid.robots.steps import EXACT_STEPS
from jaxid.robots.tree import Coupling, Tree


#: What is recorded of a joint beside its position, by the ending of the channel's name; a numbered
#: channel has the word in front.
KINDS = {"_cmd": "goal", "_tau": "torque", "_qd": "speed"}


@lru_cache(maxsize=32)
def robot_of(text: str, file: str, tip: str | None = None) -> Any:
    """The `Robot` of a file's text, MJCF or URDF by its outermost tag."""
    from jaxid.models import Robot

    urdf = re.search(r"<\s*(robot|mujoco)\b", text)
    return (Robot.from_urdf if urdf and urdf[1] == "robot" else Robot.from_mjcf)(
        file, tip=tip, text=text
    )


def robot_from(path: str, tip: str | None = None) -> Any:
    """The `Robot` of a file by its name's ending."""
    from jaxid.models import Robot

    return (Robot.from_urdf if path.lower().endswith(".urdf") else Robot.from_mjcf)(path, tip=tip)


def is_file(model: object) -> TypeGuard[str]:
    """Whether a model is named by the path of a robot's file."""
    return isinstance(model, str) and model.lower().endswith((".urdf", ".xml", ".mjcf"))


def joints_that_move(path: str) -> dict[str, bool]:
    """The joints of a robot's file that are recorded, in its order: name, and whether it slides."""
    tree: Tree = robot_from(path).tree.tree
    slides = dict(zip(tree.joints, tree.slides, strict=True))
    return {joint: bool(slides[joint]) for joint in tree.leading}


def spec_of_file(path: str) -> ModelSpec:
    """What a dataset says of a robot by its file, includes in place."""
    text = (
        Path(path).read_text(encoding="utf-8-sig")
        if path.lower().endswith(".urdf")
        else expanded(Path(path))
    )
    return ModelSpec(
        "robot", geometry=Geometry(file=Path(path).name, tip=getattr(path, "tip", None), robot=text)
    )


def is_robot(model: object) -> bool:
    return getattr(model, "name", "") == "robot" and hasattr(model, "matched")


def forms_of(channel: str, joint: str) -> dict[str, str]:
    """Names that channels of a joint may have where its position is `channel`, and what they are
    under the joint's name.
    """
    forms = {channel: joint, **{channel + end: joint + end for end in KINDS}}
    if re.fullmatch(r"q\d*", channel):
        number = channel[1:]
        forms |= {
            f"tau{number}": f"{joint}_tau",
            f"qd{number}": f"{joint}_qd",
            f"force{number}": f"{joint}_tau",
        }
    return forms


def of_the_file(
    joints: Mapping[str, str], tree: Tree, have: set[str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Channel -> joint of the file, whose names may be written a little differently
    (`arm/Shoulder-Pan`, `shoulder_pan.pos`); and those that the file lacks while all joints that it
    has are recorded.

    Raises `UsageError` for a joint that it lacks while another one is not recorded: that may be a
    slip.
    """
    found, gone = {}, {}
    for channel, joint in joints.items():
        alike = (
            [joint]
            if joint in tree.joints
            else [j for j in tree.joints if plain_name(j) == plain_name(joint)]
        )
        if len(alike) == 1:
            found[channel] = alike[0]
        else:
            gone[channel] = joint
    lacking = [joint for joint in gone.values() if joint not in tree.held]
    if lacking and not set(tree.leading) <= {*found.values(), *(have - set(gone))}:
        first = lacking[0]
        raise UsageError(
            f"[model.joints] names {first!r}, no joint of {tree.file}{nearest(first, tree.joints)}"
        )
    return found, gone


def named(dataset: Dataset, tree: Tree, joints: Mapping[str, str] | None = None) -> Dataset:
    """The dataset with its channels under the joints' names: as [model.joints] says, else q1 … in
    the order of the file.

    Raises `UsageError` for a joint that the robot lacks.
    """
    notes, have = [], set(names_of(dataset.channels))
    joints, gone = of_the_file(dict(joints or {}), tree, have)
    out = _channels_of(gone, have)
    if out:
        dataset = left_out(dataset, out)
        notes = [f"left out, for {tree.title} lacks them: {', '.join(gone.values())}"]
        have = set(names_of(dataset.channels))
    if not joints:
        joints, said = _numbered_joints(dataset, tree)
        notes += said
    names: dict[str, str] = {}
    for channel, joint in joints.items():
        forms = forms_of(channel, joint)
        names |= {old: new for old, new in forms.items() if old in have and old not in names}
    if not names:
        return replace(dataset, notes=(*dataset.notes, *notes)) if notes else dataset
    clash = sorted(have & set(names.values()) - names.keys())
    if clash:
        raise UsageError(
            f"the recording has a channel {clash[0]!r} beside the one that [model.joints] names so:"
            " rename one"
        )

    def new(name):
        return names.get(name, name)

    return replace(
        dataset,
        channels=tuple(replace(c, name=new(c.name)) for c in dataset.channels),
        experiments=tuple(_renamed(e, new) for e in dataset.experiments),
        notes=(*dataset.notes, *notes),
    )


def _channels_of(positions: Iterable[str], have: set[str]) -> list[str]:
    """The recorded channels of joints, by those of their positions."""
    found: list[str] = []
    for channel in positions:
        found += [form for form in forms_of(channel, channel) if form in have]
    return found


def _numbered_joints(dataset: Dataset, tree: Tree) -> tuple[dict[str, str], list[str]]:
    """(channel -> joint of the file, note) of positions q1 … that nothing names."""
    outputs = dataset.output_names
    numbered = {c: int(c[1:] or 1) for c in outputs if re.fullmatch(r"q\d*", c)}
    if not numbered:
        return {}, []
    in_order = sorted(numbered, key=lambda c: numbered[c])
    if set(names_of(dataset.channels)).isdisjoint(tree.joints):
        last = in_order[-1]
        if numbered[last] > len(tree.leading):
            raise UsageError(
                f"channel {last} has no joint: {tree.file} has {', '.join(tree.leading)}"
            )
        joints = {c: tree.leading[numbered[c] - 1] for c in in_order}
        listed = ", ".join(f"{c} = {j}" for c, j in joints.items())
        note = (
            f"joints by the order of the file, as the recording does not name them: {listed} (else"
            " state [model.joints])"
        )
        return joints, [note]
    if set(outputs) <= set(tree.joints):
        # joints that are named q, q1 …: their torques are tau, tau1 …
        return {c: c for c in in_order}, []
    return {}, []


def _renamed(e: Experiment, new: Any) -> Experiment:
    return replace(
        e,
        auxiliary={new(k): v for k, v in e.auxiliary.items()},
        initial=None if e.initial is None else {new(k): v for k, v in e.initial.items()},
        past=e.past_by(lambda past: _renamed(past, new)),
    )


def driving(dataset: Dataset, tree: Tree) -> Dataset:
    """The dataset with its goals as inputs where they alone can drive: no torque is an input, and
    the goals are auxiliary.
    """
    goal_names = {f"{joint}_cmd" for joint in tree.joints}
    torques = {f"{joint}_tau" for joint in tree.joints}
    if not {*tree.joints, *goal_names, *torques}.isdisjoint(dataset.input_names):
        return dataset
    goals = [c.name for c in dataset.channels if c.role == "auxiliary" and c.name in goal_names]
    free = dataset.stated.free and dataset.controller is None
    if free or not goals:
        return dataset
    note = "no torque was recorded: the goals drive through the stated law"
    moved = as_inputs(dataset, goals)
    spec = dataset.model and replace(dataset.model, free=False)
    return replace(moved, model=spec, notes=(*dataset.notes, note))


def for_a_robot(dataset: Dataset) -> Dataset:
    """The dataset without the numbers that it states of a model that is no robot, which is not the
    one that was asked for.
    """
    spec = dataset.model
    if spec is None or spec.name in (None, "robot"):
        return dataset

    def own(numbers):
        return {k: v for k, v in numbers.items() if "@" in k or k == "smoothing_velocity"}

    constants, parameters = own(spec.constants), own(spec.parameters)
    gone = [k for k in (*spec.constants, *spec.parameters) if k not in (*constants, *parameters)]
    note = (
        f"dataset.toml states {', '.join(gone)} of {spec.name}, which is not the model asked for:"
        " not used"
        if gone
        else ""
    )
    spec = replace(
        spec, name="robot", geometry=None, without=(), constants=constants, parameters=parameters
    )
    return replace(dataset, model=spec, notes=(*dataset.notes, *([note] if note else [])))


def prepared(model: object, dataset: Dataset) -> tuple[object, Dataset]:
    """(model, dataset) where either may mean a robot: its `Robot`, and the dataset under the
    joints' names. Else as they are.
    """
    model = _meant(model, dataset)
    if not is_robot(model):
        return model, dataset
    dataset = for_a_robot(dataset)
    if wanted(dataset) and not model.tree.tree.floats:  # type: ignore[attr-defined]
        model = type(model)(floating(model.tree.tree), driven=False)  # type: ignore[attr-defined, call-arg]
    tree: Tree = model.tree.tree  # type: ignore[attr-defined]
    dataset = named(dataset, tree, dataset.stated.joints)
    dataset = driving(drives_led(outputs_led(dataset, tree), tree), tree)
    tree, _ = led(tree, dataset)
    dataset = with_free_joints(dataset, tree)
    dataset = with_rates(dataset, tree)
    dataset = free_of_contact(dataset, tree, stepped(model, tree, dataset))
    return model, with_base(dataset, tree)


def _meant(model: object, dataset: Dataset) -> object:
    """The `Robot` of a file that is named, or that the dataset states; else the model as it is."""
    stated = dataset.stated.geometry
    if (model is None or model == "robot") and stated is not None and stated.robot:
        return robot_of(stated.robot, stated.file, stated.tip)
    if not is_file(model):
        return model
    tip = getattr(model, "tip", None)  # of a path that the command line was given with one
    may_be_an_arm = model.lower().endswith(".urdf") and tip is None and not wanted(dataset)
    return _beyond_an_arm(model, dataset) if may_be_an_arm else robot_from(model, tip)


def _beyond_an_arm(path: str, dataset: Dataset) -> Any:
    """The `Robot` of a URDF where a serial arm of numbered joints would not do: the recording names
    joints, goals drive, or the tree branches; else the path.
    """
    try:
        robot = robot_from(path)
    except UsageError:
        return path  # `SerialArm.from_urdf` says what is wrong with it
    tree: Tree = robot.tree.tree
    names = set(names_of(dataset.channels))
    torque = any(c.unit in ("N m", "N", "A") for c in dataset.inputs)
    chain = all(up == k - 1 for k, up in enumerate(tree.parent))
    goals = dataset.controller is not None and not torque
    by_name = bool(names & set(tree.joints)) or bool(dataset.stated.joints)
    return robot if by_name or goals or not chain else path


def matched(robot: Any, dataset: Dataset) -> Chain:
    """The chain of a robot on a dataset whose channels go by its joints' names.

    Raises `UsageError` where no joint is recorded, goals and torques are both inputs, or some
    joints lack theirs.
    """
    tree: Tree = robot.tree.tree
    tree, notes = recorded(tree, dataset)
    spec = dataset.stated
    what = driven_by(tree.driven, dataset)
    if not (what or spec.free):
        raise UsageError(without_drive(tree.driven[0], dataset))
    riding = rides(dataset) and bool(what)
    law = law_of(tree, dataset) if what == "goal" else None
    simulator = simulator_of(robot, tree, law, spec)
    ground = _ground(tree, dataset, simulator) if not riding else None
    out = type(robot)(tree, driven=False, rides=riding, simulator=simulator, ground=ground)
    if law is not None:
        out = out.driven_by(law)
    out = _placed(out, spec)
    smoothing = spec.constants.get("smoothing_velocity", 0.0)
    signature = with_speeds(out.signatures[0], {c.name: c.unit for c in dataset.outputs})
    units = {c.name: c.unit for c in dataset.channels}
    needed = signature.outputs if spec.free else (*signature.outputs, *signature.inputs)
    for name, unit in needed:
        if (have := units.get(name, unit)) != unit:
            raise UsageError(
                f"channel {name!r} is in {have}; {tree.title} has it in {unit}:"
                f" correct its unit, or convert it: {as_unit(have, unit)}"
            )
    return Chain(out, signature=signature, smoothing_velocity=smoothing)


def _ground(tree: Tree, dataset: Dataset, simulator: str) -> Ground | None:
    """What touches planes where that is asked for, in MuJoCo's steps."""
    if simulator != "mujoco" or not asked_for_contacts(dataset):
        return None
    return ground_of(dataset, tree)


def recorded(tree: Tree, dataset: Dataset) -> tuple[Tree, tuple[str, ...]]:
    """The tree with joints that the dataset does not measure held, and what is to be said of it."""
    outputs = set(dataset.output_names)
    if tree.floats:
        refuse_unmeasured(tree, dataset)
    tree, notes = led(tree, dataset)
    measured = [j for j in tree.leading if j in outputs or f"{j}_qd" in outputs]
    followers = {c.follower: c.leader for c in tree.couplings if c.follower in outputs}
    _refuse_lone_followers(followers, measured)
    _refuse_ties(tree, measured)
    if not measured:
        raise UsageError(
            f"no channel is a joint of {tree.title}: its joints are {', '.join(tree.leading)}, the"
            f" outputs of the recording {', '.join(sorted(outputs)) or 'none'}. Name channels so,"
            f' or map them under [model.joints]: q1 = "{tree.leading[0]}"'
        )
    refuse_unknown(tree, outputs)
    held = {joint: held_at(tree, dataset, joint) for joint in tree.leading if joint not in measured}
    locked = tree.locked(held)
    own = {joint: at for joint, at in locked.held.items() if joint not in tree.held}
    said = filter(
        None,
        (
            _held_said(own) if held else "",
            _ties_said(tree),
            _curves_said(tree, measured),
            _followers_said(followers),
        ),
    )
    return locked, (*notes, *said)


def _refuse_lone_followers(followers: Mapping[str, str], measured: Sequence[str]) -> None:
    """Raises `UsageError` where a joint is recorded and the one that leads it is not."""
    for follower, leader in followers.items():
        if leader not in measured:
            raise UsageError(
                f"{follower} is recorded and {leader}, which it follows, is not: record {leader},"
                f" or work its position out of that of {follower} (`scale`, `offset`) and give"
                f' {follower} role = "auxiliary"'
            )


def _held_said(held: Mapping[str, float]) -> str:
    """Joints that are held, with what follows them."""
    listed = ", ".join(f"{joint} at {at:.4g}" for joint, at in held.items())
    return (
        f"not recorded and held: {listed} (state {POSE}NAME under [model.constants] where that is"
        " wrong)"
    )


def _ties_said(tree: Tree) -> str:
    if not tree.ties:
        return ""
    listed = "; ".join(f"{t.what}, of {', '.join(t.joints)}" for t in tree.ties)
    return f"not simulated, for all joints that it acts on are held: {listed}"


def _curves_said(tree: Tree, measured: Sequence[str]) -> str:
    curved = [c for c in tree.couplings if c.curve is not None and c.leader in measured]
    if not curved:
        return ""
    listed = ", ".join(f"{c.follower} with {c.leader} at {_about(c):.3g}" for c in curved)
    return f"coupled by a curve: {listed}; dry friction of a follower counts as it does there"


def _followers_said(followers: Mapping[str, str]) -> str:
    if not followers:
        return ""
    listed = ", ".join(f"{a} follows {b}" for a, b in followers.items())
    return f"{listed}, as the file says: not compared"


def _about(c: Coupling) -> float:
    return c.as_curve.about


def _refuse_ties(tree: Tree, measured: Sequence[str]) -> None:
    """Raises `UsageError` where a joint that is recorded, or follows one that is, hangs on what a
    tree cannot express.
    """
    moves = {*measured, *(c.follower for c in tree.couplings if c.leader in measured)}
    for tie in tree.ties:
        hanging = [j for j in (*measured, *tie.joints) if j in tie.joints and j in moves]
        if hanging:
            raise UsageError(
                f"{tree.title}: {tie.what}, acts on {', '.join(tie.joints)}, and"
                f" {hanging[0]} is recorded; jaxid takes joints that are driven by themselves. Give"
                ' these joints role = "auxiliary" (and take their goals out): they are then held'
                " where they were on average"
            )


def _placed(robot: Any, spec: ModelSpec) -> Any:
    """The robot on the base that [model.base] states."""
    base = dict(spec.base)
    kind = base.pop("kind", "fixed")
    if kind == "free":
        if base:
            raise UsageError(
                f'[model.base] {next(iter(base))}: a base of kind = "free" is where its channels'
                " base_roll, base_pitch and base_yaw show it; leave the angle out"
            )
        return robot
    return with_fields(robot, {f"base_{k}": np.float64(v) for k, v in base.items()})


def notes_of(model: Any, dataset: Dataset) -> tuple[str, ...]:
    """What a result says of how a robot and a recording were brought together."""
    tree: Tree = model.tree.tree
    _, notes = recorded(tree, dataset)
    chain = matched(model, dataset)
    law = chain.mechanism.drive_law  # type: ignore[attr-defined]
    notes = notes if law is None else (*notes, law.text)
    if law is not None or chain.mechanism.integrator:
        notes = (*notes, _steps_said(chain.mechanism))
    impossible = [
        f"{text}: no body has it, the nearest one is simulated" for _, text in tree.impossible
    ]
    stopped = stops.sentences(tree, dataset, bool(chain.mechanism.integrator))
    return (*tree.notes, *impossible, *notes, *stopped)


def _steps_said(mechanism: Any) -> str:
    """Whose steps simulate a robot under goals, and why not the file's."""
    tree: Tree = mechanism.tree.tree
    if mechanism.integrator and tree.simulator is not None:
        if mechanism.simulator == EXACT_STEPS:
            return f"simulated in {tree.simulator.exact().said}, which leave nothing behind"
        return f"simulated as its file asks MuJoCo for: {tree.simulator.said}"
    beyond = beyond_its_step(tree, mechanism.drive_law)
    return f"simulated in jaxid's own steps: {beyond or 'with joints that dry friction holds'}"
