"""What an identification answers: stated numbers, and what a payload's interval holds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest


pytest.importorskip("pinocchio")

from jaxid.data.dataset import ModelSpec, ParameterPrior  # noqa: E402
from jaxid.identification.payload import payload_of  # noqa: E402
from jaxid.identification.run import identify  # noqa: E402
from jaxid.models import UR10  # noqa: E402
from test_identification import LOAD, recording, truth  # noqa: E402


def test_a_payload_says_beside_its_mass_that_exact_gains_are_assumed():
    base = UR10().base()
    plain = payload_of(truth(base, LOAD) - truth(base), 1e-6 * np.eye(40), base)
    stated = payload_of(truth(base, LOAD) - truth(base), 1e-6 * np.eye(40), base, gain_std=0.1)
    assert "exact" in plain.exact_gains and "gain_std" in plain.exact_gains
    assert stated.exact_gains == "" and stated.mass[1] > 0.09 * LOAD[9]
    assert plain.to_dict()["gains"] == plain.exact_gains


@pytest.mark.slow
def test_stated_numbers_of_an_arm_are_answered():
    """One that leads alone is confirmed or refuted; one that shows only with others is neither."""
    data = recording(None, 0.02, 1, np.ones(6))
    first = identify(None, data, friction="linear")
    value = {name: float(first.theta[first.names.index(name)]) for name in ("F_v3", "F_c1")}
    known = {"F_v3": value["F_v3"], "F_c1": 2 * value["F_c1"], "m3": 4.0}
    spec = ModelSpec("ur10", parameters={k: ParameterPrior(v) for k, v in known.items()})
    found = identify(None, dataclasses.replace(data, model=spec), friction="linear")
    rows = {r["parameter"]: r for r in found.to_dict()["stated"]}
    assert set(rows) == set(known)
    assert abs(rows["F_v3"]["deviation"]) < 3 < abs(rows["F_c1"]["deviation"])
    assert (
        "standard deviations from" in rows["F_c1"]["text"] and rows["F_c1"]["text"] in found.answers
    )
    assert rows["m3"]["deviation"] is None and "neither confirmed nor refuted" in rows["m3"]["text"]
