"""Sets of arms: by torque along a measured motion, and under position goals, with files that are
exact, loose, or that touch a floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxid.benchmark import goal_arms
from jaxid.benchmark.case import (
    ASKED,
    asked_rows,
    BlindCase,
    depends_on,
    Draft,
    Exam,
    SPLITS,
    WithheldEffect,
)
from jaxid.benchmark.goal_arms import GoalArm
from jaxid.data.dataset import Dataset
from jaxid.study.papers.twins.serial_arm import torques


# ---- by torque

RATE, SECONDS, READING = 200, 10.0, 1e-5
#: Effects of an arm by torque, and their medium strength as a share of what the joint's torque is.
BY_TORQUE = {
    "coulomb_friction": 0.06,
    "viscous_friction": 0.06,
    "stribeck_friction": 0.1,
    "load_dependent_friction": 0.1,
    "quadratic_drag": 0.1,
    "spring_torque": 0.15,
    "constant_torque": 0.05,
    "torque_scale": 0.1,
    "torque_ripple": 0.08,
    "position_dependent_friction": 0.08,
    "temperature_dependent_friction": 0.1,
}


@dataclass(frozen=True)
class TorqueArm:
    """Numbers of an arm with turning joints: table of modified Denavit-Hartenberg, bodies [joints
    10] about the origins of the links, and inertia of the drives, viscous and dry friction.
    """

    alpha: np.ndarray
    a: np.ndarray
    d: np.ndarray
    bodies: np.ndarray
    drives: np.ndarray
    viscous: np.ndarray
    dry: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator, n: int) -> TorqueArm:
        """An arm of n joints, smaller from link to link."""
        outer = np.arange(n)[::-1] + 1.0
        bodies = np.zeros((n, 10))
        lengths = rng.uniform(0.2, 0.4, n)
        for j in range(n):
            mass = rng.uniform(0.6, 1.2) * outer[j]
            com = np.array([lengths[j] / 2, rng.uniform(-0.03, 0.03), rng.uniform(-0.03, 0.03)])
            own = mass * lengths[j] ** 2 / 12 * np.diag([0.15, 1.0, 1.0])
            inertia = own + mass * (com @ com * np.eye(3) - np.outer(com, com))
            bodies[j, :6] = inertia[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
            bodies[j, 6:9], bodies[j, 9] = mass * com, mass
        turns = np.append(0.0, rng.choice([0.0, np.pi / 2, -np.pi / 2], n - 1))
        turns[1] = np.pi / 2  # the second axis lies: gravity acts
        return cls(
            alpha=turns,
            a=np.append(0.0, lengths[:-1]),
            d=np.append(0.3, np.zeros(n - 1)),
            bodies=bodies,
            drives=rng.uniform(0.02, 0.06, n) * outer,
            viscous=rng.uniform(0.3, 0.8, n) * outer,
            dry=rng.uniform(0.3, 0.8, n) * outer,
        )

    def torque(self, motion: tuple[np.ndarray, ...]) -> np.ndarray:
        """Of bodies, drives and friction, along a motion [time joints]."""
        rigid = torques(self.alpha, self.a, self.d, self.bodies, self.drives, motion)
        return rigid + self.viscous * motion[1] + self.dry * np.sign(motion[1])

    def xml(self) -> str:
        """As MJCF, with a motor at each joint."""
        opened, motors = "", ""
        for j, (xx, xy, xz, yy, yz, zz, *h, mass) in enumerate(self.bodies):
            com = np.array(h) / mass
            inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            inertia = inertia - mass * (com @ com * np.eye(3) - np.outer(com, com))
            numbers = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
            turn, shift = self.alpha[j], self.d[j]
            place = _text([self.a[j], -np.sin(turn) * shift, np.cos(turn) * shift])
            opened += (
                f'<body name="l{j + 1}" pos="{place}" '
                f'quat="{_text([np.cos(turn / 2), np.sin(turn / 2), 0, 0])}">'
                f'<joint name="j{j + 1}" axis="0 0 1" armature="{self.drives[j]:.9g}" '
                f'damping="{self.viscous[j]:.9g}" frictionloss="{self.dry[j]:.9g}"/>'
                f'<inertial pos="{_text(com)}" mass="{mass:.9g}" fullinertia="{_text(numbers)}"/>'
            )
            motors += f'<motor name="m{j + 1}" joint="j{j + 1}"/>'
        closed = "</body>" * len(self.bodies)
        return (
            '<mujoco model="arm"><compiler angle="radian"/><option gravity="0 0 -9.81"/>'
            f"<worldbody>{opened}{closed}</worldbody><actuator>{motors}</actuator></mujoco>"
        )


def _text(numbers: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{x:.9g}" for x in numbers)


def torque_drafts(name: str, seed: int, numbers: Sequence[int]) -> list[Draft]:
    """Arms of three to six joints whose motion and torque are recorded."""
    made = []
    for number in numbers:
        made.append(Draft(name, seed, number, f"arms {number % 8}", _each_by_torque))
    return made


def _each_by_torque(group: Sequence[Draft]) -> list[BlindCase]:
    return [_by_torque(draft) for draft in group]


def _moved(rng: np.random.Generator, n: int) -> tuple[np.ndarray, ...]:
    """Position, speed and acceleration [time joints] of sums of sines."""
    t = np.arange(int(RATE * SECONDS))[:, None] / RATE
    out = [np.zeros((len(t), n)) for _ in range(3)]
    for j in range(n):
        w = 2 * np.pi * rng.uniform(0.08, 0.9, 6)
        size, phase = rng.uniform(0.4, 1.0, 6) / np.maximum(w, 2.0), rng.uniform(0, 6.3, 6)
        x = w * t + phase
        out[0][:, j] = (size * np.sin(x)).sum(1)
        out[1][:, j] = (size * w * np.cos(x)).sum(1)
        out[2][:, j] = -(size * w**2 * np.sin(x)).sum(1)
    return tuple(out)


def _by_torque(draft: Draft) -> BlindCase:
    rng = draft.rng()
    n = int(rng.integers(3, 7))
    return by_torque(TorqueArm.drawn(rng, n), rng)


def by_torque(stated: TorqueArm, rng: np.random.Generator) -> BlindCase:
    """An arm that differs from what is stated by up to 5 % and lacks an effect, or none."""
    n = len(stated.bodies)
    real = deepcopy(stated)
    for numbers in (real.bodies, real.drives, real.viscous, real.dry):
        numbers *= rng.uniform(0.95, 1.05, (n, 1)[: numbers.ndim])
    effect = str(rng.choice(list(BY_TORQUE))) if rng.uniform() > 0.15 else ""
    joint = int(rng.integers(n))
    size = BY_TORQUE.get(effect, 0.0) * rng.choice([0.5, 1.0, 2.0]) * rng.uniform(0.7, 1.4)
    law = _Law(effect, joint, size, rng.uniform(0, 1, 3))
    runs = [_moved(rng, n) for _ in range(len(SPLITS) + 1)]
    level = np.std(np.concatenate([real.torque(m) for m in runs]), axis=0)
    speed = np.std(np.concatenate([m[1] for m in runs]), axis=0)
    white = 0.01 * level
    recorded, read = [], []
    for m in runs:
        tau = law.on(real.torque(m), m, level[joint], speed[joint])
        recorded.append(tau + white * rng.standard_normal(tau.shape))
        read.append(m[0] + READING * rng.standard_normal(m[0].shape))
    names = [f"j{k + 1}" for k in range(n)]
    motors = [f"{name}_tau" for name in names]
    rows = _moving_rows(runs[-1][1], speed)
    t = np.arange(len(read[-1])) / RATE
    noise = dict(zip(motors, white.tolist(), strict=True))
    exam = Exam(
        given={"t": t} | _columns(names, read[-1]),
        rows=rows,
        truth=_columns(motors, recorded[-1][rows]),
        stated=_columns(motors, stated.torque(runs[-1])[rows]),
        noise=noise,
    )
    missing = ()
    if effect:
        number = law.number(level[joint], speed[joint])
        missing = (WithheldEffect(effect, names[joint], number),)
    question = {
        "robot": "model.xml",
        "without": [],
        "joints": names,
        "trust": "measured",
        "residual": "inverse_dynamics",
        "noise_of_torque": noise,
    }
    return BlindCase(
        question=question,
        dataset=_measured(names, motors, recorded[:-1], read[:-1]),
        simulator="numpy (Newton and Euler)",
        missing=missing,
        over=depends_on(missing),
        exam=exam,
        files={"model.xml": stated.xml()},
        model_toml=_model_toml("measured"),
    )


def _moving_rows(v: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Rows of the exam at which no joint turns back, for a hundredth of a second there decides the
    sign of its dry friction; none within a second of the ends.
    """
    moving = np.all(np.abs(v) > 0.05 * speed, axis=1)
    moving[:RATE], moving[-RATE:] = False, False
    there = np.flatnonzero(moving)
    return there[np.linspace(0, len(there) - 1, ASKED).astype(int)]


