"""When a command takes effect: its hold between samples, and its delay. Cheap to simulate by
themselves, and asked first.
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxid.dynamics.effect import InputEffect
from jaxid.dynamics.export_law import ExportLaw, StandsFor
from jaxid.dynamics.parameter import param, Quantity, STEP


#: Once a step of `dt` s, in a simulator.
DELAY = '''class Delay:
    """The value of `delay` s ago, linear between steps."""

    def __init__(self, delay):
        self.delay, self.past = delay, []

    def __call__(self, value, dt):
        self.past.insert(0, value)
        steps = self.delay / dt
        k = int(steps)
        del self.past[k + 2 :]
        old = lambda i: self.past[min(i, len(self.past) - 1)]
        return old(k) + (steps - k) * (old(k + 1) - old(k))
'''


class InputDelay(InputEffect):
    """A pure transport delay of the command."""

    name: ClassVar[str] = "input_delay"
    mirrors: ClassVar[str] = "sensor_delay"
    stage: ClassVar[int] = 0
    equation: ClassVar[str] = "u(t) -> u(t - delay)"
    signature: ClassVar[str] = "phase lag that grows in proportion to frequency"
    source: ClassVar[str] = "exact for a held input: mean of the delayed command over the step"
    excitation: ClassVar[str] = (
        "one multisine with energy up to ten times the bandwidth, and a recorded clock pulse"
    )
    axis: ClassVar[str] = "command"
    seen: ClassVar[str] = "wherever the command changes"
    plain: ClassVar[str] = "Commands take effect {delay} late."
    check: ClassVar[str] = (
        "Time a step of the command against the first motion; look at buses, filters and the"
        " control period between."
    )
    acts_on: ClassVar[str] = "timing"
    stands_for: ClassVar = StandsFor("delay", "delay", fitted="delay")
    export_law: ClassVar = ExportLaw("command", memory=DELAY)
    by_torque: ClassVar[bool] = True
    column: ClassVar = staticmethod(lambda torque, step: np.gradient(torque, step, axis=0))
    delay: Array = param(0.0, 0.0, 0.1, scale=0.002, unit="s", meaning="delay of the command")
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

    def start(self, u):
        return ()

    def __call__(self, u, s, z):
        change = s.command.delayed(self.delay) - s.command.u
        return jnp.where(self.delay > 0, u + change, u), z

    def late(self):
        return self.delay

    def transfer(self, omega):
        angle = omega[:, None] * self.delay
        return jnp.cos(angle), -jnp.sin(angle)


class InputHold(InputEffect):
    """How the command runs between its samples: as stated, or the other of zero-order hold and
    linear interpolation.
    """

    name: ClassVar[str] = "input_hold"
    stage: ClassVar[int] = 0
    equation: ClassVar[str] = (
        "u -> (1 - share) u_stated + share u_other   (zero-order against linear hold)"
    )
    signature: ClassVar[str] = "half a sample of lead or lag between command and motion"
    source: ClassVar[str] = (
        "a wrong hold alone moves well-known tools by 1 to 3 % on a clean pendulum"
    )
    excitation: ClassVar[str] = (
        "a command that changes at every sample (fast chirp), and the same at half the sampling rate"
    )
    axis: ClassVar[str] = "command"
    seen: ClassVar[str] = "wherever the command changes from sample to sample"
    plain: ClassVar[str] = (
        "Between its samples the command does not run as stated: {share:%} of it follows the other"
        " hold (steps against straight lines)."
    )
    check: ClassVar[str] = (
        "Look up whether the drive keeps a command until the next one or ramps to it, and state it"
        " as the channel's hold."
    )
    acts_on: ClassVar[str] = "timing"
    export_law: ClassVar = (
        "hold or interpolate the commands between their samples as the effect says; no model file"
        " says it"
    )
    stated_as: ClassVar[str] = "hold"
    share: Array = param(
        0.0, 0.0, 1.0, scale=0.2, unit="1", meaning="0 the stated hold, 1 the other one"
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ({"share": 1.0},)
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"share": 0.2},
        {"share": 0.5},
        {"share": 1.0},
    )

    def start(self, u):
        return ()

    def __call__(self, u, s, z):
        return u + self.share * (s.command.other - s.command.u), z
