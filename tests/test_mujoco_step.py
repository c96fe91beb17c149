"""A robot's step as its file asks MuJoCo for, against MuJoCo."""

import importlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Command
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.dynamics.soft_constraints import constrained, Constraints
from jaxid.models import Robot
from jaxid.numerics.precision import float64
from jaxid.numerics.reverse import in_reverse
from simulated import quick_jit
from written_robots import _body, gantry, shoulder


mujoco: Any = importlib.import_module("mujoco")  # its names are made when it loads

#: MuJoCo's own solver is asked for all digits.
SOLVED = 'tolerance="1e-14" iterations="200" ls_iterations="200" ls_tolerance="1e-12"'
#: What the joints and drives of an arm may have besides friction and damping.
SOFT = 'solreffriction="0.01 0.8" solimpfriction="0.95 0.99 0.001"'
DIRECT = 'solreffriction="-100 -20" solreflimit="-3000 -40" margin="0.02"'
STOPS = 'limited="true" range="-0.25 0.3" solimplimit="0.5 0.95 0.05 0.4 3"'


def arm(
    n: int,
    integrator: str,
    step: float,
    joint: str = "",
    drive: str = "",
    flag: str = "",
    friction: float = 0.2,
) -> str:
    """An arm of n hinges that position actuators drive."""
    rng = np.random.default_rng(1)
    text, drives = "", ""
    for k in reversed(range(n)):
        axis = " ".join(f"{v:.3f}" for v in rng.normal(size=3))
        own = f'armature="{rng.uniform(0.01, 0.05):.4f}" stiffness="{rng.uniform(0, 2):.2f}"'
        own += f' damping="0.5 0.2 0.3" frictionloss="{friction}" springref="0.1"'
        text = _body(rng, f"b{k}", f'<joint name="j{k}" axis="{axis}" {own} {joint}/>', text)
        drives = f'<position joint="j{k}" kp="60" kv="2" {drive}/>{drives}'
    return (
        '<mujoco><compiler angle="radian"/>'
        f'<option timestep="{step}" integrator="{integrator}" {SOLVED}>'
        f'<flag contact="disable" {flag}/></option>'
        f"<worldbody>{text}</worldbody><actuator>{drives}</actuator></mujoco>"
    )


def goals(n: int, samples: int, step: float) -> np.ndarray:
    """Goals [samples n] that swing each joint by itself."""
    rng = np.random.default_rng(0)
    frequency, phase = rng.uniform(0.5, 3, n), rng.uniform(0, 6, n)
    t = np.arange(samples)[:, None] * step
    return 0.6 * np.sin(2 * np.pi * frequency * t + phase)