def _columns(names: Sequence[str], table: np.ndarray) -> dict[str, np.ndarray]:
    """The columns of a table [rows names] by name."""
    return dict(zip(names, table.T, strict=True))


def _measured(
    names: list[str], motors: list[str], tau: list[np.ndarray], q: list[np.ndarray]
) -> Dataset:
    """Runs of torques and positions, each [time joints]."""
    inputs, outputs = {}, {}
    for k, (name, motor) in enumerate(zip(names, motors, strict=True)):
        inputs[motor] = [x[:, k] for x in tau]
        outputs[name] = [x[:, k] for x in q]
    return Dataset.from_arrays(
        [np.arange(len(x)) / RATE for x in q],
        inputs=inputs,
        outputs=outputs,
        units=dict.fromkeys(motors, "N m") | dict.fromkeys(names, "rad"),
        split=list(SPLITS),
        noise_std=dict.fromkeys(names, READING),
        check_model=False,
    )


@dataclass(frozen=True)
class _Law:
    """An effect at one joint of an arm by torque: its size as a share of the joint's torque."""

    effect: str
    joint: int
    size: float
    shape: np.ndarray

    def on(
        self, tau: np.ndarray, m: tuple[np.ndarray, ...], level: float, speed: float
    ) -> np.ndarray:
        """The torque [time joints] that is recorded with the effect."""
        out, j = tau.copy(), self.joint
        if self.effect == "torque_scale":
            out[:, j] = tau[:, j] / (1 + self.size)
        elif self.effect:
            out[:, j] += level * self.size * self._form(tau[:, j] / level, m, speed)
        return out

    def _form(self, load: np.ndarray, m: tuple[np.ndarray, ...], speed: float) -> np.ndarray:
        """The force for a size of 1, [time]."""
        q, v = m[0][:, self.joint], m[1][:, self.joint]
        way = np.sign(v)
        order, phase = 3 + 9 * self.shape[0], 6.3 * self.shape[1]
        slow = (0.05 + 0.15 * self.shape[2]) * speed
        forms = {
            "coulomb_friction": way,
            "viscous_friction": v / speed,
            "stribeck_friction": 2 * way * np.exp(-((v / slow) ** 2)),
            "load_dependent_friction": np.abs(load) * way,
            "quadratic_drag": v * np.abs(v) / speed**2,
            "spring_torque": q,
            "constant_torque": np.ones_like(q),
            "torque_ripple": np.sin(order * q + phase),
            "position_dependent_friction": way * np.sin(order / 4 * q + phase),
            "temperature_dependent_friction": -_warm(v / speed) * v / speed,
        }
        return forms[self.effect]

    def number(self, level: float, speed: float) -> float | None:
        """The number of `SIZES`."""
        units = {
            "coulomb_friction": level,
            "viscous_friction": level / speed,
            "stribeck_friction": 2 * level,
            "load_dependent_friction": 1.0,
            "quadratic_drag": level / speed**2,
            "spring_torque": level,
            "constant_torque": level,
            "torque_scale": 1.0,
        }
        if self.effect not in units:
            return None
        return float(self.size * units[self.effect])


