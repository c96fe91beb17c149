"""Probabilities of sets of effects: what must hold of them whatever the data are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jaxid.diagnosis.probability import (
    EvidenceRule,
    log_evidence,
    log_prior,
    normalised,
    Probabilities,
    RULE,
    SetMember,
)
from jaxid.diagnosis.torque.algebra import ColumnPrior
from jaxid.diagnosis.torque.claims import claims, in_place_of
from jaxid.diagnosis.torque.held_out import cut, HeldOutRows, JudgedRun
from jaxid.diagnosis.torque.library import Unit
from jaxid.diagnosis.torque.weigh import Scales, weigh


SAMPLES, JOINTS = 240, 2


def unit(effect: str, joint: int, numbers: int = 1, signed: bool = False) -> Unit:
    open_ = np.full(numbers, np.inf)
    return Unit(
        effect=effect,
        location=f"q{joint + 1}",
        fields=tuple(f"number_{k}" for k in range(numbers)),
        least=np.zeros(numbers) if signed else -open_,
        most=open_,
        spread=open_,
        shape={},
        joints=(joint,),
        columns=[],
    )


UNITS = [
    unit("spring", 0),
    unit("drag", 0, signed=True),
    unit("ripple", 0, numbers=2),
    unit("spring", 1),
    unit("any_force_over_position", 1, numbers=3),
]


def columns_of(rng: np.random.Generator) -> np.ndarray:
    """[samples joints 2 + p]: two columns that every set has, and those of the units."""
    count = 2 + sum(len(u.fields) for u in UNITS)
    x = np.zeros((SAMPLES, JOINTS, count))
    x[:, :, :2] = rng.standard_normal((SAMPLES, JOINTS, 2))
    first = 2
    for u in UNITS:
        own = slice(first, first + len(u.fields))
        x[:, u.joints[0], own] = rng.standard_normal((SAMPLES, len(u.fields)))
        first = own.stop
    return x


def scales(
    numbers: dict[int, float],
    seed: int = 0,
    noise: float = 1.0,
    by: np.ndarray | float = 1.0,
    gone: tuple[int, ...] = (),
) -> Scales:
    """Two runs with some columns in them; all columns times `by`, those of `gone` nothing."""
    rng = np.random.default_rng(seed)
    runs, p = [], 0
    for _ in range(2):
        x = columns_of(rng)
        p = x.shape[2]
        x[:, :, list(gone)] = 0.0
        theta = np.zeros(x.shape[2])
        theta[:2] = (3.0, -2.0)
        for column, value in numbers.items():
            theta[column] = value
        target = x @ theta + rng.standard_normal((SAMPLES, JOINTS))
        rows = np.concatenate([x * by, target[:, :, None]], axis=2) * noise
        ones = np.full((SAMPLES, JOINTS), noise)
        runs.append(JudgedRun(rows, 1 / ones, ones, np.ones(JOINTS, bool)))
    return Scales(HeldOutRows(runs, ColumnPrior(np.zeros((p, p)), np.zeros(p)), 4.0), UNITS, 2)


def test_probabilities_sum_to_one_and_lie_between_nothing_and_all():
    found = weigh(scales({2: 0.3, 7: 0.2}))
    for asked in found.asked:
        assert asked.found.weights.sum() == pytest.approx(1.0)
        assert np.all(asked.found.weights >= 0)
    assert all(0.0 <= p <= 1.0 for p in found.places.values())
    whole = found.asked[0].found
    assert whole.none + whole.of(lambda u: True) == pytest.approx(1.0)


def test_what_is_there_is_found_and_nothing_else():
    found = weigh(scales({2: 1.0, 6: -0.8}))
    assert {UNITS[c.unit].place for c in claims(found)} == {("spring", "q1"), ("spring", "q2")}
    assert not claims(weigh(scales({})))
    assert weigh(scales({})).asked[0].found.none > 0.9


def test_a_law_that_would_act_the_wrong_way_round_is_not_asked():
    there = weigh(scales({3: 1.0}))
    assert there.places[("drag", "q1")] > 0.99
    assert ("drag", "q1") not in weigh(scales({3: -1.0})).places


def test_a_free_law_is_not_named():
    found = weigh(scales({7: 1.0, 8: -1.0, 9: 0.7}))
    assert found.places[("any_force_over_position", "q2")] > 0.99
    assert not claims(found)


@pytest.mark.parametrize("seed", range(3))
def test_units_of_columns_and_of_the_target_change_nothing(seed):
    numbers = {2: 0.25, 4: 0.15}
    by = np.exp(np.random.default_rng(seed).uniform(-6, 6, 2 + sum(len(u.fields) for u in UNITS)))
    plain, other = weigh(scales(numbers, seed)), weigh(scales(numbers, seed, 1e3, by))
    assert plain.best == other.best
    for place, p in plain.places.items():
        assert other.places[place] == pytest.approx(p, abs=1e-4)


def test_a_column_of_nothing_changes_nothing():
    numbers = {2: 0.25}
    gone = weigh(scales(numbers, gone=(6,)))
    assert ("spring", "q2") not in gone.places
    assert gone.places[("spring", "q1")] == pytest.approx(
        weigh(scales(numbers)).places[("spring", "q1")], abs=0.02
    )


def test_what_is_no_number_has_no_probability():
    left = np.array([[10.0], [np.nan], [np.inf]])
    assert log_evidence(left, np.array([10.0]), 16.0)[:, 0].tolist() == [0.0, -np.inf, -np.inf]
    assert normalised(np.array([0.0, np.nan, -np.inf])).tolist() == [1.0, 0.0, 0.0]
    assert normalised(np.array([np.nan, np.nan])).tolist() == [1.0, 0.0]


def test_far_above_the_noise_only_the_share_that_is_closed_counts():
    rows = np.array([100.0])
    near = log_evidence(np.array([[1e5], [0.5e5]]), rows, 16.0)
    far = log_evidence(np.array([[1e9], [0.5e9]]), rows, 16.0)
    assert far[1] - far[0] == pytest.approx(8 * np.log(2), rel=1e-3)
    assert near[1] - near[0] == pytest.approx(far[1] - far[0], rel=1e-2)
    # Just above the noise it is the likelihood, and below it nothing is left to explain.
    step = 1e-4
    below, above = log_evidence(np.array([[100 - step], [100 + step]]), rows, 16.0)
    assert below == 0 and above == pytest.approx(-step / 2, rel=1e-3)


def test_shapes_of_an_effect_share_its_prior():
    one = [SetMember("drag", "q1", 1)]
    several = [SetMember("drag", "q1", 1, shapes=4)] * 4
    rule = EvidenceRule()
    whole = np.exp(log_prior([(k,) for k in range(4)], several, rule)).sum()
    assert whole == pytest.approx(np.exp(log_prior([(0,)], one, rule))[0])


def test_sums_over_sets():
    units = (SetMember("a", "q1", 1), SetMember("b", "q1", 1), SetMember("a", "q2", 1))
    found = Probabilities(units, ((), (0,), (0, 2), (1,)), np.array([0.1, 0.4, 0.3, 0.2]))
    assert found.best == (0,) and found.none == pytest.approx(0.1)
    assert found.places == pytest.approx({("a", "q1"): 0.7, ("a", "q2"): 0.3, ("b", "q1"): 0.2})
    assert found.of(lambda u: u.place == "q1") == pytest.approx(0.9)


def test_held_out_blocks_are_predicted_from_the_others():
    """By algebra and by least squares of the rows themselves."""
    asked = scales({2: 0.3})
    data = asked.data
    found = data.beside(np.arange(2), np.array([2, 3])).left(np.array([[0, 1]]))[0]
    rng = np.random.default_rng(0)
    runs = []
    for _ in range(2):
        x = columns_of(rng)
        theta = np.zeros(x.shape[2])
        theta[:3] = (3.0, -2.0, 0.3)
        runs.append((x[:, :, :4], x @ theta + rng.standard_normal((SAMPLES, JOINTS))))
    blocks = cut([SAMPLES, SAMPLES], 4.0)
    left = np.zeros(JOINTS)
    for fold in range(data.folds):
        kept = [b for i, b in enumerate(blocks) if i % data.folds != fold]
        A = np.concatenate([runs[k][0][s].reshape(-1, 4) for k, s in kept])
        b = np.concatenate([runs[k][1][s].ravel() for k, s in kept])
        theta = np.linalg.lstsq(A, b, rcond=None)[0]
        for k, s in blocks[fold :: data.folds]:
            left += np.sum((runs[k][1][s] - runs[k][0][s] @ theta) ** 2, axis=0)
    assert found == pytest.approx(left / 2, rel=1e-5)


def test_what_is_known_beforehand_costs():
    asked = scales({2: 0.3})
    p = asked.data.size
    information, mean = np.zeros((p, p)), np.zeros(p)
    information[0, 0], mean[0] = 1e4, 3.5  # it is 3
    asked.data.known = ColumnPrior(information, mean)
    cost = asked.data.beside(np.arange(2), np.array([2])).costs(np.array([[0]]))[0]
    rows = 2 * SAMPLES * JOINTS
    between = 0.5 * rows / (rows + information[0, 0])  # what the data draw it away by
    assert cost == pytest.approx(information[0, 0] * between**2, rel=0.3)


@pytest.mark.parametrize("lengths", [[5], [1000], [300, 20, 700]])
def test_blocks_hold_every_sample_once(lengths):
    blocks = cut(lengths, 12.0)
    for run, count in enumerate(lengths):
        own = np.concatenate([s for k, s in blocks if k == run])
        assert sorted(own) == list(range(count))


def test_of_too_many_kinds_the_one_goes_that_is_missed_least():
    found = weigh(scales({2: 2.0, 3: 0.7, 6: -1.5}))

    def kinds(most):
        return {UNITS[c.unit].effect for c in claims(found, most)}

    assert kinds(2) == {"spring", "drag"} and kinds(1) == {"spring"}


def alike_elsewhere(seed: int = 0) -> Scales:
    """Three joints; of three units at the first one two are the same column, of which one counts as
    acting there alone and one as acting at all joints.
    """
    rng, joints = np.random.default_rng(seed), 3
    bias = unit("bias", 0)
    tilt = replace(unit("tilt", 0), joints=(0, 1, 2))
    units, runs = [bias, tilt, unit("drag", 0)], []
    for _ in range(2):
        x = rng.standard_normal((SAMPLES, joints, 4))
        x[:, :, 2] = x[:, :, 1]
        x[:, 1:, 3] = 0.0
        target = x @ np.array([3.0, 1.5, 0.0, 0.0]) + rng.standard_normal((SAMPLES, joints))
        ones = np.ones((SAMPLES, joints))
        rows = np.concatenate([x, target[:, :, None]], axis=2)
        runs.append(JudgedRun(rows, ones, ones, np.ones(joints, bool)))
    nothing = ColumnPrior(np.zeros((4, 4)), np.zeros(4))
    return Scales(HeldOutRows(runs, nothing, 4.0), units, 1)


def test_what_says_the_same_at_a_place_is_one_family_whoever_was_asked_with_it():
    found = weigh(alike_elsewhere())
    units = found.scales.units
    assert found.places["bias", "q1"] == pytest.approx(0.5, abs=0.1)
    (claim,) = claims(found)
    assert {units[u].effect for u in (claim.unit, *claim.instead)} == {"bias", "tilt"}
    assert claim.together >= RULE.sure > claim.probability


def test_what_may_act_in_the_place_of_an_effect_is_what_looks_the_same():
    found = weigh(alike_elsewhere())
    (claim,) = claims(found)
    instead = in_place_of(found, [claim.unit])
    own, other = sorted([("bias", "q1"), ("tilt", "q1")], key=lambda p: p in instead)
    assert found.scales.units[claim.unit].place == own
    assert instead[other] == pytest.approx(0.5, abs=0.1)
    assert instead.get(("drag", "q1"), 0.0) < 0.05


def test_what_acts_beside_is_in_nobodys_place():
    """Both act: neither may be there instead of the other one."""
    found = weigh(scales({2: 1.0, 3: 1.0}))
    spring = next(u for u in found.best if UNITS[u].effect == "spring")
    assert found.places["drag", "q1"] > 0.99
    assert in_place_of(found, [spring]).get(("drag", "q1"), 0.0) < 0.01
