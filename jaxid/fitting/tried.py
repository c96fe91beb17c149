"""A patched robot's file tried in MuJoCo on the recording that a result is of, before it is
written.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from jaxid.base.errors import DatasetError, UsageError
from jaxid.data.dataset import Dataset, Experiment
from jaxid.data.io import load_dataset
from jaxid.fitting.replay import in_mujoco, joints_of, measured_start
from jaxid.robots.export.code_beside import commanded
from jaxid.robots.export.run import read_tree
from jaxid.robots.export.target import ExportRow
from jaxid.robots.match import driving, named


#: This many seconds of a recording are run for one trial.
LONGEST = 120.0


class OnRecording:
    """Called with the files of a patch: how far the patched robot's free run in MuJoCo is from a
    recording, rms by joint in its unit; None where there is no such run.
    """

    def __init__(self, dataset: Dataset):
        self.dataset = shortened(dataset)

    def __call__(
        self, files: Mapping[str, str], name: str, rows: Sequence[ExportRow]
    ) -> Mapping[str, float] | None:
        with tempfile.TemporaryDirectory() as folder:
            for file, text in files.items():
                path = Path(folder) / PurePosixPath(file)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
            try:
                return self._off(Path(folder) / name, commanded(self.dataset, rows))
            except UsageError:
                return None

    def _off(self, path: Path, dataset: Dataset) -> Mapping[str, float] | None:
        tree = read_tree(path)
        data = driving(named(dataset, tree, dataset.stated.joints), tree)
        joints = joints_of(data, tree)
        starts = [measured_start(e, data, joints) for e in data.experiments]
        runs = in_mujoco(data, path, tree, None, starts, [])
        outputs = data.output_names
        off: dict[str, float] = {}
        for k, joint in enumerate(joints):
            c = outputs.index(joint)
            left = [run[:, k] - e.y[:, c] for run, e in zip(runs, data.experiments, strict=True)]
            read = [e.read[:, c] & np.isfinite(e.y[:, c]) for e in data.experiments]
            every = np.concatenate([x[at] for x, at in zip(left, read, strict=True)])
            off[joint] = float(np.sqrt(np.mean(every**2))) if len(every) else float("nan")
        return off if np.isfinite(list(off.values())).all() else None


def shortened(dataset: Dataset) -> Dataset:
    """The first runs of a dataset, as many seconds as a trial takes."""
    kept: list[Experiment] = []
    room = LONGEST
    for e in dataset.experiments:
        count = int(np.searchsorted(e.t - e.t[0], room, side="right"))
        if count < 2:
            break
        kept.append(e if count >= len(e.t) else e.piece(0, count, name=e.name, split=e.split))
        room -= e.duration
    return replace(dataset, experiments=tuple(kept))


def recording_of(
    content: Mapping[str, Any], beside: Path | None, stated: str | Path | None = None
) -> OnRecording | None:
    """The recording that a result is of: in the `stated` folder, else that of the same content in
    the folder of the robot's file or near the result's. None where there is none, or where the
    result is of one that was mended before it was used.

    Raises `DatasetError` for a stated folder that holds no dataset.
    """
    if stated is not None:
        return OnRecording(load_dataset(stated))
    found = content.get("data")
    findings = found if isinstance(found, list) else []
    if any(isinstance(f, Mapping) and f.get("applied") for f in findings):
        return None
    robot = content.get("robot")
    file = robot.get("file") if isinstance(robot, Mapping) else None
    places = [Path(str(file)).parent] if file else []
    places += [beside, beside.parent] if beside is not None else []
    for folder in places:
        dataset = _same(folder, content.get("dataset_sha256"))
        if dataset is not None:
            return OnRecording(dataset)
    return None


def _same(folder: Path, sha256: object) -> Dataset | None:
    """The dataset in a folder, None where there is none of this content."""
    if not sha256 or not (folder / "dataset.toml").is_file():
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            dataset = load_dataset(folder)
    except (DatasetError, UsageError):
        return None
    return dataset if dataset.sha256 == sha256 and dataset.experiments else None
