"""What a recording needs of a device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from jaxid.data.limits import Limits
from jaxid.hardware.recorder import Stream
from jaxid.hardware.trajectory import Trajectory


class Sample(NamedTuple):
    """One row: host time (s, monotonic), device time (s), one number for each column of the
    stream.
    """

    host: float
    device: float
    values: Sequence[float]


class DeviceReading(NamedTuple):
    """What of a sample is compared with limits."""

    q: Sequence[float]
    qd: Sequence[float]
    current: Sequence[float]
    temperature: Sequence[float] = ()


@dataclass(frozen=True, eq=False)
class PathPlan:
    """A path as it will be sent: `table [rows joints]` every `step` s, clamped to `lower`, `upper`
    and `largest_step` from `start` on. `marks` (row, name) become events.
    """

    kind: str
    table: np.ndarray
    step: float
    lower: Sequence[float]
    upper: Sequence[float]
    largest_step: Sequence[float]
    start: Sequence[float]
    marks: Sequence[tuple[int, str]] = ()

    @property
    def duration(self) -> float:
        return len(self.table) * self.step

    def order(self) -> dict[str, Any]:
        """As a message to a driver that has the table."""
        return {
            "mode": self.kind,
            "step": self.step,
            "lower": list(self.lower),
            "upper": list(self.upper),
            "largest_step": list(self.largest_step),
            "start": list(self.start),
            "marks": [list(m) for m in self.marks],
        }


@dataclass
class News:
    """What came from a device since the last look: samples, commands with their own times, and the
    driver's messages.
    """

    samples: list[Sample] = field(default_factory=list)
    commands: list[Sample] = field(default_factory=list)
    messages: list[Mapping[str, Any]] = field(default_factory=list)


class Device(Protocol):
    """A robot or servo that can be recorded, and moved. Every method may raise `HardwareError` or,
    before anything moves, `UsageError`.
    """

    name: str
    joints: int
    kinds: tuple[str, ...]  # of commands it takes
    command_step: float  # s between the commands of a path

    def open(self) -> None:
        """Connects and checks; changes nothing on the device."""
        ...

    def streams(self) -> list[Stream]:
        """Its samples, and its commands where they are recorded by themselves (clock
        `COMMANDS`).
        """
        ...

    def limits(self) -> Limits:
        """Its own limits, which a user's can only tighten."""
        ...

    def begin(self) -> None:
        """Samples flow from now on, and have to be taken."""
        ...

    def filenos(self) -> list[int]:
        """What to wait on."""
        ...

    def news(self) -> News: ...

    def measured(self, values: Sequence[float]) -> DeviceReading: ...

    def alarm(self, values: Sequence[float], moving: bool) -> str | None:
        """Why a recording must end, from the device's own status."""
        ...

    def plan(self, trajectory: Trajectory, limits: Limits, values: Sequence[float]) -> PathPlan:
        """How a path would be sent, starting from the sample `values`."""
        ...

    def load(self, plan: PathPlan) -> None:
        """Hands the path over to the driver while samples go on; messages `want` and, in the end,
        `loaded` follow.
        """
        ...

    def arm(self, plan: PathPlan, data_age: float) -> None:
        """Takes control, with watchdogs that stop after `data_age` s of silence; the message
        `armed` follows.
        """
        ...

    def play(self, plan: PathPlan) -> None:
        """Moves; messages `mark`, `progress` and `done` follow."""
        ...

    def beat(self) -> None:
        """Tells the driver that all is well; without it motion ends by itself."""
        ...

    def losses(self) -> dict[str, int]:
        """Samples that the line lost, by reason."""
        ...

    def stop(self, reason: str) -> str:
        """Ends all motion and gives up control, whatever state things are in; says how."""
        ...

    def close(self) -> None: ...


def still(kind: str, center: np.ndarray) -> np.ndarray:
    """The command at which nothing moves: the place itself, or zero."""
    return center if kind == "position" else np.zeros_like(center)


def approach(start: np.ndarray, end: np.ndarray, limits: Limits, step: float) -> np.ndarray:
    """A straight way in joint space `[rows joints]` at rest at both ends, at no more than a third
    of the limits.
    """
    distance = np.abs(end - start)
    if distance.max() < 1e-6:
        return np.zeros((0, len(start)))
    duration = 0.5
    for j, d in enumerate(distance):
        if limits.speed is not None:
            duration = max(
                duration, 1.875 * d / (0.33 * limits.speed[j])
            )  # peak speed of the polynomial below
        if limits.acceleration is not None:
            duration = max(duration, float(np.sqrt(5.78 * d / (0.33 * limits.acceleration[j]))))
    s = np.linspace(0.0, 1.0, int(np.ceil(duration / step)) + 1)[1:]
    return start + (s**3 * (10 - 15 * s + 6 * s**2))[:, None] * (end - start)
