"""The robots of the MuJoCo menagerie: which jaxid takes, what it holds, what it refuses and why, and
how near its dynamics are to MuJoCo's.

    python benchmarks/menagerie.py FOLDER

FOLDER is a checkout of the menagerie; without one, $JAXID_MENAGERIE names it. Scenes around a robot
and parts that MuJoCo does not take by themselves are told apart from robots. Of each robot that is taken, the
forces that random motions need are compared with those of MuJoCo's own reading of the file, by the
largest difference over the largest force. Writes docs/menagerie.md.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jax  # noqa: E402
import numpy as np  # noqa: E402

from jaxid import UsageError  # noqa: E402
from jaxid.models import Robot  # noqa: E402
from jaxid.numerics.precision import float64  # noqa: E402
from jaxid.robots.mjcf import read_mjcf  # noqa: E402
from jaxid.robots.mjcf_spec import library  # noqa: E402
from jaxid.robots.tree import Tree  # noqa: E402


PAGE = Path(__file__).resolve().parents[1] / "docs" / "menagerie.md"
#: Random motions for each robot, after as many poses at rest.
MOTIONS = 20
#: Largest positions (rad, m) of joints without a range, speeds and accelerations.
FAR, FAST, HARD = 1.5, 2.0, 5.0
#: Stands for a mesh whose file the checkout lacks; it gives no inertia where jaxid takes the robot.
CORNERS = [0, 0, 0, 0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1]
FACES = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]
HEAD = """# Robots of the MuJoCo menagerie

Written by `python benchmarks/menagerie.py FOLDER`; do not edit. Made on {commit}.

{summary}

- *joints*: hinges and slides that a recording may show, those that follow others among them.
- *followers*: joints that the file couples to another one. Where such a joint is recorded it leads.
- *held*: joints that must not move in a recording, and why. All others may.
- *difference*: the largest difference of a force from MuJoCo's over the largest force, of {count}
  random poses and motions. The forces hold inertia, weight, springs and `gravcomp`, no friction.

## Robots

{robots}

## Parts of robots

Files that MuJoCo does not take by themselves: other files include them.

{parts}
"""


@dataclass(frozen=True)
class Tried:
    """One file of the menagerie: the tree that it gives, or why it gives none."""

    name: str
    tree: Tree | None
    refused: str
    difference: float


def main(folder: Path | None = None) -> dict[str, Any]:
    """The summary of all files; writes the page with each of them."""
    folder = folder or Path(os.environ.get("JAXID_MENAGERIE", "menagerie"))
    files = sorted(folder.glob("*/*.xml"))
    if not files:
        raise FileNotFoundError(f"{folder} is no checkout of the menagerie: set JAXID_MENAGERIE")
    alone = [tried(file, folder, compare=True) for file in files if "scene" not in file.name]
    parts = [one for one in alone if is_part(one)]
    robots = [one for one in alone if not is_part(one)]
    scenes = [tried(file, folder, compare=False) for file in files if "scene" in file.name]
    rows = summary(robots, parts, scenes)
    commit = commit_of(folder)
    PAGE.write_text(page(robots, parts, rows, commit), encoding="utf-8")
    return {
        "title": "Robots of the MuJoCo menagerie",
        "text": f"What is taken of each file stands in docs/menagerie.md. Made on {commit}.",
        "rows": rows,
    }


def is_part(one: Tried) -> bool:
    """Whether a file is no robot by itself: it holds no body, or MuJoCo does not take it alone."""
    return any(words in one.refused for words in ("holds no <body>", "MuJoCo does not take it"))


def tried(file: Path, folder: Path, compare: bool) -> Tried:
    """What jaxid makes of one file."""
    name = file.relative_to(folder).as_posix()
    print(name, flush=True)
    try:
        tree = read_mjcf(file)
    except UsageError as error:
        said = str(error).replace(f"{folder.as_posix()}/", "")
        return Tried(name, None, said.removeprefix(f"{name}: "), np.nan)
    return Tried(name, tree, "", difference(file, tree) if compare else np.nan)


def difference(file: Path, tree: Tree) -> float:
    """The largest difference of a force from MuJoCo's, over the largest force."""
    robot = Robot(tree, driven=False)
    motions = drawn(tree)
    theirs = forces_of_mujoco(file, tree, motions)
    forces = jax.jit(
        jax.vmap(lambda q, qd, qdd: robot.inverse(q, qd, qdd)),
        compiler_options={"xla_backend_optimization_level": 0},
    )
    with float64():
        own = np.asarray(forces(*motions))
    return float(np.abs(own - theirs).max() / np.abs(theirs).max())


