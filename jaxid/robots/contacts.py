"""Where the shapes of a robot's file touch along a recording: what touches a plane is simulated
(`jaxid.robots.ground`); of other contacts only what lies between them counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from jaxid.base.errors import UsageError
from jaxid.base.wording import listed
from jaxid.data.dataset import Dataset, Experiment
from jaxid.data.splits import GUARD_SAMPLES
from jaxid.robots.ground import Ground
from jaxid.robots.ground_points import (
    kind_of,
    name_of,
    NEAR,
    Pair,
    PairContact,
    points_of,
    simulated,
)
from jaxid.robots.mjcf_spec import compiled, drop_all, library, parsed, touchable
from jaxid.robots.mjcf_ties import without_tendons
from jaxid.robots.recorded_joints import held_at
from jaxid.robots.tree import Tree


#: Words of the note that says which parts of runs do not count.
NOT_SIMULATED = "touch, and such contacts are not simulated"
#: Samples beside a contact that do not count: noise of the sensors moves where it begins and ends.
#: A part also knows its first ones, from which a late command acts.
GUARD = GUARD_SAMPLES
#: Samples of a run that are looked at; of a longer one every second, third ... of them.
MOST = 20_000


@dataclass(frozen=True, eq=False)
class Shapes:
    """The compiled model of a file's bodies, joints and plain shapes; its planes see what comes
    within `room` (m), 0 where the file has margins of its own.
    """

    model: Any
    room: float

    def acts(self, contact: Any) -> bool:
        """Whether a contact pushes, and does not only come near."""
        return bool(contact.dist < contact.includemargin - self._room(contact))

    def simulated(self, contact: Any) -> bool:
        """Whether a contact is of a kind that `jaxid.robots.ground` has."""
        return bool(self.room) and simulated(self.model, contact)

    def _room(self, contact: Any) -> float:
        return self.room if kind_of(self.model, contact.geom[0]) == "PLANE" else 0.0


@dataclass(frozen=True)
class Touching:
    """In which samples of a run [samples] something touches that is not simulated, and what does
    first ("": nothing). `near`: pairs of shapes that come near and are simulated; `landed`: whether
    one of them touches.
    """

    samples: Bool[np.ndarray, " samples"]
    between: str
    near: Mapping[Pair, PairContact]
    landed: bool


def free_of_contact(dataset: Dataset, tree: Tree, stepped: bool) -> Dataset:
    """The dataset with those parts of its runs in which no shapes of the robot's file touch but
    what is simulated, and a note; as it is where none do, the file has no shapes, or the dataset
    states `contacts = false`. `stepped`: whether MuJoCo's steps are simulated, which know contacts
    with planes.

    Shapes are planes, spheres, capsules, ellipsoids, cylinders and boxes; meshes are not looked at.
    Raises `UsageError` where nothing for fitting is left.
    """
    shapes = _looked_at(dataset, tree)
    if shapes is None:
        return dataset
    kept: list[Experiment] = []
    said: list[str] = []
    for run in dataset.experiments:
        touching = _touching(shapes, _positions(run, dataset, tree), len(run), stepped)
        if not touching.between:
            kept.append(run)
            continue
        kept += _parts(run, touching.samples)
        after = run.t[np.argmax(touching.samples)] - run.t[0]
        share = 100 * np.mean(touching.samples)
        said.append(f"{run.name} ({touching.between} after {after:.3g} s, {share:.2g} % of it)")
    if not said:
        return dataset
    if not any(run.split == "fit" for run in kept):
        raise UsageError(
            f"nothing for fitting is left where shapes of {tree.file} do not touch: {said[0]}."
            " Such contacts are not simulated: record the robot free of them, or state [model]"
            " contacts = false where the machine touches nothing"
        )
    note = (
        f"shapes of {tree.file} {NOT_SIMULATED}: left out of {listed(said)}"
        " (where the machine touches nothing, state [model] contacts = false)"
    )
    return replace(dataset, experiments=tuple(kept), notes=(*dataset.notes, note))


def ground_of(dataset: Dataset, tree: Tree) -> Ground | None:
    """What of a robot touches planes of its file along a recording, for a tree whose joints that
    are not recorded are held; None where nothing does that is simulated.
    """
    shapes = _looked_at(dataset, tree)
    if shapes is None:
        return None
    near: dict[Pair, PairContact] = {}
    landed = False
    for run in dataset.experiments:
        touching = _touching(shapes, _positions(run, dataset, tree), len(run), True)
        near |= touching.near
        landed = landed or touching.landed
    return points_of(shapes.model, near, tree) if landed else None


def _looked_at(dataset: Dataset, tree: Tree) -> Shapes | None:
    """The compiled shapes of a file whose contacts count; None where none do."""
    ignored = dataset.stated.contacts is False
    if ignored or tree.floats or not tree.text or _of_speed_alone(dataset, tree):
        return None
    return _shapes(tree.text, tree.file)


def _parts(run: Experiment, touching: Bool[np.ndarray, " samples"]) -> list[Experiment]:
    """The parts of a run between its contacts."""
    edges = np.flatnonzero(np.diff(touching, prepend=True, append=True))
    parts: list[tuple[int, int]] = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        start = 0 if begin == 0 else int(begin) + 2 * GUARD
        stop = len(run) if end == len(run) else int(end) - GUARD
        if stop - start >= 2 * GUARD:
            parts.append((start, stop))
    found: list[Experiment] = []
    for number, (start, stop) in enumerate(parts, 1):
        name = run.name if len(parts) == 1 else f"{run.name} part {number}"
        past = 0 if start == 0 else GUARD
        found.append(run.piece(start, stop, name=name, split=run.split, past=past))
    return found


def _of_speed_alone(dataset: Dataset, tree: Tree) -> bool:
    """Whether a joint moves whose position is not recorded."""
    outputs = dataset.output_names
    return any(f"{j}_qd" in outputs and j not in outputs for j in tree.leading)


@lru_cache(maxsize=8)
def _shapes(text: str, file: str) -> Shapes | None:
    """Those of a file; None where nothing in it can touch. Raises `UsageError` for shapes that
    MuJoCo refuses.
    """
    mujoco = library()
    spec = parsed(Path(file), text)
    if spec.option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT):
        return None
    shapes = _plain_shapes(spec)
    if not shapes:
        return None
    names = {g.name for g in shapes}
    pairs = [p for p in spec.pairs if {p.geomname1, p.geomname2} <= names]
    # A pair of its own has a margin of its own.
    room = 0.0 if pairs or any(g.margin or g.gap for g in shapes) else NEAR
    for geom in shapes:
        geom.material = ""
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.margin += room
    for body in spec.bodies[1:]:
        if not body.explicitinertial:  # of no matter to where something is
            body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), True
    drop_all(spec, {"geoms": shapes, "pairs": pairs, "excludes": list(spec.excludes)})
    without_tendons(mujoco, spec)
    return Shapes(compiled(Path(file), spec), room)


def _plain_shapes(spec: Any) -> list[Any]:
    """Planes and plain shapes of a file; of one whose base is free those that it carries: where it
    stands in its surroundings is not recorded.
    """
    joint = library().mjtJoint
    shapes = touchable(spec)
    if any(j.type == joint.mjJNT_FREE for j in spec.joints):
        shapes = [g for g in shapes if g.parent.name != "world"]
    return shapes


def _positions(run: Experiment, dataset: Dataset, tree: Tree) -> dict[str, np.ndarray]:
    """Joint of the file -> its position along a run [samples], or the one where it is held [1]."""
    measured = dict(zip(dataset.output_names, run.motion().T, strict=True))
    found = {joint: np.full(1, place) for joint, place in tree.held.items()}
    for joint in tree.leading:
        if joint in measured:
            found[joint] = measured[joint]
        else:
            found[joint] = np.full(1, held_at(tree, dataset, joint))
    for tie in tree.couplings:
        if tie.follower not in found and tie.leader in found:
            found[tie.follower] = np.asarray(tie.as_curve.at(found[tie.leader])[0])
    return found


def _touching(
    shapes: Shapes, positions: Mapping[str, np.ndarray], samples: int, stepped: bool
) -> Touching:
    """What touches along a run of so many samples; a run that is asked for again is not gone
    through again.
    """
    kept = tuple((j, np.asarray(x, float).tobytes()) for j, x in positions.items())
    return _looked_through(shapes, kept, samples, stepped)


@lru_cache(maxsize=32)
def _looked_through(
    shapes: Shapes, kept: tuple[tuple[str, bytes], ...], samples: int, stepped: bool
) -> Touching:
    positions = {joint: np.frombuffer(values) for joint, values in kept}
    mujoco, model = library(), shapes.model
    data = mujoco.MjData(model)
    joints = {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j): j for j in range(model.njnt)}
    addresses = {joint: model.jnt_qposadr[joints[joint]] for joint in positions if joint in joints}
    found, between = np.zeros(samples, bool), ""
    near: dict[Pair, PairContact] = {}
    landed = False
    step = 1 + samples // MOST
    for k in range(0, samples, step):
        for joint, address in addresses.items():
            values = positions[joint]
            data.qpos[address] = values[min(k, len(values) - 1)]
        mujoco.mj_fwdPosition(model, data)
        for contact in data.contact[: data.ncon]:
            pair = int(contact.geom[0]), int(contact.geom[1])
            acts = shapes.acts(contact)
            if stepped and (pair in near or shapes.simulated(contact)):
                near.setdefault(pair, PairContact.of(contact))
                landed = landed or acts
            elif acts:
                found[k : k + step] = True
                between = between or f"{name_of(model, pair[1])} touches {name_of(model, pair[0])}"
    return Touching(found, between, near, landed)
