"""Designed experiments: limits kept, information as claimed, files that the other commands read."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings, strategies as st

import jaxid
from jaxid.base.errors import UsageError
from jaxid.cli.app import cli
from jaxid.cli.excite import how_to_play
from jaxid.cli.record import record
from jaxid.data.dataset import Channel, Geometry, ModelSpec
from jaxid.data.limits import Limits
from jaxid.dynamics.base_parameters import torque_columns
from jaxid.excitation.bounds import bounds_of, KNOWN
from jaxid.excitation.clearance import gaps, heights, links_of, nodes
from jaxid.excitation.design import excite
from jaxid.excitation.trajectories import feasible, SearchSetting, Shape
from jaxid.hardware.trajectory import Trajectory
from jaxid.models import Panda, UR10, UR10e
from jaxid.numerics.precision import float64


EXPONENT = np.array([0.5758, 0.2723, 0.6093, 0.9995, 0.8031, 0.7209])


@pytest.fixture(scope="module")
def arm():
    """A short search: what is tested here holds for every trajectory."""
    return excite("ur10", starts=4, iterations=50, seed=1)


def differences(q: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speed and acceleration by differences alone."""
    h = t[1] - t[0]
    return np.diff(q, axis=0) / h, np.diff(q, 2, axis=0) / h**2


@pytest.mark.slow
def test_the_motion_keeps_its_limits_and_rests_at_both_ends(arm):
    """Seen from the positions alone, on a grid finer than that of the search."""
    t = np.linspace(0, 10, 20001)
    q = arm.fourier(t)[0]
    qd, qdd = differences(q, t)
    known = KNOWN["ur10"]
    assert (q >= np.array(known.lower)).all() and (q <= np.array(known.upper)).all()
    assert (np.abs(qd).max(0) <= known.speed).all() and (
        np.abs(qdd).max(0) <= np.array(known.acceleration) + 1e-3
    ).all()
    for k in (0, -1):
        assert np.abs(qd[k]).max() < 1e-3 and np.abs(qdd[k]).max() < 0.05
    assert np.allclose(q[0], q[-1], atol=1e-9)
    for e in arm.limits:  # what is reported is what is reached
        j = int(e["joint"][1:]) - 1
        if e["quantity"] == "speed":
            assert e["highest"] == pytest.approx(np.abs(qd[:, j]).max(), rel=2e-3)


@pytest.mark.slow
def test_the_condition_number_is_that_of_the_written_out_regressor(arm):
    """58 columns: base parameters, then the paper's friction with its exponents; sign(qd) smoothed
    as in the identification.
    """
    model, (q, qd, qdd) = UR10(), arm.fourier(arm.t)
    W = np.zeros((len(q), 6, 58))
    W[:, :, :40] = torque_columns(model, q, qd, qdd)[:, :, list(model.base().kept)]
    j = np.arange(6)
    W[:, j, 40 + j], W[:, j, 46 + j], W[:, j, 52 + j] = (
        np.tanh(qd / 0.01),
        qd * (qd**2 + 1e-6) ** ((EXPONENT - 1) / 2),
        1.0,
    )
    assert arm.condition_number == pytest.approx(np.linalg.cond(W.reshape(-1, 58)), rel=1e-6)
    noise = np.array([3.7817, 4.1789, 3.0339, 1.7334, 1.0670, 0.9896])
    A = (W / noise[:, None]).reshape(-1, 58)
    std = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    assert np.allclose(list(arm.content["expected_std"].values()), std, rtol=1e-5)


@pytest.mark.slow
def test_optimisation_beats_chance(arm):
    """The best of many random motions of the same family, all scaled to the same limits, is worse
    by far.
    """
    assert arm.condition_number < 130


@pytest.mark.slow
def test_ur10_excitation_beats_the_published_one():
    """Paper 001: 79.67 for 10 s."""
    made = excite("ur10")
    assert made.condition_number < 79.67, made.condition_number
    assert made.content["clearance"]["height_m"] >= 0 and made.content["clearance"]["links_m"] > 0.1


@pytest.mark.slow
def test_links_stay_apart_and_above_the_floor(arm):
    q = arm.fourier(np.linspace(0, 10, 3001))[0]
    node, links = nodes(UR10(), q), links_of(UR10())
    assert gaps(links, node).min() - 0.12 >= 0.99 * arm.content["clearance"]["links_m"] > 0
    assert heights(links, node).min() - 0.06 >= -1e-3


