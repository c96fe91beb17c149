"""Experiments and datasets in memory: SI units, float64, read-only, already checked.

`Dataset` holds recorded runs (`Experiment`) and measured frequency responses (`FrequencyResponse`).
Columns of `u` follow `Dataset.inputs` and columns of `y` follow `Dataset.outputs`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TYPE_CHECKING

import numpy as np

from jaxid.base.display import displays
from jaxid.base.reader import arrays_reader
from jaxid.base.wording import names_of
from jaxid.data.experiment import (
    Channel as Channel,
    Experiment as Experiment,
    FrequencyResponse as FrequencyResponse,
    StatedChannel as StatedChannel,
)


if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class ParameterPrior:
    """What the user knows beforehand of a fitted parameter: start value, bounds, whether its
    logarithm is searched (None: as the model says), and a Gaussian prior {"mean": ..., "std": ...}.
    """

    value: float | None = None
    lower: float | None = None
    upper: float | None = None
    log: bool | None = None
    prior: dict[str, float] | None = None

    @property
    def start(self) -> float | None:
        """The value, else the mean of the prior."""
        if self.value is None and self.prior is not None:
            return self.prior["mean"]
        return self.value


@dataclass(frozen=True)
class Geometry:
    """The links of a `serial_arm`: the text of a URDF with its file's name, root and tip of the
    chain, or the columns of a Denavit-Hartenberg table of a `convention` (modified or standard).
    """

    urdf: str = ""
    file: str = ""
    tip: str | None = None
    root: str | None = None
    convention: str = "modified"
    columns: dict[str, list[float] | list[bool]] = field(default_factory=dict)
    robot: str = ""  # the text of a robot's file, MJCF or URDF
    path: str = field(default="", compare=False)  # where that lay


@dataclass(frozen=True)
class ModelSpec:
    """The model a dataset is meant for; `free` is motion without any input, `geometry` that of a
    `serial_arm` or a robot, whose `base` is fixed or prescribed; `joints`: channel of a position ->
    the name of its joint. `file` is the path of a model of the user's own, with its class where it
    was named (`/data/osc/duffing.py:Duffing`). `trust` says how far stated numbers may be off: see
    `jaxid.problem.trust`. `simulator` says whose steps a robot of a file takes: "own", "mujoco" or
    "mujoco_rk4".
    `contacts`: whether shapes of its file that touch count as contacts of the machine; true has
    them simulated.
    """

    name: str | None = None
    without: tuple[str, ...] = ()
    free: bool = False
    constants: dict[str, float] = field(default_factory=dict)
    parameters: dict[str, ParameterPrior] = field(default_factory=dict)
    geometry: Geometry | None = None
    joints: dict[str, str] = field(default_factory=dict)
    base: dict[str, Any] = field(default_factory=dict)
    file: str | None = field(default=None, compare=False)  # where it lies makes no other model
    trust: str | None = None
    simulator: str | None = None
    contacts: bool | None = None


@dataclass(frozen=True)
class Controller:
    """The feedback law under which the data were recorded; sample time, saturation and gains stand
    in `settings`.
    """

    kind: str
    settings: dict[
        str, float | list[float] | str | list[str] | dict[str, float] | dict[str, str]
    ] = field(default_factory=dict)


@dataclass(frozen=True)
class Dataset:
    """Checked experiments with their channels.

    `notes` says what was done and what deserves a look; `sha256` is that of the content. Two
    datasets are equal when their names, channels, runs, model and controller are, wherever they
    were read from.
    """

    name: str
    channels: tuple[Channel, ...]
    experiments: tuple[Experiment, ...] = ()
    responses: tuple[FrequencyResponse, ...] = ()
    model: ModelSpec | None = None
    controller: Controller | None = None
    description: str = ""
    source: dict[str, Any] | str | None = None
    notes: tuple[str, ...] = field(default=(), compare=False)
    sha256: str = field(default="", compare=False)
    #: Channel -> how near a model has to come, SI: see `jaxid.problem.accuracy`.
    accuracy: dict[str, float] = field(default_factory=dict, compare=False)

    __hash__ = None  # type: ignore[assignment]

    @property
    def inputs(self) -> tuple[Channel, ...]:
        return tuple(c for c in self.channels if c.role == "input")

    @property
    def outputs(self) -> tuple[Channel, ...]:
        return tuple(c for c in self.channels if c.role == "output")

    @property
    def input_names(self) -> list[str]:
        return names_of(self.inputs)

    @property
    def output_names(self) -> list[str]:
        return names_of(self.outputs)

    @property
    def stated(self) -> ModelSpec:
        """What is stated of the model: a spec without a name or a number where nothing is."""
        return self.model or ModelSpec()

    @property
    def seen(self) -> list[Experiment]:
        """The runs that may be looked at while something is chosen: all but those to report on."""
        return [e for e in self.experiments if e.split != "report"]

    @property
    def to_fit(self) -> tuple[Experiment, ...]:
        """The runs of the fit; all where none is for it."""
        return self.split("fit") or self.experiments

    @property
    def sampling_time(self) -> float:
        """Median time between samples of the runs to fit, s, to a microsecond; 0 without runs."""
        steps = [np.median(np.diff(e.t)) for e in self.to_fit]
        return round(float(np.median(steps)), 6) if steps else 0.0

    def split(self, name: str) -> tuple[Experiment, ...]:
        """The runs of one split: "fit", "validation" or "report"."""
        if name not in ("fit", "validation", "report"):
            raise ValueError(f"no split {name!r} (there is: fit, validation, report)")
        return tuple(e for e in self.experiments if e.split == name)

    def with_splits(self) -> Dataset:
        """The dataset with validation and report data, by these rules; `notes` says what was done.

        Without a validation run, the last 30 % of each fit run are kept for it. Without a report
        run, each validation run is cut once in time: first half validation, second half report.
        After each cut max(20 samples, 0.1 s) are left out. Times stay absolute; a later piece knows
        no initial state, but what went before it, up to 5 s (1000 samples) for validation and 60 s
        (20 000 samples) for report: delays, lags, springs and friction that remembers start from
        there, and the free run begins up to 1 s before the part. A run whose later piece would be
        under 20 samples is not cut.
        """
        from jaxid.data.splits import with_splits

        return with_splits(self)

    @classmethod
    def from_arrays(
        cls,
        t: Any,
        inputs: Mapping[str, Any] | None = None,
        outputs: Mapping[str, Any] | None = None,
        *,
        auxiliary: Mapping[str, Any] | None = None,
        units: Mapping[str, str] | None = None,
        **settings: Any,
    ) -> Dataset:
        """A dataset from arrays, with the same checks as a folder.

        One run: `t [time]` seconds and channel -> `[time]`. Several runs: lists of such arrays, one
        a run. `units`: channel -> unit; a channel named by convention (`q1`, `qd`, `tau`, `force`,
        `current2` …) needs none. No inputs is free motion.

        Settings of a run (one value for all, or a list with one a run): `split` ("fit"), `at_rest`,
        `initial` (state -> value), `constants`, `initial_window_s`, `split_at_gaps`, `names`. Of a
        channel (channel -> value): `noise_std`, `resolution`, `hold`, `valid` (arrays like its
        values: 0 where it was not read). Of the dataset: `name`, `description`, `source`, `model`
        (an id or a `ModelSpec`), `controller` (a `Controller`), `check_model` (True).

        Raises `DatasetError` with every fault; `file` is then the run's name and `row` the index
        into the array.
        """
        return arrays_reader().from_arrays(
            t, inputs or {}, outputs or {}, auxiliary or {}, units or {}, **settings
        )

    @classmethod
    def from_frame(
        cls,
        frame: Any,
        inputs: Sequence[str] | Mapping[str, str] = (),
        outputs: Sequence[str] | Mapping[str, str] = (),
        *,
        auxiliary: Sequence[str] | Mapping[str, str] = (),
        time: str = "t",
        **settings: Any,
    ) -> Dataset:
        """A dataset from a data frame, or from a list of frames (one a run); else like
        `from_arrays`.

        `inputs`, `outputs`, `auxiliary`: column names, or channel -> column; `time`: the column of
        seconds. A frame is whatever gives its columns by `frame[name]` and lists them in
        `frame.columns` (pandas, polars, a pyarrow table has `column_names`).
        """
        return arrays_reader().from_frame(frame, inputs, outputs, auxiliary, time, **settings)

    def plot(self, channel: str | None = None, ax: Axes | None = None) -> Axes:
        """Draws a channel (default: the first output) of every run over time, on new axes or the
        given ones.
        """
        return displays().picture(self, channel, ax)

    def __repr__(self) -> str:
        from jaxid.base.wording import one_line

        runs = [f"{e.name} ({e.split}, {len(e.t)} samples)" for e in self.experiments]
        runs += [f"{r.name} ({r.split}, {len(r.omega)} lines)" for r in self.responses]

        def of(channels):
            return ", ".join(f"{c.name} ({c.unit})" for c in channels) or "none"

        more = f" and {len(runs) - 6} more" if len(runs) > 6 else ""
        return one_line(
            f"Dataset {self.name}: inputs {of(self.inputs)}; outputs {of(self.outputs)}; runs"
            f" {', '.join(runs[:6])}{more}"
        )

    def _repr_html_(self) -> str:
        return displays().fragment(self)
