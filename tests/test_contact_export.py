"""What was found of the ground, written into a file and run in MuJoCo."""

import importlib
from typing import Any

import numpy as np
import pytest

from jaxid.robots.export.mjcf_file import MjcfFile
from jaxid.robots.export.mjcf_ground import on_the_ground
from jaxid.robots.export.sheet import RobotChange
from jaxid.robots.export.target import APPROXIMATE, EXACT
from jaxid.robots.mjcf import read_mjcf
from jaxid.simulation.mujoco_run import Driven, MujocoRobot


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads

FILE = """<mujoco><compiler angle="radian"/><option timestep="0.002"/>
  <worldbody><geom name="floor" type="plane" size="1 1 .1" pos="0 0 -.1" friction="0.9"/>
  <body name="arm"><joint name="lift" axis="0 1 0" damping="0.1"/>
    <inertial pos=".15 0 0" mass="0.4" diaginertia=".002 .002 .002"/>
    <geom {name} type="sphere" size=".02" pos=".3 0 0" friction="0.7 0.01 0.001" {more}/>
  </body></worldbody>
  <actuator><position joint="lift" kp="8" kv="0.5"/></actuator></mujoco>"""


def patched(tmp_path, value: float, name: str = 'name="ball"', more: str = ""):
    """The fields, and the friction and stiffness of the contact that the patched file has."""
    path = tmp_path / "arm.xml"
    path.write_text(FILE.format(name=name, more=more))
    file = MjcfFile(path)
    change = RobotChange(
        effect="sliding_friction",
        location="ball",
        quantity="sliding_friction",
        place="ball",
        value=value,
        before=None,
        unit="1",
    )
    fields, ops = on_the_ground([change], file)
    model = mujoco.MjModel.from_xml_string(file.texts["arm.xml"].result())
    data = mujoco.MjData(model)
    data.qpos[0] = 0.35
    mujoco.mj_forward(model, data)
    assert data.ncon == 1
    return fields, ops, data.contact[0].friction


def how(fields) -> str:
    return fields["sliding_friction", "ball"].how


@pytest.mark.parametrize("value", [0.45, 0.8, 1.3])
def test_the_contact_has_the_friction_that_was_found(value, tmp_path):
    fields, ops, friction = patched(tmp_path, value)
    np.testing.assert_allclose(friction, [value, value, 0.01, 0.001, 0.001])
    assert how(fields) == EXACT
    assert ops[0].attributes["friction"] == [value, 0.01, 0.001]


def test_a_shape_that_says_more_of_its_contact_says_so(tmp_path):
    fields, _, friction = patched(tmp_path, 0.45, more='solref="0.01 1"')
    assert friction[0] == pytest.approx(0.45)
    assert how(fields) == APPROXIMATE


def test_a_shape_without_a_name_is_not_written(tmp_path):
    fields, ops, friction = patched(tmp_path, 0.45, name="")
    assert not fields
    assert not ops
    assert friction[0] == pytest.approx(0.9)


def test_a_file_runs_on_its_floor_where_contacts_are_asked_for(tmp_path):
    path = tmp_path / "arm.xml"
    text = FILE.format(name='name="ball"', more="")
    path.write_text(text)
    t = np.arange(0.0, 2.0, 0.002)
    goals = 0.6 * np.sin(2 * np.pi * 0.5 * t)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    expected = np.empty_like(t)
    for k, goal in enumerate(goals):
        expected[k], data.ctrl[:] = data.qpos[0], goal
        mujoco.mj_step(model, data)
    still = np.zeros(1)
    found = {}
    for contacts in (True, False):
        robot = MujocoRobot(path, read_mjcf(path), {}, None, ("lift",), contacts=contacts)
        drive = Driven("goal", None, robot)
        run = robot.run(("lift",), t, goals[:, None], [False], drive, still, still)
        found[contacts] = run[:, 0]
    np.testing.assert_allclose(found[True], expected, rtol=0, atol=1e-12)
    assert np.max(np.abs(found[False] - expected)) > 0.05
