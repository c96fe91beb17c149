"""Joints that stand at the stops of a robot's file, which not every model of it has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.wording import number, percent
from jaxid.data.dataset import Dataset
from jaxid.robots.tree import Tree


def at_stops(tree: Tree, dataset: Dataset) -> list[tuple[str, float]]:
    """Joints with a share of their samples that lie at a stop or past it, in any run."""
    outputs, found = dataset.output_names, []
    for joint in (j for j in tree.joints if j in outputs):
        k = tree.joint(joint)
        q = np.concatenate([e.y[:, outputs.index(joint)] for e in dataset.experiments])
        share = float(np.mean((q <= tree.lower[k]) | (q >= tree.upper[k])))
        if share > 0:
            found.append((joint, share))
    return found


def sentences_of(mechanism: Any, dataset: Dataset) -> tuple[str, ...]:
    """Those of a model, where it is a robot's."""
    held = getattr(mechanism, "tree", None)
    return () if held is None else sentences(held.tree, dataset, bool(mechanism.integrator))


def sentences(tree: Tree, dataset: Dataset, simulated: bool = False) -> tuple[str, ...]:
    """What is to be said of them; nothing where no joint comes to its stops. `simulated`: whether
    the model has stops.
    """
    found = at_stops(tree, dataset)
    if not found:
        return ()
    told = []
    for joint, share in found:
        k = tree.joint(joint)
        unit = "m" if tree.slides[k] else "rad"
        ends = f"{number(float(tree.lower[k]))} to {number(float(tree.upper[k]))} {unit}"
        told.append(
            f"{joint} stands at or past its range ({ends}) in {percent(share)} of the samples"
        )
    text = f"{'; '.join(told)}: MuJoCo stops it there"
    if not simulated:
        text += ", jaxid's model has no stops"
    return (f"{text}{_in_degrees(tree, [j for j, _ in found])}",)


def _in_degrees(tree: Tree, joints: list[str]) -> str:
    """Where a file that says no angle has ranges that are radians by their size."""
    path = Path(tree.file)
    if path.suffix.lower() not in (".xml", ".mjcf") or not path.is_file():
        return ""
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    at = [k for k in map(tree.joint, joints) if not tree.slides[k]]
    small = bool(at) and all(np.degrees(tree.upper[k] - tree.lower[k]) <= 4 * np.pi for k in at)
    if "<compiler" in text and "angle" in text or not small:
        return ""
    return (
        f". {path.name} states no angle, so its ranges are degrees: were radians meant, add"
        ' <compiler angle="radian"/>'
    )
