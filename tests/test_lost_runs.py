"""Fits that a free run or a sensor's noise would lead astray: windows, weights by what is left,
equations without a scale.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import jaxid
from jaxid.data.dataset import ModelSpec, ParameterPrior
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import constant, param
from jaxid.fitters import LevenbergMarquardt
from jaxid.fitting import lost_runs
from jaxid.fitting.lost_runs import decays
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.result import Estimate, Fit, Score
from jaxid.fitting.scale_free import shrinking
from jaxid.models.effects import CoulombFriction, ViscousFriction
from jaxid.problem.binding import bind
from jaxid.problem.residual import InverseDynamics


class Cylinder(Rigid):
    """A pneumatic cylinder: two pressures, one piston."""

    name: ClassVar[str] = "cylinder"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("p1", "Pa"), ("p2", "Pa")), (("position", "m"),), ("position",), linear=True),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
    )
    equations: ClassVar[str] = "mass qdd = area1 p1 - area2 p2 - friction"
    source: ClassVar[str] = "textbook"
    mass: Array = param(5.0, 1e-2, 1e4, unit="kg", log=True)
    area1: Array = param(8e-4, 1e-6, 1.0, unit="m^2", log=True)
    area2: Array = param(7e-4, 1e-6, 1.0, unit="m^2", log=True)

    def drive(self, signature, u, q, qd):
        return (self.area1 * u[0] - self.area2 * u[1])[None]

    def matrices(self, q, qd):
        return self.mass[None, None], jnp.zeros_like(q)


AREAS = {"area1": 8e-4, "area2": 6.9e-4}


def piston(**known):
    """0.3 s at 5 kHz: 3.2 kg, 60 N s/m, 25 N of dry friction."""
    t, rng = np.arange(1500) * 2e-4, np.random.default_rng(0)
    p1 = 3e5 + 1.5e5 * np.sin(2 * np.pi * 9 * t)
    p2 = 3e5 * 8 / 6.9 - 1.2e5 * np.sin(2 * np.pi * 9 * t + 0.3)
    x, v, out = 0.0, 0.0, []
    for force in AREAS["area1"] * p1 - AREAS["area2"] * p2:
        out.append(x)
        for _ in range(20):
            w = v + 1e-5 * (force - 60 * v) / 3.2
            w = np.sign(w) * max(0.0, abs(w) - 1e-5 * 25 / 3.2)
            x, v = x + 1e-5 * (v + w) / 2, w
    units = {"p1": "Pa", "p2": "Pa", "position": "m"}
    y = np.array(out) + 1e-5 * rng.standard_normal(len(t))
    data = jaxid.Dataset.from_arrays(
        t, {"p1": p1, "p2": p2}, {"position": y}, units=units, noise_std={"position": 1e-5}
    )
    return replace(data, model=ModelSpec(constants=known))


def test_a_fast_short_record_of_a_pneumatic_cylinder_is_recovered():
    fit = jaxid.fit(Cylinder(), piston(**AREAS))
    assert fit.state == "converged" and fit.loss < 1.3
    for name, value in {"mass": 3.2, "viscous": 60.0, "coulomb": 25.0}.items():
        p = fit.parameters[name]
        assert p.std and abs(p.value - value) < 3.5 * p.std + 0.002 * value


def test_a_torque_equation_without_a_scale_is_refused():
    with pytest.raises(jaxid.UsageError, match="only the ratios of mass, area1, area2"):
        jaxid.fit(Cylinder(), piston(), residual="inverse_dynamics")


@pytest.mark.parametrize("known", [{"mass": 3.2}, {"area1": 8e-4}])
def test_one_stated_number_holds_the_scale(known):
    b = bind(Cylinder(), piston(**known))
    problem = ProblemBuilder(b).problem(InverseDynamics(), "fit", b.free, b.theta)
    assert shrinking(problem, problem.z(b.theta)) == ()


def test_a_prior_holds_the_scale():
    data = replace(
        piston(),
        model=ModelSpec(parameters={"mass": ParameterPrior(prior={"mean": 3.2, "std": 0.1})}),
    )
    b = bind(Cylinder(), data)
    problem = ProblemBuilder(b).problem(InverseDynamics(), "fit", b.free, b.theta)
    assert shrinking(problem, problem.z(b.theta)) == ()


# ---- free swings


def released(seconds=20.0, drag=0.004, dry=0.003, rate=100):
    """A pendulum of 0.02 kg m^2 and 1.2 N m let go at 1.6 rad, with air drag and dry friction."""
    q, v, out, h = 1.6, 0.0, [], 0.1 / rate
    t = np.arange(0, seconds, 1 / rate)
    for _ in t:
        out.append(q)
        for _ in range(10):
            v -= h * (1.2 * np.sin(q) + drag * v * abs(v) + dry * np.tanh(v / 1e-4)) / 0.02
            q += h * v
    y = np.array(out) + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    data = jaxid.Dataset.from_arrays(t, {}, {"q": y}, noise_std={"q": 1e-3})
    left_out = ("constant_torque", "coulomb_friction")
    return replace(
        data, model=ModelSpec("pendulum", free=True, without=left_out, constants={"inertia": 0.02})
    )


def test_a_decay_is_told_from_a_coast_and_from_a_driven_motion():
    assert decays(bind(None, released(10.0)))
    t = np.arange(0, 6, 0.01)
    coast = jaxid.Dataset.from_arrays(t, {}, {"q": 3 * (1 - np.exp(-t))}, noise_std={"q": 1e-3})
    assert not decays(bind("joint", replace(coast, model=ModelSpec(free=True))))
    driven = jaxid.Dataset.from_arrays(
        t, {"tau": np.sin(9 * t)}, {"q": np.sin(9 * t)}, noise_std={"q": 1e-3}
    )
    assert not decays(bind("joint", driven))


@pytest.mark.slow
def test_a_long_decay_that_the_model_does_not_follow_is_fitted_by_windows():
    fit = jaxid.fit(None, released())
    assert fit.simulation == "windows" and fit.residual == "multiple_shooting"
    assert fit.free_run["fit"]["q"].rmse > fit.scores["fit"]["q"].rmse
    assert any("free swing through several amplitudes" in note for note in fit.notes)
    assert abs(fit.parameters["gravity_torque"].value - 1.2) < 0.03


def ended(
    state="converged",
    loss=1.0,
    nrmse=0.001,
    parameters=True,
    theta=0.0,
    spent=10,
    residual="output_error",
) -> Fit:
    """A fit as one may have ended."""
    score = {"fit": {"q": Score(nrmse, nrmse, nrmse, "rad")}}
    found = {"inertia": Estimate(0.2, 0.01, "kg m^2", 0.0, 1.0)} if parameters else {}
    return Fit(
        "pendulum",
        (),
        "lm",
        residual,
        "sum_of_squares",
        0,
        state == "converged",
        state == "failed",
        "",
        loss,
        found,
        score if parameters else {},
        {},
        spent,
        1.0,
        0.5,
        "d",
        "",
        theta=np.array([theta]),
    )


@pytest.fixture(scope="module")
def driven():
    t = np.arange(0, 6, 0.01)
    data = jaxid.Dataset.from_arrays(
        t, {"tau": np.sin(3 * t)}, {"q": np.sin(3 * t)}, noise_std={"q": 1e-3}
    )
    return ProblemBuilder(bind("pendulum", data))


def outcome(bench, first: Fit, growth: float, monkeypatch, **others: Fit) -> tuple[Fit, list[str]]:
    """What is believed, and what was fitted on the way; `others` by residual, `free` from where
    windows ended.
    """
    asked = []

    def fitted(residual, begin, spent):
        asked.append(residual.name if residual else "free")
        assert (begin is not None) == (residual is None) and spent >= first.evaluations
        return others[asked[-1]]

    monkeypatch.setattr(lost_runs, "growth", lambda bench, theta: growth)
    return lost_runs.believed(bench, first, LevenbergMarquardt(), fitted), asked


def test_a_free_run_that_follows_is_kept(driven, monkeypatch):
    for first in (ended(), ended(loss=1e5, nrmse=0.02)):
        assert outcome(driven, first, 1e6, monkeypatch) == (first, [])


def test_a_free_run_that_forgets_its_start_gives_way_to_windows(driven, monkeypatch):
    windows = ended(loss=30.0, spent=40, residual="multiple_shooting")
    fit, asked = outcome(
        driven, ended(loss=1e6, nrmse=0.2), 1e4, monkeypatch, multiple_shooting=windows
    )
    assert (
        asked == ["multiple_shooting"]
        and fit.residual == "multiple_shooting"
        and fit.evaluations == 50
    )
    assert "grows 1e+04 times" in fit.notes[-1] and "windows" in fit.notes[-1]


def test_a_free_run_that_went_astray_is_searched_again_from_where_windows_ended(
    driven, monkeypatch
):
    windows = ended(loss=30.0, residual="multiple_shooting")
    first, better, worse = ended(loss=1e6, nrmse=0.9), ended(loss=1.1), ended(loss=2e6)
    fit, asked = outcome(driven, first, 2.0, monkeypatch, multiple_shooting=windows, free=better)
    assert asked == ["multiple_shooting", "free"] and fit.loss == 1.1 and fit.evaluations == 30
    fit, _ = outcome(driven, first, 2.0, monkeypatch, multiple_shooting=windows, free=worse)
    assert fit.loss == 1e6


def test_a_diverged_run_is_compared_by_torque_and_says_so(driven, monkeypatch):
    torque = ended(loss=3.0, residual="inverse_dynamics")
    first = ended("failed", np.inf, parameters=False)
    fit, asked = outcome(driven, first, 0.0, monkeypatch, inverse_dynamics=torque)
    assert (
        asked == ["inverse_dynamics"]
        and fit.residual == "inverse_dynamics"
        and lost_runs.DIVERGES in fit.notes
    )


@pytest.mark.slow
def test_windows_of_a_pendulum_thrown_over_the_top_have_intervals_that_mean_something():
    """0.18 kg m^2, 3.6 N m and a drag that the model lacks."""
    t = np.arange(0, 20, 0.01)
    u = 1.6 * np.sin(2 * np.pi * 0.62 * t) + 1.2 * np.sin(2 * np.pi * 0.23 * t + 1) + 0.08
    q, v, out = 0.0, 0.0, []
    for tau in u:
        out.append(q)
        for _ in range(20):
            v += (
                5e-4
                * (tau - 3.6 * np.sin(q) - 0.02 * v - 0.02 * v * abs(v) - 0.05 * np.tanh(v / 1e-3))
                / 0.18
            )
            q += 5e-4 * v
    y = np.array(out) + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    data = jaxid.Dataset.from_arrays(t, {"tau": u}, {"q": y}, noise_std={"q": 1e-3}, at_rest=True)
    fit = jaxid.fit("pendulum", data, residual="multiple_shooting")
    for name, value in {"inertia": 0.18, "gravity_torque": 3.6}.items():
        p = fit.parameters[name]
        assert p.std and abs(p.value - value) < 4 * p.std and p.std < 0.2 * value
    # The picture shows what was compared: a free run over the top goes anywhere.
    for trace in fit.traces:
        rms = np.sqrt(np.mean((trace.measured - trace.simulated["fit"]) ** 2))
        assert trace.windows and np.isclose(rms, fit.scores[trace.split]["q"].rmse, rtol=1e-6)
        assert fit.free_run[trace.split]["q"].rmse > rms


# ---- channels of different resolution


class CartPole(Rigid):
    """A cart on a belt drive with a pole."""

    name: ClassVar[str] = "cart_pole"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature(
            (("u", "V"),), (("x", "m"), ("phi", "rad")), ("x", "phi"), prismatic=(True, False)
        ),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
    )
    equations: ClassVar[str] = (
        "[mass, pole cos phi; pole cos phi, swing] qdd = [gain u + pole sin phi w^2, -g pole sin phi]"
    )
    source: ClassVar[str] = "textbook"
    mass: Array = param(1.0, 1e-2, 1e2, unit="kg", log=True)
    pole: Array = param(0.05, 1e-4, 10.0, unit="kg m", log=True)
    swing: Array = param(0.02, 1e-5, 1.0, unit="kg m^2", log=True)
    gain: Array = constant(8.0, unit="N/V")

    def drive(self, signature, u, q, qd):
        return jnp.stack([self.gain * u[0], 0.0 * u[0]])

    def matrices(self, q, qd):
        c, s = jnp.cos(q[1]), jnp.sin(q[1])
        M = jnp.array([[self.mass, self.pole * c], [self.pole * c, self.swing]])
        return M, jnp.stack([-self.pole * s * qd[1] ** 2, 9.81 * self.pole * s])


POLE = {"mass": 0.8, "pole": 0.06, "swing": 0.016}


def cart(dry: float, noise=(2e-5, 5e-3)):
    """Dry friction of the cart, which the model lacks; its encoder is far finer than the pole's."""
    t, rng = np.arange(0, 8, 0.01), np.random.default_rng(0)
    u = 0.9 * np.sin(2 * np.pi * 0.9 * t) + 0.6 * np.sin(2 * np.pi * 0.37 * t + 0.4)
    m, p, J = POLE.values()

    def slope(x, volts):
        c, s = np.cos(x[1]), np.sin(x[1])
        force = 8 * volts - 4 * x[2] - dry * np.tanh(x[2] / 2e-3) + p * s * x[3] ** 2
        torque = -9.81 * p * s - 0.002 * x[3]
        det = m * J - (p * c) ** 2
        return np.array(
            [x[2], x[3], (J * force - p * c * torque) / det, (m * torque - p * c * force) / det]
        )

    x, out, h = np.zeros(4), [], 1e-3
    for volts in u:
        out.append(x[:2])
        for _ in range(10):
            k1 = slope(x, volts)
            k2 = slope(x + h / 2 * k1, volts)
            x = x + h * slope(x + h / 2 * k2, volts)
    y = np.array(out) + np.array(noise) * rng.standard_normal((len(t), 2))
    units, levels = {"u": "V", "x": "m", "phi": "rad"}, dict(zip(("x", "phi"), noise, strict=True))
    return jaxid.Dataset.from_arrays(
        t, {"u": u}, {"x": y[:, 0], "phi": y[:, 1]}, units=units, noise_std=levels, at_rest=True
    )


@pytest.mark.slow
def test_a_fine_encoder_does_not_pin_a_coarse_one():
    fit = jaxid.fit(CartPole(), cart(1.5))
    assert fit.reweighted_loss is not None and fit.reweighted_loss < fit.loss
    assert any("weighed by what the model leaves" in note for note in fit.notes)
    assert fit.scores["fit"]["phi"].nrmse < 0.5
    assert abs(fit.parameters["swing"].value / POLE["swing"] - 1) < 0.3
    assert fit.to_dict()["reweighted_loss"] == fit.reweighted_loss
