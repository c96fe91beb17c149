"""What a recording says about itself where a model has a drive of its own: volts, pressures."""

from __future__ import annotations

from math import pi
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from scipy.integrate import cumulative_trapezoid

import jaxid
from jaxid.benchmark.broken import recording
from jaxid.conventions import checking
from jaxid.conventions.missing_force import measured
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import constant, param
from jaxid.models.effects import CoulombFriction, ViscousFriction
from jaxid.problem.binding import bind


FRICTION = ((ViscousFriction, {"coefficient": "viscous"}), (CoulombFriction, {"level": "coulomb"}))
T = np.arange(800) / 100
SPLITS = ["fit", "fit", "validation"]


class Winch(Rigid):
    """A drum on a motor whose winding and back EMF are known."""

    name: ClassVar[str] = "winch"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("u", "V"),), (("q", "rad"),), ("q",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = FRICTION
    equations: ClassVar[str] = "inertia qdd = k (u - k qd) / R - friction"
    source: ClassVar[str] = "textbook"
    inertia: Array = param(0.01, 1e-5, 10.0, unit="kg m^2", log=True)
    k: Array = constant(0.1, unit="N m/A")
    R: Array = constant(2.0, unit="ohm")

    def drive(self, signature, u, q, qd):
        return self.k / self.R * (u - self.k * qd)

    def matrices(self, q, qd):
        return self.inertia[None, None], jnp.zeros_like(q)


class Piston(Rigid):
    """Two pressures on one piston."""

    name: ClassVar[str] = "piston"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("p_a", "Pa"), ("p_b", "Pa")), (("position", "m"),), ("position",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = FRICTION
    equations: ClassVar[str] = "mass qdd = area (p_a - p_b) - friction"
    source: ClassVar[str] = "textbook"
    mass: Array = param(1.0, 0.01, 100.0, unit="kg", log=True)
    area: Array = constant(5e-4, unit="m^2")

    def drive(self, signature, u, q, qd):
        return self.area * (u[:1] - u[1:])

    def matrices(self, q, qd):
        return self.mass[None, None], jnp.zeros_like(q)


def moved(seed: int, size: float, force) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Positions of three runs at T, and the force that each takes, as means over the steps that
    follow the samples.
    """
    rng, h = np.random.default_rng(seed), T[1]
    q, f = [], []
    for _ in SPLITS:
        w, phase, a = (
            2 * pi * rng.uniform(0.2, 1.6, 6),
            rng.uniform(0, 2 * pi, 6),
            size * rng.uniform(0.3, 1.0, 6),
        )

        def wave(t, k, w=w, p=phase, a=a):
            return (a * w**k * np.sin(w * t[:, None] + p + k * pi / 2)).sum(1)

        q.append(wave(T, 0) + 1e-4 * size * rng.standard_normal(len(T)))
        f.append(force(wave(T + h / 2, 1), wave(T + h / 2, 2)))
    return q, f


def found(model: type, u: dict[str, list[np.ndarray]], y: dict[str, list[np.ndarray]]):
    units = dict((*model.signatures[0].inputs, *model.signatures[0].outputs))
    data = jaxid.Dataset.from_arrays(
        [T[: len(x)] for x in next(iter(y.values()))],
        u,
        y,
        units=units,
        split=SPLITS,
        check_model=False,
    )
    return data, checking.run_check(model(), data).findings


def volts(seed: int):
    q, tau = moved(seed, 0.3, lambda v, a: 0.02 * a + 0.02 * v + 0.03 * np.sign(v) + 0.005 * v)
    return q, [20.0 * x for x in tau]  # 0.005 is back EMF


@pytest.mark.parametrize(
    ("broken", "kinds"), [(lambda u: u, []), (np.abs, ["unsigned"]), (lambda u: -u, ["sign"])]
)
def test_volts_without_their_sign_are_told(broken, kinds):
    q, u = volts(1)
    _, findings = found(Winch, {"u": [broken(x) for x in u]}, {"q": q})
    assert [f.kind for f in findings] == kinds


def test_a_run_is_looked_at_from_end_to_end():
    q, u = volts(1)
    data, _ = found(Winch, {"u": u}, {"q": q})
    motion = measured(bind(Winch(), data))
    assert motion is not None and motion.since.max() > 0.9 * T[-1]


def test_pressures_that_move_as_one_are_late_together():
    q, force = moved(2, 0.05, lambda v, a: 2.0 * a + 10.0 * v + 0.5 * np.sign(v))
    p_a, p_b = ([3e5 + way * x[:-1] / 1e-3 for x in force] for way in (1, -1))
    _, findings = found(Piston, {"p_a": p_a, "p_b": p_b}, {"position": [x[1:] for x in q]})
    assert [(f.kind, f.channel, f.value, f.decisive) for f in findings] == [
        ("row_shift", "p_a", 1.0, True),
        ("row_shift", "p_b", 1.0, True),
    ]


def spun(fault: str, angle: bool = False) -> jaxid.Dataset:
    """A wheel with dry and viscous friction and drag of which a tachometer is read, and an
    encoder.
    """
    t, runs = np.arange(0, 8, 0.005), []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        f, phase = rng.uniform(0.15, 2.0, 7), rng.uniform(0, 6.28, 7)

        def wave(t, f=f, p=phase):
            return 8 / np.sqrt(7) * np.sin(2 * np.pi * np.multiply.outer(t, f) + p).sum(-1)

        v = wave(t + 0.0025)  # a held input acts by its mean over the step
        a = (wave(t + 0.003) - wave(t + 0.002)) / 1e-3
        tau = 0.02 * a + 0.06 * v + 0.25 * np.tanh(v / 0.02) + 0.01 * v * np.abs(v)
        runs.append((tau, wave(t) + 0.02 * rng.standard_normal(len(t))))

    def late(x):
        return np.concatenate([x[:1], x[:1], x[:-2]])

    change = {"sign": np.negative, "row_shift": late, "unsigned": np.abs}.get(fault, lambda x: x)
    rates = [y for _, y in runs]
    turned = (
        [cumulative_trapezoid(y, t, initial=0.0) + 1e-4 * np.sin(40 * t) for y in rates]
        if angle
        else []
    )
    scale, turn = {
        "qd": (-1, 1),
        "q": (1, -1),
        "rpm": (30 / pi, 1),
        "deg": (1, 180 / pi),
        "gear": (41.5, 1),
    }.get(fault, (1, 1))
    units = {"tau": "N m", "qd": "rad/s"} | ({"q": "rad"} if angle else {})
    read = {"qd": [scale * y for y in rates]} | ({"q": [turn * x for x in turned]} if angle else {})
    return jaxid.Dataset.from_arrays(
        [t] * 3,
        {"tau": [change(u) for u, _ in runs]},
        read,
        units=units,
        split=["fit", "validation", "report"],
        model="joint",
    )


@pytest.mark.parametrize(
    ("fault", "value", "line"),
    [
        ("", None, ""),
        ("sign", -1.0, "scale = -1"),
        ("row_shift", 2.0, "shift = 2"),
        ("unsigned", None, ""),
    ],
)
def test_a_tachometer_alone_tells_what_is_wrong_with_the_torque(fault, value, line):
    found = jaxid.check(None, spun(fault)).findings
    assert [(f.kind, f.channel, f.value, f.line) for f in found] == (
        [(fault, "tau", value, line)] if fault else []
    )


@pytest.mark.parametrize(
    ("fault", "kind", "channel", "line"),
    [
        ("", "", "", ""),
        ("qd", "sign", "qd", "scale = -1"),
        ("q", "sign", "q", "scale = -1"),
        ("rpm", "scale", "qd", 'unit = "rpm"'),
        ("deg", "scale", "q", 'unit = "deg"'),
        ("gear", "scale", "qd", "scale = 0.0240946"),
    ],
)
def test_a_speed_that_is_not_the_rate_of_its_position(fault, kind, channel, line):
    """Which of the two is wrong the torque tells, or the unit; a torque of opposite sign is
    neither.
    """
    found = jaxid.check(None, spun(fault, angle=True)).findings
    told = [(f.kind, f.channel, f.line[:14], f.same_as, f.applied) for f in found]
    asked = fault == "gear"  # by a gear either of them may be meant
    assert told == (
        [(kind, channel, line[:14], (("scale", "q"),) * asked, not asked)] if kind else []
    )


@pytest.mark.parametrize("wrong", ["qd1", "q1"])
def test_speeds_of_two_joints_in_the_order_of_the_other(wrong):
    r = recording("planar_arm", 3)
    names = [n for n, _ in r.plant.outputs]
    read = dict(zip(names, np.moveaxis(r.y, 2, 0), strict=True))
    speeds = {f"qd{k + 1}": np.gradient(read[n], r.t, axis=1) for k, n in enumerate(names)}
    series = read | speeds
    pair = ("qd1", "qd2") if wrong == "qd1" else names
    series |= {pair[0]: series[pair[1]], pair[1]: series[pair[0]]}
    units = dict((*r.plant.inputs, *r.plant.outputs)) | dict.fromkeys(speeds, "rad/s")
    data = jaxid.Dataset.from_arrays(
        [r.t] * len(r.u),
        {n: list(r.u[:, :, i]) for i, (n, _) in enumerate(r.plant.inputs)},
        {n: list(y) for n, y in series.items()},
        units=units,
        split=SPLITS,
        model=r.plant.model,
    )
    told = [(f.kind, f.channel, f.same_as, f.applied) for f in jaxid.check(None, data).findings]
    assert told == [("swapped_channels", pair[0], (), True)]