def in_mujoco(text: str, u: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Positions [samples n] from rest at q; u are goals, or torques where there is no actuator."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:] = q
    out = []
    for row in u:
        out.append(data.qpos.copy())
        (data.ctrl if model.nu else data.qfrc_applied)[:] = row
        mujoco.mj_step(model, data)
    return np.array(out)


def stepped(chain: Chain, step: float, u: Any, q: Any) -> Any:
    """The same by jaxid."""
    body = chain.body().prepare(jnp.asarray(step))
    start = chain.start(q, jnp.zeros_like(q), u[0], body)

    def one(carry, row):
        command = Command(jnp.zeros(()), jnp.asarray(step), row, row, lambda late: row)
        return chain.step(body, carry, command)

    return jax.lax.scan(one, start, u)[1]


def both(text: str, step: float, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Runs by MuJoCo and by jaxid."""
    robot = Robot.from_mjcf("robot.xml", text=text).stepped("mujoco")
    n = len(robot.signatures[0].joints)
    u, q = goals(n, samples, step), np.full(n, 0.1)
    with float64():
        own = np.asarray(quick_jit(lambda u, q: stepped(Chain(robot), step, u, q))(u, q))
    return in_mujoco(text, u, q), own


@pytest.mark.parametrize(
    ("n", "integrator", "step", "more"),
    [
        (1, "RK4", 0.002, {"joint": SOFT}),
        (1, "Euler", 0.005, {"joint": f"{DIRECT} {STOPS}"}),
        (3, "Euler", 0.002, {"joint": STOPS, "flag": 'eulerdamp="disable"'}),
        (2, "implicit", 0.005, {"drive": 'ctrlrange="-0.3 0.4"'}),
        (6, "implicitfast", 0.002, {"joint": SOFT, "drive": 'forcerange="-4 5"'}),
        (3, "RK4", 0.005, {"joint": STOPS}),
        (12, "Euler", 0.002, {"joint": 'actuatorfrcrange="-6 6"'}),
    ],
)
def test_a_step_is_mujocos(n, integrator, step, more):
    theirs, own = both(arm(n, integrator, step, **more), step, round(1 / step))
    assert np.abs(theirs).max() > 0.2
    assert np.abs(own - theirs).max() < 1e-10


@pytest.mark.parametrize("made", [gantry, shoulder])
def test_slides_and_several_joints_of_a_body_move_as_in_mujoco(made):
    step = 0.002
    option = f'<option timestep="{step}" integrator="implicitfast" {SOLVED} '
    text = made().replace("<option ", option).replace('armature="', 'frictionloss="0.4" armature="')
    theirs, own = both(text, step, 250)
    assert np.ptp(theirs) > 0.1
    assert np.abs(own - theirs).max() < 1e-9


def test_friction_creeps_and_holds_as_in_mujoco():
    """Under its own weight a joint that friction could hold slides on slowly."""
    text = arm(1, "implicitfast", 0.002, friction=20.0).replace('kp="60" kv="2"', 'kp="1" kv="0"')
    theirs, own = both(text, 0.002, 500)
    crept = abs(theirs[-1, 0] - theirs[0, 0])
    assert 1e-7 < crept < 1e-2
    assert np.abs(own - theirs).max() < 1e-6 * crept


@pytest.mark.parametrize(
    "integrator", ["implicitfast", pytest.param("RK4", marks=pytest.mark.slow)]
)
def test_a_run_is_differentiated_as_it_is(integrator):
    step = 0.005
    robot = Robot.from_mjcf("arm.xml", text=arm(2, integrator, step, STOPS)).stepped("mujoco")
    layout = ParameterVector(Chain(robot))
    u, q = goals(2, 60, step), np.full(2, 0.1)
    names = ("frictionloss@j0", "damping@j1", "armature@j0", "mass@b1", "kp@j1")
    at = [layout.index(name) for name in names]

    def end(theta):
        return jnp.sum(stepped(layout.model(theta), step, u, q)[-1])

    with float64():
        theta = jnp.asarray(layout.values)
        with in_reverse():
            backwards = np.asarray(quick_jit(jax.grad(end))(theta))[at]
        along = quick_jit(lambda theta, x: jax.jvp(end, (theta,), (x,)))
        still, forwards = jnp.zeros_like(theta), []
        for i in at:
            size = 1e-5 * max(1e-2, abs(float(theta[i])))
            moved = [float(along(theta.at[i].add(side * size), still)[0]) for side in (-1, 1)]
            forwards.append((moved[1] - moved[0]) / (2 * size))
        tangents = [float(along(theta, still.at[i].set(1.0))[1]) for i in at]
    assert np.all(backwards != 0)
    np.testing.assert_allclose(backwards, forwards, rtol=1e-4)
    np.testing.assert_allclose(backwards, tangents, rtol=1e-9)


def test_a_joint_at_rest_has_finite_derivatives():
    text = arm(2, "Euler", 0.002, friction=5.0).replace("<option ", '<option gravity="0 0 0" ')
    robot = Robot.from_mjcf("arm.xml", text=text).stepped("mujoco")
    layout, still = ParameterVector(Chain(robot)), np.full(2, 0.1)

    def end(theta):
        return jnp.sum(stepped(layout.model(theta), 0.002, jnp.tile(still, (20, 1)), still)[-1])

    with float64(), in_reverse():
        gradient = np.asarray(quick_jit(jax.grad(end))(jnp.asarray(layout.values)))
    assert np.all(np.isfinite(gradient))


def test_soft_constraints_are_solved_to_rounding():
    """What is found balances: M a = force - friction + stops."""
    rng = np.random.default_rng(3)
    count, n = 300, 7
    B = rng.normal(size=(count, n, n))
    M = B @ B.swapaxes(1, 2) + 0.05 * np.eye(n)
    compliance: Any = 10 ** rng.uniform(-5, 1, (2, count, n))
    rows: Any = Constraints(
        target=rng.normal(size=(count, n)),
        compliance=compliance[0],
        minus=rng.uniform(0, 2, (count, n)) * rng.integers(0, 2, (count, n)),
        plus=rng.uniform(0, 2, (count, n)),
        side=rng.integers(-1, 2, (count, n)).astype(float),
        stop_target=rng.normal(size=(count, n)),
        stop_compliance=compliance[1],
    )
    force, guess = 3 * rng.normal(size=(2, count, n))
    with float64():
        found = quick_jit(jax.vmap(constrained))(M, force, rows, guess)
        a, opposed = (np.asarray(x) for x in found)
    pushed = np.maximum(rows.stop_target - rows.side * a, 0) / rows.stop_compliance
    left = np.einsum("kij,kj->ki", M, a) - force + opposed - rows.side * pushed
    size = np.abs(M).max() * np.abs(a).max(1, keepdims=True) + np.abs(pushed)
    assert np.abs(left / size).max() < 1e-10


def test_other_numbers_of_friction_and_stops_take_the_same_program():
    texts = [arm(2, "Euler", 0.002), arm(2, "Euler", 0.001, f"{SOFT} {STOPS}")]
    robots = [Robot.from_mjcf("arm.xml", text=text).stepped("mujoco") for text in texts]
    first, second = (ParameterVector(Chain(robot)).form for robot in robots)
    assert first == second
    other = Robot.from_mjcf("arm.xml", text=texts[0])
    assert first != ParameterVector(Chain(other)).form


def test_what_a_file_disables_is_left_to_the_own_step():
    for flag in ('frictionloss="disable"', 'constraint="disable"', 'damper="disable"'):
        robot = Robot.from_mjcf("arm.xml", text=arm(1, "Euler", 0.002, flag=flag))
        assert robot.tree.tree.simulator is None
        assert robot.stepped("mujoco").integrator == ""
