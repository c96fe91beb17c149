"""Outputs that are of no joint, and where joints without a recording are held."""

from __future__ import annotations

import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.base.wording import names_of
from jaxid.data.dataset import Dataset
from jaxid.robots.floating import ANGLES
from jaxid.robots.tree import Tree


#: Constant under which a dataset states where a joint that it does not record was held.
POSE = "pose@"


def refuse_unknown(tree: Tree, outputs: set[str]) -> None:
    """Outputs that are of no joint."""
    unknown = sorted(outputs - set(tree.joints) - {f"{j}_qd" for j in tree.joints})
    if not unknown:
        return
    first = unknown[0]
    if first in ANGLES:
        raise UsageError(
            f'output {first!r} is how the base turns: [model.base] kind = "free" compares it;'
            ' of a base that is moved (kind = "prescribed") give it role = "auxiliary"'
        )
    raise UsageError(
        f"output {first!r} is not a joint of"
        f" {tree.title}{nearest(first, tree.leading)}; map it under"
        ' [model.joints], or give it role = "auxiliary"'
    )


def held_at(tree: Tree, dataset: Dataset, joint: str) -> float:
    """Where a joint without a measured position is held: as stated, as recorded beside, or as the
    file has it.
    """
    names = set(names_of(dataset.channels))
    constants = dataset.stated.constants
    stated = f"{POSE}{joint}"
    if stated in constants:
        return constants[stated]
    if f"{joint}_cmd" in names and joint not in names:
        raise UsageError(
            f"{joint} has a goal and no measured position: record it, or state where it was"
            f' held under [model.constants]: "{stated}" = 0.0'
        )
    series = [e.auxiliary[joint] for e in dataset.experiments if joint in e.auxiliary]
    return float(np.mean(np.concatenate(series))) if series else tree.neutral(joint)
