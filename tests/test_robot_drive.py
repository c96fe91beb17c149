"""What drives a robot and what carries it: laws whose numbers are fitted, recorded rates of goals,
encoders that are off inside the loop, and a base that moves as it was measured.
"""

import importlib
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxid import Dataset, UsageError
from jaxid.base.stopping import Interrupted
from jaxid.data.dataset import Controller, ModelSpec
from jaxid.diagnosis.goals.loop import loop_of, mean_input
from jaxid.diagnosis.limbs import diagnose_each, joined
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Command, Signals
from jaxid.excitation.bounds import bounds_of
from jaxid.excitation.design import mechanism_of
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.result import Estimate
from jaxid.fitting.simulate import own_numbers
from jaxid.models import Robot
from jaxid.models.effects import CoulombFriction, Saturation, SensorBias
from jaxid.problem.binding import bind, resolve_model
from jaxid.problem.residual import InverseDynamics, OutputError
from jaxid.robots.beside import left_out as without_channels, rides
from jaxid.robots.drives import stated_law
from jaxid.robots.match import notes_of, prepared, spec_of_file
from jaxid.robots.yardstick import stated
from report_sample import sample_diagnosis


mujoco: Any = importlib.import_module("mujoco")

LINK = '<inertial pos="0.1 0.02 -0.03" mass="0.4" diaginertia="2e-3 3e-3 4e-3"/>'
ARM = f"""<mujoco><default><joint damping="0.3" armature="0.02"/><position kp="8" kv="0.2"/></default>
<worldbody><body name="l1" pos="0.05 -0.1 0.2"><joint name="lift" axis="0 1 0"/>{LINK}
<body name="l2" pos="0.2 0 0.1"><joint name="turn" axis="1 0 0"/>{LINK}</body></body></worldbody>
<actuator><position joint="lift"/><position joint="turn"/></actuator></mujoco>"""
JOINTS = ("lift", "turn")
T = np.arange(300) * 0.01


def wave(k):
    return 0.3 * np.sin(4 * T + k)


def recording(controller=None, auxiliary=None, units=None, **more: Any) -> Dataset:
    return Dataset.from_arrays(
        T,
        {f"{j}_cmd": wave(k) for k, j in enumerate(JOINTS)},
        {j: wave(k + 0.4) for k, j in enumerate(JOINTS)},
        auxiliary=auxiliary,
        units={n: "rad" for j in JOINTS for n in (j, f"{j}_cmd")} | (units or {}),
        controller=controller,
        check_model=False,
        **more,
    )


def pd(kind="pd", **more):
    gains = {
        "pd": {"kp": 20.0, "kd": 0.5},
        "pid": {"kp": 20.0, "kd": 0.5, "ki": 3.0},
        "cascade": {"kp": 10.0, "kv": 2.0},
    }
    return Controller(kind, {**gains[kind], "sample_time": 0, **more})


def chain_of(dataset: Dataset) -> Any:
    return resolve_model(*prepared(Robot.from_mjcf("robot.xml", text=ARM), dataset))


def asked(chain: Any, goal, q, qd, beside=(), h=0.002):
    """Joint torque that the law of a chain makes of inputs at one moment."""
    u = (
        jnp.concatenate([jnp.asarray(goal), jnp.asarray(beside)])
        if len(beside)
        else jnp.asarray(goal)
    )
    command = Command(jnp.zeros(()), jnp.asarray(h), u, u, lambda d: u)
    q, qd = jnp.asarray(q), jnp.asarray(qd)
    signals = Signals(command.t, q, qd, jnp.zeros_like(q), command.h, command, qd)
    z = chain.start(q, qd, u).z
    return np.asarray(chain.commanded(signals, z)[0])[: len(goal)]


