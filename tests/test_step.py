"""The step against separately written equations: stick-slip, every effect on every mechanism,
energies, gradients.
"""

from __future__ import annotations

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from jaxtyping import Array

import reference as ref
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.dry_friction import solve_dry
from jaxid.dynamics.effect import Command
from jaxid.dynamics.mechanism import Lagrangian
from jaxid.dynamics.parameter import constant, param
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.models import Joint, Pendulum, PlanarArm
from jaxid.models.effects import InputDelay
from jaxid.numerics.precision import float64
from simulated import REFERENCE, relative, Simulator, within_bounds


# ---- stick-slip


STICKY = {"inertia": 0.08, "gravity_torque": 1.5, "viscous": 0.05, "coulomb": 0.3, "offset": 0.0}
STICKY_TRUTH = ref.Truth(viscous=0.05, coulomb=0.3)


@pytest.fixture(scope="module")
def stick_slip():
    """A command held for 4 ms a sample, and the event-exact answer."""
    t = np.arange(1000) * 4e-3
    u = ref.multisine(t, [1.2], 0, lines=5)
    q, _ = ref.simulate(ref.pendulum(), STICKY_TRUTH, t, u)
    assert np.count_nonzero(np.diff(np.sign(np.diff(q[:, 0])))) > 4  # it reverses and rests
    return t, u, q


@pytest.fixture(scope="module")
def pendulum(stick_slip):
    t, u, _ = stick_slip
    return {h: Simulator(Chain(Pendulum()), t, u, h) for h in (4e-3, 2e-3, 1e-3)}


def test_stick_slip_pendulum_is_second_order(stick_slip, pendulum):
    error = {h: relative(s.outputs([STICKY])[0], stick_slip[2]) for h, s in pendulum.items()}
    print("pendulum with stick-slip, relative error by step:", error)
    assert error[2e-3] <= 2e-5
    assert error[4e-3] > 3 * error[2e-3] > 9 * error[1e-3]


def test_tangents_equal_central_differences(pendulum):
    s = pendulum[2e-3]
    theta = s.theta(STICKY | {"offset": 0.02})
    _, dy = s.tangents(theta)
    for i, name in enumerate(s.layout.names):
        e = 1e-6 * max(abs(theta[i]), 0.1) * np.eye(len(theta))[i]
        high, low = s.outputs(np.array([theta + e, theta - e]))
        difference = (high - low) / (2 * e[i])
        assert np.max(np.abs(dy[i] - difference)) <= 1e-6 * np.max(np.abs(difference)), name


# ---- several joints


ARM_TRUTH = ref.Truth(viscous=np.array([1.0, 0.5]), coulomb=np.array([2.0, 0.8]))
ARM = {"viscous1": 1.0, "viscous2": 0.5, "coulomb1": 2.0, "coulomb2": 0.8}


def test_arm_with_dry_friction_at_both_joints():
    t = np.arange(300) * 4e-3
    u = ref.multisine(t, [14.0, 4.0], 3)
    q, _ = ref.simulate(ref.planar_arm(), ARM_TRUTH, t, u)
    error = {
        h: relative(Simulator(Chain(PlanarArm()), t, u, h).outputs([ARM])[0], q)
        for h in (4e-3, 2e-3, 1e-3)
    }
    print("arm with stick-slip, relative error by step:", error)
    assert error[2e-3] <= 1e-4
    assert error[4e-3] > 3 * error[2e-3] > 9 * error[1e-3]


def test_one_joint_holds_against_gravity_while_the_other_slides():
    t = np.arange(250) * 4e-3
    u = np.stack([0 * t, 5.0 * np.sin(2 * np.pi * 1.2 * t)], 1)
    start = [0.5, -0.4, 0.0, 0.0]
    truth = ref.Truth(viscous=np.array([1.0, 0.5]), coulomb=np.array([25.0, 0.8]))
    q, _ = ref.simulate(ref.planar_arm(), truth, t, u, start[:2], start[2:])
    assert np.all(q[:, 0] == 0.5) and np.ptp(q[:, 1]) > 0.5
    error = {}
    for h in (4e-3, 2e-3):
        y = Simulator(Chain(PlanarArm()), t, u, h).outputs([ARM | {"coulomb1": 25.0}], start)[0]
        assert np.all(y[:, 0] == 0.5)  # a joint that sticks does not creep
        error[h] = relative(y, q)
    assert (
        error[2e-3] < 2e-5 and error[4e-3] > 3 * error[2e-3]
    )  # second order beside a joint that sticks


