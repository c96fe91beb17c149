"""What a robot's file leaves out, as its owner has it: brakes of nothing, stops that the recording
meets, a patch of one line.
"""

import dataclasses
import importlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.diagnosis.goals.propose import absent_effects
from jaxid.problem.binding import bind
from jaxid.robots.export.kept import kept
from jaxid.robots.export.outcome import outcome
from jaxid.robots.mjcf import read_mjcf
from jaxid.robots.stops import sentences


DRY = 1.2  # N m
mujoco: Any = importlib.import_module("mujoco")


def file(dry: float = 0.0, angle: str = '<compiler angle="radian"/>', rate: float = 1e-3) -> str:
    return f"""<mujoco>{angle}
  <option timestep="{rate}" integrator="implicitfast"/>
  <worldbody><body name="upper">
    <joint name="lift" axis="0 1 0" damping="1.0" armature="0.1" range="-2 2"/>
    <inertial pos="0 0 -.15" mass="2.2" diaginertia=".025 .025 .004"/>
    <body name="fore" pos="0 0 -.3">
      <joint name="bend" axis="0 1 0" damping="0.6" armature="0.06" range="-2.4 2.4" frictionloss="{dry}"/>
      <inertial pos="0 0 -.12" mass="1.3" diaginertia=".01 .01 .002"/>
    </body>
  </body></worldbody>
  <actuator><position joint="lift" kp="120" kv="6"/><position joint="bend" kp="80" kv="4"/></actuator>
</mujoco>"""


def log(text: str, folder: Path, seconds: float = 10.0, noise: float = 2e-4) -> Path:
    """A recording in MuJoCo of the file in `text`, with goals and encoders at 100 Hz, and the file
    without dry friction.
    """
    rng, joints = np.random.default_rng(3), ("lift", "bend")
    m = mujoco.MjModel.from_xml_string(text)
    step, t = round(0.01 / m.opt.timestep), np.arange(0, seconds, 0.01)
    runs = []
    for _ in range(3):
        f, phase = rng.uniform(0.1, 0.9, (2, 4)), rng.uniform(0, 6.28, (2, 4))
        goal = (
            0.2
            * (
                np.sin(2 * np.pi * f[:, :, None] * t + phase[:, :, None])
                - np.sin(phase)[:, :, None]
            )
            .sum(1)
            .T
        )
        d, q = mujoco.MjData(m), []
        for u in goal * np.minimum(1, t)[:, None]:
            q.append(d.qpos + rng.normal(0, noise, 2))
            d.ctrl[:] = u
            mujoco.mj_step(m, d, step)
        runs.append((goal * np.minimum(1, t)[:, None], np.array(q)))
    data = jaxid.Dataset.from_arrays(
        [t] * 3,
        {f"{j}_cmd": [u[:, k] for u, _ in runs] for k, j in enumerate(joints)},
        {j: [q[:, k] for _, q in runs] for k, j in enumerate(joints)},
        units={n: "rad" for j in joints for n in (j, f"{j}_cmd")},
        split=["fit", "validation", "report"],
        at_rest=True,
        noise_std=dict.fromkeys(joints, noise),
        check_model=False,
    )
    jaxid.save_dataset(data, folder / "log")
    return folder / "log"


# ---- from the recording to one changed attribute


@pytest.mark.slow
def test_a_brake_that_the_file_leaves_at_nothing_is_named_and_alone_written_back(tmp_path):
    arm = tmp_path / "arm.xml"
    arm.write_text(file().replace(' frictionloss="0.0"', ""))
    found = jaxid.diagnose(str(arm), jaxid.load_dataset(log(file(DRY), tmp_path)))
    (effect,) = found.which.effects
    assert (found.which.verdict, effect.effect, effect.location) == (
        "named",
        "coulomb_friction",
        "bend",
    )
    level = effect.parameters["level"]
    assert level.std and abs(level.value - DRY) < 0.03 * DRY  # MuJoCo's creeps
    assert not [s for s in found.final.stated if s.refuted and s.parameter != "frictionloss"], (
        "the file's own numbers are right"
    )
    written = found.export("mjcf").files["arm.xml"]
    changed = [
        b for a, b in zip(arm.read_text().split("\n"), written.split("\n"), strict=True) if a != b
    ]
    assert (
        len(changed) == 1
        and 'name="bend"' in changed[0]
        and 'damping="0.6" armature="0.06"' in changed[0]
    )


