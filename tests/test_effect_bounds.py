"""Bounds of effects are those of what they are called, whatever the data show."""

from __future__ import annotations

import numpy as np
import pytest

from jaxid import catalogue
from jaxid.dynamics.parameter import ANGLE, Reference, resolve, specs, SPEED, TORQUE


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
    ],
)
@pytest.mark.parametrize("angle", [0.1, 2.0, 300.0])
def test_bounds_are_those_of_what_an_effect_is_called(effect, field, least, most, angle):
    spec = specs(catalogue.effect_class(effect))[field]
    reference = Reference(torque=1.0, speed=1.0, angle=angle, duration=8.0, step=0.01)
    lower, upper = resolve(spec.lower, reference), resolve(spec.upper, reference)
    assert lower < upper
    assert least is None or lower >= least
    assert most is None or upper <= most


@pytest.mark.parametrize("travel", [0.1, 2.0, 300.0])
def test_a_ripple_repeats_within_the_travel(travel):
    order = specs(catalogue.effect_class("torque_ripple"))["order"]
    reference = Reference(torque=1.0, speed=1.0, angle=travel, duration=8.0, step=0.01)
    assert resolve(order.lower, reference) * travel / (2 * np.pi) > 0.999, "one period at least"


def test_powers_of_magnitudes_are_as_in_python():
    reference = Reference(torque=6.0, speed=3.0, angle=2.0, duration=8.0, step=0.01)
    assert resolve(4 * TORQUE / ANGLE**3, reference) == pytest.approx(3.0)
    assert str(TORQUE / ANGLE**3) == "1 * torque / angle^3"
    assert resolve((2 * SPEED) ** 2, reference) == 36.0
    assert resolve(SPEED**0, reference) == 1.0
