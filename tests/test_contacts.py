"""Contacts of a robot's file: simulated where they are asked for, else what lies between counts."""

import importlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.data.dataset import ModelSpec
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.replay import in_mujoco
from jaxid.models import Robot
from jaxid.problem.binding import bind
from jaxid.problem.residual import OutputError
from jaxid.robots.contacts import GUARD
from jaxid.robots.match import prepared
from jaxid.robots.mjcf import read_mjcf


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads

STEP = 0.002
#: A pendulum of 0.3 m with a ball at its end, whose pivot is `height` over a floor.
FILE = """<mujoco><compiler angle="radian"/><option timestep="0.002"/>
  <worldbody><geom name="floor" type="plane" size="1 1 .1" pos="0 0 {floor}"/>
  <body name="base"><geom name="mount" type="box" size=".02 .02 .5"/>
  <body name="arm"><joint name="lift" axis="0 1 0" damping="0.1"/>
    <inertial pos=".15 0 0" mass="0.4" diaginertia=".002 .002 .002"/>
    <geom name="ball" type="sphere" size=".02" pos=".3 0 0"/></body></body></worldbody>
  {more}<actuator><position joint="lift" kp="8" kv="0.5"/></actuator>
</mujoco>"""


def goals() -> np.ndarray:
    t = np.arange(2000) * STEP
    return 0.6 * np.sin(2 * np.pi * 0.5 * t) * t / t[-1]


