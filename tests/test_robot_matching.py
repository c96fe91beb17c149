"""A robot and a recording: channels by joint names, what drives, and which joints are held."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid import Dataset, UsageError
from jaxid.base.errors import DatasetError
from jaxid.data.dataset import Controller, ModelSpec
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.models import Robot
from jaxid.problem.binding import resolve_model
from jaxid.robots.limbs import limbs_of
from jaxid.robots.match import prepared
from written_robots import quadruped, two_arms


PD = Controller("pd", {"kp": 20.0, "kd": 1.5, "sample_time": 0.0})
T = np.arange(100) * 0.01


def wave(k):
    return 0.1 * np.sin(3 * T + k)


def recording(joints, ends=("_cmd",), role="inputs", controller: Any = PD, **more: Any):
    names = [j + e for e in ends for j in joints]
    inputs = {n: wave(k) for k, n in enumerate(names)}
    groups = {"inputs": inputs} if role == "inputs" else {"auxiliary": inputs}
    units = {
        n: "N m" if n.endswith("_tau") or n.startswith("tau") else "rad" for n in [*names, *joints]
    }
    return Dataset.from_arrays(
        T,
        outputs={j: wave(k + 0.5) for k, j in enumerate(joints)},
        units=units,
        controller=controller,
        **groups,
        **more,
    )


def arms(**more):
    return Robot.from_mjcf("robot.xml", text=two_arms(), **more)


LEFT, RIGHT = [f"left{k}" for k in (1, 2, 3, 4)], [f"right{k}" for k in (1, 2, 3)]


def test_joints_go_by_name_in_any_order():
    robot, data = prepared(arms(), recording([*RIGHT[::-1], *LEFT]))
    chain: Any = resolve_model(robot, data)
    assert chain.signature.joints == (*LEFT, *RIGHT)
    assert {e.name for e in chain.effects} == {
        "viscous_friction",
        "coulomb_friction",
        "position_law",
    }


def test_numbered_channels_follow_the_file_and_the_result_says_so():
    joints = [f"q{k}" for k in range(1, 8)]
    data = recording(joints, ends=(), controller=None)
    _, named = prepared(arms(), data)
    assert [c.name for c in named.outputs] == [*LEFT, *RIGHT]
    assert "q1 = left1" in named.notes[-1]
    spec = ModelSpec(free=True, joints={"q1": "right1", "q2": "left1"})
    _, named = prepared(arms(), recording(["q1", "q2"], ends=(), controller=None, model=spec))
    assert [c.name for c in named.outputs] == ["right1", "left1"]


def test_joints_that_are_not_recorded_are_held_and_their_bodies_carried():
    robot, data = prepared(arms(), recording(LEFT[:2]))
    chain: Any = resolve_model(robot, data)
    tree = chain.mechanism.tree.tree
    assert tree.joints == ("left1", "left2")
    whole = arms().tree.tree
    left = [k for k, j in enumerate(whole.joints) if j in LEFT]
    assert abs(tree.inertia[:, 9].sum() - whole.inertia[left, 9].sum()) < 1e-12
    with pytest.raises(UsageError, match="left3 has a goal and no measured position"):
        both = recording(LEFT[:2])
        extra = recording(["left3"])
        cmd = Dataset.from_arrays(
            T,
            {
                **{c.name: both.experiments[0].u[:, i] for i, c in enumerate(both.inputs)},
                "left3_cmd": extra.experiments[0].u[:, 0],
            },
            {c.name: both.experiments[0].y[:, i] for i, c in enumerate(both.outputs)},
            units={n: "rad" for n in ("left1", "left2", "left1_cmd", "left2_cmd", "left3_cmd")},
            controller=PD,
        )
        resolve_model(*prepared(arms(), cmd))


def test_goals_alone_drive_and_goals_beside_torques_do_not():
    goals = recording(RIGHT, role="auxiliary")
    _, data = prepared(arms(), goals)
    assert [c.name for c in data.inputs] == [
        f"{j}_cmd" for j in RIGHT
    ] and "no torque was recorded" in data.notes[-1]
    both = recording(RIGHT, ends=("_cmd", "_tau"))
    with pytest.raises(UsageError, match="both goals .* are inputs"):
        resolve_model(*prepared(arms(), both))
    chain: Any = resolve_model(*prepared(arms(), recording(RIGHT, ends=("_tau",), controller=None)))
    assert chain.direct and {e.name for e in chain.effects} == {
        "viscous_friction",
        "coulomb_friction",
    }
    with pytest.raises(UsageError, match=r"states no position actuator for right1.*\[controller\]"):
        resolve_model(*prepared(arms(), recording(RIGHT, controller=None)))


def test_the_law_is_stated_by_number_list_or_name():
    def law(**settings):
        controller = Controller("pd", {"kp": 20.0, "kd": 1.5, "sample_time": 0.0, **settings})
        chain: Any = resolve_model(*prepared(arms(), recording(RIGHT, controller=controller)))
        return chain.mechanism

    assert law(kp=[1.0, 2.0, 3.0]).drive_law.kp == (1.0, 2.0, 3.0)
    named = law(
        kp={"right3": 3.0, "right1": 1.0, "right2": 2.0},
        fit=["kp", "delay"],
        spread={"kp": 0.5},
        delay=0.01,
    )
    assert named.drive_law.kp == (1.0, 2.0, 3.0)
    kp, late = named.known()["kp@right2"], named.known()["delay@right1"]
    assert (kp.lower, kp.upper, kp.prior) == (0.02, 7.0, {"mean": 2.0, "std": 1.0})
    assert (late.lower, late.upper, late.prior) == (0.0, 0.1, {"mean": 0.01, "std": 0.001})
    plain = law(fit=["kp", "kd"], spread=0.3).known()
    assert plain["kp@right1"].prior == {"mean": 20.0, "std": 6.0} and plain["kd@right1"].prior[
        "std"
    ] == pytest.approx(0.45)
    for settings, words in (
        ({"spread": 0.0}, "spread is 0.0; it is a positive number"),
        ({"spread": {"kq": 0.1}}, "spread"),
        ({"kp": {"right1": 1.0}}, "right2, right3"),
        ({"kp": [1.0, 2.0]}, "a list of 3"),
        ({"kq": 1.0}, "kq"),
        ({"fit": ["kq"]}, "kq"),
        ({"delay": 0.5}, "delay"),
        ({"velocity": "difference"}, "continuous"),
        ({"reference_velocity": "difference"}, "continuous"),
        ({"saturation": -1.0}, "positive"),
    ):
        with pytest.raises(UsageError, match=words):
            law(**settings)


def test_limbs_are_cut_apart_with_what_is_stated_of_them():
    robot = Robot.from_mjcf("robot.xml", text=quadruped())
    joints = [f"{leg}{k}" for leg in ("FL", "FR", "RL", "RR") for k in (1, 2, 3)]
    spec = ModelSpec(constants={"armature@RL2": 0.3, "base_roll": 0.1})
    limbs = limbs_of(
        robot,
        recording(
            joints,
            controller=replace(PD, settings={**PD.settings, "kp": list(range(1, 13))}),
            model=spec,
        ),
    )
    assert [r.signatures[0].joints for r, _ in limbs] == [
        tuple(joints[k : k + 3]) for k in (0, 3, 6, 9)
    ]
    third: Any = limbs[2][1]
    first: Any = limbs[0][1]
    assert [c.name for c in third.inputs] == [f"RL{k}_cmd" for k in (1, 2, 3)]
    assert third.controller.settings["kp"] == [7, 8, 9]
    assert third.model.constants == {
        "armature@RL2": 0.3,
        "base_roll": 0.1,
    } and first.model.constants == {"base_roll": 0.1}


def write(folder, model, joints=("lift", "elbow"), controller="", roles=("input", "output")):
    folder.mkdir()
    lines = ['name = "d"', model, controller]
    for j in joints:
        lines += [
            f'[channels.{j}_cmd]\nrole = "{roles[0]}"\nunit = "rad"',
            f'[channels.{j}]\nrole = "{roles[1]}"\nunit = "rad"',
        ]
    lines.append('[[experiments]]\nfile = "run.csv"')
    (folder / "dataset.toml").write_text("\n".join(lines))
    header = ",".join(["t", *(f"{j}_cmd" for j in joints), *joints])
    rows = [
        ",".join(repr(float(v)) for v in (t, *[wave(k)[i] for k in range(2 * len(joints))]))
        for i, t in enumerate(T)
    ]
    (folder / "run.csv").write_text("\n".join([header, *rows]))
    return folder


MJCF = """<mujoco><default><joint damping="0.6" frictionloss="0.05" armature="0.028"/><position kp="20" kv="0.5"/></default>
<worldbody><body name="l1"><joint name="lift" axis="0 1 0"/><inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>
<body name="l2" pos="0.2 0 0"><joint name="elbow" axis="0 1 0"/><inertial pos="0.1 0 0" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/>
</body></body></worldbody><actuator><position joint="lift"/><position joint="elbow"/></actuator></mujoco>"""


def test_a_dataset_names_its_robot(tmp_path):
    folder = write(
        tmp_path / "a", '[model]\nrobot = "arm.xml"\n[model.base]\nkind = "prescribed"\nroll = 0.2'
    )
    (folder / "arm.xml").write_text(MJCF)
    data = jaxid.load_dataset(folder)
    chain: Any = resolve_model(None, data)
    assert chain.signature.joints == ("lift", "elbow") and float(chain.mechanism.base_roll) == 0.2
    assert "armature@elbow" in (names := ParameterVector(chain).names) and "kp@lift" in names
    again = jaxid.load_dataset(jaxid.save_dataset(data, tmp_path / "copy"))
    assert resolve_model(None, again).signature == chain.signature


def test_an_mjcf_named_as_the_urdf_of_an_arm_and_goals_without_torque_are_read(tmp_path):
    folder = write(tmp_path / "a", '[model]\nname = "serial_arm"\nurdf = "arm.xml"', ("q1", "q2"))
    (folder / "arm.xml").write_text(MJCF)
    assert resolve_model(None, jaxid.load_dataset(folder)).signature.joints == ("lift", "elbow")


def test_faults_of_a_robot_stand_with_their_line(tmp_path):
    for number, (model, words) in enumerate(
        (
            ('[model]\nrobot = "arm.xml"\nname = "serial_arm"', "beside which name"),
            ('[model]\nrobot = "gone.xml"', "no file"),
            ('[model]\nrobot = "../arm.xml"', "outside the folder"),
            ('[model]\nrobot = "arm.xml"\n[model.joints]\nlift = "lft"', "'lft'"),
            (
                '[model]\nrobot = "arm.xml"\n[model.base]\nkind = "free"',
                "needs mass and inertia of the base",
            ),
            ('[model]\nname = "pendulum"\n[model.base]\nroll = 0.1', "belongs to a robot"),
        )
    ):
        folder = write(tmp_path / str(number), model)
        (folder / "arm.xml").write_text(MJCF)
        with pytest.raises(DatasetError, match=words):
            jaxid.load_dataset(folder)
