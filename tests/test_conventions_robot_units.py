"""Units of a robot's channels beside what its file states: forces of a gantry, gears of an arm."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import jaxid
from jaxid.conventions.checking import run_check
from jaxid.conventions.finding import DataFinding


GANTRY = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body><inertial pos="0 0 0" mass="12" diaginertia=".1 .1 .1"/>
<joint name="x" type="slide" axis="1 0 0" damping="20" frictionloss="8"/>
<body><inertial pos="0 0 0" mass="5" diaginertia=".1 .1 .1"/>
<joint name="y" type="slide" axis="0 1 0" damping="12" frictionloss="5"/>
<body><inertial pos="0 0 0" mass="3" diaginertia=".1 .1 .1"/>
<joint name="z" type="slide" axis="0 0 1" damping="15" frictionloss="4"/>
</body></body></body></worldbody><actuator><motor joint="x"/><motor joint="y"/><motor joint="z"/>
</actuator></mujoco>"""
ARM = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body><inertial pos="0 0 .04" mass="1.8" diaginertia=".006 .006 .005"/>
<joint name="yaw" axis="0 0 1" damping="1" armature=".05" frictionloss=".3"/>
<body pos="0 0 .1"><inertial pos="0 0 .14" mass="1.5" diaginertia=".014 .014 .002"/>
<joint name="shoulder" axis="0 1 0" damping="1.5" armature=".06" frictionloss=".3"/>
<body pos="0 0 .28"><inertial pos="0 0 .11" mass=".9" diaginertia=".006 .006 .001"/>
<joint name="elbow" axis="0 1 0" damping=".8" armature=".03" frictionloss=".2"/>
<body pos="0 0 .22"><inertial pos=".01 0 .05" mass=".5" diaginertia=".0015 .0015 .0004"/>
<joint name="roll" axis="0 0 1" damping=".05" armature=".01" frictionloss=".05"/>
</body></body></body></body></worldbody><actuator><motor joint="yaw"/><motor joint="shoulder"/>
<motor joint="elbow"/><motor joint="roll"/></actuator></mujoco>"""
#: File, joints, unit of a position and of a force, its noise, gains that hold it, size of a motion.
GANTRY_RIG = GANTRY, "x y z", "m", "N", 2e-5, [800, 500, 400], [80, 50, 40], 0.4
ARM_RIG = (
    ARM,
    "yaw shoulder elbow roll",
    "rad",
    "N m",
    1e-4,
    [60, 120, 80, 20],
    [8, 12, 6, 0.5],
    0.7,
)
Slip = Callable[[np.ndarray, np.ndarray], None]


def recorded(rig: tuple, slip: Slip, path: Path) -> jaxid.Dataset:
    """Three runs of a file by MuJoCo; `slip` changes forces and positions [time joints] in place."""
    mujoco = pytest.importorskip("mujoco")
    text, joints, unit, force, noise, kp, kd, size = rig
    names = joints.split()
    path.write_text(text)
    model, rng = mujoco.MjModel.from_xml_string(text), np.random.default_rng(4)
    times, inputs, outputs = [], {f"{n}_tau": [] for n in names}, {n: [] for n in names}
    for _ in range(3):
        f, phase = rng.uniform(0.1, 0.7, (4, len(names))), rng.uniform(0, 6.3, (4, len(names)))
        state, t, u, q = mujoco.MjData(model), np.arange(0, 10, 0.004), [], []
        for now in t:
            goal = size / 3 * (np.sin(2 * np.pi * f * now + phase) - np.sin(phase)).sum(0)
            state.ctrl[:] = kp * (goal - state.qpos) - kd * state.qvel
            u.append(state.ctrl.copy())
            q.append(state.qpos + noise * rng.standard_normal(len(names)))
            mujoco.mj_step(model, state, 2)
        u, q = np.array(u), np.array(q)
        slip(u, q)
        times.append(t)
        for j, name in enumerate(names):
            inputs[f"{name}_tau"].append(u[:, j])
            outputs[name].append(q[:, j])
    units = dict.fromkeys(inputs, force) | dict.fromkeys(outputs, unit)
    split = ["fit", "fit", "validation"]
    return jaxid.Dataset.from_arrays(
        times, inputs, outputs, units=units, split=split, check_model=False
    )


def thousandths(u, q):
    u *= 1000


def pounds(u, q):
    u /= 4.4482216152605


def kilograms_at_a_centimetre(u, q):
    u /= 0.0980665


def quarters(u, q):
    u /= 4


def elbow_in_degrees(u, q):
    q[:, 2] = np.degrees(q[:, 2])


def yaw_of_the_motor(u, q):
    u[:, 0] /= 30


def roll_of_the_motor(u, q):
    u[:, 3] /= 30


def found(rig: tuple, slip: Slip, folder: Path) -> DataFinding:
    path = folder / "robot.xml"
    (finding,) = run_check(str(path), recorded(rig, slip, path)).findings
    assert finding.kind == "scale"
    return finding


@pytest.mark.parametrize(
    ("rig", "slip", "channel", "value"),
    [
        (GANTRY_RIG, thousandths, "x_tau", 1000.0),
        (GANTRY_RIG, pounds, "x_tau", 0.224809),
        pytest.param(ARM_RIG, elbow_in_degrees, "elbow", 180 / np.pi, marks=pytest.mark.slow),
    ],
)
def test_what_a_file_states_tells_units(rig, slip, channel, value, tmp_path):
    finding = found(rig, slip, tmp_path)
    assert (finding.channel, finding.applied) == (channel, True)
    assert finding.value == pytest.approx(value, rel=2e-3)
    together = len(rig[1].split()) if channel.endswith("_tau") else 0
    assert finding.line.count("# of") == together


def test_kilograms_at_a_centimetre_are_no_kilograms(tmp_path):
    """What the model lacks moves the fitted factor by 3 %; between two units that is asked about."""
    finding = found(ARM_RIG, kilograms_at_a_centimetre, tmp_path)
    assert finding.value == pytest.approx(10.19716) and finding.line.startswith('unit = "kgf cm"')


def test_a_factor_that_is_near_to_a_unit_is_none(tmp_path):
    """A quarter of the force is 11 % from pounds; masses that are off may be its cause."""
    path = tmp_path / "robot.xml"
    assert not run_check(str(path), recorded(GANTRY_RIG, quarters, path)).findings


@pytest.mark.parametrize(
    ("slip", "channel"), [(yaw_of_the_motor, "yaw_tau"), (roll_of_the_motor, "roll_tau")]
)
def test_a_gear_at_a_joint_that_holds_no_weight_is_found(slip, channel, tmp_path):
    """Friction and armature take many a factor, at a roll joint all: what is stated comes nearest
    to one, and that is asked about.
    """
    finding = found(ARM_RIG, slip, tmp_path)
    assert finding.channel == channel and finding.value is not None
    assert 1 / 45 < finding.value < 1 / 20
    assert not finding.applied or finding.value == pytest.approx(1 / 30)
