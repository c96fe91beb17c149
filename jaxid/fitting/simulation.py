"""What a simulation returns: plain data that prints and saves itself as JSON."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxid.base.display import Printed
from jaxid.base.serialise import model_digest, plain, SCHEMA


@dataclass(frozen=True, repr=False)
class Simulation(Printed):
    """Free runs of a model on a dataset's inputs: per experiment `t` and the outputs, and the rmse
    per channel.
    """

    model: str
    runs: tuple[dict[str, np.ndarray], ...]
    rmse: tuple[dict[str, float], ...]
    units: dict[str, str]
    notes: tuple[str, ...] = ()
    motion: Callable[[int], Any] = field(default=lambda i: None, repr=False, compare=False)
    """The mechanism in run i as a `jaxid.simulation.animation.OutlineMotion` (`strip()`, `animate()`); None without an outline."""
    solver: str = "own"
    """What simulated: jaxid's own stepping, or a solver of diffrax."""

    starts: tuple[np.ndarray, ...] = field(default=(), repr=False, compare=False)
    """Start of each run, [2 nq]: positions, then speeds."""
    model_sha256: str = ""
    """Of the file of a model of the user's own."""

    def to_dict(self) -> dict[str, Any]:
        return plain(
            {
                "schema": SCHEMA,
                "kind": "simulation",
                "model": self.model,
                **model_digest(self.model_sha256),
                "solver": self.solver,
                "rmse": self.rmse,
                "units": self.units,
                "notes": self.notes,
            }
        )
