"""Robots' files whose inertias come from meshes, whose weight is cancelled, or that are no robot:
what is taken, and what is said of the rest.
"""

import importlib
from typing import Any

import numpy as np
import pytest

from jaxid import Dataset, UsageError
from jaxid.models import Robot
from jaxid.numerics.precision import float64
from jaxid.robots.arms import as_arm
from jaxid.robots.export.run import export
from jaxid.robots.floating import floating
from jaxid.robots.match import robot_of, spec_of_file
from jaxid.robots.mjcf import read_mjcf
from jaxid.robots.mjcf_text import expanded
from jaxid.robots.origin import origin
from written_robots import lifted, quadruped


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads

INERTIAL = '<inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>'
#: A tetrahedron, as OBJ.
OBJ = "v 0 0 0\nv 0.3 0 0\nv 0 0.2 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
SCALED = '<mesh name="m" file="a.obj" scale="2 1 1"/>'
ROBOT = f"""<mujoco><compiler meshdir="parts"/><asset>{SCALED}<mesh file="seen.obj"/></asset><worldbody>
<body name="l1"><joint name="lift" axis="0 1 0"/><geom type="mesh" mesh="m" density="500" euler="10 20 30"/>
<geom type="mesh" mesh="seen" mass="0"/>
<body name="l2" pos="0.2 0 0"><joint name="elbow" axis="0 1 0"/>{INERTIAL}
<body pos="0.1 0 0"><geom type="mesh" mesh="m" mass="0.4"/><geom type="sphere" size="0.05" pos="0 0 0.1"/></body>
</body></body></worldbody></mujoco>"""


def written(folder, text=ROBOT, mesh=OBJ):
    (folder / "parts").mkdir(exist_ok=True)
    (folder / "parts" / "a.obj").write_text(mesh)
    robot = folder / "robot.xml"
    robot.write_text(text)
    return robot


def peer(robot):
    """The mass of what hangs on each joint, and the joint space inertia at zero, by MuJoCo."""
    spec = mujoco.MjSpec.from_file(str(robot))
    for geom in [g for g in spec.geoms if g.meshname == "seen"]:
        spec.delete(geom)
    spec.delete(next(m for m in spec.meshes if m.name == "seen"))
    model = spec.compile()
    data = mujoco.MjData(model)
    dense = np.zeros((2, 2))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, dense)
    return model.body_subtreemass[[1, 2]], dense


def test_inertia_that_comes_from_meshes_is_mujocos(tmp_path):
    """A mesh that weighs nothing is not read: it is not there."""
    robot = written(tmp_path)
    tree = read_mjcf(robot)
    masses, dense = peer(robot)
    np.testing.assert_allclose(np.cumsum(tree.inertia[::-1, 9])[::-1], masses, rtol=1e-12)
    np.testing.assert_allclose(tree.swung(), np.diag(dense), rtol=1e-9)
    assert tree.links == ("l1", "l2")


def test_a_dataset_keeps_the_inertia_and_needs_no_mesh_any_more(tmp_path):
    robot = written(tmp_path)
    masses, _ = peer(robot)
    geometry = spec_of_file(str(robot)).geometry
    assert geometry is not None and geometry.robot is not None
    (tmp_path / "parts" / "a.obj").unlink()
    tree = robot_of(geometry.robot, "elsewhere.xml").tree.tree
    assert abs(tree.inertia[:, 9].sum() - masses[0]) < 1e-12
    assert "a body without a name" not in geometry.robot


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("a.obj", "b.obj", ("b.obj", "is not there", "parts", "l1", "<inertial")),
        ('"a.obj"', '"../../a.obj"', ("outside the folder", "l1")),
        ("a.obj", "a.dae", ("a.dae", ".stl, .obj, .msh")),
    ],
)
def test_a_mesh_that_is_not_read_is_named(tmp_path, old, new, words):
    robot = written(tmp_path, ROBOT.replace(old, new))
    with pytest.raises(UsageError) as error:
        read_mjcf(robot)
    assert all(word in str(error.value) for word in words), str(error.value)


def test_a_mesh_that_is_no_mesh_is_refused(tmp_path):
    with pytest.raises(UsageError, match="MuJoCo does not take it"):
        read_mjcf(written(tmp_path, mesh="v 0 0 0\n"))


