"""Runs of a file in MuJoCo: blocks of steps against one step after another."""

from pathlib import Path

import numpy as np
import pytest

from jaxid.robots.drives import DriveLaw
from jaxid.robots.mjcf import read_mjcf
from jaxid.simulation.mujoco_run import BLOCK, Driven, MujocoRobot


JOINTS = ("shoulder", "elbow")
SAMPLES = np.arange(0.0, 5.0, 0.01)
LINEAR = [True, False]


def text(integrator: str = "Euler", drive: str = "", motor: str = "position") -> str:
    """An arm of two joints, whose 5 s are more steps than one block has."""
    gains = 'kp="30" kv="1"' if motor == "position" else ""
    return f"""<mujoco><option timestep="0.001" integrator="{integrator}"/>
  <worldbody><body><joint name="shoulder" axis="0 1 0" damping="0.2" frictionloss="0.1"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" density="800"/>
    <body pos="0.3 0 0"><joint name="elbow" axis="0 1 0" armature="0.01" range="-1 1"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" density="800"/></body></body>
  </worldbody>
  <actuator><{motor} joint="shoulder" {gains} {drive}/><{motor} joint="elbow" gear="2" {gains}/>
  </actuator></mujoco>"""


def law(period: float) -> DriveLaw:
    """A pd law whose goals come late."""
    return DriveLaw(
        origin="stated",
        kind="pd",
        kp=(25.0, 25.0),
        kd=(1.5, 1.5),
        ki=(0.0, 0.0),
        gain=(1.0, 1.0),
        lowest=(-8.0, -8.0),
        highest=(8.0, 8.0),
        offset=(0.0, 0.0),
        delay=(0.0123, 0.0123),
        lag=(0.0, 0.0),
        control=((-1.0, 1.0), (-1.0, 1.0)),
        period=period,
    )


def runs(path: Path, kind: str, stated: DriveLaw | None = None, held=None, joints=JOINTS):
    """The run by blocks and the run step by step, with their notes."""
    goals = 0.8 * np.sin(2 * SAMPLES)[:, None] * np.ones(len(joints))
    found = []
    for at_once in (True, False):
        robot = MujocoRobot(path, read_mjcf(path), held or {}, None, joints, stated)
        if not at_once:
            robot._at_once = lambda d, control: None
        still = np.zeros(len(joints))
        linear = LINEAR[: len(joints)]
        drive = Driven(kind, stated, robot)
        run = robot.run(joints, SAMPLES, goals, linear, drive, still, still)
        found.append((run, robot.notes))
    return found


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize(
    ("kind", "drive", "motor"),
    [
        ("goal", "", "position"),
        ("goal", 'timeconst="0.02"', "position"),
        ("goal", 'delay="0.0125" nsample="20"', "position"),
        ("torque", "", "motor"),
        ("free", "", "motor"),
    ],
)
def test_blocks_of_steps_are_the_steps(integrator, kind, drive, motor, tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(text(integrator, drive, motor))
    assert len(SAMPLES) * 10 > BLOCK, "the run has to be longer than a block"
    (blocks, _), (steps, _) = runs(path, kind)
    assert np.isfinite(steps).all() and np.ptp(steps, axis=0).min() > 0.02
    np.testing.assert_array_equal(blocks, steps)


@pytest.mark.parametrize("period", [0.0, 0.01])
def test_a_stated_law_drives_both_alike(period, tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(text())
    (blocks, _), (steps, _) = runs(path, "law", law(period))
    assert np.isfinite(steps).all() and np.ptp(steps, axis=0).min() > 0.02
    np.testing.assert_array_equal(blocks, steps)


def test_a_joint_that_is_held_stays(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(text())
    (blocks, _), (steps, _) = runs(path, "goal", held={"elbow": 0.4}, joints=("shoulder",))
    assert np.isfinite(steps).all()
    np.testing.assert_array_equal(blocks, steps)


def test_a_run_that_diverges_says_when(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "arm.xml"
    path.write_text(text(drive='forcerange="-1e9 1e9"').replace('kp="30"', 'kp="3e7"'))
    (blocks, said), (steps, said_of_steps) = runs(path, "goal")
    assert np.isnan(steps[-1]).all()
    np.testing.assert_array_equal(blocks, steps)
    assert said == said_of_steps
    assert any("diverged after" in note for note in said)
    assert not Path("MUJOCO_LOG.TXT").exists()
