"""A robot's file in MuJoCo, driven along a recording: drawings and a free base are left out, and
contacts where they are not asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.robots.drives import DriveLaw
from jaxid.robots.mjcf_spec import compilable, library
from jaxid.robots.mjcf_text import expanded
from jaxid.robots.tree import Tree


#: Armature of a joint that is held, kg m^2. With 1e9 MuJoCo's solver of contacts and friction loses
#: its digits, and dry friction elsewhere creeps by other amounts.
HELD = 1e6
#: Longest time step of a file that states none (a URDF), s.
STEP = 1e-3
#: Most steps of one run.
MOST_STEPS = 50_000_000
#: Steps that are taken in one call.
BLOCK = 4096


@dataclass(frozen=True)
class Driven:
    """What moves the joints: goals through the file's actuators, goals through a `law`, torques, or
    nothing ("goal", "law", "torque", "free"). Torques go through motors in the units that those of
    `reference` have.
    """

    kind: str
    law: DriveLaw | None
    reference: MujocoRobot


class MujocoRobot:
    """The compiled model of a file, with joints `held` and gravity as given; a continuous pd `law`
    of some joints becomes actuators in the place of the file's own, so that MuJoCo integrates it
    like those. `contacts`: its planes and plain shapes touch. Raises `UsageError`.
    """

    def __init__(
        self,
        path: Path,
        tree: Tree,
        held: Mapping[str, float],
        gravity: np.ndarray | None,
        joints: Sequence[str] = (),
        law: DriveLaw | None = None,
        contacts: bool = False,
    ):
        self.mj: Any = library()
        self.notes: list[str] = []
        self.contacts = contacts
        spec = self._of_tree(tree, law) if path.suffix.lower() == ".urdf" else self._of_file(path)
        for joint in held:
            spec.joint(joint).armature = HELD
        self.spec = spec
        self.continuous = law is not None and law.period <= 0 and law.kind == "pd"
        if law is not None and self.continuous:
            self._drive(spec, joints, law)
        try:
            self.model = spec.compile()
        except (ValueError, self.mj.FatalError) as error:
            raise UsageError(
                f"{path}: MuJoCo does not take it: {' '.join(str(error).split())}"
            ) from None
        if gravity is not None:
            self.model.opt.gravity[:] = gravity
        self.held = dict(held)

    def _of_file(self, path: Path) -> Any:
        spec, _ = compilable(path, expanded(path), self.contacts)
        for key in list(spec.keys):
            spec.delete(key)
        kinds = self.mj.mjtJoint
        for joint in list(spec.joints):
            if joint.type == kinds.mjJNT_BALL:  # held, as jaxid has it
                spec.delete(joint)
            elif joint.type == kinds.mjJNT_FREE:
                spec.delete(joint)
                self.notes.append("the base is held where the file puts it, as jaxid has it")
        for loop in [e for e in spec.equalities if e.type != self.mj.mjtEq.mjEQ_JOINT]:
            spec.delete(loop)  # all of its joints are held
        return spec

    def _of_tree(self, tree: Tree, law: DriveLaw | None) -> Any:
        """A URDF as jaxid reads it: MuJoCo's own import drops what is fixed to the root, limits and
        drives.
        """
        mj = self.mj
        spec = mj.MjSpec()
        spec.compiler.degree = False
        stiffest = (
            np.sqrt(max(law.kp) / float((tree.swung() + tree.armature).min()))
            if law is not None
            else 0.0
        )
        step = float(np.clip(0.2 / max(stiffest, 1e-9), STEP / 10, STEP))
        spec.option.timestep, spec.option.integrator = step, mj.mjtIntegrator.mjINT_IMPLICITFAST
        bodies: list[Any] = []
        for k, name in enumerate(tree.joints):
            above = spec.worldbody if tree.parent[k] < 0 else bodies[tree.parent[k]]
            quat = np.zeros(4)
            mj.mju_mat2Quat(quat, np.ascontiguousarray(tree.place[k][:3, :3]).ravel())
            body = above.add_body(name=f"body of {name}", pos=tree.place[k][:3, 3], quat=quat)
            xx, xy, xz, yy, yz, zz, hx, hy, hz, m = tree.inertia[k]
            m = max(float(m), 1e-9)
            c = np.array([hx, hy, hz]) / m
            I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - m * (
                c @ c * np.eye(3) - np.outer(c, c)
            )
            I = I + max(0.0, 1e-12 - float(np.linalg.eigvalsh(I)[0])) * np.eye(3)
            body.mass, body.ipos, body.explicitinertial = m, c, True
            body.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
            kind = mj.mjtJoint.mjJNT_SLIDE if tree.slides[k] else mj.mjtJoint.mjJNT_HINGE
            body.add_joint(
                name=name,
                type=kind,
                axis=tree.axis[k],
                damping=[*tree.damping[k]],
                frictionloss=tree.frictionloss[k],
                armature=tree.armature[k],
                solref_friction=[2 * step, 1.0],
                solimp_friction=[0.99, 0.9999, 0.001, 0.5, 2.0],
            )
            bodies.append(body)
        for c in tree.couplings:
            spec.add_equality(
                type=mj.mjtEq.mjEQ_JOINT,
                name1=c.follower,
                name2=c.leader,
                objtype=mj.mjtObj.mjOBJ_JOINT,
                data=[c.offset, c.ratio, 0, 0, 0, 0, 0, 0, 0, 0, 0],
            )
        spec.compiler.balanceinertia = True
        self.notes.append(f"the URDF runs in MuJoCo as jaxid reads it, with steps of {step:.2g} s")
        return spec

    def _drive(self, spec: Any, joints: Sequence[str], law: DriveLaw) -> None:
        mj = self.mj
        for one in [a for a in spec.actuators if a.target in joints]:
            spec.delete(one)
        for k, joint in enumerate(joints):
            g, big = law.gain[k], 1e12
            a = spec.add_actuator(
                name=f"law of {joint}", target=joint, trntype=mj.mjtTrn.mjTRN_JOINT
            )
            a.gaintype, a.biastype = mj.mjtGain.mjGAIN_FIXED, mj.mjtBias.mjBIAS_AFFINE
            a.gainprm[0] = g * law.kp[k]
            a.biasprm[:3] = [g * law.offset[k], -g * law.kp[k], -g * law.kd[k]]
            limits = np.clip(sorted((g * law.lowest[k], g * law.highest[k])), -big, big)
            a.forcerange, a.forcelimited = limits, True

    def address(self, joint: str) -> tuple[int, int]:
        """(place in qpos, place in qvel)."""
        j = self.mj.mj_name2id(self.model, self.mj.mjtObj.mjOBJ_JOINT, joint)
        if j < 0:  # one without a name goes by its number
            j = int(joint.removeprefix("joint"))
        return int(self.model.jnt_qposadr[j]), int(self.model.jnt_dofadr[j])

    def actuator(self, joint: str) -> int:
        """The actuator on a joint, -1 where there is none."""
        m, trn = self.model, self.mj.mjtTrn
        _, dof = self.address(joint)
        on = (int(trn.mjTRN_JOINT), int(trn.mjTRN_JOINTINPARENT))
        found = [
            a
            for a in range(m.nu)
            if int(m.actuator_trntype[a]) in on and int(m.jnt_dofadr[m.actuator_trnid[a, 0]]) == dof
        ]
        return found[0] if len(found) == 1 else -1

    def run(
        self,
        joints: Sequence[str],
        t: np.ndarray,
        u: np.ndarray,
        linear: Sequence[bool],
        drive: Driven,
        q: np.ndarray,
        qd: np.ndarray,
    ) -> np.ndarray:
        """Positions [time joints] at times t under inputs u [time joints], held or linear between
        samples, from (q, qd).
        """
        mj, m = self.mj, self.model
        d = mj.MjData(m)
        at, dof = map(np.array, zip(*(self.address(j) for j in joints), strict=True))
        held = [(*self.address(joint), value) for joint, value in self.held.items()]
        for place, _, value in held:
            d.qpos[place] = value
        d.qpos[at], d.qvel[dof] = q, qd
        dt, steps = float(m.opt.timestep), int(np.ceil((t[-1] - t[0]) / m.opt.timestep)) + 1
        if steps > MOST_STEPS:
            raise UsageError(
                f"{t[-1] - t[0]:g} s in steps of {dt:g} s are {steps:,} steps, more than MuJoCo is"
                " asked for here"
            )
        inputs = _Inputs(t - t[0], u, linear)
        push = self._pusher(d, joints, dof, drive, inputs, at)
        times, k = t - t[0], 0
        out = np.full((len(t), len(joints)), np.nan)
        before_all = mj.get_mju_user_warning()
        mj.set_mju_user_warning(lambda text: None)  # else it writes a file where it stands
        try:
            for begins in range(0, steps + 1, BLOCK):
                now = np.arange(begins, min(begins + BLOCK, steps + 1)) * dt
                states = self._advanced(d, now, push, held)
                done = len(states) - 1
                ends = now[:done] + dt - 1e-9 * dt
                at_step = np.searchsorted(ends, times[k:], side="right")
                at_step = at_step[at_step < done]
                here = slice(k, k + len(at_step))
                share = (times[here] - now[at_step]) / dt
                q, qd = states[:, at], states[:, m.nq + dof]
                first, last = at_step, at_step + 1
                out[here] = _between(q[first], q[last], qd[first], qd[last], share, dt)
                k = here.stop
                if k == len(t):
                    break
                if done < len(now):
                    self.notes.append(
                        f"MuJoCo's run diverged after {now[done]:.3g} s: a smaller timestep, or"
                        " armature, may help"
                    )
                    break
        finally:
            mj.set_mju_user_warning(before_all)
        return out

    def _advanced(
        self,
        d: Any,
        now: np.ndarray,
        push: _Pusher,
        held: Sequence[tuple[int, int, float]],
    ) -> np.ndarray:
        """Positions and speeds before the first of some steps, which begin at times `now`, and
        after each of them; fewer where the run diverges.
        """
        if push.ahead is not None and not held:
            states = self._at_once(d, push.ahead(now))
            if states is not None:
                return states
        mj, m = self.mj, self.model
        states = [np.concatenate([d.qpos, d.qvel])]
        for moment in now:
            push.step(float(moment))
            mj.mj_step(m, d)
            for place, moving, value in held:  # else it falls by a little each step
                d.qpos[place], d.qvel[moving] = value, 0.0
            if _diverged(mj, d):
                break
            states.append(np.concatenate([d.qpos, d.qvel]))
        return np.array(states)

    def _at_once(self, d: Any, control: np.ndarray) -> np.ndarray | None:
        """The same under inputs [steps ...] that are known before, in one call; None, and as it
        was, where MuJoCo has anything to warn of.
        """
        from mujoco.rollout import Rollout

        mj, m = self.mj, self.model
        kinds = mj.mjtState
        whole, kept = int(kinds.mjSTATE_INTEGRATION), int(kinds.mjSTATE_FULLPHYSICS)
        driven = int(kinds.mjSTATE_CTRL) | int(kinds.mjSTATE_QFRC_APPLIED)
        before = np.zeros(mj.mj_stateSize(m, whole))
        begin = np.zeros(mj.mj_stateSize(m, kept))
        mj.mj_getState(m, d, before, whole)
        mj.mj_getState(m, d, begin, kept)
        with Rollout(nthread=0) as rollout:
            after: Any = rollout.rollout(
                m,
                d,
                begin[None],
                control[None],
                control_spec=driven,
                initial_warmstart=d.qacc_warmstart[None],
            )[0]
        if any(w.number for w in d.warning):
            for w in d.warning:
                w.number = 0
            mj.mj_setState(m, d, before, whole)
            return None
        every = np.concatenate([begin[None], after[0]])
        return every[:, 1 : 1 + m.nq + m.nv]  # the first is the time

    def gear(self, joints: Sequence[str]) -> np.ndarray:
        """The gear of each joint's actuator, 1 where it has none."""
        acts = np.array([self.actuator(joint) for joint in joints])
        gear = np.ones(len(joints))
        gear[acts >= 0] = self.model.actuator_gear[acts[acts >= 0], 0]
        return gear

    def _pusher(
        self,
        d: Any,
        joints: Sequence[str],
        dof: np.ndarray,
        drive: Driven,
        inputs: _Inputs,
        at: np.ndarray,
    ) -> _Pusher:
        mj, m = self.mj, self.model
        if drive.kind == "free":
            return _Pusher(lambda now: None, lambda now: np.zeros((len(now), m.nu + m.nv)))
        if drive.kind == "law" and not self.continuous:
            assert drive.law is not None
            law = _LawRun(drive.law, inputs, float(m.opt.timestep))

            def by_law(now: float) -> None:
                d.qfrc_applied[dof] = law(now, d.qpos[at], d.qvel[dof])

            return _Pusher(by_law)
        acts = np.array([self.actuator(j) for j in joints])
        goals = inputs
        if drive.kind == "law" and drive.law is not None:
            goals = _Goals(drive.law, inputs)
        gear = 1 / drive.reference.gear(joints) if drive.kind == "torque" else self.gear(joints)
        own = acts >= 0
        first = gear * goals(np.zeros(1))[0]
        for a, value in zip(acts[own], first[own], strict=True):
            d.ctrl[a] = value
            if m.actuator_actadr[a] >= 0:
                d.act[m.actuator_actadr[a]] = value
            if m.actuator_history[a, 0] > 0:
                n = int(m.actuator_history[a, 0])
                before = np.arange(-n, 0) * float(m.opt.timestep)
                mj.mj_initCtrlHistory(m, d, int(a), before, np.full((n, 1), value))

        def by_actuators(now: float) -> None:
            value = gear * goals(np.array([now]))[0]
            d.ctrl[acts[own]] = value[own]
            d.qfrc_applied[dof[~own]] = value[~own]

        def ahead(now: np.ndarray) -> np.ndarray:
            value = gear * goals(now)
            control = np.zeros((len(now), m.nu + m.nv))
            control[:, acts[own]] = value[:, own]
            control[:, m.nu + dof[~own]] = value[:, ~own]
            return control

        return _Pusher(by_actuators, ahead)


