"""What a fit and a diagnosis return: plain data that prints, saves itself as JSON and draws its
report.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, TYPE_CHECKING

import numpy as np

from jaxid.base.display import Displayed, displays
from jaxid.base.frames import frame
from jaxid.base.serialise import model_digest, plain, SCHEMA
from jaxid.base.versions import versions
from jaxid.conventions.finding import as_data, DataFinding
from jaxid.fitting.exportable import Exportable


if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

    from jaxid.dynamics.chain import Chain
    from jaxid.fitting.posterior import Posterior
    from jaxid.fitting.stated import StatedNumber


#: Of a fit as a table.
FRAME_COLUMNS = (
    "parameter",
    "value",
    "std",
    "unit",
    "lower",
    "upper",
    "at_bound",
    "identifiable",
)


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter. `std` is None and `identifiable` False where the data do not determine
    it.
    """

    value: float
    std: float | None
    unit: str
    lower: float
    upper: float
    at_bound: bool = False
    identifiable: bool = True

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class Covariance:
    """Mean squares and products of what the fitted numbers `names` are off by, [n n], positive
    semidefinite.

    One-sided where a number stands at its bound. As wide as the bounds where the data do not
    determine one, whose estimate then has no standard deviation.
    """

    names: tuple[str, ...]
    matrix: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        return plain({"names": self.names, "matrix": self.matrix})


@dataclass(frozen=True)
class EffectEstimate:
    """An effect at a location with its fitted parameters."""

    effect: str
    location: str
    parameters: dict[str, Estimate] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        return plain(
            {
                "effect": self.effect,
                "location": self.location,
                "parameters": self.parameters,
            }
        )

    def __str__(self) -> str:
        return f"{self.effect} at {self.location}"


def with_origin(fit: Fit) -> dict[str, Any]:
    """What a result's JSON needs beside the numbers to carry them back: the robot's file, and how
    the numbers depend.
    """
    out: dict[str, Any] = {"robot": fit.robot} if fit.robot else {}
    return out if fit.covariance is None else out | {"covariance": fit.covariance.to_dict()}


@dataclass(frozen=True)
class Score:
    """How well a channel is reproduced by the free run (torque for inverse dynamics)."""

    rmse: float
    nrmse: float
    relative_error: float
    unit: str

    def to_dict(self) -> dict[str, Any]:
        return {
            "rmse": self.rmse,
            "nrmse": self.nrmse,
            "relative_error": self.relative_error,
            "unit": self.unit,
        }


