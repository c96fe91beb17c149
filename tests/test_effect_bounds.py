"""Bounds of effects are those of what they are called, whatever the data show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import jaxid
from jaxid.data.dataset import Experiment
from jaxid.dynamics import catalogue
from jaxid.dynamics.parameter import ANGLE, resolve, specs, SPEED, TORQUE, TypicalMagnitudes
from jaxid.models import Joint
from jaxid.problem.binding import bind


@pytest.mark.parametrize(
    "effect, field, least, most",
    [
        (
            "temperature_dependent_friction",
            "time",
            1.0,
            None,
        ),  # a winding warms in seconds, a gear in minutes
        ("lugre_friction", "presliding", None, 0.1),  # bristles give, rad or m; more is a spring
        ("lugre_friction", "relaxation", None, 0.01),
        ("sensor_lag", "lag", None, 0.1),  # a slower filter shows no motion
        ("flexible_mode", "damping_ratio", None, 0.7072),  # with more it does not swing
        ("geometric_stiffening", "share", 0.0, None),  # what softens is no stiffening
        ("actuator_curve", "low", -1.0, None),  # monotone: no slope below zero
        ("actuator_curve", "middle", -1.0, None),
        ("actuator_curve", "high", -1.0, None),
        ("power_law_friction", "coefficient", 0.0, None),  # no friction drives
        ("power_law_friction", "exponent", 0.01, 2.0),
        ("reflected_inertia", "inertia", 0.0, None),
        ("base_motion", "share", 0.0, None),
        ("step_change", "time", 0.0, 8.0),
    ],
)
@pytest.mark.parametrize("angle", [0.1, 2.0, 300.0])
def test_bounds_are_those_of_what_an_effect_is_called(effect, field, least, most, angle):
    spec = specs(catalogue.effect_class(effect))[field]
    reference = TypicalMagnitudes(torque=1.0, speed=1.0, angle=angle, duration=8.0, step=0.01)
    lower, upper = resolve(spec.lower, reference), resolve(spec.upper, reference)
    assert lower < upper
    assert least is None or lower >= least
    assert most is None or upper <= most


@pytest.mark.parametrize("effect", catalogue.effect_names())
@pytest.mark.parametrize(("duration", "step"), [(0.05, 1e-4), (8.0, 0.01), (3600.0, 0.1)])
def test_bounds_leave_room_in_short_and_long_recordings(effect, duration, step):
    reference = TypicalMagnitudes(1.0, 1.0, 1.0, duration=duration, step=step)
    for field, spec in specs(catalogue.effect_class(effect)).items():
        lower, upper = resolve(spec.lower, reference), resolve(spec.upper, reference)
        assert spec.fixed or lower < upper, field


def test_a_change_lies_within_the_time_of_all_runs():
    """On their own clock, which may begin anywhere: in the runs to fit, and in those held out."""
    t = 500.0 + 0.01 * np.arange(400)
    runs = []
    for k, split in enumerate(("fit", "validation", "report")):
        own = t + 4.0 * k
        u, q = np.cos(own)[:, None], np.sin(own)[:, None]
        runs.append(Experiment(name=f"run_{k}", split=split, t=own, u=u, y=q))
    one = jaxid.Dataset.from_arrays(t, {"tau": np.cos(t)}, {"q": np.sin(t)}, check_model=False)
    data = replace(one, experiments=tuple(runs))
    binding = bind(Joint(), data, effects=["step_change@inertia"])
    own = binding.layout.of_effect("step_change", "inertia")
    (time,) = [i for i in own if binding.layout.entries[i].field == "time"]
    assert (binding.lower[time], binding.upper[time]) == pytest.approx((500.0, 511.99))


@pytest.mark.parametrize("travel", [0.1, 2.0, 300.0])
def test_a_ripple_repeats_within_the_travel(travel):
    order = specs(catalogue.effect_class("torque_ripple"))["order"]
    reference = TypicalMagnitudes(torque=1.0, speed=1.0, angle=travel, duration=8.0, step=0.01)
    assert resolve(order.lower, reference) * travel / (2 * np.pi) > 0.999, "one period at least"


@pytest.mark.parametrize(
    "effect, other", [("actuator_lag", "filter in the sensor"), ("sensor_lag", "a drive")]
)
def test_a_lag_says_that_one_at_the_other_end_looks_alike(effect, other):
    """Where only one place of the way from command to reading is seen."""
    kind = catalogue.effect_class(effect)
    assert other in kind.check and "looks alike" in kind.check


def test_powers_of_magnitudes_are_as_in_python():
    reference = TypicalMagnitudes(torque=6.0, speed=3.0, angle=2.0, duration=8.0, step=0.01)
    assert resolve(4 * TORQUE / ANGLE**3, reference) == pytest.approx(3.0)
    assert str(TORQUE / ANGLE**3) == "1 * torque / angle^3"
    assert resolve((2 * SPEED) ** 2, reference) == 36.0
    assert resolve(SPEED**0, reference) == 1.0
