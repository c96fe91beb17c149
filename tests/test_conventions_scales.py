"""Known factors of one channel or of a whole log, beside numbers that are right and that are off;
and the signs of channels that read no joint.
"""

from __future__ import annotations

from math import pi
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import jaxid
from jaxid.benchmark.broken import recording
from jaxid.benchmark.numpy_twin import recorded
from jaxid.benchmark.plants import LINK, PLANTS
from jaxid.conventions import checking
from jaxid.conventions.beside_joints import followed, Run
from jaxid.conventions.readings import (
    known_factors,
    nearest_factor,
    unmistakable,
    whole_ratio,
)
from jaxid.data.dataset import ModelSpec
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import constant, param
from jaxid.fitters.short_fit import free_motion
from jaxid.models.effects import ConstantTorque, CoulombFriction, ViscousFriction


DEGREES = 180 / pi


class Hoist(Rigid):
    """A pendulum behind a gear of 30: what enters is the motor's torque; the load is known."""

    name: ClassVar[str] = "hoist"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("tau", "N m"),), (("q", "rad"),), ("q",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
        (ConstantTorque, {"torque": "offset"}),
    )
    equations: ClassVar[str] = (
        "(inertia + rotor ratio^2) qdd + gravity_torque sin(q) + friction = ratio tau"
    )
    source: ClassVar[str] = "textbook"
    rotor: Array = param(1e-5, 1e-8, 1e-2, unit="kg m^2", log=True)
    ratio: Array = constant(30.0, unit="1")
    inertia: Array = constant(0.045, unit="kg m^2")
    gravity_torque: Array = constant(0.9, unit="N m")

    def drive(self, signature, u, q, qd):
        return self.ratio * u

    def matrices(self, q, qd):
        inertia = self.inertia + self.ratio**2 * self.rotor
        return jnp.reshape(inertia, (1, 1)), self.gravity_torque * jnp.sin(q)


def decided(model: object, data: jaxid.Dataset) -> list[Any]:
    found = checking.run_check(model, data).findings
    return [(f.kind, f.channel, pytest.approx(f.value), f.decisive) for f in found]


def pendulum(seed: int, angle: float = 1.0, torque: float = 1.0, model: Any = "pendulum"):
    """The twin's pendulum, J 0.06 and m g l 0.9, each channel times a factor."""
    r = recording("pendulum", seed)
    return jaxid.Dataset.from_arrays(
        [r.t] * 3,
        {"tau": list(torque * r.u[:, :, 0])},
        {"q": list(angle * r.y[:, :, 0])},
        split=["fit", "fit", "validation"],
        model=None if isinstance(model, Rigid) else model,
        check_model=False,
    )


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("angle", "torque", "channel", "value"),
    [
        (1.0, 1.0 / 30, "", 0.0),
        (DEGREES, 1.0 / 30, "q", DEGREES),
        (1.0, 1000.0 / 30, "tau", 1000.0),
        (1.0, 1.0, "tau", 30.0),
    ],
)
def test_a_load_that_is_known_tells_units_and_a_gear(seed, angle, torque, channel, value):
    found = decided(Hoist(), pendulum(seed, angle, torque, model=Hoist()))
    assert found == ([("scale", channel, value, True)] if channel else [])


@pytest.mark.parametrize("seed", [1, 2])
def test_degrees_beside_stated_numbers_that_are_off_are_asked_about(seed):
    """By these numbers another factor fits better: degrees are likelier than a gear of 47."""
    off = Hoist(gravity_torque=jnp.asarray(1.09))
    (finding,) = checking.run_check(off, pendulum(seed, DEGREES, 1.0 / 30, model=off)).findings
    assert (finding.kind, finding.channel, finding.line) == ("scale", "q", 'unit = "deg"')
    assert finding.value == pytest.approx(DEGREES) and not finding.decisive


@pytest.mark.parametrize("model", ["tracker", "planar_arm"])
def test_a_whole_log_in_degrees_is_one_finding(model):
    r = recording(model, 2)
    r.y = np.degrees(r.y)
    checked = checking.run_check(None, r.dataset())
    (finding,) = checked.findings
    assert finding.kind == "scale" and finding.decisive and not finding.same_as
    names = [n for n, _ in r.plant.outputs]
    assert finding.line == "\n".join(f'unit = "deg"  # of {n}' for n in names)
    assert checked.mended is not None
    assert np.allclose(checked.mended.experiments[0].y, np.radians(r.y[0]))


def test_goals_and_positions_of_a_servo_in_degrees_are_one_finding():
    r = recording("servo", 1)
    speed = np.gradient(r.y, r.t, axis=1)
    r.u = np.degrees(r.y + (r.u + 0.04 * speed) / (0.12 * 7.4 * 0.4))
    r.y = np.degrees(r.y)
    (finding,) = checking.run_check(None, r.dataset()).findings
    assert (finding.kind, finding.decisive) == ("scale", True)
    assert finding.value == pytest.approx(DEGREES)
    assert "# of q_cmd" in finding.line and "# of q\n" in finding.line + "\n"


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("off", [0.8, 1.0, 1.25])
def test_numbers_that_are_off_are_no_unit(seed, off):
    model = Hoist(gravity_torque=jnp.asarray(0.9 * off))
    assert not decided(model, pendulum(10 + seed, torque=1.0 / 30, model=model))


