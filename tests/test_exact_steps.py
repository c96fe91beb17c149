"""A machine that takes no steps, and a file whose simulator does: two numbers of it are wrong."""

import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.base.serialise import save_json
from jaxid.robots.export.run import export


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads

ARM = """<mujoco model="arm"><compiler angle="radian"/>
<option timestep="{step}" integrator="{integrator}"/><worldbody><body pos="0 0 0.5">
  <joint name="shoulder" axis="0 1 0" damping="1" armature="0.05" frictionloss="{friction}"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1.2"/>
  <body name="fore" pos="0.3 0 0">
    <joint name="elbow" axis="0 1 0" damping="0.4" armature="0.02" frictionloss="0.02"/>
    <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.025" mass="{mass}"/></body></body>
</worldbody><actuator><position name="a1" joint="shoulder" kp="120" kv="3"/>
<position name="a2" joint="elbow" kp="60" kv="1.5"/></actuator></mujoco>"""
FILE = ARM.format(step=0.001, integrator="implicitfast", friction=0.05, mass=0.7)
MACHINE = ARM.format(step=1e-4, integrator="RK4", friction=0.4, mass=0.82)
HARD = '<default><joint solreffriction="2e-4 1" solimpfriction=".99 .9999 .001"/></default>'
STICKING = MACHINE.replace("<worldbody>", f"{HARD}<worldbody>")
JOINTS = ("shoulder", "elbow")
RATE, SECONDS, NOISE = 100, 8.0, 1e-4


def run_of(text: str, u: np.ndarray) -> np.ndarray:
    """Positions [samples joints] in MuJoCo under held goals, from rest."""
    model = mujoco.MjModel.from_xml_string(text)
    data, out = mujoco.MjData(model), []
    every = round(1 / RATE / model.opt.timestep)
    for goal in u:
        out.append(data.qpos.copy())
        data.ctrl[:] = goal
        mujoco.mj_step(model, data, every)
    return np.array(out)


def goals(seed: int) -> np.ndarray:
    """Sums of sines [samples joints]."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, SECONDS, 1 / RATE)[:, None]
    out = np.zeros((len(t), len(JOINTS)))
    for frequency, size in zip(rng.uniform(0.2, 1.6, (4, 2)), rng.uniform(0.1, 0.25, (4, 2))):
        out += size * np.sin(2 * np.pi * frequency * t)
    return out


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("machine", "simulator"), [(MACHINE, "mujoco_rk4"), (STICKING, "own")], ids=["soft", "hard"]
)
def test_what_steps_leave_behind_gets_no_name(tmp_path: Path, machine: str, simulator: str):
    """Numbers are the machine's, and those that are written follow it in the file's own steps."""
    file = tmp_path / "arm.xml"
    file.write_text(FILE)
    readings, wanted = [], [goals(seed) for seed in range(4)]
    for seed, u in enumerate(wanted):
        noise = NOISE * np.random.default_rng(10 + seed).standard_normal(u.shape)
        readings.append(run_of(machine, u) + noise)
    t = np.arange(0, SECONDS, 1 / RATE)
    data = jaxid.Dataset.from_arrays(
        [t] * len(wanted),
        {f"{joint}_cmd": [u[:, k] for u in wanted] for k, joint in enumerate(JOINTS)},
        {joint: [q[:, k] for q in readings] for k, joint in enumerate(JOINTS)},
        units=dict.fromkeys([*JOINTS, *(f"{joint}_cmd" for joint in JOINTS)], "rad"),
        noise_std=dict.fromkeys(JOINTS, NOISE),
        check_model=False,
    )
    found = jaxid.diagnose(str(file), data)
    assert found.which.verdict == "none"
    assert found.final.robot["simulator"]["kind"] == simulator
    assert found.how_far.gap_after < 1.1
    new = goals(9)
    save_json(found, tmp_path / "diagnosis.json")
    content = json.loads((tmp_path / "diagnosis.json").read_text())
    patched = export(content, "mjcf", robot=file).files["arm.xml"]
    apart = {}
    for which, text in (("file", FILE), ("patched", str(patched))):
        apart[which] = np.sqrt(np.mean((run_of(text, new) - run_of(machine, new)) ** 2))
    assert apart["patched"] < apart["file"] / 20