def test_stated_gains_are_priors_and_the_result_says_so():
    data = recording(
        pd(kp={"lift": 20.0, "turn": 5.0}, kd=0.0, fit=["kp", "kd", "delay"], spread={"kp": 0.2})
    )
    b = bind(Robot.from_mjcf("robot.xml", text=ARM), data)
    names = {b.layout.names[i]: i for i in b.free}
    assert {f"{n}@{j}" for n in ("kp", "kd", "delay") for j in JOINTS} <= set(names)
    assert b.priors == {
        names["kp@lift"]: (20.0, 4.0),
        names["kp@turn"]: (5.0, 1.0),
    }  # what is stated as 0 has none
    assert "prior of kp@lift: 20 ± 4 N m/rad (stated)" in b.said
    i = names["kp@turn"]
    assert 0 < b.lower[i] < 5 - 4 < 5 + 4 < b.upper[i] and b.theta[i] == 5.0
    own = bind(Robot.from_mjcf("robot.xml", text=ARM), recording(pd(fit=["kp"])))
    assert (
        "prior of kp@lift, kp@turn: 20 ± 2 N m/rad (stated)" in own.said
    )  # 10 % where no spread is stated


def test_only_numbers_that_the_file_can_have_stand_beside_it():
    """Those of an effect at a torque have neither joint nor link of the file."""
    b = bind(
        Robot.from_mjcf("arm.xml", text=ARM), recording(), candidates=[Saturation, CoulombFriction]
    )
    found = {
        i: Estimate(1.0, 0.1, "N m", 0.0, 9.0)
        for i in (*b.free, *b.layout.of_effect("saturation", "turn_tau"))
    }
    rows = stated(b, found).values()
    assert {r["parameter"] for r in rows} >= {"damping", "armature"} and not {
        r["parameter"] for r in rows
    } & {"limit"}


def test_what_the_files_steps_add_refutes_no_number_of_it():
    text = ARM.replace(
        "<worldbody>", '<option timestep="0.01" integrator="implicitfast"/><worldbody>', 1
    )
    own = recording(model=ModelSpec(simulator="own"))
    b = bind(Robot.from_mjcf("arm.xml", text=text), own)
    assert isinstance(b.chain.mechanism, Robot)
    steps = b.chain.mechanism.tree.tree.steps
    i = b.layout.index("armature@lift")

    def number(name):
        return float(b.theta[b.layout.index(name)])

    added = 0.005 * (number("damping@lift") + number("kd@lift"))
    assert steps.step == 0.01 and added > 1e-3
    std = 0.01 * added
    for more, refuted in ((0.0, False), (added, False), (-added, True), (2 * added, True)):
        (row,) = stated(b, {i: Estimate(b.theta[i] + more, std, "kg m^2", 0.0, 9.0)}).values()
        assert (abs(row["deviation"]) > 3) == refuted, more
        fitted = b.theta[i] + more - (added if refuted else 0.0)
        np.testing.assert_allclose(row["fitted"], fitted)


@pytest.mark.parametrize("kind", ["pd", "cascade"])
def test_a_recorded_rate_of_the_goal_drives_too(kind):
    rates = {f"{j}_rate": np.cos(T + k) for k, j in enumerate(JOINTS)}
    law = pd(kind, reference_velocity="*_rate")
    data = recording(law, rates, {n: "rad/s" for n in rates})
    _, moved = prepared(Robot.from_mjcf("robot.xml", text=ARM), data)
    chain = chain_of(data)
    assert (
        [n for n, _ in chain.signature.inputs]
        == [c.name for c in moved.inputs]
        == [*(f"{j}_cmd" for j in JOINTS), *rates]
    )
    goal, q, qd, rate = (
        np.array([0.3, -0.2]),
        np.array([0.1, 0.2]),
        np.array([0.5, -1.0]),
        np.array([0.7, 0.4]),
    )
    expected = (
        20 * (goal - q) + 0.5 * (rate - qd) if kind == "pd" else 2 * (10 * (goal - q) + rate - qd)
    )
    assert np.allclose(asked(chain, goal, q, qd, rate), expected)
    with pytest.raises(UsageError, match="no channel 'lift_speed'"):
        chain_of(recording(pd(reference_velocity="*_speed"), rates, {n: "rad/s" for n in rates}))
    with pytest.raises(UsageError, match="a name with \\*"):
        chain_of(recording(pd(reference_velocity="rate"), rates, {n: "rad/s" for n in rates}))


