"""An auxiliary sensor beside the main device: lines of numbers on a serial port, or a file that
another logger wrote.
"""

from __future__ import annotations

import os
import time
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator, ValidationError

from jaxid.base.errors import UsageError
from jaxid.base.small_files import read_small
from jaxid.data.units import Conversion, conversion, UnitError
from jaxid.hardware.device import Sample
from jaxid.hardware.errors import HardwareError
from jaxid.hardware.port import opened
from jaxid.hardware.recorder import Column, Stream


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _Channel(_Strict):
    column: str
    unit: str
    role: Literal["input", "output", "auxiliary"] = "auxiliary"
    scale: FiniteFloat = 1.0
    offset: FiniteFloat = 0.0
    noise_std: FiniteFloat | None = Field(default=None, gt=0)
    resolution: FiniteFloat | None = Field(default=None, gt=0)

    def as_column(self, name: str) -> Column:
        """The column of a recording, in SI."""
        si = conversion(self.unit)
        hold = "linear" if self.role == "input" else "zero"
        widths = [self.resolution, self.noise_std]
        resolution, noise = (w and w * si.factor for w in widths)
        return Column(name, si.si, self.role, resolution, noise, hold)


class _Time(_Strict):
    column: str
    unit: str = "s"
    #: The counter starts again from 0 here, in its own unit.
    wraps_at: FiniteFloat | None = Field(default=None, gt=0)


class _Match(_Strict):
    column: str
    to: str
    derivative: int = Field(default=0, ge=0, le=2)
    search_s: FiniteFloat | None = Field(default=None, gt=0)


