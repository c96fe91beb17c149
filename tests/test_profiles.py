"""Profiles and bootstrap against what is known of linear problems, and where a parabola
misleads.
"""

from __future__ import annotations

import numpy as np
import pytest

from jaxid.fitting.covariance import covariance
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.profiles import bootstrap, profile_likelihood
from jaxid.problem.binding import bind
from jaxid.problem.residual import OutputError
from test_fitters import data_of


@pytest.fixture(scope="module")
def fitted():
    binding = bind(None, data_of("joint"))
    problem = ProblemBuilder(binding).problem(OutputError(), "fit", binding.free, binding.theta)
    return problem, levenberg_marquardt([(problem, problem.z(binding.theta))], 60, 1e-12)[0].z


def test_profile_of_a_well_determined_fit_is_the_covariance(fitted):
    problem, z = fitted
    cov, theta, slope = covariance(problem, z), problem.theta(z), problem.dtheta(z)
    profiles = profile_likelihood(problem, z)
    assert list(profiles) == problem.names[: problem.free.size]
    for k, (name, p) in enumerate(profiles.items()):
        std, value = cov.std[k] * slope[k], theta[problem.free[k]]
        low, high = p.interval
        assert low is not None and high is not None and low < value < high
        assert (high - low) / (2 * 1.96 * std) == pytest.approx(1, abs=0.15), name
        assert np.all(np.diff(p.values) > 0) and p.rise.min() == 0
    assert (
        profiles["inertia"].unit == "kg m^2"
        and profiles["inertia"].plot().get_xlabel() == "inertia (kg\u00a0m^2)"
    )


def test_profile_needs_no_absolute_step(fitted):
    """Bounds a thousand times wider change nothing: steps come from the standard deviation."""
    problem, z = fitted
    name = problem.names[1]
    lower, upper = 0.2 * problem.whole[0], 1000 * problem.whole[1]
    wide = type(problem)(problem.runs, problem.base, problem.free, lower, upper, problem.records)
    theta = problem.theta(z)
    a = profile_likelihood(problem, z, [name])[name].interval
    b = profile_likelihood(wide, wide.z(theta, problem.starts(z)), [name])[name].interval
    assert a[0] is not None and b[0] is not None and a[1] is not None and b[1] is not None
    assert np.allclose([a[0], a[1]], [b[0], b[1]], rtol=1e-3)


def test_profile_at_a_bound_has_one_end(fitted):
    """The friction bound just below the best value: the interval is open on that side and says that
    the bound is why.
    """
    problem, z = fitted
    theta = problem.theta(z)
    i = problem.runs.layout.index("coulomb")
    lower, upper, scale = (a.copy() for a in problem.whole)
    upper[i] = theta[i] - 0.5 * covariance(problem, z).std[list(problem.free).index(i)]
    tight = type(problem)(
        problem.runs, problem.base, problem.free, lower, upper, problem.records, scale=scale
    )
    end = levenberg_marquardt([(tight, tight.z(theta, problem.starts(z)))], 40, 1e-12)[0].z
    p = profile_likelihood(tight, end, ["coulomb"])["coulomb"]
    assert p.interval[1] is None and p.at_bound[1]
    assert p.interval[0] is not None and p.interval[0] < upper[i]


def test_bootstrap_agrees_with_the_covariance_of_white_residuals(fitted):
    problem, z = fitted
    cov, slope = covariance(problem, z), problem.dtheta(z)
    found = bootstrap(problem, z, 150, seed=1)
    again = bootstrap(problem, z, 10, seed=1)
    assert found.failed == 0 and found.samples.shape == (150, problem.free.size)
    assert np.array_equal(again.samples, found.samples[:10])
    for k, name in enumerate(found.names):
        assert found.std[name] / (cov.std[k] * slope[k]) == pytest.approx(1, abs=0.25), name
        low, high = found.interval()[name]
        assert low < problem.theta(z)[problem.free[k]] < high


def test_bootstrap_of_coloured_residuals_keeps_their_colour(fitted):
    """Residuals with a memory widen the intervals as the covariance does; independent draws would
    not.
    """
    problem, z = fitted
    rng = np.random.default_rng(0)
    at = problem.runs.record(problem.records[0]).samples
    noise = rng.standard_normal(len(at))
    for i in range(1, len(at)):
        noise[i] = 0.9 * noise[i - 1] + np.sqrt(1 - 0.81) * noise[i]
    targets = problem.targets.copy()
    targets[at, 0] = problem.predictions(z)[0][:, 0] + 1e-3 * noise
    coloured = problem.with_targets(targets)
    end = levenberg_marquardt([(coloured, z)], 40, 1e-12)[0].z
    cov, slope = covariance(coloured, end), problem.dtheta(end)
    assert not cov.white
    found = bootstrap(coloured, end, 150)
    assert found.memory > 5
    ratio = (
        np.array([found.std[n] for n in found.names]) / (cov.std * 1.0)[: len(found.names)] / slope
    )
    assert np.all(ratio > 0.4) and np.all(ratio < 1.8)
