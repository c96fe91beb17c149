"""A diagnosis of runs that touch, on twins that MuJoCo makes."""

import importlib
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest

import jaxid
from jaxid.conventions import checking
from jaxid.data.dataset import ModelSpec
from jaxid.diagnosis.evidence import HeldOut
from jaxid.diagnosis.goals.gains import with_room
from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.goals.touching import _Judge, _of_numbers, Trial
from jaxid.diagnosis.hypothesis import Hypothesis, SearchResult
from jaxid.diagnosis.verdict import judge
from jaxid.dynamics import catalogue
from jaxid.fitting import problem_builder
from jaxid.fitting.problem_builder import (
    Begun,
    descend_over_stretches,
    estimate_starts,
    ProblemBuilder,
)
from jaxid.models import Robot
from jaxid.problem.binding import bind
from jaxid.problem.residual import OutputError
from test_contacts import LEG, SOLES


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads

STEP, EVERY = 0.002, 5
NAMES = ("along", "up", "hip", "knee")
NOISE = np.array([2e-4, 2e-4, 1e-4, 1e-4])
TEXT = LEG.format(shape=SOLES["capsule"], integrator="implicitfast")


def goals(t: np.ndarray, hops_per_s: float) -> np.ndarray:
    bend = 0.8 + 0.45 * np.clip(1.5 * np.sin(2 * np.pi * hops_per_s * t), -0.6, 1.0)
    return np.stack([-0.5 * bend, bend], 1)