def test_factors_are_those_of_the_unit():
    assert nearest_factor(0.1, known_factors("N"))[1] == "kgf read as N"
    assert nearest_factor(9.0, known_factors("N", 9.80665))[1] == "N read as kgf"
    assert "kgf" not in nearest_factor(9.0, known_factors("m"))[1]
    assert nearest_factor(0.1, known_factors("m/s^2"))[1] == "g_n read as m/s^2"
    assert nearest_factor(pi / 180, known_factors("rad", pi / 180))[1] == "rad read as deg"
    assert set(known_factors("N s/m").values()) == {1000.0, 1e-3}
    assert whole_ratio(30.02, 1e-4) == 30 and whole_ratio(1 / 30.02, 1e-4) == 1 / 30
    assert whole_ratio(30.3, 1e-4) is None and whole_ratio(30.0, 0.05) is None


@pytest.mark.parametrize(
    ("scale", "channel", "factor"),
    [
        ({"qd": 180 / pi}, "qd", 180 / pi),
        ({"qd": 30 / pi}, "qd", 30 / pi),
        ({"qd": 1 / (2 * pi)}, "qd", 1 / (2 * pi)),
        ({"q": 180 / pi}, "q", 180 / pi),
        ({"q": 4096 / (2 * pi)}, "q", 4096 / (2 * pi)),
    ],
)
def test_of_a_position_and_its_speed_the_one_with_another_unit_is_told(scale, channel, factor):
    whole = recording("joint", 5).dataset()
    t, q, qd, tau = [], [], [], []
    for e in whole.experiments:
        t.append(e.t)
        q.append(e.y[:, 0] * scale.get("q", 1.0))
        qd.append(np.gradient(e.y[:, 0], e.t) * scale.get("qd", 1.0))
        tau.append(e.u[:, 0])
    data = jaxid.Dataset.from_arrays(
        t,
        {"tau": tau},
        {"q": q, "qd": qd},
        units={"tau": "N m", "q": "rad", "qd": "rad/s"},
        split=[e.split for e in whole.experiments],
        model="joint",
    )
    told = [f for f in jaxid.check("joint", data).findings if f.kind == "scale"]
    assert [(f.channel, f.applied) for f in told] == [(channel, True)]
    assert told[0].value == pytest.approx(factor, rel=2e-3)


def test_a_size_between_two_units_stands_for_none():
    torques = known_factors("N m")
    assert "lbf ft read as N m" not in torques  # 0.74, as a mass may be off
    assert unmistakable(10.2, 1e-3, torques) and not unmistakable(9.5, 1e-3, torques)
    assert unmistakable(100.02, 1e-3, torques) and not unmistakable(101.0, 1e-3, torques)
    assert not unmistakable(101.0, 0.1, torques) and not unmistakable(0.25, np.inf, torques)


def link(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two runs of a flexible link, its stiffness 20 % and its hub 15 % off: t, tau [runs time], and
    hub angle and tip acceleration [runs time 2], noise and a zero on the latter.
    """
    plant, rng = PLANTS["flexible_link"], np.random.default_rng(seed)
    t = np.arange(4 * plant.rate) / plant.rate
    f, phase = rng.uniform(0.3, 4.0, (2, 6, 1)), rng.uniform(0, 2 * pi, (2, 6, 1))
    u = 0.12 * np.sin(2 * pi * f * t + phase).sum(1)
    numbers = {**LINK, "E": 1.2 * LINK["E"], "I_m": 0.85 * LINK["I_m"]}
    lanes = {k: np.full((2, 1), x) for k, x in numbers.items()}
    y = recorded(plant, u[:, :, None], lanes, rng)
    y[:, :, 1] += 0.2 + 0.3 * rng.standard_normal(y.shape[:2])
    return t, u, y


@pytest.mark.parametrize("factor", [1.0, -1.0, -1 / 9.80665])
def test_the_slow_part_of_a_signal_tells_its_sign_and_size(factor):
    """Beside 15 % of another size, noise and a zero; a signal of its own says nothing."""
    t = np.arange(0.0, 8.0, 0.005)
    rng = np.random.default_rng(0)

    def wave(k):
        waves = [(2 * pi * f) ** k * np.sin(2 * pi * f * t + f) for f in (0.4, 0.9, 1.7)]
        return np.sum(waves, axis=0)

    q = wave(0)
    other = np.sin(2 * pi * 1.3 * t)

    def run(size):
        return Run(t, q[:, None], np.stack([-size * wave(2), other], 1))

    model, rig = run(0.2), run(0.23 * factor)
    rig.signals[:, 0] += 0.5 + 0.2 * np.std(rig.signals[:, 0]) * rng.standard_normal(len(t))
    found = followed([rig], [model], 0, 10.0)
    assert found is not None and found.ratio == pytest.approx(1.15 * factor, rel=0.05)
    assert followed([rig], [model], 1, 10.0) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("torque", "angle", "acceleration", "found"),
    [
        (1, 1, 1, []),
        (1, 1, -1, [("sign", "tip_acceleration", "scale = -1")]),
        (-1, 1, 1, [("sign", "tau", "scale = -1")]),
        (1, -1, 1, [("sign", "phi", "scale = -1")]),
        (1, 1, 1 / 9.80665, [("scale", "tip_acceleration", 'unit = "g_n"')]),
    ],
)
def test_the_sign_of_an_accelerometer_follows_from_the_joint(torque, angle, acceleration, found):
    t, u, y = link(10)
    data = jaxid.Dataset.from_arrays(
        [t, t],
        {"tau": list(torque * u)},
        {"phi": list(angle * y[:, :, 0]), "tip_acceleration": list(acceleration * y[:, :, 1])},
        units={"tip_acceleration": "m/s^2"},
        split=["fit", "fit"],
        model=ModelSpec("flexible_link"),
    )
    told = checking.run_check(None, data, free=free_motion).findings
    assert [(f.kind, f.channel, f.line) for f in told] == found
    assert all(f.applied for f in told)
