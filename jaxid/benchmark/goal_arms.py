"""Arms of random MJCF files with one effect that the file has not, simulated by MuJoCo under
position goals.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxid.data.dataset import Dataset


RATE, STEP = 500, 1e-3
NOISE = 1e-4  # of an encoder, rad
KINDS = (
    "none",
    "frictionloss",
    "armature",
    "input_delay",
    "torque_scale",
    "stribeck_friction",
    "payload",
    "sensor_bias",
    "constant_torque",
    "saturation",
    "gravity_offset",
    "backlash",
)


@dataclass(frozen=True)
class MujocoSteps:
    """Seconds, MuJoCo's word for the integrator, and whether dry friction is stiff."""

    step: float = STEP
    integrator: str = "implicitfast"
    stiff: bool = True

    def xml(self, gravity: str) -> str:
        """The option, and the default of the joints."""
        steps = f'timestep="{self.step}" integrator="{self.integrator}"'
        option = f'<option {steps} gravity="{gravity}"/>'
        if not self.stiff:
            return option
        return (
            f"{option}"
            f'<default><joint solreffriction="{2 * self.step} 1" solimpfriction=".99 .9999 .001"/>'
            "</default>"
        )


#: Steps so small that more of them change nothing that an encoder reads.
FINE = MujocoSteps(step=1e-4, integrator="RK4")


@dataclass
class GoalArm:
    """An arm as its file states it: one row for each joint."""

    axes: list[str]
    length: np.ndarray
    mass: np.ndarray
    armature: np.ndarray
    damping: np.ndarray
    frictionloss: np.ndarray
    kp: np.ndarray
    kv: np.ndarray
    limit: np.ndarray
    more: dict[str, Any] = field(default_factory=dict)  # what the recorded arm has beyond its file
    solver: MujocoSteps = MujocoSteps()

    @classmethod
    def drawn(cls, rng: np.random.Generator, n: int | None = None) -> GoalArm:
        n = n or int(rng.integers(2, 4))
        axes = [str(rng.choice(["0 1 0", "0 1 0", "1 0 0", "0 0 1"])) for _ in range(n)]
        axes[0], axes[1] = "0 1 0", axes[1] if n > 2 else "0 1 0"

        def between(low, high):
            return rng.uniform(low, high, n)

        outer = np.arange(n)[::-1] + 1.0
        kp = between(20, 40) * outer
        return cls(
            axes=axes,
            length=between(0.15, 0.3),
            mass=between(0.2, 0.6),
            armature=between(0.01, 0.04) * outer,
            damping=between(0.3, 0.8) * outer,
            frictionloss=between(0.03, 0.1) * outer,
            kp=kp,
            kv=0.02 * kp,
            limit=0.8 * kp,
        )

    @property
    def n(self) -> int:
        return len(self.axes)

    def xml(self, play: int | None = None) -> str:
        """`play`: the joint that has a second hinge with play."""
        open_, close = "", ""
        for k in range(self.n):
            opened, closed = self._link(k, play == k)
            open_, close = open_ + opened, closed + close
        actuators = "".join(self._actuator(k) for k in range(self.n))
        floor = ""
        if "floor" in self.more:
            floor = (
                f'<geom name="floor" type="plane" size="2 2 0.1" pos="0 0 {self.more["floor"]}"/>'
            )
        gravity = " ".join(f"{v:.9g}" for v in self._gravity())
        head = f'<compiler angle="radian"/>{self.solver.xml(gravity)}'
        world = f"<worldbody>{floor}{open_}{close}</worldbody>"
        return f'<mujoco model="arm">{head}{world}<actuator>{actuators}</actuator></mujoco>'

    def _gravity(self) -> np.ndarray:
        roll, pitch = self.more.get("tilt", (0.0, 0.0))
        down = [np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)]
        return 9.81 * np.array(down)

    def _link(self, k: int, play: bool) -> tuple[str, str]:
        """What opens the body of a link, and what closes it."""
        place = f"{self.length[k - 1]} 0 0" if k else "0 0 0.2"
        joint = (
            f'<joint name="j{k + 1}" axis="{self.axes[k]}" armature="{self.armature[k]}" '
            f'damping="{self.damping[k]}" frictionloss="{self.frictionloss[k]}"/>'
        )
        body = self._body(k)
        if not play:
            return f'<body name="l{k + 1}" pos="{place}">{joint}{body}', "</body>"
        reach = self.more["play"]
        opened = (
            f'<body name="r{k + 1}" pos="{place}">{joint}'
            '<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-6 1e-6 1e-6"/>'
            f'<body name="l{k + 1}"><joint name="play" axis="{self.axes[k]}" limited="true" '
            f'range="-{reach} {reach}" damping="0.01" armature="1e-4"/>{body}'
        )
        return opened, "</body></body>"

    def _body(self, k: int) -> str:
        """Mass of a link with its load; a ball at the end of the last one, where there is a
        floor.
        """
        mass, middle = self.mass[k], np.array([self.length[k] / 2, 0.0, 0.0])
        load, at = self.more.get("payload", {}).get(k, (0.0, np.zeros(3)))
        total = mass + load
        com = (mass * middle + load * np.asarray(at)) / total
        across = mass * self.length[k] ** 2 / 12
        inertia = np.diag([0.1 * across + 1e-5, across, across])
        for part, apart in ((mass, middle - com), (load, np.asarray(at) - com)):
            inertia = inertia + part * (apart @ apart * np.eye(3) - np.outer(apart, apart))
        rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
        numbers = " ".join(f"{v:.9g}" for v in inertia[rows, columns])
        position = " ".join(f"{v:.9g}" for v in com)
        body = f'<inertial pos="{position}" mass="{total}" fullinertia="{numbers}"/>'
        if "floor" in self.more and k == self.n - 1:
            body += f'<geom name="tip" type="sphere" size="0.02" pos="{self.length[k]} 0 0"/>'
        return body

    def _actuator(self, k: int) -> str:
        return (
            f'<position name="a{k + 1}" joint="j{k + 1}" kp="{self.kp[k]}" kv="{self.kv[k]}" '
            f'forcerange="-{self.limit[k]} {self.limit[k]}"/>'
        )


