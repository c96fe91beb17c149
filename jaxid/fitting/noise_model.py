"""The noise in residuals as a stationary process with a memory, with what the fit took from it
given back.

A fit bends p parameters towards the slow part of noise with a memory, so that the residuals' own
correlations are too small, by half in a record of a few memories. Their expectation is known for
each autocovariance of the noise (of M R M, with M the projection off the Jacobian), which is solved
for it; an autoregression (Yule and Walker) carries it to all lags.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.base.computer import cores
from jaxid.force.covariance import transform_length
from jaxid.simulation.sample_buffers import LONG


#: The longest autoregression tried.
ORDER = 8
ROUNDS = 40
#: What a fit takes away of a disturbance may be most of it: its variance may be this many times
#: what is left, and no more.
LARGEST = 10.0


@dataclass(frozen=True)
class Autoregression:
    """e_t = sum_k ar_k e_(t-k) + innovation, of one column."""

    ar: np.ndarray
    innovation: float  # standard deviation

    def covariance(self, length: int) -> np.ndarray:
        """Autocovariance at lags 0 to length - 1."""
        from scipy.signal import lfilter, lfiltic

        p = len(self.ar)
        A = np.zeros((p + 1, p + 1))  # Yule-Walker equations for the first p + 1 lags
        full = np.concatenate([[1.0], -self.ar])
        for k in range(p + 1):
            for j in range(p + 1):
                A[k, abs(k - j)] += full[j]
        first = np.linalg.solve(A, np.eye(p + 1)[0] * self.innovation**2)
        rest = np.zeros(max(0, length - p - 1))
        if p and rest.size:
            rest = np.asarray(lfilter([1.0], full, rest, zi=lfiltic([1.0], full, first[:0:-1]))[0])
        return np.concatenate([first, rest])[:length]

    def memory(self) -> float:
        """Samples that share one piece of noise: the sum of all correlations, at least 1."""
        return max(1.0, (self.innovation / (1 - self.ar.sum())) ** 2 / self.covariance(1)[0])

    def whitened(self, series: np.ndarray) -> np.ndarray:
        """The innovations of a series."""
        from scipy.signal import lfilter

        return np.asarray(lfilter(np.concatenate([[1.0], -self.ar]), [1.0], series))

    def coloured(self, innovations: np.ndarray) -> np.ndarray:
        """The series that these innovations make."""
        from scipy.signal import lfilter

        return np.asarray(lfilter([1.0], np.concatenate([[1.0], -self.ar]), innovations))


@dataclass(frozen=True)
class RecordResidual:
    """Residual r [samples columns] of one record and its Jacobian J [samples columns p] by all
    parameters, 0 where nothing is measured.
    """

    r: np.ndarray
    J: np.ndarray


def autoregressions(parts: Sequence[RecordResidual], inverse: np.ndarray) -> list[Autoregression]:
    """One for each column, common to all records; `inverse` [p p] of J'J."""
    columns = range(parts[0].r.shape[1])
    values, vectors = np.linalg.eigh(inverse)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    # [columns samples p] of orthonormal columns over all records
    Q = [np.moveaxis(p.J @ root, 1, 0) for p in parts]
    longest = max(len(p.r) for p in parts)
    order = min(ORDER, min(len(p.r) for p in parts) // 16)
    count = np.array([_seen(parts, c, order) for c in columns])
    raw = np.array([_summed_products(parts, c, order) / count[c] for c in columns])
    orders = [_order(raw[c], count[c]) for c in columns]
    most = LARGEST * raw[:, 0, 0]

    def fitted(moments: np.ndarray) -> list[Autoregression]:
        return [_no_larger(_fitted(moments[c], orders[c], count[c]), most[c]) for c in columns]

    found = fitted(raw)
    before = np.array([f.covariance(order + 1) for f in found])
    for _ in range(ROUNDS):
        noise = [f.covariance(longest) for f in found]
        taken = _taken_by_fit(Q, noise, order)
        found = fitted(raw + taken / count[:, None, None])
        now = np.array([f.covariance(order + 1) for f in found])
        if np.all(np.abs(now - before) <= 1e-3 * now[:, :1]):
            break
        before = now
    return found


def _seen(parts: Sequence[RecordResidual], column: int, first: int) -> int:
    """Samples of a column that count, behind the first ones of each record."""
    return max(1, int(sum(np.count_nonzero(p.r[first:, column]) for p in parts)))


def _summed_products(parts: Sequence[RecordResidual], column: int, order: int) -> np.ndarray:
    return sum(_products(p.r[:, column], p.r[:, column], order) for p in parts)  # type: ignore[return-value]


def _taken_by_fit(Q: Sequence[np.ndarray], noise: Sequence[np.ndarray], order: int) -> np.ndarray:
    """What the fit has taken out of the products of each column, by the covariance of its noise."""
    G = np.zeros((Q[0].shape[2], Q[0].shape[2]))
    crosses: list[list[np.ndarray]] = []
    for q in Q:
        of_record = []
        for c, covariance in enumerate(noise):
            rq = _correlated(covariance, q[c])
            G = G + q[c].T @ rq
            of_record.append(_products(q[c], rq, order))
        crosses.append(of_record)
    taken = np.zeros((len(noise), order + 1, order + 1))
    for q, of_record in zip(Q, crosses, strict=True):
        for c, both in enumerate(of_record):
            taken[c] += both + both.T - _products(q[c], q[c] @ G, order)
    return taken


def student(
    parts: Sequence[RecordResidual], noise: Sequence[Autoregression], parameters: int
) -> float:
    """By how much the ends of a 95 % interval lie further out than a normal distribution's, for
    want of independent samples.
    """
    from scipy.special import ndtri, stdtrit

    worth = 0.0
    for part in parts:
        for c, column in enumerate(noise):
            worth += np.count_nonzero(part.r[:, c]) / column.memory()
    return float(stdtrit(max(2.0, worth - parameters), 0.975) / ndtri(0.975))


def score_covariance(
    parts: Sequence[RecordResidual], noise: Sequence[Autoregression]
) -> np.ndarray:
    """J' R J [p p] with R of the noise."""
    S: np.ndarray = np.zeros((parts[0].J.shape[2],) * 2)
    for p in parts:
        for c, column in enumerate(noise):
            S += p.J[:, c].T @ _correlated(column.covariance(len(p.r)), p.J[:, c])
    return (S + S.T) / 2


def _order(products: np.ndarray, count: int) -> int:
    """By Akaike's criterion."""
    errors = [_solved(products, k)[1] for k in range(len(products))]
    return int(np.argmin([count * np.log(e) + 2 * k for k, e in enumerate(errors)]))


def _solved(products: np.ndarray, order: int) -> tuple[np.ndarray, float]:
    """Coefficients and variance of the innovations by least squares from mean products of lagged
    samples.
    """
    ar = np.linalg.lstsq(
        products[1 : order + 1, 1 : order + 1], products[0, 1 : order + 1], rcond=1e-12
    )[0]
    return ar, max(
        float(products[0, 0] - ar @ products[0, 1 : order + 1]),
        1e-12 * float(products[0, 0]),
        1e-300,
    )


def _fitted(products: np.ndarray, order: int, count: int) -> Autoregression:
    """The stationary one next to it: no root of its polynomial comes nearer to the unit circle than
    one part in `count`.
    """
    ar, error = _solved(products, order)
    roots = np.roots(np.concatenate([[1.0], -ar]))
    size = np.abs(roots)
    if np.any(size > 1 - 1 / count):
        ar = -np.real(
            np.poly(np.where(size > 1 - 1 / count, roots / size * (1 - 1 / count), roots))
        )[1:]
    return Autoregression(ar, float(np.sqrt(error)))


def _no_larger(noise: Autoregression, variance: float) -> Autoregression:
    """The same with less noise, where its variance is more than this: a smooth residual of short
    windows fits roots at the unit circle, whose stationary variance has nothing to do with what was
    seen.
    """
    own = float(noise.covariance(1)[0])
    return (
        noise
        if own <= variance or variance == 0
        else Autoregression(noise.ar, noise.innovation * float(np.sqrt(variance / own)))
    )


def _products(a: np.ndarray, b: np.ndarray, order: int) -> np.ndarray:
    """sum_t a_(t - i) . b_(t - j) for i, j = 0 to order, over the samples that have all of them."""
    n, a, b = (
        len(a),
        np.ascontiguousarray(a).reshape(len(a), -1),
        np.ascontiguousarray(b).reshape(len(b), -1),
    )

    # of one piece of memory: no copies
    def lag(x, k):
        return x[order - k : n - k].reshape(-1)

    found = np.zeros((order + 1, order + 1))
    found[0] = [lag(a, 0) @ lag(b, j) for j in range(order + 1)]
    found[1:, 0] = [lag(a, i) @ lag(b, 0) for i in range(1, order + 1)]

    def backwards(x):
        return x[::-1]

    more = (
        backwards(a[:order]) @ backwards(b[:order]).T
    )  # both lagged once more: a sample more in front, one less at the end
    less = backwards(a[n - order :]) @ backwards(b[n - order :]).T
    for i in range(order):
        found[i + 1, 1:] = found[i, :-1] + (more - less)[i]
    return found


def _correlated(covariance: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The Toeplitz matrix of an autocovariance times x [samples columns]; for memory's sake column
    by column if long.
    """
    from scipy.fft import irfft, rfft

    n = len(x)
    if n > LONG and x.shape[1] > 1:
        out = np.empty_like(x)
        for k in range(x.shape[1]):
            out[:, k : k + 1] = _correlated(covariance, x[:, k : k + 1])
        return out
    length, workers = transform_length(n), cores()
    circle = np.zeros(length)
    circle[:n] = covariance[:n]
    circle[length - n + 1 :] = covariance[1:n][::-1]
    spectrum = np.asarray(rfft(circle))[:, None] * np.asarray(
        rfft(x, length, axis=0, workers=workers)
    )
    return np.asarray(irfft(spectrum, length, axis=0, workers=workers))[:n]
