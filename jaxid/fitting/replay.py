"""A robot's file run in MuJoCo on a recording: the round trip of `jaxid export`, and the comparison
of two simulators.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.display import Printed
from jaxid.base.errors import UsageError
from jaxid.base.serialise import plain, SCHEMA
from jaxid.data.dataset import Dataset, Experiment
from jaxid.fitting.simulate import simulate_dataset
from jaxid.models import Robot
from jaxid.robots.drives import DriveLaw, stated_law
from jaxid.robots.export.code_beside import commanded, left_out, on_commands
from jaxid.robots.export.law_code import own_number
from jaxid.robots.export.run import read_tree
from jaxid.robots.export.save import ROWS, source_of
from jaxid.robots.export.target import EXACT, ExportRow
from jaxid.robots.free_joints import free_joints
from jaxid.robots.match import driving, named, recorded
from jaxid.robots.origin import digest
from jaxid.robots.tree import rotation, Tree
from jaxid.simulation.mujoco_run import Driven, MujocoRobot


#: Effects that every robot has by itself, whatever its file says.
LAWS = frozenset(kind.name for kind, _ in Robot.builtin)


@dataclass(frozen=True, repr=False)
class Replay(Printed):
    """`rows`: for each run and joint the rms error in MuJoCo and in the other (`other`: "jaxid", or
    "against"), the rms between both, and of a file that `jaxid export` patched the error of the
    original one in MuJoCo (`before`). `runs`: for each run `t` and the joints' positions in MuJoCo
    and (`NAME_jaxid`, `NAME_against`) the other.
    """

    dataset: str
    robot: str
    other: str
    rows: tuple[dict[str, Any], ...]
    runs: tuple[dict[str, np.ndarray], ...]
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        return plain(
            {
                "schema": SCHEMA,
                "kind": "replay",
                "dataset": self.dataset,
                "robot": self.robot,
                "per_joint": self.rows,
                "notes": self.notes,
            }
        )

    def tables(self) -> dict[str, bytes]:
        """The runs as Parquet: name -> content."""
        import pyarrow
        import pyarrow.parquet

        out = {}
        for i, run in enumerate(self.runs):
            buffer = io.BytesIO()
            pyarrow.parquet.write_table(pyarrow.table(dict(run)), buffer)
            out[f"run_{i + 1}.parquet"] = buffer.getvalue()
        return out


@dataclass(frozen=True)
class _Source:
    """What a patched file was exported from: the result's numbers, the original file, the rows that
    are not exact.
    """

    content: Mapping[str, Any]
    original: Path | None
    rows: tuple[ExportRow, ...]


def run_replay(dataset: Dataset, robot: Path, against: Path | None) -> Replay:
    """See `jaxid.replay`."""
    tree = _plain_tree(robot)
    data = driving(named(dataset, tree, dataset.stated.joints), tree)
    notes: list[str] = []
    measured = [measured_start(e, data, joints_of(data, tree)) for e in data.experiments]
    if against is None:
        other, source = "jaxid", _source(robot)
        simulated, starts = _by_jaxid(dataset, data, robot, tree, source, notes)
        starts = starts or measured
        beside = () if source is None else source.rows
        ours = in_mujoco(commanded(data, beside), robot, tree, source, starts, notes)
        notes += _of_code(beside)
    else:
        other, source, starts, beside = "against", None, measured, ()
        there = _plain_tree(against)
        if there.leading != tree.leading:
            raise UsageError(
                f"{against} has the joints {', '.join(there.leading)}, {robot} has"
                f" {', '.join(tree.leading)}"
            )
        ours = in_mujoco(data, robot, tree, None, starts, notes)
        simulated = in_mujoco(data, against, there, None, starts, notes)
    before = _before(data, source, starts)
    rows, runs = _compared(data, tree, ours, simulated, other, before)
    if not left_out(beside):
        notes += _worse(rows)
    notes += _verdict(rows, source, other)
    return Replay(
        dataset.name, str(robot), other, tuple(rows), tuple(runs), tuple(dict.fromkeys(notes))
    )


def _plain_tree(path: Path) -> Tree:
    """The tree of a robot's file. Raises `UsageError` where there is none."""
    if not path.is_file():
        raise UsageError(f"{path}: no such file, or none that is plain")
    return read_tree(path)


