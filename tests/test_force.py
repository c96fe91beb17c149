"""Least squares on the force that a model lacks, beside SciPy and NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from jaxid.force.covariance import (
    correlation_time,
    covariance_of_rows,
    no_narrower,
    of_joints,
    of_scores,
    sandwich,
)
from jaxid.force.least_squares import NormalEquations, Rows, solve
from jaxid.force.rows import ForceRows


def a_problem(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns of unlike sizes, a target, and the numbers that made it."""
    count = int(rng.integers(1, 30))
    A = rng.normal(size=(60, count)) * 10 ** rng.uniform(-2, 2, count)
    x = rng.normal(size=count)
    return A, A @ x + rng.normal(size=60), x


@pytest.mark.parametrize("kind", [NormalEquations.of_rows, Rows])
def test_numbers_within_bounds_are_the_best_there(kind):
    rng = np.random.default_rng(0)
    for _ in range(60):
        A, b, x = a_problem(rng)
        low = x - rng.exponential(size=len(x)) * rng.choice([0.01, 10.0], len(x))
        high = low + 0.01 + 3 * rng.exponential(size=len(x))
        found, held = solve(kind(A, b), np.zeros(len(x)), low, high)
        assert np.all((low <= found) & (found <= high))
        assert np.all((found == low)[held] | (found == high)[held])
        least = 2 * lsq_linear(A, b, (low, high), method="bvls").cost
        assert np.sum((A @ found - b) ** 2) <= least * (1 + 1e-9)


@pytest.mark.parametrize("kind", [NormalEquations.of_rows, Rows])
def test_without_bounds_numbers_are_those_of_numpy(kind):
    rng = np.random.default_rng(1)
    for _ in range(20):
        A, b, _ = a_problem(rng)
        found, held = solve(kind(A, b), np.zeros(A.shape[1]))
        least = np.linalg.lstsq(A, b, rcond=None)[0]
        assert np.allclose(found, least, rtol=1e-4, atol=1e-4)
        assert np.sum((A @ found - b) ** 2) <= np.sum((A @ least - b) ** 2) * (1 + 1e-9)
        assert not held.any()


@pytest.mark.parametrize("kind", [NormalEquations.of_rows, Rows])
def test_what_is_left_open_stays_at_the_start(kind):
    """Of two equal columns the sum alone is told, of an empty one nothing."""
    rng = np.random.default_rng(2)
    own = rng.normal(size=50)
    A = np.column_stack([own, own, np.zeros(50)])
    start = np.array([3.0, 1.0, 7.0])
    found, _ = solve(kind(A, 10 * own), start)
    assert np.allclose(found, [6.0, 4.0, 7.0], atol=1e-6)


def test_what_is_known_beforehand_is_a_ridge():
    rng = np.random.default_rng(3)
    A, b, x = a_problem(rng)
    std = rng.uniform(0.01, 1.0, len(x))
    beside = NormalEquations.of_rows(A, b).beside(np.diag(std**-2.0), x)
    found, _ = solve(beside, np.zeros(len(x)))
    wide, target = np.concatenate([A, np.diag(1 / std)]), np.concatenate([b, x / std])
    assert np.allclose(found, np.linalg.lstsq(wide, target, rcond=None)[0], rtol=1e-6)


def test_instruments_have_no_part_in_what_is_left():
    rng = np.random.default_rng(4)
    Z = rng.normal(size=(200, 3))
    A, b = Z @ rng.normal(size=(3, 3)) + rng.normal(size=(200, 3)), rng.normal(size=200)
    found, _ = solve(Rows.projected(A, b, Z), np.zeros(3))
    assert np.allclose(Z.T @ (A @ found - b), 0.0, atol=1e-9)


def test_a_number_without_room_stays_where_it_is():
    A, b = np.eye(2), np.array([5.0, 5.0])
    bound = np.array([1.0, 9.0])
    found, held = solve(Rows(A, b), np.ones(2), np.array([1.0, 0.0]), bound)
    assert np.array_equal(found, [1.0, 5.0]) and list(held) == [True, False]


def rows_with_noise(rng: np.random.Generator, theta: np.ndarray, count: int = 400) -> ForceRows:
    """Two runs of two joints with white noise of unlike sizes."""
    columns = [rng.normal(size=(count, 2, len(theta))) for _ in range(2)]
    noise = [rng.normal(size=(count, 2)) * np.array([0.1, 0.5]) for _ in range(2)]
    return ForceRows.of(columns, [W @ theta + e for W, e in zip(columns, noise, strict=True)])


def test_triangles_stand_for_all_rows():
    rng = np.random.default_rng(5)
    theta = rng.normal(size=4)
    rows = rows_with_noise(rng, theta)
    weights = [np.array([2.0, 0.3]), np.array([1.0, 5.0])]
    A, b = rows.stacked(weights)
    few, target = rows.triangles().stacked(weights)
    assert len(few) < len(A) / 10
    assert np.allclose(few.T @ few, A.T @ A) and np.allclose(few.T @ target, A.T @ b)
    assert np.allclose(rows.triangles().rms(theta), rows.rms(theta))
    assert np.allclose(rows.weighted(weights).stacked(rows.plain_weights())[0], A)


@pytest.mark.parametrize("scores", [of_joints, of_scores])
def test_standard_deviations_are_how_far_estimates_scatter(scores):
    """Of 200 recordings with white noise, those of the first told beforehand."""
    rng = np.random.default_rng(6)
    theta = np.array([1.0, -2.0, 0.5])
    found, told = [], []
    for _ in range(200):
        rows = rows_with_noise(rng, theta, count=60)
        weights = [np.array([10.0, 2.0])] * 2
        x, _ = solve(Rows(*rows.stacked(weights)), np.zeros(3))
        found.append(x)
        told.append(np.diag(covariance_of_rows(rows, weights, x, scores).matrix))
    scatter = np.std(found, axis=0)
    assert np.allclose(np.sqrt(np.mean(told, axis=0)) / scatter, 1.0, atol=0.25)


def test_a_covariance_is_positive_semidefinite_and_no_narrower_than_the_least():
    rng = np.random.default_rng(7)
    for _ in range(20):
        root = rng.normal(size=(3, 6))  # of fewer directions than numbers
        slope, least = np.diag(10 ** rng.uniform(-3, 3, 6)), np.diag(rng.uniform(0.1, 1.0, 6))
        made = sandwich(slope, root.T @ root, least, 1e-10)
        size = np.sqrt(np.diag(made))
        assert np.linalg.eigvalsh(made / size / size[:, None]).min() > -1e-12
        assert np.all(size >= np.sqrt(np.diag(least)) / np.diag(slope) * (1 - 1e-9))


def test_a_variance_that_rounding_took_is_the_least_one():
    """Stretched from nothing it would be no number, and so would all that goes with it."""
    made = np.array([[4.0, 1.0, 1e-3], [1.0, 1.0, 0.0], [1e-3, 0.0, 0.0]])
    wider = no_narrower(made, np.array([1.0, 4.0, 9.0]))
    assert np.allclose(wider, [[4.0, 2.0, 0.0], [2.0, 4.0, 0.0], [0.0, 0.0, 9.0]])


def test_rows_that_share_noise_count_less():
    rng = np.random.default_rng(8)
    white = rng.normal(size=4000)
    slow = np.convolve(rng.normal(size=4020), np.ones(20), "valid")[:4000]
    assert correlation_time([white], 1000) < 1.5
    assert 12 < correlation_time([slow], 1000) < 28
