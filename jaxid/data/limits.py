"""Limits of a motion: position, speed, acceleration, torque."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from jaxid.base.errors import nearest, UsageError
from jaxid.base.numbers import is_number
from jaxid.base.small_files import read_small
from jaxid.base.wording import names_of


@dataclass(frozen=True)
class Limits:
    """Bounds of each joint, one number a joint or one for all; None is no bound.

    `lower`, `upper` rad; `speed` rad/s; `acceleration` rad/s^2; `current` A; `temperature` K.
    `step` is the largest change from one command to the next (rad, rad/s or A, as the command is).
    `tracking` is how far (rad) a joint may be from where it is told to be. `data_age` s is how long
    anything may be silent while something moves: the measurements, the recording process, and the
    driver, for the watchdog of the device itself.
    """

    lower: tuple[float, ...] | None = None
    upper: tuple[float, ...] | None = None
    speed: tuple[float, ...] | None = None
    acceleration: tuple[float, ...] | None = None
    current: tuple[float, ...] | None = None
    temperature: tuple[float, ...] | None = None
    step: tuple[float, ...] | None = None
    tracking: tuple[float, ...] | None = None
    data_age: float = 0.1

    def __post_init__(self):
        if not (is_number(self.data_age) and 0.02 <= self.data_age <= 2.0):
            raise UsageError(f"limit data_age is {self.data_age!r} s; write 0.02 to 2")
        object.__setattr__(self, "data_age", float(self.data_age))
        for name, value in self.stated.items():
            numbers = _numbers(name, value)
            if name not in ("lower", "upper") and min(numbers) <= 0:
                raise UsageError(f"limit {name} is {value!r}; write numbers above 0")
            object.__setattr__(self, name, numbers)

    @property
    def stated(self) -> dict[str, Any]:
        """The bounds of joints that there are, by name."""
        names = [name for name in names_of(fields(self)) if name != "data_age"]
        bounds = {name: getattr(self, name) for name in names}
        return {name: value for name, value in bounds.items() if value is not None}

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Limits:
        """From a TOML file whose keys are the fields, as in `speed = [1.0, 1.0, 1.5]`; raises
        `UsageError`.
        """
        path = Path(path)
        try:
            content = tomllib.loads(read_small(path).decode())
        except OSError as error:
            raise UsageError(f"limits {path}: cannot be read ({error.strerror})") from error
        except ValueError as error:
            raise UsageError(f"limits {path}: not readable as TOML: {error}") from error
        known = names_of(fields(cls))
        for name in content:
            if name not in known:
                raise UsageError(f"limits {path}: there is no limit {name!r}{nearest(name, known)}")
        try:
            return cls(**content)
        except (TypeError, UsageError) as error:
            raise UsageError(f"limits {path}: {error}") from error

    def widened(self, joints: int) -> Limits:
        """The same with one number for each joint; raises `UsageError` where a list has another
        length.
        """
        wide = {}
        for name, value in self.stated.items():
            if len(value) not in (1, joints):
                raise UsageError(
                    f"limit {name} has {len(value)} numbers for {joints} joints; write 1 or"
                    f" {joints}"
                )
            wide[name] = value * joints if len(value) == 1 else value
        return replace(self, **wide)

    def within(self, device: Limits, joints: int) -> Limits:
        """These limits where they are tighter, else those of the device."""
        own, other = self.widened(joints), device.widened(joints).stated
        merged = other | own.stated
        for name in other.keys() & own.stated.keys():
            tighter = max if name == "lower" else min
            merged[name] = tuple(map(tighter, own.stated[name], other[name]))
        return replace(own, **merged)

    def violation(
        self,
        q: Sequence[float],
        qd: Sequence[float],
        current: Sequence[float] = (),
        temperature: Sequence[float] = (),
    ) -> str | None:
        """One sentence on the first measurement beyond its limit, or None; rad, rad/s, A, K.

        Positions may pass theirs by one percent and speeds and currents by ten, for measurements
        are noisy.
        """
        return (
            self._violation("temperature", temperature, None, self.temperature, "K", 0.0)
            or self._violation("q", q, self.lower, self.upper, "rad", 0.01)
            or self._violation("qd", qd, _negative(self.speed), self.speed, "rad/s", 0.1)
            or self._violation("current", current, _negative(self.current), self.current, "A", 0.1)
        )

    @staticmethod
    def _violation(name, values, lower, upper, unit: str, margin: float) -> str | None:
        for j, value in enumerate(values):
            measured = f"measured {name}{j + 1}" if len(values) > 1 else f"measured {name}"
            if not math.isfinite(value):
                return f"{measured} is {value}"
            measured += f" = {value:.4g} {unit}"
            if upper is not None and value > upper[j] + margin * max(abs(upper[j]), 1e-3):
                return f"{measured} is above its limit of {upper[j]:.4g} {unit}"
            if lower is not None and value < lower[j] - margin * max(abs(lower[j]), 1e-3):
                return f"{measured} is below its limit of {lower[j]:.4g} {unit}"
        return None


def _numbers(name: str, value: Any) -> tuple[float, ...]:
    """One number, or one a joint. Raises `UsageError` for anything else."""
    numbers = [value] if isinstance(value, int | float) else list(value)
    if not numbers or not all(map(is_number, numbers)):
        raise UsageError(f"limit {name} is {value!r}; write a number, or one number a joint")
    return tuple(map(float, numbers))


def _negative(upper: tuple[float, ...] | None) -> tuple[float, ...] | None:
    return None if upper is None else tuple(-v for v in upper)
