"""A joint that is read twice: a speed late against its position, play between two encoders; and
bodies that cannot exist.
"""

import numpy as np
import pytest

import jaxid
from jaxid.conventions.bodies import impossible
from jaxid.conventions.late_speed import late_speeds
from jaxid.conventions.play import plays, read_twice
from jaxid.data.dataset import Dataset
from jaxid.diagnosis.next_experiment import advice
from jaxid.models import Robot
from jaxid.robots.urdf_tree import read_urdf_tree


FORMS = "plain", "uneven", "jitter", "standstill", "coarse", "repeats"
STEP, COUNT = 0.005, 1600


def times(form: str, rng: np.random.Generator) -> np.ndarray:
    steps = np.ones(COUNT)
    if form == "uneven":
        steps = np.where(np.arange(COUNT) % 2, 1.2, 0.8)
    if form == "jitter":
        steps = rng.uniform(0.6, 1.4, COUNT)
    return np.cumsum(steps) * STEP


def motion(rng: np.random.Generator, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    f, phase = rng.uniform(0.15, 1.6, 6), rng.uniform(0, 6.28, 6)
    a, w = rng.uniform(0.3, 1, 6) / np.maximum(f, 0.4), 2 * np.pi * f
    x = w * t[:, None] + phase
    return (a * np.sin(x)).sum(1), (a * w * np.cos(x)).sum(1), -(a * w * w * np.sin(x)).sum(1)


def recorded(form: str, seed: int, mean_of: int = 1, role: str = "auxiliary") -> Dataset:
    """Position and speed of a joint; the speed is a mean of so many samples."""
    rng = np.random.default_rng(seed)
    t = times(form, rng)
    q, v, _ = motion(rng, t)
    if form == "standstill":
        q[COUNT // 2 :], v[COUNT // 2 :] = q[COUNT // 2], 0.0
    v = v + 0.03 * rng.standard_normal(COUNT)
    q = np.round(q / 1.5e-3) * 1.5e-3 if form == "coarse" else q + 2e-4 * rng.standard_normal(COUNT)
    v = np.convolve(
        np.concatenate([np.full(mean_of - 1, v[0]), v]), np.ones(mean_of) / mean_of, "valid"
    )
    if form == "coarse" and mean_of == 1:  # a speed by differences stands half a row late
        v = np.concatenate([[0.0], np.diff(q) / np.diff(t)])
    if form == "repeats":
        q, v = (np.repeat(x[::4], 4)[:COUNT] for x in (q, v))
    outputs, auxiliary = ({"q": q}, {"qd": v}) if role == "auxiliary" else ({"q": q, "qd": v}, {})
    return Dataset.from_arrays(
        t,
        {"tau": np.sin(t)},
        outputs,
        auxiliary=auxiliary,
        units={"tau": "N m", "q": "rad", "qd": "rad/s"},
    )


@pytest.mark.parametrize("role", ["auxiliary", "output"])
@pytest.mark.parametrize("form", FORMS)
def test_a_speed_that_was_averaged_is_late_by_half_of_that(form, role):
    for shown in [list(late_speeds(recorded(form, seed, 13, role))) for seed in range(3)]:
        finding = shown[0].finding
        assert (finding.kind, finding.channel) == ("filtered", "qd") and not shown[0].mending
        assert finding.value == pytest.approx(0.030, abs=0.002)
        assert finding.line == ("" if role == "auxiliary" else 'role = "auxiliary"')
        assert "Use q alone" in finding.text and " rows) later than q" in finding.text


@pytest.mark.parametrize("form", FORMS)
def test_a_speed_that_goes_with_its_position_is_left(form):
    assert [list(late_speeds(recorded(form, seed))) for seed in range(6)] == [[]] * 6


def two_encoders(between: str, seed: int, form: str = "plain") -> Dataset:
    """The motor's encoder and that of the load, with what lies between the two."""
    rng = np.random.default_rng(seed)
    t = times(form, rng)
    q, v, a = motion(rng, t)
    tau = 0.02 * a + 0.05 * v + 0.1 * np.sign(v)
    load = q.copy()
    if between == "play":
        at = q[0]
        for k, x in enumerate(q):
            at = min(max(at, x - 0.01), x + 0.01)
            load[k] = at
    elif between == "late":
        load = np.interp(t - 0.01, t, q)
    elif between == "late, up and down":
        q = np.abs(t % 4 - 2)
        load = np.interp(t - 0.01, t, q)
    elif between == "soft":
        load = q - tau / 20
    elif between == "friction":
        load = q - (0.1 * np.sign(v) + 0.02 * a) / 20
    elif between == "eccentric":
        load = q + 0.01 * np.sin(3 * q)
    elif between == "coarse":
        load = np.round(q / 0.01) * 0.01
    count = 0.01 if between == "both coarse" else 1e-6
    noisy = [np.round((x + 1e-4 * rng.standard_normal(COUNT)) / count) * count for x in (load, q)]
    return Dataset.from_arrays(
        t,
        {"tau": tau},
        {"q": noisy[0]},
        auxiliary={"q_motor": noisy[1]},
        units={"tau": "N m", "q": "rad", "q_motor": "rad"},
    )


@pytest.mark.parametrize("form", ["plain", "uneven", "jitter"])
def test_play_between_two_encoders_is_read_off(form):
    for seed in range(4):
        (shown,) = plays(two_encoders("play", seed, form))
        assert (shown.finding.kind, shown.finding.channel) == (
            "play",
            "q_motor",
        ) and not shown.mending
        assert shown.finding.value == pytest.approx(0.02, abs=5e-4)


@pytest.mark.parametrize(
    "between",
    [
        "nothing",
        "late",
        "late, up and down",
        "soft",
        "friction",
        "eccentric",
        "coarse",
        "both coarse",
    ],
)
def test_two_encoders_without_play_show_none(between):
    assert [list(plays(two_encoders(between, seed))) for seed in range(6)] == [[]] * 6


def test_no_second_encoder_is_asked_for_where_there_is_one():
    asked = advice("partly", ["backlash"], ["joint_elasticity"])
    assert "a second encoder" in asked
    both = read_twice(two_encoders("play", 0))
    assert both == ("q", "q_motor")
    told = advice("partly", ["backlash"], ["joint_elasticity"], read_twice=both)
    assert "a second encoder" not in told and "difference of q and q_motor" in told


URDF = """<robot name="leg"><link name="base"/>
<link name="hip"><inertial><mass value="0.5"/>
<inertia ixx="-0.0013" ixy="0" ixz="0" iyy="-0.0012" iyz="0" izz="0.0004"/></inertial></link>
<joint name="hip_x" type="revolute"><parent link="base"/><child link="hip"/><axis xyz="1 0 0"/>
<limit lower="-2" upper="2" effort="20" velocity="20"/></joint></robot>"""


def test_an_inertia_that_no_body_has_is_said_with_its_link():
    (finding,) = impossible(Robot(read_urdf_tree("leg.urdf", URDF)))
    assert (finding.kind, finding.channel, finding.decisive, finding.applied) == (
        "impossible_body",
        "hip",
        True,
        True,
    )
    assert (
        "-0.0013" in finding.text
        and "leg.urdf" in finding.text
        and "nearest body" in finding.headline
    )
    assert impossible(Robot(read_urdf_tree("leg.urdf", URDF.replace("-0.001", "0.001")))) == []
    assert impossible(jaxid.models.Joint()) == []
