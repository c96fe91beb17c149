"""Gains of a robot's law as numbers that may be wrong."""

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.data.dataset import Controller
from jaxid.diagnosis.goals.gains import (
    asked_for,
    freed,
    held_gains,
    ROOM,
    with_room,
)
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.same_speed import said_as_one
from jaxid.fitting.stated import StatedNumber
from jaxid.models import Robot
from jaxid.problem.binding import bind, Binding


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
CASES = DATA.parent / "cases"
HUB = """<mujoco><option timestep="5e-4"/><worldbody><body name="hub">
<joint name="steer" axis="0 0 1" armature="0.006" damping="0.1" frictionloss="0.02"/>
<inertial pos="0 0 0" mass="0.3" diaginertia="0.0006 0.0006 0.001"/></body></worldbody>
<actuator><position name="steer" joint="steer" kp="8" kv="0.3"{limit}/></actuator></mujoco>"""


def recording(model: Any, q: np.ndarray | None = None, **controller: Any) -> jaxid.Dataset:
    t = np.arange(0, 4, 0.01)
    goal = 0.5 * np.sin(2 * np.pi * (0.3 + 0.4 * t) * t)
    return jaxid.Dataset.from_arrays(
        t,
        {"steer_cmd": goal},
        {"steer": goal if q is None else q},
        units={"steer": "rad", "steer_cmd": "rad"},
        noise_std={"steer": 1e-4},
        check_model=False,
        controller=Controller("pd", controller) if controller else None,
    )


def hub(folder: Path, limit: str = "") -> str:
    path = folder / "hub.xml"
    path.write_text(HUB.format(limit=limit))
    return str(path)


def bound(**controller: Any) -> Binding:
    model = Robot.from_mjcf("hub.xml", text=HUB.format(limit=""))
    return with_room(bind(model, recording(model, **controller)))


def test_gains_that_nobody_asked_for_are_held_and_have_room():
    b = bound()
    names = [b.layout.names[i] for i in held_gains(b)]
    assert names == ["kp@steer", "kd@steer"] and not set(held_gains(b)) & set(b.free)
    for i in held_gains(b):
        assert b.lower[i] == 0.0 and b.upper[i] == ROOM * b.theta[i] and b.scale[i] > 0
    wide = freed(b, ["kd@steer"])
    assert [wide.layout.names[i] for i in held_gains(wide)] == ["kp@steer"]
    assert 'fit = ["kd"]' in asked_for(wide, ["kd@steer"])


def test_a_gain_that_is_asked_for_is_no_hypothesis():
    b = bound(kp=8.0, kd=0.3, sample_time=0.0, velocity="measured", fit=["kd"])
    assert [b.layout.names[i] for i in held_gains(b)] == ["kp@steer"]


def test_a_gain_of_nothing_has_room_too():
    b = bound(kp=8.0, kd=0.0, sample_time=0.0, velocity="measured")
    kd = b.layout.index("kd@steer")
    assert kd in held_gains(b) and b.upper[kd] == ROOM * 8.0


@pytest.mark.parametrize(
    "limit, fitted, one",
    [
        ("", 0.25, True),
        ("", 0.05, True),
        (' forcerange="-1 1"', 0.25, False),  # where the drive is at its limit, kd brakes nothing
    ],
)
def test_damping_and_kd_are_said_as_one_where_they_are_one(limit, fitted, one, tmp_path):
    path = hub(tmp_path, limit)
    bench = ProblemBuilder(bind(path, recording(path)), differences=1)
    theta = bench.binding.theta.copy()
    theta[bench.binding.layout.index("damping@steer")] = fitted
    row = StatedNumber(
        joint="steer",
        link="",
        parameter="damping",
        stated=0.1,
        fitted=fitted,
        std=0.001,
        deviation=(fitted - 0.1) / 0.001,
        text="damping of steer: …",
        unit="N m s/rad",
    )
    told = said_as_one(bench, theta, [row])
    if not one:
        assert told == (row,)
        return
    alone, whole = told
    assert alone.deviation is None and alone.stated == 0.1
    assert whole.parameter == "kd + damping of steer" and whole.deviation == row.deviation
    assert whole.stated == pytest.approx(0.4) and whole.fitted == pytest.approx(0.3 + fitted)
    assert "stated 0.300 + 0.100 N m s/rad" in whole.text and "only the sum" in whole.text


@pytest.mark.slow
def test_a_kd_that_is_too_high_is_what_differs():
    """No brake of the joint can be that negative: the law's own gain is wrong."""
    folder = CASES / "robot3_kd_too_high"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here")
    found = jaxid.diagnose(None, jaxid.load_dataset(folder))
    assert found.which.verdict == "none" and not found.which.effects
    (wrong,) = [s for s in found.final.stated if s.refuted]
    assert (wrong.parameter, wrong.joint, wrong.stated) == ("kd", "steer", 0.7)
    assert wrong.beside == pytest.approx(0.05, abs=0.005)  # true
    assert not found.final.failed and found.how_far.gap_before > 50
    assert '[controller] fit = ["kd"]' in " ".join(found.notes)


@pytest.mark.slow
@pytest.mark.parametrize(
    "stated, parameter, value",
    [
        ('kp="8" kv="0.03"', "kd + damping of steer", 0.07),
        ('kp="7" kv="0.05"', "kp", 8.0),
    ],
)
def test_a_gain_that_is_a_little_off_is_no_effect(stated, parameter, value, tmp_path):
    """A kd that is too low is no friction, a kp that is too low no lighter rotor."""
    folder = CASES / "robot3_kd_too_high"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here")
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    text = (tmp_path / "hub.xml").read_text().replace('kp="8" kv="0.7"', stated)
    (tmp_path / "hub.xml").write_text(text)
    found = jaxid.diagnose(None, jaxid.load_dataset(tmp_path))
    assert found.which.verdict == "none" and not found.which.effects
    first = [s for s in found.final.stated if s.refuted][0]
    assert first.parameter == parameter
    told = first.fitted if first.beside is None else first.beside
    assert told == pytest.approx(value, rel=0.03)
