"""Reduced benchmarks: honest intervals, and the scan against an adaptive solver."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import reference as ref
from benchmarks import blind_cases, diffrax_reference, recovery, run_all
from benchmarks.blind_cases import plan, recordings
from jaxid.benchmark import laws, mujoco_twin, numpy_twin as twins, plants, withheld
from jaxid.benchmark.withheld import commands
from jaxid.models import Pendulum, PlanarArm


def test_intervals_hold_the_truth():
    """40 noise seeds; the benchmark runs 200."""
    found = recovery.study(40)
    covered = recovery.coverage(found)
    assert np.all(covered >= 0.82)
    assert np.mean(covered) >= 0.89
    width = np.median(found["stds"], 0) / found["bounds"]
    assert np.all(width <= 1.3) and np.all(width >= 0.95)


@pytest.mark.parametrize(
    "kind, values, amplitude, smoothing, limit",
    [
        (Pendulum, diffrax_reference.PENDULUM, [1.2], 0.03, 5e-6),
        (PlanarArm, diffrax_reference.ARM, [14.0, 4.0], 0.1, 1e-5),
    ],
    ids=["pendulum", "planar_arm"],
)
def test_scan_agrees_with_diffrax(kind, values, amplitude, smoothing, limit):
    to_diffrax, to_sticking = diffrax_reference.agreement(
        kind, values, amplitude, smoothing, 5e-4, count=250
    )
    assert to_diffrax <= limit
    assert limit < to_sticking < 0.02


def test_the_twins_of_the_blind_cases_are_those_of_the_tests():
    """Against the event-exact simulator; several lanes with an effect each, 3e-4 rad being the
    recordings' noise.
    """
    plant = plants.PLANTS["pendulum"]
    t = np.arange(100) / plant.rate
    u = ref.multisine(t, [0.6], 3, periods=0.6, lines=4)
    effects = [
        ({}, {}),
        ({"stribeck": 0.05, "stribeck_speed": 0.3},) * 2,
        ({"load": 0.1},) * 2,
        ({"dead_zone": 0.05},) * 2,
        ({"delay": 0.0083},) * 2,
        ({"linear": 1.0}, {"other_hold": 1.0}),
        ({"lag": 0.01}, {"lag_s": 0.01}),
    ]
    nominal = {"viscous": 0.03, "coulomb": 0.04, "offset": 0.01}
    numbers = {"J": 0.06, "mgl": 0.9, **nominal}
    p = {k: np.full((len(effects), 1), float(x)) for k, x in {**plants.NEUTRAL, **numbers}.items()}
    for lane, (own, _) in enumerate(effects):
        for k, x in own.items():
            p[k][lane] = x
    y = twins.rigid(plant, np.tile(u[None], (len(effects), 1, 1)), p, 50, plant.step)[:, ::50, 0]
    for lane, (_, truth) in enumerate(effects):
        q, _ = ref.simulate(ref.pendulum(0.06, 0.9), ref.Truth(**nominal, **truth), t, u)
        assert np.abs(y[lane] - q[:, 0]).max() < 3e-5, truth


@pytest.mark.slow
def test_the_arms_twin_is_as_good_as_its_noise():
    """Dry friction between two coupled links: taken with the mass matrix of a step's beginning it
    is off by more than the noise once the arm swings.
    """
    plant = plants.PLANTS["planar_arm"]
    t = np.arange(200) / plant.rate
    u = ref.multisine(t, [22.0, 7.0], 5, periods=0.8, lines=5)
    p = {
        k: np.array([plant.nominal.get(k, (x, x))] * 2, float)
        for k, x in (plants.NEUTRAL | plant.nominal).items()
    }
    p["compliance"][1, 0], p["spring_damping"][1, 0] = (
        5e-5,
        0.1,
    )  # a motor of its own behind a stiff spring
    parts = round(1 / plant.rate / plant.step)
    y, soft = twins.rigid(plant, np.tile(u, (2, 1, 1)), p, parts, plant.step)[:, ::parts]
    friction: dict[str, Any] = {k: np.array(plant.nominal[k]) for k in ("viscous", "coulomb")}
    q, _ = ref.simulate(ref.planar_arm(), ref.Truth(**friction), t, u)
    assert np.ptp(q, axis=0).min() > 0.5 and np.abs(y - q).max() < 0.3 * plant.noise
    assert (
        np.abs(soft - q).max() < 0.02
    )  # the other joint's dry friction reaches the link behind the spring


@pytest.mark.parametrize("model", mujoco_twin.PLANTS)
@pytest.mark.slow
def test_the_twins_of_mujoco_are_the_same_machines(model):
    """For 1.5 s, with what MuJoCo has itself and what is set anew before every step; the arm swings
    over the top.
    """
    plant = plants.PLANTS[model]
    u = commands(plant, np.random.default_rng(4), 1)[:, : int(1.5 * plant.rate)]
    own = {
        "payload": 0.05,
        "spring": 0.03,
        "reflected": 0.002,
        "tilt": 0.02,
        "load": 0.1,
        "drag": 0.002,
        "dry_asymmetry": 0.005,
    }
    own |= {"ripple": 0.02, "ripple_order": 6.0, "dead_zone": 0.02, "lag": 0.01, "droop": 0.02}
    if model in ("joint", "tracker"):
        own |= {
            "payload": 0.0,
            "tilt": 0.0,
        }  # no gravity; payloads of the tracker are of its barrel alone
    p = {k: np.full((1, plant.n), float(x)) for k, x in (plants.NEUTRAL | own).items()}
    p |= {k: np.array([x]) for k, x in plant.nominal.items()}
    fast, slow = round(1 / plant.rate / mujoco_twin.STEP), round(1 / plant.rate / plant.step)
    h = 1 / plant.rate / fast
    q = mujoco_twin.simulated(
        plant, laws.fine(u, p, fast, h)[0], {k: x[0] for k, x in p.items()}, h
    )[::fast]
    reference = twins.rigid(plant, u, p, slow, plant.step)[0, ::slow]
    assert np.ptp(reference, 0).min() > 0.05 and np.abs(q - reference).max() < 5 * plant.noise


def test_cases_that_begin_in_motion_state_neither_rest_nor_splits(monkeypatch):
    monkeypatch.setitem(withheld.SECONDS, "joint", 0.5)
    monkeypatch.setattr(blind_cases, "BEFORE_S", 0.5)
    (data,), _, _ = recordings(plan("joint", 3, ("moving_control",))[:1], 3)
    plant = plants.PLANTS["joint"]
    assert [(e.split, e.at_rest, e.initial, len(e)) for e in data.experiments] == [
        ("fit", False, None, plant.rate // 2)
    ] * 3
    assert sum(abs(e.y[20, 0] - e.y[0, 0]) > 30 * plant.noise for e in data.experiments) >= 2


def test_results_are_written_from_what_was_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(run_all, "HERE", tmp_path)
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "a.json").write_text(
        '{"title": "A", "text": "t", "rows": [{"x": 1.23456, "y": "a|b"}, {"z": 2}]}'
    )
    run_all.write()
    text = (tmp_path / "RESULTS.md").read_text()
    assert "## A" in text and "| x | y | z |" in text and "| 1.235 | a\\|b |  |" in text


def test_every_benchmark_has_an_entry():
    assert {"recovery", "diffrax_reference"} <= set(run_all.modules())
