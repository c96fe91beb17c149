"""What was found goes back into the simulator: patched files, code for what has no field, and the round trip in MuJoCo."""

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.robots.export.run import export
from jaxid.robots.export.save import save
from jaxid.simulation.mujoco_run import Driven, MujocoRobot


mujoco: Any = importlib.import_module("mujoco")

ARM = """<mujoco model="arm">
  <!-- two joints about y, driven by position actuators -->
  <compiler angle="radian"/>
  <option timestep="2.5e-4" integrator="implicitfast"/>
  <default>
    <joint damping="0.2" armature="0.02"/> <!-- the motors' -->
  </default>
  <worldbody>
    <body name="upper">
      <joint name="lift" axis="0 1 0"
             range="-2 2"/>
      <inertial pos="0.1 0 0.02" quat="1 0.2 0 0" mass="0.6" diaginertia="2e-3 3e-3 2.5e-3"/>
      <body name="fore" pos="0.25 0 0">
        <joint name="bend" axis='0 1 0' stiffness="0.5" springref="0.1"/>
        <inertial pos="0.08 0 0" mass="0.3" diaginertia="5e-4 1e-3 1e-3"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="lift_act" joint="lift" kp="20" kv="0.8" forcerange="-6 6"/>
    <general joint="bend" gear="2" gainprm="3" biastype="affine" biasprm="0 -3 -0.1"/> <!-- kp 12, kd 0.4 at the joint -->
  </actuator>
</mujoco>
"""
URDF = """<?xml version="1.0"?>
<robot name="arm">
  <!-- kept -->
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.1 0 0" rpy="0.3 0 0"/><mass value="0.6"/>
    <inertia ixx="2e-3" ixy="0" ixz="0" iyy="3e-3" iyz="0" izz="2.5e-3"/></inertial></link>
  <link name="tip"><inertial><mass value="0.1"/><inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <joint name="lift" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="9" velocity="5"/></joint>
  <joint name="glue" type="fixed"><parent link="upper"/><child link="tip"/><origin xyz="0.3 0 0"/></joint>
</robot>
"""
JOINTS = ("lift", "bend")


def entry(value, std=1e-3, unit=""):
    return {"value": value, "std": std, "unit": unit}


def fit(parameters=None, effects=(), path="", **robot):
    """A fit.json of the arm as jaxid writes it."""
    drive = {"origin": "file", "kind": "pd", "period": 0.0, "joints": {
        "lift": {"kp": 20.0, "kd": 0.8, "gain": 1.0, "lowest": -6.0, "highest": 6.0, "offset": 0.0, "delay": 0.0, "lag": 0.0},
        "bend": {"kp": 12.0, "kd": 0.4, "gain": 1.0, "lowest": None, "highest": None, "offset": 0.0, "delay": 0.0, "lag": 0.0},
    }}  # fmt: skip
    own = {"file": str(path), "joints": list(JOINTS), "held": {}, "drive": drive} | robot
    named = [{"effect": e, "location": where, "parameters": {k: entry(v) for k, v in n.items()}} for e, where, n in effects]
    return {"schema": 1, "kind": "fit", "model": "robot", "robot": own, "effects": named,
            "parameters": {k: entry(v) for k, v in (parameters or {}).items()}}  # fmt: skip


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return path


# ---- round trip: jaxid's free run with an effect, and MuJoCo's of the patched file

#: Every effect that the round trip goes through, at the value that makes it nothing.
NEUTRAL: dict[tuple[str, str], dict[str, float]] = {
    ("torque_scale", "bend_tau"): {"gain": 0.0},
    ("saturation", "bend_tau"): {"limit": 1e12},
    ("back_emf", "lift_tau"): {"constant": 0.0},
    ("input_delay", "lift_cmd"): {"delay": 0.0},
    ("actuator_lag", "lift_cmd"): {"lag": 0.0},
    ("constant_torque", "bend"): {"torque": 0.0},
    ("spring_torque", "bend"): {"stiffness": 0.0},
    ("quadratic_drag", "lift"): {"coefficient": 0.0},
    ("reflected_inertia", "bend"): {"inertia": 0.0},
    ("payload", "bend"): {"mass": 0.0},
    ("gravity_offset", "lift"): {"tilt": 0.0},
}
#: (name, fitted numbers, effects, largest error over the effect's size)
EXACT = [
    ("damping", {"damping@lift": 0.5}, {}),
    ("armature", {"armature@bend": 0.05}, {}),
    ("mass and centre", {"mass@fore": 0.45, "com_x@fore": 0.1, "com_z@fore": 0.03}, {}),
    ("inertia", {"gyration_xx@upper": 0.12, "gyration_zz@upper": 0.15, "gyration_zx@upper": 0.03}, {}),
    ("gains", {"kp@lift": 14.0, "kd@lift": 1.4, "kp@bend": 9.0}, {}),
    ("limit", {"highest@lift": 1.2}, {}),
    ("encoder bias", {"encoder_bias@bend": 0.08}, {}),
    ("torque scale", {}, {("torque_scale", "bend_tau"): {"gain": -0.3}}),
    ("saturation", {}, {("saturation", "bend_tau"): {"limit": 0.5}}),
    ("back EMF", {}, {("back_emf", "lift_tau"): {"constant": 0.4}}),
    ("delay", {}, {("input_delay", "lift_cmd"): {"delay": 0.0137}}),
    ("lag", {}, {("actuator_lag", "lift_cmd"): {"lag": 0.03}}),
    ("torque", {}, {("constant_torque", "bend"): {"torque": 0.25}}),
    ("torque and saturation", {}, {("constant_torque", "bend"): {"torque": 0.25}, ("saturation", "bend_tau"): {"limit": 0.6}}),
    ("spring", {}, {("spring_torque", "bend"): {"stiffness": 1.5}}),
    ("drag", {}, {("quadratic_drag", "lift"): {"coefficient": 0.3}}),
    ("rotor", {}, {("reflected_inertia", "bend"): {"inertia": 0.03}}),
    ("payload", {}, {("payload", "bend"): {"mass": 0.2}}),
    ("tilt", {}, {("gravity_offset", "lift"): {"tilt": 0.15}}),
]
APPROXIMATE = [("frictionloss", {"frictionloss@lift": 0.3, "frictionloss@bend": 0.1}, {})]


