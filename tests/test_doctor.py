"""`jaxid doctor`: the closed form of its self test is right, and what goes wrong is said."""

from __future__ import annotations

import json

import numpy as np
from scipy.integrate import solve_ivp

from jaxid.base import extras
from jaxid.cli import self_test as doctor
from jaxid.cli.app import main
from jaxid.cli.doctor import text


def test_the_closed_form_is_the_motion_of_the_joint():
    tau = np.random.default_rng(0).uniform(-1, 1, 40)

    def equation(t, state, torque):
        return [state[1], (torque - doctor.VISCOUS * state[1]) / doctor.INERTIA]

    state, expected = np.zeros(2), [0.0]
    for torque in tau[:-1]:
        run = solve_ivp(equation, (0, doctor.PERIOD), state, args=(torque,), rtol=1e-10, atol=1e-13)
        state = run.y[:, -1]
        expected.append(state[0])
    np.testing.assert_allclose(doctor.motion(tau, 0), expected, atol=1e-10)
    late = doctor.motion(tau, 3)
    np.testing.assert_allclose(late[3:], expected[:-3], atol=1e-10)
    assert not late[:4].any()


def test_all_is_well_here(capsys):
    assert main(["doctor", "--json", "--quiet"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["well"] and len(found["tests"]) == len(doctor.SELF_TESTS)
    assert set(found["extras"]) == {extra for extra, _ in extras.EXTRAS.values()}


def test_what_goes_wrong_is_said(monkeypatch, capsys):
    def broken():
        raise RuntimeError("no such device")

    monkeypatch.setattr(doctor, "SELF_TESTS", {"one thing": broken})
    monkeypatch.setattr("jaxid.base.extras.find_spec", lambda package: None)
    monkeypatch.setattr(doctor, "find_spec", lambda package: None)
    assert main(["doctor"]) == 1
    printed = capsys.readouterr().out
    assert "RuntimeError: no such device" in printed and "Something went wrong" in printed
    assert 'pip install "jaxid[ros]"' in printed


def test_a_diagnosis_that_names_something_else_does_not_pass(monkeypatch):
    monkeypatch.setattr(doctor, "twin", lambda delay, make=doctor.twin: make(0))
    assert not doctor.the_delay_is_named().passed


def test_a_cache_that_cannot_be_written_is_told(monkeypatch):
    monkeypatch.setattr(doctor, "SELF_TESTS", {})
    monkeypatch.setattr("jaxid.runtime.cache_folder", lambda: None)
    health = doctor.examine()
    assert health.cache is None and health.well
    assert "JAXID_CACHE_DIR" in text(health)
