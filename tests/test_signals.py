"""Filtering and differentiation against signals whose derivatives are known."""

from __future__ import annotations

import numpy as np
import pytest

from jaxid.data.signals import (
    content_cutoff,
    decimate,
    differentiate,
    filter_ends,
    followed,
    start_state,
    zero_phase,
)


T = 0.001 * np.arange(4000)
W = 2 * np.pi * 2


def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.sin(W * t), W * np.cos(W * t), -(W**2) * np.sin(W * t)


def irregular(seed: int = 0) -> np.ndarray:
    return np.sort(T + 0.0003 * np.random.default_rng(seed).uniform(-1, 1, len(T)))


@pytest.mark.parametrize("t", [T, irregular()], ids=["regular", "irregular"])
def test_velocity_and_acceleration(t):
    q, qd, qdd = motion(t)
    found = differentiate(t, q, 50.0)
    inner = slice(filter_ends(t, 50.0), -filter_ends(t, 50.0))
    for got, true in zip(found[:3], (q, qd, qdd), strict=True):
        assert got.shape == t.shape
        assert np.max(np.abs(got - true)[inner]) < 2e-3 * np.max(np.abs(true))


def test_noise_is_damped_and_nothing_is_shifted():
    q, qd, _ = motion(T)
    noisy = q + 1e-3 * np.random.default_rng(0).standard_normal(len(T))
    _, found, _, _ = differentiate(T, noisy, 20.0)
    inner = slice(200, -200)
    assert np.std((found - qd)[inner]) < 0.02 * np.std(qd)
    shift = [np.sum(np.roll(found, k)[inner] * qd[inner]) for k in range(-5, 6)]
    assert abs(int(np.argmax(shift)) - 5) <= 1


def test_the_statement_says_what_was_done():
    statement = differentiate(T, motion(T)[0], 50.0)[3]
    assert (
        "order 4" in statement
        and "cutoff 50 Hz" in statement
        and "40 samples at each end" in statement
    )
    assert "irregular" in differentiate(irregular(), motion(irregular())[0], 50.0)[3]


def test_several_columns_are_filtered_alike():
    q = np.stack(motion(T), axis=1)
    together = zero_phase(T, q, 30.0)
    np.testing.assert_allclose(together[:, 1], zero_phase(T, q[:, 1], 30.0))


def test_cutoff_halves_the_amplitude():
    tone = np.sin(2 * np.pi * 40 * T)
    found = zero_phase(T, tone, 40.0)[1000:-1000]
    assert np.max(np.abs(found)) == pytest.approx(0.5, rel=0.01)


def test_decimation_keeps_the_motion_and_drops_what_would_alias():
    q = motion(T)[0] + 0.5 * np.sin(2 * np.pi * 190 * T)
    t, x, text = decimate(T, q, 25)
    assert len(t) == len(x) == 160 and "16 Hz" in text
    assert np.max(np.abs(x - motion(t)[0])[5:-5]) < 1e-3
    t, x, text = decimate(T, q, 1)
    np.testing.assert_array_equal(x, q)
    assert text == "not decimated"


def test_start_state():
    t = T + 3
    q0, qd0, text = start_state(
        t, np.stack([0.2 + 1.5 * (t - 3), 4 - 2 * (t - 3) + (t - 3) ** 2], axis=1)
    )
    np.testing.assert_allclose(q0, [0.2, 4.0])
    np.testing.assert_allclose(qd0, [1.5, -2.0])
    assert "101 samples" in text
    q0, qd0, _ = start_state(t, 0.2 + 1.5 * (t - 3), window_s=0.02)
    assert (float(q0), float(qd0)) == pytest.approx((0.2, 1.5))


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 500.0, 600.0, np.nan])
def test_impossible_cutoffs_are_refused(cutoff):
    with pytest.raises(ValueError, match="cutoff"):
        zero_phase(T, motion(T)[0], cutoff)


def test_impossible_signals_are_refused():
    with pytest.raises(ValueError, match="expected"):
        zero_phase(T, motion(T)[0][:-1], 10.0)
    with pytest.raises(ValueError, match="increase"):
        zero_phase(T[::-1], motion(T)[0], 10.0)
    with pytest.raises(ValueError, match="factor"):
        decimate(T, motion(T)[0], 0)
    with pytest.raises(ValueError, match="too few"):
        start_state(T[:3], T[:3])


def test_short_records_are_filtered_too():
    t = 0.01 * np.arange(12)
    assert np.isfinite(zero_phase(t, np.sin(t), 5.0)).all()


def test_a_polynomial_is_asked_no_more_than_it_follows():
    t, rng = np.arange(500) * 2e-4, np.random.default_rng(0)
    noise = 1e-3 * rng.standard_normal((500, 1))
    assert followed(t, 0.3 + 2 * t[:, None] + noise) == pytest.approx(t[-1])
    assert followed(t, np.floor(40 * t[:, None])) == pytest.approx(t[-1])  # a counter's steps
    fast = np.sin(60 * t) + noise[:, 0]
    short = followed(t, fast[:, None])
    near, far = (abs(float(start_state(t, fast, window)[0])) for window in (short, float(t[-1])))
    assert short < 0.06 and near < 0.1 < far


@pytest.mark.parametrize("rows", [200, 500, 5000])
def test_noise_of_a_short_record_is_no_content(rows):
    """A spectrum of few segments reaches far above its mean by chance; motion at 1 Hz stays all
    that there is.
    """
    t = np.arange(rows) / 100
    for seed in range(20):
        noise = 8e-4 * np.random.default_rng(seed).standard_normal(rows)
        assert content_cutoff(t, 0.3 * np.sin(2 * np.pi * t + seed) + noise, 8e-4) < 6
