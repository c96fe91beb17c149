"""Effects between the mechanism and the recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.dynamics.effect import OutputEffect, RecordEffect
from jaxid.dynamics.export_law import ExportLaw
from jaxid.dynamics.parameter import ANGLE, param, Quantity, STEP

from .actuator import LAG
from .timing import DELAY


class SensorBias(OutputEffect):
    """A sensor whose zero is off."""

    name: ClassVar[str] = "sensor_bias"
    equation: ClassVar[str] = "y -> y + bias"
    signature: ClassVar[str] = (
        "a constant offset; where gravity or a spring acts, a motion that belongs to another"
        " position"
    )
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = (
        "a rest at a position known otherwise (hanging freely, a stop, a level)"
    )
    axis: ClassVar[str] = "reading"
    seen: ClassVar[str] = "always, by the same amount"
    plain: ClassVar[str] = "The sensor reads {bias} too much at every position."
    check: ClassVar[str] = "Set the zero again at a mechanical stop or with a gauge."
    export_law: ClassVar = ExportLaw("reading", "y + bias")
    bias: Array = param(
        0.0, -0.5 * ANGLE, 0.5 * ANGLE, scale=0.005 * ANGLE, unit="{y}", meaning="reading at zero"
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ({"bias": 0.02 * ANGLE},)
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"bias": 0.003},
        {"bias": 0.03},
        {"bias": -0.3},
    )

    def offset(self):
        return self.bias

    def start(self, y, rate):
        return ()

    def __call__(self, y, s, z):
        return y + self.bias, z


class SensorScale(OutputEffect):
    """A sensor with a wrong gain."""

    name: ClassVar[str] = "sensor_scale"
    equation: ClassVar[str] = "y -> (1 + gain) y"
    signature: ClassVar[str] = "residual in proportion to the reading"
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = "two rests a known distance apart"
    axis: ClassVar[str] = "reading"
    seen: ClassVar[str] = "in proportion to the reading"
    plain: ClassVar[str] = "The sensor reads {gain:%} too much of every position."
    check: ClassVar[str] = "Check counts per turn and the gear ratio between sensor and joint."
    export_law: ClassVar = ExportLaw("reading", "(1 + gain) * y")
    gain: Array = param(
        0.0, -0.9, 2.0, scale=0.01, unit="1", meaning="share by which the sensor reads more"
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ({"gain": 0.03},)
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"gain": 0.005},
        {"gain": 0.03},
        {"gain": -0.3},
    )

    def start(self, y, rate):
        return ()

    def __call__(self, y, s, z):
        return (1 + self.gain) * y, z

    def transfer(self, omega):
        return 1 + self.gain + 0 * omega[:, None], 0 * self.gain * omega[:, None]


class SensorLag(OutputEffect):
    """A sensor or its filter of first order, exact for a signal that runs straight from step to
    step, also before the run.
    """

    name: ClassVar[str] = "sensor_lag"
    equation: ClassVar[str] = "lag dy'/dt = y - y'"
    signature: ClassVar[str] = (
        "phase lag and loss of gain towards high frequency, in this channel alone"
    )
    source: ClassVar[str] = "textbook; exact solution for a ramp"
    excitation: ClassVar[str] = (
        "one multisine with energy up to ten times the bandwidth, with a second sensor or a clock"
        " pulse"
    )
    axis: ClassVar[str] = "reading"
    seen: ClassVar[str] = "wherever the reading changes faster than in {lag}"
    plain: ClassVar[str] = "The reading is filtered: it follows with a time constant of {lag}."
    check: ClassVar[str] = (
        "Look up the filter of the sensor, and switch it off for the recording; a drive that"
        " answers late looks alike."
    )
    export_law: ClassVar = ExportLaw("reading", memory=LAG)
    lag: Array = param(0.0, 0.0, 0.1, scale=0.003, unit="s", meaning="time constant of the sensor")
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"lag": 0.001},
        {"lag": 0.006},
        {"lag": 0.03},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"lag": 0.003},
        {"lag": 0.01},
        {"lag": 0.05},
    )

    def start(self, y, rate):
        return y - self.lag * rate, y, jnp.zeros_like(y)

    def __call__(self, y, s, z):
        lagged, before, h = (
            z  # reading and signal at the last step's beginning, and how long ago that was
        )
        present = self.lag > 0
        lag, h = jnp.where(present, self.lag, 1.0), jnp.where(h > 0, h, 1.0) + 0 * y
        slope = jnp.where(z[2] > 0, (y - before) / h, 0.0)
        after = y - slope * lag + (lagged - before + slope * lag) * jnp.exp(-h / lag)
        reading = jnp.where(present, jnp.where(z[2] > 0, after, y + (lagged - before)), y)
        return reading, (reading, y, s.h + 0 * y)

    def transfer(self, omega):
        x = omega[:, None] * self.lag
        return 1 / (1 + x * x), -x / (1 + x * x)


class SensorDelay(RecordEffect):
    """A sensor or logger that is late; before the run the signal ran straight, with the speed that
    it begins with.

    Taken from the simulated series by cubic interpolation, at any delay and sampling.
    """

    name: ClassVar[str] = "sensor_delay"
    mirrors: ClassVar[str] = "input_delay"
    equation: ClassVar[str] = "y(t) -> y(t - delay)"
    signature: ClassVar[str] = (
        "phase lag that grows in proportion to frequency, in this channel alone"
    )
    source: ClassVar[str] = "exact but for the interpolation (four points)"
    excitation: ClassVar[str] = (
        "a pulse that both the command and this channel record, or closed loop with the command"
        " logged"
    )
    axis: ClassVar[str] = "reading"
    seen: ClassVar[str] = "wherever the reading changes"
    plain: ClassVar[str] = "The reading arrives {delay} late."
    check: ClassVar[str] = (
        "Look at the bus, the driver's buffer, and which clock stamps the samples."
    )
    acts_on: ClassVar[str] = "timing"
    export_law: ClassVar = ExportLaw("reading", memory=DELAY)
    delay: Array = param(0.0, 0.0, 0.1, scale=0.002, unit="s", meaning="delay of the reading")
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"delay": 0.001},
        {"delay": 1.0 * STEP},
        {"delay": 0.004},
        {"delay": 0.015},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"delay": 0.0013},
        {"delay": 0.006},
        {"delay": 0.0271},
    )

    def __call__(self, t, y, h, rate):
        def late(x, d, r):
            return interpolated(t, x, t - d, r) if h is None else shifted(x, d / h, r * h)

        return jnp.where(self.delay > 0, jax.vmap(late, (1, 0, 0), 1)(y, self.delay, rate), y)

    def transfer(self, omega):
        angle = omega[:, None] * self.delay
        return jnp.cos(angle), -jnp.sin(angle)


class TimestampJitter(RecordEffect):
    """Time stamps that scatter around the true instants.

    What it does to a reading's mean is second order; mostly it is noise that grows with speed, of
    standard deviation `spread` |dy/dt|. A fit and a diagnosis read the spread off the recording
    itself where that shows it (`time_stamps`).
    """

    name: ClassVar[str] = "timestamp_jitter"
    equation: ClassVar[str] = (
        "y -> y(t + e), e normal: mean y + spread^2 / 2 d2y/dt2, noise spread |dy/dt| beside the"
        " sensor's"
    )
    signature: ClassVar[str] = "white residuals whose variance grows with the square of speed"
    source: ClassVar[str] = "second-order expansion"
    excitation: ClassVar[str] = (
        "the same motion slowly and fast, with a hardware clock beside the recorder's"
    )
    axis: ClassVar[str] = "time"
    seen: ClassVar[str] = "at high speed"
    plain: ClassVar[str] = "The time stamps scatter by {spread}."
    check: ClassVar[str] = "Let the device stamp the samples, or record on a real-time system."
    export_law: ClassVar = "a fault of the log's clock, not of the robot: mend the time stamps"
    spread: Array = param(
        0.0, 0.0, 0.02, scale=0.001, unit="s", meaning="standard deviation of the time stamps"
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"spread": 0.003},
        {"spread": 0.01},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"spread": 0.002},
        {"spread": 0.005},
        {"spread": 0.01},
    )

    def __call__(self, t, y, h, rate):
        h = jnp.diff(t)[:, None]
        slope = jnp.diff(y, axis=0) / h
        bend = 2 * jnp.diff(slope, axis=0) / (h[1:] + h[:-1])
        return y.at[1:-1].add(self.spread**2 / 2 * bend)


def interpolated(
    t: Float[Array, " time"],
    y: Float[Array, " time"],
    at: Float[Array, " n"],
    rate: Float[Array, ""],
) -> Float[Array, " n"]:
    """A series at other times through the four samples around each (Lagrange); straight, with this
    rate, before it begins.
    """
    k = jnp.clip(jnp.searchsorted(t, at, side="right") - 2, 0, t.shape[0] - 4)
    return jnp.where(
        at <= t[0],
        y[0] + rate * (at - t[0]),
        _cubic(at, [t[k + i] for i in range(4)], [y[k + i] for i in range(4)]),
    )


def shifted(
    y: Float[Array, " time"], steps: Float[Array, ""], rise: Float[Array, ""]
) -> Float[Array, " time"]:
    """The same for a series by equal steps that is late by this many of them, and rose by `rise` in
    each before it began: four slices instead of a search for each sample.
    """
    whole = jnp.floor(steps)
    part = 1 - (steps - whole)  # from the second of the four samples
    before, after = (
        4 * y[0] - 6 * y[1] + 4 * y[2] - y[3],
        4 * y[-1] - 6 * y[-2] + 4 * y[-3] - y[-4],
    )  # on the same cubic
    n = y.shape[0]
    late = jnp.concatenate([jnp.full((n,), y[0]), y[:1], before[None], y, after[None]])
    begin = n - jnp.clip(whole, 0, n).astype(jnp.int32)
    window = jax.lax.dynamic_slice_in_dim(late, begin, n + 3)
    return jnp.where(
        jnp.arange(n) <= steps,
        y[0] + rise * (jnp.arange(n) - steps),
        _cubic(part, (-1, 0, 1, 2), [window[i : i + n] for i in range(4)]),
    )


def _cubic(at: Any, places: Sequence[Any], values: Sequence[Array]) -> Array:
    """The cubic through four values at four places (Lagrange)."""
    total = jnp.zeros_like(values[0])
    for i, place in enumerate(places):
        weight = 1.0
        for other in (*places[:i], *places[i + 1 :]):
            weight = weight * (at - other) / (place - other)
        total = total + weight * values[i]
    return total
