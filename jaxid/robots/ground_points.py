"""Which points of a robot's file may touch its planes, and how they give way."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxid.robots.file_step import joint_numbers
from jaxid.robots.ground import ContactPoint, Ground, Softness
from jaxid.robots.mjcf_spec import compilable, compiled, library
from jaxid.robots.tree import Tree


#: Shapes of a compiled model by their numbers: the plane first.
Pair = tuple[int, int]

#: A shape that comes no nearer to a plane than this along a recording is not simulated with it, m.
NEAR = 0.01
#: Dimensions of a contact that slides and neither twists nor rolls.
SLIDES = 3


class PairContact(NamedTuple):
    """How two shapes touch, as MuJoCo mixes what the file says of each."""

    friction: tuple[float, ...]
    solref: tuple[float, ...]
    solimp: tuple[float, ...]

    @classmethod
    def of(cls, contact: Any) -> PairContact:
        parts = (contact.friction, contact.solref, contact.solimp)
        return cls(*(tuple(map(float, part)) for part in parts))


def kind_of(model: Any, shape: int) -> str:
    """PLANE, SPHERE, CAPSULE, BOX ... of a compiled model."""
    return library().mjtGeom(int(model.geom_type[shape])).name.removeprefix("mjGEOM_")


def simulated(model: Any, contact: Any) -> bool:
    """Whether a contact is of a plane that does not move with a sphere, a capsule or a box, and of
    a kind that `jaxid.robots.ground` has.
    """
    mujoco = library()
    plane, shape = contact.geom
    slides_alike = contact.friction[0] == contact.friction[1]
    of_its_own = not np.any(contact.solreffriction)
    return bool(
        kind_of(model, plane) == "PLANE"
        and model.body_weldid[model.geom_bodyid[plane]] == 0
        and kind_of(model, shape) in ("SPHERE", "CAPSULE", "BOX")
        and contact.dim == SLIDES
        and contact.friction[0] > 0
        and slides_alike
        and of_its_own
        and int(model.opt.cone) == int(mujoco.mjtCone.mjCONE_PYRAMIDAL)
        and not model.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
    )


def points_of(model: Any, near: Mapping[Pair, PairContact], tree: Tree) -> Ground | None:
    """The points of those pairs of shapes whose shape a joint of the tree carries; `model` is
    compiled of the file's shapes.
    """
    mujoco = library()
    whole = _whole(tree.text, tree.file)
    data = mujoco.MjData(whole)
    for joint, value in tree.held.items():
        data.qpos[whole.joint(joint).qposadr] = value
    mujoco.mj_kinematics(whole, data)
    mujoco.mj_comPos(whole, data)
    shapes: list[str] = []
    points: list[ContactPoint] = []
    friction: dict[str, float] = {}
    for (plane, shape), contact in sorted(near.items()):
        node, joint = _carrier(whole, int(model.geom_bodyid[shape]), tree)
        if node < 0:
            continue
        name, own = name_of(model, shape), contact.friction[0]
        if friction.get(name, own) != own:  # a number of its own on each plane
            name = f"{name}_{shape}_{plane}"
        friction[name] = own
        if name not in shapes:
            shapes.append(name)
        frame = _Frame(whole, data, joint)
        body = int(model.geom_bodyid[shape])
        turn, place = _of_world(model, data, shape)
        flat, foot = _of_world(model, data, plane)
        normal = flat[:, 2]
        for local, radius, along in _touched(model, shape):
            points.append(
                ContactPoint(
                    shape=shapes.index(name),
                    node=node,
                    position=frame.point(place + turn @ local),
                    radius=radius,
                    along=() if along is None else frame.direction(turn @ along),
                    normal=tuple(map(float, normal)),
                    height=float(normal @ foot),
                    centre=frame.point(data.xipos[body]),
                    softness=_softness(contact, whole),
                )
            )
    if not points:
        return None
    return Ground(
        points=tuple(points),
        shapes=tuple(shapes),
        friction=tuple(friction[name] for name in shapes),
        ratio=float(whole.opt.impratio),
    )


@lru_cache(maxsize=8)
def _whole(text: str, file: str) -> Any:
    """The compiled model of a file, with its masses."""
    path = Path(file)
    return compiled(path, compilable(path, text)[0])


def _carrier(model: Any, body: int, tree: Tree) -> tuple[int, int]:
    """(node of the tree, joint of the model) that carries a body; (-1, -1) for what the base
    carries.
    """
    mujoco = library()
    while body > 0:
        first = int(model.body_jntadr[body])
        for joint in reversed(range(first, first + int(model.body_jntnum[body]))):
            own = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) or f"joint{joint}"
            if own in tree.joints:
                return tree.joints.index(own), joint
        body = int(model.body_parentid[body])
    return -1, -1


class _Frame:
    """That of a node in the pose of the file: the axes of the joint's body, on the joint."""

    def __init__(self, model: Any, data: Any, joint: int):
        body = int(model.jnt_bodyid[joint])
        self.turn = data.xmat[body].reshape(3, 3).copy()
        self.origin = data.xanchor[joint].copy()

    def point(self, at: np.ndarray) -> tuple[float, ...]:
        """A point of the world in it."""
        return self.direction(at - self.origin)

    def direction(self, along: np.ndarray) -> tuple[float, ...]:
        """A direction of the world in it."""
        return tuple(map(float, self.turn.T @ along))


def _of_world(model: Any, data: Any, shape: int) -> tuple[np.ndarray, np.ndarray]:
    """(rotation [3 3], position [3]) of a shape in the world; `data` that of the bodies."""
    mujoco = library()
    body = int(model.geom_bodyid[shape])
    own = np.zeros(9)
    mujoco.mju_quat2Mat(own, model.geom_quat[shape])
    turn = data.xmat[body].reshape(3, 3)
    return turn @ own.reshape(3, 3), data.xpos[body] + turn @ model.geom_pos[shape]


def _touched(model: Any, shape: int) -> list[tuple[np.ndarray, float, np.ndarray | None]]:
    """(place in the shape's frame, radius, direction along which friction is counted) of each point
    that may touch a plane.
    """
    size, kind = model.geom_size[shape], kind_of(model, shape)
    if kind == "SPHERE":
        return [(np.zeros(3), float(size[0]), None)]
    if kind == "CAPSULE":
        axis = np.array([0.0, 0.0, 1.0])
        return [(side * size[1] * axis, float(size[0]), axis) for side in (1, -1)]
    corners = product((-1.0, 1.0), repeat=3)
    return [(size * np.array(corner), 0.0, None) for corner in corners]


def _softness(contact: PairContact, model: Any) -> Softness:
    """What solref and solimp of a contact mean in the file's steps."""
    mujoco = library()
    safe = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_REFSAFE)
    quickest = 2 * float(model.opt.timestep) if safe else 0.0
    _, _, _, _, _, *own = joint_numbers(
        friction=contact.solref,
        friction_impedance=contact.solimp,
        stop=contact.solref,
        stop_impedance=contact.solimp,
        ends=(0.0, 0.0),
        margin=0.0,
        quickest=quickest,
    )
    return Softness(*own)


def name_of(model: Any, shape: int) -> str:
    """That of a shape, or of its body."""
    mujoco = library()
    own = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, int(shape))
    body = int(model.geom_bodyid[shape])
    return own or mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or f"shape {shape}"
