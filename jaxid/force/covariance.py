"""How well rows whose residual has a memory determine numbers: directions that are left open, and
sandwich covariances.
"""

from __future__ import annotations

import os

import numpy as np


#: A direction of the scaled normal matrix with an eigenvalue below this share of the largest is not
#: determined.
NULL = 1e-12


def null_directions(
    scaled: np.ndarray, kept: np.ndarray
) -> tuple[np.ndarray, tuple[tuple[int, ...], ...]]:
    """Which variables take part in no undetermined direction; and groups tied together (correlation
    above 0.999).
    """
    index = np.flatnonzero(kept)
    identifiable = np.ones(len(kept), bool)
    groups: list[tuple[int, ...]] = []
    if not index.size:
        return identifiable, ()
    values, vectors = np.linalg.eigh(scaled[np.ix_(index, index)])
    null = values <= NULL * values[-1]
    for vector in vectors[:, null].T:
        members = np.flatnonzero(np.abs(vector) > 1e-3)
        identifiable[index[members]] = False
        groups.append(tuple(int(i) for i in index[members]))
    if not null.any():
        inverse = np.linalg.inv(scaled[np.ix_(index, index)])
        d = np.sqrt(np.diag(inverse))
        tied = np.abs(inverse / d / d[:, None]) > 0.999
        seen: set[int] = set()
        for i in range(len(index)):
            members = np.flatnonzero(tied[i])
            if i not in seen and members.size > 1:
                seen.update(int(m) for m in members)
                groups.append(tuple(int(k) for k in index[members]))
    return identifiable, tuple(dict.fromkeys(groups))


def whiteness(series: list[np.ndarray], lags: int = 20) -> tuple[bool, int]:
    """Ljung-Box test at 0.1 %, and the residual's memory in samples (first lag whose correlation is
    lost in the noise).
    """
    from scipy.special import chdtri

    statistic, total, memory = 0.0, 0, 1
    for r in series:
        n = len(r)
        if n < 4 * lags:
            continue
        r = r - r.mean()
        power = float(r @ r)
        if power <= 0:
            continue
        f = np.fft.rfft(r, 2 * n)
        rho = np.fft.irfft(f * np.conj(f))[: n // 2] / power
        statistic += n * float(np.sum(rho[1 : lags + 1] ** 2))
        total += lags
        below = np.flatnonzero(np.abs(rho) < max(0.05, 2 / np.sqrt(n)))
        memory = max(memory, int(below[0]) if below.size else n // 4)
    return total == 0 or bool(statistic < chdtri(total, 0.001)), memory


def long_run(scores: list[tuple[list[int], np.ndarray]], n: int, memory: int) -> np.ndarray:
    """Long-run covariance of the summed scores: Bartlett weights over four times the residual's
    memory.
    """
    from scipy.fft import rfft

    S = np.zeros((n, n))
    for columns, s in scores:
        bandwidth = int(min(4 * memory, len(s) // 3))
        length = transform_length(len(s))
        lags = np.zeros(
            length
        )  # the weights of all lags, whose products are summed as those of spectra
        lags[: bandwidth + 1] = 1 - np.arange(bandwidth + 1) / (bandwidth + 1)
        lags[length - bandwidth :] = lags[bandwidth:0:-1]
        weights = np.real(np.asarray(rfft(lags))) / length
        weights[1 : (length + 1) // 2] *= 2  # those of negative frequencies
        f = np.asarray(rfft(s, length, axis=0, workers=os.cpu_count() or 1))
        S[np.ix_(columns, columns)] += sum(
            part.T @ (weights[:, None] * part) for part in (np.real(f), np.imag(f))
        )
    values, vectors = np.linalg.eigh((S + S.T) / 2)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def transform_length(n: int) -> int:
    """A short length of Fourier transforms that holds a series of n samples and all its lags."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(2 * n + 1, real=True) or 0)
