"""Where the shapes of a robot's file touch along a recording. Contacts are not simulated, so only
what lies between them counts.
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
from jaxid.robots.mjcf_spec import compiled, drop_all, library, parsed, plain
from jaxid.robots.mjcf_ties import without_tendons
from jaxid.robots.recorded_joints import held_at
from jaxid.robots.tree import Tree


#: Samples beside a contact that do not count: noise of the sensors moves where it begins and ends.
#: A part also knows its first ones, from which a late command acts.
GUARD = GUARD_SAMPLES
#: Samples of a run that are looked at; of a longer one every second, third ... of them.
MOST = 20_000


@dataclass(frozen=True)
class Touching:
    """In which samples of a run [samples] something touches, and what does first."""

    samples: Bool[np.ndarray, " samples"]
    between: str


def free_of_contact(dataset: Dataset, tree: Tree) -> Dataset:
    """The dataset with those parts of its runs in which no shapes of the robot's file touch, and a
    note; as it is where none do, the file has no shapes, or the dataset states `contacts = false`.

    Shapes are planes, spheres, capsules, ellipsoids, cylinders and boxes; meshes are not looked at.
    Raises `UsageError` where nothing for fitting is left.
    """
    ignored = dataset.model is not None and dataset.model.contacts is False
    if ignored or tree.floats or not tree.text or _of_speed_alone(dataset, tree):
        return dataset
    shapes = _shapes(tree.text, tree.file)
    if shapes is None:
        return dataset
    kept: list[Experiment] = []
    said: list[str] = []
    for run in dataset.experiments:
        touching = _touching(shapes, _positions(run, dataset, tree), len(run))
        if touching is None:
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
            " Contacts are not simulated: record the robot free of them, or state [model]"
            " contacts = false where the machine touches nothing"
        )
    note = (
        f"shapes of {tree.file} touch, and contacts are not simulated: left out of {listed(said)}"
        " (where the machine touches nothing, state [model] contacts = false)"
    )
    return replace(dataset, experiments=tuple(kept), notes=(*dataset.notes, note))


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
def _shapes(text: str, file: str) -> Any:
    """The compiled model of a file's bodies, joints and plain shapes; None where nothing in it can
    touch. Raises `UsageError` for shapes that MuJoCo refuses.
    """
    mujoco = library()
    spec = parsed(Path(file), text)
    if spec.option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT):
        return None
    floats = any(j.type == mujoco.mjtJoint.mjJNT_FREE for j in spec.joints)
    shapes = [g for g in spec.geoms if plain(g) or g.type == mujoco.mjtGeom.mjGEOM_PLANE]
    if floats:  # where it stands in its surroundings is not recorded
        shapes = [g for g in shapes if g.parent.name != "world"]
    if not shapes:
        return None
    names = {g.name for g in shapes}
    pairs = [p for p in spec.pairs if {p.geomname1, p.geomname2} <= names]
    for geom in shapes:
        geom.material = ""
    for body in spec.bodies[1:]:
        if not body.explicitinertial:  # of no matter to where something is
            body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), True
    drop_all(spec, {"geoms": shapes, "pairs": pairs, "excludes": list(spec.excludes)})
    without_tendons(mujoco, spec)
    return compiled(Path(file), spec)


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


def _touching(model: Any, positions: Mapping[str, np.ndarray], samples: int) -> Touching | None:
    """Where shapes touch along a run of so many samples; None where they never do."""
    mujoco = library()
    data = mujoco.MjData(model)
    joints = {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j): j for j in range(model.njnt)}
    addresses = {joint: model.jnt_qposadr[joints[joint]] for joint in positions if joint in joints}
    found, between = np.zeros(samples, bool), ""
    step = 1 + samples // MOST
    for k in range(0, samples, step):
        for joint, address in addresses.items():
            values = positions[joint]
            data.qpos[address] = values[min(k, len(values) - 1)]
        mujoco.mj_fwdPosition(model, data)
        acting = np.flatnonzero(data.contact.exclude[: data.ncon] == 0)
        found[k : k + step] = acting.size > 0
        if acting.size and not between:
            first, second = data.contact.geom[acting[0]]
            between = f"{_name(model, second)} touches {_name(model, first)}"
    return Touching(found, between) if between else None


def _name(model: Any, geom: int) -> str:
    """That of a shape, or of its body."""
    mujoco = library()
    own = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, int(geom))
    body = int(model.geom_bodyid[geom])
    return own or mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or "the world"
