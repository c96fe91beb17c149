"""What several places share is said once, what they do not share is said of each."""

from dataclasses import replace

import pytest

from jaxid.diagnosis.alike import alike
from jaxid.diagnosis.result import Finding, Which
from jaxid.fitting.result import EffectEstimate, Estimate
from jaxid.report import effect_text


def late(place: str, delay: float, std: float | None = 0.4e-3) -> EffectEstimate:
    number = Estimate(value=delay, std=std, unit="s", lower=0.0, upper=0.1)
    return EffectEstimate("input_delay", place, {"delay": number})


JOINTS = [f"q{k}_cmd" for k in range(1, 13)]
ALIKE = tuple(late(place, 11.8e-3 + 0.2e-3 * (-1) ** k) for k, place in enumerate(JOINTS))


def test_one_delay_of_twelve_joints_is_said_once():
    (group,) = alike(ALIKE)
    delay = group.common.parameters["delay"]
    assert group.locations == tuple(JOINTS)
    assert delay.value == pytest.approx(11.8e-3)
    assert delay.std == pytest.approx(0.4e-3 / 12**0.5)
    (said,) = effect_text.meaning(Which("named", ALIKE, (), ()))
    assert said.startswith("All 12 places alike: Commands take effect 0.0118")


@pytest.mark.parametrize("other", [late("q2_cmd", 20e-3), late("q2_cmd", 11.9e-3, std=None)])
def test_what_differs_or_is_not_known_is_said_of_each_place(other):
    groups = alike((late("q1_cmd", 11.8e-3), other))
    assert [g.locations for g in groups] == [("q1_cmd",), ("q2_cmd",)]


def test_each_effect_names_all_places_that_are_like_it():
    told = Which("named", (*ALIKE, late("tau", 0.05)), (), ()).to_dict()["effects"]
    assert [e["locations"] for e in told] == [[e.location] for e in (*ALIKE, late("tau", 0.05))]
    told = Which("named", ALIKE, (), ()).to_dict()["effects"]
    assert all(e["locations"] == JOINTS for e in told)
    assert [e["location"] for e in told] == JOINTS


def test_the_keys_of_probabilities_are_always_there():
    told = Which("named", ALIKE[:1], (), ()).to_dict()
    assert {"probability", "families", "free_law", "none"} <= set(told)
    one = {"locations", "probability", "alone", "missed_without", "missed_interval_95"}
    assert one <= set(told["effects"][0])


def test_a_finding_says_what_is_missing_in_which_direction():
    found = Finding("q", "q", "forward", (0.0, 1.0), 0.5, 3.0, "", direction="forward")
    told = replace(found, value=12.0, unit="N").to_dict()
    assert (told["direction"], told["value"], told["unit"]) == ("forward", 12.0, "N")