def joints_of(data: Dataset, tree: Tree) -> tuple[str, ...]:
    """Joints that are measured."""
    return recorded(tree, data)[0].leading


def _source(robot: Path) -> _Source | None:
    """What `jaxid export` wrote beside a file of its own that was not edited since."""
    import json

    from jaxid.base.small_files import read_small

    content = source_of(robot.parent)
    if content.get("files", {}).get(robot.name) != digest(str(robot)):
        return None
    original = Path(str(content.get("robot", {}).get("file", "")))
    known = original.is_file() and digest(str(original)) == content["robot"].get("sha256")
    try:
        rows = json.loads(read_small(robot.parent / ROWS))
    except (OSError, ValueError):
        rows = []
    told = tuple(ExportRow.of(r) for r in rows if isinstance(r, Mapping))
    return _Source(content, original if known else None, told)


def _of_code(rows: Sequence[ExportRow]) -> list[str]:
    """What of effects.py is in a run of the patched file, and what is not."""
    notes = []
    if on_commands(rows):
        notes.append(f"its goals pass through {on_commands(rows)}, as effects.py has it")
    if left_out(rows):
        notes.append(f"without {left_out(rows)}, which effects.py adds")
    return notes


def _by_jaxid(
    raw: Dataset, data: Dataset, robot: Path, tree: Tree, source: _Source | None, notes: list[str]
) -> tuple[Any, Any]:
    """(positions by run, starts) of jaxid's free run; (None, None) where it has none, with a note
    that says why. `raw` is the dataset as it came, `data` the same under the joints' names.
    """
    from jaxid.models import Robot

    result = source.content.get("result", {}) if source is not None else {}
    fitted = result.get("kind") in ("fit", "diagnosis")
    if fitted and result.get("model") not in (None, "robot"):
        return _by_its_model(raw, result, robot, notes)
    joints = joints_of(data, tree)
    if source is not None and source.original is not None and fitted:
        model = Robot(read_tree(source.original))
        content = _content(source, data, joints)
        notes.append(f"jaxid's run is of the result that {robot.name} was exported from")
    else:
        model, content = Robot(tree), None
        notes.append(f"jaxid's run is of {robot.name} as it stands")
        if _own_actuators(tree, joints):
            data = replace(data, controller=None)
    spec = replace(data.stated, name=None, geometry=None, parameters={}, joints={})
    data = replace(data, model=spec)
    return _simulated(content, data, model, joints_of(data, tree), notes)


def _simulated(
    content: Any, data: Dataset, model: Any, joints: Sequence[str], notes: list[str]
) -> tuple[Any, Any]:
    """(positions [samples joints] by run, starts), or (None, None) and a note that says why."""
    try:
        simulation = simulate_dataset(content, data, model)
    except UsageError as error:
        notes.append(f"jaxid has no run of its own: {error}")
        return None, None
    positions = []
    for run in simulation.runs:
        positions.append(np.stack([run[j] for j in joints if j in run], 1))
    return positions, [np.asarray(s) for s in simulation.starts]


def _by_its_model(
    dataset: Dataset, result: Mapping[str, Any], robot: Path, notes: list[str]
) -> tuple[Any, Any]:
    """The same of a result whose model is no robot's, on the channels that it has."""
    content = {
        "parameters": result.get("parameters", {}),
        "effects": list(result.get("effects", ())),
    }
    joints = dataset.output_names
    found = _simulated(content, dataset, result["model"], joints, notes)
    if found[0] is not None:
        notes.append(f"jaxid's run is of the {result['model']} that {robot.name} was exported from")
    return found


def _content(source: _Source, data: Dataset, joints: tuple[str, ...]) -> dict[str, Any]:
    """The result's numbers for a model with all of its own laws: those that it did without are
    0.
    """
    result, robot = source.content["result"], source.content.get("robot", {})
    kept = data.stated.without
    gone = LAWS.difference(kept)
    effects = [e for e in result.get("effects", ()) if e.get("effect") not in gone]
    without = [own_number(n) for n in robot.get("without", ()) if n not in kept]
    fitted = [own.fitted for own in without if own is not None]
    zero = {f"{name}@{joint}": {"value": 0.0} for name, joint in product(fitted, joints)}
    return {"parameters": {**zero, **result.get("parameters", {})}, "effects": effects}


