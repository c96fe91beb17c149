"""A residual of a user's own, imported from the door."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import jaxid
from jaxid.problem import MultipleShooting, Residual
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
