"""What an MJCF file lets act among several joints and a tree of single joints cannot express:
tendons and loops.

The joints that such a tie acts on are named with it. They are held together, or the robot is
refused: see `jaxid.robots.match`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxid.base.wording import names_of
from jaxid.robots.tree import Coupling, Tie


#: Fields of a tendon that let it push or brake.
PUSHES = ("stiffness", "damping", "frictionloss", "armature")


@dataclass(frozen=True)
class Tendon:
    """A tendon that acts: the joints that it runs over, and the bodies (through sites and geoms),
    by name.
    """

    name: str
    joints: tuple[str, ...]
    bodies: tuple[str, ...]


def acting_tendons(mujoco: Any, spec: Any) -> tuple[list[Tendon], list[str]]:
    """(tendons of a spec that drive, couple or brake, names that are used and stand nowhere)."""
    used = {a.target for a in spec.actuators if a.trntype == mujoco.mjtTrn.mjTRN_TENDON}
    for e in spec.equalities:
        if e.type == mujoco.mjtEq.mjEQ_TENDON:
            used |= {name for name in (e.name1, e.name2) if name}
    automatic = bool(spec.compiler.autolimits)
    acting = []
    for tendon in spec.tendons:
        pushes = any(np.any(np.asarray(getattr(tendon, field)) != 0) for field in PUSHES)
        stated = int(tendon.limited)
        ranged = automatic and bool(np.any(np.asarray(tendon.range) != 0))
        limited = stated == 1 or (stated == 2 and ranged)
        if pushes or limited or tendon.name in used:
            acting.append(_run_of(mujoco, tendon))
    lost = sorted(used - set(names_of(spec.tendons)))
    return acting, lost


def _run_of(mujoco: Any, tendon: Any) -> Tendon:
    kinds = mujoco.mjtWrap
    joints, bodies = [], []
    for wrap in tendon.path:
        if wrap.type == kinds.mjWRAP_PULLEY:
            continue
        target = wrap.target
        if wrap.type == kinds.mjWRAP_JOINT:
            joints.append(target.name)
        else:
            bodies.append(target.parent.name)
    return Tendon(tendon.name, tuple(joints), tuple(bodies))


def without_tendons(mujoco: Any, spec: Any) -> None:
    """Deletes tendons and what refers to them."""
    kinds = mujoco.mjtTrn
    for actuator in [a for a in spec.actuators if a.trntype == kinds.mjTRN_TENDON]:
        spec.delete(actuator)
    for equality in [e for e in spec.equalities if e.type == mujoco.mjtEq.mjEQ_TENDON]:
        spec.delete(equality)
    for tendon in list(spec.tendons):
        spec.delete(tendon)
    for key in spec.keys:  # their commands count the actuators that are gone
        key.ctrl, key.act = [], []


class Ties:
    """Collects ties of a compiled model, whose tendons are given. `joint` names a joint by its
    number.
    """

    def __init__(self, mujoco: Any, model: Any, joint: Any):
        self.mj, self.m, self.joint = mujoco, model, joint
        self.found: list[Tie] = []

    def add(self, what: str, joints: Iterable[str]) -> None:
        self.found.append(Tie(what, tuple(dict.fromkeys(joints))))

    def above(self, body: int) -> list[int]:
        """Numbers of the joints that carry a body, from the base on; a free joint counts among
        them.
        """
        m, out = self.m, []
        while body > 0:
            first = int(m.body_jntadr[body])
            own = range(first, first + int(m.body_jntnum[body]))
            out = [*own, *out]
            body = int(m.body_parentid[body])
        return out

    def between(self, bodies: Sequence[int]) -> list[str]:
        """Names of the joints that move some bodies against each other: those that do not carry all
        of them.
        """
        paths = [self.above(b) for b in bodies]
        common = set(paths[0]).intersection(*paths[1:])
        numbers = sorted(set().union(*paths) - common)
        single = [j for j in numbers if int(self.m.jnt_type[j]) in self.singles()]
        return [self.joint(j) for j in single]

    def singles(self) -> tuple[int, int]:
        kinds = self.mj.mjtJoint
        return int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE)

    def behind(self, joint: int) -> list[str]:
        """Names of hinge and slide joints that a joint carries."""
        numbers = [j for j in range(self.m.njnt) if joint in self.above(int(self.m.jnt_bodyid[j]))]
        return [
            self.joint(j)
            for j in numbers
            if int(self.m.jnt_type[j]) in self.singles() and j != joint
        ]

    def tendons(self, tendons: Sequence[Tendon]) -> None:
        def body(name):
            return self.mj.mj_name2id(self.m, self.mj.mjtObj.mjOBJ_BODY, name)

        for tendon in tendons:
            bodies = [number for name in tendon.bodies if (number := body(name)) >= 0]
            moved = self.between(bodies) if bodies else []
            self.add(f"tendon {tendon.name!r}", (*tendon.joints, *moved))

    def loop(self, equality: int, what: str) -> None:
        """A connection or weld of two bodies, or of two sites."""
        ends = [int(self.m.eq_obj1id[equality]), int(self.m.eq_obj2id[equality])]
        if int(self.m.eq_objtype[equality]) == int(self.mj.mjtObj.mjOBJ_SITE):
            ends = [int(self.m.site_bodyid[site]) for site in ends]
        self.add(what, self.between(ends))


def resolved(couplings: Sequence[Coupling]) -> tuple[tuple[Coupling, ...], list[Coupling]]:
    """(couplings to joints that lead, those that have no such leader): what follows a follower
    follows its leader; a joint that follows two, or itself round a circle, follows none.
    """
    names = [c.follower for c in couplings]
    by_name = {c.follower: c for c in couplings if names.count(c.follower) == 1}
    out, left = [], []
    for c in couplings:
        end = _led(c, by_name) if c.follower in by_name else None
        if end is None or (end.leader in names):
            left.append(c)
        else:
            out.append(end)
    return tuple(out), left


def _led(c: Coupling, by_name: Mapping[str, Coupling]) -> Coupling | None:
    """The coupling to the first joint of a row of followers; None where they run in a circle."""
    seen = {c.follower}
    while c.leader in by_name:
        if c.leader in seen:
            return None
        seen.add(c.leader)
        up = by_name[c.leader]
        c = c.through(up)
    return c
