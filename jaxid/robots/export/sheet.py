"""The numbers of a robot before and after a result, joint by joint and link by link, and which
change made which of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jaxid.dynamics.rigid_body import about_origin
from jaxid.robots.bodies import BODY, body_of
from jaxid.robots.tree import rotation, Tree


#: Below this share of the numbers' size a body counts as unchanged.
SAME = 1e-12


@dataclass(frozen=True)
class JointNumbers:
    """What holds at one joint, SI. `torque` is added to the joint always, `drive` multiplies a
    recorded torque.
    """

    damping: float = 0.0
    quadratic: float = 0.0
    cubic: float = 0.0
    frictionloss: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    springref: float = 0.0
    kp: float = 0.0
    kd: float = 0.0
    ki: float = 0.0
    offset: float = 0.0
    lowest: float = -np.inf
    highest: float = np.inf
    delay: float = 0.0
    lag: float = 0.0
    bias: float = 0.0
    torque: float = 0.0
    drive: float = 1.0


@dataclass(frozen=True)
class LinkInertia:
    """Mass (kg), centre of mass (m) in the link's frame, inertia about it along the frame's axes [3
    3].
    """

    mass: float
    com: np.ndarray
    inertia: np.ndarray

    @property
    def ten(self) -> np.ndarray:
        """The ten numbers about the frame's origin."""
        return about_origin(self.mass, self.com, self.inertia[np.triu_indices(3)])


@dataclass(frozen=True)
class RobotChange:
    """One effect, or one fitted number, and what of the robot it changed: `quantity` at `place` (a
    joint or a link).

    A quantity is a field of `JointNumbers`, `force` (both limits), `inertial`, `gravity`, or the
    effect's own name where no such number says it; `value` is then a table of the effect's numbers.
    """

    effect: str
    location: str
    quantity: str
    place: str
    value: Any
    before: Any
    unit: str
    note: str = ""


@dataclass
class Sheet:
    """`tree` None where no file is known; `before` and `after` by joint. `bodies` are (before,
    after) of links, lumped as the model has them. `gravity` likewise. `driven`: a goal drives, by a
    law of the file (`own_law`) or of the recording.
    """

    tree: Tree | None
    before: dict[str, JointNumbers]
    after: dict[str, JointNumbers]
    bodies: dict[str, tuple[LinkInertia, LinkInertia]] = field(default_factory=dict)
    gravity: tuple[np.ndarray, np.ndarray] | None = None
    changes: list[RobotChange] = field(default_factory=list)
    driven: bool = False
    own_law: bool = True
    sampled: float = 0.0
    kind: str = "pd"
    notes: list[str] = field(default_factory=list)

    @property
    def own_tree(self) -> Tree:
        """The tree of the file, where one is patched."""
        assert self.tree is not None
        return self.tree

    def joint(self, place: str) -> str:
        """The joint of a location: a joint, or its goal, torque or speed channel."""
        for end in ("", "_cmd", "_tau", "_qd"):
            name = place.removesuffix(end)
            if name in self.after:
                return name
        return ""

    def set(self, joint: str, **numbers: float) -> None:
        self.after[joint] = replace(self.after[joint], **numbers)

    def slides(self, joint: str) -> bool:
        if self.tree is None or joint not in self.tree.joints:
            return False
        return self.tree.slides[self.tree.joints.index(joint)]

    def force_unit(self, joint: str) -> str:
        return "N" if self.slides(joint) else "N m"

    @property
    def changed(self) -> dict[str, JointNumbers]:
        """Joints of which a number is another one than before."""
        return {j: n for j, n in self.after.items() if n != self.before[j]}

    def record(self, changes: Iterable[RobotChange]) -> None:
        self.changes += changes


