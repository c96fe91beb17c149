"""A robot before any data: a tree of hinge and slide joints with the numbers that its file states.

A node is one joint and the body behind it. Its frame has the axes of that body and its origin on
the joint, at zero position; a body with several joints is a chain of nodes of which the last
carries it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.dynamics.rigid_body import moved, Placements
from jaxid.robots.curves import Curve, Polynomial
from jaxid.robots.file_step import FileStep
from jaxid.robots.steps import Steps


#: Nodes of a base that floats, from the world to the base: three slides, then Rz(yaw) Ry(pitch)
#: Rx(roll).
FLOATS = ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll")


@dataclass(frozen=True)
class Coupling:
    """A joint that follows another: q_follower = offset + ratio q_leader, or by a `curve`, which
    that line touches.
    """

    follower: str
    leader: str
    offset: float
    ratio: float
    curve: Curve | None = None

    @classmethod
    def by(cls, follower: str, leader: str, curve: Curve) -> Coupling:
        """Along a curve; a line where it is one."""
        if not all(piece.straight for piece in curve.pieces):
            return cls(follower, leader, *curve.tangent(), curve)
        return cls(follower, leader, *replace(curve, about=0.0).tangent())

    @property
    def as_curve(self) -> Curve:
        return self.curve or Curve((Polynomial((self.offset, self.ratio)),), 0.0)

    @property
    def turns(self) -> bool:
        """Whether the follower may lead as well."""
        return self.as_curve.turns

    def at(self, leader: Any) -> Any:
        """Position of the follower."""
        return self.as_curve.at(leader)[0]

    def turned(self) -> Coupling:
        """The leader as the follower."""
        return self.by(self.leader, self.follower, self.as_curve.turned())

    def through(self, before: Coupling) -> Coupling:
        """The follower of a leader that follows another one itself."""
        pieces = (*before.as_curve.pieces, *self.as_curve.pieces)
        about = before.curve.about if before.curve is not None else 0.0
        if before.curve is None and self.curve is not None and before.ratio:
            about = (self.curve.about - before.offset) / before.ratio
        return self.by(self.follower, before.leader, Curve(pieces, about))


@dataclass(frozen=True)
class Tie:
    """What acts among several joints and a tree cannot express: `what` it is, and the `joints` that
    it acts on.
    """

    what: str
    joints: tuple[str, ...]


@dataclass(frozen=True)
class Actuator:
    """What a file states of a joint's drive, at the joint: torque = gear (gain u + bias - kp q' -
    kd qd'), clipped to `force`.

    `kind` is motor (u is a torque), position (u is a goal) or velocity; `control` clips u. `lag` s,
    `delay` s.
    """

    name: str
    kind: str
    kp: float = 0.0
    kd: float = 0.0
    gain: float = 1.0
    offset: float = 0.0
    force: tuple[float, float] = (-np.inf, np.inf)
    control: tuple[float, float] = (-np.inf, np.inf)
    lag: float = 0.0
    delay: float = 0.0


@dataclass(frozen=True)
class Tree:
    """`parent` -1 is the base; `place` [n 4 4] the node's frame in its parent's at the joint's
    `reference`; `axis` [n 3] in it.

    `inertia` [n 10] is about the node's origin, `anchor` [n 3] that origin in the frame of the body
    as the file has it (`links`, "" for a node between two joints of one body). `damping` [n 3]: f =
    d1 v + d2 v |v| + d3 v^3. Limits are infinite where unknown. `held`: where joints of the file
    that do not move here stand. `impossible`: links with an inertia that no body has, and what is
    wrong with it. `trunk`: ten numbers of the base itself about the base's frame, `carrier` that
    link's name, and `root` [16], row by row, its pose in it where it is free to move in the file.
    `floats`: the first six nodes are the base's own freedom (see `robots.floating`). `steps`: those
    of the simulator that the file is of, where they add to its numbers; `simulator` how that one
    takes them, None where that is not known. `ties` must have all of
    their joints held before anything is simulated (see `robots.match`). `lifted` [n 10]: bodies
    whose weight the file cancels (`gravcomp`), as `inertia`; None where it cancels none. `text` is
    that of an MJCF file, includes in place.
    """

    file: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    parent: tuple[int, ...]
    slides: tuple[bool, ...]
    axis: np.ndarray
    place: np.ndarray
    reference: np.ndarray
    inertia: np.ndarray
    anchor: np.ndarray
    armature: np.ndarray
    damping: np.ndarray
    frictionloss: np.ndarray
    stiffness: np.ndarray
    spring: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    couplings: tuple[Coupling, ...] = ()
    actuators: Mapping[str, Actuator] = field(default_factory=dict)
    poses: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    base: str = "base"
    impossible: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    held: Mapping[str, float] = field(default_factory=dict)
    trunk: tuple[float, ...] = (0.0,) * 10
    root: tuple[float, ...] = tuple(np.eye(4).ravel().tolist())
    carrier: str = "base"
    floats: bool = False
    steps: Steps | None = None
    simulator: FileStep | None = None
    ties: tuple[Tie, ...] = ()
    lifted: np.ndarray | None = None
    text: str = field(default="", repr=False)

    @property
    def title(self) -> str:
        """What it is called: its file where it has one."""
        return self.file or "the robot"

    @property
    def n(self) -> int:
        return len(self.joints)

    @property
    def followers(self) -> tuple[str, ...]:
        return tuple(c.follower for c in self.couplings)

    @property
    def leading(self) -> tuple[str, ...]:
        """Joints that move by themselves, in the order of the file; behind them the angles of a
        base that floats.
        """
        own = tuple(j for j in self.joints[6 * self.floats :] if j not in self.followers)
        return (*own, *FLOATS[:2:-1]) if self.floats else own

    @property
    def driven(self) -> tuple[str, ...]:
        """Those of them that a drive moves: all but the angles of a base that floats."""
        return self.leading[: -3 if self.floats else None]

    @property
    def ends(self) -> tuple[str, ...]:
        """Links that nothing hangs on."""
        return tuple(link for k, link in enumerate(self.links) if k not in self.parent)

    def joint(self, name: str) -> int:
        """Position of a joint by name; raises `UsageError` with the nearest one."""
        if name not in self.joints:
            raise UsageError(f"{self.file}: there is no joint {name!r}{nearest(name, self.joints)}")
        return self.joints.index(name)

    def taken(self, keep: Sequence[int]) -> dict[str, Any]:
        """Per-node fields of the nodes kept."""
        k = list(keep)
        arrays = (
            "axis",
            "place",
            "reference",
            "inertia",
            "anchor",
            "armature",
            "damping",
            "frictionloss",
            "stiffness",
            "spring",
            "lower",
            "upper",
            "velocity",
            "effort",
        )
        out: dict[str, Any] = {name: getattr(self, name)[k] for name in arrays}
        out["lifted"] = None if self.lifted is None else self.lifted[k]
        for name in ("joints", "links", "slides"):
            of_all = getattr(self, name)
            out[name] = tuple(of_all[i] for i in k)
        return out

    def locked(self, pose: Mapping[str, float]) -> Tree:
        """The same with these joints (and what follows them) held; their bodies belong to what
        carries them.
        """
        held = {self.joint(name): float(value) for name, value in pose.items()}
        for c in self.couplings:
            if c.leader in pose:
                held[self.joint(c.follower)] = float(c.at(float(pose[c.leader])))
        if not held:
            return self
        keep = [k for k in range(self.n) if k not in held]
        number = {k: i for i, k in enumerate(keep)}
        fields = self.taken(keep)
        inertia, places, parents = fields["inertia"].copy(), [], []
        lifted = None if self.lifted is None else fields["lifted"].copy()
        trunk = np.array(self.trunk)
        # held node -> (node that carries it or -1, its frame there)
        carrier: dict[int, tuple[int, np.ndarray]] = {}
        for k in range(self.n):  # parents stand before their children
            up, T = self.parent[k], self.place[k]
            if up in carrier:
                up, before = carrier[up]
                T = before @ T
            if k not in held:
                places.append(T)
                parents.append(number.get(up, -1))
                continue
            T = T @ motion(self.axis[k], self.slides[k], held[k] - self.reference[k])
            carrier[k] = up, T
            if up < 0:
                trunk += turned(self.inertia[k], T)
                continue
            inertia[number[up]] += turned(self.inertia[k], T)
            if lifted is not None and self.lifted is not None:
                lifted[number[up]] += turned(self.lifted[k], T)
        own = {
            **fields,
            "place": np.array(places).reshape(-1, 4, 4),
            "inertia": inertia,
            "lifted": lifted,
            "parent": tuple(parents),
        }
        own["trunk"] = tuple(trunk.tolist())
        values = {self.joints[k]: value for k, value in held.items()}
        return replace(self._without(values.keys()), **own, held={**self.held, **values})

    def _without(self, gone: Collection[str]) -> Tree:
        """What is said of joints, without those that are gone."""

        def left(of_joints: Mapping[str, Any]) -> dict[str, Any]:
            return {joint: value for joint, value in of_joints.items() if joint not in gone}

        couplings = [c for c in self.couplings if not {c.follower, c.leader} & set(gone)]
        ties = [t for t in self.ties if set(t.joints) & set(self.joints) - set(gone)]
        return replace(
            self,
            couplings=tuple(couplings),
            actuators=left(self.actuators),
            poses={name: left(pose) for name, pose in self.poses.items()},
            ties=tuple(ties),
        )

    def path_to(self, link: str) -> tuple[str, ...]:
        """Joints between the base and a link."""
        if link not in self.links:
            raise UsageError(
                f"{self.file}: no joint moves a link"
                f" {link!r}{nearest(link, [n for n in self.links if n])}; the ends are"
                f" {', '.join(self.ends)}"
            )
        k, out = self.links.index(link), []
        while k >= 0:
            out.append(self.joints[k])
            k = self.parent[k]
        return tuple(reversed(out))

    def swung(self) -> np.ndarray:
        """Inertia about each joint's axis of all that hangs on it at the reference (mass where it
        slides), [n].
        """
        total, out = self.inertia.copy(), np.zeros(self.n)
        for k in reversed(range(self.n)):
            xx, xy, xz, yy, yz, zz = total[k, :6]
            about = (
                self.axis[k] @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ self.axis[k]
            )
            out[k] = total[k, 9] if self.slides[k] else about
            if self.parent[k] >= 0:
                total[self.parent[k]] += turned(total[k], self.place[k])
        return out

    def size(self, node: int) -> float:
        """Length of a link, m: to the next joints, or twice as far as its centre of mass; at least
        0.02.
        """
        ends = [
            float(np.linalg.norm(self.place[k][:3, 3]))
            for k, up in enumerate(self.parent)
            if up == node
        ]
        m = float(self.inertia[node][9])
        com = float(np.linalg.norm(self.inertia[node][6:9])) / m if m > 0 else 0.0
        return max(0.02, 2 * com, *ends)

    def free_moments(self) -> set[str]:
        """Numbers com_x@LINK … of first moments that gravity shows: across the axis of a hinge, and
        not where that stands upright on the base. A base that floats falls with the rest: nothing
        shows.
        """
        out: set[str] = set()
        if self.floats:
            return out
        turn = [np.eye(3)] * self.n
        moved = [False] * self.n  # whether a joint before this one turns it
        down = np.array(self.gravity) / max(float(np.linalg.norm(self.gravity)), 1e-12)
        for k, up in enumerate(self.parent):
            turn[k] = (turn[up] if up >= 0 else np.eye(3)) @ self.place[k][:3, :3]
            moved[k] = up >= 0 and (moved[up] or not self.slides[up])
            upright = not moved[k] and abs((turn[k] @ self.axis[k]) @ down) > 1 - 1e-6
            if self.links[k] and not self.slides[k] and not upright and np.any(down):
                across = np.argsort(np.abs(self.axis[k]))[:2]
                out |= {f"com_{'xyz'[i]}@{self.links[k]}" for i in across}
        return out

    def neutral(self, joint: str) -> float:
        """Where a joint that nobody moves is held: the first pose of the file, else its
        reference.
        """
        k = self.joint(joint)
        pose: Mapping[str, float] = next(iter(self.poses.values()), {})
        return float(pose.get(joint, np.clip(self.reference[k], self.lower[k], self.upper[k])))

    def limbs(self) -> tuple[tuple[str, ...], ...]:
        """Leading joints by limb: what hangs on the base at one joint; couplings join limbs. On a
        fixed base limbs do not move each other.
        """
        root = list(range(self.n))
        for k, up in enumerate(self.parent):
            root[k] = root[up] if up >= 0 else k
        for c in self.couplings:
            ends = {root[self.joint(c.follower)], root[self.joint(c.leader)]}
            for k, r in enumerate(root):
                if r in ends:
                    root[k] = min(ends)
        groups: dict[int, list[str]] = {}
        for k, name in enumerate(self.joints):
            if name in self.leading:
                groups.setdefault(root[k], []).append(name)
        return tuple(map(tuple, groups.values()))

    def only(self, joints: Sequence[str]) -> Tree:
        """The limbs of these joints alone; they must be whole limbs."""
        wanted = {*joints, *(c.follower for c in self.couplings if c.leader in joints)}
        keep = [k for k, name in enumerate(self.joints) if name in wanted]
        number = {-1: -1} | {k: i for i, k in enumerate(keep)}
        return replace(
            self,
            **self.taken(keep),
            parent=tuple(number[self.parent[k]] for k in keep),
            couplings=tuple(c for c in self.couplings if c.follower in wanted),
            actuators={k: a for k, a in self.actuators.items() if k in wanted},
        )

    def follow(self) -> tuple[np.ndarray, np.ndarray]:
        """(S [n leading], c [n]) with the positions of all joints S q + c; curves as the lines that
        touch them.
        """
        leading = self.leading
        S, c = np.zeros((self.n, len(leading))), np.zeros(self.n)
        for k, name in enumerate(self.joints):
            if name in leading:
                S[k, leading.index(name)] = 1.0
        for one in self.couplings:
            k = self.joint(one.follower)
            S[k, leading.index(one.leader)], c[k] = one.ratio, one.offset
        return S, c


class StaticTree:
    """A tree as a value that compares and hashes by its content, for static fields of modules."""

    def __init__(self, tree: Tree):
        self.tree = tree
        # Steps are of another simulator, and the text holds what is drawn and touched as well.
        own = [v for k, v in vars(tree).items() if k not in ("steps", "text")]
        parts = []
        for v in own:
            parts.append(v.tobytes().hex() if isinstance(v, np.ndarray) else repr(v))
        self._key = hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StaticTree) and other._key == self._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __repr__(self) -> str:
        return f"StaticTree({self._key})"


def turned(inertia: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Ten numbers of a body, from the frame that stands at T into the frame around it."""
    x, y, z, p = (tuple(T[:3, k]) for k in range(4))
    return np.array(moved(Placements(x, y, z, p), inertia))


