"""Probabilities of sets of effects that were simulated, and what is claimed of them."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from jaxid.diagnosis.belief import Belief, FreeLaw, joined_beliefs
from jaxid.diagnosis.goals.compared import ComparedSets
from jaxid.diagnosis.goals.search import Decider
from jaxid.diagnosis.goals.single_changes import belief_of
from jaxid.diagnosis.hypothesis import Candidate
from jaxid.diagnosis.result import Which
from jaxid.diagnosis.selection import most_probable, step_from
from jaxid.diagnosis.simulated import (
    believed,
    log_weight,
    simulated_sets,
    told_apart,
    worth,
)


ROWS = 4000
LAG = Candidate("actuator_lag", "tau", (0,))
DELAY = Candidate("input_delay", "tau", (1,))
DRAG = Candidate("quadratic_drag", "q", (2,))


def leaving(
    left: float, *effects: Candidate, held: float | None = None, departed: float = 0.0
) -> Any:
    """A set that leaves these mean squares of fit and validation runs, whose numbers depart so much
    from what is stated.
    """
    validation = left if held is None else held
    series = np.full((ROWS, 1), np.sqrt(validation))
    return SimpleNamespace(
        effects=effects,
        size=len(effects),
        departed=departed,
        fit_loss=left + departed / ROWS,
        path=SimpleNamespace(count=ROWS),
        validation=SimpleNamespace(loss=validation, count=ROWS, settled=[series]),
    )


def test_what_comes_down_to_the_noise_is_claimed_alone():
    sets = simulated_sets([leaving(90.0), leaving(1.0, LAG), leaving(40.0, DELAY)])
    claim = sets.claim(LAG, [DELAY])
    assert claim is not None and claim.probability > 0.99 and not claim.instead
    assert sets.claim(DELAY, []) is None


def test_two_that_say_the_same_are_a_family():
    sets = simulated_sets([leaving(90.0), leaving(1.0, LAG), leaving(1.0, DELAY)])
    assert sets.of(LAG) == pytest.approx(0.5, abs=0.01)
    claim = sets.claim(LAG, [DELAY])
    assert claim is not None and claim.instead == (DELAY,) and claim.probability > 0.99
    told = believed(sets, [claim], leaving(1.0, LAG)).to_dict()
    assert tuple(told["families"][0]["effects"]) == ("actuator_lag", "input_delay")
    assert sets.claim(LAG, []) is None


def test_a_small_effect_explains_more_than_the_form_of_a_large_one_is_known():
    """A law that explains nearly all of 900 times the noise is not known to a thousandth."""
    one, both = leaving(1.11, LAG), leaving(1.05, LAG, DRAG)
    assert most_probable([both, one]) is one
    far = leaving(1.9, LAG)
    assert most_probable([both, far]) is both


@pytest.mark.parametrize(("left", "held", "enough"), [(0.99, 0.96, True), (1.0, 1.05, False)])
def test_a_part_of_the_effects_is_enough_where_the_rest_is_within_the_noise(left, held, enough):
    """Dry friction came down to the noise; with Stribeck's share of 0.2 % of it the validation runs
    were 25 units better.
    """
    both, alone = leaving(0.98, LAG, DRAG, held=0.945), leaving(left, LAG, held=held)
    assert (most_probable([both, alone]) is alone) is enough


def test_what_is_stated_of_the_numbers_tells_two_that_leave_the_same_apart():
    stretched, plain = leaving(1.0, LAG, departed=20.0), leaving(1.0, DELAY)
    assert log_weight(plain) - log_weight(stretched) == pytest.approx(10.0)
    sets = simulated_sets([leaving(90.0), stretched, plain])
    assert sets.of(DELAY) > 0.99


@pytest.mark.parametrize(("left", "on"), [(99.0, False), (50.0, True)])
def test_a_search_goes_on_from_what_the_data_speak_for(left, on):
    """Half of a gap is no claim, and yet a place from where a second effect may close the rest."""
    before, half = leaving(100.0), leaving(left, DRAG)
    assert (step_from(before, [half]) is half) is on
    assert simulated_sets([before, half]).claim(DRAG, []) is None


@pytest.mark.parametrize(("left", "claimed"), [(50.0, False), (20.0, False), (2.0, True)])
def test_most_of_the_gap_has_to_go(left, claimed):
    """One law that mends a part of what another one does wrong is no more than possible."""
    sets = simulated_sets([leaving(100.0), leaving(left, DRAG)])
    assert (sets.claim(DRAG, []) is not None) is claimed


def test_more_effects_cost_more_than_chance_gives():
    one, two = leaving(1.0, LAG), leaving(0.999, LAG, DRAG)
    assert log_weight(one) > log_weight(two)
    sets = simulated_sets([leaving(90.0), one, two])
    assert sets.claim(LAG, []) is not None and sets.claim(DRAG, []) is None


def test_what_diverged_has_no_probability():
    sets = simulated_sets([leaving(90.0), leaving(float("nan"), LAG)])
    assert sets.of(LAG) == 0.0 and sets.found.none == 1.0


def test_sets_are_told_apart_by_their_probability_not_by_single_readings():
    assert told_apart(leaving(1.0, LAG), leaving(1.05, DELAY))
    assert not told_apart(leaving(1.0, LAG), leaving(1.0005, DELAY))
    assert not told_apart(leaving(50.0, LAG), leaving(60.0, DELAY))


def test_parts_of_a_machine_are_joined():
    law = FreeLaw("q2", "position", 0.97)
    one = Belief({("actuator_lag", "tau"): 0.99}, probability=0.99, none=0.01)
    other = Belief({("quadratic_drag", "q"): 0.4}, free_law=law, none=0.5)
    found = joined_beliefs([one, other])
    assert found is not None and found.free_law == law
    assert set(found.places) == {("actuator_lag", "tau"), ("quadratic_drag", "q")}
    assert (found.probability, found.none) == (0.99, 0.005)
    assert joined_beliefs([]) is None


def test_what_each_effect_is_worth():
    nominal, both = leaving(101.0), leaving(1.0, LAG, DRAG)
    alone, other = leaving(41.0, LAG), leaving(61.0, DRAG)
    found = worth([nominal, alone, other, both], both)
    lag = found["actuator_lag", "tau"]
    assert lag.alone == pytest.approx(0.6) and lag.missed_without == pytest.approx(0.6)
    drag = found["quadratic_drag", "q"]
    assert drag.alone == pytest.approx(0.4) and drag.missed_without == pytest.approx(0.4)
    assert worth([nominal], nominal) == {}


def test_where_something_is_missing_that_nothing_is_has_no_probability():
    """The sets that were compared may hold nothing that explains a gap."""
    belief = Belief({}, none=0.94)
    for verdict, expected in (("none", 0.94), ("unknown", 0.0), ("partly", 0.0)):
        which = Which(verdict, (), (), (), belief=belief)
        assert which.to_dict()["none"] == expected
    assert Which("unknown", (), (), ()).to_dict()["none"] is None


def test_what_simulations_take_back_is_no_more_probable_than_they_make_it():
    columns = Belief({("torque_scale", "tau"): 0.98, ("actuator_lag", "tau"): 0.2}, none=0.0)
    judged = {("torque_scale", "tau"): 0.1, ("actuator_lag", "tau"): 0.9, ("backlash", "q"): 0.5}
    places = {("torque_scale", "tau"): 0.1, ("actuator_lag", "tau"): 0.2}
    assert columns.at_most(judged).places == places


def test_at_the_noise_only_what_acts_in_the_place_of_what_is_named_is_left():
    """Columns of a loose arm made two loads and a lag possible that the simulation did not miss."""
    bias, tilt, load = ("sensor_bias", "j1"), ("gravity_offset", "j1"), ("payload", "j3")
    law = FreeLaw("j2", "speed", 0.4)
    columns = Belief(
        {bias: 0.501, tilt: 0.499, load: 0.31},
        probability=0.99,
        free_law=law,
        none=0.0,
        rivals={tilt: 0.498, load: 0.02},
    )
    found = columns.at_the_noise({bias}, [bias])
    assert found.places == {bias: 0.501, tilt: 0.498, load: 0.02}
    assert found.free_law is None and found.none == 0.0
    nothing = Belief({load: 0.999}, none=0.001).at_the_noise({}, [])
    assert nothing.places == {} and nothing.none == 1.0


def test_what_acts_in_the_place_of_what_is_sure_is_as_improbable_as_that_is_sure():
    """Columns of a loose arm gave a load at one link 0.99998, and 0.18 to one in its place."""
    load, instead = ("payload", "j3"), ("payload", "j2")
    columns = Belief({load: 0.99998, instead: 0.18}, 0.99998, none=0.0, rivals={instead: 0.18})
    found = columns.at_the_noise({load}, [load])
    assert found.places[instead] == pytest.approx(2e-5)


def test_what_was_asked_again_beside_more_is_told_anew():
    """Columns of a loose arm made a law possible; beside what stands a simulation gives it less."""
    bias, tilt, law = ("sensor_bias", "j1"), ("gravity_offset", "j1"), ("lugre_friction", "j3")
    before = Belief({bias: 0.501, tilt: 0.499, law: 0.81}, none=0.0, rivals={tilt: 0.498})
    ripple = ("torque_ripple", "j1")
    found = before.asked_again(Belief({law: 0.03, ripple: 0.01}), {bias})
    assert found.places == {bias: 0.501, tilt: 0.498, law: 0.03, ripple: 0.01}
    assert before.asked_again(Belief({}), {bias}).places == {bias: 0.501, tilt: 0.498}


def test_two_that_simulations_do_not_tell_apart_are_one_answer_with_one_probability(monkeypatch):
    def gained(_: Decider, before: Any, after: Any) -> float:
        return after.worth - before.worth

    monkeypatch.setattr(Decider, "gained", gained)
    tilt, bias = Candidate("gravity_offset", "j1", (0,)), Candidate("sensor_bias", "j1", (1,))
    nominal, chosen, other = (
        cast(Any, SimpleNamespace(effects=effects, worth=worth))
        for effects, worth in (((), 0.0), ((tilt,), 40.0), ((bias,), 40.0))
    )
    decider = Decider(cast(Any, None), ())
    decider.compare(chosen, [nominal, other])
    rivals = decider.rivals(chosen, [other])
    belief = Belief(decider.certain([tilt]), probability=0.5)
    told = decider.compared.with_families(belief, [tilt], rivals)
    (family,) = told.to_dict()["families"]
    assert tuple(family["effects"]) == ("gravity_offset", "sensor_bias")
    assert tuple(family["locations"]) == ("j1", "j1")
    assert family["probability"] == told.probability == pytest.approx(1.0)


def test_a_family_is_as_probable_as_that_one_of_it_is_there():
    """A load at either of two links, alone or beside a lag: what is there twice counts once."""
    load, other = Candidate("payload", "j2", (0,)), Candidate("payload", "j3", (1,))
    at, elsewhere = ("payload", "j2"), ("payload", "j3")
    weights = {
        frozenset({at}): 0.4,
        frozenset({at, elsewhere}): 0.2,
        frozenset({elsewhere}): 0.38,
        frozenset(): 0.02,
    }
    compared = ComparedSets(weights)
    (family,) = compared.with_families(Belief({at: 0.6}), [load], [other]).families
    assert family.places == (at, elsewhere) and family.probability == pytest.approx(0.98)
    assert not compared.claimed(load, [other])


def test_a_set_that_was_simulated_twice_counts_once_by_its_best():
    lag, nothing = ("actuator_lag", "tau"), frozenset()
    compared = ComparedSets.by_evidence([(nothing, 0.0), (frozenset({lag}), 0.0), (nothing, -1.0)])
    assert compared.places[lag] == pytest.approx(0.5)
    diverged = ComparedSets.by_evidence([(nothing, 0.0), (frozenset({lag}), np.nan)])
    assert diverged.places[lag] < 1e-9


def test_single_changes_that_leave_as_much_are_one_answer():
    """A delay of a goal and a lag of its drive, each alone beside the file."""
    left = {(): 900.0, (DELAY,): 1.0, (LAG,): 1.5, (DRAG,): 400.0}
    asked = [cast(Any, SimpleNamespace(effects=effects)) for effects in left]
    alone = cast(
        Any,
        SimpleNamespace(of_numbers=lambda h: not h.effects, evidence=lambda h: left[h.effects]),
    )
    belief = belief_of(alone, [asked[0], *asked[2:]], [asked[1], asked[0]])
    (family,) = belief.families
    assert family.places == (("input_delay", "tau"), ("actuator_lag", "tau"))
    assert belief.probability == family.probability == pytest.approx(1.0)
    assert belief.places["input_delay", "tau"] == pytest.approx(1 / (1 + np.exp(-0.25)))


def test_effects_of_sets_that_were_simulated_share_their_probability(monkeypatch):
    def gained(_: Decider, before: Any, after: Any) -> float:
        return after.worth - before.worth

    def found(worth: float, *effects: Candidate) -> Any:
        return SimpleNamespace(effects=effects, worth=worth)

    monkeypatch.setattr(Decider, "gained", gained)
    decider = Decider(cast(Any, None), ())
    won = found(0.0, LAG)
    both = found(-2.0, LAG, DELAY)
    decider.compare(won, [won, found(-9.0, DELAY), both, found(np.nan, DRAG)])
    odds = np.exp(-2.0) + np.exp(-9.0)
    assert decider.sure["input_delay", "tau"] == pytest.approx(odds / (1 + odds))
    assert decider.sure["actuator_lag", "tau"] == pytest.approx(1 / (1 + np.exp(-9.0)), rel=2e-5)
    assert decider.sure["quadratic_drag", "q"] < 1e-9


def test_of_two_that_leave_as_much_at_one_place_either_may_be_claimed(monkeypatch):
    """Neither has what a claim needs; one of both is there. At two places nothing is claimed."""

    def even(_: Decider, before: Any, after: Any) -> float:
        return 0.0

    monkeypatch.setattr(Decider, "gained", even)
    for other, claimed in ((DELAY, True), (DRAG, False)):
        decider = Decider(cast(Any, None), ())
        won = cast(Any, SimpleNamespace(effects=(LAG,)))
        lost = cast(Any, SimpleNamespace(effects=(other,)))
        decider.compare(won, [won, lost])
        rivals = decider.rivals(won, [won, lost])
        assert rivals == [other] and decider.sure["actuator_lag", "tau"] == pytest.approx(0.5)
        assert decider.compared.claimed(LAG, rivals) is claimed