def of_tree(tree: Tree | None, joints: Iterable[str], robot: Mapping[str, Any]) -> Sheet:
    """What holds before: the file's numbers (those of mimic joints carried to the joint that leads
    them), and the law's.
    """
    drive = robot.get("drive")
    law: Mapping[str, Any] = drive["joints"] if drive else {}
    numbers: dict[str, JointNumbers] = {}
    for joint in tree.driven if tree is not None else joints:
        own: dict[str, float] = {}
        if tree is not None:
            own = _of_file(tree, joint)
        if joint in law:
            n, g = law[joint], law[joint].get("gain", 1.0)
            own |= {k: g * n.get(k, 0.0) for k in ("kp", "kd", "ki", "offset")}
            own |= {k: n.get(k, 0.0) for k in ("delay", "lag")}
            own |= {"lowest": g * n.get("lowest", -np.inf), "highest": g * n.get("highest", np.inf)}
        numbers[joint] = JointNumbers(**own)
    sheet = Sheet(tree, numbers, dict(numbers), driven=bool(drive))
    if drive:
        sheet.own_law = drive.get("origin") == "file"
        sheet.sampled, sheet.kind = float(drive.get("period") or 0.0), str(drive.get("kind"))
    if tree is not None:
        sheet.gravity = (np.array(tree.gravity, np.float64),) * 2  # type: ignore[assignment]
    return sheet


def _of_file(tree: Tree, joint: str) -> dict[str, float]:
    S, _ = tree.follow()
    s, k = S[:, tree.leading.index(joint)], tree.joints.index(joint)
    actuator = tree.actuators.get(joint)
    force = actuator.force if actuator is not None else (-np.inf, np.inf)
    return {
        "damping": float((s**2) @ tree.damping[:, 0]),
        "quadratic": float(np.abs(s**3) @ tree.damping[:, 1]),
        "cubic": float((s**4) @ tree.damping[:, 2]),
        "frictionloss": float(np.abs(s) @ tree.frictionloss),
        "armature": float(tree.armature[k]),
        "stiffness": float(tree.stiffness[k]),
        "springref": float(tree.spring[k]),
        "lowest": float(force[0]),
        "highest": float(force[1]),
    }


def body_before(tree: Tree, link: str) -> LinkInertia:
    """The body of a link as the model starts with it: the nearest one that can exist, with what is
    fixed to it.
    """
    k = tree.links.index(link)
    return from_numbers(dict(zip(BODY, body_of(tree.inertia[k], tree.anchor[k])[0], strict=True)))


def numbers_of(tree: Tree, link: str) -> dict[str, float]:
    """The ten numbers of a link by the names that a fit has for them."""
    k = tree.links.index(link)
    return {
        name: float(v)
        for name, v in zip(BODY, body_of(tree.inertia[k], tree.anchor[k])[0], strict=True)
    }


def from_numbers(n: Mapping[str, float]) -> LinkInertia:
    G = np.array(
        [
            [n["gyration_xx"], 0.0, 0.0],
            [n["gyration_yx"], n["gyration_yy"], 0.0],
            [n["gyration_zx"], n["gyration_zy"], n["gyration_zz"]],
        ]
    )
    S = n["mass"] * G @ G.T
    return LinkInertia(
        n["mass"], np.array([n["com_x"], n["com_y"], n["com_z"]]), np.trace(S) * np.eye(3) - S
    )


def from_ten(ten: np.ndarray) -> tuple[LinkInertia, float]:
    """The nearest body that can exist to ten numbers about the frame's origin, and how far off it
    is: the largest difference of a number over the largest number.
    """
    body = from_numbers(dict(zip(BODY, body_of(ten, np.zeros(3))[0], strict=True)))
    return body, float(np.abs(body.ten - ten).max() / max(float(np.abs(ten).max()), 1e-300))


def turned_gravity(
    g: np.ndarray, roll: float, pitch: float, yaw: float, back: tuple[float, float, float]
) -> np.ndarray:
    """Gravity of a file whose base stands at angles `back`, so that it acts as on a base at (roll,
    pitch, yaw).
    """
    return rotation(*back) @ rotation(roll, pitch, yaw).T @ g
