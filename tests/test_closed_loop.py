"""Controllers, closed-loop simulation, linear estimators; EMPS where its recordings are at hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jaxid
from benchmarks import closed_loop as twin, emps_inverse as emps
from jaxid.base.errors import UsageError
from jaxid.data.dataset import Controller, Dataset, ParameterPrior
from jaxid.dynamics.controller import law_of
from jaxid.fitting.controlled_motion import simulate_closed_loop
from jaxid.problem.binding import bind


LAW: dict[str, Any] = {"kp": 3.0, "kd": 0.4}


@pytest.fixture(scope="module")
def quiet() -> Dataset:
    """The twin without noise."""
    return twin.recording(twin.simulate([0], 0.0, 0.0), 0)


def law(data: Dataset, kind: str, settings: dict[str, Any]):
    data = replace(data, controller=Controller(kind, settings))
    return law_of(data, bind("joint", data).chain.signature)


def test_closed_loop_simulation_follows_the_exact_twin(quiet):
    """Positions and torques of the product's closed loop against the twin's closed-form
    integration.
    """
    b = bind("joint", quiet, splits=False)
    theta = b.theta.copy()
    for name, value in twin.TRUTH.items():
        theta[b.layout.index(name)] = value
    ((q, u),) = simulate_closed_loop(b.dataset, b.dataset.experiments, b.layout, theta, b.sigma)
    e = quiet.experiments[0]
    assert np.max(np.abs(q - e.y)) < 1e-5 * np.ptp(e.y)
    assert np.max(np.abs(u - e.u)) < 1e-3 * np.max(np.abs(e.u))


@pytest.mark.parametrize(
    "kind, settings, words",
    [
        ("pdd", LAW, "pd"),
        ("pd", {**LAW, "kpp": 1.0}, "kp"),
        ("pd", {"kp": 1.0}, "'kd' is missing"),
        ("cascade", LAW, "kv"),
        ("pd", {**LAW, "velocity": "differenc"}, "difference"),
        ("pd", {**LAW, "kp": [1.0, 2.0]}, "one per joint"),
        ("pd", {**LAW, "reference": "q_cnd"}, "q_cmd"),
        ("pd", {**LAW, "sample_time": 0.0}, "positive"),
    ],
)
def test_a_wrong_controller_is_refused_by_name(quiet, kind, settings, words):
    with pytest.raises(UsageError, match=words):
        law(quiet, kind, settings)


def test_a_controller_slower_than_the_recording_holds_its_output(quiet):
    data = replace(
        quiet,
        controller=Controller("pid", {**LAW, "ki": 1.0, "sample_time": 0.01, "saturation": 0.3}),
    )
    b = bind("joint", data, splits=False)
    ((_, u),) = simulate_closed_loop(data, data.experiments, b.layout, b.theta, b.sigma)
    assert np.isfinite(u).all() and np.max(np.abs(u)) <= 0.3
    changes = np.flatnonzero(np.diff(u[:, 0]))
    assert changes.size and np.all((changes + 1) % 5 == 0)


def test_linear_estimators_refuse_what_they_cannot_do(quiet):
    with pytest.raises(UsageError, match=r"\[controller\]"):
        jaxid.fit("joint", replace(quiet, controller=None), fitter="iv")
    with pytest.raises(UsageError, match="inverse_dynamics"):
        jaxid.fit("joint", quiet, fitter="ls", residual="output_error")
    with pytest.raises(UsageError, match="linear in its parameters.*stribeck"):
        jaxid.fit("joint", quiet, fitter="ls", effects=["stribeck_friction"])
    with pytest.raises(UsageError, match="closed_loop|controller"):
        jaxid.fit("joint", replace(quiet, controller=None), residual="closed_loop")


def test_recursion_ends_where_least_squares_does(quiet):
    """Without forgetting; with it the later samples count more, and the estimate of a clean twin
    stays.
    """
    batch = jaxid.fit("joint", quiet, fitter="ls")
    stream = jaxid.fit("joint", quiet, fitter="rls")
    forgets = jaxid.fit(
        "joint", quiet, fitter=jaxid.fitters.RecursiveLeastSquares(forgetting=0.999)
    )
    assert stream.residual == "inverse_dynamics" and stream.fitter == "rls"
    for name, p in batch.parameters.items():
        assert stream.parameters[name].value == pytest.approx(p.value, rel=1e-5, abs=1e-7), name
        assert stream.parameters[name].std == pytest.approx(p.std, rel=1e-3), name
        assert forgets.parameters[name].value == pytest.approx(p.value, rel=0.05, abs=2e-3), name
    assert forgets.parameters["inertia"].value != batch.parameters["inertia"].value


@pytest.mark.slow
def test_least_squares_is_the_minimum_that_lm_finds_and_keeps_bounds(quiet):
    linear = jaxid.fit("joint", quiet, fitter="ls")
    general = jaxid.fit("joint", quiet, fitter="lm", residual="inverse_dynamics")
    assert linear.residual == "inverse_dynamics"
    assert linear.loss == pytest.approx(general.loss, rel=1e-8)
    assert quiet.model is not None
    tight = replace(quiet.model, parameters={"viscous": ParameterPrior(0.1, 0.0, 0.15)})
    bounded = jaxid.fit("joint", replace(quiet, model=tight), fitter="ls")
    assert bounded.parameters["viscous"].at_bound and bounded.parameters[
        "viscous"
    ].value == pytest.approx(0.15)
    assert bounded.loss > linear.loss


def test_a_bound_leaves_the_covariance_positive_semidefinite(quiet):
    assert quiet.model is not None
    tight = replace(quiet.model, parameters={"viscous": ParameterPrior(0.1, 0.0, 0.15)})
    bounded = jaxid.fit("joint", replace(quiet, model=tight), fitter="ls")
    viscous = bounded.parameters["viscous"]
    assert viscous.at_bound and viscous.std is not None and viscous.std > 0
    assert bounded.covariance is not None
    C = bounded.covariance.matrix
    size = np.sqrt(np.diag(C))
    assert np.linalg.eigvalsh(C / size / size[:, None]).min() > -1e-9


def test_instruments_remove_the_bias_of_least_squares():
    """Reduced study; benchmarks/closed_loop.py has 60 seeds and all methods."""
    found = twin.study(range(8), ("ls", "iv"))
    ls, iv = (twin.summary(found[m]) for m in ("ls", "iv"))
    assert abs(ls["claimed"][0]) > 1.5, ls
    assert np.all(np.abs(iv["bias"]) < 1.0), iv
    assert np.mean(iv["coverage"]) >= 0.8, iv


@pytest.mark.skipif(
    not emps.folder().is_dir(), reason="the EMPS recordings are not here (JAXID_DATA)"
)
def test_emps_least_squares_agrees_with_the_published_estimate():
    data = emps.load()
    fit = emps.nominal(data)
    for name, (value, two_sigma) in emps.PUBLISHED.items():
        assert abs(fit.parameters[name].value - value) <= two_sigma, name
    train, test = emps.force_errors(data, fit)
    assert train <= 0.036 and test <= 0.043, (train, test)
    (force, position), (force_test, position_test) = emps.closed_loop(data, fit)
    assert force <= 0.0526 and force_test <= 0.0741, (force, force_test)
    assert position <= 1.8e-6 and position_test <= 2.8e-6, (position, position_test)
