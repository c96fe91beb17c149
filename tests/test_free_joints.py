"""Joints of a file that nothing drives, beside others that goals drive."""

import importlib
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.dynamics import catalogue
from jaxid.models import Robot
from jaxid.problem.binding import bind


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads

STEP, EVERY = 0.002, 5
#: A cart that a drive moves, and a pole that hangs on it.
CART = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body name="cart" pos="0 0 .5">
    <joint name="along" type="slide" axis="1 0 0" damping="2" frictionloss="{friction}"/>
    <geom type="box" size=".1 .05 .05" mass="1"/>
  <body name="pole"><joint name="swing" axis="0 1 0" damping=".01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass=".3"/></body></body></worldbody>
  <actuator><position joint="along" kp="200" kv="20"/></actuator></mujoco>"""


def recorded(friction: float, seed: int = 1, seconds: float = 8.0) -> jaxid.Dataset:
    """Three runs of the cart in MuJoCo, with 0.1 mm and 0.1 mrad of noise."""
    model = mujoco.MjModel.from_xml_string(CART.format(friction=friction))
    noise = np.random.default_rng(seed)
    steps = np.arange(int(seconds / STEP))
    times, goals, along, swing = [], [], [], []
    for run in range(3):
        data = mujoco.MjData(model)
        t = (steps - steps % EVERY) * STEP
        u = 0.15 * np.sin(2 * np.pi * (0.4 + 0.1 * run) * t)
        u += 0.08 * np.sin(2 * np.pi * (1.1 + 0.2 * run) * t + run)
        u *= np.minimum(t, 1.0)
        q = np.empty((len(steps), 2))
        for k, goal in enumerate(u):
            q[k], data.ctrl[0] = data.qpos, goal
            mujoco.mj_step(model, data)
        q = q[::EVERY] + 1e-4 * noise.standard_normal((len(steps) // EVERY, 2))
        times.append(t[::EVERY])
        goals.append(u[::EVERY])
        along.append(q[:, 0])
        swing.append(q[:, 1])
    return jaxid.Dataset.from_arrays(
        times,
        {"along_cmd": goals},
        {"along": along, "swing": swing},
        units={"along": "m", "along_cmd": "m", "swing": "rad"},
        split=["fit", "validation", "report"],
        check_model=False,
    )


def robot() -> Robot:
    return Robot.from_mjcf("cart.xml", text=CART.format(friction=0))


def test_a_joint_without_an_actuator_moves_freely():
    binding = bind(robot(), recorded(0.0, seconds=2.0))
    names = list(binding.layout.names)
    assert binding.theta[names.index("kp@along")] == 200
    assert binding.theta[names.index("kp@swing")] == 0
    assert names.index("kp@swing") not in binding.free
    assert any("swing" in note and "moves freely" in note for note in binding.dataset.notes)


@pytest.mark.parametrize(
    ("effect", "places"),
    [
        ("input_delay", ("along_cmd",)),
        ("torque_scale", ("along_tau",)),
        ("coulomb_friction", ("along", "swing")),
    ],
)
def test_nothing_on_the_way_of_a_command_is_asked_where_nothing_is_driven(effect, places):
    chain = bind(robot(), recorded(0.0, seconds=2.0)).chain
    assert chain.offers(catalogue.effect_class(effect, chain.mechanism)) == places


def test_a_joint_that_the_file_drives_needs_its_goal():
    text = CART.format(friction=0).replace(
        "</actuator>", '<position joint="swing" kp="1"/></actuator>'
    )
    with pytest.raises(jaxid.UsageError, match="no goal is recorded of swing"):
        bind(Robot.from_mjcf("cart.xml", text=text), recorded(0.0, seconds=2.0))


@pytest.mark.slow
def test_friction_of_a_cart_is_named_beside_a_pole_that_swings_freely():
    found = jaxid.diagnose(robot(), recorded(3.0))
    assert found.which.verdict == "named"
    (effect,) = found.which.effects
    assert (effect.effect, effect.location) == ("coulomb_friction", "along")
    assert effect.parameters["level"].value == pytest.approx(3.0, abs=0.02)
    assert found.how_far.gap_after < 1.1
