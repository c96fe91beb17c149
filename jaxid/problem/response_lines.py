"""The lines of a frequency response: as they were measured, or estimated from a record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxid.data.dataset import FrequencyResponse as Measured


@dataclass(frozen=True)
class Lines:
    """One measured response, repeats merged: rising omega, response, and the standard deviation of
    its parts, [lines].
    """

    omega: np.ndarray
    response: np.ndarray
    std: np.ndarray
    statement: str


def merged(measured: Measured) -> Lines:
    """Median over repeats, weights from their scatter (both robust to outliers); without repeats 2
    % of the gain, in the zeros of the response of a tenth of its median.
    """
    order = np.argsort(measured.omega, kind="stable")
    omega, response = measured.omega[order], np.asarray(measured.response, complex)[order]
    first = np.append(True, np.diff(omega) > 1e-9 * omega[1:])
    groups = np.split(response, np.flatnonzero(first)[1:])
    middle = np.array([np.median(np.real(g)) + 1j * np.median(np.imag(g)) for g in groups])
    counts = np.array([g.size for g in groups])
    if np.median(counts) >= 3:
        parts = [
            np.concatenate([np.real(g - m), np.imag(g - m)])
            for g, m in zip(groups, middle, strict=True)
        ]
        share = np.array([np.median(np.abs(p)) for p in parts]) / np.maximum(np.abs(middle), 1e-300)
        # A line's own scatter is known from few repeats: pooled with its neighbours', in shares of
        # the gain.
        pooled = np.array([np.median(share[max(0, k - 5) : k + 6]) for k in range(share.size)])
        few = counts / np.maximum(counts - 0.8, 0.2)  # the median leaves less scatter about it
        std = 1.4826 * few * np.maximum(pooled, 1e-3) * np.abs(middle) * 1.2533 / np.sqrt(counts)
        statement = f"median of {np.median(counts):.0f} repeats, weights from their scatter"
        return Lines(omega[first], middle, std, statement)
    gain = np.abs(middle)
    return Lines(
        omega[first],
        middle,
        0.02 * np.maximum(gain, 0.1 * np.median(gain)),
        "no repeats: noise taken as 2 % of the gain",
    )


def estimate(
    t: np.ndarray, u: np.ndarray, y: np.ndarray, band_hz: tuple[float, float], least_input: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(bins, U, Y) of a record [time] in a band: discrete Fourier transforms without window, and
    only bins in which the input has `least_input` of its largest amplitude. Y / U is the response.
    """
    U, Y = np.fft.rfft(u), np.fft.rfft(y)
    f = np.fft.rfftfreq(t.size, float(np.median(np.diff(t))))
    size = np.abs(U)
    least = max(
        least_input * size[1:].max(), 1e-9 * size.max()
    )  # a constant input has but rounding beside f = 0
    bins = np.flatnonzero(
        (f >= band_hz[0]) & (f <= band_hz[1]) & (f > 0) & (size >= least) & (size > 0)
    )
    return bins, U[bins], Y[bins]


def parts_of(
    response: np.ndarray, std: np.ndarray, magnitude: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Target and weight rows [2 lines]."""
    if magnitude:
        target, weight = (
            np.column_stack([np.abs(response), 0 * std]),
            np.column_stack([1 / std, 0 * std]),
        )
    else:
        target, weight = (
            np.column_stack([np.real(response), np.imag(response)]),
            np.column_stack([1 / std, 1 / std]),
        )
    return target.ravel(), weight.ravel()