def test_distances_equal_dense_sampling():
    """Line to line distances against all pairs of 200 points; folded arms come out as touching."""
    rng = np.random.default_rng(0)
    arm, q = UR10e(), rng.uniform(-3, 3, (40, 6))
    links, node = links_of(UR10e()), nodes(UR10e(), q)
    s = np.linspace(0, 1, 200)[:, None]
    for k, (i, j) in enumerate(links.pairs):
        for time in range(40):
            a, b, c, d = node[time, [i, i + 1, j, j + 1]]
            dense = np.linalg.norm((a + s * (b - a))[:, None] - (c + s * (d - c)), axis=2).min()
            assert dense - 1e-3 <= gaps(links, node)[time, k] <= dense + 0.06
    folded = np.array([[0.0, -np.pi / 2, 3.05, 0.0, 0.0, 0.0]])
    assert gaps(links, nodes(arm, folded)).min() < 0.2 < gaps(links, nodes(arm, 0 * folded)).min()


@pytest.mark.parametrize("kind", [UR10, UR10e, Panda])
def test_default_boxes_are_clear_of_self_collision(kind):
    """Any pose of the box, not only those of one trajectory."""
    known = KNOWN[kind.name]
    q = np.random.default_rng(1).uniform(known.lower, known.upper, (5000, len(known.home)))
    assert gaps(links_of(kind()), nodes(kind(), q)).min() > 0.12


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 9))
def test_any_numbers_become_a_feasible_motion(seed, harmonics):
    rng = np.random.default_rng(seed)
    bounds = bounds_of("panda", Panda.signatures[0], None)
    numbers: list[Any] = [
        10 ** rng.uniform(-3, 3) * rng.normal(size=(harmonics, 7)) for _ in range(2)
    ]
    shape = Shape(*numbers, *rng.normal(size=(2, 7)))
    with float64():
        setting = SearchSetting(
            bounds, np.ones(7), None, 0.06, 0.0, 1.0, links_of(Panda()), "condition", 10
        )
        t = np.linspace(0, 2 * np.pi, 64 * harmonics)
        a, b, middle = (np.asarray(x) for x in feasible(shape, setting, t))
    assert np.allclose(a.sum(0), 0, atol=1e-9) and np.allclose(
        np.arange(1, harmonics + 1) @ b, 0, atol=1e-9
    )
    from jaxid.excitation.trajectories import series

    q, qd, qdd = series(a, b, middle, 1.0, t)
    assert (q > bounds.lower).all() and (q < bounds.upper).all()
    assert (np.abs(qd) <= bounds.speed).all() and (np.abs(qdd) <= bounds.acceleration).all()


@pytest.mark.slow
def test_a_friction_law_can_be_asked_for():
    """Columns of the Stribeck law count, and the joints spend time at low speed."""
    made = excite("ur10e", starts=2, iterations=25, friction="stribeck")
    assert made.content["columns"] == 70 and "F_s3" in made.content["expected_std"]
    slow = made.content["speed_coverage"]["share_of_time"]
    assert all(sum(row[:3]) > 0.05 for row in slow.values())


@pytest.mark.slow
def test_limits_of_a_file_count(tmp_path):
    path = tmp_path / "limits.toml"
    path.write_text("speed = 0.5\nlower = -0.4\nupper = [0.4, 0.2]\n")
    out = tmp_path / "plan"
    arguments = [
        "excite",
        "--model",
        "planar_arm",
        "--out",
        str(out),
        "--limits",
        str(path),
        "--starts",
        "2",
        "--iterations",
        "25",
    ]
    done = CliRunner().invoke(cli, [*arguments, "--json"])
    assert done.exit_code == 0, done.output
    content = json.loads((out / "excitation.json").read_text())
    assert content == json.loads(done.stdout)
    assert content["expected_std"].keys() >= {"m1", "coulomb1", "viscous2"}
    data = jaxid.load_dataset(out)
    q = data.experiments[0].y
    qd, _ = differences(q, data.experiments[0].t)
    assert np.abs(qd).max() <= 0.5 and q.min() >= -0.4 and (q.max(0) <= [0.4, 0.2]).all()
    path = Trajectory.read(out, joints=2)
    assert path.check(Limits(speed=(0.5,), lower=(-0.4,), upper=(0.4, 0.2)), 0.008) == []
    assert path.check(Limits(speed=(0.3,)), 0.008)
    again = CliRunner().invoke(cli, [*arguments, "--quiet"])
    assert again.exit_code == 0  # an earlier design is replaced
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    refused = CliRunner().invoke(
        cli,
        [
            "excite",
            "--model",
            "planar_arm",
            "--out",
            str(tmp_path / "mine"),
            "--starts",
            "2",
            "--iterations",
            "25",
        ],
    )
    assert refused.exit_code != 0 and (tmp_path / "mine" / "notes.txt").read_text() == "mine"


