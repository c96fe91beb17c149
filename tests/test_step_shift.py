"""What the steps of a file's simulator alone do to a number refutes none of the file's."""

from __future__ import annotations

import numpy as np
import pytest

import jaxid
from jaxid.models import Robot
from test_own_simulator import dataset, EVERY, FILE, goals, recorded, STEP


SECONDS = 4.0
#: The same machine in steps of half the file's.
FINER = FILE.replace(f'timestep="{STEP}"', f'timestep="{STEP / 2}"').replace(
    'nsample="7"', 'nsample="13"'
)


@pytest.fixture(scope="module")
def readings() -> np.ndarray:
    u = goals(SECONDS)
    noise = 1e-4 * np.random.default_rng(8).standard_normal(len(u))
    return recorded(FINER, u, 2 * EVERY) + noise


def refuted(readings: np.ndarray, text: str) -> dict[str, float]:
    """Numbers of a file that a recording refutes, and what they are."""
    robot = Robot.from_mjcf("lift.xml", text=text)
    found = jaxid.fit(robot, dataset(goals(SECONDS), readings))
    return {s.parameter: s.fitted for s in found.stated if s.refuted}


@pytest.mark.slow
def test_a_machine_in_finer_steps_refutes_no_right_number(readings, monkeypatch):
    assert refuted(readings, FILE) == {}
    monkeypatch.setattr("jaxid.fitting.assemble.with_steps", lambda *a: a[-1])
    assert refuted(readings, FILE)  # what it is there for


@pytest.mark.slow
def test_a_wrong_number_is_refuted_all_the_same(readings):
    found = refuted(readings, FILE.replace('damping="0.4"', 'damping="1.0"'))
    assert found.keys() == {"kd + damping of lift"}
    assert found["kd + damping of lift"] == pytest.approx(2.4, rel=0.05)