def run(text: str, hops_per_s: float, seconds: float, late: int) -> tuple[np.ndarray, np.ndarray]:
    """Goals and positions every 10 ms of a leg that hops; commands act `late` steps after."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    t = np.arange(round(seconds / STEP)) * STEP
    held = goals(t, hops_per_s)[np.arange(len(t)) // EVERY * EVERY]
    data.qpos[:] = [0.0, 0.6, *held[0]]
    positions, landed = np.empty((len(t), 4)), 0
    for k in range(len(t)):
        positions[k] = data.qpos
        data.ctrl[:] = held[max(0, k - late)]
        mujoco.mj_step(model, data)
        landed += data.ncon > 0
    assert 0.1 * len(t) < landed
    return held[::EVERY], positions[::EVERY]


def recorded(text: str, seconds: float, late: int = 0, seed: int = 0) -> jaxid.Dataset:
    """Three runs, one to fit, one to judge by and one to report."""
    rng = np.random.default_rng(seed)
    made = [run(text, hops_per_s, seconds, late) for hops_per_s in (1.4, 1.25, 1.55)]
    noisy = [q + NOISE * rng.normal(size=q.shape) for _, q in made]
    t = np.arange(len(noisy[0])) * STEP * EVERY
    data = jaxid.Dataset.from_arrays(
        [t] * 3,
        {f"{name}_cmd": [u[:, k] for u, _ in made] for k, name in enumerate(NAMES[2:])},
        {name: [q[:, k] for q in noisy] for k, name in enumerate(NAMES)},
        split=["fit", "validation", "report"],
        units={
            **dict.fromkeys(NAMES[:2], "m"),
            **dict.fromkeys([*NAMES[2:], "hip_cmd", "knee_cmd"], "rad"),
        },
        noise_std=dict(zip(NAMES, NOISE.tolist(), strict=True)),
        check_model=False,
    )
    return replace(data, model=ModelSpec(contacts=True))


def robot() -> Robot:
    return Robot.from_mjcf("leg.xml", text=TEXT)


def test_a_trial_changes_its_size_within_the_bounds():
    stated = np.array([1.0, 0.0, 1e12])
    trial = Trial(
        theta=np.array([1.0, 0.4, 20.0]), stated=stated, kind="effect", strengths=(1,), levels=(2,)
    )
    low, high = np.array([0.0, -1.0, 1.0]), np.array([2.0, 0.5, 1e3])
    np.testing.assert_allclose(trial.scaled(0.5, low, high).theta, [1.0, 0.2, 10.0])
    np.testing.assert_allclose(trial.scaled(-2.0, low, high).theta, [1.0, -0.8, 1.0])
    np.testing.assert_allclose(trial.scaled(4.0, low, high).theta, [1.0, 0.5, 80.0])
    moved = Trial(theta=np.array([1.3, 0.0, 1e12]), stated=stated, kind="number", strengths=(0,))
    np.testing.assert_allclose(moved.scaled(2.0, low, high).theta, [1.6, 0.0, 1e12])


def test_numbers_of_one_kind_are_asked_together_too():
    plain = with_room(bind(robot(), recorded(TEXT, 1.0)))
    names = plain.layout.names
    asked = set()
    for trial in _of_numbers(plain, plain.theta):
        asked.add(tuple(names[i] for i in trial.strengths))
        moved = np.flatnonzero(trial.theta != plain.theta)
        assert set(moved) <= set(trial.strengths)
    assert {("kp@hip",), ("kp@knee",), ("kp@hip", "kp@knee")} <= asked


def test_a_payload_is_offered_once_per_body():
    leg = robot()
    chain = bind(leg, recorded(TEXT, 1.0)).chain
    assert chain.offers(catalogue.effect_class("payload")) == ("up", "hip", "knee")
    along, up, _, _ = (leg.loaded(jnp.asarray(mass)).added for mass in np.eye(4))
    np.testing.assert_array_equal(along, up)


def test_the_ground_pushes_along_the_motion_so_the_model_is_not_asked_there(monkeypatch):
    def refused(*_: object) -> None:
        raise AssertionError("forces of the ground are not known along a motion")

    monkeypatch.setattr(checking, "force_fit", refused)
    jaxid.check(robot(), recorded(TEXT, 1.0))


def test_how_runs_begin_is_taken_over_by_a_model_with_candidates(monkeypatch):
    asked = []

    def begun(bench: ProblemBuilder, split: str, theta: np.ndarray) -> Begun:
        asked.append(theta)
        return Begun(np.ones((1, 8)), [np.eye(8)])

    monkeypatch.setattr(problem_builder, "_begun_touching", begun)
    data = recorded(TEXT, 1.0)
    plain = ProblemBuilder(bind(robot(), data), differences=1)
    starts = estimate_starts(plain, "fit", [plain.binding.theta])
    kinds = [catalogue.effect_class("input_delay")]
    wide = ProblemBuilder(bind(robot(), data, candidates=kinds), differences=1)
    wide.begin_as(plain)
    taken = estimate_starts(wide, "fit", [wide.binding.theta])
    np.testing.assert_array_equal(taken, starts)
    assert len(asked) == 1
    assert len(wide.binding.theta) > len(asked[0])
    late = wide.binding.theta.copy()
    late[-1] += 1e-3
    estimate_starts(wide, "fit", [late])
    assert len(asked) == 2
    back = ProblemBuilder(bind(robot(), data), differences=1)
    back.begin_as(wide)  # but for the late one, which it has no number for
    assert len(back.begun_before("fit")) == 1
    estimate_starts(back, "fit", [back.binding.theta])
    assert len(asked) == 2


def test_a_run_begins_as_with_the_model_that_is_nearest(monkeypatch):
    left = {0.1: np.full(50, 9.0), 0.2: np.full(50, 0.9), 0.3: np.full(50, 1.0)}
    left[0.4] = np.full(50, np.nan)
    monkeypatch.setattr(
        problem_builder, "residuals", lambda p, points: [left[z[0]] for z in points]
    )
    every: Any = [np.array([z]) for z in left]
    assert problem_builder._nearest(cast(Any, None), every) is every[1]
    assert problem_builder._nearest(cast(Any, None), [every[0], every[3]]) is None
    assert problem_builder._nearest(cast(Any, None), []) is None


def test_late_commands_are_asked_by_whole_steps_too():
    kinds = [catalogue.effect_class("input_delay")]
    bench = ProblemBuilder(bind(robot(), recorded(TEXT, 1.0), candidates=kinds), differences=1)
    binding = bench.binding
    starts = np.zeros((1, 8))
    trials = _Judge(bench, binding.theta, [], starts)
    late, other = binding.layout.index("input_delay.delay@hip_cmd"), 0
    theta = binding.theta.copy()
    theta[late] = 0.0047
    trial = Trial(theta=theta, stated=binding.theta, kind="effect", strengths=(late,))
    (whole,) = trials._in_whole_steps(trial)
    assert whole.theta[late] == pytest.approx(2 * STEP)
    assert not trials._in_whole_steps(replace(trial, strengths=(other,)))


def test_a_run_that_touches_is_at_the_noise_within_what_is_left_open():
    path: Any = SimpleNamespace(loss=1.0, count=1000)
    lost = Hypothesis((), np.zeros(1), path, HeldOut([], [], loss=3.0, count=1000))
    assert not lost.at_noise
    assert judge(SearchResult(lost, lost)).name == "unknown"
    open_to_it = replace(lost, left_open={"fit": 0.0, "validation": 2.5})
    assert open_to_it.at_noise
    assert judge(SearchResult(open_to_it, open_to_it)).name == "none"


@pytest.mark.slow
def test_how_a_run_that_hops_began_is_found_to_the_noise():
    data = recorded(TEXT, 2.0)
    bench = ProblemBuilder(bind(robot(), data), differences=1)
    theta = bench.binding.theta
    for split in ("fit", "validation", "report"):
        starts = estimate_starts(bench, split, [theta])[0]
        problem = bench.problem(OutputError(), split, [], theta)
        (left,) = problem.residuals(problem.z(theta, starts))
        assert np.sqrt(np.mean(left**2)) < 1.1


def test_what_cannot_follow_the_beginning_is_given_up():
    data = recorded(TEXT, 1.0)
    bench = ProblemBuilder(bind(robot(), data), differences=1)
    theta = bench.binding.theta.copy()
    whole, spent = descend_over_stretches(bench, "fit", [], theta, [0], most=10.0)
    assert whole.loss < 1.3
    theta[bench.binding.layout.index("kp@knee")] *= 0.5
    given_up, less = descend_over_stretches(bench, "fit", [], theta, [0], most=10.0)
    assert given_up.cost == np.inf
    decider = Decider(bench, bench.binding.layout.names)
    assert not np.isfinite(decider._judged((), given_up).validation.loss)
    assert less < 2 * spent


def test_runs_without_effects_take_the_program_without():
    kinds = [catalogue.effect_class(name) for name in ("input_delay", "backlash")]
    wide = bind(robot(), recorded(TEXT, 1.0), candidates=kinds)
    bench = ProblemBuilder(wide, differences=1, together=True)
    engine = bench.runs(OutputError(), "fit").engine
    late = wide.theta.copy()
    late[wide.layout.index("input_delay.delay@hip_cmd")] = 0.01
    groups = engine._at_work(np.array([wide.theta, late]) != engine._neutral)
    assert sorted(map(len, groups)) == [0, 1]
    plain, _ = engine._programs_of(frozenset())
    assert plain is not engine._programs_of(frozenset(engine._families))[0]


def test_by_torque_contacts_are_not_asked():
    data = recorded(TEXT, 1.0)
    with pytest.raises(jaxid.UsageError, match="compares the runs themselves"):
        jaxid.diagnose(robot(), data, residual="inverse_dynamics")


@pytest.mark.slow
def test_nothing_is_missing_where_the_file_hops_as_the_machine():
    found = jaxid.diagnose(robot(), recorded(TEXT, 2.0))
    assert found.which.verdict == "none"


@pytest.mark.slow
def test_slippery_ground_is_a_number_of_the_file():
    # MuJoCo takes the larger friction of two shapes.
    slippery = TEXT.replace('friction="1.2 ', 'friction="0.5 ')
    slippery = slippery.replace('type="plane"', 'type="plane" friction="0.5"')
    found = jaxid.diagnose(robot(), recorded(slippery, 2.0))
    assert found.which.verdict == "none"
    value = found.nominal.parameters["sliding_friction@sole"].value
    assert value == pytest.approx(0.5, abs=0.02)
    assert not found.which.effects


@pytest.mark.slow
def test_late_commands_of_a_leg_that_hops_are_named():
    found = jaxid.diagnose(robot(), recorded(TEXT, 2.0, late=4))
    assert found.which.verdict == "named"
    assert {e.effect for e in found.which.effects} == {"input_delay"}
    for effect in found.which.effects:
        assert effect.parameters["delay"].value == pytest.approx(0.008, abs=5e-4)
