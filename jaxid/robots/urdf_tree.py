"""Robots from URDF files: the whole tree, with mimic joints, limits and dissipation, or one chain
of it as a serial arm. Frames and axes are those of the file.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxid.base.errors import DatasetWarning, UsageError
from jaxid.base.wording import names_of
from jaxid.dynamics.kinematics import ArmTable
from jaxid.robots.bodies import fault, negative
from jaxid.robots.chain_table import table_of
from jaxid.robots.tree import Coupling, Tree, turned
from jaxid.robots.urdf import MOVING, read_links, read_robot, root_of, tip_of, UrdfJoint, UrdfRobot


class _Walk(NamedTuple):
    """What hangs on a link: the joints that move, the tree, and where each link is: (node or -1,
    its frame there [4 4]).
    """

    joints: list[UrdfJoint]
    tree: Tree
    places: Mapping[str, tuple[int, np.ndarray]]

    def behind(self, node: int) -> list[str]:
        """The links that a joint moves."""
        return [link for link, (k, _) in self.places.items() if _behind(k, node, self.tree.parent)]

    def moving_to(self, link: str) -> list[int]:
        """The nodes between the root and a link."""
        path, k = [], self.places[link][0]
        while k >= 0:
            path.append(k)
            k = self.tree.parent[k]
        return path[::-1]


def read_urdf_tree(path: str | Path, text: str | None = None) -> Tree:
    """The tree of a URDF; with `text` that is read, and the path only names it. Bodies behind fixed
    joints belong to what carries them. An inertia that no body can have is named in `impossible`
    and kept. Raises `UsageError` naming the joint or link.
    """
    path = Path(path)
    robot, root = read_links(path, text)
    walk = _walked(path, robot, root)
    joints, tree = walk.joints, walk.tree
    if not joints:
        raise UsageError(f"{path}: no joint of it moves")
    couplings = _couplings(path, joints)
    massless = _massless(joints, tree.parent, list(tree.inertia), couplings)
    if len(massless) == len(joints):
        raise UsageError(
            f"{path}: nothing of mass hangs on joint {massless[0].name!r}; give link"
            f" {massless[0].child!r} an <inertial>"
        )
    notes = tuple(
        f"joint {j.name}: by the file nothing of mass hangs on it (link {j.child} has no"
        " <inertial>), held at 0"
        for j in massless
    )
    tree = replace(tree, couplings=couplings, notes=notes)
    return tree.locked({j.name: 0.0 for j in massless})


def read_urdf(
    path: str | Path, tip: str | None = None, root: str | None = None, text: str | None = None
) -> ArmTable:
    """The chain from `root` (default: the link without a parent) to `tip` (default: the end of the
    only branch that moves).

    With `text` that is read, and the path only named in messages. Moving joints off the chain are
    locked at zero, their links added to the chain's. Raises `UsageError` for what is not a chain of
    such joints, naming the joint or link.
    """
    path = Path(path)
    robot = read_robot(path, text)
    root = root_of(robot, root, path)
    tip = tip_of(robot, root, tip, path)
    walk = _walked(path, robot, root)
    if tip not in walk.places:
        raise UsageError(f"{path}: link {tip!r} does not hang on {root!r}")
    chain = walk.moving_to(tip)
    if not chain:
        raise UsageError(f"{path}: no joint moves between {root!r} and {tip!r}")
    _tell_of_faults(path, robot, walk.behind(chain[0]))
    for node in chain:
        if walk.joints[node].mimic is not None:
            raise UsageError(
                f"{path}: joint {walk.joints[node].name!r} mimics another; jaxid takes chains of"
                " independent joints"
            )
    off_chain = [j.name for k, j in enumerate(walk.joints) if k not in chain]
    table = table_of(walk.tree.locked({name: 0.0 for name in off_chain}))
    _, frame = walk.places[tip]
    return replace(table, tool=table.tool @ frame)


def _walked(path: Path, robot: UrdfRobot, root: str) -> _Walk:
    """All that hangs on a link, in the order of a walk out along each branch."""
    nodes: list[tuple[UrdfJoint, int, np.ndarray]] = []  # joint, parent node, its frame there
    bodies: list[np.ndarray] = []
    places: dict[str, tuple[int, np.ndarray]] = {}
    trunk = np.zeros(10)

    def visit(link: str, node: int, T: np.ndarray, depth: int = 0) -> None:
        if depth > 500:
            raise UsageError(f"{path}: more than 500 links deep")
        places[link] = node, T
        total = bodies[node] if node >= 0 else trunk
        total += turned(robot.inertia[link], T)
        for joint in robot.children(link):
            here = T @ joint.T
            if joint.kind not in MOVING:
                visit(joint.child, node, here, depth + 1)
                continue
            nodes.append((joint, node, here))
            bodies.append(np.zeros(10))
            visit(joint.child, len(nodes) - 1, np.eye(4), depth + 1)

    visit(root, -1, np.eye(4))
    joints = [joint for joint, _, _ in nodes]
    limits = np.array([j.limits for j in joints]).reshape(-1, 4)
    dissipation = np.array([j.dynamics for j in joints]).reshape(-1, 2)
    damping = np.zeros((len(joints), 3))
    damping[:, 0] = dissipation[:, 0]
    zero = np.zeros(len(joints))
    faults = {name: fault(name, phi) for name, phi in robot.inertia.items()}
    tree = Tree(
        file=str(path),
        joints=tuple(names_of(joints)),
        links=tuple(j.child for j in joints),
        parent=tuple(up for _, up, _ in nodes),
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
        lower=limits[:, 0],
        upper=limits[:, 1],
        velocity=limits[:, 2],
        effort=limits[:, 3],
        base=root,
        trunk=tuple(trunk.tolist()),
        carrier=root,
        impossible=tuple((name, why) for name, why in faults.items() if why),
    )
    return _Walk(joints, tree, places)


def _tell_of_faults(path: Path, robot: UrdfRobot, links: list[str]) -> None:
    """Refuses what cannot be simulated; an inertia beyond the sum of the others is in many makers'
    files, and only said. Of what stands still nothing shows.
    """
    for link in links:
        why = fault(link, robot.inertia[link])
        if why is None:
            continue
        if negative(robot.inertia[link]):
            raise UsageError(f"{path}: {why}. Correct its <inertial>")
        text = f"{path}: {why}, which no body can have; it is taken as it stands"
        warnings.warn(text, DatasetWarning, stacklevel=4)


def _massless(
    joints: list[UrdfJoint],
    parent: tuple[int, ...],
    bodies: list[np.ndarray],
    couplings: tuple[Coupling, ...],
) -> list[UrdfJoint]:
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


def _couplings(path: Path, joints: list[UrdfJoint]) -> tuple[Coupling, ...]:
    out = [Coupling(j.name, *j.mimic) for j in joints if j.mimic is not None]
    names, followers = set(names_of(joints)), {c.follower for c in out}
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
