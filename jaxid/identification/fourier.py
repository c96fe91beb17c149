"""Derivatives of a periodic motion that keep its harmonics: the measured positions as a Fourier
series of whole periods.
"""

from __future__ import annotations

import numpy as np

from jaxid.base.errors import UsageError


#: A series that leaves this many times what the readings scatter by themselves is not of whole
#: periods.
LEFT = 3.0


def harmonic_motion(
    t: np.ndarray, q: np.ndarray, highest_hz: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(q, qd, qdd) [time n] by the harmonics up to `highest_hz` of a record that holds whole
    periods, by least squares; no harmonic is damped, as a low-pass would.

    Raises `UsageError` for a record that such a series does not follow: it holds no whole periods,
    or has more harmonics.
    """
    span = float(t[-1] - t[0])
    count = int(span * highest_hz)
    if count < 1 or 2 * count + 1 > len(t) / 2:
        raise UsageError(
            f"a record of {span:.3g} s and {len(t)} samples has no Fourier series up to"
            f" {highest_hz:.3g} Hz: record longer, or lower the motion's cutoff"
        )
    w = 2 * np.pi / span * np.arange(1, count + 1)
    angle = np.outer(t - t[0], w)
    s, c = np.sin(angle), np.cos(angle)
    x = np.linalg.lstsq(np.column_stack([np.ones_like(t), s, c]), q, rcond=None)[0]
    a, b, wide = x[1 : count + 1], x[count + 1 :], w[:, None]
    smooth = x[0] + s @ a + c @ b
    scatter = np.std(np.diff(q, 3, axis=0), axis=0) / np.sqrt(
        20.0
    )  # of white noise; smooth motion leaves next to nothing
    left = np.sqrt(np.mean((q - smooth) ** 2, axis=0))
    worst = int(np.argmax(left / np.maximum(scatter, 1e-9)))
    if left[worst] > LEFT * max(float(scatter[worst]), 1e-9) + 1e-6 * float(np.ptp(q[:, worst])):
        raise UsageError(
            f"the motion is not a Fourier series of {span:.5g} s up to {highest_hz:.3g} Hz: that"
            f" leaves {left[worst]:.2g} of joint {worst + 1}, whose readings scatter by"
            f" {scatter[worst]:.2g}. Cut the run to whole periods (window_s), or raise the motion's"
            " cutoff, or leave --motion at measured"
        )
    return smooth, c @ (a * wide) - s @ (b * wide), -s @ (a * wide**2) - c @ (b * wide**2)
