"""Contacts of a robot's shapes with planes that do not move, as MuJoCo's pyramids have them.

A sphere touches a plane at one point, a capsule at its two ends, a box at its corners. A point at
the distance d < 0 from its plane gets an edge for each way of sliding,

    J = normal +- friction along,    target = -rate J v - stiffness impedance(d) d,

whose compliance is that of the first edge (Todorov 2014; MuJoCo's documentation, chapter
Computation, "Contact"). Friction that twists or rolls is not simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.dynamics.rigid_body import Placements
from jaxid.dynamics.soft_constraints import Edges, HARDEST, impedance
from jaxid.numerics.fast_math import dot, inverse


#: A unit vector and one whose y is less than this are taken for a frame as MuJoCo takes them.
STEEP = 0.5


@dataclass(frozen=True)
class Softness:
    """How a contact gives way: see `jaxid.dynamics.soft_constraints.Stops`."""

    stiffness: float
    rate: float
    softest: float
    hardest: float
    width: float
    midpoint: float
    power: float


@dataclass(frozen=True)
class ContactPoint:
    """A point of a shape that may touch a plane.

    `shape` is its place in `Ground.shapes`, `node` the joint that carries it, `position` [3] in
    that node's frame and `radius` around it; `along` [3] a direction there that friction is
    counted along, () where it is the plane's own. `normal` [3] and `height` tell the plane in the
    base's frame. `centre` [3] is that of the mass of the body in the node's frame.
    """

    shape: int
    node: int
    position: tuple[float, ...]
    radius: float
    along: tuple[float, ...]
    normal: tuple[float, ...]
    height: float
    centre: tuple[float, ...]
    softness: Softness


@dataclass(frozen=True)
class Ground:
    """Points of a robot that may touch planes. `shapes`: their names, and the `friction` of each by
    the file. `ratio`: MuJoCo's `impratio`.
    """

    points: tuple[ContactPoint, ...]
    shapes: tuple[str, ...]
    friction: tuple[float, ...]
    ratio: float

    def array(self, name: str) -> np.ndarray:
        """One number, or vector, of every point."""
        return np.array([getattr(point, name) for point in self.points])

    def soft(self, name: str) -> np.ndarray:
        """One number of the softness of every point."""
        return np.array([getattr(point.softness, name) for point in self.points])

    def softness(self) -> Any:
        """Numbers of `Softness`, each of every point."""
        return Softness(*(self.soft(name) for name in Softness.__annotations__))  # type: ignore


def nameless_of(ground: Ground | None) -> Ground | None:
    """The same without names and numbers that are told to a program."""
    if ground is None:
        return None
    shapes = tuple(f"shape {k + 1}" for k in range(len(ground.shapes)))
    return Ground(ground.points, shapes, (0.0,) * len(shapes), ground.ratio)


def friction_of(ground: Ground | None) -> Any:
    """Friction of the shapes of the ground by the file, [shapes]."""
    return np.array(() if ground is None else ground.friction, np.float64)


class TreePose(NamedTuple):
    """Nodes of a tree in the base's frame: rotations [n 3 3], origins [n 3], axes [n 3]; whether a
    node slides [n], and whether it moves another one [n n] (of the mover, of the moved).
    """

    turn: Any
    origin: Any
    axis: Any
    slides: np.ndarray
    moves: np.ndarray


def pose_of(
    poses: Placements,
    axes: Sequence[Sequence[float]],
    slides: Sequence[bool],
    parent: Sequence[int],
) -> TreePose:
    """From the frames of the nodes, components [n]."""
    columns = [jnp.stack(column, -1) for column in poses[:3]]
    turn = jnp.stack(columns, -1)
    axis = jnp.sum(turn * np.array(axes).reshape(-1, 1, 3), -1)
    return TreePose(turn, jnp.stack(poses.p, -1), axis, np.array(slides, bool), _moves(parent))


def _moves(parent: Sequence[int]) -> np.ndarray:
    out = np.eye(len(parent), dtype=bool)
    for node, up in enumerate(parent):
        if up >= 0:
            out[:, node] |= out[:, up]
    return out


def _places(pose: TreePose, nodes: np.ndarray, local: np.ndarray) -> Float[Array, "points 3"]:
    """Points of nodes' frames in the base's frame."""
    return pose.origin[nodes] + jnp.sum(pose.turn[nodes] * local[:, None, :], -1)


def _slopes(
    pose: TreePose, nodes: np.ndarray, at: Float[Array, "points 3"]
) -> Float[Array, "points n 3"]:
    """By how much points of nodes move with every joint."""
    arm = at[:, None] - pose.origin[None]
    turning = jnp.cross(jnp.broadcast_to(pose.axis[None], arm.shape), arm)
    moved = jnp.where(pose.slides[None, :, None], pose.axis[None], turning)
    return jnp.where(pose.moves[:, nodes].T[:, :, None], moved, 0.0)


def yielding_of(ground: Ground, pose: TreePose, M: Float[Array, "n n"]) -> Float[Array, " points"]:
    """Inverse mass that each point shows a force in the pose of the file, as MuJoCo counts it: that
    of its body at the centre of mass, over all directions.
    """
    nodes = ground.array("node")
    slopes = _slopes(pose, nodes, _places(pose, nodes, ground.array("centre")))
    flat = jnp.moveaxis(slopes, 1, 2).reshape(-1, len(M))
    each = jnp.sum(dot(flat, inverse(M)) * flat, -1)
    return jnp.sum(each.reshape(-1, 3), -1) / 3


def distances_of(ground: Ground, pose: TreePose) -> Float[Array, " points"]:
    """How far each point is from its plane, m."""
    centre = _places(pose, ground.array("node"), ground.array("position"))
    return _distances(ground, centre)


def _distances(ground: Ground, centre: Float[Array, "points 3"]) -> Float[Array, " points"]:
    along = jnp.sum(centre * ground.array("normal"), -1)
    return along - ground.array("height") - ground.array("radius")


def edges_of(
    ground: Ground,
    pose: TreePose,
    friction: Float[Array, " shapes"],
    weight: Float[Array, " points"],
    qd: Float[Array, " n"],
) -> Edges:
    """Edges of all points at a pose with these speeds: four of each."""
    nodes, normal = ground.array("node"), ground.array("normal")
    centre = _places(pose, nodes, ground.array("position"))
    distance = _distances(ground, centre)
    at = centre - normal * (ground.array("radius") + distance / 2)[:, None]
    slopes = _slopes(pose, nodes, at)
    up = jnp.sum(slopes * normal[:, None], -1)
    first, second = _tangents(ground, pose)
    mu = jnp.asarray(friction)[ground.array("shape")]
    rows = []
    for tangent in (first, second):
        across = mu[:, None] * jnp.sum(slopes * tangent[:, None], -1)
        rows += [up + across, up - across]
    share = impedance(distance, ground.softness())
    touches = distance < 0
    pull = -ground.soft("stiffness") * share * distance
    rate = ground.soft("rate")
    wanted = [pull - rate * dot(row, qd) for row in rows]
    give = 2 * mu**2 / ground.ratio * (1 + mu**2) * weight * (1 - share) / share
    give = jnp.where(touches, jnp.maximum(give, HARDEST), 1.0)
    return Edges(
        rows=jnp.concatenate([jnp.where(touches[:, None], row, 0.0) for row in rows]),
        target=jnp.concatenate([jnp.where(touches, one, -1.0) for one in wanted]),
        compliance=jnp.tile(give, len(rows)),
    )


def _tangents(ground: Ground, pose: TreePose) -> tuple[Any, Any]:
    """Two directions along the plane of every point, [points 3] each."""
    normal = ground.array("normal")
    rough = np.where(np.abs(normal[:, 1:2]) < STEEP, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]])
    aligned = np.array([bool(point.along) for point in ground.points])
    along = np.array([point.along or (0.0, 0.0, 0.0) for point in ground.points])
    turned = jnp.sum(pose.turn[ground.array("node")] * along[:, None, :], -1)
    wanted = jnp.where(aligned[:, None], turned, rough)
    flat = wanted - jnp.sum(wanted * normal, -1, keepdims=True) * normal
    first = flat / jnp.linalg.norm(flat, axis=-1, keepdims=True)
    return first, jnp.cross(jnp.asarray(normal), first)
