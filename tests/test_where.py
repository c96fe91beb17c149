"""Where the gap lies: missing forces made by hand, with the noise of derivatives over them."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import jaxid
from jaxid.diagnosis.missing import Missing, missing_forces
from jaxid.diagnosis.travel import part_of_travel
from jaxid.diagnosis.where import findings, floor_at, PART, supplied, table
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.problem.binding import bind
from reference import multisine


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from jaxid.benchmark import numpy_twin as twins, plants  # noqa: E402


N, JOINTS = 2000, ("a", "b")
T = np.arange(N) / 200
QD = np.stack([np.sin(0.8 * T), np.sin(0.5 * T + 1)], 1)


def missing(force: np.ndarray, rng: np.random.Generator) -> Missing:
    """One run with that force [time joint]; noise of 1 N m in every draw."""
    experiment = cast(Any, SimpleNamespace(t=T, name="run"))
    null = rng.standard_normal((12, N, 2))
    qdd = np.gradient(QD, T, axis=0)
    return Missing(
        experiment, np.ones(N, bool), np.cumsum(QD, 0) / 200, QD, qdd, np.zeros((N, 2)), force, null
    )


def bench() -> Any:
    signature = SimpleNamespace(
        joints=JOINTS,
        outputs=(("a", "rad"), ("b", "rad")),
        output_names=("a", "b"),
        unit=lambda _pattern, _joint: "N m",
    )
    return SimpleNamespace(binding=SimpleNamespace(chain=SimpleNamespace(signature=signature)))


def looked_at(force: np.ndarray, left: np.ndarray, only: tuple[str, ...]):
    rng = np.random.default_rng(0)
    before, after = [missing(force, rng)], [missing(left, rng)]
    given = {j: g for j in only if (g := supplied(before, after, JOINTS.index(j))) is not None}
    rows = table(before, JOINTS, given)
    return findings(bench(), before, rows, {j: j for j in only}, only, given), rows, given


def test_a_force_far_below_the_noise_is_found_where_its_effect_acts():
    """A third of the noise at speed forwards, at b. Joint a shows more than noise of itself, with
    and without it.
    """
    noise = np.random.default_rng(1).standard_normal((N, 2))
    noise[:, 0] *= 1.4
    law = np.stack([np.zeros(N), 0.35 * (QD[:, 1] > 0.5)], 1)
    found, rows, given = looked_at(law + noise, noise, ("b",))
    assert np.allclose(given["b"][0], law[:, 1])
    assert {f.location for f in found} == {"b"} and sum(f.regime == "forward" for f in found) == 1
    forward = next(f for f in found if f.regime == "forward")
    assert forward.share_of_gap == pytest.approx(1.0) and 0.2 < forward.times_noise_floor < 0.35
    inside = T[(QD[:, 1] > 0.5)]
    assert inside.min() <= forward.window_s[0] < forward.window_s[1] <= inside.max() + 0.01
    row = next(r for r in rows if (r.joint, r.regime) == ("b", "forward"))
    assert (
        row.stands_out and not row.ratio > 1.1 * row.null[1]
    )  # what is measured alone does not show it
    assert all(r.supplied is None for r in rows if r.joint == "a")
    # Without the effect all that is seen is that joint a shows more than noise.
    blind, _, _ = looked_at(law + noise, noise, ())
    assert blind and {f.location for f in blind} == {"a"}
    nothing, _, _ = looked_at(0.9 * noise / [1.4, 1.0], 0.9 * noise / [1.4, 1.0], ("b",))
    assert not nothing


def test_what_an_effect_does_not_take_away_is_looked_at_as_measured():
    """A sensor or play changes the motion: what the law with it supplies along that motion is not
    what was missing.
    """
    rng = np.random.default_rng(2)
    noise = rng.standard_normal((N, 2))
    large = 3.0 * (QD > 0.5)
    moved = 0.3 * rng.standard_normal((N, 2))
    found, rows, given = looked_at(large + noise, large + noise + moved, ("a",))
    assert not given and all(r.supplied is None for r in rows)
    assert (
        {f.location for f in found} == {"a"}
        and found[0].regime == "forward"
        and found[0].times_noise_floor > 1.5
    )


def test_the_floor_is_told_where_it_lies():
    m = missing(np.zeros((N, 2)), np.random.default_rng(3))
    m.null[:, N // 3 : N // 2] = 0.0  # held by its friction
    assert np.isfinite(floor_at(m, 0)).all()
    m = missing(np.zeros((N, 2)), np.random.default_rng(3))
    m.null[:, : N // 2] *= 10
    floor = floor_at(m, 0)
    assert floor[: N // 2 - 20] == pytest.approx(10, rel=0.4) and floor[
        N // 2 + 20 :
    ] == pytest.approx(1, rel=0.4)


def test_what_repeats_differ_by_is_a_motion_and_no_noise_of_a_reading():
    """Two runs of a mass whose friction differs by a fifth end rad apart: a torque that the model
    lacks stands out of that, where rad of white noise would hide anything.
    """
    rng, t = np.random.default_rng(0), np.arange(600) / 100
    u = multisine(t, [0.05], seed=1, periods=3.0, lines=6)[:, 0]
    runs = []
    for friction in (0.018, 0.022):
        q, qd, y = 0.0, 0.0, []
        for push in u + 0.02 * (t > 4):  # what the model knows nothing of
            y.append(q)
            qd += 0.01 * (push - friction * qd) / 0.01
            q += 0.01 * qd
        runs.append(np.array(y) + 1e-4 * rng.standard_normal(len(t)))
    data = jaxid.Dataset.from_arrays(
        [t, t],
        {"tau": [u, u]},
        {"q": runs},
        split=["fit", "validation"],
        at_rest=True,
        model="joint",
    )
    binding = bind(None, data, without=["coulomb_friction", "constant_torque"])
    assert (
        binding.noise["q"].source == "repeatability"
        and binding.sigma[0] > 100 * binding.readings[0]
    )
    theta = binding.theta.copy()
    for name, value in (("inertia", 0.01), ("viscous", 0.02)):
        theta[binding.layout.index(name)] = value
    bench = ProblemBuilder(binding, differences=1)
    (m,) = missing_forces(bench, theta, estimate_starts(bench, "fit", [theta])[0], 0)
    late = m.experiment.t[m.keep] > 4.5
    floor = np.sqrt(np.mean(m.null[:, late] ** 2))
    assert abs(np.mean(m.force[late])) == pytest.approx(0.02, abs=0.006) and floor < 0.01
    # What the repeats differ by, (0.022 - 0.018) qd / 2, is in the floor.
    assert floor > 0.3 * 0.002 * np.sqrt(np.mean(m.qd[late] ** 2))


def test_a_joint_that_its_friction_may_hold_lacks_nothing():
    """It is pushed by less than its friction, and its reading flickers: no force is missing,
    whichever way the flicker goes. A model of half that friction lacks the rest of it.
    """
    rng, t = np.random.default_rng(0), np.arange(600) / 100
    u = 0.05 * np.sin(t)
    data = jaxid.Dataset.from_arrays(
        t,
        {"tau": u},
        {"q": 1e-4 * rng.standard_normal(len(t))},
        split="fit",
        at_rest=True,
        noise_std={"q": 1e-4},
        model="joint",
    )
    binding = bind(None, data, splits=False)
    bench = ProblemBuilder(binding, differences=1)
    for friction, most in ((0.06, 0.0), (0.03, 0.02)):
        theta = binding.theta.copy()
        for name, value in (
            ("inertia", 1e-4),
            ("viscous", 0.0),
            ("coulomb", friction),
            ("offset", 0.0),
        ):
            theta[binding.layout.index(name)] = value
        (m,) = missing_forces(bench, theta, estimate_starts(bench, "fit", [theta])[0], 0)
        assert np.max(np.abs(m.force)) == pytest.approx(most, abs=0.004)


def test_a_reading_that_is_left_out_leaves_a_floor():
    t, rng = np.arange(400) / 100, np.random.default_rng(0)
    q = 0.01 * np.sin(2 * t) ** 2 + 1e-4 * rng.standard_normal(t.size)
    whole = jaxid.Dataset.from_arrays(
        t, {"tau": np.sin(2 * t)}, {"q": q}, split="fit", noise_std={"q": 1e-4}, model="joint"
    )
    run = dataclasses.replace(whole.experiments[0], left_out=(np.arange(t.size) == 200)[:, None])
    binding = bind(None, dataclasses.replace(whole, experiments=(run,)), splits=False)
    bench = ProblemBuilder(binding, differences=1)
    (m,) = missing_forces(
        bench, binding.theta, estimate_starts(bench, "fit", [binding.theta])[0], 0
    )
    assert np.isfinite(m.force).all() and np.isfinite(m.null).all()


@pytest.mark.slow
def test_a_right_model_shows_what_noise_shows():
    """At each joint, though one moves faster than the other: what is measured and what is simulated
    pass the same filters.
    """
    plant, t = dataclasses.replace(plants.PLANTS["tracker"], resolution=0.0), np.arange(800) / 100
    slow, fast = (
        multisine(t, [a], seed=s, periods=p, lines=6)[:, 0]
        for a, s, p in ((1.0, 1, 4.0), (0.8, 2, 0.8))
    )
    u = np.stack([slow, fast], 1)[None]
    numbers = {k: np.array(x)[None] for k, x in plant.nominal.items()}
    y = twins.recorded(plant, u, numbers, np.random.default_rng(0))[0]
    data = jaxid.Dataset.from_arrays(
        [t],
        {"tau_theta": [u[0, :, 0]], "tau_alpha": [u[0, :, 1]]},
        {"theta": [y[:, 0]], "alpha": [y[:, 1]]},
        split=["fit"],
        at_rest=True,
        noise_std={"theta": plant.noise, "alpha": plant.noise},
        model="tracker",
    )
    binding = bind(None, data)
    theta = binding.theta.copy()
    for name, key in (("J", "J"), ("b", "viscous")):
        for k, joint in enumerate(("theta", "alpha")):
            theta[binding.layout.index(f"{name}_{joint}")] = plant.nominal[key][k]
    bench = ProblemBuilder(binding, differences=1)
    (m,) = missing_forces(bench, theta, estimate_starts(bench, "fit", [theta])[0], 0)
    ratio = np.sqrt(np.mean(m.force**2, 0) / np.mean(m.null**2, (0, 1)))
    assert ratio == pytest.approx(1.0, abs=0.15)


# ---- a part of the travel

WAY = np.stack([np.sin(0.8 * T), np.sin(0.5 * T + 1)], 1)  # m


def along(force: np.ndarray, rng: np.random.Generator) -> Missing:
    """A run that passes each place several times, with that force [time joint]."""
    whole = missing(force + rng.standard_normal((N, 2)), rng)
    return dataclasses.replace(whole, q=WAY, qd=np.gradient(WAY, T, axis=0))


def bump(at: float, width: float) -> np.ndarray:
    return np.exp(-(((WAY - at) / width) ** 2))


@pytest.mark.parametrize(("against", "sign"), [(True, 1.0), (False, 1.0), (False, -1.0)])
def test_a_tight_spot_is_told_by_where_it_lies_and_how_much_it_is(against, sign):
    rng = np.random.default_rng(4)
    runs = []
    for _ in range(3):
        law = 6.0 * sign * bump(0.35, 0.1)
        if against:
            law = law * np.sign(np.gradient(WAY, T, axis=0))
        law[:, 1] = 0.0
        runs.append(along(law, rng))
    part = part_of_travel(runs, 0, [m.force[:, 0] for m in runs])
    assert part is not None and part.against == against
    # Half of the peak lies 0.083 to either side; the travel is looked at in fortieths.
    assert part.low == pytest.approx(0.35 - 0.083, abs=0.05)
    assert part.high == pytest.approx(0.35 + 0.083, abs=0.05)
    assert part.more == pytest.approx(6.0 * sign * 0.8, rel=0.15)
    rows = table(runs, JOINTS, {})
    first = findings(bench(), runs, rows, {}, (), {})[0]
    assert (first.location, first.regime, first.variable) == ("a", PART, "position")
    assert first.range == pytest.approx((part.low, part.high), abs=0.02)
    assert first.value == pytest.approx(abs(part.more)) and "than elsewhere" in first.text
    assert first.times_noise_floor > 5 and first.unit == "N m"
    assert ("less" in first.text) == (sign < 0)
    assert ("against the motion" in first.text) == against


def test_noise_has_no_place_on_the_way():
    rng = np.random.default_rng(5)
    runs = [along(np.zeros((N, 2)), rng) for _ in range(3)]
    rows = table(runs, JOINTS, {})
    assert not any(f.regime == PART for f in findings(bench(), runs, rows, {}, (), {}))


def test_a_joint_that_stands_has_no_part_of_travel():
    still = along(np.zeros((N, 2)), np.random.default_rng(6))
    still = dataclasses.replace(still, q=np.zeros((N, 2)), qd=np.zeros((N, 2)))
    assert part_of_travel([still], 0, [still.force[:, 0]]) is None


def test_a_spot_below_the_noise_of_a_sample_is_seen_in_the_mean():
    """A force of half the noise of one sample, which its mean over many samples shows."""
    rng = np.random.default_rng(7)
    runs = []
    for _ in range(6):
        law = 0.6 * bump(-0.2, 0.12) * np.sign(np.gradient(WAY, T, axis=0))
        law[:, 1] = 0.0
        runs.append(along(law, rng))
    rows = table(runs, JOINTS, {})
    found = findings(bench(), runs, rows, {}, (), {})
    (spot,) = [f for f in found if f.regime == PART]
    assert spot.location == "a" and spot.value == pytest.approx(0.48, rel=0.35)
    assert spot.range is not None
    low, high = spot.range
    assert low == pytest.approx(-0.3, abs=0.07) and high == pytest.approx(-0.1, abs=0.07)
