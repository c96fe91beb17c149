"""Draws about a fit: against posteriors that are known in closed form, and against how often the
truth lies inside.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxid
from jaxid.fitting.nuts import Box, sample, Sampling
from jaxid.fitting.posterior import unsettled
from jaxid.numerics.precision import float64
from jaxid.report.result_files import save


pytest.importorskip("blackjax")
arviz = pytest.importorskip("arviz")

SHORT = Sampling(chains=2, draws=200, warmup=100)
TRUTH = {"inertia": 0.05, "gravity_torque": 1.0, "viscous": 0.05, "offset": 0.0}
NOISE = 1e-3


def linear(w: Any, box: Box, data: Any) -> Any:
    """Log-density of w where y = A z + noise of 1, z flat within the box."""
    A, y = data
    z = box.z(w)
    return -jnp.sum((A @ z - y) ** 2) / 2 + box.log_slope(w)


def drawn(A: np.ndarray, y: np.ndarray, lower: float, upper: float, z: np.ndarray) -> Any:
    with float64():
        bounds = np.full(z.size, lower), np.full(z.size, upper)
        box = Box.about(*bounds, z, A.T @ A)
        found = sample(linear, box, (jnp.asarray(A), jnp.asarray(y)), Sampling(4, 1000, 200))
    assert not found.diverging.any()
    return found.z.reshape(-1, z.size)


def test_a_linear_problem_has_the_posterior_of_the_textbook():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(40, 3)) * [1.0, 10.0, 0.1]
    A[:, 2] += 0.05 * A[:, 0]
    y = A @ [1.0, -0.3, 4.0] + rng.normal(size=40)
    covariance = np.linalg.inv(A.T @ A)
    mean = covariance @ A.T @ y
    z = drawn(A, y, -1e4, 1e4, mean)
    std = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((z.mean(0) - mean) / std, 0.0, atol=0.1)
    np.testing.assert_allclose(
        np.cov(z.T) / np.outer(std, std), covariance / np.outer(std, std), atol=0.12
    )


def test_progress_counts_the_warm_up_and_says_what_it_does():
    rng = np.random.default_rng(3)
    A, told = rng.normal(size=(40, 3)), []
    y = A @ [1.0, -0.3, 4.0]
    with float64():
        box = Box.about(np.full(3, -9.0), np.full(3, 9.0), np.zeros(3), A.T @ A)
        sample(
            linear, box, (jnp.asarray(A), jnp.asarray(y)), SHORT, progress=lambda *t: told.append(t)
        )
    total = SHORT.chains * (SHORT.warmup + SHORT.draws)
    assert told[0][:3] == ("posterior", 0, total) and told[0][3].startswith("compiling")
    assert told[-1] == ("posterior", total, total, f"{total} of {total} draws")


@pytest.mark.parametrize("bounds", [(0.0, 50.0), (0.0, np.inf)])
def test_a_number_at_its_bound_has_half_a_normal_distribution(bounds):
    lower, upper = bounds
    z = drawn(np.eye(1), np.zeros(1), lower, upper, np.zeros(1))
    assert z.min() >= 0
    assert z.mean() == pytest.approx(np.sqrt(2 / np.pi), abs=0.06)
    assert np.quantile(z, 0.95) == pytest.approx(1.96, abs=0.15)


def test_what_the_data_leave_open_is_flat_between_its_bounds():
    z = drawn(np.array([[1.0, 0.0]]), np.zeros(1), -3.0, 5.0, np.zeros(2))
    assert z[:, 1].mean() == pytest.approx(1.0, abs=0.3)
    assert z[:, 1].std() == pytest.approx(8 / np.sqrt(12), abs=0.25)


def test_chains_that_disagree_are_not_believed():
    diverging = np.zeros((4, 10), bool)
    assert unsettled({"a": (1.001, 900.0, 800.0)}, diverging) == []
    assert "R-hat of a" in unsettled({"a": (1.2, 900.0, 800.0)}, diverging)[0]
    assert "effective" in unsettled({"a": (1.0, 900.0, 80.0)}, diverging)[0]
    assert "R-hat" in unsettled({"a": (float("nan"), 900.0, 800.0)}, diverging)[0]
    diverging[1, 3] = True
    assert "diverged" in unsettled({"a": (1.0, 900.0, 800.0)}, diverging)[0]


def as_recorded(q: np.ndarray) -> jaxid.Dataset:
    t = np.arange(400) * 0.01
    tau = 0.6 * np.sin(3 * t) + 0.5 * np.sin(7.1 * t + 1)
    return jaxid.Dataset.from_arrays(
        t,
        {"tau": tau},
        {"q": q},
        units={"tau": "N m", "q": "rad"},
        noise_std={"q": NOISE},
        model="pendulum",
        at_rest=True,
    )


@pytest.fixture(scope="module")
def clean() -> np.ndarray:
    still = as_recorded(0.1 * np.arange(400.0))
    numbers = {name: {"value": value} for name, value in TRUTH.items()}
    simulated = jaxid.simulate(
        "pendulum", still, {"parameters": numbers | {"coulomb": {"value": 0.0}}}
    )
    return np.asarray(simulated.runs[0]["q"])


def fitted(clean: np.ndarray, seed: int, sampling: Sampling) -> jaxid.Fit:
    q = clean + NOISE * np.random.default_rng(seed).normal(size=clean.size)
    return jaxid.fit(
        "pendulum", as_recorded(q), without=["coulomb_friction"], posterior=sampling, seed=seed
    )


@pytest.fixture(scope="module")
def found(clean) -> jaxid.Fit:
    return fitted(clean, 0, SHORT)


def test_a_pendulum_agrees_with_its_own_fit(found):
    posterior = found.posterior
    assert posterior.divergences == 0 and 1.0 <= posterior.noise_factor < 1.2
    for name, marginal in posterior.parameters.items():
        estimate = found.parameters[name]
        assert abs(marginal.mean - estimate.value) < 0.5 * estimate.std
        assert marginal.std == pytest.approx(estimate.std, rel=0.3)
        low, high = marginal.profile_95
        assert abs(low - marginal.interval_95[0]) < estimate.std
        assert abs(high - marginal.interval_95[1]) < estimate.std
        assert 0.99 < marginal.r_hat < 1.1
    assert "start of record 0: q" in posterior.draws


def test_its_files_are_those_of_arviz(found, tmp_path):
    save(found, tmp_path)
    data = arviz.from_netcdf(tmp_path / "posterior.nc")
    assert data.posterior.sizes == {"chain": 2, "draw": 200}
    np.testing.assert_array_equal(data.posterior["inertia"], found.posterior.draws["inertia"])
    assert not data.sample_stats["diverging"].any()
    assert data.attrs["dataset_sha256"] == found.dataset_sha256
    assert (tmp_path / "posterior.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "report.html").read_text()
    assert ">Posterior</h2>" in page and "posterior.nc" in page
    assert "posterior of" in repr(found)
    assert found.to_dict()["posterior"]["parameters"]["inertia"]["unit"] == "kg m^2"


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_truth_lies_inside_as_often_as_it_is_said(clean):
    inside = []
    for seed in range(1, 13):
        posterior = fitted(clean, seed, SHORT).posterior
        assert posterior is not None
        for name, truth in TRUTH.items():
            low, high = posterior.parameters[name].interval_95
            inside.append(low <= truth <= high)
    # 48 intervals of 95 %, the numbers of one run dependent: 41 or fewer inside happen once in a
    # thousand.
    assert sum(inside) >= 42


@pytest.mark.slow
def test_a_model_that_misses_the_data_is_not_believed_for_its_number_of_samples(clean):
    t = np.arange(400) * 0.01
    q = clean + 0.03 * np.sin(2 * t) + NOISE * np.random.default_rng(5).normal(size=clean.size)
    fit = jaxid.fit("pendulum", as_recorded(q), without=["coulomb_friction"], posterior=SHORT)
    assert fit.posterior is not None and fit.posterior.noise_factor > 3
    for name, marginal in fit.posterior.parameters.items():
        std = fit.parameters[name].std
        assert std is None or marginal.std > 0.6 * std


def test_what_has_no_posterior_is_refused(clean):
    data = as_recorded(clean + NOISE)
    with pytest.raises(jaxid.UsageError, match="not a likelihood"):
        jaxid.fit("pendulum", data, loss="sum_of_abs", budget=50, posterior=True)
    with pytest.raises(jaxid.UsageError, match="one chain"):
        Sampling(chains=1)
