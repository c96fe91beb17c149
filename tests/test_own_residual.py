"""A residual of a user's own, imported from the door."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

import jaxid
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem import MultipleShooting, OutputError, Residual
from jaxid.problem.binding import bind
from jaxid.problem.residual import Simulation


@dataclass(frozen=True)
class Seconds(Residual):
    """A user's own residual: windows of one second, whatever the run."""

    name: ClassVar[str] = "seconds"
    simulation: ClassVar[Simulation] = "windows"

    def runs(self, dataset, experiments, layout, noise, motions, step=2e-3, shape=(0, 0)):
        return MultipleShooting(1.0).runs(dataset, experiments, layout, noise, motions, step, shape)


def test_a_residual_of_ones_own_takes_part_in_fits_and_diagnoses():
    data = jaxid.load_dataset(Path(__file__).parents[1] / "examples" / "servo_pendulum")
    found = jaxid.diagnose(None, data, effects=["dead_zone", "input_delay"], residual=Seconds())
    assert found.residual == "seconds" and [e.effect for e in found.which.effects] == ["dead_zone"]
    width = found.which.effects[0].parameters["width"]
    assert width.std is not None and abs(width.value - 0.1) < 4 * width.std
    assert found.final.simulation == "windows" and found.final.windowed


#: Samples of a run that do not count.
FIRST = 100


@dataclass(frozen=True)
class Settled(OutputError):
    """A user's own residual: a free run whose first moments do not count, against doubled
    measurements.
    """

    name: ClassVar[str] = "settled"

    def runs(self, dataset, experiments, layout, noise, motions, step=2e-3, shape=(0, 0)):
        runs = super().runs(dataset, experiments, layout, noise, motions, step, shape)
        weights = runs.weights.copy()
        for number in runs.records:
            weights[runs.record(number).samples[:FIRST]] = 0.0
        return replace(runs, weights=weights, targets=2 * runs.targets)


def test_weights_and_targets_of_a_users_own_are_those_of_every_fitter():
    """A descent reads residuals, a population losses: both are of what the residual says."""
    t = np.arange(300) / 100
    data = jaxid.Dataset.from_arrays(
        [t],
        {"tau": [np.sin(5 * t)]},
        {"q": [0.3 * np.sin(5 * t - 0.4)]},
        units={"tau": "N m", "q": "rad"},
        noise_std={"q": 1e-3},
        at_rest=True,
        check_model=False,
    )
    binding = bind("pendulum", data, splits=False)
    free = [binding.layout.index("inertia")]
    problem = ProblemBuilder(binding).problem(Settled(), "fit", free, binding.theta)
    z = problem.lower + 0.5 * (problem.upper - problem.lower)
    runs = problem.runs
    (residual,) = problem.residuals(z)
    last = runs.record(runs.records[0]).samples[-1]
    assert runs.targets[last] == 2 * data.experiments[0].y[-1]
    assert not residual[:FIRST].any()
    mean_square = np.sum(residual**2) / (len(t) - FIRST)
    assert np.isclose(problem.losses(z)[0], mean_square, rtol=1e-9)