def drawn(tree: Tree) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, speeds and accelerations of the leading joints [motions n]: first at rest."""
    rng = np.random.default_rng(0)
    own = [tree.joints.index(joint) for joint in tree.leading]
    lower = np.clip(tree.lower[own], -FAR, None)
    upper = np.clip(tree.upper[own], None, FAR)
    size = 2 * MOTIONS, len(own)
    moves = np.repeat([[0.0], [1.0]], MOTIONS, axis=0)
    q = rng.uniform(np.minimum(lower, upper), np.maximum(lower, upper), size)
    return q, moves * rng.uniform(-FAST, FAST, size), moves * rng.uniform(-HARD, HARD, size)


def forces_of_mujoco(
    file: Path, tree: Tree, motions: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> np.ndarray:
    """Forces [motions n] at the leading joints that the motions need in MuJoCo's own reading."""
    mujoco, model = library(), model_of(file)
    data = mujoco.MjData(model)

    def name(j):
        return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j) or f"joint{j}"

    number = {name(j): j for j in range(model.njnt)}
    own = [number[joint] for joint in tree.joints]
    at, dof = model.jnt_qposadr[own], model.jnt_dofadr[own]
    S, shift = tree.follow()
    needed, out = np.zeros(model.nv), []
    for q, qd, qdd in zip(*motions, strict=True):
        data.qpos[:], data.qvel[:], acceleration = model.qpos0, 0.0, np.zeros(model.nv)
        for joint, value in tree.held.items():
            data.qpos[model.jnt_qposadr[number[joint]]] = value
        data.qpos[at], data.qvel[dof] = S @ q + shift, S @ qd
        acceleration[dof] = S @ qdd
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_mulM(model, data, needed, acceleration)
        force = needed + data.qfrc_bias - data.qfrc_spring - data.qfrc_gravcomp
        out.append(S.T @ force[dof])
    return np.array(out)


def model_of(file: Path) -> Any:
    """A file as MuJoCo compiles it; tendons neither pull nor weigh."""
    spec = library().MjSpec.from_file(str(file))
    for mesh in spec.meshes:
        place = file.parent / spec.meshdir / mesh.file
        if mesh.file and not place.is_file():
            mesh.name = mesh.name or Path(mesh.file).stem
            mesh.file, mesh.uservert, mesh.userface = "", CORNERS, FACES
    model = spec.compile()
    model.tendon_stiffness[:] = 0.0
    model.tendon_armature[:] = 0.0
    return model


# ---- words


def summary(
    robots: Sequence[Tried], parts: Sequence[Tried], scenes: Sequence[Tried]
) -> list[dict[str, Any]]:
    """Rows of (what, number)."""
    trees = [one.tree for one in robots if one.tree is not None]
    why = Counter(reason(one.refused) for one in robots if one.tree is None)
    folders = {one.name.split("/")[0] for one in robots}
    folders_taken = {one.name.split("/")[0] for one in robots if one.tree is not None}
    rows = [
        ("robots (folders), taken / all", f"{len(folders_taken)} / {len(folders)}"),
        ("robots' files, taken / all", f"{len(trees)} / {len(robots)}"),
        *((f"refused: {text}", str(count)) for text, count in why.most_common()),
        ("scenes, taken / all", f"{_taken(scenes)} / {len(scenes)}"),
        ("parts of robots, refused", str(len(parts))),
        ("joints of the robots that are taken", str(sum(tree.n for tree in trees))),
        ("of them followers", str(sum(len(tree.couplings) for tree in trees))),
        ("of them held", str(sum(len(tied(tree)) for tree in trees))),
        (
            "largest difference of a force",
            f"{max(one.difference for one in robots if one.tree):.1g}",
        ),
    ]
    return [{"what": what, "number": number} for what, number in rows]


