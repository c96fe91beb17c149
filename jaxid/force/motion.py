"""What a run's sampling and motion allow: a cutoff of its torques, rows, and joints that move."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Experiment


#: Rows come at this many times the cutoff: between them there is nothing new.
ROWS_PER_CUTOFF = 4.0
#: A cutoff lies below this share of the sampling rate.
HIGHEST = 1 / 2.5
#: Readings of a joint that stands still span less than this many times their noise.
STILL = 12.0


def refuse_cutoff(e: Experiment, rate: float, cutoff_hz: float) -> None:
    """Raises `UsageError` for a cutoff that a run's sampling rate (both Hz) does not allow."""
    if cutoff_hz < HIGHEST * rate:
        return
    raise UsageError(
        f"experiment {e.name!r} is sampled at {rate:.4g} Hz; a cutoff of {cutoff_hz:g} Hz is too"
        f" high, give at most {rate / 4:.3g}"
    )


def rows_every(rate: float, cutoff_hz: float) -> int:
    """Every how many samples a row says something new."""
    return max(1, int(rate / (ROWS_PER_CUTOFF * cutoff_hz)))


def moving(
    q: Float[np.ndarray, "time joints"], noise: Float[np.ndarray, " joints"]
) -> Bool[np.ndarray, " joints"]:
    """Whether a joint moves, or only flickers by the noise of its reading."""
    return np.ptp(q, axis=0) > STILL * noise
