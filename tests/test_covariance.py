"""One covariance: positive semidefinite whatever the data leave open, one-sided where a bound
holds.
"""

from __future__ import annotations

from typing import Any, cast, NamedTuple
from unittest import mock

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from scipy.stats import truncnorm

from jaxid.fitting.covariance import covariance, CovarianceEstimate
from jaxid.numerics.truncated import moments_within, within_bounds


class Part(NamedTuple):
    """One record's residuals [samples 1] and their derivatives [samples 1 n]."""

    r: np.ndarray
    J: np.ndarray
    z_columns: list[int]


class Linear:
    """Residuals J z - y, of noise 1, as much of a problem as a covariance is made of."""

    by_windows = False

    def __init__(self, J: np.ndarray, y: np.ndarray, lower: np.ndarray, upper: np.ndarray):
        self.J, self.y, self.lower, self.upper = J, y, lower, upper
        self.size = J.shape[1]
        self.free, self.log = np.arange(self.size), np.zeros(self.size, bool)
        self.scale = 0.02 * (upper - lower)

    def precise(self) -> Linear:
        return self

    def known_before(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(0), np.zeros((0, self.size))

    def covariance(self, z: np.ndarray) -> CovarianceEstimate:
        part = Part((self.J @ z - self.y)[:, None], self.J[:, None], list(range(self.size)))
        with mock.patch("jaxid.fitting.covariance.rows", lambda jobs: [part]):
            return covariance(cast(Any, self), z)


def is_distribution(C: np.ndarray) -> bool:
    """Whether a covariance is finite, symmetric and positive semidefinite, in units of its
    diagonal.
    """
    size = np.sqrt(np.diag(C))
    R = C / np.outer(size, size)
    return bool(np.isfinite(R).all() and np.allclose(R, R.T) and np.linalg.eigvalsh(R)[0] > -1e-9)


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 6),
    st.integers(0, 6),
    st.integers(0, 6),
    st.booleans(),
)
@example(72333, 4, 1, 4, True)  # rounding of numbers that are all but known
def test_a_covariance_is_one_of_some_distribution(seed, n, rank, active, coloured):
    """Of random Jacobians, also of less than full rank and of columns of any size, with any numbers
    at their bounds.
    """
    rng = np.random.default_rng(seed)
    rank, active = min(rank, n), min(active, n)
    J = (
        rng.standard_normal((120, rank))
        @ rng.standard_normal((rank, n))
        * 10 ** rng.uniform(-4, 4, n)
    )
    r = rng.standard_normal(120)
    r = np.cumsum(r) if coloured else r
    z, width = rng.standard_normal(n), 10 ** rng.uniform(-3, 3, n)
    lower, upper = z - width, z + 10 ** rng.uniform(-3, 3, n)
    lower[:active] = z[:active]
    found = Linear(J, J @ z - r, lower, upper).covariance(z)
    assert is_distribution(found.matrix)
    assert found.at_bound[:active].all()
    told = np.isfinite(found.std)
    assert np.allclose(found.std[told] ** 2, np.diag(found.matrix)[told])
    assert np.array_equal(told, found.identifiable)
    within = np.hypot(upper - z, z - lower) * (1 + 1e-6)
    assert np.all(np.sqrt(np.diag(found.matrix)) <= within)


def test_what_is_far_from_its_bounds_has_the_least_squares_covariance():
    rng = np.random.default_rng(0)
    J, z = rng.standard_normal((400, 3)), np.array([1.0, -2.0, 0.5])
    r = rng.standard_normal(400)
    r -= J @ np.linalg.lstsq(J, r)[0]
    r *= np.sqrt(397 / (r @ r))
    found = Linear(J, J @ z - r, z - 100, z + 100).covariance(z)
    assert np.allclose(found.matrix, np.linalg.inv(J.T @ J), rtol=1e-4)


def test_two_that_the_data_tell_only_as_a_sum_are_bounded_by_it():
    """One stands at 0, and neither can be negative: each lies between 0 and the sum, and the sum is
    known.
    """
    total = 0.07
    J = np.full((200, 2), 50.0)
    rng = np.random.default_rng(0)
    z = np.array([0.0, total])
    found = Linear(
        J, J @ z - rng.standard_normal(200), np.zeros(2), np.array([14.0, 7.0])
    ).covariance(z)
    assert is_distribution(found.matrix)
    assert np.all(np.sqrt(np.diag(found.matrix)) < 0.8 * total)
    of_sum = float(np.sqrt(np.ones(2) @ found.matrix @ np.ones(2)))
    assert of_sum == pytest.approx(1 / (50 * np.sqrt(200)), rel=0.25)


def test_a_number_that_is_pushed_against_its_bound_frees_the_others():
    """The further the best value lies beyond the bound, the better the number is known to stand at
    it.
    """
    rng = np.random.default_rng(0)
    J = rng.standard_normal((300, 2)) @ np.array([[1.0, 0.9], [0.0, 0.4]])
    r = rng.standard_normal(300)
    std = []
    for beyond in (0.0, 0.05, 0.2):
        y = J @ np.array([-beyond, 0.0]) - r
        second = float(J[:, 1] @ y / (J[:, 1] @ J[:, 1]))
        z = np.array([0.0, second])
        std.append(Linear(J, y, np.array([0.0, -100.0]), np.full(2, 100.0)).covariance(z).std)
    held = float(np.sqrt(r @ r / 298 / (J[:, 1] @ J[:, 1])))
    assert std[0][0] > std[1][0] > std[2][0]
    assert std[0][1] > 1.2 * held


@pytest.mark.parametrize(
    "a, b", [(-np.inf, np.inf), (0.0, np.inf), (-1.0, 2.0), (3.0, 3.5), (-np.inf, -20.0)]
)
def test_moments_of_a_normal_variable_between_bounds(a, b):
    mean, variance = truncnorm.stats(a, b)
    assert moments_within(a, b) == pytest.approx(
        (float(mean), float(variance)), rel=1e-6, abs=1e-12
    )


def test_moments_in_a_box_are_those_of_draws_inside_it():
    rng = np.random.default_rng(0)
    A = rng.standard_normal((3, 3))
    lower, upper = np.array([-0.3, -np.inf, -1.0]), np.array([np.inf, 0.8, 0.5])
    draws = rng.multivariate_normal(np.zeros(3), A @ A.T, 200_000)
    draws = draws[((draws >= lower) & (draws <= upper)).all(1)]
    mean, C = within_bounds(A @ A.T, np.zeros(3), lower, upper)
    assert np.allclose(mean, draws.mean(0), atol=0.03)
    assert np.allclose(np.sqrt(np.diag(C)), draws.std(0), rtol=0.03)
