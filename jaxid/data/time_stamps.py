"""Time stamps that scatter around the true instants, found from a recording alone, before any
model.

A reading taken e seconds off its stamp is off by e dy/dt. High differences of neighbouring samples
take the motion out and leave white noise; where its variance grows with the square of speed, and
with nothing else so well, the stamps scatter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np

from jaxid.data.dataset import Dataset, Experiment
from jaxid.data.noise import Noise, quantisation_step
from jaxid.data.signals import content_cutoff, differentiate, filter_ends


#: The differences that are asked, and how far the slope over speed squared is from zero by each, in
#: its standard deviations. Motion that is left in the third is less in the fifth; white noise is
#: the same in both: their spreads are this much alike.
ORDERS, ALIKE = {3: 4.0, 5: 3.0}, 0.1
#: Scatter counts from this share of the noise's variance on; of a quantised reading, at high speed,
#: from this many times that.
SEEN, STEPS = 0.1, 2.0
#: Fourth moment of the standardised differences: 1.8 for an even spread, 3 for a normal one. More
#: is bursts, not stamps; the more samples a difference has, the less well their speeds are known
#: near reversals.
MOMENTS = {3: (1.5, 4.0), 5: (1.5, 8.0)}
#: Log-likelihood by which speed squared has to beat position, acceleration and time as the cause,
#: and not to lose to speed.
BETTER, LOSE = 4.0, 4.0
FEWEST = 200  # samples
EVEN = 1e-6  # steps that differ by less than this share of their median are one step


@dataclass(frozen=True)
class Stamps:
    """Standard deviation of a channel's time stamps, s, its own standard deviation, and what was
    found in the recording.
    """

    spread: float
    std: float
    text: str


def scattered_stamps(dataset: Dataset, noise: Mapping[str, Noise]) -> dict[str, Stamps]:
    """Output channel -> its time stamps, for those whose stamps scatter visibly. Report runs are
    not looked at.
    """
    runs = [e for e in dataset.seen if len(e) >= FEWEST]
    if not runs:
        return {}
    found = {}
    for k, channel in enumerate(dataset.outputs):
        stamps = _stamps(runs, k, noise[channel.name].std, channel.name)
        if stamps is not None:
            found[channel.name] = stamps
    return found


def with_scatter(
    dataset: Dataset, stamps: Mapping[str, Stamps], noise: Mapping[str, Noise]
) -> Dataset:
    """The dataset whose readings scatter as their time stamps make them."""

    def scatter(e: Experiment) -> np.ndarray:
        columns = []
        for channel, y in zip(dataset.outputs, e.y.T, strict=True):
            if channel.name in stamps:
                speed = _speed(e.t, y, noise[channel.name].std)
                columns.append(stamps[channel.name].spread * speed)
            else:
                columns.append(0 * y)
        return np.stack(columns, 1)

    def with_own(e: Experiment) -> Experiment:
        return replace(e, scatter=scatter(e), past=with_own(e.past) if e.past else None)

    return replace(dataset, experiments=tuple(map(with_own, dataset.experiments)))


def _speed(t: np.ndarray, y: np.ndarray, noise: float) -> np.ndarray:
    """Magnitude of a noisy signal's rate [time]."""
    white = (
        max(noise, float(np.sqrt(np.mean(differences(t, y, 5)[0] ** 2)))) if len(t) > 20 else noise
    )
    return np.abs(differentiate(t, y, content_cutoff(t, y, white))[1])


