"""Export of results of a gripper whose recorded finger follows another one in the file."""

import importlib
from typing import Any

import numpy as np
import pytest

from jaxid import Dataset
from jaxid.models import Robot
from jaxid.problem.binding import resolve_model
from jaxid.robots.export.run import export
from jaxid.robots.match import prepared
from jaxid.robots.origin import origin


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads

LINK = '<inertial pos="0.05 0 0.02" mass="0.4" diaginertia="8e-4 9e-4 7e-4"/>'
#: In the file `right` leads, and the drive acts on `left`, which follows.
GRIPPER = f"""<mujoco><compiler angle="radian"/><worldbody>
<body name="l1"><joint name="lift" axis="0 1 0" damping="0.3"/>{LINK}
<body name="a"><joint name="left" type="slide" axis="0 1 0" damping="2" frictionloss="0.1"/>{LINK}</body>
<body name="b"><joint name="right" type="slide" axis="0 -1 0" damping="3"/>{LINK}</body></body>
</worldbody><equality><joint joint1="left" joint2="right" polycoef="0.01 -2 0 0 0"/></equality>
<actuator><position joint="lift" kp="8" forcerange="-9 9"/><position joint="left" kp="40" kv="4" forcerange="-6 6"/>
</actuator></mujoco>"""


def robot_of_a_result(path, finger):
    """What a result says of its robot where `finger` and its goal were recorded."""
    t = np.arange(100) * 0.01
    course = {name: 0.02 + 0.01 * np.sin(3 * t + k) for k, name in enumerate(("lift", finger))}
    goals = {f"{name}_cmd": values for name, values in course.items()}
    units = {"lift": "rad", "lift_cmd": "rad", finger: "m", f"{finger}_cmd": "m"}
    data = Dataset.from_arrays(t, goals, course, units=units, check_model=False)
    robot, data = prepared(Robot.from_mjcf(str(path)), data)
    chain: Any = resolve_model(robot, data)
    return origin(chain.mechanism, None)


def result(path, finger, numbers):
    entries = {name: {"value": value, "std": 1e-3, "unit": ""} for name, value in numbers.items()}
    robot = robot_of_a_result(path, finger)
    head = {"schema": 1, "kind": "fit", "model": "robot", "robot": robot, "effects": []}
    return head | {"parameters": entries}


@pytest.fixture
def gripper(tmp_path):
    path = tmp_path / "gripper.xml"
    path.write_text(GRIPPER)
    return path


def test_numbers_of_a_recorded_follower_go_to_it_and_its_drive(gripper):
    """0.5 N s/m more than both fingers have together, seen from the follower: 2 + 3 / 4."""
    numbers = {"damping@left": 3.25, "frictionloss@left": 0.3, "kp@left": 50.0, "damping@lift": 0.4}
    content = result(gripper, "left", numbers)
    assert content["robot"]["leads"] == ["lift", "left"]
    found = export(content, "mjcf")
    assert {row.how for row in found.rows} == {"exact", "approximate"}  # friction is soft there
    model = mujoco.MjModel.from_xml_string(found.files["gripper.xml"])
    np.testing.assert_allclose(model.dof_damping, [0.4, 2.5, 3.0])
    np.testing.assert_allclose(model.dof_frictionloss, [0.0, 0.3, 0.0])
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], [8.0, 50.0])


def test_a_result_without_its_leaders_has_them_by_its_drive(gripper):
    content = result(gripper, "left", {"damping@left": 3.25})
    del content["robot"]["leads"]
    (row,) = export(content, "mjcf").rows
    assert (row.how, row.value) == ("exact", 3.25)


def test_a_drive_at_the_joint_that_was_not_recorded_is_told_with_the_ratio(gripper):
    found = export(result(gripper, "right", {"kp@right": 200.0, "damping@right": 12.0}), "mjcf")
    rows = {row.effect: row for row in found.rows}
    assert rows["damping"].how == "exact" and rows["kp"].how == "code"
    assert "drives right through left = -2 right" in rows["kp"].note
    assert "divide kp and kd by -2^2" in rows["kp"].note


@pytest.mark.parametrize("target", ["urdf", "isaaclab", "drake", "ros2_control", "genesis"])
def test_other_targets_take_a_recorded_follower_too(gripper, target):
    found = export(result(gripper, "left", {"damping@left": 3.25}), target)
    assert found.rows and all(row.location == "left" for row in found.rows)