def _diverged(mj: Any, d: Any) -> bool:
    """Whether MuJoCo has given up a run; it would begin anew."""
    kinds = (
        mj.mjtWarning.mjWARN_BADQPOS,
        mj.mjtWarning.mjWARN_BADQVEL,
        mj.mjtWarning.mjWARN_BADQACC,
    )
    return any(d.warning[int(k)].number for k in kinds)


@dataclass(frozen=True)
class _Pusher:
    """What drives a run: `step` before each step, at its time; `ahead` controls and forces
    [steps nu + nv] of many steps, None where these depend on the motion.
    """

    step: Callable[[float], None]
    ahead: Callable[[np.ndarray], np.ndarray] | None = None


class _Inputs:
    """Inputs [times nu] at times from the start, held between samples or linear."""

    def __init__(self, t: np.ndarray, u: np.ndarray, linear: Sequence[bool]):
        self.t, self.u, self.linear = t, u, np.array(linear, bool)

    def __call__(self, now: np.ndarray) -> np.ndarray:
        found = np.searchsorted(self.t, now + 1e-9, side="right") - 1
        k = np.minimum(np.maximum(found, 0), len(self.t) - 1)
        held = self.u[k]
        if not self.linear.any() or len(self.t) < 2:
            return held
        after = np.minimum(k + 1, len(self.t) - 1)
        before = np.maximum(after - 1, 0)
        share = (now - self.t[before]) / (self.t[after] - self.t[before])
        sloped = held + share[:, None] * (self.u[after] - held)
        inside = ((k < after) & (now >= 0))[:, None]
        return np.where(self.linear & inside, sloped, held)


