"""Channels that were moved in time by a fraction of a row, and what that leaves unknown.

When a sample lies within its row is known no better than `FINEST`. A machine whose causes come that
much earlier moves that much earlier: its readings are off by that time, times their rate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxid.data.dataset import Dataset
from jaxid.data.experiment import Channel, StatedChannel


#: The time of a reading within its row is known no better, whatever scatters (rows, one standard
#: deviation).
FINEST = 0.05


def retimed(channel: Channel, delay_s: float, clock_ppm: float) -> Channel:
    """A channel that says by how much more its samples were moved in time."""
    if not (delay_s or clock_ppm):
        return channel
    stated = channel.stated or StatedChannel(channel.unit)
    delay, drift = stated.delay_s + delay_s, stated.clock_ppm + clock_ppm
    return replace(channel, stated=replace(stated, delay_s=delay, clock_ppm=drift))


def known_within(dataset: Dataset) -> dict[str, float]:
    """Output channel -> how near it can be followed (rms, SI), for those that were moved by a
    fraction of a row, and for all of them where an input was.
    """
    runs = dataset.seen or list(dataset.experiments)
    if not runs:
        return {}
    step = float(np.median([np.median(np.diff(e.t)) for e in runs]))
    causes = any(_is_between_rows(c, step) for c in dataset.inputs)
    out = {}
    for k, channel in enumerate(dataset.outputs):
        if not (causes or _is_between_rows(channel, step)):
            continue
        rates = [np.gradient(e.motion()[:, k], e.t) for e in runs]
        rate = float(np.sqrt(np.mean(np.concatenate(rates) ** 2)))
        out[channel.name] = FINEST * step * rate
    return out


def _is_between_rows(channel: Channel, step: float) -> bool:
    stated = channel.stated
    if stated is None:
        return False
    rows = stated.delay_s / step
    return stated.clock_ppm != 0 or abs(rows - round(rows)) > FINEST
