"""What an identification found: base parameters, friction, payload, their uncertainty, and how well
torque is predicted.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxid.base.display import Displayed
from jaxid.base.serialise import plain, SCHEMA
from jaxid.base.versions import versions
from jaxid.base.wording import stem_and_number
from jaxid.conventions.finding import as_data, DataFinding
from jaxid.fitting.exportable import Exportable
from jaxid.identification.payload import PayloadEstimate


@dataclass(frozen=True)
class RunScore:
    """How well one experiment's torque is predicted, N m: over all joints and joint by joint,
    filtered and as recorded.
    """

    file: str
    split: str
    relative_error: float
    relative_error_per_joint: tuple[float, ...]
    rmse_per_joint: tuple[float, ...]
    unfiltered_relative_error: float
    unfiltered_rmse_per_joint: tuple[float, ...]

    def to_dict(self) -> dict[str, Any]:
        unfiltered = {
            "relative_error": self.unfiltered_relative_error,
            "rmse_per_joint": list(self.unfiltered_rmse_per_joint),
        }
        return plain(
            {
                "file": self.file,
                "split": self.split,
                "relative_error": self.relative_error,
                "relative_error_per_joint": self.relative_error_per_joint,
                "rmse_per_joint": self.rmse_per_joint,
                "unfiltered": unfiltered,
            }
        )


@dataclass(frozen=True)
class LawTrial:
    """A friction law that was tried: relative torque error on fit data and on each held-out run."""

    law: str
    fit: float
    held_out: tuple[float, ...]
    chosen: bool


@dataclass(frozen=True, repr=False)
class Identification(Displayed, Exportable):
    """Result of `jaxid.identify`. `theta` and `covariance` follow `names`: base parameters, then
    friction by joint.
    """

    model: str
    method: str
    law: str
    names: tuple[str, ...]
    expressions: tuple[str, ...]
    units: tuple[str, ...]
    theta: np.ndarray
    covariance: np.ndarray
    identifiable: np.ndarray
    base_count: int
    exponents: np.ndarray | None
    condition_number: float
    condition_number_scaled: float
    filter: str
    weights: np.ndarray  # [joints] 1 / (N m), mean over the fit runs
    experiments: tuple[RunScore, ...]
    laws: tuple[LawTrial, ...]
    standard: dict[str, float] | None
    dataset: str
    dataset_sha256: str
    notes: tuple[str, ...]
    wall_time_s: float
    payload: PayloadEstimate | None = None
    traces: tuple[Any, ...] = field(default=(), compare=False)
    labels: tuple[str, ...] = ()  # what tables call the joints: their names, else q1 …
    stated: tuple[dict[str, Any], ...] = ()
    answers: tuple[
        str, ...
    ] = ()  # sentences on what is stated and the data refute; a file as it stands
    per_joint: tuple[dict[str, Any], ...] = ()
    data: tuple[DataFinding, ...] = ()  # what the recording says about itself
    robot: dict[str, Any] = field(
        default_factory=dict
    )  # the file of a robot and its drive: see `jaxid.robots.origin`
    complete: bool = True  # whether all friction laws that were asked for were tried

    @property
    def torque_units(self) -> tuple[str, ...]:
        """Unit of each joint's torque: N m, or N where it slides."""
        return self.units[self.base_count : self.base_count + self.joints]

    @property
    def joints(self) -> int:
        return len(self.weights)

    def std(self) -> np.ndarray:
        """Standard deviations, nan where the data do not determine a number."""
        return np.where(
            self.identifiable,
            np.sqrt(np.maximum(np.diag(self.covariance), 0.0))[: len(self.names)],
            np.nan,
        )

    def exponent_std(self) -> np.ndarray:
        """Standard deviations of the exponents, which follow the other parameters in the
        covariance.
        """
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))[len(self.names) :]

    def friction(self) -> list[dict[str, Any]]:
        """Friction of each joint: id -> value, std, unit."""
        std, n = self.std(), self.joints
        out: list[dict[str, Any]] = [{"joint": name} for name in self.labels]
        for i in range(self.base_count, len(self.names)):
            j = (i - self.base_count) % n
            kind, _ = stem_and_number(self.names[i])
            if self.names[i].startswith("F_3"):
                kind = "F_3"
            out[j][kind] = {
                "value": self.theta[i],
                "std": std[i],
                "unit": self.units[i],
            }
        if self.exponents is not None:
            for j in range(n):
                out[j]["exponent"] = {
                    "value": self.exponents[j],
                    "std": self.exponent_std()[j],
                    "unit": "1",
                }
        return out

    def to_dict(self) -> dict[str, Any]:
        std = self.std()
        base = [
            {
                "name": self.names[i],
                "value": self.theta[i],
                "std": std[i],
                "unit": self.units[i],
                "identifiable": bool(self.identifiable[i]),
                "combination": self.expressions[i],
            }
            for i in range(self.base_count)
        ]
        out: dict[str, Any] = {
            "schema": SCHEMA,
            "kind": "identification",
            "model": self.model,
            "method": self.method,
            "friction_law": self.law,
            "base_parameters": base,
            "friction": self.friction(),
            "condition_number": self.condition_number,
            "condition_number_scaled": self.condition_number_scaled,
            "filter": self.filter,
            "weights": self.weights,
            "experiments": [e.to_dict() for e in self.experiments],
            "friction_laws": [vars(t) for t in self.laws],
            "names": list(self.names),
            "covariance": self.covariance,
            "stated": list(self.stated),
            "how_far": {"per_joint": list(self.per_joint)},
        }
        own = {
            "standard_parameters": self.standard,
            "payload": self.payload and self.payload.to_dict(),
            "robot": self.robot,
        }
        out |= {key: value for key, value in own.items() if value}
        out |= as_data(self.data)
        return out | {
            "dataset": self.dataset,
            "dataset_sha256": self.dataset_sha256,
            "complete": self.complete,
            "wall_time_s": self.wall_time_s,
            "versions": versions(),
            "notes": [*self.answers, *self.notes],
        }