class _Goals:
    """Goals [times n] as they reach a law: late, and within its limits."""

    def __init__(self, law: DriveLaw, inputs: _Inputs):
        self.law, self.inputs = law, inputs

    def __call__(self, now: np.ndarray) -> np.ndarray:
        late = [self.inputs(now - d)[:, k] for k, d in enumerate(self.law.delay)]
        goal = np.stack(late, axis=1)
        return np.clip(goal, *np.array(self.law.control).T) if self.law.control else goal


class _LawRun:
    """A drive law in time, as `jaxid.models.robot_drive.PositionLaw` has it."""

    def __init__(self, law: DriveLaw, inputs: _Inputs, dt: float):
        self.law, self.goals, self.dt = law, _Goals(law, inputs), dt
        self.n = {
            k: np.array(getattr(law, k), float)
            for k in ("kp", "kd", "ki", "gain", "lowest", "highest", "offset")
        }
        self.integral, self.tick, self.held = np.zeros(len(law.kp)), -1, np.zeros(len(law.kp))
        self.last = self.before = self.goal = None

    def __call__(self, now: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        law, T = self.law, self.law.period
        if T <= 0:
            return self._output(self._goal(now) - q, -qd, self.dt)
        tick = int(np.floor(now / T + 0.5 * min(1.0, self.dt / T)))
        if tick > self.tick:
            self.tick = tick
            goal = self._goal(now)
            last = q - T * qd if self.last is None else self.last
            before = q - 2 * T * qd if self.before is None else self.before
            old = goal if self.goal is None else self.goal
            speed = {
                "measured": qd,
                "difference": (q - last) / T,
                "averaged_difference": (q - before) / (2 * T),
            }[law.velocity]
            self.held = self._output(goal - q, ((goal - old) / T if law.rate else 0.0) - speed, T)
            self.last, self.before, self.goal = q.copy(), last, goal
        return self.held

    def _goal(self, now: float) -> np.ndarray:
        return self.goals(np.array([now]))[0]

    def _output(self, error: np.ndarray, rate_error: np.ndarray, h: float) -> np.ndarray:
        n = self.n
        if self.law.kind == "cascade":
            v = n["kd"] * (n["kp"] * error + rate_error) + n["offset"]
        else:
            v = n["kp"] * error + n["kd"] * rate_error + n["offset"]
        if self.law.kind == "pid":
            v = v + self.integral
            winds_up = ((v > n["highest"]) | (v < n["lowest"])) & (v * error > 0)
            self.integral = self.integral + np.where(winds_up, 0.0, n["ki"] * h * error)
        return n["gain"] * np.clip(v, n["lowest"], n["highest"])


def _between(
    q0: np.ndarray, q1: np.ndarray, v0: np.ndarray, v1: np.ndarray, share: np.ndarray, dt: float
) -> np.ndarray:
    """Cubics [times joints] between two steps, exact at both ends, at their shares [times]."""
    s = np.clip(share, 0.0, 1.0)[:, None]
    a, b = 2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s
    return a * q0 + b * dt * v0 + (1 - a) * q1 + (s**3 - s**2) * dt * v1