def _warm(v: np.ndarray, seconds: float = 4.0) -> np.ndarray:
    """Squared speed, kept in mind for some seconds."""
    keeps, warm = np.exp(-1 / RATE / seconds), 0.0
    out = np.zeros_like(v)
    for k, x in enumerate(v):
        warm = x * x + (warm - x * x) * keeps
        out[k] = warm
    return out


# ---- under goals

GOAL_SECONDS, GOAL_EXAM = 9.0, 3.0
#: Kind of a goal arm -> effect that answers name.
NAMES = {"frictionloss": "coulomb_friction", "armature": "reflected_inertia"}
#: What looks the same under one law and pose.
ALIKE = {
    "input_delay": ("input_hold", "actuator_lag"),
    "constant_torque": ("sensor_bias", "gravity_offset"),
    "sensor_bias": ("constant_torque", "gravity_offset"),
    "gravity_offset": ("constant_torque", "sensor_bias"),
}
#: A floor shows where it moves a joint by so many times the noise; steps in which it is raised, and
#: where it ends, m: the arm begins at 0.2 m with a ball of 0.02 m at its end.
SEEN, FLOOR_STEP, HIGHEST_FLOOR = 50.0, 0.02, 0.175
#: Share by which a loose file's numbers are off at most.
LOOSE = 0.4