class Bench:
    """Goals for both joints, and the runs of both simulators on them."""

    def __init__(self, folder: Path):
        self.path = folder / "arm.xml"
        self.path.write_text(ARM)
        self.t = np.arange(0, 2.5, 0.005)
        self.goals = np.stack(
            [0.7 * np.sin(2 * np.pi * (0.4 + 0.3 * self.t) * self.t), -0.5 * np.sin(2 * np.pi * 0.8 * self.t)], 1
        )
        zero = {j: np.zeros_like(self.t) for j in JOINTS}
        goals = {f"{j}_cmd": self.goals[:, k] for k, j in enumerate(JOINTS)}
        units = dict.fromkeys((*zero, *goals), "rad")
        self.data = jaxid.Dataset.from_arrays(self.t, goals, zero, units=units, at_rest=True)
        self.model = jaxid.models.Robot.from_mjcf(self.path)
        self.plain = self.by_jaxid({}, {})

    def by_jaxid(self, parameters, effects):
        own = [(e, where, effects.get((e, where), n)) for (e, where), n in NEUTRAL.items()]
        run = jaxid.simulate(self.model, self.data, fit(parameters, own)).runs[0]
        return np.stack([run[j] for j in JOINTS], 1)

    def by_mujoco(self, path: Path):
        from jaxid.robots.mjcf import read_mjcf

        robot = MujocoRobot(path, read_mjcf(path), {}, None)
        return robot.run(JOINTS, self.t, self.goals, [False] * 2, Driven("goal", None, robot), np.zeros(2), np.zeros(2))


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return Bench(tmp_path_factory.mktemp("arm"))


def error_over_size(bench: Bench, parameters, effects, out: Path):
    found = export(fit(parameters, [(*key, n) for key, n in effects.items()], bench.path), "mjcf")
    save(found, out)
    jaxids = bench.by_jaxid(parameters, effects)
    size = np.sqrt(np.mean((jaxids - bench.plain) ** 2))
    error = np.sqrt(np.mean((bench.by_mujoco(out / "arm_patched.xml") - jaxids) ** 2))
    return found, error / size, size


def test_both_simulators_agree_on_the_file_as_it_stands(bench):
    assert np.sqrt(np.mean((bench.by_mujoco(bench.path) - bench.plain) ** 2)) < 1e-3


@pytest.mark.parametrize(("name", "parameters", "effects"), EXACT, ids=[e[0] for e in EXACT])
def test_an_exact_row_comes_back_within_two_percent(bench, name, parameters, effects, tmp_path):
    found, share, size = error_over_size(bench, parameters, effects, tmp_path)
    assert {r.how for r in found.rows} == {"exact"}, found.rows
    assert size > 1e-3 and share < 0.02, f"{name}: {100 * share:.2f} % of {size:.3g} rad"


@pytest.mark.parametrize(("name", "parameters", "effects"), APPROXIMATE, ids=[e[0] for e in APPROXIMATE])
def test_an_approximate_row_says_so_and_is_near(bench, name, parameters, effects, tmp_path):
    found, share, size = error_over_size(bench, parameters, effects, tmp_path)
    assert {r.how for r in found.rows} == {"approximate"}
    assert size > 1e-3 and share < 0.1, f"{name}: {100 * share:.2f} % of {size:.3g} rad"
    assert "solreffriction" in (tmp_path / "arm_patched.xml").read_text()
