"""Robots on a base that floats, against MuJoCo with a free joint."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxid
from floating_twin import ANGLES, JOINTS, motion, mujoco, placed, recording, text, torques
from jaxid.data.dataset import ModelSpec
from jaxid.data.io import save_dataset
from jaxid.models import Robot
from jaxid.numerics.precision import float64
from jaxid.problem.binding import resolve_model
from jaxid.problem.momentum import momentum
from jaxid.robots import dynamics
from jaxid.robots.floating import floating
from simulated import quick_jit


T = np.arange(201) * 0.01
START = (
    np.array([0.2, -0.3, 0.5]),
    np.array([0.1, 0.4, 0.0, 0.05]),
    np.array([0.3, -0.2, 0.5]),
    np.array([0.1, -0.2, 3.0, 0.0]),
)

URDF = """<robot name="craft">
<link name="craft"><inertial><origin xyz="0.05 -0.02 0.03"/><mass value="7"/>
<inertia ixx="0.4" iyy="0.5" izz="0.3" ixy="0.02" ixz="-0.03" iyz="0.01"/></inertial></link>
<link name="tank"><inertial><origin xyz="0 0.1 0"/><mass value="2"/>
<inertia ixx="0.04" iyy="0.03" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="arm"><inertial><origin xyz="0.2 0 0.01"/><mass value="1.5"/>
<inertia ixx="0.02" iyy="0.03" izz="0.025" ixy="0.001" ixz="0.002" iyz="-0.001"/></inertial></link>
<joint name="weld" type="fixed"><parent link="craft"/><child link="tank"/><origin xyz="-0.2 0 0.1" rpy="0.1 0.2 0.3"/></joint>
<joint name="j1" type="revolute"><parent link="craft"/><child link="arm"/><origin xyz="0.3 0.1 0.2" rpy="0.3 -0.2 0.1"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="10" velocity="5"/></joint></robot>"""


def craft(gravity: float = 0.0) -> Robot:
    return Robot.from_mjcf("craft.xml", text=text(gravity), free=True)


def spin_of(
    angles: np.ndarray, rates: np.ndarray, accelerations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Angular velocity and acceleration of the base in its own frame."""
    pair = jax.jvp(
        dynamics.angular_velocity,
        (jnp.array(angles), jnp.array(rates)),
        (jnp.array(rates), jnp.array(accelerations)),
    )
    return np.asarray(pair[0]), np.asarray(pair[1])


def rates_of(angles: np.ndarray, spin: np.ndarray) -> np.ndarray:
    """Rates of roll, pitch, yaw at an angular velocity."""
    with float64():
        A = np.stack(
            [
                np.asarray(dynamics.angular_velocity(jnp.array(angles), jnp.array(e)))
                for e in np.eye(3)
            ],
            1,
        )
    return np.linalg.solve(A, spin)


def compared(robot: Robot, model, n: int) -> float:
    """Largest difference of the accelerations at random states, spinning and drifting."""
    data, rng, worst = mujoco.MjData(model), np.random.default_rng(0), 0.0
    with float64():
        solve = quick_jit(
            lambda q, v, tau: robot.vector_field(
                0.0, (q, v), robot.drive(robot.signatures[0], tau, q, v)
            )[1]
        )
        for _ in range(8):
            q, qd = rng.uniform(-1.2, 1.2, n + 3), rng.normal(size=n + 3)
            tau = rng.normal(size=n)
            a = np.asarray(solve(q, qd, tau))
            spin, change = spin_of(q[n:], qd[n:], a[n:])
            placed(data, q[n:], q[:n], spin, qd[:n])
            data.qfrc_applied[6:] = tau
            mujoco.mj_forward(model, data)
            size = max(1.0, float(np.abs(data.qacc).max()))
            worst = max(
                worst,
                float(
                    np.abs(np.concatenate([data.qacc[6:] - a[:n], data.qacc[3:6] - change])).max()
                    / size
                ),
            )
    return worst


@pytest.mark.parametrize("gravity", [0.0, -9.81])
def test_it_moves_as_in_mujoco(gravity):
    """Random states with linear and angular momentum, a wheel and a slide among the joints; a
    uniform gravity shows nowhere.
    """
    robot = craft(gravity)
    assert robot.signatures[0].joints == (*JOINTS, *ANGLES) and len(robot.signatures[0].inputs) == 4
    assert compared(robot, mujoco.MjModel.from_xml_string(text(gravity)), 4) < 1e-11


