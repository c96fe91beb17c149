"""Velocities and accelerations from measured positions, without a shift in time. Every result comes
with a sentence that says what was done, for the report. Signals are `[time]` or `[time n]`, times
in s, frequencies in Hz.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np


ORDER = 4
UNIFORM = 0.01  # steps that differ by less than this share of their median count as uniform


def zero_phase(t: np.ndarray, x: np.ndarray, cutoff_hz: float, order: int = ORDER) -> np.ndarray:
    """`x` through a Butterworth low-pass, forwards and backwards (no phase; -6 dB at the cutoff).

    Irregularly sampled signals are filtered on a uniform grid of the median step and brought back
    by splines. Raises `ValueError` for a cutoff that is not between 0 and half the sampling
    frequency, or too few samples.
    """
    grid, values, uniform = _on_grid(t, x)
    filtered = _filtered(grid, values, cutoff_hz, order)
    return filtered if uniform else _spline(grid, filtered, t)


#: A longer series is filtered in stretches of this many samples.
STRETCH = 1 << 15


def zero_phase_stretches(
    t: np.ndarray,
    rows: Callable[[slice], np.ndarray],
    cutoff_hz: float,
    stretch: int = STRETCH,
    order: int = ORDER,
) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """`zero_phase` of a series that is made as it is needed: `rows(samples)` gives a part of it,
    [samples n ...].

    Gives (samples, filtered, unfiltered) of one stretch after the other; a short series is one.

    Each stretch is filtered with so much of its neighbourhood that the filter has forgotten what
    lies beyond to rounding.
    """
    from scipy.signal import sos2zpk

    n = len(t)
    grid, uniform = _grid(t)
    slowest = float(np.max(np.abs(np.asarray(sos2zpk(_sections(grid, cutoff_hz, order))[1]))))
    margin = int(1.3 * np.log(1e-15) / np.log(slowest)) + _padding(grid, cutoff_hz, order)
    stretch = max(stretch, 4 * margin)
    for a in range(0, n, stretch) if n > stretch + 2 * margin else [0]:
        b = min(n, a + stretch) if n > stretch + 2 * margin else n
        low, high = max(0, a - margin), min(n, b + margin)
        x = rows(slice(low, high))
        flat = x.reshape(len(x), x.shape[1], -1)
        smooth = np.empty((b - a, *flat.shape[1:]))
        first, last = (
            np.searchsorted(grid, t[low]),
            np.searchsorted(grid, t[high - 1], side="right"),
        )
        for k in range(flat.shape[1]):  # one after the other, for memory's sake
            if uniform:
                smooth[:, k] = _filtered(grid, flat[:, k], cutoff_hz, order)[a - low : b - low]
            else:
                own = grid[first:last]
                smooth[:, k] = _spline(
                    own,
                    _filtered(grid, _spline(t[low:high], flat[:, k], own), cutoff_hz, order),
                    t[a:b],
                )
        yield slice(a, b), smooth.reshape(b - a, *x.shape[1:]), x[a - low : b - low]


def differentiate(
    t: np.ndarray, q: np.ndarray, cutoff_hz: float, order: int = ORDER
) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Filtered `q`, its velocity and its acceleration at `t`, and the sentence.

    Central differences of the zero-phase filtered signal. All three have the length of `q`; the
    first and last `filter_ends(t, cutoff_hz)` samples suffer from the ends and should not be used.
    """
    grid, values, uniform = _on_grid(t, q)
    smooth = _filtered(grid, values, cutoff_hz, order)
    step = float(grid[1] - grid[0])
    qd = np.gradient(smooth, step, axis=0)
    qdd = np.gradient(qd, step, axis=0)
    qdd[1:-1] = (smooth[2:] - 2 * smooth[1:-1] + smooth[:-2]) / step**2
    if not uniform:
        smooth, qd, qdd = (_spline(grid, x, t) for x in (smooth, qd, qdd))
    return (
        smooth,
        qd,
        qdd,
        _statement(t, cutoff_hz, order, uniform)
        + ", then central differences"
        + _ends_text(t, cutoff_hz),
    )


