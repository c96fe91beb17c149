"""A robot's file as it stands, and the one thing that is different in a recording."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.benchmark.goal_arms import dataset, GoalArm, goals, recorded
from jaxid.diagnosis.goals.as_stated import one_change
from jaxid.diagnosis.goals.own_run import run_of_file
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.binding import bind


ARM = GoalArm(
    ["0 1 0", "0 1 0"],
    np.array([0.25, 0.2]),
    np.array([0.5, 0.4]),
    np.array([0.04, 0.02]),
    np.array([0.8, 0.5]),
    np.array([0.1, 0.05]),
    np.array([60.0, 30.0]),
    np.array([1.2, 0.6]),
    np.array([48.0, 24.0]),
)


def case(seconds: float, beside: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    """A case of the blind benchmark with a changed arm; the effect is at the last joint."""
    rng = np.random.default_rng(7)
    u = goals(2, seconds, rng)
    real = replace(ARM, **more)
    q = recorded(real, "", 1, beside or {}, u, rng)
    return {"arm": ARM, "u": u, "q": q}


def written(folder: Path) -> str:
    path = folder / "arm.xml"
    path.write_text(ARM.xml())
    return str(path)


def ends(values: np.ndarray, factor: float) -> np.ndarray:
    """With the last one changed."""
    return values * np.array([1.0, factor])


def test_a_recording_of_mujocos_is_the_run_of_its_file(tmp_path):
    b = bind(written(tmp_path), dataset(case(4.0)))
    run = run_of_file(ProblemBuilder(b, differences=1, together=True))
    assert run is not None and run.accounts(b)
    off = bind(written(tmp_path), dataset(case(4.0, armature=ends(ARM.armature, 1.5))))
    run = run_of_file(ProblemBuilder(off, differences=1, together=True))
    assert run is not None and not run.accounts(off)


def test_what_is_unknown_is_not_accounted_for():
    own = "sliding_friction@foot 0.467 (stated 0.9)"
    accounts = f"One change of the file accounts for the gap: {own}."
    assert one_change(own, [], "none") == accounts
    assert one_change(own, ["lag", "delay"], "none") == f"{accounts} So would lag or delay."
    assert one_change(own, ["lag"], "unknown") == f"One change of the file comes nearest: {own}."


CHANGES = {
    "encoder": ({"bias": 0.05}, {}, ("sensor_bias", {"bias": 0.05})),
    "load": ({}, {"more": {"payload": {1: (0.2, np.array([0.2, 0.0, 0.0]))}}}, ("payload", {"mass": 0.2, "dx": 0.1})),
    "gain": ({}, {k: ends(getattr(ARM, k), 0.85) for k in ("kp", "kv", "limit")}, ("torque_scale", {"gain": -0.15})),
    "armature": ({}, {"armature": ends(ARM.armature, 1.5)}, None),
    "nothing": ({}, {}, None),
}  # fmt: skip


@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=[] if k == "nothing" else pytest.mark.slow) for k in CHANGES],
)
def test_the_one_thing_that_is_different_is_named_with_all_else_as_it_stands(kind, tmp_path):
    beside, more, lacking = CHANGES[kind]
    c = case(10.0, beside, **more)
    found = jaxid.diagnose(written(tmp_path), dataset(c))
    told = {
        (r.parameter, r.joint) for r in found.nominal.stated if r.deviation and abs(r.deviation) > 3
    }
    if lacking is None:
        assert found.which.verdict == "none" and not found.which.effects
        assert told == ({("armature", "j2")} if kind == "armature" else set())
        assert ("armature@j2" in found.which.text) == (kind == "armature")
        return
    (effect,) = found.which.effects
    assert (found.which.verdict, effect.effect, effect.location.split("_")[0]) == (
        "named",
        lacking[0],
        "j2",
    )
    for name, value in lacking[1].items():
        e = effect.parameters[name]
        assert e.std is not None and abs(e.value - value) < max(3 * e.std, 0.01 * abs(value)), name
    assert found.how_far.gap_after < 1.15 < 2 < found.how_far.gap_before
    assert "stand as they are" in found.which.text


@pytest.mark.slow
def test_a_load_on_the_axis_of_a_joint_is_as_well_one_of_the_link_before_it(tmp_path):
    arm = replace(ARM, axes=["0 1 0", "1 0 0"])
    rng = np.random.default_rng(7)
    u = goals(2, 10.0, rng)
    q = recorded(
        replace(arm, more={"payload": {1: (0.2, np.array([0.08, 0.0, 0.0]))}}), "", 1, {}, u, rng
    )
    path = tmp_path / "arm.xml"
    path.write_text(arm.xml())
    found = jaxid.diagnose(str(path), dataset({"arm": arm, "u": u, "q": q})).which
    assert found.verdict == "named"
    told = [(e.effect, e.location) for e in (*found.effects, *found.confusable_with)]
    assert sorted(told) == [("payload", "j1"), ("payload", "j2")]


SOFT = """<mujoco><option timestep="{step}"/><worldbody>
<body name="upper" pos="0 0 .4"><joint name="shoulder" axis="0 1 0" armature="0.1" damping="1"
frictionloss="{friction}"/><inertial pos="0 0 .15" mass="2" diaginertia=".02 .02 .004"/>
<body name="fore" pos="0 0 .3"><joint name="elbow" axis="0 1 0" armature="0.05" damping="0.4"
frictionloss="0.2"/><inertial pos="0 0 .12" mass="1" diaginertia=".008 .008 .002"/></body></body>
</worldbody><actuator><position joint="shoulder" kp="120" kv="8"/>
<position joint="elbow" kp="60" kv="3"/></actuator></mujoco>"""


def made_by_mujoco(text: str, seconds: float, runs: int, rate: float = 100.0) -> jaxid.Dataset:
    """Free runs of a file under goals, made by MuJoCo itself, noise of 0.3 mrad."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(text)
    rng, t = np.random.default_rng(3), np.arange(0, seconds, 1 / rate)
    times, goal_of, read = [], [], []
    for _ in range(runs):
        wave = [
            sum(np.sin(2 * np.pi * f * t + p) for f, p in rng.uniform(0.15, 1.2, (4, 2)))
            for _ in range(2)
        ]
        goal = 0.24 * np.stack(wave, 1) * np.minimum(1.0, t)[:, None]
        state, q = mujoco.MjData(model), []
        for u in goal:
            q.append(state.qpos.copy())
            state.ctrl[:] = u
            for _ in range(round(1 / rate / model.opt.timestep)):
                mujoco.mj_step(model, state)
        times.append(t)
        goal_of.append(goal)
        read.append(np.array(q) + 3e-4 * rng.standard_normal(goal.shape))
    names = ("shoulder", "elbow")
    inputs = {f"{name}_cmd": [u[:, j] for u in goal_of] for j, name in enumerate(names)}
    outputs = {name: [q[:, j] for q in read] for j, name in enumerate(names)}
    return jaxid.Dataset.from_arrays(
        times,
        inputs,
        outputs,
        units=dict.fromkeys([*inputs, *outputs], "rad"),
        split=["fit", "validation", "report"][:runs],
        at_rest=True,
        check_model=False,
    )


@pytest.mark.slow
def test_soft_friction_that_is_not_the_files_is_another_number_and_no_effect(tmp_path):
    """What MuJoCo's friction creeps by is that of the friction that is there, not of the file's."""
    path = tmp_path / "arm.xml"
    path.write_text(SOFT.format(friction=0.3, step=2e-3))
    data = made_by_mujoco(SOFT.format(friction=2.0, step=2e-3), 12.0, 3)
    found = jaxid.diagnose(str(path), data)
    assert found.which.verdict == "none" and not found.which.effects
    (wrong,) = [row for row in found.final.stated if row.refuted]
    assert (wrong.parameter, wrong.joint) == ("frictionloss", "shoulder")
    assert wrong.std is not None and wrong.beside is not None
    # Without torque a common factor of all of them is known no better than the gains are.
    assert abs(wrong.fitted - 2.0) < 2 * wrong.std < 0.2
    assert abs(wrong.beside - 2.0) < 0.01