def withheld(
    arm: GoalArm, kind: str, rng: np.random.Generator
) -> tuple[GoalArm, int, dict[str, Any]]:
    """The arm that is recorded, the joint of the effect, and what acts beside MuJoCo's own
    model.
    """
    real, j = deepcopy(arm), int(rng.integers(arm.n))
    beside: dict[str, Any] = {}
    if kind == "frictionloss":
        real.frictionloss[j] *= 2
    elif kind == "armature":
        real.armature[j] *= 2
    elif kind == "torque_scale":
        real.kp[j] *= 0.85
        real.kv[j] *= 0.85
        real.limit[j] *= 0.85
    elif kind == "saturation":
        beside["clip"] = rng.uniform(0.5, 0.7)
    elif kind == "payload":
        j = arm.n - 1
        real.more["payload"] = {j: (0.5 * arm.mass[j], np.array([arm.length[j], 0.0, 0.0]))}
    elif kind == "gravity_offset":
        j = 0
        real.more["tilt"] = (0.0, float(rng.choice([-1, 1]) * rng.uniform(0.04, 0.08)))
    elif kind == "input_delay":
        beside["delay"] = rng.uniform(0.006, 0.015)
    elif kind == "stribeck_friction":
        beside["extra"], beside["speed"] = float(2 * arm.frictionloss[j]), rng.uniform(0.1, 0.3)
    elif kind == "sensor_bias":
        beside["bias"] = float(rng.choice([-1, 1]) * rng.uniform(0.04, 0.08))
    elif kind == "constant_torque":
        beside["torque"] = float(rng.choice([-1, 1]) * rng.uniform(0.5, 1.0) * 0.03 * arm.kp[j])
    elif kind == "backlash":
        real.more["play"] = 0.01
    return real, j, beside


def goals(n: int, seconds: float, rng: np.random.Generator, rate: float = RATE) -> np.ndarray:
    """[time n] sums of sines up to 2 Hz that begin at 0."""
    t = np.arange(round(seconds * rate)) / rate
    out = np.zeros((len(t), n))
    for k in range(n):
        f = rng.uniform(0.1, 2.0, 5)
        out[:, k] = sum(
            a * (np.sin(2 * np.pi * x * t + p) - np.sin(p))
            for x, a, p in zip(
                f, 0.25 / np.sqrt(1 + (2 * f) ** 2), rng.uniform(0, 6.3, 5), strict=True
            )
        )
    return out * np.minimum(1.0, t[:, None])


