"""A recorded run, a measured frequency response, and the channels of either."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np


def _frozen(values: Any, dtype: type = float) -> np.ndarray:
    owned = isinstance(values, np.ndarray) and values.flags.owndata and not values.flags.writeable
    if owned and values.dtype == dtype:
        return values
    array = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class StatedChannel:
    """How `dataset.toml` says a channel was recorded: value = scale * raw + offset in `unit`, and
    factor * value in SI.
    """

    unit: str
    factor: float = 1.0
    scale: float = 1.0
    offset: float = 0.0
    column: str = ""
    shift: int = 0
    clock_ppm: float = 0.0
    delay_s: float = 0.0


@dataclass(frozen=True)
class Channel:
    """One measured signal, in SI; `noise_std` (one standard deviation) and `resolution`
    (quantisation step) too. `stated` is what the dataset says of how it was recorded, for messages.
    """

    name: str
    role: str  # "input" | "output" | "auxiliary"
    unit: str
    noise_std: float | None = None
    resolution: float | None = None
    hold: str = "zero"  # an input between its samples: "zero" | "linear"
    stated: StatedChannel | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, eq=False)
class Experiment:
    """One recorded run.

    `t [time]` s, strictly increasing; `u [time nu]` inputs; `y [time ny]` outputs; `auxiliary`
    channel -> `[time]`. `initial` (state -> value) or `at_rest` fix the initial state; with neither
    it is estimated. `past` samples before the first of `t` belong to the same recording and to none
    of its splits: delays, lags and friction that remember bring their state from there. `source`
    says where the samples stand, for messages. `scatter [time ny]` is the standard deviation of
    what each reading is off by beside its channel's noise, where that is known (see `time_stamps`).
    `left_out [time ny]` marks readings that count in no loss (glitches, repeated rows); `y` keeps
    there what was recorded. `repeat_of` names the run of which this is a repeat.
    """

    name: str
    split: str  # "fit" | "validation" | "report"
    t: np.ndarray
    u: np.ndarray
    y: np.ndarray
    auxiliary: dict[str, np.ndarray] = field(default_factory=dict)
    initial: dict[str, float] | None = None
    at_rest: bool = False
    constants: dict[str, float] = field(default_factory=dict)
    initial_window_s: float | None = None
    past: Experiment | None = None
    source: str = ""
    scatter: np.ndarray | None = None
    left_out: np.ndarray | None = None
    repeat_of: str | None = None

    def __post_init__(self):
        t = _frozen(self.t)
        object.__setattr__(self, "t", t)
        object.__setattr__(self, "u", _frozen(self.u))
        object.__setattr__(self, "y", _frozen(self.y))
        object.__setattr__(self, "auxiliary", {k: _frozen(v) for k, v in self.auxiliary.items()})
        if self.left_out is not None:
            object.__setattr__(
                self, "left_out", _frozen(self.left_out, bool) if np.any(self.left_out) else None
            )
        if (
            t.ndim != 1
            or self.u.ndim != 2
            or self.y.ndim != 2
            or not len(t) == len(self.u) == len(self.y)
        ):
            raise ValueError(
                f"experiment {self.name!r}: t {t.shape}, u {self.u.shape}, y {self.y.shape}; "
                "expected t [time], u [time nu], y [time ny]"
            )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Experiment):
            return NotImplemented
        plain = (
            "name",
            "split",
            "initial",
            "at_rest",
            "constants",
            "initial_window_s",
            "repeat_of",
        )
        return (
            all(getattr(self, k) == getattr(other, k) for k in plain)
            and all(np.array_equal(getattr(self, k), getattr(other, k)) for k in ("t", "u", "y"))
            and np.array_equal(self.read, other.read)
            and list(self.auxiliary) == list(other.auxiliary)
            and all(np.array_equal(v, other.auxiliary[k]) for k, v in self.auxiliary.items())
        )

    __hash__ = None  # type: ignore[assignment]

    def __len__(self) -> int:
        return len(self.t)

    @property
    def duration(self) -> float:
        """Seconds from the first sample to the last."""
        return float(self.t[-1] - self.t[0])

    def past_by(self, change: Callable[[Experiment], Experiment]) -> Experiment | None:
        """The past, changed as the run is; None where there is none."""
        return None if self.past is None else change(self.past)

    @property
    def whole(self) -> Experiment:
        """The samples with their past."""
        if self.past is None:
            return self

        def join(a, b):
            return np.concatenate([a, b])

        both = {k: join(getattr(self.past, k), getattr(self, k)) for k in ("t", "u", "y")}
        if self.scatter is not None and self.past.scatter is not None:
            both["scatter"] = join(self.past.scatter, self.scatter)
        both["left_out"] = ~join(self.past.read, self.read)
        return replace(
            self,
            **both,
            auxiliary={k: join(v, self.auxiliary[k]) for k, v in self.past.auxiliary.items()},
            past=None,
        )

    def noise(self, sigma: np.ndarray, columns: Sequence[int]) -> np.ndarray:
        """Noise of each reading of some outputs [time columns] whose channels have the noise
        `sigma` [columns].
        """
        all_alike = np.hypot(
            sigma, 0.0 if self.scatter is None else self.scatter[:, columns]
        ) * np.ones((len(self), 1))
        return (
            all_alike
            if self.left_out is None
            else np.where(self.left_out[:, columns], np.inf, all_alike)
        )

    def noise_rms(self, sigma: np.ndarray, columns: Sequence[int]) -> np.ndarray:
        """Its root mean square over the readings that count [columns]."""
        each, read = self.noise(sigma, columns), self.read[:, columns]
        return np.sqrt(np.sum(np.where(read, each, 0.0) ** 2, 0) / np.maximum(np.sum(read, 0), 1))

    @property
    def read(self) -> np.ndarray:
        """Which readings [time ny] count."""
        return np.ones(self.y.shape, bool) if self.left_out is None else ~self.left_out

    def motion(self) -> np.ndarray:
        """`y [time ny]` to smooth: readings that are left out lie on the line between their
        neighbours. Never for a loss.
        """
        if self.left_out is None:
            return self.y
        columns = []
        for y, read in zip(self.y.T, self.read.T, strict=True):
            columns.append(np.interp(self.t, self.t[read], y[read]) if read.any() else y)
        return np.stack(columns, 1)

    def piece(self, start: int, stop: int, *, name: str, split: str, past: int = 0) -> Experiment:
        """Samples `start:stop` as a run of its own, at their times, that knows up to `past` samples
        before them; only one from sample 0 keeps the initial state.
        """
        first = start == 0
        if past and not first:
            whole = self.whole
            begin = start + len(whole) - len(self)
            before = whole.piece(max(0, begin - past), begin, name=name, split=split)
        else:
            before = self.past if first else None
        return replace(
            self,
            name=name,
            split=split,
            t=self.t[start:stop],
            u=self.u[start:stop],
            y=self.y[start:stop],
            auxiliary={k: v[start:stop] for k, v in self.auxiliary.items()},
            initial=self.initial if first else None,
            at_rest=self.at_rest if first else False,
            past=before,
            scatter=None if self.scatter is None else self.scatter[start:stop],
            left_out=None if self.left_out is None else self.left_out[start:stop],
            source=f"{self.source}, samples {start + 1} to {stop} of it",
        )


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """A measured `output / input`: `omega [f]` rad/s, `response [f]` complex, in SI; repeats are
    repeated rows.
    """

    name: str
    split: str
    omega: np.ndarray
    response: np.ndarray
    input: str
    output: str
    source: str = ""

    def __post_init__(self):
        object.__setattr__(self, "omega", _frozen(self.omega))
        object.__setattr__(self, "response", _frozen(self.response, complex))
        if self.omega.ndim != 1 or self.omega.shape != self.response.shape:
            raise ValueError(
                f"response {self.name!r}: omega {self.omega.shape}, response {self.response.shape}"
            )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, FrequencyResponse):
            return NotImplemented
        return (
            all(getattr(self, k) == getattr(other, k) for k in ("name", "split", "input", "output"))
            and np.array_equal(self.omega, other.omega)
            and np.array_equal(self.response, other.response)
        )

    __hash__ = None  # type: ignore[assignment]
