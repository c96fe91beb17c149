"""What is different from a reference: a load, and nothing where the arm is the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import jaxid
from jaxid.diagnosis.run import run_diagnosis
from jaxid.diagnosis.torque.algebra import ColumnPrior, departure
from jaxid.diagnosis.torque.reference import ReferenceNumbers
from test_torque_diagnosis import ARMS, asked, body, DATA, named, payload_of, recorded, run


def one_run(data: jaxid.Dataset, path: Path) -> jaxid.Dataset:
    """Another run with the channels of a dataset, torques as its scales make them."""
    table = pd.read_parquet(path)
    gains = [14.87, 13.26, 11.13, 10.62, 11.03, 11.47]
    t = table["t"].to_numpy()
    u = np.stack([k * table[f"i{j + 1}"].to_numpy() for j, k in enumerate(gains)], 1)
    y = np.stack([table[f"q{j + 1}"].to_numpy() for j in range(6)], 1)

    def series(name, x):
        return {f"{name}{j + 1}": x[:, j] for j in range(6)}

    units = {f"tau{j + 1}": "N m" for j in range(6)} | {f"q{j + 1}": "rad" for j in range(6)}
    return jaxid.Dataset.from_arrays(
        t, series("tau", u), series("q", y), units=units, model="ur10e"
    )


@pytest.mark.parametrize("warmer", [1.0, pytest.param(1.15, marks=pytest.mark.slow)])
def test_a_reference_of_the_same_arm_shows_no_load(warmer):
    """Friction may be another by then, bodies are not."""
    arm = ARMS["three"]
    before = jaxid.identify(
        arm, recorded([run(arm, s) for s in (11, 12, 13)]), friction="linear", as_recorded=True
    )

    def less(q, qd, qdd, rigid):
        return (warmer - 1) * (2.0 * qd + 1.5 * np.tanh(qd / 0.003))

    runs = [run(arm, s, more=less) for s in (1, 2, 3)]
    d = asked(arm, runs, reference=ReferenceNumbers.read(before))
    different = {e.effect for e in d.which.effects}
    assert all("friction" in effect for effect in different), d.which.text
    assert bool(different) is (warmer > 1), d.which.text


def test_a_reference_by_torque_is_compared_by_torque():
    arm, load = ARMS["three"], body(1.5, 0.05, 0.02, 0.1)
    before = jaxid.identify(
        arm, recorded([run(arm, s) for s in (11, 12, 13)]), friction="linear", as_recorded=True
    )
    told = ReferenceNumbers.read(before)
    data = recorded([run(arm, s, load) for s in (1, 2, 3)])
    d = run_diagnosis(arm, data, 3, None, (), None, 0, None, told)
    assert d.residual == "inverse_dynamics"
    assert ("payload", "q3") in named(d), d.which.text


@pytest.mark.skipif(not (DATA / "ur10e").is_dir(), reason="no recordings at hand")
@pytest.mark.slow
def test_the_load_of_a_recorded_arm_is_weighed_against_its_reference():
    """By identification the same pair gives 3.07 +- 0.14 kg."""
    data = jaxid.load_dataset(DATA / "ur10e")
    pair = {}
    for name in ("unloaded_0131", "loaded_0131"):
        pair[name] = one_run(data, DATA / "ur10e" / f"{name}.parquet")
    before = jaxid.identify(None, pair["unloaded_0131"], as_recorded=True)
    told = ReferenceNumbers.read(before)
    d = run_diagnosis(None, pair["loaded_0131"], 3, None, (), None, 0, None, told)
    assert d.which.verdict == "named" and named(d) == {("payload", "q6")}, d.which.text
    mass = payload_of(d)["mass"]
    assert abs(mass.value - 3.07) < 0.14


def test_a_departure_counts_bodies_whatever_the_others_are():
    """As a covariance of the bodies alone has it."""
    rng = np.random.default_rng(0)
    root = rng.standard_normal((5, 9))
    information = root @ root.T
    mean, theta = rng.standard_normal(5), rng.standard_normal(5)
    inside = np.array([True, False, True, True, False])
    found = departure(ColumnPrior(information, mean), inside)
    covariance = np.linalg.inv(information)[np.ix_(inside, inside)]
    apart = (theta - mean)[inside]
    assert found(theta) == pytest.approx(apart @ np.linalg.solve(covariance, apart))
