"""Where the robot of a result comes from: its file, the joints that moved, and the law that drove
them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.small_files import read_small, TooLarge
from jaxid.data.dataset import Dataset, Geometry
from jaxid.robots.match import is_robot, matched, prepared
from jaxid.robots.tree import Tree


#: Numbers of a drive law that a result states for each joint.
LAW = ("kp", "kd", "ki", "gain", "lowest", "highest", "offset", "delay", "lag")


def origin(mechanism: Any, geometry: Geometry | None) -> dict[str, Any]:
    """The file of a `Robot` with its SHA-256 ("" where it lies no more), its joints, those of them
    that no other one leads, where others were held, its drive: `{"file", "sha256", "joints",
    "leads", "held", "base", "drive": {"origin",
    "kind", "period", …, "joints": {NAME: {"kp": …}}} or None, "simulator": {"kind", …}}`.
    """
    tree: Tree = mechanism.tree.tree
    path = (geometry.path if geometry is not None else "") or tree.file
    base: dict[str, Any] = {}
    for angle in ("roll", "pitch", "yaw"):
        base[angle] = float(np.asarray(getattr(mechanism, f"base_{angle}")))
    if tree.floats:
        base["kind"] = "free"
    return {
        "file": path,
        "sha256": digest(path),
        "joints": list(tree.joints[6 * tree.floats :]),
        "leads": list(tree.driven),
        "held": {k: float(v) for k, v in tree.held.items()},
        "base": base,
        "drive": _drive(mechanism.drive_law, tree.driven),
        "simulator": _simulator(mechanism, tree),
    }


def _simulator(mechanism: Any, tree: Tree) -> dict[str, Any]:
    """Whose steps the result's simulations took, and which these are."""
    if not mechanism.integrator or tree.simulator is None:
        return {"kind": "own"}
    return {
        "kind": mechanism.simulator,
        "timestep": tree.simulator.timestep,
        "integrator": mechanism.integrator,
    }


def _drive(law: Any, joints: Sequence[str]) -> dict[str, Any] | None:
    if law is None:
        return None
    numbers = {}
    for i, joint in enumerate(joints):
        numbers[joint] = {name: float(getattr(law, name)[i]) for name in LAW}
    return {
        "origin": "[controller]" if law.origin == "[controller]" else "file",
        "kind": law.kind,
        "velocity": law.velocity,
        "rate": law.rate,
        "period": law.period,
        "joints": numbers,
    }


def origin_on(model: object, dataset: Dataset) -> dict[str, Any]:
    """The same for a model and a dataset that are not brought together yet; nothing where the model
    is no robot.
    """
    robot, data = prepared(model, dataset)
    if not is_robot(robot):
        return {}
    return origin(matched(robot, data).mechanism, data.stated.geometry)


def joined(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """That of a robot whose limbs were looked at one by one."""
    out: dict[str, Any] = dict(parts[0]) | {"joints": [], "leads": []}
    numbers: dict[str, Any] = {}
    for part in parts:
        out["joints"] += part.get("joints", ())
        out["leads"] += part.get("leads", ())
        if out.get("drive"):
            numbers |= part["drive"]["joints"]
    if out.get("drive"):
        out["drive"] = {**out["drive"], "joints": numbers}
    return out


def digest(path: str) -> str:
    """SHA-256 of a file, "" where there is none to read."""
    try:
        return hashlib.sha256(read_small(path)).hexdigest() if Path(path).is_file() else ""
    except (OSError, TooLarge):
        return ""