def _own_actuators(tree: Tree, joints: Sequence[str]) -> bool:
    return all(j in tree.actuators and tree.actuators[j].kind == "position" for j in joints)


def measured_start(e: Experiment, data: Dataset, joints: tuple[str, ...]) -> np.ndarray:
    """The stated start, else positions of the first sample and speeds there by a parabola through
    the first samples, 0 where the run begins at rest.
    """
    outputs = data.output_names
    y = e.y[:, [outputs.index(j) for j in joints]]
    n = min(len(e.t), 5)
    speed = np.zeros(len(joints))
    if n > 1 and not e.at_rest:
        powers = np.vander(e.t[:n] - e.t[0], 3 if n > 3 else 2, increasing=True)
        speed = np.linalg.pinv(powers)[1] @ y[:n]
    start = dict(zip(joints, y[0], strict=True))
    start |= {f"{joint}_qd": v for joint, v in zip(joints, speed, strict=True)}
    known = e.initial or {}
    return np.array([known.get(name, value) for name, value in start.items()], float)


def in_mujoco(
    data: Dataset,
    path: Path,
    tree: Tree,
    source: _Source | None,
    starts: list[np.ndarray],
    notes: list[str],
) -> list[np.ndarray]:
    """Positions of the measured joints at the samples of every run."""
    free, held_notes = recorded(tree, data)
    notes += held_notes
    joints = free.leading
    inputs = data.input_names
    kind = _driven_by(data, joints, path)
    law = None
    still = free_joints(tree, data)
    driven = [joint for joint in joints if joint not in still]
    if kind == "goal" and not _own_actuators(tree, driven):
        law = _law(data, joints, source, path)
        notes.append(
            f"{path.name} has no position actuators for these joints: the law of [controller]"
            " drives"
        )
    elif kind == "goal":
        notes.append(f"driven by the position actuators of {path.name}")
    touches = data.model is not None and data.model.contacts is True
    gravity = _gravity(tree, data)
    robot = MujocoRobot(path, tree, free.held, gravity, joints, law, contacts=touches)
    reference = robot
    torques = all(f"{j}_tau" in inputs for j in joints)
    if source and source.original and torques:
        reference = MujocoRobot(source.original, read_tree(source.original), {}, None)
    drive = Driven("law" if law is not None else kind, law, reference)
    ends = {"goal": "_cmd", "torque": "_tau"}
    column = [inputs.index(f"{j}{ends[kind]}") for j in joints if kind in ends]
    linear = [data.inputs[c].hold == "linear" for c in column]
    n = len(joints)
    out = []
    for e, start in zip(data.experiments, starts, strict=True):
        q, qd = start[:n], start[n : 2 * n]
        out.append(robot.run(joints, e.t, e.u[:, column], linear, drive, q, qd))
    notes += robot.notes
    return out


def _driven_by(data: Dataset, joints: Sequence[str], path: Path) -> str:
    """What of the recording drives the joints: "goal", "torque", or "free" for nothing."""
    inputs = data.input_names
    if all(f"{j}_cmd" in inputs for j in joints):
        return "goal"
    if all(f"{j}_tau" in inputs for j in joints):
        return "torque"
    if inputs and not data.stated.free:
        raise UsageError(
            f"nothing that was recorded drives {path.name}: of its joints add goals"
            f" ({joints[0]}_cmd) or torques ({joints[0]}_tau) as inputs (the recording has"
            f" {', '.join(inputs)}), or say free = true"
        )
    return "free"


def _gravity(tree: Tree, data: Dataset) -> np.ndarray:
    """Gravity in the frame of the base as the dataset has it stand."""
    base, own = data.stated.base, data.stated.constants
    roll, pitch, yaw = (
        float(own.get(f"base_{k}", base.get(k) or 0.0)) for k in ("roll", "pitch", "yaw")
    )
    return rotation(roll, pitch, yaw).T @ np.array(tree.gravity)


