"""Robots from MJCF files, as MuJoCo compiles them: defaults, classes, angles and frames are its
own.

A file is a stranger's input. It is parsed without entities; what it includes must lie beside it and
be of sensible size; meshes, textures and everything else that is drawn are dropped before
compiling. Only meshes that give an inertia are read (see `mjcf_meshes`). What a tree of hinge and
slide joints cannot express is refused by name.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.dynamics.rigid_body import about_origin
from jaxid.robots.curves import Curve, Polynomial
from jaxid.robots.file_step import file_step
from jaxid.robots.mjcf_spec import compilable, compiled, first_of, library
from jaxid.robots.mjcf_text import expanded
from jaxid.robots.mjcf_ties import resolved, Tendon, Ties
from jaxid.robots.steps import steps_of
from jaxid.robots.tree import Actuator, Coupling, Tree, turned


def read_mjcf(path: str | Path, text: str | None = None) -> Tree:
    """The tree of a robot in an MJCF file; with `text` that is read, and the path only names it
    (and its includes' folder).

    A free joint at the root is left out: the base is fixed where the file puts it. Raises
    `UsageError` naming the element.
    """
    path = Path(path)
    whole = expanded(path, text)
    spec, tendons = compilable(path, whole)
    model = compiled(path, spec)
    return replace(_Reader(path, model, tendons).tree(), text=whole)


class _Reader:
    """Reads a compiled model, whose numbers are all resolved."""

    def __init__(self, path: Path, model: Any, tendons: Sequence[Tendon]):
        mujoco = library()
        self.path, self.m, self.mj, self.tendons = path, model, mujoco, tendons
        self.notes: list[str] = []
        self.ties = Ties(mujoco, model, lambda j: self.name("JOINT", j))

    def name(self, kind: str, index: int) -> str:
        own = self.mj.mj_id2name(self.m, getattr(self.mj.mjtObj, f"mjOBJ_{kind}"), int(index))
        return own or f"{kind.lower()}{int(index)}"

    def refuse(self, text: str) -> UsageError:
        return UsageError(f"{self.path}: {text}")

    def tree(self) -> Tree:
        m, mj = self.m, self.mj
        joints, links, parent, slides, axis, place = [], [], [], [], [], []
        inertia, lifted, anchor, number = [], [], [], []
        carrier = {0: (-1, np.eye(4))}  # body -> (node that carries it, its frame there)
        trunk, root, free, base = (
            np.zeros(10),
            np.eye(4),
            [0],
            "world",
        )  # of what the base is: all of the world, or the first free body
        for b in range(1, m.nbody):
            node, T = carrier[int(m.body_parentid[b])]
            T = T @ pose(m.body_pos[b], m.body_quat[b])
            first = int(m.body_jntadr[b])
            own = range(first, first + int(m.body_jntnum[b]))
            here = np.zeros(3)  # origin of the last node in the body's frame
            for j in own:
                kind = int(m.jnt_type[j])
                if kind == mj.mjtJoint.mjJNT_FREE:
                    self.notes.append(
                        f"joint {self.name('JOINT', j)!r} is free: the base is taken as fixed where"
                        " the file puts it"
                    )
                    if free == [0]:
                        trunk, root, free, base = np.zeros(10), T, [b], self.name("BODY", b)
                    continue
                if kind == mj.mjtJoint.mjJNT_BALL:
                    self.ball(j)
                    continue
                at = np.eye(4)
                at[:3, 3] = m.jnt_pos[j] - here
                parent.append(node)
                place.append(T @ at)
                T, here, node = np.eye(4), np.array(m.jnt_pos[j], np.float64), len(joints)
                joints.append(self.name("JOINT", j))
                slides.append(kind == mj.mjtJoint.mjJNT_SLIDE)
                axis.append(m.jnt_axis[j].copy())
                links.append("")
                inertia.append(np.zeros(10))
                lifted.append(np.zeros(10))
                anchor.append(here)
                number.append(j)
            back = np.eye(4)
            back[:3, 3] = -here
            carrier[b] = node, (T @ back)
            if node < 0 and (free == [0] or b in free or int(m.body_parentid[b]) in free):
                trunk = trunk + turned(self.ten(b), carrier[b][1])
                free = [*free, b]
            if node >= 0:
                if parent and len(own) and links[node] == "" and node == len(joints) - 1:
                    links[node] = self.name("BODY", b)
                ten = turned(self.ten(b), carrier[b][1])
                inertia[node] = inertia[node] + ten
                lifted[node] = lifted[node] + m.body_gravcomp[b] * ten
        if not joints:
            raise self.refuse(self.without_joints())
        for k, joint in enumerate(joints):
            if not self.carries(k, parent, inertia):
                raise self.refuse(
                    f"nothing of mass hangs on {links[k] or joint!r}; state its <inertial>"
                )
        j, dof = np.array(number), m.jnt_dofadr[number]
        self.refuse_curved_springs(number)
        damping = np.column_stack([m.dof_damping[dof], m.dof_dampingpoly[dof]])[:, :3]
        limited = m.jnt_limited[j].astype(bool)
        force = [self.joint_force(k) for k in j]
        self.ties.tendons(self.tendons)
        couplings, fixed = self.couplings()
        self.options()
        self.lifting()
        actuators = self.actuators(number)
        tree = Tree(
            file=str(self.path),
            joints=tuple(joints),
            links=tuple(links),
            parent=tuple(parent),
            slides=tuple(slides),
            axis=np.array(axis),
            place=np.array(place),
            reference=m.qpos0[m.jnt_qposadr[j]].copy(),
            inertia=np.array(inertia),
            anchor=np.array(anchor),
            armature=m.dof_armature[dof] + self.added(number, "actuator_armature"),
            damping=damping
            + np.column_stack(
                [self.added(number, "actuator_damping"), np.zeros((len(j), damping.shape[1] - 1))]
            ),
            frictionloss=m.dof_frictionloss[dof].copy(),
            stiffness=np.ravel(m.jnt_stiffness[j]).copy(),
            spring=m.qpos_spring[m.jnt_qposadr[j]].copy(),
            lower=np.where(limited, m.jnt_range[j, 0], -np.inf),
            upper=np.where(limited, m.jnt_range[j, 1], np.inf),
            velocity=np.full(len(j), np.inf),
            effort=np.array([max(abs(low), abs(high)) for low, high in force]),
            couplings=couplings,
            actuators=actuators,
            poses=self.poses(number, joints),
            gravity=tuple(map(float, m.opt.gravity)),  # pyright: ignore
            base="world",
            impossible=(),
            notes=tuple(dict.fromkeys(self.notes)),
            trunk=tuple(trunk.tolist()),
            root=tuple(root.ravel().tolist()),
            carrier=base,
            steps=steps_of(self.mj, m),
            simulator=file_step(self.mj, m, dict(zip(joints, number, strict=True))),
            ties=tuple(t for t in self.ties.found if t.joints),
            lifted=np.array(lifted) if m.body_gravcomp.any() else None,
        )
        return tree.locked(fixed)

    def refuse_curved_springs(self, number: Sequence[int]) -> None:
        """Raises `UsageError` for a spring that is not linear."""
        for field in ("jnt_stiffnesspoly", "jnt_springyield"):
            curved = getattr(self.m, field, None)
            for j in number:
                if curved is not None and np.any(curved[j]):
                    raise self.refuse(
                        f"joint {self.name('JOINT', j)!r} has a spring that is not linear, which"
                        " is not simulated"
                    )

    def without_joints(self) -> str:
        """What to say of a file in which nothing can be fitted."""
        if self.m.njnt:
            return "it moves freely or turns on balls alone; jaxid takes hinge and slide joints"
        return "nothing moves in it: it has no joint"

    def ten(self, b: int) -> np.ndarray:
        """Ten numbers of a body about its own frame."""
        m = self.m
        R = pose(np.zeros(3), m.body_iquat[b])[:3, :3]
        I = R @ np.diag(m.body_inertia[b]) @ R.T
        return about_origin(m.body_mass[b], m.body_ipos[b], I[np.triu_indices(3)])

    def carries(self, node: int, parent: list[int], inertia: list[np.ndarray]) -> bool:
        return inertia[node][9] > 0 or any(
            self.carries(k, parent, inertia) for k, up in enumerate(parent) if up == node
        )

    def options(self) -> None:
        o, flags = self.m.opt, int(self.m.opt.disableflags)
        if o.density or o.viscosity or np.any(o.wind):
            self.notes.append("the file's fluid (density, viscosity, wind) is not simulated")
        if flags & int(self.mj.mjtDisableBit.mjDSBL_GRAVITY):
            raise self.refuse(
                '<flag gravity="disable"> is not read: write <option gravity="0 0 0"/>'
            )

    def lifting(self) -> None:
        """What is to be said of bodies whose weight the file cancels."""
        m = self.m
        bodies = [self.name("BODY", b) for b in np.flatnonzero(m.body_gravcomp).tolist()]
        if not bodies:
            return
        self.notes.append(
            f"the weight of {first_of(bodies)} is cancelled as by gravcomp of the file"
        )
        counted = m.jnt_actgravcomp.astype(bool) & m.jnt_actfrclimited.astype(bool)
        joints = [self.name("JOINT", j) for j in np.flatnonzero(counted).tolist()]
        if joints:
            self.notes.append(
                f"actuatorgravcomp of {first_of(joints)}: what cancels weight does not count "
                "against the limit of the drive here, and does in MuJoCo"
            )

    def joint_force(self, j: int) -> tuple[float, float]:
        m = self.m
        return (
            tuple(map(float, m.jnt_actfrcrange[j])) if m.jnt_actfrclimited[j] else (-np.inf, np.inf)
        )  # type: ignore[return-value]

    def ball(self, j: int) -> None:
        """A ball joint is held where the file puts it, and everything behind it with it."""
        name = self.name("JOINT", j)
        self.notes.append(
            f"joint {name!r} is a ball joint: held where the file puts it (jaxid takes hinge and"
            " slide joints)"
        )
        self.ties.add(f"ball joint {name!r}", self.ties.behind(j))

    def couplings(self) -> tuple[tuple[Coupling, ...], dict[str, float]]:
        """(joints that follow another one, joints that an equality holds); what is neither is a
        tie.
        """
        m, mj = self.m, self.mj
        out, fixed = [], {}
        for e in range(m.neq):
            if not m.eq_active0[e]:
                continue
            name, kind = self.name("EQUALITY", e), int(m.eq_type[e])
            if kind != mj.mjtEq.mjEQ_JOINT:
                self.loop(e, name, kind)
                continue
            a, b = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
            first = self.name("JOINT", a)
            c = m.eq_data[e, :5]
            start = m.qpos0[m.jnt_qposadr[a]]
            if b < 0:
                fixed[first] = float(start + c[0])
                continue
            out.append(Coupling.by(first, self.name("JOINT", b), self.curve(c, float(start), b)))
        couplings, rest = resolved(out)
        for c in rest:
            self.ties.add(
                f"equality of {c.follower!r} with {c.leader!r}, one of several",
                (c.follower, c.leader),
            )
        return couplings, fixed

    def curve(self, c: np.ndarray, start: float, leader: int) -> Curve:
        """Of a joint that leaves `start` by the polynomial `c` of how far its leader has left its
        own.
        """
        m = self.m
        own = float(m.qpos0[m.jnt_qposadr[leader]])
        moved = np.polynomial.Polynomial(c)(np.polynomial.Polynomial([-own, 1.0])).coef
        coefficients = np.zeros(5)
        coefficients[: len(moved)] = moved
        coefficients[0] += start
        low, high = map(float, m.jnt_range[leader])
        limited = bool(m.jnt_limited[leader]) and low < high
        ends = (low, high) if limited else (-np.inf, np.inf)
        about = (low + high) / 2 if limited else own
        return Curve((Polynomial(tuple(map(float, coefficients)), *ends),), about)

    def loop(self, e: int, name: str, kind: int) -> None:
        """An equality between bodies."""
        kinds = self.mj.mjtEq
        what = kinds(kind).name.removeprefix("mjEQ_").lower()
        if kind not in (int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD)):
            raise self.refuse(f"equality {name!r} is of the kind {what}, which is not read")
        self.ties.loop(e, f"equality {name!r} ({what}), which closes a loop or ties bodies")

    def added(self, number: list[int], field: str) -> np.ndarray:
        """What actuators add to their joints' armature or damping, by the square of the gear."""
        out, values = np.zeros(len(number)), getattr(self.m, field, None)
        if values is None:
            return out
        for a, j in self.on_joints():
            if j in number:
                out[number.index(j)] += (
                    float(np.ravel(values[a])[0]) * self.m.actuator_gear[a, 0] ** 2
                )
        return out

    def on_joints(self) -> Iterable[tuple[int, int]]:
        """(actuator, joint) of those that act on one joint."""
        m, trn = self.m, self.mj.mjtTrn
        for a in range(m.nu):
            if int(m.actuator_trntype[a]) in (int(trn.mjTRN_JOINT), int(trn.mjTRN_JOINTINPARENT)):
                yield a, int(m.actuator_trnid[a, 0])

    def actuators(self, number: list[int]) -> dict[str, Actuator]:
        m = self.m
        on = dict(self.on_joints())
        for a in range(m.nu):
            if a not in on:
                what = (
                    self.mj.mjtTrn(int(m.actuator_trntype[a])).name.removeprefix("mjTRN_").lower()
                )
                self.notes.append(
                    f"actuator {self.name('ACTUATOR', a)!r} acts on a {what}, not on a joint:"
                    " left out"
                )
        out: dict[str, Actuator] = {}
        for a, j in on.items():
            if j in number:
                joint, one = self.name("JOINT", j), self.actuator(a, j)
                if joint in out and "position" in (one.kind, out[joint].kind):
                    one = Actuator(f"{out[joint].name} and {one.name}", "several")
                out[joint] = one
        return out

    def actuator(self, a: int, j: int) -> Actuator:
        """The law of one actuator at its joint. `other` where it is none of motor, position and
        velocity.
        """
        m = self.m
        gear = float(m.actuator_gear[a, 0])
        gain = float(m.actuator_gainprm[a][0])
        b0, b1, b2 = self.bias(a)
        kind = _kind_of(gain, b1, b2)
        if kind == "position" and abs(gear - 1) > 1e-9:
            self.notes.append(
                f"actuator {self.name('ACTUATOR', a)!r} has a gear of {gear:g}: its goal is a"
                f" position of the joint, ctrl / {gear:g}"
            )
        low, high = self.actuator_force(a, j, gear)
        return Actuator(
            name=self.name("ACTUATOR", a),
            kind=kind if self.is_simulated(a) else "other",
            kp=-b1 * gear * gear,
            kd=-b2 * gear * gear,
            gain=gain,
            offset=b0 * gear,
            force=(min(low * gear, high * gear), max(low * gear, high * gear)),
            control=self.control(a, gear),
            lag=float(m.actuator_dynprm[a, 0]) if self.lags(a) else 0.0,
            delay=float(m.actuator_delay[a]),
        )

    def bias(self, a: int) -> tuple[float, float, float]:
        """Force of an actuator by itself, for each position and each speed."""
        if int(self.m.actuator_biastype[a]) != int(self.mj.mjtBias.mjBIAS_AFFINE):
            return 0.0, 0.0, 0.0
        b0, b1, b2 = map(float, self.m.actuator_biasprm[a][:3])
        return b0, b1, b2

    def lags(self, a: int) -> bool:
        """Whether an actuator has a filter of first order."""
        kinds = self.mj.mjtDyn
        filters = int(kinds.mjDYN_FILTER), int(kinds.mjDYN_FILTEREXACT)
        return int(self.m.actuator_dyntype[a]) in filters

    def is_simulated(self, a: int) -> bool:
        """Whether an actuator is of a kind that a law at its joint says."""
        m, mj = self.m, self.mj
        fixed = int(m.actuator_gaintype[a]) == int(mj.mjtGain.mjGAIN_FIXED)
        biases = int(mj.mjtBias.mjBIAS_NONE), int(mj.mjtBias.mjBIAS_AFFINE)
        linear = fixed and int(m.actuator_biastype[a]) in biases
        at_once = int(m.actuator_dyntype[a]) == int(mj.mjtDyn.mjDYN_NONE)
        geared = m.actuator_gear[a, 0] != 0
        return bool(linear and geared and (at_once or self.lags(a)))

    def actuator_force(self, a: int, j: int, gear: float) -> tuple[float, float]:
        """Limits of an actuator's force before its gear, by its own and by its joint's."""
        low, high = -np.inf, np.inf
        if self.m.actuator_forcelimited[a]:
            low, high = map(float, self.m.actuator_forcerange[a])
        if not gear:
            return low, high
        ends = [end / gear for end in self.joint_force(j)]
        return max(low, min(ends)), min(high, max(ends))

    def control(self, a: int, gear: float) -> tuple[float, float]:
        """Limits of an actuator's control, at its joint."""
        if not self.m.actuator_ctrllimited[a] or not gear:
            return -np.inf, np.inf
        low, high = sorted(float(v) / gear for v in self.m.actuator_ctrlrange[a])
        return low, high

    def poses(self, number: list[int], joints: list[str]) -> dict[str, dict[str, float]]:
        m = self.m
        at = m.jnt_qposadr[number]
        return {
            self.name("KEY", k): dict(zip(joints, map(float, m.key_qpos[k][at]), strict=True))
            for k in range(m.nkey)
        }


def _kind_of(gain: float, b1: float, b2: float) -> str:
    """The kind of an actuator by its gain and its bias for each position and each speed."""
    if b1 == 0 and b2 == 0:
        return "motor"
    if b1 < 0 and abs(gain + b1) <= 1e-9 * abs(b1):
        return "position"
    if b1 == 0 and abs(gain + b2) <= 1e-9 * abs(b2):
        return "velocity"
    return "other"


def pose(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """[4 4] of a position and a unit quaternion (w x y z)."""
    w, x, y, z = np.asarray(quaternion, np.float64) / np.linalg.norm(quaternion)
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, 3] = position
    return T
