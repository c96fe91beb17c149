"""The budget of a gap: its steps, their shares, and the words that lead with what closes most."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from jaxid.base.serialise import finite
from jaxid.diagnosis.budget import budget
from jaxid.fitting.stated import StatedNumber
from jaxid.report.answer import headline
from jaxid.report.text import diagnosis_text
from report_sample import sample_diagnosis


def gaps(before: float, retuned: float, after: float, ceiling: float | None = None):
    how_far = sample_diagnosis(samples=400).how_far
    return replace(
        how_far, gap_before=before, gap_retuned=retuned, gap_after=after, ceiling=ceiling
    )


def test_shares_are_of_the_mean_square_above_the_noise():
    steps = {s.step: s for s in budget(gaps(129.0, 40.0, 1.4), (), "named")}
    assert list(steps) == ["stated", "numbers", "effects", "left"]
    assert steps["numbers"].closes == pytest.approx(1 - (40**2 - 1) / (129**2 - 1))
    assert steps["effects"].closes == pytest.approx(1 - (1.4**2 - 1) / (40**2 - 1))
    assert steps["left"].gap == 1.4


def test_without_an_effect_what_is_left_is_that_of_the_numbers():
    steps = {s.step: s for s in budget(gaps(20.0, 3.0, 1.0, ceiling=0.5), (), "unknown")}
    assert "effects" not in steps and steps["left"].gap == 3.0
    assert steps["any_free_law"].gap == pytest.approx((1 + 0.5 * 8) ** 0.5)
    *_, law = budget(gaps(20.0, 3.0, 1.0, ceiling=0.5), (), "unknown", law="position")
    assert law.to_dict() == {"step": "any_free_law", "gap": law.gap, "law": "position"}


@pytest.mark.parametrize("nothing", [float("nan"), float("inf")])
def test_a_gap_without_a_size_closes_nothing(nothing):
    steps = {s.step: s for s in budget(gaps(nothing, 2.0, 1.0), (), "named")}
    assert steps["numbers"].closes is None


@pytest.mark.parametrize(("retuned", "first"), [(2.0, True), (50.0, False)])
def test_numbers_that_close_most_come_first(retuned, first):
    """100 to 2 times the noise by numbers alone, before the effect; 100 to 50 is not that."""
    found = sample_diagnosis(samples=400)
    found = replace(found, how_far=gaps(100.0, retuned, 1.05))
    text = diagnosis_text(found)
    assert ("Re-tuned numbers close" in text) == first
    unknown = replace(found, which=replace(found.which, verdict="unknown", effects=()))
    assert headline(unknown).startswith("Re-tuned numbers close") == first


def test_a_gap_that_is_left_has_the_number_first_that_closed_the_rest():
    found = sample_diagnosis(samples=400)
    friction = StatedNumber(
        joint="shoulder",
        link="",
        parameter="frictionloss",
        stated=0.3,
        fitted=1.977,
        std=0.004,
        deviation=400.0,
        text="",
        unit="N m",
    )
    which = replace(found.which, verdict="unknown", effects=())
    final = replace(found.final, stated=(friction,))
    told = headline(replace(found, which=which, final=final, how_far=gaps(100.0, 1.12, 1.12)))
    assert told.startswith("With the shoulder's dry friction at 1.98 N m, not 0.3, ")
    assert told.endswith("What is left then no known effect explains.")


def test_the_json_holds_the_steps():
    content = json.loads(json.dumps(finite(sample_diagnosis(samples=400).to_dict())))
    steps = content["how_far"]["budget"]
    assert [s["step"] for s in steps][:2] == ["stated", "numbers"]
    assert set(steps[-1]["rms"]) == set(content["how_far"]["per_channel"])