class SensorSpec(_Strict):
    """A sensor as its TOML file describes it.

    With `port`, lines of `columns` separated by commas arrive at `baud`; `time` names the sensor's
    own clock (without one, the arrival time counts, which adds the unknown delay of the line). With
    `file`, a CSV or Parquet file is added afterwards, and `match` says which of its columns follows
    which channel of the main device (`derivative` 2: an accelerometer and an angle).
    """

    name: str = Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")
    port: str | None = None
    file: str | None = None
    baud: int = Field(default=115200, gt=0)
    columns: list[str] = []
    time: _Time | None = None
    match: _Match | None = None
    channels: dict[str, _Channel] = Field(min_length=1)

    @model_validator(mode="after")
    def _complete(self) -> SensorSpec:
        if (self.port is None) == (self.file is None):
            raise ValueError("state either `port` or `file`")
        if self.port is not None and not self.columns:
            raise ValueError("a `port` needs `columns`, the names of the numbers in a line")
        if self.file is not None and (self.match is None or self.time is None):
            raise ValueError(
                "a `file` needs `time` and `match`: its clock is not the main one, and a shared"
                " motion tells its offset"
            )
        if self.port is not None:
            for column in self.used:
                if column not in self.columns:
                    raise ValueError(f"column {column!r} is not among `columns`")
        for name, channel in self.channels.items():
            try:
                conversion(channel.unit)
            except UnitError as error:
                raise ValueError(f"channel {name}: {error}") from None
        return self

    @property
    def used(self) -> list[str]:
        """The columns that are read: those of the channels, and of the time."""
        channels = [c.column for c in self.channels.values()]
        return channels if self.time is None else [*channels, self.time.column]

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> SensorSpec:
        """Raises `UsageError` with what is wrong. A `file` is looked for beside the description."""
        path = Path(path)
        try:
            spec = cls.model_validate(tomllib.loads(read_small(path).decode()))
        except OSError as error:
            raise UsageError(f"sensor {path}: cannot be read ({error.strerror})") from error
        except ValidationError as error:
            faults = []
            for fault in error.errors():
                place = ".".join(map(str, fault["loc"]))
                faults.append(f"{place}: {fault['msg'].removeprefix('Value error, ')}")
            raise UsageError(f"sensor {path}: {'; '.join(faults)}") from error
        except ValueError as error:
            raise UsageError(f"sensor {path}: not readable as TOML: {error}") from error
        if spec.file is None:
            return spec
        return spec.model_copy(update={"file": str(path.parent / spec.file)})

    def stream(self) -> Stream:
        columns = tuple(c.as_column(name) for name, c in self.channels.items())
        clock = "arrival at the host"
        if self.time is not None:
            clock = f"sensor time, column {self.time.column!r}"
        about = {"description": self.model_dump(exclude_none=True)}
        return Stream(self.name, columns, clock, None, about)

    def convert(self, row: Mapping[str, Any]) -> list[Any]:
        """SI values of the channels from a row of columns (numbers or arrays)."""
        out = []
        for c in self.channels.values():
            si: Conversion = conversion(c.unit)
            out.append(si.factor * (c.scale * row[c.column] + c.offset) + si.shift)
        return out

    def rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (s, sensor clock) and SI values `[rows channels]` of a `file`. Raises
        `UsageError`.
        """
        from jaxid.data.table import read_table

        assert self.file is not None and self.time is not None
        path = Path(self.file)
        try:
            table = read_table(path, path.name, path.read_bytes())
        except OSError as error:
            raise UsageError(f"sensor file {path}: cannot be read ({error.strerror})") from error
        for problem in table.problems:
            raise UsageError(f"sensor file {path}: {problem}")
        columns = {}
        for name in (self.time.column, *self.used):
            if name not in table.columns:
                raise UsageError(f"sensor file {path}: {table.missing(name, 'the sensor')}")
            columns[name] = table.numbers(name).values
        for name, values in columns.items():
            if not np.isfinite(values).all():
                row = table.row(int(np.flatnonzero(~np.isfinite(values))[0]))
                raise UsageError(
                    f"sensor file {path}: row {row}, column {name}: no number; remove the row"
                )
        t = columns[self.time.column] * conversion(self.time.unit).factor
        if len(t) < 20 or np.diff(t).min() <= 0:
            raise UsageError(f"sensor file {path}: its time must rise over at least 20 rows")
        return t, np.stack(np.broadcast_arrays(*self.convert(columns)), axis=1)


@dataclass
class SerialSensor:
    """A sensor on a serial port, read line by line; a line that is not the stated numbers is
    counted and left out.
    """

    spec: SensorSpec
    malformed: int = 0

    def __post_init__(self):
        self.line: Any = None
        self._buffer = b""
        self._turns, self._last = 0.0, None

    def open(self) -> None:
        assert self.spec.port is not None
        try:
            self.line = opened(self.spec.port, self.spec.baud)
        except UsageError as error:
            raise UsageError(f"sensor {self.spec.name}: {error}") from None

    def fileno(self) -> int:
        return self.line.fileno()

    def read(self) -> list[Sample]:
        """What has arrived. Raises `HardwareError` where the port is gone."""
        try:
            block = self.line.read(self.line.in_waiting or 1)
        except OSError as error:
            raise HardwareError(
                f"sensor {self.spec.name}: port {self.spec.port} is gone ({error})"
            ) from None
        now = time.monotonic()
        first = not self._buffer and self._last is None
        *lines, self._buffer = (self._buffer + block).split(b"\n")
        samples = []
        for k, line in enumerate(lines):
            try:
                numbers = [float(w) for w in line.decode("ascii").strip().split(",")]
                row = dict(zip(self.spec.columns, numbers, strict=True))
                if not all(map(np.isfinite, numbers)):
                    raise ValueError
            except ValueError:
                # The first line may have begun before we listened.
                self.malformed += k > 0 or not first
                continue
            samples.append(Sample(now, self._time(row, now), self.spec.convert(row)))
        return samples

    def _time(self, row: Mapping[str, float], now: float) -> float:
        clock = self.spec.time
        if clock is None:
            return now
        raw = row[clock.column]
        if clock.wraps_at is not None and self._last is not None:
            if raw < self._last - clock.wraps_at / 2:
                self._turns += clock.wraps_at
        self._last = raw
        return (raw + self._turns) * conversion(clock.unit).factor

    def close(self) -> None:
        if self.line is not None:
            self.line.close()
