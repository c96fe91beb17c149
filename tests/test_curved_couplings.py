"""Joints that a file couples by a polynomial of degree above 1."""

import importlib
from typing import Any

import jax
import numpy as np
import pytest

from jaxid import Dataset
from jaxid.models import Robot
from jaxid.numerics.precision import float64
from jaxid.problem.binding import resolve_model
from jaxid.robots.curves import Curve, Polynomial
from jaxid.robots.match import notes_of, prepared
from jaxid.robots.mjcf import read_mjcf


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads

LINK = '<inertial pos="0.05 0 0.02" mass="0.4" diaginertia="8e-4 9e-4 7e-4"/>'
POLYNOMIAL = (0.01, 0.8, -1.5, 4.0, 0.0)
#: `left` follows `right`, and `tip` follows `left`.
HAND = f"""<mujoco><compiler angle="radian"/><option timestep="0.001"/><worldbody>
<body name="l1"><joint name="lift" axis="0 1 0" damping="0.3"/>{LINK}
<body name="a"><joint name="left" axis="0 1 0" damping="0.2" armature="0.003"/>{LINK}
<body name="c"><joint name="tip" axis="1 0 0" damping="0.1" stiffness="0.4"/>{LINK}</body></body>
<body name="b"><joint name="right" axis="0 -1 0" damping="0.3" range="-0.4 0.5"/>{LINK}</body></body>
</worldbody><equality>
<joint joint1="left" joint2="right" polycoef="{" ".join(map(str, POLYNOMIAL))}"/>
<joint joint1="tip" joint2="left" polycoef="0 -2 0 0 0"/>
</equality><actuator><position joint="lift" kp="8"/><position joint="DRIVEN" kp="4" kv="0.2"/>
</actuator></mujoco>"""


def hand(driven: str = "right") -> Robot:
    return Robot.from_mjcf("hand.xml", text=HAND.replace("DRIVEN", driven))


def course(t: np.ndarray) -> np.ndarray:
    """Positions of `right` [time]."""
    return 0.05 + 0.3 * np.sin(3 * t)


def followed(right: Any) -> Any:
    """Positions of `left`."""
    return np.polynomial.Polynomial(POLYNOMIAL)(right)


def recording(fingers: dict[str, np.ndarray], t: np.ndarray) -> Dataset:
    """`lift` and what of a finger was recorded."""
    channels = {"lift": 0.2 * np.cos(2 * t), "lift_cmd": 0.2 * np.cos(2 * t)} | fingers
    inputs = {k: v for k, v in channels.items() if k.endswith("_cmd")}
    outputs = {k: v for k, v in channels.items() if k not in inputs}
    units = dict.fromkeys(channels, "rad")
    noise = dict.fromkeys(outputs, 1e-3)
    return Dataset.from_arrays(t, inputs, outputs, units=units, noise_std=noise, check_model=False)


def test_a_curve_has_its_slope_and_turns_back():
    curve = Curve((Polynomial(POLYNOMIAL, -0.4, 0.5), Polynomial((0.1, -2.0))), 0.05)
    x = np.linspace(-0.4, 0.5, 41)
    value, slope, bend = curve.at(x)
    np.testing.assert_allclose(value, 0.1 - 2 * followed(x))
    h = 1e-5
    (before, _, _), (after, _, _) = curve.at(x - h), curve.at(x + h)
    np.testing.assert_allclose(slope, (after - before) / (2 * h), rtol=1e-7)
    np.testing.assert_allclose(bend, (after - 2 * value + before) / h**2, atol=1e-4)
    back = curve.turned()
    again, inverse, bent = back.at(value)
    np.testing.assert_allclose(again, x, atol=1e-12)
    np.testing.assert_allclose(inverse, 1 / slope)
    np.testing.assert_allclose(bent, -bend / slope**3)
    with float64():
        told = jax.vmap(jax.grad(lambda y: back.at(y)[0]))(value)
    np.testing.assert_allclose(told, 1 / slope, rtol=1e-6)


def test_a_curve_that_goes_back_cannot_be_turned_about():
    assert Polynomial((0.0, 0.8, -1.5, 4.0), -0.4, 0.5).turns
    assert not Polynomial((0.0, 0.0, 1.0), -0.4, 0.5).turns
    assert not Polynomial((0.0, 0.8, -1.5, 4.0)).turns  # nobody knows how far it goes


def test_followers_of_followers_go_along_the_curve():
    tree = read_mjcf("hand.xml", HAND.replace("DRIVEN", "right"))
    assert tree.leading == ("lift", "right") and not tree.ties
    by_name = {c.follower: c for c in tree.couplings}
    x = np.linspace(-0.4, 0.5, 11)
    np.testing.assert_allclose(by_name["left"].at(x), followed(x))
    np.testing.assert_allclose(by_name["tip"].at(x), -2 * followed(x))
    held = tree.locked({"right": 0.3}).held
    assert held["left"] == pytest.approx(followed(0.3))


def test_forces_are_those_of_mujoco():
    """Along the same motion of all joints, by virtual work at those that lead."""
    model = mujoco.MjModel.from_xml_string(HAND.replace("DRIVEN", "right"))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    model.dof_damping[:] = 0.0
    data = mujoco.MjData(model)
    p = np.polynomial.Polynomial(POLYNOMIAL)
    robot, rng = hand(), np.random.default_rng(3)

    @jax.jit
    def both_ways(q, qd, qdd):
        M, bias = robot.matrices(q, qd)
        return robot.inverse(q, qd, qdd), M @ qdd + bias

    for _ in range(10):
        (lift, right), (lift_v, right_v), (lift_a, right_a) = rng.uniform(-0.35, 0.45, (3, 2)) * [
            [1.0], [5.0], [20.0]
        ]  # fmt: skip
        slope, bend = p.deriv()(right), p.deriv(2)(right)
        left_v, left_a = slope * right_v, slope * right_a + bend * right_v**2
        data.qpos[:] = lift, p(right), -2 * p(right), right
        data.qvel[:] = lift_v, left_v, -2 * left_v, right_v
        data.qacc[:] = lift_a, left_a, -2 * left_a, right_a
        mujoco.mj_inverse(model, data)
        force = data.qfrc_inverse
        theirs = np.array([force[0], force[3] + slope * (force[1] - 2 * force[2])])
        with float64():
            q, qd, qdd = np.array([[lift, right], [lift_v, right_v], [lift_a, right_a]])
            ours, forward = (np.asarray(force) for force in both_ways(q, qd, qdd))
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(forward, theirs, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("recorded", ["right", "left"])
@pytest.mark.parametrize("driven", ["right", "left"])
def test_whichever_finger_is_recorded_and_driven(recorded, driven):
    """The driven one leads, under the file's own law; what was recorded goes over to it."""
    t = np.arange(300) * 0.01
    positions = {"right": course(t), "left": followed(course(t))}
    fingers = {recorded: positions[recorded], f"{driven}_cmd": positions[driven]}
    robot, data = prepared(hand(driven), recording(fingers, t))
    chain: Any = resolve_model(robot, data)
    assert chain.signature.joints[-1] == driven
    column = [c.name for c in data.outputs].index(driven)
    np.testing.assert_allclose(data.experiments[0].y[:, column], positions[driven], atol=1e-9)
    assert chain.mechanism.drive_law.kp[-1] == 4.0
    said = " ".join((*data.notes, *notes_of(robot, data)))
    assert ("taken as that of" in said) == (recorded != driven)
    assert "coupled by a curve" in said