def test_files_of_a_ur(arm, tmp_path):
    folder = arm.save(tmp_path / "ur")
    files = "dataset.toml run_1.parquet excitation.json trajectory.csv excitation.png ur_125hz.csv ur_500hz.csv ur.script"
    assert {p.name for p in folder.iterdir()} == set(files.split())
    data = jaxid.load_dataset(folder)
    assert data.model is not None and data.model.name == "ur10"
    path = Trajectory.read(folder, joints=6)
    assert (
        path.check(Limits(speed=(2.09, 2.09, 3.14, 3.14, 3.14, 3.14), acceleration=(40.0,)), 0.008)
        == []
    )
    slow, fast = (
        np.loadtxt(folder / f"ur_{r}hz.csv", delimiter=",", skiprows=1) for r in (125, 500)
    )
    assert (
        slow.shape == (1251, 7)
        and fast.shape == (5001, 7)
        and np.allclose(fast[::4], slow, atol=1e-8)
    )
    script = (folder / "ur.script").read_text()
    assert script.count("servoj(") == 1250 and script.rstrip().endswith("end")
    r = jaxid.identify(
        None, data, friction="power", cutoff_hz=8.0
    )  # its own torques identify its own arm
    phi = np.column_stack([np.asarray(UR10().inertia()), np.asarray(UR10().Ia)])
    truth = UR10().base().values(phi.ravel())
    assert np.abs(r.theta[:40] - truth).max() < 0.4


@pytest.mark.slow
def test_inputs_show_what_they_claim():
    """Least squares on noisy simulations scatter as the design says they will."""
    known = {
        "inertia": 0.06,
        "gravity_torque": 1.3,
        "viscous": 0.05,
        "coulomb": 0.1,
        "offset": 0.02,
    }
    parameters = {"parameters": {name: {"value": value} for name, value in known.items()}}
    made = excite(
        "pendulum", duration_s=6.0, rate_hz=100.0, gain=[1.5], parameters=parameters, seed=3
    )
    assert made.content["assumed_values"] == known
    e = made.dataset.experiments[0]
    assert np.allclose(e.auxiliary["current_cmd"], e.u[:, 0] / 1.5)
    assert np.abs(e.y).max() <= 1.2 and made.content["directions_not_shown"] == 0
    rng = np.random.default_rng(0)
    found = []
    for _ in range(12):
        noisy = jaxid.Dataset.from_arrays(
            e.t,
            {"tau": e.u[:, 0]},
            {"q": e.y[:, 0] + 1e-3 * rng.normal(size=len(e.t))},
            model="pendulum",
            initial={"q": 0.0, "qd": 0.0},
            noise_std={"q": 1e-3},
            split="fit",
        )
        fit = jaxid.fit(None, noisy)
        found.append([fit.parameters[n].value for n in made.content["expected_std"]])
    scatter = np.std(found, axis=0, ddof=1)
    ratio = scatter / np.array(list(made.content["expected_std"].values()))
    # The fit keeps 30 % of the run for validation, which costs it some of the information.
    assert (ratio > 0.45).all() and (ratio < 3.5).all(), ratio


def test_a_servo_is_commanded_within_its_speed(tmp_path):
    made = excite(
        "servo", duration_s=8.0, rate_hz=125.0, limits=Limits(speed=(2.0,), acceleration=(20.0,))
    )
    made.save(tmp_path / "servo")
    path = Trajectory.read(tmp_path / "servo")
    assert (
        path.kind == "position"
        and path.check(Limits(speed=(2.0,), acceleration=(20.0,)), 0.008) == []
    )
    assert np.ptp(path.values) > 0.5


@pytest.mark.parametrize("model", ["joint", pytest.param("flexible_link", marks=pytest.mark.slow)])
def test_open_loop_models(model, tmp_path):
    made = excite(model, duration_s=4.0)
    jaxid.load_dataset(made.save(tmp_path / "plan"))
    assert all(e.get("share", 0) <= 1 + 1e-9 for e in made.limits)
    assert all(0 < s < np.inf for s in made.content["expected_std"].values())


@pytest.mark.slow
@pytest.mark.parametrize(
    "model", ["tracker", "space_manipulator", "panda", "serial_arm", "robot", "flexible_arm"]
)
def test_every_other_model(model, tmp_path):
    made = excite(model, starts=2, iterations=25, duration_s=5.0)
    jaxid.load_dataset(made.save(tmp_path / "plan"))
    assert all(e.get("share", 0) <= 1 + 1e-9 for e in made.limits)