def motion(axis: np.ndarray, slides: bool, q: float) -> np.ndarray:
    """[4 4] of a joint at position q."""
    T = np.eye(4)
    if slides:
        T[:3, 3] = q * axis
        return T
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T[:3, :3] = np.eye(3) + np.sin(q) * K + (1 - np.cos(q)) * K @ K
    return T


def roll_pitch_yaw(R: np.ndarray) -> tuple[float, float, float]:
    """Angles of R = Rz(yaw) Ry(pitch) Rx(roll), accurate at every pitch."""
    yaw = np.arctan2(R[1, 0], R[0, 0]) if np.hypot(R[1, 0], R[0, 0]) > 1e-12 else 0.0
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ R
    pitch = np.arctan2(-R[2, 0], R[0, 0])
    c, s = np.cos(pitch), np.sin(pitch)
    R = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) @ R
    return float(np.arctan2(R[2, 1], R[2, 2])), float(pitch), float(yaw)


def rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def up_to(tree: Tree, tip: str | None) -> Tree:
    """The tree with only the joints up to a link free to move."""
    if tip is None:
        return tree
    path = tree.path_to(tip)
    held = [j for j in tree.leading if j not in path]
    locked = tree.locked({j: tree.neutral(j) for j in held})
    gone = [j for j in tree.joints if j not in locked.joints]
    note = (f"only the joints up to {tip} move; held: {', '.join(gone)}",) if gone else ()
    return replace(locked, notes=(*tree.notes, *note))