jitted_solve = jax.jit(
    lambda v0, free, A, minus, plus, lam: solve_dry(v0, free, A, minus, plus, lam, 0.0)
)


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 4), st.integers(0, 2**31), st.booleans())
def test_gauss_seidel_meets_the_friction_law(n, seed, moving):
    """From rest, Moreau's conditions hold; from motion, the torques stay within their levels and
    explain the velocity.
    """
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    A = root @ root.T / n + np.eye(n)
    free, minus, plus = rng.normal(size=n), rng.uniform(0, 1, n), rng.uniform(0, 1, n)
    v0 = rng.normal(size=n) if moving else np.zeros(n)
    with float64():
        solved = jitted_solve(v0, free, A, minus, plus, 0 * v0)
    lam, w, _ = (np.asarray(x) for x in solved)
    scale = np.max(np.abs(free - v0))
    assert np.max(np.abs(free - A @ lam - w)) <= 1e-10 * scale
    slack = 1e-9 * scale
    assert np.all((lam <= plus + slack) & (lam >= -minus - slack))
    if not moving:
        forwards, backwards = w > slack, w < -slack
        assert np.allclose(lam[forwards], plus[forwards], atol=1e-9)
        assert np.allclose(lam[backwards], -minus[backwards], atol=1e-9)


# ---- mechanisms


def motion(chain: Chain, q, v, h: float, steps: int):
    """States (q, qd) [steps nq] without command."""
    with float64():
        q, v = jnp.asarray(q, float), jnp.asarray(v, float)
        u = jnp.zeros(len(chain.signature.inputs))
        command = Command(jnp.zeros(()), jnp.asarray(h), u, u, lambda d: u)
        body = chain.body()

        def step(carry, _):
            return chain.advance(body, carry, command)[0], body.port(carry.x)

        run = jax.jit(lambda carry: jax.lax.scan(step, carry, None, length=steps)[1])
        return tuple(np.asarray(x) for x in run(chain.start(q, v, u)))


def energy(plant: ref.Plant, q, v, height):
    kinetic = np.array([v_k @ plant(q_k, v_k)[0] @ v_k / 2 for q_k, v_k in zip(q, v, strict=True)])
    return kinetic + np.array([height(q_k) for q_k in q])


def test_pendulum_keeps_its_energy():
    q, v = motion(Chain(Pendulum(), ()), [2.0], [0.0], 5e-4, 40_000)
    e = energy(ref.pendulum(), q[::100], v[::100], lambda q: -1.5 * np.cos(q[0]))
    assert np.ptp(e) <= 1e-8 * 1.5


def test_arm_keeps_its_energy():
    q, v = motion(Chain(PlanarArm(), ()), [1.0, 0.5], [0.0, 0.0], 5e-4, 40_000)

    def heights(q):
        return 9.81 * (-(4 * 0.25 + 2.5 * 0.5) * np.cos(q[0]) - 2.5 * 0.2 * np.cos(q[0] + q[1]))

    e = energy(ref.planar_arm(), q[::100], v[::100], heights)
    assert np.ptp(e) <= 1e-8 * np.max(np.abs(e))


class LagrangianArm(Lagrangian):
    """The planar arm from its energies."""

    name: ClassVar[str] = "lagrangian_arm"
    signatures: ClassVar[tuple] = PlanarArm.signatures
    builtin: ClassVar[tuple] = ()
    equations: ClassVar[str] = "L = T - V"
    source: ClassVar[str] = "textbook"
    m1: Array = param(4.0, 0.01, 100.0, unit="kg")
    m2: Array = param(2.5, 0.01, 100.0, unit="kg")
    gravity: Array = constant(9.81, unit="m/s^2")

    def kinetic_energy(self, q, qd):
        x2 = 0.5 * jnp.cos(q[0]) * qd[0] + 0.2 * jnp.cos(q[0] + q[1]) * (qd[0] + qd[1])
        y2 = 0.5 * jnp.sin(q[0]) * qd[0] + 0.2 * jnp.sin(q[0] + q[1]) * (qd[0] + qd[1])
        spin = (0.12 + self.m1 * 0.25**2) * qd[0] ** 2 + 0.05 * (qd[0] + qd[1]) ** 2
        return (spin + self.m2 * (x2**2 + y2**2)) / 2

    def potential_energy(self, q):
        first = self.m1 * 0.25 * jnp.cos(q[0])
        return -self.gravity * (
            first + self.m2 * (0.5 * jnp.cos(q[0]) + 0.2 * jnp.cos(q[0] + q[1]))
        )


both_arms = jax.jit(lambda q, v: (PlanarArm().matrices(q, v), LagrangianArm().matrices(q, v)))
angles = st.floats(-3.0, 3.0)
speeds = st.floats(-8.0, 8.0)


@settings(max_examples=40, deadline=None)
@given(angles, angles, speeds, speeds)
def test_three_ways_to_the_arm_agree(q1, q2, v1, v2):
    """Closed form, Lagrange by automatic differentiation, and virtual power written for the
    tests.
    """
    q, v = np.array([q1, q2]), np.array([v1, v2])
    with float64():
        closed, lagrange = both_arms(jnp.asarray(q), jnp.asarray(v))
    for a, b, c in zip(closed, lagrange, ref.planar_arm()(q, v), strict=True):
        assert np.allclose(a, b, rtol=1e-12, atol=1e-12)
        assert np.allclose(a, c, rtol=1e-12, atol=1e-12)


