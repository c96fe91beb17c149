"""Several devices, one clock: how one device's time runs against another's, with uncertainty.

Two cases. Devices on the same computer: each sample arrives at the host a little late, never early,
so the earliest arrivals show the true relation (lower envelope: Moon, Skelly, Towsley, "Estimation
and removal of clock skew from network delay measurements", INFOCOM 1999). A file from elsewhere:
only the signals themselves tell, so one is shifted and stretched until it follows the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ClockMap:
    """`main = offset + (1 + drift) * other`: s, and s per s; each with one standard deviation.
    `text` says how it was found.
    """

    offset: float
    drift: float
    offset_std: float
    drift_std: float
    text: str

    def __call__(self, other: np.ndarray) -> np.ndarray:
        return self.offset + (1 + self.drift) * np.asarray(other, float)

    def inverse(self, main: np.ndarray) -> np.ndarray:
        return (np.asarray(main, float) - self.offset) / (1 + self.drift)

    def after(self, first: ClockMap) -> ClockMap:
        """This map applied to the result of `first`."""
        scale = 1 + self.drift
        return ClockMap(
            self.offset + scale * first.offset,
            scale * (1 + first.drift) - 1,
            float(np.hypot(self.offset_std, scale * first.offset_std)),
            float(np.hypot(self.drift_std, first.drift_std)),
            f"{first.text}; {self.text}",
        )

    def inverted(self) -> ClockMap:
        scale = 1 / (1 + self.drift)
        return ClockMap(
            -self.offset * scale,
            scale - 1,
            self.offset_std * scale,
            self.drift_std * scale,
            self.text,
        )


def from_arrivals(device: np.ndarray, host: np.ndarray, blocks: int = 16) -> ClockMap:
    """The host's time as a function of the device's, from arrival times.

    A line through the earliest arrivals of each of `blocks` stretches of time, the standard
    deviations from their scatter. The shortest delay of the line itself adds to the offset and
    cannot be seen. Raises `ValueError` for fewer than 4 samples.
    """
    device, host = np.asarray(device, float), np.asarray(host, float)
    if len(device) < 4 or np.ptp(device) <= 0:
        raise ValueError("fewer than 4 samples, or a clock that stands still")
    center = float(device.mean())
    x, y = device - center, host - device
    blocks = max(2, min(blocks, len(x) // 8))
    slope = level = 0.0
    first = np.arange(0)
    for _ in range(3):  # the earliest of a block depends a little on the slope
        edge = y - slope * x
        parts = np.array_split(np.arange(len(x)), blocks)
        first = np.array([p[np.argmin(edge[p])] for p in parts])
        slope, level = np.polyfit(x[first], y[first], 1)
    scatter = y[first] - level - slope * x[first]
    sigma = float(np.sqrt(np.sum(scatter**2) / max(len(first) - 2, 1)))
    spread = float(np.sqrt(np.sum((x[first] - x[first].mean()) ** 2)))
    # A mean line passes above the earliest arrivals by their scatter; the envelope touches the
    # lowest of them.
    level += float(np.min(y - level - slope * x))
    drift_std = sigma / spread
    offset_std = float(np.hypot(sigma / np.sqrt(len(first)), drift_std * abs(center)))
    late = host - (level + slope * x + device)
    text = (
        f"arrival times: earliest of {len(first)} stretches, drift {1e6 * slope:+.1f} ±"
        f" {1e6 * drift_std:.1f} ppm, lateness median {1e3 * np.median(late):.2f} ms, longest"
        f" {1e3 * late.max():.1f} ms"
    )
    return ClockMap(float(level - slope * center), float(slope), offset_std, float(drift_std), text)


def from_signals(
    t: np.ndarray,
    x: np.ndarray,
    other_t: np.ndarray,
    other_x: np.ndarray,
    *,
    search_s: float | None = None,
    derivative: int = 0,
) -> ClockMap:
    """The main clock as a function of another's, from one motion that both recorded.

    `derivative` times the main signal `x` is differentiated before it is compared (2: an angle
    against an accelerometer). Gain and bias between the signals are free. `search_s` bounds the
    offset that is looked for (default: all that overlaps by half). Raises `ValueError` where the
    signals do not resemble each other (correlation below 0.5).
    """
    from scipy.interpolate import CubicSpline
    from scipy.optimize import least_squares
    from scipy.signal import correlate

    t, x, other_t, other_x = (np.asarray(a, float) for a in (t, x, other_t, other_x))
    step = max(float(np.median(np.diff(t))), float(np.median(np.diff(other_t))))
    x, other_x = _smooth(t, x, step, derivative), _smooth(other_t, other_x, step, 0)
    grid, other_grid = (np.arange(a[0], a[-1], step) for a in (t, other_t))
    a, b = np.interp(grid, t, x), np.interp(other_grid, other_t, other_x)
    a, b = a - a.mean(), b - b.mean()
    score = correlate(a, b, "full")
    lags = np.arange(-len(b) + 1, len(a))
    overlap = np.minimum(len(a), lags + len(b)) - np.maximum(0, lags)
    allowed = overlap >= 0.5 * min(len(a), len(b))
    begin = grid[0] - other_grid[0]
    if search_s is not None:
        allowed &= np.abs(lags * step + begin) <= search_s
    if not allowed.any():
        raise ValueError(
            "no offset within the search range makes the two recordings overlap by half"
        )
    k = int(np.argmax(np.where(allowed, np.abs(score), -np.inf)))
    coarse = float(lags[k] * step + begin)

    main, center = CubicSpline(t, x, extrapolate=False), float(other_t.mean())

    def residual(p: np.ndarray) -> np.ndarray:
        at = other_grid + coarse + p[0] + p[1] * (other_grid - center)
        value = main(np.clip(at, t[0], t[-1]))
        inside = (at >= t[0]) & (at <= t[-1])
        basis = np.stack([value, np.ones_like(value)], 1)[inside]
        gain = np.linalg.lstsq(basis, b[inside], rcond=None)[0]
        out = np.zeros(len(at))
        out[inside] = b[inside] - basis @ gain
        return out

    fit = least_squares(
        residual, [0.0, 0.0], x_scale=[step, step / max(np.ptp(other_t), step)], diff_step=1e-4
    )
    likeness = 1 - float(np.sum(fit.fun**2) / max(np.sum(b**2), 1e-300))
    if likeness < 0.25:
        raise ValueError(
            f"the signals do not resemble each other (correlation {np.sqrt(max(likeness, 0)):.2f})"
        )
    # Neighbouring residuals are alike; the count of independent ones follows from their
    # correlation.
    r = fit.fun - fit.fun.mean()
    alike = float(np.clip(np.sum(r[1:] * r[:-1]) / max(np.sum(r**2), 1e-300), 0.0, 0.99))
    variance = float(np.mean(r**2)) * (1 + alike) / (1 - alike)
    std = np.sqrt(np.diag(np.linalg.pinv(fit.jac.T @ fit.jac)) * variance)
    shift, drift = (float(v) for v in fit.x)
    text = (
        f"signals aligned with correlation {np.sqrt(likeness):.3f}: drift {1e6 * drift:+.0f} ±"
        f" {1e6 * std[1]:.0f} ppm, offset known to {1e3 * std[0]:.2f} ms in the middle"
    )
    offset = coarse + shift - drift * center
    return ClockMap(
        offset, drift, float(np.hypot(std[0], std[1] * abs(center))), float(std[1]), text
    )


def _smooth(t: np.ndarray, x: np.ndarray, step: float, derivative: int) -> np.ndarray:
    """`x` or a derivative of it below a quarter of the common Nyquist frequency, so that both
    signals carry the same band.
    """
    from jaxid.data.signals import differentiate, zero_phase

    cutoff = min(0.125 / step, 0.2 / float(np.median(np.diff(t))))
    if derivative == 0:
        return zero_phase(t, x, cutoff)
    _, velocity, acceleration, _ = differentiate(t, x, cutoff)
    return velocity if derivative == 1 else acceleration


def within_tick(
    tick: np.ndarray, resolution: float, sent: np.ndarray, received: np.ndarray
) -> tuple[np.ndarray, ClockMap, float, ClockMap]:
    """Device times finer than the device counts, the host's clock against it, the times' standard
    deviation, and the host time at which something is sent so that it arrives at a device time.

    A sample was taken while its counter read `tick` (s, steps of `resolution`), a little after the
    question was `sent` and before the answer was `received` (host s). How long after is the same
    every time but for jitter, so a line through either host time tells the device's time between
    two counts; the one that jitters less is taken. No time leaves its tick.
    """
    center = float(tick.mean())
    best, asked = None, None
    for host, word in ((sent, "question"), (received, "answer")):
        late = host - tick - resolution / 2
        keep = (
            np.abs(late - np.median(late)) < 3 * resolution
        )  # a delayed question says nothing of the clocks
        slope, level = (
            np.polyfit(tick[keep] - center, late[keep], 1)
            if keep.sum() > 3
            else (0.0, float(np.median(late)))
        )
        rest = late - level - slope * (tick - center)
        low, high = np.percentile(rest, [10, 90])
        if asked is None:
            asked = ClockMap(float(level - slope * center), float(slope), 0.0, 0.0, "")
        if best is None or high - low < best[0]:
            best = (high - low, float(slope), float(level), host, rest, word, int(keep.sum()))
    assert best is not None and asked is not None
    width, slope, level, host, rest, word, count = best
    # Rounding down to a tick alone spreads the rest evenly over one resolution; what exceeds it is
    # jitter.
    spread = width / 0.8 / np.sqrt(12)
    floor = resolution / np.sqrt(12)
    blur = float(np.clip(np.sqrt(max(spread**2 - floor**2, 0.0)), 0.05 * resolution, floor))
    drift_std = float(spread / np.sqrt(count) / max(float(tick.std()), 1e-12))
    text = (
        f"device counter of {1e3 * resolution:g} ms, refined to {1e3 * blur:.2f} ms by the times of"
        f" the {word}s: drift {1e6 * slope:+.1f} ± {1e6 * drift_std:.1f} ppm, question to answer"
        f" median {1e3 * np.median(received - sent):.2f} ms"
    )
    offset_std = float(np.hypot(spread / np.sqrt(count), drift_std * abs(center)))
    clock = ClockMap(level - slope * center, slope, offset_std, drift_std, text)
    return np.clip(clock.inverse(host), tick, tick + resolution * (1 - 1e-6)), clock, blur, asked
