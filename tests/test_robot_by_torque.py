"""A robot's file by torque: a number of it that the recording refutes is the answer."""

from __future__ import annotations

import re

import numpy as np
import pytest

import jaxid
from jaxid.diagnosis import foreseen
from jaxid.problem.binding import resolve_model


mujoco = pytest.importorskip("mujoco")
FILE = """<mujoco><option gravity="0 0 -9.81" timestep="0.0005" integrator="implicitfast"/>
<compiler angle="radian"/><worldbody><body name="l1" pos="0 0 0.3">
<joint name="lift" axis="0 1 0" armature="0.05" damping="0.6" frictionloss="0.4"/>
<inertial pos="0.15 0.01 0" mass="2.0" diaginertia="0.004 0.02 0.02"/>
<body name="l2" pos="0.3 0 0"><joint name="elbow" axis="0 1 0" armature="0.03" damping="0.4" frictionloss="0.3"/>
<inertial pos="0.12 0 0.01" mass="1.2" diaginertia="0.002 0.01 0.01"/>
<body name="l3" pos="0.25 0 0"><joint name="roll" axis="1 0 0" armature="0.01" damping="0.2" frictionloss="0.1"/>
<inertial pos="0.08 0.03 0" mass="0.6" diaginertia="0.001 0.002 0.002"/></body></body></body>
</worldbody></mujoco>"""
JOINTS = ("lift", "elbow", "roll")
T = np.arange(800) / 100


def torques(robot: str, seed: int):
    """(angles, torques) of a motion of the robot by MuJoCo's inverse dynamics, noise in both."""
    model = mujoco.MjModel.from_xml_string(robot)
    friction = model.dof_frictionloss.copy()
    model.dof_frictionloss[:] = 0  # its inverse of a soft constraint is not friction: added below
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    q, qd, qdd = np.zeros((3, len(T), 3))
    for hz in (0.3, 0.7, 1.3):
        phase, size = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.15, 0.35, 3)
        w = 2 * np.pi * hz
        angle = w * T[:, None] + phase
        q += size * np.sin(angle)
        qd += size * w * np.cos(angle)
        qdd -= size * w**2 * np.sin(angle)
    tau = np.zeros_like(q)
    for k in range(len(T)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], qd[k], qdd[k]
        mujoco.mj_inverse(model, data)
        tau[k] = data.qfrc_inverse + friction * np.sign(qd[k])
    return q + 1e-5 * rng.standard_normal(q.shape), tau + 0.01 * rng.standard_normal(q.shape)


def recorded(robot: str, runs: int = 4) -> jaxid.Dataset:
    made = [torques(robot, seed) for seed in range(runs)]
    return jaxid.Dataset.from_arrays(
        [T] * runs,
        {f"{j}_tau": [tau[:, k] for _, tau in made] for k, j in enumerate(JOINTS)},
        {j: [q[:, k] for q, _ in made] for k, j in enumerate(JOINTS)},
        units={j: "rad" for j in JOINTS} | {f"{j}_tau": "N m" for j in JOINTS},
        noise_std={j: 1e-5 for j in JOINTS},
        split=["fit", "fit", "validation", "report"][:runs],
    )


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(FILE)
    return str(path)


@pytest.mark.slow
def test_a_wrong_number_of_the_file_is_the_answer(file):
    true = re.sub(r'frictionloss="0.3"', 'frictionloss="0.42"', FILE)
    found = jaxid.diagnose(file, recorded(true), residual="inverse_dynamics")
    assert found.which.verdict == "none" and not found.which.effects
    refuted = [s for s in found.final.stated if s.refuted]
    assert [(s.joint, s.parameter) for s in refuted] == [("elbow", "frictionloss")]
    assert abs(refuted[0].fitted - 0.42) < 4 * (refuted[0].std or 0.0)
    assert found.how_far.gap_before > 2 * found.how_far.gap_retuned
    assert "elbow" in str(found) and "0.42" in str(found)


@pytest.mark.slow
def test_a_right_file_has_nothing_refuted(file):
    found = jaxid.diagnose(file, recorded(FILE), residual="inverse_dynamics")
    assert found.which.verdict == "none"
    assert not [s for s in found.final.stated if s.refuted]


def test_an_arm_whose_free_runs_take_minutes_goes_by_torque(file, monkeypatch):
    data = recorded(FILE, runs=2)
    monkeypatch.setattr(foreseen, "FREE_RUNS_S", 0.0)
    nominal = resolve_model(file, data, ())
    why = foreseen.long_free_runs(nominal, data, ())
    assert "inverse_dynamics" in why and "minutes" in why
    assert not foreseen.long_free_runs(nominal, data, (), residual="output_error")
    monkeypatch.setattr(foreseen, "FREE_RUNS_S", 1e9)
    assert not foreseen.long_free_runs(nominal, data, ())
