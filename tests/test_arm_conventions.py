"""What a recording of an arm says about itself: one channel of a twin broken, with and without an
effect that the model lacks.
"""

from __future__ import annotations

from functools import cache
from math import pi
from typing import Any

import numpy as np
import pytest

import jaxid
from jaxid.conventions import checking
from jaxid.conventions.mending import mended, Mending
from jaxid.fitters.short_fit import left_by_short_fit
from jaxid.models import Panda, SerialArm, UR10e
from test_serial_arm import table_of
from test_torque_diagnosis import at, recorded, run, THREE, wrist


EFFECTS = {
    "": None,
    "drag": at(1, lambda q, v, r: 0.8 * np.abs(v) * v),
    "load": at(1, lambda q, v, r: 0.15 * np.abs(r) * np.tanh(v / 0.003)),
    "ripple": at(1, lambda q, v, r: 2.0 * np.sin(8 * q)),
    "spring": at(1, lambda q, v, r: 1.5 * q),
    "wrist": wrist,
}
ARMS = {
    "three": lambda: SerialArm(THREE),
    "six": UR10e,
    "seven": lambda: SerialArm(table_of(Panda())),
}


@cache
def arm(name: str) -> Any:
    return ARMS[name]()


@cache
def sound(name: str, effect: str = "") -> jaxid.Dataset:
    return recorded([run(arm(name), s, more=EFFECTS[effect]) for s in (1, 2, 3)])


def findings(name: str, effect: str, fault: Mending) -> list[Any]:
    return list(
        checking.run_check(
            arm(name), mended(sound(name, effect), fault), gap=left_by_short_fit
        ).findings
    )


def scaled(channel: str, factor: float) -> Mending:
    return Mending({channel: {"scale": factor}})


@pytest.mark.parametrize("effect", ["", "drag"])
@pytest.mark.parametrize(
    ("name", "kind", "channel", "fault", "line"),
    [
        pytest.param(
            "seven", "sign", "tau2", scaled("tau2", -1.0), "scale = -1", marks=pytest.mark.slow
        ),
        pytest.param(
            "seven", "sign", "q3", scaled("q3", -1.0), "scale = -1", marks=pytest.mark.slow
        ),
        pytest.param(
            "seven",
            "zero",
            "q4",
            Mending({"q4": {"offset": 1.5708}}),
            "offset = -1.5708",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "seven", "scale", "q2", scaled("q2", 180 / pi), 'unit = "deg"', marks=pytest.mark.slow
        ),
        ("seven", "scale", "tau3", scaled("tau3", 1000.0), 'unit = "mN m"'),
        ("three", "sign", "tau1", scaled("tau1", -1.0), "scale = -1"),
        ("three", "scale", "q1", scaled("q1", 180 / pi), 'unit = "deg"'),
        (
            "three",
            "swapped_channels",
            "tau2",
            Mending(exchanged=(("tau2", "tau3"),)),
            'column = "tau3"  # of tau2',
        ),
    ],
)
def test_a_broken_channel_of_an_arm_is_found(name, kind, channel, fault, line, effect):
    (finding,) = findings(name, effect, fault)
    assert (finding.kind, finding.channel, finding.decisive) == (kind, channel, True)
    assert finding.line.startswith(line)


#: Six joints are between three and seven: `make test-all` takes them too.
EACH_ARM = ["three", pytest.param("six", marks=pytest.mark.slow), "seven"]


@pytest.mark.parametrize("effect", EFFECTS)
@pytest.mark.parametrize("name", EACH_ARM)
def test_nothing_is_claimed_of_an_arm_that_lacks_an_effect(name, effect):
    assert not findings(name, effect, Mending())


def test_what_the_numbers_of_a_model_take_in_is_no_finding():
    """The zero of a base joint turns nothing, and the scale of a light last joint's torque is that
    of its friction.
    """
    assert not findings("seven", "", Mending({"q1": {"offset": 1.5708}}))
    assert not [f for f in findings("three", "", scaled("tau3", 1000.0)) if f.decisive]
