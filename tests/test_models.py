"""The papers' rigid systems against equations derived by SymPy and integrated by SciPy, which share
no code with the product.
"""

from __future__ import annotations

from functools import cache
from math import pi
from typing import Any

import equinox as eqx
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from scipy.integrate import solve_ivp

import jaxid
from jaxid.dynamics.effect import Command
from jaxid.dynamics.mechanism import Rigid
from jaxid.dynamics.parameter import TypicalMagnitudes
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.models import FlexibleLink, MODELS, Servo, SpaceManipulator, Tracker
from jaxid.models.effects import BaseMotion
from jaxid.numerics.precision import float64
from jaxid.simulation.transfer import transfer
from simulated import flow, quick_jit, relative, Simulator


# ---- Lagrange by SymPy


def lagrange(T, V, q, qd):
    """tau = d/dt dL/dqd - dL/dq as functions of (q, qd, qdd), with everything else in it
    substituted.
    """
    qdd = sp.symbols(f"a0:{len(q)}")
    equations = []
    for x, v in zip(q, qd, strict=True):
        momentum = sp.diff(T, v)
        rate = sum(
            sp.diff(momentum, y) * w + sp.diff(momentum, w) * a
            for y, w, a in zip(q, qd, qdd, strict=True)
        )
        equations.append(rate - sp.diff(T - V, x))
    return sp.lambdify((q, qd, qdd), equations, "numpy")


PAPER: dict[str, Any] = {"J_theta": 0.117, "J_alpha": 0.1}
M, MC, LONG, U, R, G = 0.043, 0.103, 0.26, 0.036, 0.09, 9.81


@cache
def tracker(J_theta: float, J_alpha: float, rotor: float = 0.0):
    """The rod and camera as masses on a barrel that points back over the base axis, the rest of
    J_alpha as a free inertia.
    """
    th, al, thd, ald, s = sp.symbols("th al thd ald s")
    q, qd = (th, al), (thd, ald)

    def speed2(s):
        r, z = R - s * sp.cos(al), s * sp.sin(al)
        return (r * thd) ** 2 + (sp.diff(r, al) * ald) ** 2 + (sp.diff(z, al) * ald) ** 2

    geometric = sp.Rational(1, 2) * (
        sp.integrate(sp.expand(M / LONG * speed2(s)), (s, 0, LONG)) + MC * speed2(U)
    )
    own = M * LONG**2 / 3 + MC * U**2  # of rod and camera about the tilt axis
    lumped = J_alpha - rotor - own  # tilts, and yaws with cos^2 alpha as the paper has it
    T = (
        geometric
        + (J_theta * thd**2 + lumped * (ald**2 + sp.cos(al) ** 2 * thd**2) + rotor * ald**2) / 2
    )
    V = (M * LONG / 2 + MC * U) * G * sp.sin(al)
    return lagrange(T, V, q, qd)


@cache
def space(floating: bool, share: float = 1.0) -> Any:
    """Base (x, y, turn), link 1, last body (a `share` of it), all in the inertial plane; parameters
    below.
    """
    x, y, th, q1, q2 = q = sp.symbols("x y th q1 q2")
    qd = sp.symbols("xd yd thd q1d q2d")
    p = SPACE | {k: share * SPACE[k] for k in ("m2", "hx", "hy", "I2")}

    def turn(a):
        return sp.Matrix([[sp.cos(a), -sp.sin(a)], [sp.sin(a), sp.cos(a)]])

    def rate(e) -> Any:
        return sum((sp.diff(e, c) * v for c, v in zip(q, qd, strict=True)), sp.zeros(2, 1))

    centre = sp.Matrix([x, y])
    first = centre + turn(th) * sp.Matrix([p["base_x"], p["base_y"]])
    link = first + turn(th + q1) * sp.Matrix([p["c1"], 0])
    second = first + turn(th + q1) * sp.Matrix([p["l1"], 0])
    w1, w2 = qd[2] + qd[3], qd[2] + qd[3] + qd[4]
    across = turn(th + q1 + q2) * sp.Matrix([-p["hy"], p["hx"]]) * w2
    v, vl, vb = rate(second), rate(link), rate(centre)
    own = p["I1"] - p["m1"] * p["c1"] ** 2
    T = (
        p["base_mass"] * vb.dot(vb)
        + p["base_inertia"] * qd[2] ** 2
        + p["m1"] * vl.dot(vl)
        + own * w1**2
        + p["m2"] * v.dot(v)
        + 2 * v.dot(across)
        + p["I2"] * w2**2
    ) / 2
    if not floating:
        T = T.subs({th: 0, qd[0]: 0, qd[1]: 0, qd[2]: 0})
        return lagrange(T, 0, q[3:], qd[3:])
    mass = sp.lambdify((q,), sp.hessian(sp.expand(T), qd), "numpy")
    return lagrange(T, 0, q, qd), mass


