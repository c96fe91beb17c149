"""Robots' files: what is read from MJCF and URDF, and what is refused by name."""

import importlib
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from jaxid import UsageError
from jaxid.models import Robot
from jaxid.robots.mjcf import read_mjcf
from jaxid.robots.urdf_tree import read_urdf_tree
from written_robots import humanoid, quadruped


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads


INERTIAL = '<inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>'


def mjcf(body=INERTIAL, joint='<joint name="lift" axis="0 1 0"/>', more="", head=""):
    second = f'<body name="l2" pos="0.2 0 0"><joint name="elbow" axis="0 1 0"/>{INERTIAL}</body>'
    return f'<mujoco>{head}<worldbody><body name="l1" pos="0 0 0.1">{joint}{body}{second}</body></worldbody>{more}</mujoco>'


def read(text):
    return read_mjcf("robot.xml", text)


def refused(text, *words, reader=read_mjcf, file="robot.xml"):
    with pytest.raises(UsageError) as error:
        reader(file, text)
    assert all(word in str(error.value) for word in words), str(error.value)


def test_joints_of_an_mjcf_have_what_mujoco_compiles():
    head = (
        '<default><joint damping="0.6" frictionloss="0.05" armature="0.028" stiffness="2" springref="30"/>'
        '<position kp="20" kv="0.5" forcerange="-3 3" timeconst="0.01"/></default>'
    )
    drives = '<actuator><position name="a1" joint="lift" gear="2"/><motor name="a2" joint="elbow" gear="5"/></actuator>'
    pose = '<keyframe><key name="home" qpos="0.4 -0.7"/></keyframe>'
    tree = read(
        mjcf(
            joint='<joint name="lift" axis="0 1 0" damping="1 0.2 0.1" range="-90 90"/>',
            more=drives + pose,
            head=head,
        )
    )
    assert tree.joints == ("lift", "elbow") and tree.links == ("l1", "l2") and tree.ends == ("l2",)
    np.testing.assert_allclose(tree.armature, 0.028)
    np.testing.assert_allclose(tree.damping, [[1, 0.2, 0.1], [0.6, 0, 0]])
    np.testing.assert_allclose(tree.frictionloss, 0.05)
    np.testing.assert_allclose(tree.stiffness, 2)
    np.testing.assert_allclose(tree.spring, np.pi / 6)
    np.testing.assert_allclose([tree.lower[0], tree.upper[0]], [-np.pi / 2, np.pi / 2])
    lift, elbow = tree.actuators["lift"], tree.actuators["elbow"]
    assert (lift.kind, elbow.kind) == ("position", "motor")
    np.testing.assert_allclose(
        [lift.kp, lift.kd, *lift.force, lift.lag], [80, 2, -6, 6, 0.01]
    )  # at the joint: gear squared
    assert tree.neutral("lift") == 0.4 and tree.neutral("elbow") == -0.7


def test_a_stated_drive_gives_the_torque_of_mujoco():
    drives = (
        '<actuator><position joint="lift" kp="30" kv="1.5" forcerange="-4 4" gear="3"/></actuator>'
    )
    text = mjcf(more=drives)
    one = read(text).actuators["lift"]
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    clipped = 0
    for q, v, goal in rng.uniform(-1, 1, (200, 3)):
        data.qpos[0], data.qvel[0], data.ctrl[0] = (
            q,
            v,
            3 * goal,
        )  # MuJoCo's length is gear times the angle
        mujoco.mj_forward(model, data)
        tau = np.clip(one.kp * (goal - q) - one.kd * v + one.offset, *one.force)
        clipped += tau in one.force
        assert abs(tau - data.qfrc_actuator[0]) < 1e-12
    assert 0 < clipped < 200


def test_what_a_tree_cannot_express_is_refused_by_name():
    mesh = '<asset><mesh name="arm" file="nowhere.stl"/></asset>'
    refused(mjcf(body='<geom type="mesh" mesh="arm"/>', head=mesh), "l1", "meshes", "<inertial")
    refused(mjcf(head='<compiler inertiafromgeom="true"/>'), "inertiafromgeom")
    refused(
        mjcf(body=INERTIAL.replace("1e-3 1e-3 1e-3", "1e-3 1e-3 5e-3")), "l1", "0.005", "no body"
    )
    refused(mjcf(body=INERTIAL.replace("pos", 'mass="x" pos')), "robot.xml")
    refused("<robot/>", "<robot>", ".urdf")
    refused("<mujoco", "not XML")