def _taken(files: Sequence[Tried]) -> int:
    return sum(one.tree is not None for one in files)


def reason(refused: str) -> str:
    """The kind of a refusal."""
    kinds = {
        "is not there": "a mesh that gives an inertia is not in the checkout",
        "moves freely": "only a free joint or balls",
        "no joint": "no joint at all",
        "another model": "another model is attached",
    }
    return next((text for words, text in kinds.items() if words in refused), refused)


def tied(tree: Tree) -> dict[str, str]:
    """Joints that must be held, and what acts on them."""
    out: dict[str, str] = {}
    for tie in tree.ties:
        for joint in tie.joints:
            out.setdefault(joint, kind_of_tie(tie.what))
    return out


def kind_of_tie(what: str) -> str:
    """A tie without the names in it."""
    if what.startswith("tendon"):
        return "tendons"
    if "closes a loop" in what:
        return "loops"
    if what.startswith("ball joint"):
        return "a ball joint before them"
    return "curved or double couplings"


def row_of(one: Tried) -> Mapping[str, str]:
    """One robot's row of the page."""
    tree = one.tree
    if tree is None:
        return {"file": f"`{one.name}`", "taken": f"no: {short(one.refused)}"}
    counts = Counter(tied(tree).values())
    balls = sum("is a ball joint" in note for note in tree.notes)
    held = [f"{count} by {kind}" for kind, count in counts.items()]
    if balls:
        held.append(f"{balls} ball joints")
    if tree.held:
        held.append(f"{len(tree.held)} by the file")
    remarks = []
    if any("is free" in note for note in tree.notes):
        remarks.append("free base")
    if tree.lifted is not None:
        remarks.append("gravcomp")
    return {
        "file": f"`{one.name}`",
        "taken": ", ".join(["yes", *remarks]),
        "joints": str(tree.n),
        "followers": str(len(tree.couplings) or ""),
        "held": ", ".join(held),
        "difference": f"{one.difference:.0e}",
    }


def short(text: str, most: int = 250) -> str:
    """The first sentence of a refusal."""
    text = text.split("; or add")[0].split(": add <")[0].replace("<body>", "`<body>`")
    return text if len(text) <= most else text[:most].rsplit(" ", 1)[0] + " …"


def table(rows: Sequence[Mapping[str, str]]) -> str:
    """Markdown of rows that have the columns of the longest one."""
    if not rows:
        return "None."
    columns = list(max(rows, key=len))
    lines = [f"| {' | '.join(columns)} |", "|" + " --- |" * len(columns)]
    for row in rows:
        cells = [row.get(column, "").replace("|", "\\|") for column in columns]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def page(
    robots: Sequence[Tried],
    parts: Sequence[Tried],
    rows: Sequence[Mapping[str, str]],
    commit: str,
) -> str:
    """The page of the documentation."""
    said = [
        {"file": f"`{one.name}`", "what is said": short(one.refused) or "taken"} for one in parts
    ]
    return HEAD.format(
        commit=commit,
        count=2 * MOTIONS,
        summary=table(rows),
        robots=table([row_of(one) for one in robots]),
        parts=table(said),
    )


def commit_of(folder: Path) -> str:
    """The commit of a checkout."""
    command = ["git", "-C", str(folder), "rev-parse", "HEAD"]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    return f"commit {found.stdout.strip()[:12]}" if found.returncode == 0 else "a copy without git"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    for entry in main(parser.parse_args().folder)["rows"]:
        print(f"{entry['what']}: {entry['number']}")
