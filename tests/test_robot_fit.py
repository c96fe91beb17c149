"""A robot is fitted like any other model: a joint that MuJoCo drives by its own position
actuator.
"""

import importlib
import json
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.cli.app import main


mujoco: Any = importlib.import_module("mujoco")

LINK = '<inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>'
ARM = f"""<mujoco><option timestep="5e-4" integrator="RK4"/><default><joint damping="0.3" armature="0.02"/></default>
<worldbody><body name="l1"><joint name="lift" axis="0 1 0"/>{LINK}</body></worldbody>
<actuator><position joint="lift" kp="8" kv="0.2" forcerange="-1 1"/></actuator></mujoco>"""


def record(model, seconds=6.0, dt=0.01, noise=2e-4):
    """Goals held between samples, measured angle with noise, both [time]; MuJoCo's own
    simulation.
    """
    data, t = mujoco.MjData(model), np.arange(0, seconds, dt)
    goal = 0.5 * np.sin(2 * np.pi * (0.3 + 0.25 * t) * t)
    q = np.empty_like(t)
    for k, g in enumerate(goal):
        q[k], data.ctrl[0] = data.qpos[0], g
        for _ in range(round(dt / model.opt.timestep)):
            mujoco.mj_step(model, data)
    return t, goal, q + noise * np.random.default_rng(0).normal(size=t.size)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The recording of a robot whose damping, armature and centre of mass are not those of its
    file.
    """
    out = tmp_path_factory.mktemp("arm")
    model = mujoco.MjModel.from_xml_string(ARM)
    model.dof_damping[0], model.dof_armature[0], model.body_ipos[1, 0] = 0.45, 0.03, 0.15
    rows = np.column_stack(record(model))
    np.savetxt(out / "run.csv", rows, delimiter=",", header="t,lift_cmd,lift", comments="")
    (out / "arm.xml").write_text(ARM)
    channels = "".join(
        f'[channels.{c}]\nrole = "{r}"\nunit = "rad"\n'
        for c, r in (("lift_cmd", "input"), ("lift", "output"))
    )
    (out / "dataset.toml").write_text(
        f'name = "arm"\n{channels}[[experiments]]\nfile = "run.csv"\nat_rest = true\n'
    )
    return out


@pytest.mark.slow
def test_a_fit_says_what_differs_from_the_file(folder, tmp_path, capsys):
    assert (
        main(
            [
                "fit",
                str(folder),
                "--model",
                str(folder / "arm.xml"),
                "--out",
                str(tmp_path),
                "--json",
            ]
        )
        == 0
    )
    fit = json.loads(capsys.readouterr().out)
    found = fit["parameters"]
    moment = 0.3 * np.hypot(found["com_x@l1"]["value"], found["com_z@l1"]["value"])
    assert abs(moment - 0.045) < 0.003
    assert abs(found["damping@lift"]["value"] - 0.45) < 0.03
    # Of the inertia about the axis the first moment's share is fitted with it, the rest is the
    # armature.
    inertia = found["armature@lift"]["value"] + 1e-3 + moment**2 / 0.3
    assert abs(inertia - (0.03 + 1e-3 + 0.3 * 0.15**2)) < 0.002
    rows = {r["parameter"]: r for r in fit["stated"]}
    assert (
        rows["damping"]["stated"] == 0.3
        and rows["damping"]["joint"] == "lift"
        and rows["damping"]["deviation"] > 3
    )
    assert any("link l1 carries" in n and "more first moment" in n for n in fit["notes"])
    for row in fit["how_far"]["per_joint"]:
        assert row["joint"] == "lift" and row["retuned"] < 5e-4 < row["as_it_stands"]
    assert jaxid.load_dataset(folder).name == "arm"