@pytest.mark.slow
def test_a_recording_at_the_stops_of_its_file_is_simulated_with_them(tmp_path):
    text = file(DRY, angle="")  # its ranges are degrees
    arm = tmp_path / "arm.xml"
    arm.write_text(file(0.0, angle=""))
    path = log(text, tmp_path)
    found = jaxid.diagnose(str(arm), jaxid.load_dataset(path))
    assert all(e.effect == "coulomb_friction" for e in found.which.effects)
    assert found.how_far.gap_after < 1.2 < found.how_far.gap_before
    notes = " ".join(jaxid.check(str(arm), jaxid.load_dataset(path)).notes)
    assert "MuJoCo stops it there" in notes and 'angle="radian"' in notes
    assert "has no stops" not in notes


# ---- its parts


def test_stops_are_said_where_a_joint_meets_them(tmp_path):
    arm = tmp_path / "arm.xml"
    data = jaxid.load_dataset(log(file(), tmp_path, seconds=4.0))
    for angle, told in (('<compiler angle="radian"/>', False), ("", True)):
        arm.write_text(file(angle=angle))
        said = sentences(read_mjcf(arm), data)
        assert bool(said) == told
    assert (
        "lift stands at or past its range" in said[0]
        and 'add <compiler angle="radian"/>' in said[0]
    )


def test_brakes_that_a_file_states_are_no_effects(tmp_path):
    arm = tmp_path / "arm.xml"
    data = jaxid.load_dataset(log(file(), tmp_path, seconds=4.0))
    for dry, lacking in ((0.0, ["lift", "bend"]), (0.3, ["lift"])):
        arm.write_text(file(dry))
        found = absent_effects(bind(str(arm), data))
        assert [(c.effect, c.location) for c in found] == [("coulomb_friction", j) for j in lacking]


# ---- which numbers stay


def result(
    fitted: Mapping[str, tuple[float, float, float | None]],
    covariance: np.ndarray | None = None,
    verdict: str = "named",
):
    """A diagnosis with (stated, fitted, std) of each number."""
    rows = [
        {
            "joint": k.split("@")[1],
            "link": "",
            "parameter": k.split("@")[0],
            "stated": s,
            "fitted": v,
            "std": e,
        }
        for k, (s, v, e) in fitted.items()
    ]
    entry = (
        {}
        if covariance is None
        else {"covariance": {"names": list(fitted), "matrix": covariance.tolist()}}
    )
    numbers = {k: {"value": v, "std": e, "unit": ""} for k, (_, v, e) in fitted.items()}
    content = {
        "kind": "diagnosis",
        "model": "robot",
        "parameters": numbers,
        "stated": rows,
        **entry,
    }
    return outcome(json.loads(json.dumps(content | {"which": {"verdict": verdict, "effects": []}})))


def left(found) -> set[str]:
    return {k for k, n in kept(found).parameters.items() if n.kept}


def test_numbers_that_the_data_do_not_refute_stay_as_the_file_has_them():
    one, two = "damping@lift", "damping@bend"
    assert left(result({one: (1.0, 1.02, 0.05), two: (1.0, 2.0, 0.05)})) == {one}
    assert left(result({one: (1.0, 1.02, 0.05), two: (1.0, 1.02, None)}, verdict="unknown")) == {
        one,
        two,
    }
    assert left(result({one: (1.0, 1.02, 0.05), two: (1.0, 1.02, None)})) == {
        one
    }  # not known alone, yet of the fit
    assert kept(result({one: (1.0, 1.2345678, 0.012)})).parameters[one].value == 1.2346


def test_numbers_that_go_together_are_left_together_or_not_at_all():
    """Two that trade for each other: each near the file's by itself, both not."""
    one, two = "damping@lift", "damping@bend"
    C = 0.05**2 * np.array([[1.0, 0.98], [0.98, 1.0]])
    both_off, traded = (
        {one: (1.0, 1.05, 0.05), two: (1.0, 0.95, 0.05)},
        {one: (1.0, 1.05, 0.05), two: (1.0, 1.05, 0.05)},
    )
    assert left(result(both_off, C)) != {one, two} and left(result(traded, C)) == {one, two}


def test_an_outcome_of_a_model_that_is_no_robot_is_kept_as_well():
    found = result({"damping@lift": (1.0, 1.001, 0.05)})
    plain = dataclasses.replace(
        found,
        parameters={"inertia": found.parameters["damping@lift"]},
        content={"stated": [{"joint": "q", "link": "", "parameter": "inertia", "stated": 1.0}]},
    )
    assert left(plain) == {"inertia"}