def test_every_model_has_a_test_here():
    text = Path(__file__).read_text()
    assert [m.name for m in jaxid.models.MODELS if f'"{m.name}"' not in text] == []


@pytest.mark.slow
def test_the_objective_of_paper_001():
    """(18) and its constraints, worked out here from the coefficients alone; the search lowers
    it.
    """
    made: Any
    made, other = (
        excite(
            "ur10",
            criterion="paper001",
            harmonics=5,
            starts=n,
            iterations=steps,
            seed=1,
            floor=-10.0,
            radius=0.0,
        )
        for n, steps in ((4, 50), (1, 1))
    )
    condition = excite(
        "ur10",
        criterion="condition",
        harmonics=5,
        starts=4,
        iterations=50,
        seed=1,
        floor=-10.0,
        radius=0.0,
    )
    known, home = KNOWN["ur10"], np.array([0, -np.pi / 2, 0, -np.pi / 2, 0, 0])
    told = made.content["paper001"]
    l, w = np.arange(1, 6)[:, None], 2 * np.pi * 0.1
    a, b = np.asarray(made.fourier.a), np.asarray(made.fourier.b)
    for total in (a.sum(0), (b / l).sum(0), (l * b).sum(0)):
        assert np.abs(total).max() < 1e-9
    assert np.allclose(made.fourier.middle, home) and np.allclose(
        made.fourier(np.zeros(1))[0], home
    )
    size = np.hypot(a, b)
    room = np.minimum(np.array(known.upper) - home, home - np.array(known.lower))
    assert (np.sum(size / (w * l), 0) <= room + 1e-9).all() and (
        size.sum(0) <= np.array(known.speed) + 1e-9
    ).all()
    assert np.allclose(told["sums"]["speed"], size.sum(0)) and np.allclose(
        told["sums"]["acceleration"], (w * l * size).sum(0)
    )
    assert objective(other) > told["objective"] == pytest.approx(objective(made), rel=1e-6)
    assert told["objective"] < 1.1 * objective(
        condition
    )  # another search may find a little better, and does


def objective(made: Any) -> float:
    t = made.dataset.experiments[0].t
    q, qd, qdd = made.fourier(t)
    base = UR10().base()
    Y = torque_columns(UR10(), q, qd, qdd)[:, :, list(base.kept)]
    F = [np.tanh(qd / 0.01), qd * (qd**2 + 1e-6) ** ((EXPONENT - 1) / 2), np.ones_like(qd)]
    W = (
        np.concatenate([Y, *(f[:, :, None] * np.eye(6) for f in F)], 2)
        / np.array(KNOWN["ur10"].torque_noise)[:, None]
    )
    W = W.reshape(-1, 58)
    kinds = np.array([n[0] for n in base.names])
    groups = [
        np.arange(58),
        np.flatnonzero(kinds == "I"),
        np.flatnonzero(kinds == "m"),
        np.arange(40, 58),
    ]
    return float(np.dot([10, 5, 1, 1], [np.linalg.cond(W[:, g]) for g in groups]))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"criterion": "paper001", "harmonics": 2}, "3 harmonics"),
        ({"duration_s": 10.5, "base_frequency_hz": 0.1}, "whole ones"),
        ({"harmonics": 1}, "at least 2"),
        ({"friction": "stribek"}, "stribeck"),
        ({"criterion": "conditon"}, "condition"),
        ({"rate_hz": 2.0}, "rate of at least"),
        ({"limits": Limits(lower=(1.0,), upper=(-1.0,))}, "range of q1 is empty"),
    ],
)
def test_what_does_not_fit_is_refused(arguments, words):
    with pytest.raises(UsageError, match=words):
        excite("ur10", **arguments)


@pytest.mark.slow
def test_a_floor_that_cannot_be_kept():
    with pytest.raises(UsageError, match="--floor"):
        excite("ur10", starts=4, iterations=50, floor=1.2, seed=1)


PENDULUM = ModelSpec("pendulum")
ROBOT = ModelSpec("robot", geometry=Geometry(file="robot.xml", robot="<mujoco/>"))


def design(columns: str, inputs: str, model: ModelSpec, gains: list[float] | None = None) -> Any:
    """A design of 1 s by what it plays and what its model takes."""
    channels = tuple(
        Channel(name, "input", "N m" if name.startswith("tau") else "rad")
        for name in inputs.split(",")
    )
    commands = {name: np.array([0.0, 1.0]) for name in columns.split(",")}
    dataset = SimpleNamespace(inputs=channels, model=model)
    return SimpleNamespace(commands=commands, dataset=dataset, content={"gains": gains})


SIX = ",".join(f"q{k}_cmd" for k in range(1, 7))
TAUS = "tau1,tau2"


