"""The links and joints of a URDF file, read safely: no entities, no external references.

Frames and axes are those of the file; inertial parameters are about the frames of the links.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.base.xml_tree import Declares, xml_root
from jaxid.dynamics.rigid_body import about_origin
from jaxid.robots.tree import rotation


MOVING = ("revolute", "continuous", "prismatic")


@dataclass
class UrdfJoint:
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
class UrdfRobot:
    inertia: dict[str, np.ndarray] = field(
        default_factory=dict
    )  # link -> ten numbers about its frame
    joints: dict[str, UrdfJoint] = field(default_factory=dict)

    def children(self, link: str) -> list[UrdfJoint]:
        return [j for j in self.joints.values() if j.parent == link]


def read_links(path: Path, text: str | None = None) -> tuple[UrdfRobot, str]:
    """The links and joints of a URDF, and its root link. Raises `UsageError` for what is no
    tree.
    """
    robot = read_robot(path, text)
    root = root_of(robot, None, path)
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


def read_robot(path: Path, text: str | None = None) -> UrdfRobot:
    """All links and joints, in the order of the file."""
    tree = _robot_element(path, text)
    robot = UrdfRobot()
    for link in tree.findall("link"):
        name = _text(link, "name", path, "a link")
        if name in robot.inertia:
            raise UsageError(f"{path}: link {name!r} stands there twice")
        robot.inertia[name] = _inertia(link, path, name)
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
                f"{path}: link {joint.child!r} has two parents; a closed loop is not a serial chain"
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
        T[:3, :3] = rotation(roll, pitch, yaw)
        T[:3, 3] = _numbers(element.get("xyz"), "0 0 0", 3, path, f"xyz of {what}")
    return T


def _inertia(link: Any, path: Path, name: str) -> np.ndarray:
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
    R = T[:3, :3]
    I = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    return about_origin(m, T[:3, 3], I[np.triu_indices(3)])


def _joint(element: Any, path: Path) -> UrdfJoint:
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
    return UrdfJoint(
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


def root_of(robot: UrdfRobot, root: str | None, path: Any) -> str:
    """The link that the joints begin at: `root`, or the one without a parent."""
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


def tip_of(robot: UrdfRobot, root: str, tip: str | None, path: Any) -> str:
    """The link that a chain ends at: `tip`, or the end of the only branch that moves."""
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


def _ends(robot: UrdfRobot, link: str) -> list[str]:
    """The last link that moves of each branch."""
    behind = [j.child for j in robot.children(link) if _moves(robot, j)]
    if not behind:
        return [link]
    return list(chain.from_iterable(_ends(robot, child) for child in behind))


def _moves(robot: UrdfRobot, joint: UrdfJoint) -> bool:
    return joint.kind in MOVING or any(_moves(robot, j) for j in robot.children(joint.child))
