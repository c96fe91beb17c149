"""How the code is written, held by counts that may only fall; tests/measure_house.py prints them."""

from __future__ import annotations

import pytest

import measure_house


#: The most that each may be. Lower a number when the code has become better; never raise one.
LIMITS = {
    measure_house.DENSITY: 22.7,
    "fmt: skip": 14,
    "lines over 100 columns": 96,
    "thresholds without a recorded case": 0,
    "functions of more than 15 decisions": 7,
    "calls with 8 or more positional arguments": 5,
    "comprehensions with a loop or choice inside": 41,
    "named lambdas": 3,
    "class names in two or more modules": 0,
    "effect ids quoted": 3,
}
#: Texts of the core that are also ids of effects, and what they are there.
QUOTED = {
    "payload": "a key of an identification's result: the load by difference",
    "saturation": "a key of [controller]: the limit of a law",
    "viscous_friction": "a field of Isaac Lab's actuators",
}


@pytest.fixture(scope="module")
def found() -> dict[str, float]:
    return measure_house.figures()


@pytest.mark.parametrize("name", LIMITS)
def test_what_makes_code_hard_to_read_only_falls(found, name):
    assert found[name] <= LIMITS[name], (
        f"{name}: {found[name]}, at most {LIMITS[name]} before this change"
    )


def test_an_effect_is_asked_and_not_named():
    """What is to be known of an effect stands in its own class."""
    assert measure_house.quoted_ids() == set(QUOTED)


def test_a_function_full_of_choices_is_counted():
    dense = "def f(a):\n    return [x if x else 1 for x in a if x and a or x]\n"
    counts = dict(measure_house._of_node(measure_house.ast.parse(dense).body[0]))
    assert counts["decisions"] == 4
    assert counts["function lines"] == 2
