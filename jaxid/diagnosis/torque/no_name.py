"""What a law of no name depends on, where free runs name nothing that explains all: by the torque
that the measured motion needs, where free laws compete with effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from jaxid.base.errors import UsageError
from jaxid.diagnosis.belief import Belief
from jaxid.diagnosis.result import Diagnosis
from jaxid.diagnosis.torque.claims import believed
from jaxid.diagnosis.torque.found import searched
from jaxid.diagnosis.torque.study import TorqueStudy
from jaxid.dynamics.effect import Effect
from jaxid.fitting.lost_runs import by_torque
from jaxid.problem.binding import Binding


#: Verdicts that leave something open.
OPEN = ("partly", "unknown")


def with_law_of_no_name(
    found: Diagnosis, binding: Binding, kinds: Sequence[type[Effect]], most: int
) -> Diagnosis:
    """A diagnosis of free runs that says what the most probable law of no name depends on. As it
    is where nothing is left open, or torques of a `binding` without candidates cannot be compared.
    """
    if found.which.verdict not in OPEN or not by_torque(binding):
        return found
    try:
        weighed = searched(TorqueStudy(binding, kinds, None, None, False), most).weighed
    except UsageError:  # runs that are too short for a torque say nothing of one
        return found
    law = believed(weighed, ()).free_law
    if law is None:
        return found
    which = replace(found.which, belief=replace(found.which.belief or Belief({}), free_law=law))
    if law.probability >= weighed.scales.rule.sure:
        which = replace(which, text=f"{which.text} {law.sentence}")
    return replace(found, which=which)