def goal_drafts(name: str, seed: int, numbers: Sequence[int]) -> list[Draft]:
    """Arms under position goals, simulated by MuJoCo."""
    return [Draft(name, seed, number, f"{name} {number % 8}", _each_goal) for number in numbers]


def _each_goal(group: Sequence[Draft]) -> list[BlindCase]:
    return [_goal(draft) for draft in group]


def _goal(draft: Draft) -> BlindCase:
    rng = draft.rng()
    stated = GoalArm.drawn(rng)
    if draft.set == "contact":
        stated.more["floor"] = float(rng.uniform(-0.05, 0.12))
    kind = str(rng.choice(goal_arms.KINDS))
    real, j, beside = goal_arms.withheld(stated, kind, rng)
    unseen = draft.set == "contact" and draft.number % 3 == 0
    if unseen:  # a floor that the file has not, and nothing else
        real, kind, beside = deepcopy(stated), "none", {}
        del stated.more["floor"]
    if draft.set == "loose":
        for numbers in (real.armature, real.damping, real.frictionloss):
            numbers *= 1 + LOOSE * rng.uniform(-1, 1, stated.n)
    u = goal_arms.goals(stated.n, GOAL_SECONDS, rng)
    if unseen and not _touches(real, stated, u):
        unseen = False
        del real.more["floor"]
    again = goal_arms.goals(stated.n, GOAL_EXAM, rng)
    beside = goal_arms.limited(real, j, beside, u, rng)
    q = goal_arms.recorded(real, kind, j, beside, u, rng)
    later = goal_arms.recorded(real, kind, j, beside, again, rng)
    said = goal_arms.recorded(stated, "none", 0, {}, again, rng)
    names = [f"j{k + 1}" for k in range(stated.n)]
    rows = asked_rows(len(again), goal_arms.RATE // 10)
    exam = Exam(
        given={"t": np.arange(len(again)) / goal_arms.RATE}
        | {f"{j}_cmd": again[:, k] for k, j in enumerate(names)},
        rows=rows,
        truth={j: later[rows, k] for k, j in enumerate(names)},
        stated={j: said[rows, k] for k, j in enumerate(names)},
        noise=dict.fromkeys(names, goal_arms.NOISE),
    )
    missing = () if kind == "none" else (_of_goal(kind, names, j, stated, beside),)
    trust = "loose" if draft.set == "loose" else "exact"
    question = {"robot": "model.xml", "without": [], "joints": names, "trust": trust}
    return BlindCase(
        question=question,
        dataset=goal_arms.dataset({"arm": stated, "u": u, "q": q}),
        simulator="mujoco",
        missing=missing,
        outside="a floor that the file has not" if unseen else "",
        over=("position",) if unseen else depends_on(missing),
        exam=exam,
        files={"model.xml": stated.xml()},
        model_toml=_model_toml(trust),
    )


def _touches(real: GoalArm, stated: GoalArm, u: np.ndarray) -> bool:
    """Raises the floor until the recording shows it, to just below the arm as it begins; whether
    the recording then does.
    """
    still = np.random.default_rng(0)
    free = goal_arms.recorded(stated, "none", 0, {}, u, still, noise=0.0)
    while True:
        q = goal_arms.recorded(real, "none", 0, {}, u, still, noise=0.0)
        if np.abs(q - free).max() > SEEN * goal_arms.NOISE:
            return True
        if real.more["floor"] + FLOOR_STEP > HIGHEST_FLOOR:
            return False
        real.more["floor"] += FLOOR_STEP


def _model_toml(trust: str) -> str:
    """Lines of [model]: the robot's file, and how far its numbers may be off."""
    return f'robot = "model.xml"\ntrust = "{trust}"\n'


def _of_goal(
    kind: str, names: list[str], j: int, stated: GoalArm, beside: dict[str, Any]
) -> WithheldEffect:
    sizes: dict[str, float] = {
        "frictionloss": stated.frictionloss[j],
        "armature": stated.armature[j],
        "torque_scale": -0.15,
        "saturation": beside.get("top", 0.0),
        "payload": 0.5 * stated.mass[j],
        "input_delay": beside.get("delay", 0.0),
        "stribeck_friction": beside.get("extra", 0.0),
        "sensor_bias": beside.get("bias", 0.0),
        "constant_torque": beside.get("torque", 0.0),
        "backlash": 0.02,
    }
    size = float(sizes[kind]) if kind in sizes else None
    alike = []
    for effect in ALIKE.get(kind, ()):
        alike += [f"{effect}@{place}" for place in (names[j], names[0])]
    return WithheldEffect(NAMES.get(kind, kind), names[j], size, tuple(dict.fromkeys(alike)))