@pytest.mark.parametrize(
    ("made", "device", "meant", "joints"),
    [
        (
            design("tau,current_cmd", "tau", PENDULUM, [1.5]),
            "dynamixel --port PORT --id 1 --mode current",
            " --model pendulum --gain 1.5",
            1,
        ),
        (
            design("tau1,tau2,current1_cmd,current2_cmd", TAUS, ROBOT, [1.5, 2.0]),
            "dynamixel --port PORT --id 1 --id 2 --mode current",
            " --model {plan}/robot.xml --gain 1.5,2",
            2,
        ),
        (
            design("q1_cmd,q2_cmd", TAUS, ModelSpec("planar_arm")),
            "dynamixel --port PORT --id 1 --id 2 --mode position",
            "",
            2,
        ),
        (design(SIX, TAUS, ModelSpec("ur10")), "ur10 --host HOST", "", 6),
        (
            design("lift_cmd,elbow_cmd", "lift_cmd,elbow_cmd", ROBOT),
            "dynamixel --port PORT --id 1 --id 2 --mode position",
            " --model {plan}/robot.xml",
            2,
        ),
    ],
)
def test_the_command_that_plays_a_design_runs_as_printed(tmp_path, made, device, meant, joints):
    plan = tmp_path / "plan"
    plan.mkdir()
    columns = {"t": np.array([0.0, 1.0]), **made.commands}
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{v:g}" for v in row) for row in rows)]
    (plan / "trajectory.csv").write_text("\n".join(lines))
    said = how_to_play(made, plan)
    options = f"--play {plan}{meant.format(plan=plan)} --out {plan}_run"
    assert said == f"play it with: jaxid record {device} {options}"
    _, name, *words = shlex.split(said.partition("jaxid ")[2])
    command = record.get_command(click.Context(record), name)
    assert command is not None
    taken = command.make_context(name, words).params
    mode = taken.get("mode", "position")
    path = Path(taken["play"]) / "trajectory.csv"
    named = ["lift", "elbow"]
    assert Trajectory.read(path, joints, mode, named).values.shape == (2, joints)


def test_a_design_that_no_device_plays_says_what_to_do(tmp_path):
    assert "give --gain" in how_to_play(design("tau", "tau", PENDULUM), tmp_path)
    pushed = design("push", "push", ROBOT)
    pushed.dataset.inputs = (Channel("push", "input", "N"),)
    assert "play trajectory.csv yourself" in how_to_play(pushed, tmp_path)


HINGE = """<mujoco><compiler angle="radian"/><worldbody><body name="arm">
<joint name="shoulder" type="hinge" axis="0 1 0" damping="0.05" range="-1.5 1.5"/>
<inertial pos="0.15 0 0" mass="0.3" diaginertia="0.001 0.002 0.002"/></body></worldbody>{}</mujoco>
"""
GOALS = """<actuator><position joint="shoulder" kp="10" kv="0.3"/></actuator>"""


@pytest.mark.slow
def test_the_range_of_a_file_stays_where_it_is(tmp_path):
    """The arm hangs at pi / 2 without drive, beyond its range of 1.5 rad."""
    file = tmp_path / "robot.xml"
    file.write_text(HINGE.format(GOALS))
    made = excite(str(file), duration_s=4.0, starts=2)
    goals = made.commands["shoulder_cmd"]
    assert np.abs(goals).max() <= 1.5 and np.ptp(goals) > 0.5
    assert np.abs(made.dataset.experiments[0].y).max() <= 1.5
    file.write_text(HINGE.format(""))
    with pytest.raises(UsageError, match=r"without drive shoulder rests at 1\.571, outside"):
        excite(str(file), duration_s=4.0, starts=2)


@pytest.mark.slow
def test_each_torque_of_a_robot_has_a_current_of_its_own(tmp_path):
    file = tmp_path / "robot.xml"
    file.write_text(
        """<mujoco><worldbody><body><joint name="a" axis="0 0 1" damping="0.1"/>
<inertial pos="0.1 0 0" mass="0.3" diaginertia="0.01 0.01 0.01"/><body pos="0.2 0 0">
<joint name="b" axis="0 0 1" damping="0.1"/>
<inertial pos="0.1 0 0" mass="0.3" diaginertia="0.01 0.01 0.01"/></body></body></worldbody></mujoco>
"""
    )
    made = excite(str(file), duration_s=2.0, starts=1, gain=[2.0])
    torques = made.dataset.experiments[0].u
    for k in range(2):
        assert np.allclose(made.commands[f"current{k + 1}_cmd"], torques[:, k] / 2.0)
