"""Serial chains from URDF files, read safely: no entities, no external references.

Revolute, continuous and prismatic joints become the joints of the chain; links behind fixed joints are added to the link that
carries them. The frames are those of the URDF, turned where a joint's axis is not its z axis so that it becomes z (an axis along
-z is turned about x); inertial parameters are turned with them.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.dynamics.kinematics import ArmTable, geometry_of
from jaxid.dynamics.rigid_body import about_origin, moved, Placements
from jaxid.errors import DatasetWarning, nearest, UsageError
from jaxid.storage.xml_tree import Declares, xml_root


MOVING = ("revolute", "continuous", "prismatic")


@dataclass
class _Joint:
    name: str
    kind: str
    parent: str
    child: str
    T: np.ndarray  # child frame in the parent's at zero position
    axis: np.ndarray
    limits: tuple[float, float, float, float]  # lower, upper, velocity, effort
    dynamics: tuple[float, float]  # damping, friction
    mimic: tuple[str, float, float] | None  # joint that it follows, offset, ratio


@dataclass
class _Robot:
    inertia: dict[str, np.ndarray] = field(
        default_factory=dict
    )  # link -> ten numbers about its frame
    joints: dict[str, _Joint] = field(default_factory=dict)
    impossible: dict[str, str] = field(
        default_factory=dict
    )  # link -> why no body can have its inertia

    def children(self, link: str) -> list[_Joint]:
        return [j for j in self.joints.values() if j.parent == link]


def read_urdf(
    path: str | Path, tip: str | None = None, root: str | None = None, text: str | None = None
) -> ArmTable:
    """The chain from `root` (default: the link without a parent) to `tip` (default: the end of the
    only branch that moves).

    With `text` that is read, and the path only named in messages. Moving joints off the chain are
    locked at zero, their links added to the chain's. Raises `UsageError` for what is not a chain of
    such joints, naming the joint or link.
    """
    robot = _read(Path(path), text)
    root = _root(robot, root, path)
    tip = _tip(robot, root, tip, path)
    chain = _chain_to(robot, root, tip, path)
    moving = [j for j in chain if j.kind in MOVING]
    if not moving:
        raise UsageError(f"{path}: no joint moves between {root!r} and {tip!r}")
    for link in _behind(robot, moving[0].child):
        if link in robot.impossible:  # of what stands still nothing shows
            _tell(f"{path}: {robot.impossible[link]}", refuse="negative" in robot.impossible[link])
    for j in chain:
        if j.mimic:
            raise UsageError(
                f"{path}: joint {j.name!r} mimics another; jaxid takes chains of independent joints"
            )
    geometry, inertia, before, k = [], [], np.eye(4), -1
    on_chain = {j.name for j in chain}
    for j in chain:
        here = before @ j.T
        if j.kind not in MOVING:
            if k >= 0:
                inertia[k] = inertia[k] + _turned(_lumped(robot, j.child, on_chain), here)
            before = here
            continue
        turn = np.eye(4)
        turn[:3, :3] = z_to(j.axis)
        geometry.append(geometry_of(here @ turn))
        before = np.linalg.inv(turn)
        inertia.append(_turned(_lumped(robot, j.child, on_chain), before))
        k += 1
    a, alpha, d, theta, b, gamma = np.array(geometry).T
    limits = np.array([j.limits for j in moving]).T
    return ArmTable(
        a,
        alpha,
        d,
        theta,
        b,
        gamma,
        tuple(j.kind == "prismatic" for j in moving),
        np.array(inertia),
        np.zeros(len(moving)),
        before,
        tuple(j.name for j in moving),
        *limits,
        *np.array([j.dynamics for j in moving]).T,
    )


def read_links(path: Path, text: str | None = None) -> tuple[_Robot, str]:
    """The links and joints of a URDF, and its root link. Raises `UsageError` for what is no
    tree.
    """
    robot = _read(path, text)
    root = _root(robot, None, path)
    reached, edge = {root}, [root]
    while edge:
        joints = chain.from_iterable(map(robot.children, edge))
        edge = [joint.child for joint in joints]
        reached |= set(edge)
    lost = sorted(set(robot.inertia) - reached)
    if lost:
        raise UsageError(
            f"{path}: link {lost[0]!r} does not hang on the root {root!r}: its joints form a closed"
            " loop"
        )
    return robot, root


def _robot_element(path: Path, text: str | None) -> Any:
    """The outermost element of a URDF. Raises `UsageError` for a file that is none."""
    from xml.etree.ElementTree import ParseError

    try:
        tree = xml_root(path if text is None else text)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from error
    except ParseError as error:
        raise UsageError(f"{path}: not XML ({error})") from error
    except Declares as error:
        raise UsageError(
            f"{path}: {error}, which is refused; write the URDF without them"
        ) from error
    if tree.tag != "robot":
        raise UsageError(f"{path}: the outermost tag is not <robot>; give a URDF")
    if any(
        "xacro" in e.tag or "${" in str(list(e.attrib.values()))
        for e in tree.iter()
        if isinstance(e.tag, str)
    ):
        other = (
            f"{path.stem}.urdf" if path.suffix.lower() != ".urdf" else f"{path.stem}_expanded.urdf"
        )
        raise UsageError(
            f"{path}: a xacro file; expand it first, into another file: xacro {path.name} > {other}"
        )
    return tree


def _read(path: Path, text: str | None = None) -> _Robot:
    tree = _robot_element(path, text)
    robot = _Robot()
    for link in tree.findall("link"):
        name = _text(link, "name", path, "a link")
        if name in robot.inertia:
            raise UsageError(f"{path}: link {name!r} stands there twice")
        robot.inertia[name] = _inertia(link, path, name, robot)
    for element in tree.findall("joint"):
        joint = _joint(element, path)
        for link in (joint.parent, joint.child):
            if link not in robot.inertia:
                raise UsageError(
                    f"{path}: joint {joint.name!r} names link"
                    f" {link!r}{nearest(link, robot.inertia)}"
                )
        if any(joint.child == other.child for other in robot.joints.values()):
            raise UsageError(
                f"{path}: link {joint.child!r} has two parents; closed loops are no serial chain"
            )
        robot.joints[joint.name] = joint
    return robot


def _text(element: Any, key: str, path: Path, what: str) -> str:
    value = element.get(key)
    if not value:
        raise UsageError(f"{path}: {what} has no {key!r}")
    return value


def _numbers(text: str | None, default: str, count: int, path: Path, what: str) -> np.ndarray:
    try:
        values = np.array([float(x) for x in (text or default).split()])
    except ValueError:
        values = np.zeros(0)
    if values.size != count or not np.isfinite(values).all():
        raise UsageError(
            f"{path}: {what} is {text!r}; it needs {count} finite number{'s' if count > 1 else ''}"
        )
    return values


def _number(element: Any, key: str, default: str, path: Path, what: str) -> float:
    return float(
        _numbers(
            element.get(key) if element is not None else None, default, 1, path, f"{what} {key}"
        )[0]
    )


def _origin(element: Any, path: Path, what: str) -> np.ndarray:
    T = np.eye(4)
    if element is not None:
        roll, pitch, yaw = _numbers(element.get("rpy"), "0 0 0", 3, path, f"rpy of {what}")
        T[:3, :3] = _rotation(2, yaw) @ _rotation(1, pitch) @ _rotation(0, roll)
        T[:3, 3] = _numbers(element.get("xyz"), "0 0 0", 3, path, f"xyz of {what}")
    return T


def _rotation(axis: int, angle: float) -> np.ndarray:
    R, i, j = np.eye(3), (axis + 1) % 3, (axis + 2) % 3
    R[i, i] = R[j, j] = np.cos(angle)
    R[j, i], R[i, j] = np.sin(angle), -np.sin(angle)
    return R


def _inertia(link: Any, path: Path, name: str, robot: _Robot) -> np.ndarray:
    inertial = link.find("inertial")
    if inertial is None:
        return np.zeros(10)
    what = f"link {name!r}"
    T = _origin(inertial.find("origin"), path, what)
    m = _number(inertial.find("mass"), "value", "0", path, f"mass of {what}:")
    tensor = inertial.find("inertia")
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (
        _number(tensor, key, "0", path, f"inertia of {what}:") for key in keys
    )
    if why := _impossible(m, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])):
        robot.impossible[name] = f"{what} has {why}"
    R = T[:3, :3]
    I = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    return about_origin(m, T[:3, 3], I[np.triu_indices(3)])


def _tell(text: str, refuse: bool) -> None:
    """Refuses what cannot be simulated; an inertia beyond the sum of the others is in many makers'
    files, and only said.
    """
    if refuse:
        raise UsageError(f"{text}. Correct its <inertial>")
    warnings.warn(f"{text}; it is taken as it stands", DatasetWarning, stacklevel=4)


def _impossible(m: float, I: np.ndarray) -> str:
    """Why no body has this mass and this inertia about its centre of mass [3 3]; empty where one
    can.
    """
    if m < 0:
        return f"a mass of {m:g} kg, and a mass is not negative"
    moments = np.linalg.eigvalsh(I)
    said = "principal moments of inertia of " + ", ".join(f"{v:.4g}" for v in moments) + " kg m^2"
    if moments[0] < -1e-6 * max(float(np.abs(moments).max()), 1e-300):
        return f"{said}, and none can be negative"
    if moments[2] > (moments[0] + moments[1]) * (1 + 1e-3) + 1e-12:
        return f"{said}, which no body can have: one exceeds the sum of the others"
    return ""


def _joint(element: Any, path: Path) -> _Joint:
    name = _text(element, "name", path, "a joint")
    kind = _text(element, "type", path, f"joint {name!r}")
    if kind not in (*MOVING, "fixed"):
        raise UsageError(
            f"{path}: joint {name!r} is of type {kind!r}; jaxid knows"
            f" {', '.join((*MOVING, 'fixed'))}"
        )
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None:
            raise UsageError(f"{path}: joint {name!r} has no <{tag}>")
        ends.append(_text(end, "link", path, f"<{tag}> of joint {name!r}"))
    axis_tag = element.find("axis")
    axis = _numbers(
        axis_tag.get("xyz") if axis_tag is not None else None,
        "1 0 0",
        3,
        path,
        f"axis of joint {name!r}",
    )
    if kind in MOVING and np.linalg.norm(axis) < 1e-9:
        raise UsageError(f"{path}: the axis of joint {name!r} is zero")
    limit, dynamics = element.find("limit"), element.find("dynamics")
    what = f"limit of joint {name!r}:"
    endless = kind == "continuous" or limit is None
    lower = -np.inf if endless else _number(limit, "lower", "0", path, what)
    upper = np.inf if endless else _number(limit, "upper", "0", path, what)
    if not endless and lower > upper:
        raise UsageError(
            f"{path}: joint {name!r} has lower = {lower:g} above upper = {upper:g}; exchange them"
        )

    def rate(key: str) -> float:
        if limit is None or limit.get(key) is None:
            return np.inf
        return _number(limit, key, "0", path, what)

    losses = f"dynamics of joint {name!r}:"
    return _Joint(
        name=name,
        kind=kind,
        parent=ends[0],
        child=ends[1],
        T=_origin(element.find("origin"), path, f"joint {name!r}"),
        axis=axis / max(float(np.linalg.norm(axis)), 1e-300),
        limits=(lower, upper, rate("velocity"), rate("effort")),
        dynamics=(
            _number(dynamics, "damping", "0", path, losses),
            _number(dynamics, "friction", "0", path, losses),
        ),
        mimic=_mimic(element.find("mimic"), path, name),
    )


def _mimic(tag: Any, path: Path, name: str) -> tuple[str, float, float] | None:
    if tag is None:
        return None
    what = f"mimic of joint {name!r}:"
    ratio, offset = (
        _number(tag, key, default, path, what)
        for key, default in (("multiplier", "1"), ("offset", "0"))
    )
    return _text(tag, "joint", path, f"<mimic> of joint {name!r}"), offset, ratio


def _root(robot: _Robot, root: str | None, path: Any) -> str:
    if root is not None:
        if root not in robot.inertia:
            raise UsageError(f"{path}: there is no link {root!r}{nearest(root, robot.inertia)}")
        return root
    children = {j.child for j in robot.joints.values()}
    roots = [name for name in robot.inertia if name not in children]
    used = {j.parent for j in robot.joints.values()} & set(roots)
    if len(roots) > 1 and len(used) == 1:  # links that no joint names belong to nothing
        return next(iter(used))
    if not robot.inertia:
        raise UsageError(f"{path}: it has no <link> (a file that xacro made of macros alone?)")
    if len(roots) != 1:
        raise UsageError(
            f"{path}: {len(roots)} links have no parent ({', '.join(roots) or 'a closed loop'});"
            ' name where the chain begins: root = "LINK" under [model] of dataset.toml, or'
            " --root LINK"
        )
    return roots[0]


def _tip(robot: _Robot, root: str, tip: str | None, path: Any) -> str:
    if tip is not None:
        if tip not in robot.inertia:
            raise UsageError(f"{path}: there is no link {tip!r}{nearest(tip, robot.inertia)}")
        return tip
    link = root
    while True:
        moving = [j for j in robot.children(link) if _moves(robot, j)]
        if len(moving) > 1:
            branches = ", ".join(j.child for j in moving)
            raise UsageError(
                f"{path}: behind {link!r} several branches move ({branches}); name its last link:"
                ' tip = "LINK" under '
                "[model] of dataset.toml, or --tip LINK. Ends to choose from:"
                f" {', '.join(_ends(robot, root))}"
            )
        if not moving:
            return link
        link = moving[0].child


def _ends(robot: _Robot, link: str) -> list[str]:
    """The last link that moves of each branch."""
    behind = [j.child for j in robot.children(link) if _moves(robot, j)]
    if not behind:
        return [link]
    return list(chain.from_iterable(_ends(robot, child) for child in behind))


def _behind(robot: _Robot, link: str) -> list[str]:
    """A link and everything that hangs on it."""
    behind = [link]
    for joint in robot.children(link):
        behind += _behind(robot, joint.child)
    return behind


def _moves(robot: _Robot, joint: _Joint) -> bool:
    return joint.kind in MOVING or any(_moves(robot, j) for j in robot.children(joint.child))


def _chain_to(robot: _Robot, root: str, tip: str, path: Any) -> list[_Joint]:
    of_child = {j.child: j for j in robot.joints.values()}
    chain: list[_Joint] = []
    link = tip
    while link != root:
        if link not in of_child or len(chain) > len(of_child):
            raise UsageError(f"{path}: link {tip!r} does not hang on {root!r}")
        chain.append(of_child[link])
        link = of_child[link].parent
    return chain[::-1]


def _lumped(robot: _Robot, link: str, on_chain: set[str]) -> np.ndarray:
    """Ten numbers of a link and of everything that hangs on it off the chain, in the link's
    frame.
    """
    total = robot.inertia[link].copy()
    for j in robot.children(link):
        if j.name not in on_chain:
            total += _turned(_lumped(robot, j.child, on_chain), j.T)
    return total


def _turned(inertia: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Ten numbers of a body, from the frame that stands at T into the frame around it."""
    x, y, z, p = (tuple(T[:3, k]) for k in range(4))
    return np.array(moved(Placements(x, y, z, p), inertia))


def z_to(axis: np.ndarray) -> np.ndarray:
    """The smallest rotation that takes z into the axis; about x where the axis is -z."""
    c = axis[2]
    if c < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    v = np.array([-axis[1], axis[0], 0.0])  # z x axis
    S = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + S + S @ S / (1 + c)
