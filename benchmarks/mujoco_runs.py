"""Runs of robots' files by jaxid and by MuJoCo: how far they are apart within one second.

    python benchmarks/mujoco_runs.py FILE.xml ...   # adds these files, each in a process of its own

A file's run is kept in results/mujoco_runs.jsonl.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jaxid  # noqa: E402
from benchmarks.menagerie import tied  # noqa: E402
from jaxid.data.dataset import ModelSpec  # noqa: E402
from jaxid.robots.mjcf import read_mjcf  # noqa: E402
from jaxid.robots.tree import Tree  # noqa: E402


TEXT = (
    "How far runs of one second by jaxid and by MuJoCo are apart, of files that others wrote (a fork"
    " of the menagerie of 2024, and robots of Unilab). Goals swing every joint that the file has a"
    " position actuator for, by up to 0.3 rad or m; where it has none the robot falls. Both take the"
    " file's own steps, soft friction and stops, and nothing touches. Joints that the file ties to"
    " something else are held. MuJoCo has these by a large armature, and dry friction elsewhere then"
    " creeps by other amounts (shadow_hand). The file go2_arm allows MuJoCo's solver one iteration,"
    " which leaves it unsolved; with 100 of them both are 4e-16 rad apart."
)
RESULTS = Path(__file__).with_name("results") / "mujoco_runs.jsonl"
SECONDS, SAMPLE = 1.0, 0.01
#: Largest swing of a goal, largest position of a joint without a range, rad or m.
SWING, FAR = 0.3, 1.0


def recording(tree: Tree) -> jaxid.Dataset:
    """Goals that swing the joints, and readings that follow them at once."""
    ties = tied(tree)
    joints = [joint for joint in tree.leading if joint not in ties]
    place = [tree.joints.index(joint) for joint in joints]
    lower = np.clip(tree.lower[place], -FAR, FAR)
    upper = np.clip(tree.upper[place], -FAR, FAR)
    rng = np.random.default_rng(0)
    frequency, phase = rng.uniform(0.5, 2.0, len(joints)), rng.uniform(0.0, 6.0, len(joints))
    step = 0.002 if tree.simulator is None else tree.simulator.timestep
    sample = step * max(1, round(SAMPLE / step))  # a whole number of steps
    t = np.arange(round(SECONDS / sample) + 1) * sample
    begins = np.minimum(1.0, (t[:, None] / 0.2) ** 3)
    swing = np.minimum(0.25 * (upper - lower), SWING)
    goals = (lower + upper) / 2 + swing * begins * np.sin(
        2 * np.pi * frequency * t[:, None] + phase
    )
    inputs: dict[str, Any] = {}
    outputs: dict[str, Any] = {}
    units: dict[str, str] = {}
    for k, joint in enumerate(joints):
        name, unit = f"joint_{k + 1}", "m" if tree.slides[place[k]] else "rad"
        outputs[name], units[name] = goals[:, k], unit
        if _is_driven(tree, joint):
            inputs[f"{name}_cmd"], units[f"{name}_cmd"] = goals[:, k], unit
    data = jaxid.Dataset.from_arrays(t, inputs, outputs, units=units, check_model=False)
    names = {f"joint_{k + 1}": joint for k, joint in enumerate(joints)}
    stated = ModelSpec(free=not inputs, contacts=False, joints=names, simulator="mujoco")
    return replace(data, model=stated)


def _is_driven(tree: Tree, joint: str) -> bool:
    return joint in tree.actuators and tree.actuators[joint].kind == "position"


def compared(file: Path) -> dict[str, Any]:
    """How far both runs of a file are apart at most, and how far its joints move."""
    tree = read_mjcf(file)
    data = recording(tree)
    found = jaxid.replay(data, file)
    (run,) = found.runs
    columns = {name: np.asarray(values) for name, values in dict(run).items()}
    apart, moved = 0.0, 0.0
    for name, own in columns.items():
        joint = name.removesuffix("_jaxid")
        if joint != name:
            apart = max(apart, float(np.abs(own - columns[joint]).max()))
            moved = max(moved, float(np.ptp(own)))
    if not moved:
        raise SystemExit(f"{file}: {'; '.join(found.notes)}")
    steps = tree.simulator
    return {
        "robot": f"{file.parent.name}/{file.name}",
        "joints": len(data.outputs),
        "held": len(tree.leading) - len(data.outputs),
        "driven": len(data.inputs),
        "dry friction": "yes" if np.any(tree.frictionloss) else "",
        "steps": "jaxid's own"
        if steps is None
        else f"{steps.integrator.lower()} {steps.timestep:g} s",
        "moved [rad, m]": f"{moved:.2g}",
        "apart at most [rad, m]": f"{apart:.0e}",
    }


def main() -> dict[str, Any]:
    """The files that were run."""
    if not RESULTS.exists():
        raise FileNotFoundError("no file was run: python benchmarks/mujoco_runs.py FILE.xml ...")
    rows = [json.loads(line) for line in RESULTS.read_text().splitlines()]
    return {
        "title": "Robots' runs beside MuJoCo's",
        "text": TEXT,
        "rows": sorted(rows, key=lambda row: row["robot"]),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("files", type=Path, nargs="+")
    files = parser.parse_args().files
    if len(files) == 1:
        row = compared(files[0])
        with RESULTS.open("a") as store:
            store.write(json.dumps(row) + "\n")
        print(row, flush=True)
    else:  # a process each: programs of many robots would fill the memory
        for file in files:
            subprocess.run([sys.executable, __file__, str(file)], check=False)