def _law(data: Dataset, joints: tuple[str, ...], source: _Source | None, path: Path) -> DriveLaw:
    """The law of [controller], with the numbers that the result found."""
    if data.controller is None:
        raise UsageError(
            f"{path} has no position actuator for every recorded joint, and the dataset states no"
            " law: add [controller] (kind, kp, kd)"
        )
    law = stated_law(data.controller, joints, float(np.median(np.diff(data.experiments[0].t))))
    found = source.content.get("result", {}).get("parameters", {}) if source is not None else {}
    for name in ("kp", "kd", "ki", "highest", "lowest", "delay"):
        values = list(getattr(law, name))
        for k, joint in enumerate(joints):
            value = found.get(f"{name}@{joint}", {}).get("value")
            if value is not None:
                values[k] = float(value)
        law = replace(law, **{name: tuple(values)})
    return law


def _before(
    data: Dataset, source: _Source | None, starts: list[np.ndarray]
) -> list[np.ndarray] | None:
    """Positions by run of the file that was patched, where it is still there."""
    if source is None or source.original is None:
        return None
    try:
        return in_mujoco(data, source.original, read_tree(source.original), None, starts, [])
    except UsageError:  # no law drives the original
        return None


def _worse(rows: list[dict[str, Any]]) -> list[str]:
    """Joints at which the patched file is further from the recording than the original."""
    out = []
    for joint in dict.fromkeys(r["joint"] for r in rows):
        own = [r for r in rows if r["joint"] == joint and r.get("before") is not None]
        now, was = sum(r["mujoco"] ** 2 for r in own), sum(r["before"] ** 2 for r in own)
        if now > was:
            out.append(
                f"{joint}: in MuJoCo the patched file is further from the recording than the"
                " original: do not take it over"
            )
    return out


def _compared(
    data: Dataset, tree: Tree, ours: list, other: list | None, name: str, before: list | None = None
) -> tuple[list[dict[str, Any]], list[dict]]:
    joints, outputs = joints_of(data, tree), data.output_names
    rows, runs = [], []
    for i, e in enumerate(data.experiments):
        run: dict[str, np.ndarray] = {"t": e.t}
        for k, joint in enumerate(joints):
            c = outputs.index(joint)
            measured = e.y[:, c]
            read = e.read[:, c] & np.isfinite(measured)
            mine = ours[i][:, k]
            run[joint] = mine
            row: dict[str, Any] = {"experiment": e.name, "joint": joint}
            if before is not None:
                row["before"] = _rms((before[i][:, k] - measured)[read])
            row |= {"mujoco": _rms((mine - measured)[read]), name: None, "difference": None}
            if other is not None:
                theirs = other[i][:, k]
                run[f"{joint}_{name}"] = theirs
                row[name] = _rms((theirs - measured)[read])
                row["difference"] = _rms(mine - theirs)
            rows.append(row | {"unit": data.outputs[c].unit})
        runs.append(run)
    return rows, runs


def _rms(x: np.ndarray) -> float:
    """Root mean square; not a number where there is nothing."""
    return float(np.sqrt(np.mean(x**2))) if len(x) else float("nan")


def _verdict(rows: list[dict[str, Any]], source: _Source | None, other: str) -> list[str]:
    """Joints at which the simulators differ by more than the other is off, and what could not be
    carried over there.
    """
    out = []
    them = "the other file" if other == "against" else "jaxid"
    for joint in dict.fromkeys(r["joint"] for r in rows):
        own = [r for r in rows if r["joint"] == joint and r["difference"] is not None]
        worst = max(own, key=lambda r: r["difference"] / max(r[other], 1e-300), default=None)
        if worst is None or not worst["difference"] > worst[other]:
            continue
        text = (
            f"{joint}: MuJoCo and {them} differ by {worst['difference']:.3g} {worst['unit']}, more"
            f" than {them}'s run differs from the recording ({worst[other]:.3g})"
        )
        lacking = _lacking(source, joint)
        if lacking:
            text += f"; not carried over exactly there: {', '.join(lacking)}"
        out.append(text)
    return out


def _lacking(source: _Source | None, joint: str) -> list[str]:
    """The effects of a joint that an export did not carry over exactly, each once."""
    lacking = {}
    for row in source.rows if source else ():
        of_joint = row.location.split("_cmd")[0].split("_tau")[0]
        if row.how != EXACT and of_joint == joint:
            lacking[f"{row.effect} ({row.how})"] = None
    return list(lacking)
