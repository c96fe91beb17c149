"""The effects of last resort: an actuator's curve and a number that changes, against SciPy, and in
fits and diagnoses.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxid
from jaxid.diagnosis.last_resort import asked_last, first_asked
from jaxid.dynamics.chain import Chain
from jaxid.models import Joint, Pendulum, Tracker
from jaxid.models.effects import ActuatorCurve, StepChange
from jaxid.numerics.precision import float64
from simulated import relative, Simulator


T = np.arange(2001) * 1e-3
U = (0.8 * np.sin(2 * np.pi * 1.1 * T) + 0.4 * np.sin(2 * np.pi * 2.7 * T))[:, None]


def chain_of(effect) -> Chain:
    return Chain(Pendulum()).without("coulomb_friction").with_effects(effect)


def swing(t: np.ndarray, u: np.ndarray, inertia, drive) -> np.ndarray:
    """q [time] of a pendulum with these laws of time and command, the command held between
    samples.
    """
    x, out = np.zeros(2), []
    for k in range(len(t)):
        out.append(x[0])
        step = t[min(k + 1, len(t) - 1)] - t[k]
        if step:

            def field(s, x, k=k):
                return [
                    x[1],
                    (drive(u[k]) - 0.9 * np.sin(x[0]) - 0.05 * x[1]) / inertia(s),
                ]

            x = solve_ivp(field, (t[k], t[k] + step), x, "RK45", rtol=1e-9, atol=1e-12).y[:, -1]
    return np.array(out)


NUMBERS = {"inertia": 0.06, "gravity_torque": 0.9, "viscous": 0.05, "offset": 0.0}


@pytest.mark.parametrize("effect", [ActuatorCurve, StepChange])
def test_zero_strength_is_the_identity(effect):
    plain = Simulator(Chain(Pendulum()).without("coulomb_friction"), T[:400], U[:400])
    other = Simulator(chain_of(effect()), T[:400], U[:400])
    assert np.array_equal(plain.outputs([NUMBERS]), other.outputs([NUMBERS]))
    moved = (
        {"actuator_curve.reach@tau": 0.7}
        if effect is ActuatorCurve
        else {"step_change.time@inertia": 0.2}
    )
    assert np.array_equal(plain.outputs([NUMBERS]), other.outputs([NUMBERS | moved]))


def test_a_curve_is_that_of_interpolation():
    low, middle, high, reach = 0.2, -0.4, -0.8, 0.9
    k = reach / 3
    knots = (
        np.array([0, k, 2 * k, 9]),
        np.cumsum([0, k * (1 + low), k * (1 + middle), (9 - 2 * k) * (1 + high)]),
    )

    def law(u):
        return float(np.sign(u) * np.interp(abs(u), *knots))

    grid = np.linspace(-2, 2, 101)
    own: Any = {"low": low, "middle": middle, "high": high, "reach": reach}
    with float64():
        made = np.asarray(ActuatorCurve(**own).bent(grid))  # type: ignore[arg-type]
    np.testing.assert_allclose(made, [law(u) for u in grid], atol=1e-14)
    assert np.all(np.diff(made) >= 0)  # monotone within its bounds
    sim = Simulator(chain_of(ActuatorCurve()), T[:800], U[:800])
    q = sim.outputs([NUMBERS | {f"actuator_curve.{n}@tau": v for n, v in own.items()}])[0, :, 0]
    assert relative(q, swing(T[:800], U[:800, 0], lambda t: 0.06, law)) < 2e-5


@pytest.mark.parametrize("at", [0.3, 0.3004])
def test_a_number_changes_where_it_says(at):
    sim = Simulator(chain_of(StepChange()), T[:800], U[:800])
    q = sim.outputs([NUMBERS | {"step_change.size@inertia": 0.05, "step_change.time@inertia": at}])[
        0, :, 0
    ]
    truth = swing(T[:800], U[:800, 0], lambda t: 0.06 if t < at else 0.11, lambda u: u)
    assert relative(q, truth) < 3e-4
    assert relative(q, swing(T[:800], U[:800, 0], lambda t: 0.06, lambda u: u)) > 0.01


def test_the_moment_has_a_derivative():
    sim = Simulator(chain_of(StepChange()), T[:500], U[:500])
    at = NUMBERS | {"step_change.size@inertia": 0.05, "step_change.time@inertia": 0.3004}
    y, slopes = sim.tangents(sim.theta(at))
    i = sim.layout.index("step_change.time@inertia")
    later, sooner = (
        sim.outputs([at | {"step_change.time@inertia": 0.3004 + d}])[0] for d in (1e-4, -1e-4)
    )
    difference = (later - sooner) / 2e-4
    assert np.abs(difference).max() > 0.1 and relative(slopes[i], difference) < 0.02


def test_places_are_the_numbers_of_the_model():
    assert Chain(Joint()).places(StepChange) == ("inertia", "viscous", "coulomb", "offset")
    assert set(Chain(Tracker()).places(StepChange)) == {"J_theta", "J_alpha", "b_theta", "b_alpha"}
    assert Chain(jaxid.models.FlexibleLink()).places(StepChange) == ()


@dataclass(frozen=True)
class Answer:
    """As much of a diagnosis as the question needs."""

    verdict: str
    names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def which(self):
        return SimpleNamespace(
            verdict=self.verdict, effects=[SimpleNamespace(effect=n) for n in self.names]
        )

    how_far = SimpleNamespace(gap_after=7.0)


@pytest.mark.parametrize(
    ("first", "again", "taken"),
    [
        (Answer("named", ("dead_zone",)), None, False),
        (Answer("none"), None, False),
        (Answer("unknown"), Answer("named", ("step_change",)), True),
        (Answer("unknown"), Answer("partly", ("actuator_curve",)), True),
        (Answer("unknown"), Answer("none"), False),
        (Answer("partly", ("backlash",)), Answer("named", ("backlash", "actuator_curve")), True),
        (Answer("partly", ("backlash",)), Answer("named", ("backlash",)), False),
        (Answer("partly", ("backlash",)), Answer("partly", ("step_change",)), False),
        (Answer("unknown"), Answer("named", ("torque_scale",)), True),  # which the curve comprises
        (
            Answer("partly", ("saturation",)),
            Answer("named", ("saturation",)),
            False,
        ),  # only as others were not asked
    ],
)
def test_they_are_asked_last(first, again, taken):
    asked = []

    def ask(names):
        asked.append(names)
        return again

    found: Any = asked_last(first, Chain(Pendulum()), "output_error", ask)  # type: ignore[arg-type]
    late = ("actuator_curve", "step_change")
    simpler = tuple(n for n in ("torque_scale", "dead_zone", "saturation") if n not in first.names)
    assert asked == ([] if again is None else [(*first.names, *late, *simpler)])
    expected: Any = again if taken else first
    assert found.which.verdict == expected.verdict and bool(found.notes) == taken
    assert not {"actuator_curve", "step_change"} & set(first_asked())


def lost(seed: int) -> jaxid.Dataset:
    """A joint that loses 40 % of its inertia half-way, three runs."""
    rng, t = np.random.default_rng(seed), np.arange(1600) * 5e-3
    runs, inputs = [], []
    for _ in range(3):
        u: Any = sum(
            a * np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for a, f in ((0.5, 0.6), (0.4, 1.7))
        )
        x, out = np.zeros(2), []
        for k in range(len(t)):
            out.append(x[0])
            for j in range(5):
                J = 0.1 if t[k] + j * 1e-3 < 3.6 else 0.06
                x = x + 1e-3 * np.array([x[1], (u[k] - 0.3 * x[1]) / J])
        runs.append(np.array(out) + 1e-3 * rng.standard_normal(len(t)))
        inputs.append(u)
    return jaxid.Dataset.from_arrays(
        [t] * 3,
        inputs={"tau": inputs},
        outputs={"q": runs},
        units={"tau": "N m", "q": "rad"},
        noise_std={"q": 1e-3},
        split=["fit", "validation", "report"],
        at_rest=True,
        model="joint",
    )


def test_a_lost_load_is_named_with_its_moment():
    found = jaxid.diagnose(None, lost(0), effects=["step_change", "quadratic_drag"])
    named = [(e.effect, e.location) for e in found.which.effects]
    assert found.which.verdict == "named" and named == [("step_change", "inertia")]
    numbers = found.which.effects[0].parameters
    assert abs(numbers["time"].value - 3.6) < 0.2
    assert abs(numbers["size"].value + 0.04) < 4 * max(numbers["size"].std or 0.0, 1e-3)
