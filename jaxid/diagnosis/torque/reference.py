"""What was found on another recording, as what is known beforehand: "fitted on A, what is different
in B".
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.small_files import read_small
from jaxid.data.dataset import Dataset, ModelSpec, ParameterPrior
from jaxid.diagnosis.torque.algebra import ColumnPrior
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.numerics.precision import float64
from jaxid.problem.binding import Binding
from jaxid.problem.residual import InverseDynamics, Residual


WANTED = (
    "a reference is the fit.json, identification.json or diagnosis.json of another recording of the"
    " same model"
)


#: Smallest eigenvalue that correlations are taken to have: in directions that were not determined a
#: covariance may say nothing.
CLOSE = 1e-4


@dataclass(frozen=True)
class ReferenceNumbers:
    """Numbers of a model by name, and their covariance [n n]."""

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    said: str
    regrouped: bool = False  # whether they are base parameters, in which numbers that a fit holds are counted, too

    @classmethod
    def read(cls, given: Any) -> ReferenceNumbers:
        """From a result, its dictionary, or its JSON file. Raises `UsageError` for anything
        else.
        """
        content = given.to_dict() if hasattr(given, "to_dict") else given
        if isinstance(content, str | Path):
            content = _loaded(content)
        if not isinstance(content, Mapping):
            raise UsageError(WANTED)
        if content.get("kind") == "identification":
            return _identified(content)
        if content.get("kind") in ("fit", "diagnosis") and isinstance(
            content.get("parameters"), Mapping
        ):
            return _fitted(content)
        raise UsageError(f"{WANTED}; this one is of kind {content.get('kind')!r}")

    def known(self, binding: Binding) -> ColumnPrior:
        """What it says of the numbers that a binding's fit determines. Raises `UsageError` where it
        says nothing of them.
        """
        names = [binding.layout.names[i] for i in binding.free]
        shared = [n for n in names if n in self.names]
        if not shared:
            raise UsageError(
                f"the reference ({self.said}) knows none of this model's numbers"
                f" ({', '.join(names[:6])} …)"
            )
        at = [self.names.index(n) for n in shared]
        place = [names.index(n) for n in shared]
        size = np.sqrt(np.diag(self.covariance)[at])
        scaled = self.covariance[np.ix_(at, at)] / size / size[:, None]
        values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
        inverse = (
            (vectors / np.maximum(values, CLOSE * values[-1])) @ vectors.T / size / size[:, None]
        )
        information, mean = np.zeros((len(names), len(names))), np.zeros(len(names))
        information[np.ix_(place, place)], mean[place] = inverse, self.values[at]
        if self.regrouped:
            counted = _counted(binding)
            mean[place] -= [counted.get(n, 0.0) for n in shared]
        return ColumnPrior(information, mean)

    def taken(
        self, residual: Residual | None, chain: Chain, dataset: Dataset, goals: bool
    ) -> tuple[Residual | None, Dataset]:
        """By what to compare, and the dataset, where no torque is compared with priors.

        A reference that was made by torque is compared so, unless another residual is asked for or
        `goals` drive the robot. Its numbers stand for several that free runs need, and hold
        together by a covariance that no free run takes over.
        """
        if residual is None and self.regrouped and not goals:
            residual = InverseDynamics()
        if isinstance(residual, InverseDynamics):
            return residual, dataset
        return residual, self.as_priors(chain, dataset)

    def as_priors(self, chain: Chain, dataset: Dataset) -> Dataset:
        """The dataset with the numbers stated as known, one by one, where nothing else is stated of
        them.
        """
        spec = dataset.model or ModelSpec(chain.mechanism.name)
        have, own = ParameterVector(chain).names, dict(spec.parameters)
        for name, value, var in zip(self.names, self.values, np.diag(self.covariance), strict=True):
            if name in have and name not in own and name not in spec.constants:
                own[name] = ParameterPrior(prior={"mean": float(value), "std": float(np.sqrt(var))})
        if not any(name in have for name in self.names):
            raise UsageError(
                f"the reference ({self.said}) knows none of this model's numbers"
                f" ({', '.join(have[:6])} …)"
            )
        return replace(dataset, model=replace(spec, parameters=own))


def _counted(binding: Binding) -> dict[str, float]:
    """What an arm's numbers that are held add to each base parameter."""
    arm: Any = binding.layout.model(binding.theta).mechanism
    if not hasattr(arm, "base"):
        return {}
    base = arm.base()
    with float64():
        phi = np.concatenate([np.asarray(arm.inertia()), np.asarray(arm.Ia)[:, None]], 1).ravel()
    phi[list(base.kept)] = 0.0
    return dict(zip(base.names, base.values(phi).tolist(), strict=True))


def _loaded(path: str | Path) -> Any:
    try:
        return json.loads(read_small(path).decode())
    except OSError as error:
        raise UsageError(f"--reference {path}: cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise UsageError(f"--reference {path}: not JSON ({error}); {WANTED}") from error


def _identified(content: Mapping[str, Any]) -> ReferenceNumbers:
    """Base parameters and friction of an identification, those that its data determine."""
    names = list(content["names"])
    own = {e["name"]: (e["value"], e["identifiable"]) for e in content["base_parameters"]}
    for j, entry in enumerate(content["friction"]):
        own |= {
            f"{k}{j + 1}": (v["value"], v["std"] is not None)
            for k, v in entry.items()
            if isinstance(v, Mapping)
        }
    at = [i for i, n in enumerate(names) if n in own and own[n][1]]
    covariance = np.array(content["covariance"], float)[np.ix_(at, at)]
    return ReferenceNumbers(
        tuple(names[i] for i in at),
        np.array([own[names[i]][0] for i in at], float),
        covariance,
        f"identification of {content['dataset']}",
        True,
    )


def _fitted(content: Mapping[str, Any]) -> ReferenceNumbers:
    """Numbers of a fit or a diagnosis, each with its standard deviation."""
    told = {
        k: v for k, v in content["parameters"].items() if isinstance(v, Mapping) and v.get("std")
    }
    if not told:
        raise UsageError(f"the reference holds no number with a standard deviation; {WANTED}")
    values = np.array([v["value"] for v in told.values()], float)
    std = np.array([v["std"] for v in told.values()], float)
    given = content.get("covariance", {})
    covariance = np.array(given.get("matrix", []) if isinstance(given, Mapping) else given, float)
    if covariance.shape != (len(std), len(std)):
        covariance = np.diag(std**2)
    return ReferenceNumbers(
        tuple(told),
        values,
        covariance,
        f"{content['kind']} of {content.get('dataset', 'another recording')}",
    )
