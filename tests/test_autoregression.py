"""Noise with a memory: against dense matrices, spectra, and the scatter of linear fits, where all
is known.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from jaxid.fitting.noise_model import (
    Autoregression,
    autoregressions,
    RecordResidual,
    score_covariance,
    student,
)


@settings(max_examples=30, deadline=None)
@given(st.floats(0, 0.95), st.floats(0, np.pi), st.floats(-0.9, 0.9), st.floats(0.1, 10))
def test_autocovariance_is_that_of_the_spectrum(radius, angle, real, size):
    roots = [radius * np.exp(1j * angle), radius * np.exp(-1j * angle), real]
    noise = Autoregression(-np.real(np.poly(roots))[1:], size)
    turn = np.exp(-2j * np.pi * np.arange(8192) / 8192)
    response = size / np.polyval(np.real(np.poly(roots))[::-1], turn)
    expected = np.fft.ifft(np.abs(response) ** 2).real[:30]
    assert np.allclose(noise.covariance(30), expected, rtol=1e-9, atol=1e-9 * expected[0])
    assert noise.memory() == pytest.approx(max(1.0, abs(response[0]) ** 2 / expected[0]))
    series = np.random.default_rng(0).normal(size=50)
    assert np.allclose(noise.whitened(noise.coloured(series)), series)


def regressors(n: int, rng: np.random.Generator) -> np.ndarray:
    t = 0.01 * np.arange(n)
    return np.stack(
        [np.ones(n)] + [np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (0.4, 0.9, 1.7)], 1
    )[:, None]


def test_score_covariance_is_that_of_the_dense_matrices():
    rng = np.random.default_rng(1)
    noise = [Autoregression(np.array([0.9]), 0.3), Autoregression(np.array([1.2, -0.4]), 2.0)]
    parts = [RecordResidual(rng.normal(size=(n, 2)), rng.normal(size=(n, 2, 3))) for n in (40, 17)]
    dense = sum(
        p.J[:, c].T @ toeplitz(noise[c].covariance(len(p.r))) @ p.J[:, c]
        for p in parts
        for c in range(2)
    )
    assert np.allclose(score_covariance(parts, noise), dense)


COLOURS = {
    "white": (np.zeros(0), 0.0),
    "memory 10 samples": (np.array([np.exp(-0.1)]), 0.0),
    "resonance": (np.array([1.8, -0.85]), 0.0),
    "memory 10 samples and white": (np.array([np.exp(-0.1)]), 0.2),
}


@pytest.mark.parametrize("colour", COLOURS)
def test_intervals_of_linear_fits_hold_the_truth(colour):
    ar, white = COLOURS[colour]
    rng = np.random.default_rng(2)
    held, naive, memories = [], [], []
    for _ in range(120):
        J = [regressors(n, rng) for n in (201, 160)]
        inverse = np.linalg.inv(sum(j[:, 0].T @ j[:, 0] for j in J))
        e = [
            lfilter([1.0], [1.0, *-ar], rng.normal(size=len(j) + 500))[500:]
            + white * rng.normal(size=len(j))
            for j in J
        ]
        theta = inverse @ sum(j[:, 0].T @ x for j, x in zip(J, e, strict=True))
        parts = [
            RecordResidual((x - j[:, 0] @ theta)[:, None], j) for j, x in zip(J, e, strict=True)
        ]
        noise = autoregressions(parts, inverse)
        cov = inverse @ score_covariance(parts, noise) @ inverse * student(parts, noise, 4) ** 2
        held.append(np.abs(theta) < 1.96 * np.sqrt(np.diag(cov)))
        power = np.mean([np.mean(p.r**2) for p in parts])
        naive.append(np.abs(theta) < 1.96 * np.sqrt(power * np.diag(inverse)))
        memories.append(noise[0].memory())
    assert 0.91 <= np.mean(held) <= 0.985, np.mean(held)
    if "10" in colour:
        assert np.mean(naive) < 0.7
    if not white:
        exact = Autoregression(ar, 1.0).memory()
        assert np.median(memories) == pytest.approx(exact, rel=0.15)


def test_a_column_without_data_is_silent():
    rng = np.random.default_rng(3)
    J = np.repeat(regressors(100, rng), 2, 1)
    J[:, 1] = 0
    inverse = np.linalg.inv(J[:, 0].T @ J[:, 0])
    noise = autoregressions(
        [RecordResidual(np.stack([rng.normal(size=100), np.zeros(100)], 1), J)], inverse
    )
    assert noise[1].innovation < 1e-100 and np.isfinite(noise[1].memory())
    assert noise[0].innovation == pytest.approx(1, rel=0.3)


def test_smooth_residuals_of_short_windows_have_a_variance_like_what_is_seen(monkeypatch):
    """Eight windows of a residual without noise of its own, each with two numbers of its own: roots
    lie at the unit circle.
    """
    from jaxid.fitting import noise_model

    rng, t = np.random.default_rng(0), np.linspace(-1, 1, 175)
    smooth = np.polynomial.legendre.legvander(t, 7)
    parts, seen = [], []
    for k in range(8):
        J = np.zeros((175, 1, 18))
        J[:, 0, 2 * k : 2 * k + 2] = smooth[:, :2]
        J[:, 0, 16:] = np.sin(np.outer(t, [2.0, 3.0]) + k)
        r = 40 * smooth[:, 2:] @ rng.standard_normal(6) + 0.5 * rng.standard_normal(175)
        parts.append(noise_model.RecordResidual(r[:, None], J))
        seen.append(np.mean(r**2))
    inverse = np.linalg.inv(sum(p.J[:, 0].T @ p.J[:, 0] for p in parts))

    def variance():
        return float(noise_model.autoregressions(parts, inverse)[0].covariance(1)[0])

    assert variance() <= 1.001 * noise_model.LARGEST * np.mean(seen)
    monkeypatch.setattr(noise_model, "LARGEST", np.inf)
    assert variance() > 100 * np.mean(seen)
