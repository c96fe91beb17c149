"""Numbers that hang together are drawn together."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

import jaxid
from jaxid.base.serialise import finite
from jaxid.numerics.drawn import beside_the_others, draws
from jaxid.robots.export.outcome import ExportOutcome, Number, outcome as read
from jaxid.robots.export.ranges import ranges_of


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
NAMES = ("damping@steer", "kd@steer")
#: Damping stands at its bound of 0; the sum of both is known, and neither alone.
SUM, KNOWN, OPEN = 0.07, 1e-3, 0.03
SHARED = KNOWN**2 / 2 * np.eye(2) + OPEN**2 * np.array([[1.0, -1.0], [-1.0, 1.0]])


def outcome(covariance: np.ndarray = SHARED) -> ExportOutcome:
    std = np.sqrt(np.diag(SHARED))
    numbers = {
        NAMES[0]: Number(0.0, float(std[0]), "N m s/rad", at_bound=True, lower=0.0, upper=14.0),
        NAMES[1]: Number(SUM, float(std[1]), "N m s/rad", lower=0.0, upper=7.0),
    }
    return ExportOutcome("fit", "robot", numbers, (), {}, NAMES, covariance)


def test_a_sum_that_is_known_is_kept_in_every_draw():
    table = ranges_of(outcome(), "mjcf").table["draws"]
    assert tuple(table["names"]) == NAMES
    drawn = np.array(table["values"])
    assert drawn.shape == (200, 2) and drawn.min() >= 0
    assert np.abs(drawn.sum(1) - SUM).max() < 5 * KNOWN
    assert np.ptp(drawn[:, 0]) > OPEN  # what is open between the two is open


@pytest.mark.parametrize("to", ["mjlab", "isaaclab"])
def test_what_is_drawn_by_itself_keeps_the_sum_beside_the_others_as_written(to):
    text = ranges_of(outcome(), to).files[f"ranges_{to}.py"]
    found = [tuple(map(float, pair)) for pair in re.findall(r"\(([\d.e-]+), ([\d.e-]+)\)", text)]
    assert found
    for low, high in found:
        assert 0 <= low and high - low < 5 * KNOWN


def test_numbers_without_a_covariance_are_drawn_by_themselves():
    found = ranges_of(outcome(np.full((2, 2), np.nan)), "mjcf")
    drawn = np.array(found.table["draws"]["values"])
    assert drawn.shape == (200, 2) and np.isfinite(drawn).all()
    assert np.ptp(drawn.sum(1)) > OPEN


def test_draws_have_the_mean_and_the_covariance_that_they_are_of():
    rng = np.random.default_rng(1)
    A = rng.standard_normal((3, 3))
    mean, wide = np.array([1.0, -2.0, 3.0]), np.full(3, np.inf)
    x = draws(mean, A @ A.T, -wide, wide, 20_000)
    np.testing.assert_allclose(x.mean(0), mean, atol=0.1)
    np.testing.assert_allclose(np.cov(x.T), A @ A.T, rtol=0.1, atol=0.1)


def test_where_hardly_any_draw_is_within_the_bounds_there_are_fewer():
    far = draws(np.zeros(1), np.eye(1), np.array([50.0]), np.array([51.0]), 3)
    assert far.shape == (0, 1)


def test_beside_the_others_a_number_is_known_as_well_as_the_sum():
    assert beside_the_others(SHARED) == pytest.approx([KNOWN] * 2, rel=0.01)


@pytest.mark.slow
def test_draws_of_a_recording_keep_what_it_tells_of_damping_and_kd():
    """Its covariance at a bound: true are kp 8, kd + damping 0.07, and only ratios are known."""
    folder = DATA.parent / "cases" / "robot3_covariance_at_bound"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here")
    found = jaxid.diagnose(None, jaxid.load_dataset(folder))
    content = json.loads(json.dumps(finite(found.to_dict())))
    table = ranges_of(read(content), "mjlab").table
    column = dict(zip(table["draws"]["names"], np.array(table["draws"]["values"]).T, strict=True))
    braked = (column["kd@steer"] + column["damping@steer"]) / column["kp@steer"] * 8.0
    assert np.mean(braked) == pytest.approx(0.07, abs=0.005) and np.std(braked) < 0.02
    assert np.ptp(column["damping@steer"]) > 0.05  # open is how the two share it
    R = np.array(table["correlation"]["matrix"], float)
    assert np.linalg.eigvalsh(R)[0] > -1e-9
