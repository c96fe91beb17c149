"""Speeds as outputs, drives of a model's own, scales that are read off both."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import jaxid
from jaxid.data.dataset import ModelSpec
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import constant, param
from jaxid.models.effects import ConstantTorque, CoulombFriction, ViscousFriction
from jaxid.problem.binding import bind


class Coast(Rigid):
    """A body whose only sensor reads its speed."""

    name: ClassVar[str] = "coast"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((), (("velocity", "m/s"),), ("position",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (CoulombFriction, {"level": "rolling"}),
        (ViscousFriction, {"coefficient": "viscous"}),
    )
    equations: ClassVar[str] = "mass qdd = -rolling sign(qd) - viscous qd"
    source: ClassVar[str] = "textbook"
    mass: Array = param(100.0, 1.0, 1e4, unit="{I}", log=True)

    def matrices(self, q, qd):
        return self.mass[None, None], jnp.zeros_like(q)

    def output(self, x, tau, rests):
        return x[1]


class Slow(Rigid):
    """A slow axis driven by volts."""

    name: ClassVar[str] = "slow"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("u", "V"),), (("position", "m"),), ("position",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
        (ConstantTorque, {"torque": "offset"}),
    )
    equations: ClassVar[str] = "mass qdd + viscous qd + coulomb sign(qd) + offset = gain u"
    source: ClassVar[str] = "textbook"
    mass: Array = constant(0.5, unit="kg")
    gain: Array = constant(20.0, unit="N/V")

    def drive(self, signature, u, q, qd):
        return self.gain * u

    def matrices(self, q, qd):
        return self.mass[None, None], jnp.zeros_like(q)


class Cart(Rigid):
    """One input, two joints, and no law between them."""

    name: ClassVar[str] = "cart"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("u", "V"),), (("x", "m"), ("phi", "rad")), ("x", "phi")),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
    )
    equations: ClassVar[str] = "mass qdd = u"
    source: ClassVar[str] = "textbook"
    mass: Array = constant(0.5, unit="kg")

    def matrices(self, q, qd):
        return self.mass * jnp.eye(2), jnp.zeros_like(q)


def coasting(start=8.0):
    """100 kg against 5 N and 0.2 N s/m; only the speed is logged, at 2 Hz."""
    rng, t = np.random.default_rng(0), np.arange(0, 80, 0.5)
    speed = (start + 25.0) * np.exp(-0.2 / 100 * t) - 25.0 + 0.01 * rng.standard_normal(len(t))
    data = jaxid.Dataset.from_arrays(t, {}, {"velocity": speed}, noise_std={"velocity": 0.01})
    return replace(data, model=ModelSpec(free=True, constants={"mass": 100.0}))


def within(fit, **true):
    for name, value in true.items():
        p = fit.parameters[name]
        assert p.std and abs(p.value - value) < 3.5 * p.std, (name, p)


def test_a_coast_down_by_speed_alone_is_recovered():
    fit = jaxid.fit(Coast(), coasting())
    within(fit, rolling=5.0, viscous=0.2)
    assert fit.state == "converged" and fit.loss < 1.3
    assert {fit.parameters[n].unit for n in ("rolling", "viscous")} == {"N", "N s/m"}
    assert all(
        rows["velocity"].relative_error < 0.01 for rows in fit.scores.values()
    )  # of the parts that were cut, too


def swinging(noise=0.01):
    """Speed of a driven pendulum, by small steps."""
    t = np.arange(0, 10, 0.01)
    u = 0.8 * np.sin(2 * np.pi * (0.2 + 0.05 * t) * t)
    q, v, out = 0.4, 0.2, []
    for tau in u:
        out.append(v)
        for _ in range(20):
            a = (tau - 1.5 * np.sin(q) - 0.05 * v) / 0.08
            v, q = v + 5e-4 * a, q + 5e-4 * (v + 2.5e-4 * a)
    return t, u, np.array(out) + noise * np.random.default_rng(1).standard_normal(len(t))


def test_a_pendulum_by_its_gyroscope_alone_is_recovered():
    t, u, speed = swinging()
    data = jaxid.Dataset.from_arrays(t, {"tau": u}, {"qd": speed}, noise_std={"qd": 0.01})
    fit = jaxid.fit("pendulum", data, without=("coulomb_friction", "constant_torque"))
    assert fit.state == "converged" and fit.loss < 1.3
    for name, value in {"inertia": 0.08, "gravity_torque": 1.5, "viscous": 0.05}.items():
        assert fit.parameters[name].value == pytest.approx(value, rel=0.01)


@pytest.mark.parametrize(
    ("unit", "factor"), [("rpm", 30 / np.pi), ("rad/s", 1.0), ("deg/s", 180 / np.pi)]
)
def test_a_speed_is_an_output_of_every_model_in_its_unit(tmp_path, unit, factor):
    t, u, speed = swinging()
    np.savetxt(
        tmp_path / "a.csv",
        np.c_[t, u, factor * speed],
        delimiter=",",
        header="t,tau,velocity",
        comments="",
    )
    (tmp_path / "dataset.toml").write_text(
        'name = "p"\n[model]\nname = "pendulum"\n[channels.tau]\nrole = "input"\nunit = "N m"\n'
        f'[channels.velocity]\nrole = "output"\nunit = "{unit}"\n[[experiments]]\nfile = "a.csv"\n'
    )
    b = bind(None, jaxid.load_dataset(tmp_path))
    assert b.chain.signature.outputs == (("velocity", "rad/s"),) and b.chain.signature.speeds == (
        0,
    )
    assert b.references[0].speed == pytest.approx(np.percentile(np.abs(speed), 99), rel=0.05)


def test_a_speed_beside_the_position_is_taken_with_it():
    t = np.linspace(0, 2, 200)
    channels = {"q": np.sin(t), "qd": np.cos(t)}
    b = bind("joint", jaxid.Dataset.from_arrays(t, {"tau": np.cos(t)}, channels))
    assert b.chain.signature.outputs == (("q", "rad"), ("qd", "rad/s"))


def axis(seed=0):
    """0.5 kg, 500 N s/m, 5 N of dry friction, 20 N/V times 0.6 V sin(2 pi 0.1 t): inertia does not show."""
    rng, t = np.random.default_rng(seed), np.arange(0, 40, 0.02)
    fine = np.arange(0, 40, 1e-3)
    force = 12 * np.sin(2 * np.pi * 0.1 * fine)
    speed = np.sign(force) * np.maximum(np.abs(force) - 5, 0) / 500
    x = np.interp(t, fine, np.cumsum(speed) * 1e-3)
    u = 0.6 * np.sin(2 * np.pi * 0.1 * t)
    return jaxid.Dataset.from_arrays(
        t,
        {"u": u},
        {"position": x + 2e-5 * rng.standard_normal(len(t))},
        units={"u": "V"},
        noise_std={"position": 2e-5},
        hold={"u": "linear"},
        at_rest=True,
    )


@pytest.mark.parametrize("residual", ["output_error", "inverse_dynamics"])
def test_friction_of_an_axis_driven_by_volts_is_recovered(residual):
    fit = jaxid.fit(Slow(), axis(), residual=residual)
    assert fit.state == "converged"
    for name, value in {"viscous": 500.0, "coulomb": 5.0}.items():
        # A speed that is made of positions has noise where its sign turns, which the torque
        # equation does not know of.
        assert fit.parameters[name].value == pytest.approx(
            value, rel=0.02 if residual == "output_error" else 0.15
        )
    assert fit.parameters["viscous"].unit == "N s/m"


def test_torque_of_a_drive_scales_the_bounds():
    b = bind(Slow(), axis())
    assert b.references[0].torque == pytest.approx(12.0, rel=0.02)
    assert b.upper[b.layout.index("coulomb")] > 10


def test_inputs_that_are_no_torques_of_joints_need_a_drive():
    t = np.linspace(0, 2, 200)
    data = jaxid.Dataset.from_arrays(
        t, {"u": np.cos(t)}, {"x": np.sin(t), "phi": np.cos(t)}, units={"x": "m", "u": "V"}
    )
    with pytest.raises(jaxid.UsageError, match="1 input, 2 joints: write `drive`"):
        jaxid.fit(Cart(), data)