def test_an_integral_begins_where_the_joint_is_held():
    chain = chain_of(recording(pd("pid")))
    q, zero = np.array([0.4, -0.3]), np.zeros(2)
    hold = np.asarray(chain.mechanism.inverse(jnp.asarray(q), jnp.zeros(2), jnp.zeros(2)))
    assert np.allclose(asked(chain, q, q, zero), hold) and np.abs(hold).max() > 0.1


def test_an_encoder_that_is_off_tells_the_loop_too():
    chain = chain_of(recording(pd()))
    off = chain.with_effects(SensorBias(bias=jnp.array([0.05, -0.02])))
    goal, q, qd = np.array([0.3, -0.2]), np.array([0.1, 0.2]), np.array([0.5, -1.0])
    assert np.allclose(asked(off, goal, q, qd), asked(chain, goal, q + [0.05, -0.02], qd))


def test_a_law_read_at_the_samples_is_in_phase():
    """Goals that are held jump at every sample; half a sample of lead would read as inertia and
    damping.
    """
    law = replace(stated_law(pd(), JOINTS, 0.01))
    t = np.arange(0, 4, 0.05)
    q = 0.2 * np.sin(2 * t[:, None] + [0.0, 1.0])
    goal = 0.3 * np.sin(2 * t[:, None] + [0.3, 0.5])
    fine = np.arange(0, 4 - 0.05, 1e-3)
    held = goal[np.floor(fine / 0.05 + 1e-9).astype(int)]
    true = 20 * (held - 0.2 * np.sin(2 * fine[:, None] + [0.0, 1.0])) - 0.5 * 0.4 * np.cos(
        2 * fine[:, None] + [0.0, 1.0]
    )

    def basis(t):
        return np.stack([np.sin(2 * t), np.cos(2 * t), np.ones_like(t)], 1)

    def fit(t, tau):
        return np.linalg.lstsq(basis(t), tau, rcond=None)[0][:2]

    inner = slice(2, -2)
    expected = fit(fine, true)
    assert (
        np.abs(fit(t[inner], law.torque(t, goal, q)[inner]) - expected).max()
        < 0.02 * np.abs(expected).max()
    )
    late = law.torque(t, goal, q, held=False)
    assert np.abs(fit(t[inner], late[inner]) - expected).max() > 0.05 * np.abs(expected).max()


def ride(t):
    """Roll, pitch and yaw of a base, their rates and accelerations."""
    a, w = np.array([0.3, 0.2, 0.4]), np.array([2.0, 3.0, 1.5])
    return np.concatenate([a * np.sin(w * t), a * w * np.cos(w * t), -a * w**2 * np.sin(w * t)])


def test_a_base_that_turns_loads_the_joints_as_in_mujoco():
    """Against inverse dynamics of MuJoCo, where three more hinges turn the base."""
    inner = ARM.split("<worldbody>")[1].split("</worldbody>")[0]
    hinges = [
        f'<joint name="{n}" axis="{a}" damping="0" armature="0"/>'
        for n, a in (("yaw", "0 0 1"), ("pitch", "0 1 0"), ("roll", "1 0 0"))
    ]
    tiny = '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-8 1e-8 1e-8"/>'
    model = mujoco.MjModel.from_xml_string(
        ARM.replace(inner, f'<body name="trunk">{"".join(hinges)}{tiny}{inner}</body>')
    )
    model.dof_damping[:] = 0
    angles = {
        f"base_{k}": np.array([ride(t)[i] for t in T])
        for i, k in enumerate(("roll", "pitch", "yaw"))
    }
    spec = ModelSpec(base={"kind": "prescribed"})
    data = recording(pd(), angles, dict.fromkeys(angles, "rad"), model=spec)
    chain = chain_of(data)
    _, moved = prepared(Robot.from_mjcf("robot.xml", text=ARM), data)
    assert rides(moved) and len(chain.signature.inputs) == 2 + 9
    state = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for k in (60, 150):
        q, qd, qdd = rng.normal(size=(3, 2))
        own = ride(T[k])
        order = [2, 1, 0]  # MuJoCo's joints: yaw, pitch, roll
        state.qpos[:] = [*own[:3][order], *q]
        state.qvel[:] = [*own[3:6][order], *qd]
        state.qacc[:] = [*own[6:][order], *qdd]
        mujoco.mj_inverse(model, state)
        still = chain.mechanism.inverse(*(jnp.asarray(x) for x in (q, qd, qdd)))
        drive = chain.mechanism.drive(
            chain.signature,
            jnp.concatenate([jnp.zeros(2), jnp.asarray(own)]),
            *map(jnp.asarray, (q, qd)),
        )
        assert np.allclose(np.asarray(still - drive), state.qfrc_inverse[3:], atol=1e-5)
        derived = moved.experiments[0].u[k, 2:]
        assert (
            np.abs(derived - own).max() < 0.05
        )  # rates and accelerations by differences of what was recorded


