"""Robots from URDF files: every branch, with mimic joints, limits and dissipation. Frames and axes
are those of the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxid.errors import UsageError
from jaxid.robots.bodies import fault
from jaxid.robots.tree import Coupling, Tree, turned
from jaxid.robots.urdf import MOVING, read_links


def read_urdf_tree(path: str | Path, text: str | None = None) -> Tree:
    """The tree of a URDF; with `text` that is read, and the path only names it. Bodies behind fixed
    joints belong to what carries them. An inertia that no body can have is named in `impossible`
    and kept. Raises `UsageError` naming the joint or link.
    """
    path = Path(path)
    robot, base = read_links(path, text)
    nodes: list[tuple[Any, int, np.ndarray]] = []  # joint, parent node, its frame there
    bodies: list[np.ndarray] = []
    trunk = np.zeros(10)

    def visit(link: str, node: int, T: np.ndarray, depth: int = 0) -> None:
        if depth > 500:
            raise UsageError(f"{path}: more than 500 links deep")
        if node >= 0:
            bodies[node] = bodies[node] + turned(robot.inertia[link], T)
        else:
            trunk[:] += turned(robot.inertia[link], T)
        for joint in robot.children(link):
            here = T @ joint.T
            if joint.kind not in MOVING:
                visit(joint.child, node, here, depth + 1)
                continue
            nodes.append((joint, node, here))
            bodies.append(np.zeros(10))
            visit(joint.child, len(nodes) - 1, np.eye(4), depth + 1)

    visit(base, -1, np.eye(4))
    if not nodes:
        raise UsageError(f"{path}: no joint of it moves")
    joints = [joint for joint, _, _ in nodes]
    limits = np.array([j.limits for j in joints]).T
    dissipation = np.array([j.dynamics for j in joints])
    parent = tuple(up for _, up, _ in nodes)
    couplings = _couplings(path, joints)
    massless = _massless(joints, parent, bodies, couplings)
    if len(massless) == len(joints):
        raise UsageError(
            f"{path}: nothing of mass hangs on joint {massless[0].name!r}; give link"
            f" {massless[0].child!r} an <inertial>"
        )
    damping = np.zeros((len(joints), 3))
    damping[:, 0] = dissipation[:, 0]
    zero = np.zeros(len(joints))
    tree = Tree(
        file=str(path),
        joints=tuple(j.name for j in joints),
        links=tuple(j.child for j in joints),
        parent=parent,
        slides=tuple(j.kind == "prismatic" for j in joints),
        axis=np.array([j.axis for j in joints]),
        place=np.array([T for _, _, T in nodes]),
        reference=zero,
        inertia=np.array(bodies),
        anchor=np.zeros((len(joints), 3)),
        armature=zero,
        damping=damping,
        frictionloss=dissipation[:, 1].copy(),
        stiffness=zero,
        spring=zero,
        lower=limits[0],
        upper=limits[1],
        velocity=limits[2],
        effort=limits[3],
        couplings=couplings,
        base=base,
        trunk=tuple(trunk.tolist()),
        carrier=base,
        impossible=tuple(
            (name, f) for name, phi in robot.inertia.items() if (f := fault(name, phi))
        ),
        notes=tuple(
            f"joint {j.name}: by the file nothing of mass hangs on it (link {j.child} has no"
            " <inertial>), held at 0"
            for j in massless
        ),
    )
    return tree.locked({j.name: 0.0 for j in massless})


def _massless(
    joints: list[Any],
    parent: tuple[int, ...],
    bodies: list[np.ndarray],
    couplings: tuple[Coupling, ...],
) -> list[Any]:
    """Joints that move nothing of mass, neither by themselves nor by what follows them or what they
    follow (fingers without <inertial>, wheels for show).
    """
    alone = set()
    for k, joint in enumerate(joints):
        behind = [body for i, body in enumerate(bodies) if _behind(i, k, parent)]
        if not sum(body[9] for body in behind) > 0:
            alone.add(joint.name)
    heavy: set[str] = set()
    for c in couplings:
        if not {c.follower, c.leader} <= alone:
            heavy |= {c.follower, c.leader}
    return [j for j in joints if j.name in alone - heavy]


def _behind(node: int, joint: int, parent: tuple[int, ...]) -> bool:
    while node > joint:
        node = parent[node]
    return node == joint


def _couplings(path: Path, joints: list[Any]) -> tuple[Coupling, ...]:
    out = [Coupling(j.name, *j.mimic) for j in joints if j.mimic is not None]
    names, followers = {j.name for j in joints}, {c.follower for c in out}
    for c in out:
        if c.leader not in names:
            raise UsageError(
                f"{path}: joint {c.follower!r} mimics {c.leader!r}, which does not move"
            )
        if c.leader in followers:
            raise UsageError(
                f"{path}: joint {c.follower!r} mimics {c.leader!r}, which mimics another; name the"
                " last one in each"
            )
    return tuple(out)