def recorded(text: str, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions in MuJoCo, and in which samples there is a contact."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    q, touching = np.empty(len(u)), np.zeros(len(u), bool)
    for k, goal in enumerate(u):
        q[k] = data.qpos[0]
        mujoco.mj_fwdPosition(model, data)
        touching[k] = data.ncon > 0
        data.ctrl[:] = goal
        mujoco.mj_step(model, data)
    return q, touching


def prepared_by(text: str, runs: int = 1, **model: Any) -> tuple[jaxid.Dataset, np.ndarray]:
    u = goals()
    q, touching = recorded(text, u)
    data = jaxid.Dataset.from_arrays(
        [np.arange(len(u)) * STEP] * runs,
        {"lift_cmd": [u] * runs},
        {"lift": [q] * runs},
        units={"lift": "rad", "lift_cmd": "rad"},
        check_model=False,
    )
    data = replace(data, model=ModelSpec(**model))
    robot = Robot.from_mjcf("arm.xml", text=text)
    return prepared(robot, data)[1], touching


def file(floor: float = -0.1, more: str = "") -> str:
    return FILE.format(floor=floor, more=more)


def test_what_the_simulator_of_its_file_touches_does_not_count():
    data, touching = prepared_by(file())
    first = int(np.argmax(touching))
    assert 100 < first < 1900
    assert len(data.experiments) > 1
    assert data.experiments[0].t[-1] == pytest.approx((first - GUARD - 1) * STEP)
    for part in data.experiments:
        known = np.round(part.whole.t / STEP).astype(int)
        assert not touching[known].any()
    counted = sum(len(part) for part in data.experiments)
    assert counted > 0.8 * np.sum(~touching)
    assert f"run_1 (ball touches floor after {first * STEP:.3g} s" in data.notes[-1]


@pytest.mark.slow
def test_parts_between_contacts_are_fitted_with_what_is_known_before_them():
    """A delay acts at the beginning of a part, too: its damping and its delay come back."""
    data, _ = prepared_by(file())
    robot = Robot.from_mjcf("arm.xml", text=file())
    found = jaxid.fit(robot, data, effects=["input_delay@lift_cmd"])
    assert found.parameters["damping@lift"].value == pytest.approx(0.1, rel=0.02)
    assert abs(found.effects[0].parameters["delay"].value) < STEP / 2


@pytest.mark.parametrize(
    "text",
    [
        file(floor=-1.0),
        file(more='<contact><exclude body1="world" body2="arm"/></contact>'),
        file().replace("<option", '<option><flag contact="disable"/></option><option'),
        file().replace('type="plane"', 'type="plane" contype="0" conaffinity="0"'),
    ],
    ids=["below", "excluded", "disabled", "drawn"],
)
def test_nothing_is_cut_where_the_file_has_no_contact(text):
    data, touching = prepared_by(text)
    assert not touching.any()
    assert [len(run) for run in data.experiments] == [2000]
    assert not any("touch" in note for note in data.notes)


def test_who_knows_that_nothing_touches_says_so(tmp_path):
    data, _ = prepared_by(file(), contacts=False)
    assert [len(run) for run in data.experiments] == [2000]
    jaxid.save_dataset(data, tmp_path / "kept")
    again = jaxid.load_dataset(tmp_path / "kept", check_model=False)
    assert again.model is not None and again.model.contacts is False


def test_runs_that_touch_from_the_start_are_refused():
    with pytest.raises(jaxid.UsageError, match=r"ball touches floor.*contacts = false"):
        prepared_by(file(floor=0.5))


def test_a_dataset_on_disk_is_cut_alike(tmp_path):
    text = file()
    u = goals()
    q, touching = recorded(text, u)
    (tmp_path / "arm.xml").write_text(text)
    table = np.column_stack([np.arange(len(u)) * STEP, u, q])
    np.savetxt(
        Path(tmp_path) / "run.csv", table, delimiter=",", header="t,lift_cmd,lift", comments=""
    )
    (tmp_path / "dataset.toml").write_text(
        'name = "touch"\n[model]\nrobot = "arm.xml"\n[channels.lift_cmd]\nrole = "input"\n'
        'unit = "rad"\n[channels.lift]\nrole = "output"\nunit = "rad"\n[[experiments]]\n'
        'file = "run.csv"\n'
    )
    data = prepared(None, jaxid.load_dataset(tmp_path, check_model=False))[1]
    assert len(data.experiments) > 1
    for part in data.experiments:
        assert not touching[np.round(part.t / STEP).astype(int)].any()


#: A leg of three joints that a guide lets slide, with nothing that drives its two slides.
LEG = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="{integrator}"/>
  <worldbody><geom name="floor" type="plane" size="5 5 .1"/>
  <body name="hips" pos="0 0 .62"><joint name="along" type="slide" axis="1 0 0"/>
    <joint name="up" type="slide" axis="0 0 1" ref=".62" damping=".5"/>
    <geom type="box" size=".08 .05 .05" mass="3"/>
  <body name="thigh"><joint name="hip" axis="0 1 0" armature=".01" damping=".2"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass=".6"/>
  <body name="shank" pos="0 0 -.3"><joint name="knee" axis="0 1 0" armature=".01" damping=".2"
      frictionloss=".1"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.25" size=".025" mass=".4"/>
  <body name="foot" pos="0 0 -.28"><geom name="sole" mass=".1" {shape}/></body>
  </body></body></body></worldbody>
  <actuator><position joint="hip" kp="200" kv="4"/>
    <position joint="knee" kp="200" kv="4" forcerange="-60 60"/></actuator></mujoco>"""
SOLES = {
    "sphere": 'type="sphere" size=".03"',
    "capsule": 'type="capsule" fromto="-.05 0 0 .06 .01 0" size=".02" friction="1.2 .005 .0001"',
    "box": 'type="box" size=".05 .02 .01" solref=".01 .8" solimp=".8 .95 .002 .4 1.5"',
}


def hopping(text: str) -> tuple[jaxid.Dataset, np.ndarray]:
    """Eight hundred steps of the leg in MuJoCo that begin at rest, and its positions [time 4]."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    t = np.arange(800) * STEP
    bend = 0.8 + 0.45 * np.clip(1.5 * np.sin(2 * np.pi * 1.4 * t), -0.6, 1.0)
    u = np.stack([-0.5 * bend, bend], 1)
    data.qpos[:] = [0.0, 0.6, *u[0]]
    q, landed = np.empty((len(t), 4)), 0
    for k, goal in enumerate(u):
        q[k], data.ctrl[:] = data.qpos, goal
        mujoco.mj_step(model, data)
        landed += data.ncon > 0
    assert 100 < landed < 790
    names = ("along", "up", "hip", "knee")
    recorded = jaxid.Dataset.from_arrays(
        [t],
        {f"{name}_cmd": [u[:, k]] for k, name in enumerate(names[2:])},
        {name: [q[:, k]] for k, name in enumerate(names)},
        units={
            **dict.fromkeys(names[:2], "m"),
            **dict.fromkeys([*names[2:], "hip_cmd", "knee_cmd"], "rad"),
        },
        initial=[{name: float(q[0, k]) for k, name in enumerate(names)}],
        check_model=False,
    )
    return replace(recorded, model=ModelSpec(contacts=True)), q


def rollout(text: str, data: jaxid.Dataset, **numbers: float) -> tuple[np.ndarray, list[str]]:
    """The simulation of a file from rest, and the names of the model's numbers."""
    robot = Robot.from_mjcf("leg.xml", text=text)
    binding = bind(robot, data, splits=False)
    runs = ProblemBuilder(binding, differences=1).runs(OutputError(), "fit")
    theta = binding.theta.copy()
    for name, value in numbers.items():
        theta[binding.layout.names.index(name)] = value
    start = np.concatenate([data.experiments[0].y[0], np.zeros(4)])
    lane = runs.engine.outputs(theta[None], start[None], np.zeros(1, int))[0]
    return lane[: len(data.experiments[0])], list(binding.layout.names)


@pytest.mark.parametrize(
    "sole",
    [
        "capsule",
        pytest.param("sphere", marks=pytest.mark.slow),
        pytest.param("box", marks=pytest.mark.slow),
    ],
)
def test_a_leg_hops_as_it_does_in_mujoco(sole):
    integrator = {"sphere": "Euler", "capsule": "implicitfast", "box": "RK4"}[sole]
    text = LEG.format(shape=SOLES[sole], integrator=integrator)
    data, q = hopping(text)
    found, names = rollout(text, data)
    np.testing.assert_allclose(found, q, rtol=0, atol=1e-8)
    assert "sliding_friction@sole" in names
    slippery, _ = rollout(text, data, **{"sliding_friction@sole": 0.1})
    assert np.max(np.abs(slippery - q)) > 1e-3


def test_a_replay_lets_joints_without_an_actuator_move_on_the_ground(tmp_path):
    text = LEG.format(shape=SOLES["capsule"], integrator="implicitfast")
    path = tmp_path / "leg.xml"
    path.write_text(text)
    recorded, q = hopping(text)
    data = prepared(Robot.from_mjcf(path), recorded)[1]
    start = np.concatenate([q[0], np.zeros(4)])
    notes: list[str] = []
    (found,) = in_mujoco(data, path, read_mjcf(path), None, [start], notes)
    np.testing.assert_allclose(found, q, rtol=0, atol=1e-12)
    assert any("driven by the position actuators" in note for note in notes)


def test_a_slide_has_forces_and_a_hinge_torques():
    text = LEG.format(shape=SOLES["capsule"], integrator="implicitfast")
    data, _ = hopping(text)
    chain = bind(Robot.from_mjcf("leg.xml", text=text), data, splits=False).chain
    units = dict(chain.torque_channels)
    assert units == {
        "torque at along": "N",
        "torque at up": "N",
        "torque at hip": "N m",
        "torque at knee": "N m",
    }


def test_where_a_robot_of_two_limbs_touches_its_torques_tell_nothing():
    joints = ("trunk", "left", "right")
    arm = """<body name="{name}"><joint name="{name}" axis="0 1 0" damping=".1"/>
      <inertial pos=".15 0 0" mass=".4" diaginertia=".002 .002 .002"/>
      <geom type="sphere" size=".02" pos=".3 0 0"/></body>"""
    arms = "".join(arm.format(name=name) for name in joints[1:])
    drives = "".join(f'<position joint="{name}" kp="8" kv=".5"/>' for name in joints)
    text = f"""<mujoco><compiler angle="radian"/><option timestep="0.002"/><worldbody>
      <geom type="plane" size="1 1 .1" pos="0 0 -.1"/><body name="trunk">
      <joint name="trunk" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
      {arms}</body></worldbody><actuator>{drives}</actuator></mujoco>"""
    t = np.arange(200) * STEP
    q = np.stack([0.1 * np.sin(9 * t), 0.6 * t / t[-1], -0.1 * np.sin(5 * t) ** 2], 1)
    data = jaxid.Dataset.from_arrays(
        [t],
        {f"{name}_cmd": [q[:, k]] for k, name in enumerate(joints)},
        {name: [q[:, k]] for k, name in enumerate(joints)},
        units=dict.fromkeys([*joints, *(f"{name}_cmd" for name in joints)], "rad"),
        check_model=False,
    )
    data = replace(data, model=ModelSpec(contacts=True))
    robot = Robot.from_mjcf("arms.xml", text=text)
    mechanism = bind(robot, data, splits=False).chain.mechanism
    first = int(np.argmax(0.3 * np.sin(q[:, 1]) >= 0.08))
    told = mechanism.told_by_torque(q, 3)
    np.testing.assert_array_equal(told, np.arange(len(t)) < first - 3)
