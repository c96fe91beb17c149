"""The commanded motion in the place of the measured one: it is smooth, and as good where the drives
follow it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Dataset


def commanded(dataset: Dataset) -> Dataset:
    """The dataset with every output NAME read from its commanded channel NAME_cmd (paper 001,
    equation 7).

    Raises `UsageError` where a run lacks one.
    """
    names = dataset.output_names
    lacking = []
    for goal in (f"{n}_cmd" for n in names):
        if not all(goal in e.auxiliary for e in dataset.experiments):
            lacking.append(goal)
    if lacking:
        raise UsageError(
            f"the commanded motion needs {', '.join(lacking)}: give the controller's target"
            ' position of each joint as a channel of that name, role = "auxiliary"'
        )

    def by(e):
        return replace(
            e, y=np.stack([np.asarray(e.auxiliary[f"{n}_cmd"], float) for n in names], 1)
        )

    note = "the motion is the commanded one; what the drives lag behind it is in the torque error"
    return replace(
        dataset, experiments=tuple(map(by, dataset.experiments)), notes=(*dataset.notes, note)
    )