SPACE: dict[str, Any] = {
    "m2": 40.0,
    "hx": 20.0,
    "hy": 4.0,
    "I2": 18.0,
    "l1": 1.2,
    "I1": 10.2,
    "m1": 20.0,
    "c1": 0.6,
    "base_mass": 500.0,
    "base_inertia": 120.0,
    "base_x": 0.6,
    "base_y": 0.2,
}


@eqx.filter_jit
def inverse(model: Rigid, q, qd, qdd) -> jax.Array:
    return model.inverse(q, qd, qdd)


def torque(model: Rigid, q, qd, qdd) -> np.ndarray:
    with float64():
        return np.asarray(inverse(model, jnp.asarray(q), jnp.asarray(qd), jnp.asarray(qdd)))


@pytest.mark.parametrize("rotor", [0.0, 0.03])
def test_the_tracker_is_the_papers_corrected_equation(rotor):
    rng = np.random.default_rng(2)
    values: dict[str, Any] = {"J_theta": 0.117, "J_alpha": 0.1, "rotor_alpha": rotor}
    model = Tracker(**values)
    for q, qd, qdd in rng.normal(size=(50, 3, 2)):
        truth = np.array(tracker(0.117, 0.1, rotor)(q, qd, qdd))
        np.testing.assert_allclose(torque(model, q, qd, qdd), truth, rtol=1e-10, atol=1e-12)
        k, s, c = M * LONG + 2 * MC * U, np.sin(q[1]), np.cos(q[1])
        J = 0.1 - rotor
        bend = k * R * s - 2 * J * s * c
        printed = (0.117 + (M + MC) * R**2 - k * R * c + J * c**2) * qdd[0] + bend * qd[0] * qd[1]
        assert truth[0] == pytest.approx(printed, rel=1e-10)


def test_the_tracker_under_voltage():
    """Equation (6), and Table 1, which contradicts it."""
    signature = Tracker.signatures[1]

    def drive(model, v):
        return np.asarray(model.drive(signature, jnp.array([v, -v]), jnp.zeros(2), jnp.zeros(2)))

    with float64():
        for v, paper, table in (
            (1.0, 0.0, 0.0),
            (1.68, 0.0, 0.0),
            (2.4, 0.072, 0.0882),
            (3.6, 0.192, 0.1176),
        ):
            np.testing.assert_allclose(drive(Tracker(), v), [paper, -paper], atol=1e-12)
            np.testing.assert_allclose(
                drive(Tracker(motor_table=True), v), [table, -table], atol=1e-12
            )


def test_an_unpowered_barrel_sags():
    """With the identified parameters by 32.8 degrees in 10 s (test A of the paper leaves the barrel
    at 0 V).
    """
    t = np.arange(1001) * 0.01
    s = Simulator(jaxid.Chain(Tracker()), t, np.zeros((1001, 2)), 2.5e-3, size=8192)
    y = s.outputs([{"J_theta": 0.117, "J_alpha": 0.1, "b_theta": 1.9, "b_alpha": 1.495}])[0]
    assert np.rad2deg(y[-1, 1]) == pytest.approx(-32.8, abs=0.1)
    assert abs(y[-1, 0]) < 1e-12