@dataclass(frozen=True)
class Trace:
    """One output channel of one experiment: measured and simulated, for pictures."""

    experiment: str
    split: str
    channel: str
    unit: str
    t: np.ndarray
    measured: np.ndarray
    simulated: dict[
        str, np.ndarray
    ]  # label -> series, for instance "nominal", "with dead_zone at tau"
    noise: float
    windows: bool = False  # simulated in short windows, each with its own start

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draws measured minus simulated over time, with the band of the noise, on new axes or the
        given ones.
        """
        return displays().picture(self, ax)


@dataclass(frozen=True, repr=False)
class Fit(Displayed, Exportable):
    """The result of every fitter: parameters with uncertainty, scores on fit and validation data,
    and what it cost.
    """

    model: str
    effects: tuple[EffectEstimate, ...]
    fitter: str
    residual: str
    loss_name: str
    seed: int
    converged: bool
    failed: bool
    stopped_because: str
    loss: float
    parameters: dict[str, Estimate]
    scores: dict[str, dict[str, Score]]  # split -> channel -> score
    windowed: dict[str, Score]
    evaluations: int
    wall_time_s: float
    compile_time_s: float
    dataset: str
    dataset_sha256: str
    notes: tuple[str, ...] = ()
    correlated: tuple[
        tuple[str, ...], ...
    ] = ()  # groups of parameters the data determine only together
    history: tuple[tuple[int, float], ...] = ()  # (evaluations, best loss so far)
    traces: tuple[Trace, ...] = ()
    theta: np.ndarray = field(
        default_factory=lambda: np.zeros(0)
    )  # every number of the model, in the order of its layout
    stalled: bool = False  # ended by a rule of the fitter's own, without having converged
    # What the scores are of: free_run | windows | closed_loop | inverse_dynamics |
    # frequency_response
    simulation: str = "free_run"
    free_run: dict[str, dict[str, Score]] = field(
        default_factory=dict
    )  # scores of the free run, where `scores` are of another
    stated: tuple[
        StatedNumber, ...
    ] = ()  # what a file or the dataset states beside what was fitted
    per_joint: tuple[
        dict[str, Any], ...
    ] = ()  # of a robot: each joint's error with the file as it stands
    chain: Chain | None = field(default=None, repr=False, compare=False)
    """The fitted model with its effects, None where the fit failed: `.ode()`, `jaxid.simulate(fit.chain, other_data)`."""
    solver: str = "own"  # what simulated: jaxid's own stepping, or a solver of diffrax
    data: tuple[DataFinding, ...] = ()  # what the recording says about itself
    robot: dict[str, Any] = field(
        default_factory=dict
    )  # the file of a robot and its drive: see `jaxid.robots.origin`
    covariance: Covariance | None = None  # of the fitted numbers
    reweighted_loss: float | None = (
        None  # of channels weighed by what the model leaves of them, where that was fitted
    )
    recursion: tuple[Any, ...] = ()  # of a fit along its blocks: a `recursion.Step` each
    model_sha256: str = ""  # of the file of a model of the user's own
    posterior: Posterior | None = None  # draws, where they were asked for

    @property
    def state(self) -> str:
        """`converged`, `stalled`, `failed`, or `budget`: a limit of evaluations, iterations or time
        ended it.
        """
        return (
            "failed"
            if self.failed
            else "converged"
            if self.converged
            else "stalled"
            if self.stalled
            else "budget"
        )

    def to_frame(self) -> pandas.DataFrame:
        """A row for each fitted number, those of added effects as `dead_zone.width@tau`. Raises
        `UsageError` without pandas.
        """
        found = dict(self.parameters)
        for e in self.effects:
            for name, estimate in e.parameters.items():
                found[f"{e.effect}.{name}@{e.location}"] = estimate
        rows = [{"parameter": name, **estimate.to_dict()} for name, estimate in found.items()]
        return frame(rows, FRAME_COLUMNS)

    def to_dict(self) -> dict[str, Any]:
        content = {
            "schema": SCHEMA,
            "kind": "fit",
            "model": self.model,
            "effects": self.effects,
            "fitter": self.fitter,
            "residual": self.residual,
            "loss_name": self.loss_name,
            "solver": self.solver,
            "seed": self.seed,
            "state": self.state,
            "converged": self.converged,
            "stopped_because": self.stopped_because,
            "loss": self.loss,
            "reweighted_loss": self.reweighted_loss,
            "parameters": self.parameters,
            "simulation": self.simulation,
            **self.scores,
            "free_run": self.free_run,
            "windowed": self.windowed,
            "correlated": self.correlated,
            "stated": self.stated,
            "how_far": {"per_joint": self.per_joint},
            **with_origin(self),
            "evaluations": self.evaluations,
            "wall_time_s": self.wall_time_s,
            "compile_time_s": self.compile_time_s,
            "dataset": self.dataset,
            "dataset_sha256": self.dataset_sha256,
            **model_digest(self.model_sha256),
            "versions": versions(),
            "notes": self.notes,
            **as_data(self.data),
        }
        if self.recursion:
            content["recursion"] = self.recursion
        if self.posterior is not None:
            content["posterior"] = self.posterior
        return plain(content)

    def plot(self, channel: str | None = None, ax: Axes | None = None) -> Axes:
        """Draws a channel (default: the first) as measured and as simulated, on data that were not
        fitted where there are any.
        """
        return displays().picture(self, channel, ax)
