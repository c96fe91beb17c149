"""Runs that begin at rest with a command that does not keep them there."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest

import jaxid
from jaxid.benchmark import numpy_twin, plants
from jaxid.diagnosis.rest_before import keeps_at_rest, with_rest_before
from jaxid.problem.binding import bind


NOISE, DELAY = 3e-4, 0.02


@cache
def recorded_late(first: float = 1.0) -> jaxid.Dataset:
    """Four runs of a pendulum that stood still under no torque until they began with a step, which
    acts late.
    """
    before, samples = 40, 1000
    inputs = []
    for run in range(4):
        rng = np.random.default_rng(10 + run)
        u = np.zeros((samples + before, 1))
        at = before
        while at < len(u):
            step = int(rng.integers(60, 200))
            u[at : at + step] = rng.uniform(-0.5, 0.5)
            at += step
        inputs.append(u)
    plant = dataclasses.replace(plants.PLANTS["pendulum"], rate=200, noise=NOISE, resolution=0.0)
    numbers = plant.nominal | {"delay": np.array([DELAY])}
    lanes = {name: np.tile(value, (4, 1)) for name, value in numbers.items()}
    y = numpy_twin.recorded(plant, np.array(inputs), lanes, np.random.default_rng(1))
    return jaxid.Dataset.from_arrays(
        [np.arange(samples) / 200] * 4,
        {"tau": [u[before:, 0] if first is None else u[before:, 0] * first for u in inputs]},
        {"q": list(y[:, before:, 0])},
        units={"tau": "N m", "q": "rad"},
        split=["fit", "fit", "validation", "report"],
        at_rest=True,
        noise_std={"q": NOISE},
        model="pendulum",
    )


@pytest.mark.parametrize(
    ("first", "kept"), [(0.3, 0.3), (-1.0, 0.225), pytest.param(1.0, 0.425, marks=pytest.mark.slow)]
)
def test_the_command_nearest_the_first_that_keeps_a_pendulum_at_rest(first, kept):
    """Its weight pulls with 0.325 N m, and dry friction holds 0.1 N m either way."""
    binding = bind("pendulum", recorded_late())
    theta = binding.theta.copy()
    theta[binding.layout.index("gravity_torque")] = 1.1
    theta[binding.layout.index("coulomb")] = 0.1
    chain = binding.layout.model(theta)
    q = np.array([np.arcsin(0.325 / 1.1)])
    assert keeps_at_rest(chain, q, np.array([first])) == pytest.approx(kept, abs=1e-6)


def test_a_run_from_rest_has_a_sample_before_its_first_step():
    binding = bind("pendulum", recorded_late())
    rested = with_rest_before(binding.dataset, binding.chain)
    assert rested is not None
    for run in rested.experiments:
        assert run.past is not None and run.past.t[0] < run.t[0]
        assert abs(run.past.u[0, 0]) < 0.01  # it hangs, and nothing is commanded


@pytest.mark.slow
def test_what_its_first_command_keeps_at_rest_stays_as_it_is():
    binding = bind("pendulum", recorded_late(first=0.0))
    still = dataclasses.replace(
        binding.dataset,
        experiments=tuple(
            dataclasses.replace(e, y=e.y - e.y[0]) for e in binding.dataset.experiments
        ),
    )
    assert with_rest_before(still, binding.chain) is None
    moving = dataclasses.replace(
        still,
        experiments=tuple(dataclasses.replace(e, at_rest=False) for e in still.experiments),
    )
    assert with_rest_before(moving, binding.chain) is None


@pytest.mark.slow
def test_a_delay_of_a_first_step_is_named():
    found = jaxid.diagnose("pendulum", recorded_late(), effects=["input_delay", "quadratic_drag"])
    (late,) = found.which.effects
    assert (found.which.verdict, late.effect) == ("named", "input_delay")
    assert late.parameters["delay"].value == pytest.approx(DELAY, rel=1e-2)
    assert any("before runs from rest" in note for note in found.notes)
