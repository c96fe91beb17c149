"""A descent over jumps, on residuals that are known."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxid.fitting import wide_slopes
from jaxid.fitting.wide_slopes import before_lost, descend_widely, is_noise


SAMPLES = np.linspace(0.0, 1.0, 200)
TRUE = np.array([0.7, -1.3])


def predicted(z: np.ndarray, jumps: float) -> np.ndarray:
    """A curve of two numbers that are rounded to so much."""
    a, b = np.round(z / jumps) * jumps
    return a * np.sin(5 * SAMPLES) + b * SAMPLES**2


def problem(lower: float = -5.0, upper: float = 5.0, size: int = 2) -> Any:
    return SimpleNamespace(
        size=size,
        scale=np.ones(size),
        lower=np.full(size, lower),
        upper=np.full(size, upper),
        known_before=lambda z: (np.zeros(0), np.zeros((0, size))),
        records=[0],
        runs=SimpleNamespace(record=lambda k: SimpleNamespace(samples=np.arange(len(SAMPLES)))),
        targets=np.zeros((len(SAMPLES), 1)),
    )


@pytest.fixture
def noisy(monkeypatch):
    """Residuals over a noise of 0.01 of curves that jump by the number that is given."""
    noise = np.random.default_rng(3).normal(size=len(SAMPLES))

    def use(jumps: float) -> None:
        target = predicted(TRUE, 1e-9) + 0.01 * noise
        monkeypatch.setattr(
            wide_slopes,
            "residuals",
            lambda p, points: [(predicted(z, jumps) - target) / 0.01 for z in points],
        )

    return use


def test_jumps_that_hide_every_slope_do_not_stop_it(noisy):
    noisy(5e-3)
    path, simulated = descend_widely(problem(), np.array([2.0, 1.0]), 40)
    assert path.loss < 1.2
    np.testing.assert_allclose(path.z, TRUE, atol=0.02)
    assert simulated > 40


def test_without_jumps_it_is_least_squares_with_its_curvature(noisy):
    noisy(1e-9)
    path, _ = descend_widely(problem(), np.array([2.0, 1.0]), 40)
    slopes = np.stack([np.sin(5 * SAMPLES), SAMPLES**2], 1) / 0.01
    start = (predicted(np.array([2.0, 1.0]), 1e-9) - predicted(TRUE, 1e-9)) / 0.01
    assert path.loss < np.mean(start**2)
    assert path.converged
    assert path.hessian is not None
    np.testing.assert_allclose(path.hessian, slopes.T @ slopes, rtol=1e-4)
    error = np.sqrt(np.diag(np.linalg.inv(path.hessian)))
    assert np.all(np.abs(path.z - TRUE) < 4 * error)


def test_at_the_noise_one_round_that_gains_nothing_ends_it(noisy, monkeypatch):
    noisy(1e-9)
    end, _ = descend_widely(problem(), TRUE, 40)
    _, at_noise = descend_widely(problem(), end.z, 40)
    monkeypatch.setattr(wide_slopes, "is_noise", lambda squares, count: False)
    _, elsewhere = descend_widely(problem(), end.z, 40)
    assert at_noise < elsewhere


def test_chance_makes_so_much_of_noise():
    noise = np.random.default_rng(5).normal(size=(200, 400))
    assert all(is_noise(float(r @ r), r.size) for r in noise)
    assert not is_noise(1.5 * 400, 400)
    assert not is_noise(np.inf, 400)


def test_a_run_is_followed_until_it_leaves_the_noise():
    r = np.random.default_rng(2).normal(size=300)
    assert before_lost(r).all()
    r[200:] += 8.0
    kept = before_lost(r)
    assert kept[:200].all()
    assert not kept[210:].any()
    r[50] = np.nan
    np.testing.assert_array_equal(np.flatnonzero(before_lost(r)), np.arange(50))


def test_where_a_well_is_narrow_it_is_looked_for_within_what_the_run_tells_before(monkeypatch):
    noise = np.random.default_rng(3).normal(size=len(SAMPLES))
    begun, about = np.arange(len(SAMPLES)) < 100, []

    def left(z):
        """The first half tells the first number; a run with another second one is lost after."""
        lost = 0.0 if abs(z[1] - TRUE[1]) < 0.1 else 30.0
        return noise + np.where(begun, (z[0] - TRUE[0]) / 0.01, lost)

    monkeypatch.setattr(wide_slopes, "residuals", lambda p, points: [left(z) for z in points])
    own = wide_slopes.WideDescent.look_about

    def counted(descent):
        about.append(descent.z.copy())
        return own(descent)

    monkeypatch.setattr(wide_slopes.WideDescent, "look_about", counted)
    path, _ = descend_widely(problem(), np.array([0.7, -1.8]), 40)
    assert about
    assert path.loss < 1.3
    np.testing.assert_allclose(path.z[0], TRUE[0], atol=0.01)


def test_it_stays_within_bounds(noisy):
    noisy(1e-9)
    path, _ = descend_widely(problem(upper=0.5), np.array([0.0, 0.0]), 20)
    assert path.z[0] <= 0.5
    assert path.z[0] == pytest.approx(0.5)


def test_points_that_diverge_are_left(noisy, monkeypatch):
    noisy(1e-9)
    own = wide_slopes.residuals

    def diverging(p, points):
        return [
            np.where(z[0] > 2.5, np.nan, r) for z, r in zip(points, own(p, points), strict=True)
        ]

    monkeypatch.setattr(wide_slopes, "residuals", diverging)
    path, _ = descend_widely(problem(), np.array([2.4, 1.0]), 40)
    assert path.loss < 1.2


def test_nothing_to_move_is_an_end(monkeypatch):
    monkeypatch.setattr(wide_slopes, "residuals", lambda p, points: [np.ones(10) for _ in points])
    path, simulated = descend_widely(problem(size=0), np.zeros(0), 10)
    assert path.converged
    assert path.loss == 1.0
    assert simulated == 1