def test_what_ties_joints_together_is_named_with_all_of_them():
    """Joints of a tendon, of a loop through its two branches, and behind a ball joint."""
    tendon = '<tendon><fixed name="t"><joint joint="lift" coef="1"/><joint joint="elbow" coef="1"/></fixed></tendon>'
    driven = (
        tendon
        + '<actuator><position tendon="t" kp="3"/></actuator><keyframe><key ctrl="1"/></keyframe>'
    )
    both = ("lift", "elbow")
    loop = '<equality><connect name="loop" body1="l1" body2="l2" anchor="0 0 0"/></equality>'
    to_the_world = '<equality><connect name="loop" body1="l2" anchor="0 0 0"/></equality>'
    cases = (
        (mjcf(more=tendon), []),
        (mjcf(more=tendon.replace('"t"', '"t" damping="1"')), [("tendon 't'", both)]),
        (mjcf(more=tendon.replace('"t"', '"t" range="-1 1"')), [("tendon 't'", both)]),
        (mjcf(more=driven), [("tendon 't'", both)]),
        (mjcf(more=loop), [("equality 'loop' (connect)", ("elbow",))]),
        (mjcf(more=to_the_world), [("equality 'loop' (connect)", both)]),
        (mjcf(joint='<joint name="lift" type="ball"/>'), [("ball joint 'lift'", ("elbow",))]),
    )
    for text, expected in cases:
        found = read(text).ties
        assert [t.joints for t in found] == [joints for _, joints in expected]
        assert all(t.what.startswith(what) for t, (what, _) in zip(found, expected, strict=True))


def test_shapes_without_meshes_give_the_inertia_of_mujoco():
    text = mjcf(body='<geom type="capsule" size="0.02 0.1" pos="0.1 0 0.02" mass="0.7"/>')
    model = mujoco.MjModel.from_xml_string(text)
    link = read(text).inertia[0]
    assert abs(link[9] - model.body_mass[1]) < 1e-15
    np.testing.assert_allclose(
        link[6:9], model.body_mass[1] * (model.body_ipos[1] - model.jnt_pos[0]), atol=1e-12
    )
    box = '<body name="box"><freejoint/><geom type="mesh" mesh="m"/></body>'
    loose = mjcf(head='<asset><mesh name="m" file="nowhere.stl"/></asset>').replace(
        "<worldbody>", "<worldbody>" + box
    )
    assert read(loose).joints == ("lift", "elbow")


def test_inertias_from_geometry_come_with_the_command_that_states_them(tmp_path):
    robot = tmp_path / "robot.xml"
    mesh = '<asset><mesh name="m" vertex="0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"/></asset>'
    body = '<geom type="mesh" mesh="m" mass="0.7"/>'
    robot.write_text(mjcf(head=mesh, body=body))
    assert read_mjcf(robot).inertia[0][9] == 0.7
    robot.write_text(mjcf(head='<compiler inertiafromgeom="true"/>' + mesh, body=body))
    with pytest.raises(UsageError) as refusal:
        read_mjcf(robot)
    command = re.search(r'python -c "(.*)"$', str(refusal.value))
    assert command
    subprocess.run([sys.executable, "-c", command[1]], check=True)
    assert read_mjcf(tmp_path / "robot_inertial.xml").inertia[0][9] == 0.7


def test_geometry_that_weighs_nothing_or_moves_nothing_is_dropped():
    mesh = '<geom type="mesh" mesh="arm"/>'
    asset = '<asset><mesh name="arm" file="nowhere.stl"/><texture name="t" type="2d" file="nowhere.png"/></asset>'
    tree = read(mjcf(body=INERTIAL + mesh, head=asset))
    assert tree.inertia[0][9] == 0.3
    world = mjcf().replace(
        "<worldbody>",
        '<worldbody><geom type="plane" size="1 1 1"/><body name="table">' + mesh + "</body>",
    )
    assert read(world.replace("<mujoco>", "<mujoco>" + asset)).joints == ("lift", "elbow")