def test_a_recorded_base_that_is_not_prescribed_is_said_to_be_unused():
    angles = {"base_roll": wave(1)}
    _, data = prepared(
        Robot.from_mjcf("robot.xml", text=ARM), recording(pd(), angles, {"base_roll": "rad"})
    )
    assert "base_roll recorded and not used" in data.notes[-1]


def test_a_joint_that_is_called_like_an_angle_of_the_base_is_that_joint():
    named = {
        old: old.replace("lift", "base_yaw") for old in ("lift", "turn", "lift_cmd", "turn_cmd")
    }
    robot = Robot.from_mjcf("robot.xml", text=ARM.replace('"lift"', '"base_yaw"'))
    prescribed = ModelSpec(base={"kind": "prescribed"})
    for spec in (None, prescribed):
        data = recording(pd(), model=spec)
        data = replace(data, channels=tuple(replace(c, name=named[c.name]) for c in data.channels))
        _, ready = prepared(robot, data)
        assert not ready.notes and [c.name for c in ready.outputs] == ["base_yaw", "turn"]
        assert resolve_model(robot, ready).signature.joints == ("base_yaw", "turn")
    tilted = recording(pd(), {"base_roll": wave(1)}, {"base_roll": "rad"}, model=prescribed)
    with pytest.raises(UsageError, match="'base_yaw'.*rename it"):
        prepared(robot, tilted)


def test_speeds_of_joints_are_outputs():
    data = recording(pd())
    e = data.experiments[0]
    speeds = {f"{j}_qd": np.gradient(e.y[:, k], T) for k, j in enumerate(JOINTS)}
    both = Dataset.from_arrays(
        T,
        {f"{j}_cmd": wave(k) for k, j in enumerate(JOINTS)},
        {"lift": wave(0.4), **speeds},
        units={
            "lift": "rad",
            "lift_cmd": "rad",
            "turn_cmd": "rad",
            **dict.fromkeys(speeds, "rad/s"),
        },
        controller=pd(),
        check_model=False,
    )
    signature = chain_of(both).signature
    assert [n for n, _ in signature.outputs] == [
        "lift",
        "lift_qd",
        "turn_qd",
    ] and signature.joints == JOINTS


@pytest.mark.parametrize(
    "verdicts, whole",
    [
        (("none", "none"), "none"),
        (("named", "none"), "named"),
        (("named", "unknown"), "partly"),
        (("partly", "none"), "partly"),
        (("unknown", "none"), "unknown"),
    ],
)
def test_limbs_that_were_diagnosed_one_by_one_are_one_answer(verdicts, whole):
    sample = sample_diagnosis(200)
    parts = [
        replace(
            sample,
            which=replace(
                sample.which,
                verdict=v,
                effects=sample.which.effects if v in ("named", "partly") else (),
            ),
        )
        for v in verdicts
    ]
    found = joined(parts, [("a1", "a2"), ("b1",)], recording(pd()))
    assert found.which.verdict == whole
    assert len(found.which.effects) == sum(len(p.which.effects) for p in parts)
    assert np.isclose(found.how_far.gap_before, sample.how_far.gap_before)
    assert (found.how_far.shrinkage is None) == (whole in ("none", "unknown"))
    assert "a1 and a2: " in found.which.text and "limbs" in found.notes[-1]
    assert found.to_dict()["which"]["verdict"] == whole


