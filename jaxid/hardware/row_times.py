"""The times of the rows of a recording: the device's clock against the host's, gaps, repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxid.base.wording import names_of
from jaxid.hardware.clock import ClockMap, from_arrivals, within_tick
from jaxid.hardware.recorder import Stream, StreamRows


@dataclass(frozen=True)
class RowTimes:
    """The main stream's own time: `keep` which rows, `t` from 0, `zero` device time of t = 0,
    `host` the host against it.
    """

    keep: np.ndarray
    t: np.ndarray
    zero: float
    host: ClockMap
    rate: float
    lost: int
    duplicated: int
    gaps: list[tuple[float, float, int]]
    notes: list[str]
    blur: float  # standard deviation of each time (s)
    asked: ClockMap  # host time of sending against the device time of arrival

    def since_start(self, host: float) -> float:
        """Time since t = 0 of an instant of the host, s."""
        return float(self.host.inverse(np.array([host]))[0] - self.zero)


def row_times(stream: Stream, rows: StreamRows) -> RowTimes:
    """The times of the main stream's rows, and what is lost or stands there twice."""
    clock = _device_clock(stream, rows)
    rising = np.flatnonzero(is_rising(rows.device))
    keep = rising[is_rising(clock.device[rising])]
    notes = []
    back = int(np.sum(np.diff(rows.device) < 0))
    if back:
        notes.append(f"the device's clock went backwards {back} times; those rows were left out")
    t = clock.device[keep]
    zero = float(t[0])
    step = np.diff(t)
    median = float(np.median(step)) if len(step) else 0.0
    period = stream.period or median
    if period and median > 1.5 * period:
        notes.append(
            f"the device sends {1 / median:.1f} samples a second where {1 / period:.1f} were"
            " asked for"
        )
        period = median
    # A device that sends by itself has lost what is not there; one that is asked may have been
    # asked late.
    polled = bool(stream.info.get("tick_s"))
    missing = np.zeros(len(step), int)
    if period:
        missing = np.maximum(np.round(step / period).astype(int) - 1, 0)
    missing[step < 2.5 * period] *= not polled
    gaps = [
        (round(float(t[k] - zero), 6), round(float(t[k + 1] - zero), 6), int(missing[k]))
        for k in np.flatnonzero(missing)
    ]
    if gaps:
        worst = max(gaps, key=lambda g: g[2])
        notes.append(
            f"{len(gaps)} gaps of {missing.sum()} samples together, the longest from {worst[0]:.3f}"
            f" to {worst[1]:.3f} s"
        )
    repeated = len(rows.device) - len(keep) - back
    return RowTimes(
        keep=keep,
        t=np.round(t - zero, 9),
        zero=zero,
        host=clock.host,
        rate=(len(t) - 1) / float(t[-1] - t[0]) if len(t) > 1 else 0.0,
        lost=int(missing.sum()),
        duplicated=max(repeated, 0),
        gaps=gaps,
        notes=notes,
        blur=clock.blur,
        asked=clock.asked,
    )


@dataclass(frozen=True)
class _DeviceClock:
    """`device` times of all rows, the host against them, their blur, and the host's time of asking
    against them.
    """

    device: np.ndarray
    host: ClockMap
    blur: float
    asked: ClockMap


def _device_clock(stream: Stream, rows: StreamRows) -> _DeviceClock:
    device = rows.device
    rising = is_rising(device)
    if rising.sum() < 4:
        offset = float(rows.host[0] - device[0])
        host = ClockMap(offset, 0.0, 0.0, 0.0, "too few samples to compare clocks")
        return _DeviceClock(device, host, 0.0, host)
    tick = stream.info.get("tick_s")
    if not tick:
        host = from_arrivals(device[rising], rows.host[rising])
        return _DeviceClock(device, host, 0.0, host)
    names = names_of(stream.columns)
    sent = rows.values[rising, names.index("t_sent")]
    answered = rows.values[rising, names.index("t_received")]
    fine = device.copy()
    fine[rising], host, blur, asked = within_tick(device[rising], tick, sent, answered)
    return _DeviceClock(fine, host, blur, asked or host)


def is_rising(t: np.ndarray) -> np.ndarray:
    """Which samples are later than every one before them."""
    top = np.maximum.accumulate(t)
    return np.concatenate([[True], t[1:] > top[:-1]])
