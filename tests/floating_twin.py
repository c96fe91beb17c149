"""A craft with an arm, a reaction wheel and a rail on a base that floats: its file, and its motion
by MuJoCo.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from jaxid.data.dataset import Dataset, Geometry, ModelSpec, ParameterPrior
from jaxid.robots.tree import roll_pitch_yaw, rotation


mujoco: Any = pytest.importorskip("mujoco")

JOINTS = ("j1", "j2", "w1", "s1")
ANGLES = ("base_roll", "base_pitch", "base_yaw")
TEXT = """<mujoco><option gravity="0 0 {gravity}" integrator="RK4" timestep="{step}"/><worldbody>
<body name="craft" pos="0.3 -0.2 1.1" quat="0.8 0.2 -0.4 0.3"><freejoint name="root"/>
<inertial pos="0.05 -0.02 0.03" mass="7" fullinertia="0.4 0.5 0.3 0.02 -0.03 0.01"/>
<body name="a1" pos="0.3 0.1 0.2" quat="0.9 0.1 0.3 -0.2"><joint name="j1" axis="0.2 0.9 0.1" armature="0.01"
damping="{damping}"/><inertial pos="0.1 0.02 0" mass="1.5" fullinertia="0.02 0.03 0.025 0.001 0.002 -0.001"/>
<body name="a2" pos="0.4 0 0.05"><joint name="j2" axis="0 0 1" pos="0.02 0.01 0" damping="{damping}"/>
<inertial pos="0.15 0 0.03" mass="{mass}" fullinertia="0.01 0.015 0.012 0 0 0"/></body></body>
<body name="wheel" pos="-0.1 0 0.1"><joint name="w1" axis="0 0 1"/>
<inertial pos="0 0 0" mass="0.6" fullinertia="0.002 0.002 0.004 0 0 0"/></body>
<body name="rail" pos="0 -0.2 0"><joint name="s1" type="slide" axis="1 0 0.2" damping="{damping}"/>
<inertial pos="0 0.02 0" mass="0.4" fullinertia="0.002 0.002 0.003 0 0 0"/></body>
</body></worldbody></mujoco>"""


def text(gravity: float = 0.0, step: float = 1e-3, damping: float = 0.0, mass: float = 1.1) -> str:
    return TEXT.format(gravity=gravity, step=step, damping=damping, mass=mass)


def placed(data: Any, angles: np.ndarray, q: np.ndarray, spin: np.ndarray, qd: np.ndarray) -> None:
    """MuJoCo's data with the base turned by (roll, pitch, yaw), spinning at `spin` rad/s in its own
    frame.
    """
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation(*angles).ravel())
    data.qpos[:3], data.qpos[3:7], data.qpos[7:] = (0.4, 0.1, -0.3), quaternion, q
    data.qvel[:3], data.qvel[3:6], data.qvel[6:] = (0.2, -0.1, 0.3), spin, qd


def angles_of(quaternion: np.ndarray) -> np.ndarray:
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, quaternion)
    return np.array(roll_pitch_yaw(R.reshape(3, 3)))


def motion(
    t: np.ndarray,
    torque: np.ndarray,
    start: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    inside: int = 4,
    **file: Any,
) -> np.ndarray:
    """Joints and unwrapped angles [time 7] under torque [time 4] that is held from sample to
    sample; `inside` steps each.
    """
    model = mujoco.MjModel.from_xml_string(text(step=float(t[1] - t[0]) / inside, **file))
    data = mujoco.MjData(model)
    placed(data, *start)
    out = []
    for u in torque:
        out.append([*data.qpos[7:], *angles_of(data.qpos[3:7])])
        data.qfrc_applied[6:] = u
        for _ in range(inside):
            mujoco.mj_step(model, data)
    return np.unwrap(np.array(out), axis=0)


def torques(t: np.ndarray, seed: int, size: float = 0.3) -> np.ndarray:
    """Smooth torques [time 4], the wheel's smaller."""
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * rng.uniform(0.2, 1.2, (4, 3))
    u = np.stack([np.cos(np.outer(t, w[j]) + rng.uniform(0, 6, 3)).sum(1) for j in range(4)], 1)
    return size * u * np.array([1.0, 0.6, 0.05, 1.0])


def recording(
    torque: list[np.ndarray],
    runs: list[np.ndarray],
    t: np.ndarray,
    noise: float,
    seed: int = 0,
    numbers: Any = None,
    **file: Any,
) -> Dataset:
    """A dataset of runs with angle noise `noise` (rad, m)."""
    rng = np.random.default_rng(seed)
    read = [y + noise * rng.standard_normal(y.shape) for y in runs]
    names = (*JOINTS, *ANGLES)
    data = Dataset.from_arrays(
        [t] * len(runs),
        {f"{j}_tau": [u[:, k] for u in torque] for k, j in enumerate(JOINTS)},
        {n: [y[:, k] for y in read] for k, n in enumerate(names)},
        noise_std=dict.fromkeys(names, max(noise, 1e-9)),
        split="fit",
        units=dict.fromkeys(names, "rad")
        | dict.fromkeys([f"{j}_tau" for j in JOINTS], "N m")
        | {"s1_tau": "N", "s1": "m"},
    )
    spec = ModelSpec(
        "robot",
        geometry=Geometry(file="craft.xml", robot=text(**file)),
        base={"kind": "free"},
        parameters={
            k: ParameterPrior(*v) if isinstance(v, tuple) else ParameterPrior(v)
            for k, v in (numbers or {}).items()
        },
    )
    return replace(data, model=spec)