def test_limbs_that_are_finished_are_kept_when_the_others_are_stopped():
    model = Robot.from_mjcf("arm.xml", text=ARM)
    limbs = [
        (model, recording(pd(), name=name)) for name in ("finished", "half", "endless", "never")
    ]
    sample = sample_diagnosis(200)
    told = []

    def work(_, data, tell):
        if data.name == "half":
            raise Interrupted(sample)
        while data.name == "endless":
            tell("simulated", 0, 1, "")
        return sample

    with pytest.raises(Interrupted) as stopped:
        diagnose_each(limbs, work, limbs[0][1], lambda *words: told.append(words))
    assert (
        2 <= stopped.value.partial.which.text.count("lift and turn: ") <= 3
    )  # the last one may have been begun or not
    assert all(words == ("limb 3 of 4 (lift, turn): simulated", 0, 1, "") for words in told)


def test_a_robots_file_is_a_model_for_designs_and_lists(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(ARM.replace('name="lift"', 'name="lift" range="-60 60"'))
    mechanism, table = mechanism_of(str(path))
    bounds = bounds_of(mechanism.name, mechanism.signatures[0], None, table)
    assert (
        mechanism.name == "robot"
        and np.isclose(bounds.upper[0], 0.9 * np.pi / 3)
        and bounds.upper[1] > 1.0
    )
    spec: Any = spec_of_file(str(path))
    assert spec.name == "robot" and "<mujoco" in spec.geometry.robot
    assert np.isfinite(
        [p["value"] for p in own_numbers(Chain(mechanism))["parameters"].values()]
    ).all()


def test_numbers_of_another_model_are_not_those_of_a_robot():
    spec = ModelSpec("serial_arm", constants={"gravity": 9.8, "armature@turn": 0.3})
    chain, data = (
        chain_of(recording(pd(), model=spec)),
        prepared(Robot.from_mjcf("robot.xml", text=ARM), recording(model=spec))[1],
    )
    assert "gravity of serial_arm" in data.notes[-1]
    assert chain.mechanism.name == "robot"
    b = bind(Robot.from_mjcf("robot.xml", text=ARM), recording(pd(), model=spec))
    assert b.theta[b.layout.index("armature@turn")] == 0.3


GRIPPER = f"""<mujoco><compiler angle="radian"/><worldbody><body name="l1"><joint name="lift" axis="0 1 0" damping="0.3"/>{LINK}
<body name="a" pos="0.2 0.02 0"><joint name="left" type="slide" axis="0 1 0" damping="2"/>{LINK}</body>
<body name="b" pos="0.2 -0.02 0"><joint name="right" type="slide" axis="0 -1 0" damping="2"/>{LINK}</body></body></worldbody>
<equality><joint joint1="left" joint2="right" polycoef="0.01 -2 0 0 0"/></equality>
<actuator><position joint="lift" kp="8"/><position joint="left" kp="40" kv="4" forcerange="-6 6" ctrlrange="0 0.04"/></actuator>
</mujoco>"""


def gripper(joints, goals, text=GRIPPER, roles=()):
    """(chain, dataset, notes) of an arm of which some joints and some goals are recorded; `roles`
    names auxiliary joints.
    """
    goal = {f"{j}_cmd": 0.02 + 0.01 * wave(k) for k, j in enumerate(goals)}
    shown = {j: 0.02 + 0.01 * wave(k) for k, j in enumerate(joints)}
    units = {n: "rad" if n.startswith("lift") else "m" for n in (*goal, *shown, *roles)}
    beside = {j: np.full(len(T), 0.03) for j in roles}
    data = Dataset.from_arrays(T, goal, shown, auxiliary=beside, units=units, check_model=False)
    robot, data = prepared(Robot.from_mjcf("robot.xml", text=text), data)
    chain: Any = resolve_model(robot, data)
    return chain, data, (*data.notes, *notes_of(robot, data))


def test_a_recorded_follower_leads_with_its_own_goal():
    chain, _, notes = gripper(("lift", "left"), ("lift", "left"))
    assert chain.signature.joints == ("lift", "left") and chain.mechanism.drive_law.kp == (
        8.0,
        40.0,
    )
    assert any("right = 0.005 + -0.5 left" in note for note in notes)
    S, c = chain.mechanism.tree.tree.follow()
    assert S[:, 1].tolist() == [0.0, 1.0, -0.5] and c.tolist() == [0.0, 0.0, 0.005]


def test_goals_of_a_follower_are_told_to_the_joint_that_is_recorded():
    """The file drives `left`; only `right`, which leads in the file, is recorded: the same force by
    virtual work.
    """
    chain, data, notes = gripper(("lift", "right"), ("lift", "left"))
    law = chain.mechanism.drive_law
    assert (law.kp[1], law.kd[1], law.lowest[1], law.highest[1]) == (160.0, 16.0, -12.0, 12.0)
    np.testing.assert_allclose(law.control[1], (-0.015, 0.005))
    np.testing.assert_allclose(data.experiments[0].u[:, 1], (0.02 + 0.01 * wave(1) - 0.01) / -2)
    assert any("the goal of left is taken as that of right" in note for note in notes)


def test_fingers_that_nobody_recorded_are_held_whatever_ties_them():
    tendon = '<tendon><fixed name="grip"><joint joint="left" coef="0.5"/><joint joint="right" coef="0.5"/></fixed></tendon>'
    loop = '<connect name="bar" body1="a" body2="b" anchor="0 0 0"/></equality>'
    tied = (GRIPPER.replace("</equality>", loop) + tendon).replace("</mujoco>", "") + "</mujoco>"
    tied = tied.replace('<position joint="left"', '<position tendon="grip"')
    chain, _, notes = gripper(("lift",), ("lift",), text=tied)
    assert chain.signature.joints == ("lift",)
    assert any(
        "tendon 'grip', of left, right" in note and "equality 'bar'" in note for note in notes
    )
    chain, _, _ = gripper(("lift",), ("lift",), text=tied, roles=("right",))
    assert chain.mechanism.tree.tree.held == {"right": 0.03, "left": pytest.approx(-0.05)}
    with pytest.raises(
        UsageError, match="tendon 'grip', acts on left, right, and right is recorded.*auxiliary"
    ):
        gripper(("lift", "right"), ("lift", "right"), text=tied)


def test_units_of_channels_are_checked():
    metres = Dataset.from_arrays(
        T,
        {f"{j}_cmd": wave(k) for k, j in enumerate(JOINTS)},
        {j: wave(k) for k, j in enumerate(JOINTS)},
        units={"lift": "m", "turn": "rad", "lift_cmd": "rad", "turn_cmd": "rad"},
        controller=pd(),
        check_model=False,
    )
    with pytest.raises(UsageError, match="'lift' is in m; robot.xml has it in rad"):
        chain_of(metres)


def test_torques_tell_nothing_of_the_gains_that_make_them():
    b = bind(Robot.from_mjcf("robot.xml", text=ARM), recording(pd(fit=["kp", "delay"])))
    with pytest.raises(UsageError, match="kp@lift, kp@turn make the torque"):
        ProblemBuilder(b).problem(InverseDynamics(), "fit", b.free, b.theta)


def test_names_are_matched_as_drivers_write_them_and_a_gripper_is_left_out():
    def mapped(**joints):
        names = [f"q{k + 1}" for k in range(len(joints))]
        return Dataset.from_arrays(
            T,
            {f"{n}_cmd": wave(k) for k, n in enumerate(names)},
            {n: wave(k + 0.3) for k, n in enumerate(names)},
            controller=pd(),
            check_model=False,
            model=ModelSpec(joints=dict(zip(names, joints.values(), strict=True))),
        )

    robot = Robot.from_mjcf("robot.xml", text=ARM)
    _, data = prepared(robot, mapped(a="gripper", b="arm/Turn_joint", c="lift.pos"))
    assert [c.name for c in data.outputs] == ["turn", "lift"] and [c.name for c in data.inputs] == [
        "turn_cmd",
        "lift_cmd",
    ]
    assert (
        np.allclose(data.experiments[0].y[:, 0], wave(1.3))
        and "left out" in data.notes[-1]
        and "gripper" in data.notes[-1]
    )
    assert prepared(robot, data)[1].notes == data.notes
    with pytest.raises(UsageError, match="'gripper', no joint of"):
        prepared(robot, mapped(a="gripper", b="turn"))


def test_readings_that_count_in_no_loss_keep_their_place():
    data = recording(pd())
    e = data.experiments[0]
    unread = np.zeros(e.y.shape, bool)
    unread[7, 1] = True
    marked = replace(data, experiments=(replace(e, left_out=unread),))
    cut = without_channels(marked, ["lift", "lift_cmd"])
    kept: Any = cut.experiments[0].left_out
    assert kept.shape == cut.experiments[0].y.shape and kept[7, 0]


def test_forces_that_a_model_lacks_become_its_free_run():
    h, m, d, k = 0.005, 0.05, 0.4, 20.0
    t = np.arange(600) * h

    def every(x):
        return np.full((len(t), 1, 1), x)

    force = np.sin(3 * t)[:, None, None] * np.array([1.0, -2.0])
    moves = np.ones((len(t), 1))
    x = loop_of(h, every(m), every(d), np.zeros((len(t), 1)), every(k), moves).free_run(force)
    settled = (k - 9 * m + 3j * d) ** -1  # of a spring, a mass and a damper
    exact = (settled * np.exp(3j * t)).imag
    assert np.abs(x[300:, 0, 0] - exact[300:]).max() < 2e-3 * abs(settled)
    assert np.allclose(x[..., 1], -2 * x[..., 0])
    held = loop_of(
        h, every(m), every(d), np.where(t < 1.5, 0.0, 1e6)[:, None], every(k), moves
    ).free_run(force)[:, 0, 0]
    assert np.ptp(held[301:]) < 1e-3 * np.ptp(
        held[:300]
    )  # dry friction that sticks keeps what there is


def test_a_goal_that_is_held_counts_from_both_sides_of_its_jump():
    u = np.array([[0.0, 0.0], [2.0, 2.0], [2.0, 4.0]])
    assert np.array_equal(
        mean_input(u, np.array([False, True])), [[0.0, 0.0], [1.0, 2.0], [2.0, 4.0]]
    )


def test_a_step_under_goals_is_one_evaluation_of_second_order():
    """A law's torque is that of the middle of a step: four evaluations of the rest made it no
    better.
    """
    own = recording(pd(), model=ModelSpec(simulator="own"))
    b = bind(*prepared(Robot.from_mjcf("robot.xml", text=ARM), own))

    def simulated(step):
        p = ProblemBuilder(b, step).problem(OutputError(), "fit", [], b.theta)
        return p.predictions(p.z(b.theta))[0]

    coarse, half, fine = (simulated(step) for step in (0.01, 0.005, 0.00125))
    apart, less = np.abs(coarse - fine).max(), np.abs(half - fine).max()
    assert 3.5 < apart / less < 5 and less < 1e-4
    body: Any = b.chain.body()
    x = jnp.zeros(2), jnp.ones(2)

    def program(body):
        return str(jax.make_jaxpr(lambda x: body.damped(0.01, x, x[0], x[1], x[0], x[0])[1])(x))

    assert "length=4" not in program(body) and "length=4" in program(
        Robot(body.tree.tree, driven=False)
    )


@pytest.mark.parametrize("armature", [1e-3, 1e-7])
def test_a_joint_that_is_too_light_for_its_law_follows_its_goal(armature):
    """The law would swing it by 1 and by 100 rad in a step, and the second ran away."""
    text = f"""<mujoco><worldbody><body name="l"><joint name="turn" axis="0 0 1" damping="0.4" armature="{armature}"/>
<inertial pos="0 0 0.05" mass="0.1" diaginertia="2e-7 2e-7 2e-7"/></body></worldbody></mujoco>"""
    goal = np.where(T < 1.0, 0.0, 0.2)
    data = Dataset.from_arrays(
        T,
        {"turn_cmd": goal},
        {"turn": goal},
        units={"turn": "rad", "turn_cmd": "rad"},
        controller=pd(kd=0.0),
        check_model=False,
    )
    b = bind(*prepared(Robot.from_mjcf("robot.xml", text=text), data))
    p = ProblemBuilder(b, 0.01).problem(OutputError(), "fit", [], b.theta)
    (q,) = p.predictions(p.z(b.theta))
    assert np.abs(q).max() < 0.22 and abs(q[-1, 0] - 0.2) < 1e-3