def test_the_space_manipulator_on_a_fixed_base():
    rng = np.random.default_rng(3)
    m2, hx, hy, I2, l1, I1 = (SPACE[k] for k in ("m2", "hx", "hy", "I2", "l1", "I1"))
    for q, v, a in rng.normal(size=(50, 3, 2)):
        found = torque(SpaceManipulator(**SPACE), q, v, a)
        np.testing.assert_allclose(found, space(False)(q, v, a), rtol=1e-10, atol=1e-10)
        c, s = np.cos(q[1]), np.sin(q[1])
        tau2 = I2 * (a[0] + a[1]) + l1 * (
            hx * (c * a[0] + s * v[0] ** 2) + hy * (-s * a[0] + c * v[0] ** 2)
        )
        w, both = (v[0] + v[1]) ** 2, a[0] + a[1]
        tau1 = (
            (I1 + m2 * l1**2) * a[0]
            + tau2
            + l1 * (hx * (c * both - s * w) + hy * (-s * both - c * w))
        )
        np.testing.assert_allclose(found, [tau1, tau2], rtol=1e-10, atol=1e-10)


def test_the_floating_base_is_the_full_lagrangian_at_zero_momentum():
    """Joint torques of the five-coordinate system with a free base, at random states without
    momentum.
    """
    equations, mass = space(True)
    rng = np.random.default_rng(4)
    model = SpaceManipulator(**SPACE, floating=True)
    for q, v, a in rng.normal(size=(20, 3, 2)):
        full = np.concatenate([[0.3, -0.2, rng.normal()], q])
        A = np.array(mass(full), float)
        base = -np.linalg.solve(A[:3, :3], A[:3, 3:] @ v)
        rates = np.concatenate([base, v])
        bias = np.array(equations(full, rates, np.zeros(5)), float)
        acceleration = -np.linalg.solve(A[:3, :3], A[:3, 3:] @ a + bias[:3])
        truth = np.array(equations(full, rates, np.concatenate([acceleration, a])), float)
        np.testing.assert_allclose(truth[:3], 0, atol=1e-8)
        np.testing.assert_allclose(torque(model, q, v, a), truth[3:], rtol=1e-9, atol=1e-8)


@pytest.mark.slow
def test_the_base_turns_as_the_full_system_does_and_is_an_effect():
    equations, mass = space(True)
    t = np.arange(601) * 0.01
    u = np.column_stack([30 * np.sin(0.8 * t), -12 * np.sin(1.1 * t)])

    def field(time, x):
        A = np.array(mass(x[:5]), float)
        bias = np.array(equations(x[:5], x[5:], np.zeros(5)), float)
        k = min(int(time / 0.01 + 1e-9), 599)
        part = (time - t[k]) / 0.01
        drive = u[k] + part * (u[k + 1] - u[k])
        return np.concatenate(
            [x[5:], np.linalg.solve(A, np.concatenate([np.zeros(3), drive]) - bias)]
        )

    truth = solve_ivp(field, (0, t[-1]), np.zeros(10), "DOP853", t, rtol=1e-9, atol=1e-11).y
    none = {f"{n}{j}": v for j in (1, 2) for n, v in (("F_c", 0.0), ("F_s", 0.0), ("F_v", 0.0))}
    # As an effect on the nominal arm: at share 1 its base floats as that of the model with a
    # floating base does.
    loose = Simulator(
        jaxid.Chain(SpaceManipulator()).with_effects(BaseMotion()),
        t,
        u,
        2.5e-3,
        hold="linear",
        size=8192,
    )
    share = {f"base_motion.share@{n}": 1.0 for n in ("q1", "q2")}
    fixed, y = loose.outputs([SPACE | none, SPACE | none | share])
    assert np.abs(truth[2]).max() > 0.3  # the base turns
    assert relative(y, truth[[3, 4, 2]].T) < 2e-6
    assert relative(fixed[:, :2], truth[3:5].T) > 0.1 and np.all(fixed[:, 2] == 0)
    model = SpaceManipulator(**SPACE)
    for q, v in np.random.default_rng(0).normal(size=(20, 2, 2)):
        given = SpaceManipulator(**SPACE, floating=True).matrices(jnp.asarray(q), jnp.asarray(v))
        for x, y in zip(
            model.loosened(jnp.ones(1)).matrices(jnp.asarray(q), jnp.asarray(v)), given, strict=True
        ):
            assert np.allclose(x, y, rtol=1e-5, atol=1e-5)  # single precision