def test_includes_stay_in_the_folder(tmp_path):
    (tmp_path / "inner.xml").write_text(
        '<mujocoinclude><default><joint armature="0.5"/></default></mujocoinclude>'
    )
    robot = tmp_path / "robot.xml"
    robot.write_text(mjcf(head='<include file="inner.xml"/>'))
    np.testing.assert_allclose(read_mjcf(robot).armature, 0.5)
    for name, words in (
        ("../inner.xml", "outside"),
        ("/etc/passwd", "outside"),
        ("robot.xml", "itself"),
    ):
        robot.write_text(mjcf(head=f'<include file="{name}"/>'))
        with pytest.raises(UsageError, match=words):
            read_mjcf(robot)
    bomb = '<!DOCTYPE m [<!ENTITY a "aaaa">]>' + mjcf()
    refused(bomb, "entities")
    robot.write_text("<mujoco>" + " " * 5_000_000 + "</mujoco>")
    with pytest.raises(UsageError, match="MB"):
        read_mjcf(robot)


def test_limbs_ends_and_joints_that_are_held():
    tree = Robot.from_mjcf("robot.xml", text=quadruped()).tree.tree
    assert [limb[0] for limb in tree.limbs()] == ["FL1", "FR1", "RL1", "RR1"] and all(
        len(limb) == 3 for limb in tree.limbs()
    )
    assert "free" in tree.notes[0]
    robot = Robot.from_mjcf("robot.xml", tip="arm_l3_link", text=humanoid())
    assert robot.signatures[0].joints == ("torso1", "torso2", "arm_l1", "arm_l2", "arm_l3")
    assert abs(robot.tree.tree.inertia[:, 9].sum() - _mass_above(humanoid(), "torso1_link")) < 1e-9
    with pytest.raises(UsageError, match="arm_l3_link"):
        Robot.from_mjcf("robot.xml", tip="arm_l3_lin", text=humanoid())


def _mass_above(text, body):
    model = mujoco.MjModel.from_xml_string(text)
    return float(model.body_subtreemass[model.body(body).id])


URDF = """<robot name="tree"><link name="base"/>
<link name="la"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<link name="lb"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.03"/></inertial></link>
<joint name="left" type="revolute"><parent link="base"/><child link="la"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="9" velocity="9"/><dynamics damping="0.3" friction="0.1"/></joint>
<joint name="right" type="prismatic"><parent link="base"/><child link="lb"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="9" velocity="9"/></joint></robot>"""


def test_urdf_with_branches_names_impossible_inertias():
    tree = read_urdf_tree("tree.urdf", URDF)
    assert tree.limbs() == (("left",), ("right",)) and tree.slides == (False, True)
    assert len(tree.impossible) == 1 and re.search(r"'lb'.*0\.03", tree.impossible[0][1])
    np.testing.assert_allclose(tree.damping[:, 0], [0.3, 0])
    np.testing.assert_allclose(tree.frictionloss, [0.1, 0])
    mimic = URDF.replace(
        '<dynamics damping="0.3" friction="0.1"/>',
        '<mimic joint="right" multiplier="2" offset="0.1"/>',
    )
    assert read_urdf_tree("tree.urdf", mimic).follow()[0].tolist() == [[2.0], [1.0]]
    refused(
        mimic.replace('joint="right" m', 'joint="wrong" m'),
        "left",
        "wrong",
        reader=read_urdf_tree,
        file="tree.urdf",
    )


def test_joints_that_move_nothing_of_mass_are_held():
    finger = (
        '<link name="tip"/><joint name="finger" type="revolute"><parent link="la"/><child link="tip"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="9" velocity="9"/></joint></robot>'
    )
    tree = read_urdf_tree("tree.urdf", URDF.replace("</robot>", finger))
    assert tree.joints == ("left", "right") and tree.held == {"finger": 0.0}
    assert any("finger" in note and "tip" in note for note in tree.notes)
    follows = finger.replace("<axis", '<mimic joint="left"/><axis')
    assert read_urdf_tree("tree.urdf", URDF.replace("</robot>", follows)).followers == ("finger",)
    hollow = re.sub(r"<inertial>.*?</inertial>", "", URDF, flags=re.S)
    refused(hollow, "left", "la", "<inertial>", reader=read_urdf_tree, file="tree.urdf")
    refused('<robot name="empty"/>', "no <link>", reader=read_urdf_tree, file="tree.urdf")