def test_a_urdf_with_bodies_fixed_to_its_base(tmp_path):
    """The base is the root link with all that is fixed to it."""
    robot = Robot.from_urdf("craft.urdf", text=URDF, free=True)
    spec = mujoco.MjSpec.from_string(URDF)
    spec.option.gravity = (0, 0, 0)
    spec.compiler.fusestatic = False
    spec.bodies[1].add_freejoint()
    assert compared(robot, spec.compile(), 1) < 1e-11


def test_a_rollout_is_mujocos():
    """Two seconds of `ode()` by Runge and Kutta with MuJoCo's own step, spinning all the while."""
    robot = craft()
    u, h = torques(T, 1), 0.001
    seen = motion(T, u, START, inside=10)
    q = np.concatenate([START[1], START[0]])
    qd = np.concatenate([START[3], rates_of(START[0], START[2])])
    with float64():
        ode = robot.ode(smoothing_velocity=1e-3)

        def step(y, k):
            args = (None, lambda t: jnp.asarray(u)[k // 10])

            def slope(y):
                return ode(0.0, y, args)

            def add(y, s, d):
                return jax.tree.map(lambda a, b: a + s * b, y, d)

            k1 = slope(y)
            k2 = slope(add(y, h / 2, k1))
            k3 = slope(add(y, h / 2, k2))
            k4 = slope(add(y, h, k3))
            new = jax.tree.map(
                lambda a, b, c, d, e: a + h / 6 * (b + 2 * c + 2 * d + e), y, k1, k2, k3, k4
            )
            return new, y[0]

        found = quick_jit(lambda y: jax.lax.scan(step, y, jnp.arange(10 * len(T)))[1])(
            ode.y0(q, qd)
        )
    assert np.abs(np.asarray(found)[::10] - seen).max() < 1e-8


def test_momentum_is_conserved_and_mujocos():
    """Angular momentum about the centre of mass, in the world: MuJoCo's sum over its bodies, at
    every time the same.
    """
    robot = craft()
    model = mujoco.MjModel.from_xml_string(text())
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    with float64():
        own = quick_jit(lambda q, v: momentum(robot, q, v))
        for _ in range(5):
            q, qd = rng.uniform(-1.2, 1.2, 7), rng.normal(size=7)
            placed(data, q[4:], q[:4], spin_of(q[4:], qd[4:], qd[4:])[0], qd[:4])
            mujoco.mj_forward(model, data)
            mujoco.mj_subtreeVel(model, data)
            assert np.allclose(np.asarray(own(q, qd)), data.subtree_angmom[1], atol=1e-12)


def test_gradients_are_finite_also_at_rest():
    robot = craft()
    with float64():
        still = jnp.zeros(7)

        def field(robot, q):
            return jnp.sum(robot.vector_field(0.0, (q, still), still + 0.1)[1])

        slope = quick_jit(jax.grad(lambda q: field(robot, q)))(still + 0.2)
        mass = quick_jit(jax.grad(lambda m: field(replace_mass(robot, m), still + 0.2)))(
            jnp.asarray(robot.mass)
        )
    assert (
        np.isfinite(np.asarray(slope)).all()
        and np.isfinite(np.asarray(mass)).all()
        and np.any(np.asarray(mass) != 0)
    )


def replace_mass(robot: Robot, mass) -> Robot:
    import equinox as eqx

    return eqx.tree_at(lambda r: r.mass, robot, mass)


@pytest.fixture(scope="module")
def runs():
    """Two runs of 6 s, one without and one with momentum, friction in the joints that the fit is
    not told.
    """
    t = np.arange(601) * 0.01
    u = [torques(t, k + 1, 0.15) for k in range(2)]
    spins = (np.zeros(3), np.array([0.1, -0.05, 0.2]))
    rates = (np.zeros(4), START[3])
    return (
        t,
        u,
        [
            motion(t, a, (START[0], START[1], s, r), damping=0.2)
            for a, s, r in zip(u, spins, rates, strict=True)
        ],
    )


def spec_of(data: jaxid.Dataset) -> ModelSpec:
    assert data.model is not None
    return data.model


UNKNOWN = {"mass@a2": (1.6,), "com_x@a2": (0.1,), "com_y@a2": (0.05,)}
TRUTH = {"mass@a2": 1.1, "com_x@a2": 0.15, "com_y@a2": 0.0}


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_identification_by_momentum(runs, seed):
    """Neither torque nor acceleration: the last body's mass and centre within their intervals."""
    t, u, y = runs
    data = recording(u, y, t, 1e-4, seed, numbers=UNKNOWN, damping=0.2)
    blind = replace(
        data,
        model=replace(spec_of(data), free=True),
        channels=tuple(c for c in data.channels if c.role == "output"),
        experiments=tuple(replace(e, u=np.zeros((len(e.t), 0))) for e in data.experiments),
    )
    fit = jaxid.fit(None, blind, residual="momentum", fitter="lm(restarts=0)")
    assert set(fit.parameters) == set(TRUTH) and fit.simulation == "momentum"
    for name, value in TRUTH.items():
        found = fit.parameters[name]
        assert found.std is not None and abs(found.value - value) < 3.5 * found.std
    assert fit.parameters["mass@a2"].std < 0.03  # type: ignore[operator]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_simulate_takes_it(runs, tmp_path: Path):
    """From a folder, simulated to 1e-8."""
    t, u, y = runs
    data = recording([a[:201] for a in u], [b[:201] for b in y], t[:201], 0.0, damping=0.2)
    folder = save_dataset(data, tmp_path / "craft")
    loaded = jaxid.load_dataset(folder)
    assert loaded.model is not None and loaded.model.base == {"kind": "free"}
    run = jaxid.simulate(None, loaded, {"parameters": {}, "effects": []})
    assert max(max(r.values()) for r in run.rmse) < 1e-8


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_fit_by_torque():
    """The last body's mass and the joints' damping within their intervals; the base's rows have no
    torque.
    """
    fine = np.arange(2001) * 0.002
    smooth = torques(fine, 5, 0.15)
    moved = motion(
        fine, smooth, (START[0], START[1], np.zeros(3), np.zeros(4)), inside=2, damping=0.2
    )
    noisy = recording(
        [smooth[::5]], [moved[::5]], fine[::5], 1e-5, numbers={"mass@a2": (1.6,)}, damping=0.1
    )
    fit = jaxid.fit(
        None,
        noisy,
        residual="inverse_dynamics",
        fitter="lm(restarts=0)",
        without=["coulomb_friction"],
    )
    truth = {"mass@a2": 1.1, "damping@j1": 0.2, "damping@j2": 0.2, "damping@s1": 0.2}
    for name, value in truth.items():
        found = fit.parameters[name]
        assert found.std is not None and abs(found.value - value) < 4.5 * found.std + 1e-3


def test_what_is_not_taken_is_said(runs):
    t, u, y = runs
    data = recording(u, y, t, 1e-4)
    with pytest.raises(jaxid.UsageError, match="jaxid diagnose takes no robot on a free base"):
        jaxid.diagnose(None, data)
    with pytest.raises(jaxid.UsageError, match="jaxid identify takes no robot on a free base"):
        jaxid.identify(None, data)
    angle = replace(data, model=replace(spec_of(data), base={"kind": "free", "roll": 0.1}))
    with pytest.raises(jaxid.UsageError, match="leave the angle out"):
        resolve_model(None, angle)
    fixed = replace(data, model=replace(spec_of(data), base={"kind": "fixed"}))
    with pytest.raises(jaxid.UsageError, match='kind = "free"'):
        resolve_model(None, fixed)
    keep = [k for k, c in enumerate(data.outputs) if c.name != "base_yaw"]
    blind = replace(
        data,
        channels=tuple(c for c in data.channels if c.name != "base_yaw"),
        experiments=tuple(replace(e, y=e.y[:, keep]) for e in data.experiments),
    )
    with pytest.raises(jaxid.UsageError, match="base_yaw is missing"):
        resolve_model(None, blind)
    steep = replace(data, experiments=tuple(replace(e, y=e.y + 2.0) for e in data.experiments))
    with pytest.raises(jaxid.UsageError, match="roll and yaw are not coordinates"):
        resolve_model(None, steep)
    with pytest.raises(jaxid.UsageError, match="no number of one is fitted"):
        jaxid.fit(None, data, residual="momentum")
    with pytest.raises(jaxid.UsageError, match="of a robot on a free base"):
        jaxid.fit(
            "pendulum",
            jaxid.load_dataset(Path(__file__).parents[1] / "examples" / "servo_pendulum"),
            residual="momentum",
        )
    bare = URDF.replace('<mass value="7"/>', '<mass value="0"/>').replace(
        '<mass value="2"/>', '<mass value="0"/>'
    )
    bare = re.sub(r'ixx="0.[45]*" iyy="0.[35]*" izz="0.[35]*"', 'ixx="0" iyy="0" izz="0"', bare)
    with pytest.raises(jaxid.UsageError, match="needs mass and inertia of the base"):
        floating(Robot.from_urdf("craft.urdf", text=bare).tree.tree)