def test_arm_equals_mujoco():
    xml = """<mujoco><compiler inertiafromgeom="false"/><option gravity="0 0 -9.81"/><worldbody>
    <body><joint axis="0 -1 0"/><inertial pos="0 0 -0.25" mass="4" diaginertia="0.12 0.12 0.12"/>
    <body pos="0 0 -0.5"><joint axis="0 -1 0"/><inertial pos="0 0 -0.2" mass="2.5" diaginertia="0.05 0.05 0.05"/></body>
    </body></worldbody></mujoco>"""
    m: object = mujoco
    model = m.MjModel.from_xml_string(xml)  # pyright: ignore[reportAttributeAccessIssue]
    data = m.MjData(model)  # pyright: ignore[reportAttributeAccessIssue]
    rng = np.random.default_rng(0)
    for _ in range(20):
        data.qpos, data.qvel = rng.uniform(-3, 3, 2), rng.uniform(-5, 5, 2)
        m.mj_forward(model, data)  # pyright: ignore[reportAttributeAccessIssue]
        M = np.zeros((2, 2))
        m.mj_fullM(model, *((data, M) if hasattr(data, "M") else (M, data.qM)))  # pyright: ignore[reportAttributeAccessIssue]
        with float64():
            mine = PlanarArm().matrices(jnp.asarray(data.qpos), jnp.asarray(data.qvel))
        assert np.allclose(mine[0], M, rtol=1e-10)
        assert np.allclose(mine[1], data.qfrc_bias, rtol=1e-10, atol=1e-10)


#: The systems whose parameters may lie anywhere in their bounds; tests of the others stand in files
#: of their own.
SMALL = (Joint, Pendulum, PlanarArm)


@pytest.mark.parametrize("kind", SMALL, ids=lambda k: k.name)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_mass_matrix_is_symmetric_and_positive_definite(kind, seed):
    """For all parameters within their bounds."""
    rng = np.random.default_rng(seed)
    layout = ParameterVector(Chain(kind()))
    theta = within_bounds(layout, [REFERENCE] * layout.chain.nq, rng)
    with float64():
        body: Any = layout.model(jnp.asarray(theta)).mechanism
        M = np.asarray(
            body.matrices(*(jnp.asarray(rng.uniform(-3, 3, layout.chain.nq)) for _ in range(2)))[0]
        )
    assert np.array_equal(M, M.T)
    assert np.all(np.linalg.eigvalsh(M / np.sqrt(np.outer(np.diag(M), np.diag(M)))) > 0)


# ---- time and holds


def test_irregular_sampling_equals_regular():
    """The same held command and the same steps, seen at irregular samples."""
    rng = np.random.default_rng(4)
    places = np.concatenate([[0], np.cumsum(rng.integers(1, 5, 300))])
    t = places * 2e-3
    u = ref.multisine(t, [1.2], 0)
    every = np.arange(places[-1] + 1)
    held = u[np.searchsorted(places, every, side="right") - 1]
    chain = Chain(Pendulum())
    irregular = Simulator(chain, t, u).outputs([STICKY])[0]
    regular = Simulator(chain, every * 2e-3, held).outputs([STICKY])[0]
    assert np.max(np.abs(irregular - regular[places])) < 1e-12


def test_linear_hold_against_the_reference():
    t = np.arange(150) * 0.01
    u = ref.multisine(t, [1.2], 2)
    truth = ref.Truth(viscous=0.05)
    values = STICKY | {"coulomb": 0.0}
    out = {}
    for hold in ("zero", "linear"):
        q, _ = ref.simulate(ref.pendulum(), truth, t, u, hold=hold)
        out[hold] = Simulator(Chain(Pendulum()), t, u, 5e-4, hold).outputs([values])[0]
        assert relative(out[hold], q) < 1e-6
    assert relative(out["zero"], out["linear"]) > 1e-3


@pytest.mark.parametrize("delay", [0.0005, 0.0037, 0.0431])
def test_delay_is_exact_on_irregular_times(delay):
    """A delay that is no multiple of the step: the mean of the delayed command over each step is
    exact.
    """
    rng = np.random.default_rng(7)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.004, 0.016, 100))])
    u = ref.multisine(t, [1.2], 2)
    q, _ = ref.simulate(ref.pendulum(), ref.Truth(viscous=0.05, delay=delay), t, u)
    chain = Chain(Pendulum()).with_effects(InputDelay())
    values = STICKY | {"coulomb": 0.0, "input_delay.delay@tau": delay}
    assert relative(Simulator(chain, t, u, 5e-4).outputs([values])[0], q) < 2e-6