def filter_ends(t: np.ndarray, cutoff_hz: float) -> int:
    """How many samples at each end the filter spoils: two periods of the cutoff, at most a tenth of
    the record.
    """
    step = float(np.median(np.diff(t)))
    return min(int(np.ceil(2 / (cutoff_hz * step) - 1e-6)), len(t) // 10)


def decimate(t: np.ndarray, x: np.ndarray, factor: int) -> tuple[np.ndarray, np.ndarray, str]:
    """Every `factor`-th time and sample after a zero-phase low-pass at 0.8 of the new Nyquist
    frequency; the sentence.

    Apply it to both sides of an equation alike. `factor` 1 returns the signals as they are.
    """
    if factor < 1:
        raise ValueError(f"factor is {factor}; it is a whole number of at least 1")
    if factor == 1:
        return np.asarray(t, dtype=float), np.asarray(x, dtype=float), "not decimated"
    cutoff = 0.8 * 0.5 / (factor * float(np.median(np.diff(t))))
    filtered = zero_phase(t, x, cutoff)
    return (
        np.asarray(t)[::factor],
        filtered[::factor],
        f"decimated by {factor} after a zero-phase low-pass at {cutoff:.4g} Hz",
    )


def start_state(
    t: np.ndarray, q: np.ndarray, window_s: float | None = None, degree: int = 2
) -> tuple[np.ndarray, np.ndarray, str]:
    """Position and velocity at `t[0]` from a polynomial through the first samples; the sentence.

    The window is `window_s`, by default 20 samples and at least 0.1 s. Returns `q0 [n]` and `qd0
    [n]` (scalars as 0-d arrays for `q [time]`).
    """
    t, q = np.asarray(t, dtype=float), np.asarray(q, dtype=float)
    span = window_s if window_s is not None else max(0.1, float(t[min(20, len(t)) - 1] - t[0]))
    count = max(degree + 2, int(np.searchsorted(t, t[0] + span, side="right")))
    if len(t) < count:
        raise ValueError(f"{len(t)} samples are too few for a polynomial of degree {degree}")
    scale = float(t[count - 1] - t[0])
    basis = np.vander((t[:count] - t[0]) / scale, degree + 1, increasing=True)
    coefficients = np.linalg.lstsq(basis, q[:count].reshape(count, -1), rcond=None)[0]
    q0, qd0 = coefficients[0].reshape(q.shape[1:]), coefficients[1].reshape(q.shape[1:]) / scale
    return (
        q0,
        qd0,
        (
            f"start state from a polynomial of degree {degree} through the first {count} samples"
            f" ({scale:.3g} s)"
        ),
    )


def followed(t: np.ndarray, x: np.ndarray, degree: int = 2, least: int = 5) -> float:
    """The longest of the window of all samples, its half, its quarter …, in s, over which a
    polynomial follows every signal of x [time n]: to within twice its noise (third differences, or
    the step of a counter), or 2 % of what it moves there.
    """
    count = len(t)
    while count // 2 >= max(least, degree + 2):
        part = x[:count]
        basis = np.vander((t[:count] - t[0]) / (t[count - 1] - t[0]), degree + 1, increasing=True)
        rest = part - basis @ np.linalg.lstsq(basis, part, rcond=None)[0]
        steps = np.abs(np.diff(part, axis=0))
        counter = np.min(np.where(steps > 0, steps, np.inf), axis=0)
        noise = np.maximum(
            np.std(np.diff(part, 3, axis=0), axis=0) / np.sqrt(20),
            np.where(np.isfinite(counter), 0.3 * counter, 0),
        )
        if np.all(np.std(rest, axis=0) <= np.maximum(2 * noise, 0.02 * np.ptp(part, axis=0))):
            break
        count //= 2
    return float(t[count - 1] - t[0])


def _on_grid(t: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
    t, x = np.asarray(t, dtype=float), np.asarray(x, dtype=float)
    if t.ndim != 1 or len(t) != len(x) or len(t) < 4:
        raise ValueError(
            f"t {t.shape} and a signal {x.shape}; expected [time] and [time] or [time n], at least"
            " 4 samples"
        )
    grid, uniform = _grid(t)
    return grid, x if uniform else _spline(t, x, grid), uniform


def even_grid(t: np.ndarray) -> np.ndarray | None:
    """Times of equal steps over t, as long as the mean step; None where those of t are equal
    already.
    """
    if _grid(t)[1]:
        return None
    return np.linspace(t[0], t[-1], len(t))


def spline(t: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Series x [time ...] at other times, by the cubic spline through it."""
    return _spline(t, x, at)


def _grid(t: np.ndarray) -> tuple[np.ndarray, bool]:
    """The times of a uniform grid over t, and whether samples are taken to lie on it as they
    are.
    """
    step = np.diff(t)
    median = float(np.median(step))
    if np.min(step) <= 0:
        raise ValueError("time does not increase")
    if np.max(np.abs(step - median)) <= UNIFORM * median:
        return t[0] + (t[-1] - t[0]) / (len(t) - 1) * np.arange(len(t)), True
    return np.linspace(t[0], t[-1], max(len(t), round((t[-1] - t[0]) / median) + 1)), False


def _spline(t: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    from scipy.interpolate import CubicSpline

    return CubicSpline(t, x, axis=0)(at)


def _sections(grid: np.ndarray, cutoff_hz: float, order: int) -> np.ndarray:
    from scipy.signal import butter

    rate = 1 / float(grid[1] - grid[0])
    if not 0 < cutoff_hz < rate / 2:
        raise ValueError(
            f"cutoff {cutoff_hz:g} Hz is not between 0 and half the sampling frequency,"
            f" {rate / 2:g} Hz"
        )
    return np.asarray(butter(order, cutoff_hz, fs=rate, output="sos"))


def _padding(grid: np.ndarray, cutoff_hz: float, order: int) -> int:
    """About two periods of the cutoff; SciPy's own default is a few samples and rings at low
    cutoffs.
    """
    return max(3 * (2 * -(-order // 2) + 1), int(np.ceil(2 / float(grid[1] - grid[0]) / cutoff_hz)))


def _filtered(grid: np.ndarray, x: np.ndarray, cutoff_hz: float, order: int) -> np.ndarray:
    """A series on the steps of a grid through the low-pass."""
    from scipy.signal import sosfiltfilt

    sections, pad = (
        _sections(grid, cutoff_hz, order),
        min(len(x) - 1, _padding(grid, cutoff_hz, order)),
    )
    if x.ndim == 1 or len(x) <= STRETCH:
        return np.asarray(sosfiltfilt(sections, x, axis=0, padlen=pad))
    return np.stack(
        [sosfiltfilt(sections, column, padlen=pad) for column in x.T], 1
    )  # one after the other, for memory's sake


def _statement(t: np.ndarray, cutoff_hz: float, order: int, uniform: bool) -> str:
    grid = (
        ""
        if uniform
        else f" on a uniform grid of {np.median(np.diff(t)):.4g} s (sampling is irregular)"
    )
    return (
        f"zero-phase Butterworth low-pass of order {order}, run forwards and backwards, cutoff"
        f" {cutoff_hz:g} Hz{grid}"
    )


def _ends_text(t: np.ndarray, cutoff_hz: float) -> str:
    count = filter_ends(t, cutoff_hz)
    return f"; {count} samples at each end left out ({count * np.median(np.diff(t)):.3g} s)"


#: Segments of a spectrum that are longer have a length for which there is a fast transform.
LONG = 1 << 15


def content_cutoff(t: np.ndarray, y: np.ndarray, noise: float) -> float:
    """Frequency in Hz up to which a recorded position rises above its white noise; motion is
    smoothed there.

    At least 8 periods of the record, at most a fifth of the sampling frequency.
    """
    from scipy.fft import next_fast_len
    from scipy.signal import welch
    from scipy.stats import chi2

    rate = 1 / float(np.median(np.diff(t)))
    grid = np.interp(np.linspace(t[0], t[-1], t.size), t, y)
    second = np.diff(
        grid, 2
    )  # whitens the steep spectrum of a position, so that windows do not leak
    segment = min(second.size, max(256, second.size // 8))
    if segment > LONG:  # a length of large prime factors takes many times as long
        segment = next_fast_len(segment, real=True)
    f, power = welch(second, rate, nperseg=segment)
    floor = 2 * noise**2 / rate * (2 - 2 * np.cos(2 * np.pi * f / rate)) ** 2
    # The fewer segments are averaged, the higher noise alone reaches: where one line of a hundred
    # spectra does is no content.
    freedom = 2 * max(1, second.size // segment)
    chance = float(chi2.isf(0.01 / f.size, freedom)) / freedom
    above = np.flatnonzero((power > max(4.0, chance) * floor) & (f > 0))
    top = f[above[-1]] if above.size else 0.0
    # A lone peak far up is not content: take the frequency below which 99.9 % of the power above
    # the floor lies.
    excess = np.cumsum(np.maximum(power - floor, 0.0) * (f <= top))
    if excess[-1] > 0:
        top = f[np.searchsorted(excess, 0.999 * excess[-1])]
    return float(np.clip(1.5 * top, min(8 / (t[-1] - t[0]), rate / 5), rate / 5))


#: Share of the power of a speed that counts as its content.
SPEED_SHARE = 0.95


def speed_content(t: np.ndarray, y: np.ndarray, noise: float) -> float:
    """Frequency (Hz) below which nearly all power of the speed of a position y at equal steps lies,
    white noise taken off: no less of it than the upper half of the spectrum shows (a clock that
    jitters adds to that of the sensor).
    """
    from scipy.signal import welch

    step = float(t[-1] - t[0]) / (len(t) - 1)
    f, power = welch(np.diff(y) / step, 1 / step, nperseg=min(len(y) - 1, max(256, len(y) // 4)))
    shape = 2 / step * (2 - 2 * np.cos(2 * np.pi * f * step))
    upper = f > 0.25 / step
    floor = max(noise**2, float(np.median(power[upper] / shape[upper]))) * shape
    excess = np.cumsum(np.maximum(power - 2 * floor, 0.0))
    return float(f[np.searchsorted(excess, SPEED_SHARE * excess[-1])]) if excess[-1] > 0 else 0.0