#: The last body's inertial in the file, and what it is with a target in its hand.
HAND = '<inertial pos="0.15 0 0.03" mass="{mass}" fullinertia="0.01 0.015 0.012 0 0 0"/>'


@dataclass(frozen=True)
class Target:
    """A body that the last link takes hold of: mass, kg, centre of mass in the link's frame, m,
    inertia about it, kg m^2, and what its centre's velocity, m/s, and its spin, rad/s, are beside
    the hand's, in the world.
    """

    mass: float = 0.8
    com: tuple[float, float, float] = (0.38, 0.04, 0.0)
    inertia: tuple[float, float, float] = (0.02, 0.03, 0.025)
    drifts: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spins: tuple[float, float, float] = (0.0, 0.0, 0.0)


def holding(target: Target, mass: float = 1.1, **file: Any) -> str:
    """The file with the target fixed to the last link."""
    own, com = np.array([0.15, 0.0, 0.03]), np.array(target.com)
    m = mass + target.mass
    c = (mass * own + target.mass * com) / m
    I = np.diag([0.01, 0.015, 0.012]) + np.diag(target.inertia)
    for k, d in ((mass, own - c), (target.mass, com - c)):
        I = I + k * (d @ d * np.eye(3) - np.outer(d, d))
    full = " ".join(repr(float(v)) for v in (I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]))
    there = (
        f'<inertial pos="{c[0]!r} {c[1]!r} {c[2]!r}" mass="{m!r}" fullinertia="{full}"/>'.replace(
            "np.float64", ""
        )
    )
    return text(mass=mass, **file).replace(
        HAND.format(mass=mass), there.replace("(", "").replace(")", "")
    )


def capture(
    t: np.ndarray,
    torque: np.ndarray,
    start: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    at: int,
    target: Target,
    inside: int = 4,
    mass: float = 1.1,
    **file: Any,
) -> np.ndarray:
    """As `motion`, the target caught at sample `at`: momentum of both together goes on, the speeds
    of the joints jump.
    """
    step = float(t[1] - t[0]) / inside
    before = mujoco.MjModel.from_xml_string(text(step=step, mass=mass, **file))
    after = mujoco.MjModel.from_xml_string(holding(target, step=step, mass=mass, **file))
    model, data = before, mujoco.MjData(before)
    placed(data, *start)
    out = []
    for k, u in enumerate(torque):
        if k == at:
            speeds = caught(before, after, data, target)
            q, model, data = data.qpos.copy(), after, mujoco.MjData(after)
            data.qpos[:], data.qvel[:] = q, speeds
        out.append([*data.qpos[7:], *angles_of(data.qpos[3:7])])
        data.qfrc_applied[6:] = u
        for _ in range(inside):
            mujoco.mj_step(model, data)
    return np.unwrap(np.array(out), axis=0)


def caught(before: Any, after: Any, data: Any, target: Target) -> np.ndarray:
    """Speeds after the catch: M_after v' = M_before v + J' (momentum of the target)."""
    mujoco.mj_forward(before, data)
    body, n = before.body("a2").id, before.nv
    R = data.xmat[body].reshape(3, 3)
    place, turns = np.zeros((3, n)), np.zeros((3, n))
    mujoco.mj_jac(before, data, place, turns, data.xpos[body] + R @ np.array(target.com), body)
    v, w = place @ data.qvel + np.array(target.drifts), turns @ data.qvel + np.array(target.spins)
    brought = place.T @ (target.mass * v) + turns.T @ (R @ np.diag(target.inertia) @ R.T @ w)
    later, M = mujoco.MjData(after), np.zeros((2, n, n))
    later.qpos[:] = data.qpos
    mujoco.mj_forward(after, later)
    for k, (m, d) in enumerate(((before, data), (after, later))):
        mujoco.mj_fullM(m, d, M[k])
    return np.linalg.solve(M[1], M[0] @ data.qvel + brought)


@dataclass(frozen=True)
class Catch:
    """A run in which a target is caught at a sample, and the same file before and after it."""

    t: np.ndarray
    torque: np.ndarray
    y: np.ndarray
    at: int
    target: Target


def catch(seed: int, seconds: float = 20.0, caught: bool = True) -> Catch:
    """A target of random mass, place, inertia, speed and spin, caught at a random moment on a
    random motion whose base does not pitch too far; without the catch where `caught` is not set.
    """
    rng, t = np.random.default_rng([seed, 37]), np.arange(round(100 * seconds) + 1) * 0.01
    for k in range(20):
        target = Target(
            rng.uniform(0.4, 1.2),
            (rng.uniform(0.3, 0.45), *rng.uniform(-0.05, 0.05, 2)),
            tuple(rng.uniform(0.01, 0.03, 3)),
            tuple(rng.normal(size=3) * 0.05),
            tuple(rng.normal(size=3) * 0.15),
        )
        at = int(rng.integers(500, 801))
        start = (
            np.array([0.2, -0.3, 0.5]),
            np.array([0.1, 0.4, 0.0, 0.05]),
            rng.normal(size=3) * 0.02,
            np.zeros(4),
        )
        torque = torques(t, 100 * seed + k, 0.3)
        y = capture(t, torque, start, at if caught else len(t), target, damping=0.2)
        if np.abs(y[:, 5]).max() < 1.3:
            return Catch(t, torque, y, at, target)
    raise AssertionError("no motion of these keeps the base from pitching")
