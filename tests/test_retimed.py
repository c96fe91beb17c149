"""Channels that were moved in time by a fraction of a row: how near their machine can be followed."""

from __future__ import annotations

import numpy as np
import pytest

import jaxid
from jaxid.conventions.mending import mended, Mending
from jaxid.data.dataset import Dataset
from jaxid.data.retimed import FINEST, known_within
from jaxid.problem.binding import bind


T = np.arange(0, 6, 0.004)
NUMBERS = {"inertia": 0.05, "viscous": 0.3, "coulomb": 0.2, "offset": 0.0}


def torque(t: np.ndarray) -> np.ndarray:
    """At rest at first: nothing of it may lie before the run."""
    since = np.maximum(t - 0.2, 0.0)
    return np.sin(2 * np.pi * 0.9 * since) ** 3 + 0.4 * np.sin(2 * np.pi * 2.3 * since)


def recorded(u: np.ndarray) -> Dataset:
    """A joint with dry friction under a torque [time], from rest, without noise."""
    units = {"tau": "N m", "q": "rad"}
    plain = Dataset.from_arrays(T, {"tau": u}, {"q": u}, units=units, at_rest=True, model="joint")
    (run,) = jaxid.simulate("joint", plain, {"parameters": NUMBERS}).runs
    return Dataset.from_arrays(
        T, {"tau": u}, {"q": run["q"]}, units=units, at_rest=True, model="joint"
    )


def test_a_cause_within_its_row_moves_a_run_by_time_and_rate():
    on_time = recorded(torque(T))
    earlier = recorded(torque(T + FINEST * 0.004))
    change = earlier.experiments[0].y - on_time.experiments[0].y
    moved = mended(on_time, Mending({"tau": {"delay_s": 0.006}}))
    told = known_within(moved)
    assert told["q"] == pytest.approx(np.sqrt(np.mean(change**2)), rel=0.05)
    assert bind("joint", moved).sigma[0] > told["q"] > 10 * bind("joint", on_time).sigma[0]


@pytest.mark.parametrize("forms", [{}, {"delay_s": 0.008}, {"scale": 2.0}])
def test_what_lies_on_rows_is_known_as_its_sensor_knows_it(forms):
    moved = mended(recorded(torque(T)), Mending({"tau": forms}))
    assert known_within(moved) == {}


def test_an_output_that_was_moved_says_nothing_of_others():
    units = {"tau": "N m", "q": "rad", "qd": "rad/s"}
    data = Dataset.from_arrays(
        T,
        {"tau": torque(T)},
        {"q": torque(T), "qd": np.gradient(torque(T), T)},
        units=units,
        model="joint",
    )
    assert list(known_within(mended(data, Mending({"qd": {"clock_ppm": 300.0}})))) == ["qd"]