def test_the_servo_against_scipy():
    """Saturated duty, back-EMF, current limit, a release; viscous friction, no dry friction (that
    is the step's own test).
    """
    p = {
        "torque_constant": 0.11,
        "back_emf": 0.05,
        "armature": 0.0018,
        "q_offset": 0.03,
        "gain_scale": 6e-4,
        "kp": 400.0,
        "supply_voltage": 7.4,
        "mass": 0.49,
        "length": 0.1,
        "gravity": 9.81,
        "current_limit": 6.0,
        "viscous": 0.004,
    }
    t = np.arange(801) * 5e-3
    goal = 1.2 * np.sin(2 * pi * 0.6 * t) + 0.6 * (t > 1.5)
    enable = np.where((t > 2.5) & (t < 3.0), 0.0, 1.0)

    def field(time, x):
        k = min(int(time / 5e-3 + 1e-9), 799)
        duty = min(1.0, max(-1.0, p["gain_scale"] * p["kp"] * (goal[k] - x[0])))
        volts = min(p["current_limit"], max(-p["current_limit"], p["supply_voltage"] * duty))
        tau = enable[k] * (p["torque_constant"] * volts - p["back_emf"] * x[1])
        load = p["mass"] * p["gravity"] * p["length"] * np.sin(x[0] - p["q_offset"])
        return [
            x[1],
            (tau - load - p["viscous"] * x[1]) / (p["mass"] * p["length"] ** 2 + p["armature"]),
        ]

    x, truth = np.zeros(2), [0.0]
    for k in range(800):
        x = solve_ivp(field, (t[k], t[k + 1] - 1e-12), x, "DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
        truth.append(x[0])
    s = Simulator(jaxid.Chain(Servo()), t, np.column_stack([goal, enable]), 1e-3)
    y = s.outputs([p | {"coulomb": 0.0}])[0, :, 0]
    assert relative(y, np.array(truth)) < 1e-4


# ---- every model


def chains() -> list[jaxid.Chain]:
    out = [jaxid.Chain(kind()) for kind in MODELS]
    voltage = jaxid.Chain(Tracker(motor_table=True), signature=Tracker.signatures[1])
    return [
        *out,
        jaxid.Chain(SpaceManipulator(floating=True)),
        voltage,
        jaxid.Chain(FlexibleLink(nonlinear=True)),
    ]


def label(chain: jaxid.Chain) -> str:
    name = f"{chain.mechanism.name}-{'-'.join(n for n, _ in chain.signature.inputs)}-{len(chain.signature.outputs)}"
    return name + "-nonlinear" * bool(getattr(chain.mechanism, "nonlinear", False))


def draw(layout: ParameterVector, rng: np.random.Generator) -> np.ndarray:
    """Random numbers inside the bounds of a model, effects' relative to magnitudes of one."""
    ones = [TypicalMagnitudes(1.0, 1.0, 1.0, 1.0, 1e-3)] * 8
    lower, upper, _ = layout.boxes(ones, ones)
    out = layout.values.copy()
    for i, e in enumerate(layout.entries):
        if not e.spec.fixed:
            share = rng.uniform()
            positive = e.spec.log and lower[i] > 0
            out[i] = (
                lower[i] * (upper[i] / lower[i]) ** share
                if positive
                else lower[i] + share * (upper[i] - lower[i])
            )
    return out


#: The others are the same code with more joints or other ends, or take the compiler half a minute
#: and more: `make test-all`.
QUICK = (
    "joint-tau-1",
    "pendulum-tau-1",
    "servo-q_cmd-enable-1",
    "flexible_link-tau-2-nonlinear",
)


@pytest.mark.parametrize(
    "chain",
    [c if label(c) in QUICK else pytest.param(c, marks=pytest.mark.slow) for c in chains()],
    ids=label,
)
def test_no_gradient_is_nan(chain):
    """Of a step, the sensors and the frequency response, by every number and state, in 1,000 draws,
    a quarter of them at rest.
    """
    layout, nq, nu = ParameterVector(chain), chain.nq, len(chain.signature.inputs)
    rng = np.random.default_rng(0)
    theta = np.array([draw(layout, rng) for _ in range(1000)])
    state = rng.normal(size=(1000, 2 * nq))
    state[:250, nq:] = 0.0
    state[:100] = 0.0
    u = rng.normal(size=(1000, nu))
    u[:50] = 0.0

    def answer(theta, state, u):
        model = layout.model(theta)
        body = model.body().prepare(jnp.asarray(1e-3))
        carry = model.start(state[:nq], state[nq:], u)
        command = Command(jnp.zeros(()), jnp.asarray(1e-3), u, u, lambda d: u)
        carry, y = jax.lax.scan(lambda carry, _: model.step(body, carry, command), carry, None, 2)
        re, im = transfer(model, jnp.array([3.0, 80.0]))
        return jnp.concatenate([*body.port(carry.x), y.ravel(), re.ravel(), im.ravel()])

    with float64():
        both = quick_jit(jax.vmap(lambda *a: (answer(*a), jax.jacfwd(answer, (0, 1))(*a))))
        value, (by_theta, by_state) = both(jnp.asarray(theta), jnp.asarray(state), jnp.asarray(u))
    for name, a in (("value", value), ("by parameters", by_theta), ("by state", by_state)):
        assert np.isfinite(np.asarray(a)).all(), name


RIGID = {label(c): c for c in chains() if isinstance(c.mechanism, Rigid)}


@cache
def masses(name: str):
    layout = ParameterVector(RIGID[name])

    def mass(theta, q):
        mechanism: Any = layout.model(theta).mechanism
        return mechanism.matrices(q, jnp.zeros_like(q))[0]

    return layout, quick_jit(jax.vmap(jax.vmap(mass, (None, 0))))


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_mass_matrix_is_symmetric_and_positive_definite(seed):
    """10,000 random states and parameters in all (physical ones where a model's parameters need not
    be: its defaults).
    """
    rng = np.random.default_rng(seed)
    for name, chain in RIGID.items():
        layout, mass = masses(name)
        theta = np.array([draw(layout, rng) for _ in range(40)])
        if chain.mechanism.name not in ("joint", "pendulum", "planar_arm", "tracker", "servo"):
            theta = np.tile(layout.values, (40, 1))
        q = rng.uniform(-pi, pi, (40, 50, chain.nq))
        with float64():
            A = np.asarray(mass(jnp.asarray(theta), jnp.asarray(q)))
        assert np.abs(A - np.swapaxes(A, -1, -2)).max() <= 1e-12 * np.abs(A).max()
        assert np.linalg.eigvalsh(A).min() > 0, chain.mechanism.name


@eqx.filter_jit
def at_rest(mechanism: Rigid, q) -> tuple[jax.Array, jax.Array]:
    """Mass matrix and bias of a mechanism that does not move."""
    return mechanism.matrices(q, jnp.zeros_like(q))


def energy(mechanism: Rigid, q, qd):
    """Kinetic and potential energy by the mass matrix and the work of the bias at rest along a path
    from 0 to q.
    """
    M, _ = at_rest(mechanism, jnp.asarray(q))
    work = 0.0
    for x, w in zip(*np.polynomial.legendre.leggauss(24), strict=True):
        _, bias = at_rest(mechanism, jnp.asarray((x + 1) / 2 * q))
        work += w / 2 * np.asarray(bias) @ q
    return qd @ np.asarray(M) @ qd / 2 + work


@pytest.mark.parametrize(
    ("mechanism", "q", "qd"),
    [
        (Tracker(**PAPER), [0.0, 0.5], [2.0, 1.0]),
        (SpaceManipulator(**SPACE), [0.1, 0.5], [0.8, -1.0]),
        (SpaceManipulator(**SPACE, floating=True), [0.1, 0.5], [0.8, -1.0]),
    ],
    ids=["tracker", "fixed", "floating"],
)
def test_energy_is_kept_for_20_seconds(mechanism, q, qd):
    n = len(q)
    with float64():
        x0 = mechanism.start(jnp.asarray(q), jnp.asarray(qd))
        end = flow(lambda x: mechanism.vector_field(0.0, x, jnp.zeros(n)), x0, 20.0)
        before, after = (
            energy(mechanism, np.array(q), np.array(qd)),
            energy(mechanism, *(np.asarray(x) for x in end[:2])),
        )
    assert abs(after - before) < 1e-8 * abs(before)
