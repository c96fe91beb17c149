"""Which effects a model cannot tell apart: known identities are found, and what gravity tells apart
is not in a class.
"""

import pytest

from jaxid.diagnosis.equivalence import equivalences


@pytest.mark.timeout(600)
@pytest.mark.parametrize("model", ["joint", pytest.param("pendulum", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_classes_are_those_of_mechanics(model):
    found = equivalences(model)
    classes = {frozenset(map(str, c)) for c in found.classes}
    assert (
        frozenset({"input_delay at tau", "sensor_delay at q"}) in classes
    )  # from rest, nothing else runs on time
    # A motor with its link on a spring is a joint with a swinging mass, unless the link alone has
    # weight.
    both = frozenset({"joint_elasticity at q", "flexible_mode at q"})
    assert (both in classes) == (model == "joint")
    absorbed = {str(p) for p in found.absorbed}
    # A gain of the drive scales every other number, and the e.m.f. is viscous friction.
    assert {"torque_scale at tau", "back_emf at tau"} <= absorbed