def test_meshes_that_give_no_inertia_are_not_looked_for(tmp_path):
    stated = ROBOT.replace("<geom", INERTIAL + "<geom", 1).replace('mass="0.4"', 'mass="0"')
    robot = tmp_path / "robot.xml"
    robot.write_text(stated)
    assert read_mjcf(robot).inertia[0][9] == 0.3
    assert "<mesh" not in expanded(robot)


def test_weight_that_the_file_cancels_stays_cancelled_where_joints_are_held():
    """Of joints that are held the bodies belong to what carries them, their lift too."""
    text = lifted()
    tree = read_mjcf("robot.xml", text).locked({"finger1": 0.02, "j3": 0.7})
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    own = [model.joint(name).id for name in tree.joints]
    q = np.array([0.3, -0.8, 0.5])
    data.qpos[:] = [0.3, -0.8, 0.7, 0.5, 0.02]
    mujoco.mj_forward(model, data)
    needed = (data.qfrc_bias - data.qfrc_gravcomp)[own]
    assert np.abs(data.qfrc_gravcomp[own]).min() > 0.1
    zero = np.zeros(3)
    robot = Robot(tree, driven=False)
    with float64():
        found = np.asarray(robot.inverse(q, zero, zero))
    np.testing.assert_allclose(found, needed, atol=1e-10)
    assert any("gravcomp" in note and "j1_link, j3_link" in note for note in tree.notes)


def test_what_takes_no_cancelled_weight_says_so():
    floats = quadruped().replace('name="FL1_link"', 'name="FL1_link" gravcomp="1"')
    with pytest.raises(UsageError, match="gravcomp"):
        floating(read_mjcf("robot.xml", floats))
    joints = ("j1", "j2", "j3", "j4")
    t = np.arange(100) * 0.01
    course = {j: np.sin(3 * t + k) for k, j in enumerate(joints)}
    torques = {f"{j}_tau": np.cos(3 * t + k) for k, j in enumerate(joints)}
    units = {j: "rad" for j in joints} | {f"{j}_tau": "N m" for j in joints}
    data = Dataset.from_arrays(t, torques, course, units=units, check_model=False)
    with pytest.raises(UsageError, match="identify takes no robot whose weight the file cancels"):
        as_arm(Robot.from_mjcf("robot.xml", text=lifted()), data)


def test_an_export_says_what_cancelled_weight_does_to_a_patched_body(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(lifted())
    tree = read_mjcf(path)
    numbers = {"mass@j3_link": 1.5, "mass@j2_link": 1.5}
    content = {
        "schema": 1,
        "kind": "fit",
        "model": "robot",
        "robot": origin(Robot(tree, driven=False), None),
        "effects": [],
        "parameters": {k: {"value": v, "std": 0.1, "unit": "kg"} for k, v in numbers.items()},
    }
    notes = {row.location: row.note for row in export(content, "mjcf").rows}
    assert "gravcomp cancels the weight as patched" in notes["j3_link"]
    assert "gravcomp" not in notes["j2_link"]


def test_a_limit_that_cancelled_weight_counts_against_is_said():
    text = lifted().replace(
        'name="j1" ', 'name="j1" actuatorgravcomp="true" actuatorfrcrange="-5 5" ', 1
    )
    assert any("actuatorgravcomp of j1" in note for note in read_mjcf("robot.xml", text).notes)


def test_files_that_are_no_robot_are_told_from_robots(tmp_path):
    part = tmp_path / "drives.xml"
    part.write_text('<mujoco><actuator><position joint="lift" class="strong"/></actuator></mujoco>')
    (tmp_path / "robot.xml").write_text('<mujoco><include file="drives.xml"/></mujoco>')
    keys = tmp_path / "keys.xml"
    keys.write_text('<mujoco><keyframe><key name="home" qpos="0 0"/></keyframe></mujoco>')

    def body(inside):
        return f'<mujoco><worldbody><body name="a">{inside}{INERTIAL}</body></worldbody></mujoco>'

    for file, text, words in (
        (part, None, "robot.xml includes it"),
        (keys, None, "holds no <body>"),
        ("one.xml", body("<freejoint/>"), "moves freely or turns on balls alone"),
        ("one.xml", body(""), "it has no joint"),
    ):
        with pytest.raises(UsageError, match=words):
            read_mjcf(file, text)