def differences(t: np.ndarray, y: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """What no polynomial below `order` has of the samples, whatever their times [time - order], and
    the weights of the samples in it [time - order, order + 1]: of unit norm, so that white noise
    keeps its variance.
    """
    step = np.diff(t)
    even = np.ptp(step) < EVEN * np.median(step)
    at = np.lib.stride_tricks.sliding_window_view((t - t[0]) / np.median(step), order + 1)[
        : 1 if even else None
    ]
    weights = 1 / np.prod(at[:, :, None] - at[:, None, :] + np.eye(order + 1), axis=2)
    weights = np.broadcast_to(
        weights / np.linalg.norm(weights, axis=1, keepdims=True), (len(t) - order, order + 1)
    )
    return np.sum(weights * np.lib.stride_tricks.sliding_window_view(y, order + 1), 1), weights


def _stamps(runs: Sequence[Experiment], column: int, noise: float, name: str) -> Stamps | None:
    """See `scattered_stamps`, for one channel."""
    found = [_by_differences(runs, column, noise, order, sure) for order, sure in ORDERS.items()]
    if any(f is None for f in found):
        return None
    (first, std, share), (second, _, _) = [f for f in found if f is not None]
    if abs(first - second) > ALIKE * first:
        return None
    noise_text = (
        f"its noise grows with speed and is {np.sqrt(1 + share):.3g} times that at standstill in"
        " root mean square"
    )
    return Stamps(
        first,
        std,
        f"time stamps of {name} scatter by {1e3 * first:.3g} +- {1e3 * std:.2g} ms: {noise_text}",
    )


def _by_differences(
    runs: Sequence[Experiment], column: int, noise: float, order: int, sure: float
) -> tuple[float, float, float] | None:
    """Spread, its standard deviation, and the mean square of what it adds over that of the noise;
    None where the noise is not of that kind.
    """
    parts = [_squares_and_causes(e, column, noise, order) for e in runs]
    square, *causes = (np.concatenate(x) for x in zip(*parts, strict=True))
    if square.size < FEWEST or not square.any():
        return None
    # Differences that overlap remember each other.
    correlation = [comb(2 * order, order + k) / comb(2 * order, order) for k in range(1, order + 1)]
    memory = 1 + 2 * sum(c**2 for c in correlation)
    (slope, std, likelihood, moment), speed, *others = [
        _variance(square, c, memory) for c in causes
    ]
    added = slope * float(causes[0].mean())
    step = quantisation_step([e.y[:, column] for e in runs])
    fast = slope * float(np.percentile(causes[0], 95))
    likely = likelihood > max(speed[2] - LOSE, max(o[2] for o in others) + BETTER)
    visible = added > SEEN * noise**2 and (step is None or fast > STEPS * step**2 / 12)
    least, most = MOMENTS[order]
    if not (slope > sure * std and likely and visible and least < moment < most):
        return None
    spread = float(np.sqrt(slope))
    return spread, std / (2 * spread), added / noise**2


def _squares_and_causes(e: Experiment, column: int, noise: float, order: int) -> list[np.ndarray]:
    """The squared differences of a run, and what may cause them over the same samples: speed
    squared, speed, position squared, acceleration squared, time.
    """
    y = e.motion()[:, column]
    d, weights = differences(e.t, y, order)
    cutoff = content_cutoff(e.t, y, max(noise, float(np.sqrt(np.mean(d**2)))))
    q, rate, bend = differentiate(e.t, y, cutoff)[:3]
    ends = filter_ends(e.t, cutoff)
    inside = slice(ends, len(d) - ends)
    found = [d**2]
    for cause in (rate**2, np.abs(rate), (q - q.mean()) ** 2, bend**2, e.t - e.t[0]):
        windows = np.lib.stride_tricks.sliding_window_view(cause, order + 1)
        found.append(np.sum(weights**2 * windows, 1))
    return [x[inside] for x in found]


def _variance(
    square: np.ndarray, cause: np.ndarray, memory: float
) -> tuple[float, float, float, float]:
    """Squares of normal numbers whose variance is a line over a cause: its slope, the slope's
    standard deviation, the log-likelihood, and the fourth moment of the standardised numbers.
    """
    size = max(float(cause.mean()), 1e-300)
    X = np.stack([np.ones_like(cause), cause / size], 1)
    level = float(square.mean())
    variance = np.full(square.size, level)
    b = np.zeros(2)
    for _ in range(12):
        W = X / variance[:, None] ** 2
        b = np.linalg.lstsq(X.T @ W, W.T @ square, rcond=None)[0]
        variance = np.maximum(X @ b, 1e-3 * level)
    cov = np.linalg.pinv(X.T @ (X / variance[:, None] ** 2))
    likelihood = -0.5 * float(np.sum(np.log(variance) + square / variance)) / memory
    moment = float(np.mean((square / variance) ** 2))
    return float(b[1]) / size, float(np.sqrt(2 * memory * cov[1, 1])) / size, likelihood, moment