def recorded(
    arm: GoalArm,
    kind: str,
    j: int,
    beside: dict[str, Any],
    u: np.ndarray,
    rng: np.random.Generator,
    rate: float = RATE,
    noise: float = NOISE,
) -> np.ndarray:
    """What the encoders read [time n] under goals [time n]."""
    import mujoco

    mj: Any = mujoco
    m = mj.MjModel.from_xml_string(arm.xml(j if kind == "backlash" else None))
    d = mj.MjData(m)
    adr = [int(m.joint(f"j{k + 1}").qposadr[0]) for k in range(arm.n)]
    dof = [int(m.joint(f"j{k + 1}").dofadr[0]) for k in range(arm.n)]
    bias = np.zeros(arm.n)
    bias[j] = beside.get("bias", 0.0)
    if "top" in beside:
        m.actuator_forcerange[j] = -beside["top"], beside["top"]
    late = beside.get("delay", 0.0)
    t = np.arange(len(u)) / rate
    step = arm.solver.step
    per, out = round(1 / rate / step), np.empty_like(u)
    for k in range(len(u)):
        for part in range(per):
            goal = u[k].copy()
            if late:
                now = t[k] + part * step - late
                goal[j] = u[max(0, int(np.floor(now * rate + 1e-9))), j] if now >= 0 else u[0, j]
            d.ctrl[:] = goal - bias  # the law sees what the encoder reads
            if "torque" in beside:
                d.qfrc_applied[dof[j]] = beside["torque"]
            if "extra" in beside:
                v = d.qvel[dof[j]] / beside["speed"]
                m.dof_frictionloss[dof[j]] = arm.frictionloss[j] + beside["extra"] * np.exp(-(v**2))
            if part == 0:
                out[k] = d.qpos[adr] + bias
            mj.mj_step(m, d)
    return out + noise * rng.standard_normal(out.shape)


def limited(
    arm: GoalArm,
    j: int,
    beside: dict[str, Any],
    u: np.ndarray,
    rng: np.random.Generator,
    rate: float = RATE,
) -> dict[str, Any]:
    """`beside` with the most torque that a drive gives which gives less than the file says: a share
    of what a motion asks for.
    """
    if "clip" not in beside:
        return beside
    free = recorded(arm, "none", j, {}, u, rng, rate)
    asked = arm.kp[j] * (u[:, j] - free[:, j]) - arm.kv[j] * np.gradient(free[:, j], 1 / rate)
    return beside | {"top": beside["clip"] * float(np.abs(asked).max())}


def case(
    seed: int, number: int, seconds: float, off: float = 0.0, more: float = 0.0
) -> dict[str, Any]:
    """A case with its key: file, goals, readings. `off`: the share by which armature, damping and
    dry friction of the file are wrong at most; `more` seconds of the motion that goes on.
    """
    rng = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    arm = GoalArm.drawn(rng)
    real, j, beside = withheld(arm, kind, rng)
    wrong = np.random.default_rng([seed, number, 1])
    for numbers in (real.armature, real.damping, real.frictionloss):
        numbers *= 1 + off * wrong.uniform(-1, 1, arm.n)
    u = goals(arm.n, seconds + more, rng)
    beside = limited(real, j, beside, u[: round(seconds * RATE)], rng)
    return {
        "kind": kind,
        "joint": f"j{j + 1}",
        "beside": beside,
        "arm": arm,
        "u": u,
        "q": recorded(real, kind, j, beside, u, rng),
    }


def dataset(c: dict[str, Any]) -> Dataset:
    n = c["arm"].n
    t = np.arange(len(c["u"])) / c.get("rate", RATE)
    joints = [f"j{k + 1}" for k in range(n)]
    return Dataset.from_arrays(
        t,
        {f"{j}_cmd": c["u"][:, k] for k, j in enumerate(joints)},
        {j: c["q"][:, k] for k, j in enumerate(joints)},
        units=dict.fromkeys([*joints, *(f"{j}_cmd" for j in joints)], "rad"),
        check_model=False,
    )
