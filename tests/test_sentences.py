"""No sentence against a number of the same result: over random searches, report data and
results.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from hypothesis import given, settings, strategies as st
from pytest import MonkeyPatch

from jaxid.base import wording
from jaxid.base.serialise import finite
from jaxid.diagnosis.breakdown import Share
from jaxid.diagnosis.evidence import HeldOut
from jaxid.diagnosis.hypothesis import Hypothesis, SearchResult
from jaxid.diagnosis.next_experiment import advice
from jaxid.diagnosis.reasons import FollowsFitRuns, Lacks, LacksInPart, Remark, ReportNotReached
from jaxid.diagnosis.result import ChannelGap, Finding, HowFar, Ranked, Which
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.diagnosis.torque import judge as judge_by_torque
from jaxid.diagnosis.verdict import astray, Gaps, judge, level, upheld, Verdict
from jaxid.fitting.result import EffectEstimate, Estimate
from jaxid.fitting.stated import sentence_of, StatedNumber
from jaxid.report import answer, effect_text, identified, text
from jaxid.report.display import write
from report_sample import sample_diagnosis, sample_fit


many = settings(max_examples=150, deadline=None)
losses = st.one_of(st.floats(0.3, 4.0), st.floats(0.0, 300.0).map(lambda x: 10.0**x))
gaps = st.one_of(st.floats(0.3, 3.0), st.floats(-1.0, 150.0).map(lambda x: 10.0**x))
SAMPLE = sample_diagnosis(samples=200)


def hypothesis(fit_loss: float, loss: float, *effects: str) -> Any:
    """What a verdict sees of a hypothesis that leaves these mean squares of fit and validation
    runs.
    """
    path: Any = SimpleNamespace(loss=fit_loss, count=4000)
    return Hypothesis(cast(Any, effects), np.zeros(0), path, HeldOut([], [], loss, 4000))


def check_numbers(words: str) -> None:
    """Shares of 0 to 100 %, and nothing with more digits than a person reads."""
    assert "nan" not in words.lower().split() and "inf" not in words.lower().split()
    for share in re.findall(r"(?<!below −)([-−]?[\d.]+(?:e[+-]?\d+)?) %", words):
        assert 0.0 <= float(share.replace("−", "-")) <= 100.0, words
    assert not re.search(r"\d{8,}", words), words


@many
@given(
    losses, losses, losses, losses, st.lists(st.tuples(losses, losses), max_size=3), st.booleans()
)
def test_verdicts_by_fit_and_validation_data(fit0, loss0, fit1, loss1, others, several):
    nominal, chosen = hypothesis(fit0, loss0), hypothesis(fit1, loss1, "drag at q")
    tried = [hypothesis(a, b, f"effect {k} at q") for k, (a, b) in enumerate(others)]
    for search in (
        SearchResult(nominal, nominal, tried),
        SearchResult(nominal, chosen, [chosen, *tried], several=several),
    ):
        judged = judge(search)
        verdict, words = judged.name, judged.text
        check_numbers(words)
        left, before = search.chosen.validation.loss, nominal.validation.loss
        share = 1 - (left - 1) / (before - 1) if before > 1 else 0.0
        if verdict == "none":
            assert max(fit0, loss0) <= level(4000)
        elif verdict == "named":
            assert left <= level(4000) or share >= LIMITS.named
        elif verdict == "partly":
            assert share > 0 or fit1 <= level(4000) < fit0
        best = min((h.validation.loss for h in search.tried), default=np.inf)
        if verdict == "unknown" and best < min(
            left, before
        ):  # the ranking's first is not passed over in silence
            assert "On validation data alone" in words


@many
@given(st.sampled_from(["named", "partly"]), gaps, gaps, gaps, st.booleans())
def test_verdicts_hold_on_report_data(verdict, before, retuned, after, several):
    held = upheld(
        Verdict(verdict, (Remark("The model lacks drag."),)), Gaps(before, retuned, after), several
    )
    found, words = held.name, held.text
    check_numbers(words)
    if found in ("named", "partly"):
        at_noise = retuned <= LIMITS.near and after**2 <= LIMITS.alike * max(
            LIMITS.alike, retuned**2
        )
        assert after < min(before, retuned) or at_noise
    else:
        assert "not claimed" in words and wording.times(after) in words


@many
@given(
    st.lists(
        st.tuples(st.sampled_from(["run_1", "forward", "backward", "late"]), gaps),
        min_size=1,
        max_size=4,
    )
)
def test_nothing_is_missing_only_where_every_run_and_direction_is_near_the_noise(parts):
    runs = [Share(name, "", 100, gap, gap, gap) for name, gap in parts if name == "run_1"]
    regimes = [Share(name, "q", 100, gap, gap, gap) for name, gap in parts if name != "run_1"]
    found = astray(runs, regimes, max(gap for _, gap in parts))
    told = [gap for name, gap in parts if name != "late"] or [max(gap for _, gap in parts)]
    assert bool(found) == any(gap > 1.5 for gap in told)


@st.composite
def results(draw) -> Any:
    """A diagnosis as the schema allows it."""
    verdict = draw(st.sampled_from(["named", "partly", "none", "unknown"]))
    still = verdict == "unknown" and draw(st.booleans())
    before, retuned, after = (np.nan if still else draw(gaps) for _ in range(3))
    if verdict in ("named", "partly"):
        after = draw(st.floats(0.5, 1.0)) * min(before, retuned)
    else:
        after = retuned
    shrink = 1 - (after**2 - 1) / (before**2 - 1) if before > 1 and verdict != "none" else np.nan
    shrinkage = min(float(shrink), 1.0) if np.isfinite(shrink) and shrink >= 0 else None
    low = draw(st.floats(-1e9, 1.0))
    interval = (min(low, shrinkage), 1.0) if shrinkage is not None and draw(st.booleans()) else None
    reason = (
        ""
        if interval
        else "no interval: too few blocks"
        if shrinkage is not None
        else "there is no gap to shrink"
    )
    noise = st.floats(-9, 3).map(lambda x: 10.0**x)
    channels = {}
    for k in range(0 if still else draw(st.integers(1, 6))):
        n = draw(noise)
        channels[f"tau{k + 1}"] = ChannelGap(
            "N m", n * draw(gaps), n * draw(gaps), n * draw(gaps), n, "stated"
        )
    split = draw(st.sampled_from(["report", "validation"]))
    far = HowFar(
        before,
        retuned,
        after,
        1.0,
        shrinkage,
        interval,
        reason,
        channels,
        "",
        interval_from="runs",
        split=split,
    )
    size = draw(gaps)
    value = Estimate(
        size,
        draw(st.none() | st.floats(1e-5, 10.0).map(lambda share: share * size)),
        "N m",
        0.0,
        1e6,
    )
    effects = (
        (EffectEstimate("quadratic_drag", "q", {"drag": value}),)
        if verdict in ("named", "partly")
        else ()
    )
    ranking = (
        Ranked(
            "quadratic_drag",
            "q",
            draw(gaps),
            1.0,
            1.0,
            "quadratic_drag at q: closes 3 % of the gap",
        ),
    )
    where = ()
    if verdict != "none" and draw(st.booleans()):
        where = (
            Finding("q", "q", "forward", (0.1, 0.6), draw(st.floats(0.0, 1.0)), draw(gaps), ""),
        )
    repeated = draw(st.booleans())
    text_ = "What is kept stands still: nothing can be judged on it." if still else ""
    advised = advice(
        verdict,
        [e.effect for e in effects],
        [],
        repeated=repeated,
        still=("report",) if still else (),
    )
    against = {
        str(e): f"{e} does next to nothing"
        for e in effects
        if verdict == "partly" and draw(st.booleans())
    }
    which = Which(verdict, effects, (), ranking, text_, against)
    found = replace(SAMPLE, which=which, how_far=far, where=where, next_experiment=advised)
    return found, repeated, still


@many
@given(results())
def test_sentences_of_a_diagnosis_agree_with_its_numbers(drawn):
    found, repeated, still = drawn
    far, verdict = found.how_far, found.which.verdict
    cards = [
        answer.headline(found),
        *(
            w
            for c in (answer.where_card, answer.which_card, answer.far_card)
            for w in _flat(c(found))
        ),
    ]
    terminal = " ".join(text.diagnosis_text(found).split())
    for words in (*cards, terminal):
        check_numbers(words.replace("With 95 % probability", ""))
    json.dumps(finite(found.to_dict()), allow_nan=False)
    everything = " ".join([*cards, terminal])
    assert ("Nothing is missing" in everything) == (verdict == "none")
    assert ("Nowhere above the noise" in everything) == (verdict == "none")
    if still:
        assert (
            "There is a gap" not in everything
            and "nothing can be judged" in everything.lower()
            and "–" not in terminal
        )
        return
    doubted = bool(found.which.doubts)
    assert (
        ("The model lacks" in terminal)
        == ("The model lacks" in cards[0])
        == (verdict in ("named", "partly") and not doubted)
    )
    assert (
        ("may be part of it" in terminal)
        == ("may be part of it" in cards[0])
        == ("Perhaps " in everything)
        == doubted
    )
    sentence = text.how_far_sentence(far, verdict)
    claimed = verdict in ("named", "partly")
    assert claimed or "falls" not in sentence
    if claimed and far.gap_after < 0.99 * min(far.gap_before, far.gap_retuned):
        assert "falls" in sentence
    if verdict == "none":
        assert f"is {wording.times(far.gap_retuned)} times the noise" in sentence
        assert ("go where the data that were fitted leave" in sentence) == (far.gap_retuned > 1.5)
        assert answer.far_card(found)[0] == f"{wording.times(far.gap_retuned)} × the noise"
    if (
        verdict == "unknown"
        and far.gap_retuned > 1.001 * far.gap_before
        and wording.times(far.gap_retuned) != wording.times(far.gap_before)
    ):
        assert "further from these than as it was stated" in sentence
    shown = [n for n in far.per_channel if f"{n}: rms error" in terminal]

    def change(g):
        return max(abs(g.rmse_before - g.rmse_after), g.rmse_retuned, g.rmse_after) / g.noise

    assert len(shown) == min(3, len(far.per_channel))
    assert max(change(g) for g in far.per_channel.values()) == max(
        change(far.per_channel[n]) for n in shown
    )
    assert not (repeated and "repeat one run" in found.next_experiment.lower())
    assert ("never fitted nor chosen on" in everything) <= (far.split == "report")


@many
@given(st.tuples(gaps, gaps, gaps))
def test_a_gap_by_torque_is_told_with_the_data_that_it_is_of(left):
    """Fit, validation and report data leave gaps of their own: a card that gave the largest without
    a name stood beside another number of the report data.
    """
    runs = {"fit": [0], "validation": [1], "report": [2]}
    nominal = SimpleNamespace(gap=lambda which: left[which[0]])
    found: Any = SimpleNamespace(nominal=nominal, fit=[0], choose=[1], judge=[2])
    with MonkeyPatch.context() as patch:
        patch.setattr(judge_by_torque, "_possible", lambda _: [])
        verdict = judge_by_torque._nothing_claimed(found)
    assert (verdict.name == "none") == (max(left) <= LIMITS.near)
    if verdict.name == "unknown":
        told = re.findall(r"\((.*) times the noise on (\w+) data\)", verdict.text)
        assert told == [(wording.times(left[runs[told[0][1]][0]]), told[0][1])]


errors = st.floats(-4, 300).map(lambda x: 10.0**x)


@many
@given(
    st.lists(
        st.tuples(st.sampled_from(["fit", "validation", "report"]), errors), min_size=1, max_size=4
    )
)
def test_the_headline_of_an_identification_is_about_its_worst_held_out_run(runs):
    experiments = [SimpleNamespace(split=split, relative_error=e) for split, e in runs]
    result: Any = SimpleNamespace(payload=None, experiments=experiments)
    words = identified.headline(result)
    held_out = [e for split, e in runs if split != "fit"]
    worst = max(held_out or [e for _, e in runs])
    assert ("held-out" in words) == bool(held_out) and ("worse than no model" in words) == (
        worst >= 1
    )
    told = float(re.findall(r"([\d.]+(?:e[+-]?\d+)?) %", words)[0])
    assert abs(told - 100 * worst) <= 0.0051 + 0.01 * 100 * worst and not re.search(
        r"\d{8,}", words
    )


@many
@given(st.lists(st.tuples(st.floats(0.1, 10), st.floats(-50, 50), st.booleans()), max_size=9))
def test_stated_numbers_are_refuted_as_their_deviations_say(numbers):
    stated = []
    for k, (value, deviation, determined) in enumerate(numbers):
        estimate = Estimate(
            value + 0.01 * deviation, 0.01 if determined else None, "N m", -100.0, 100.0
        )
        own = deviation if determined else None
        said = sentence_of(f"number_{k}", value, estimate, own)
        stated.append(
            StatedNumber(
                "q", "", f"number_{k}", value, estimate.value, estimate.std, own, said, "N m"
            )
        )
    stated.sort(key=lambda s: -abs(s.deviation or 0.0))
    refuted = [s for s in stated if s.deviation is not None and abs(s.deviation) > 3]
    words = text.stated_sentences(stated)
    for s in stated:
        agrees, unknown = (
            "agrees with the data" in s.text,
            "neither confirmed nor refuted" in s.text,
        )
        assert (agrees, unknown) == (
            s.deviation is not None and s not in refuted,
            s.deviation is None,
        )
    if len(refuted) > 2:
        assert words[0].startswith(f"{len(refuted)} of {len(stated)} numbers") and len(words) == 1
        told = re.findall(r"\(([\d.e+]+)(?: to ([\d.e+]+))? standard deviations off\)", words[0])[0]
        least, most = float(told[0]), float(told[1] or told[0])
        assert abs(least - min(abs(s.deviation) for s in refuted)) <= 0.06 * least
        assert abs(most - max(abs(s.deviation) for s in refuted)) <= 0.06 * most
        assert words[0].count("→") == min(len(refuted), text.STATED)
    else:
        assert len(words) == len(refuted)


def test_a_refuted_number_is_the_answer_where_no_effect_is_missing():
    """The headline, the card and the terminal name it; numbers that agree are not named."""
    said = "frictionloss of shoulder: 1.97 N m, stated 0.3 (130 standard deviations)"
    other = StatedNumber("shoulder", "link2", "frictionloss", 0.3, 1.97, 0.013, 130.0, said, "N m")
    same = StatedNumber(
        "elbow", "link3", "damping", 0.8, 0.81, 0.01, 1.0, "damping of elbow: agrees", "N m s/rad"
    )
    which = Which("none", (), (), (), "The model reaches the noise floor: there is no gap.")
    found = replace(
        SAMPLE, which=which, where=(), final=replace(SAMPLE.final, stated=(other, same))
    )
    told = "The shoulder's dry friction is 1.97 N m, not 0.3."
    assert answer.headline(found) == told
    fact, words = answer.where_card(found)
    assert fact == "In what is stated of shoulder" and words[0] == told
    assert answer.which_card(found)[1][0].startswith(told)
    terminal = " ".join(text.diagnosis_text(found).split())
    assert told in terminal and "Nothing is missing" not in terminal and "elbow" not in terminal
    agreed = replace(found, final=replace(SAMPLE.final, stated=(same,)))
    assert answer.headline(agreed).startswith("Nothing is missing")
    named = replace(found, which=SAMPLE.which)
    assert "dry friction is 1.97" not in answer.headline(named)


def test_stated_numbers_of_one_name_are_told_apart_by_their_joints():
    def own(joint):
        return StatedNumber(
            joint,
            "",
            "armature",
            0.028,
            0.004,
            0.001,
            -24.0,
            f"armature of {joint}: 0.004 kg m^2, …",
            "kg m^2",
        )

    (words,) = text.stated_sentences([own("elbow"), own("wrist"), own("gripper")])
    assert all(f"armature of {joint} 0.0280 → " in words for joint in ("elbow", "wrist", "gripper"))


def test_what_is_doubted_stands_behind_what_is_sure():
    drags = [EffectEstimate("quadratic_drag", q) for q in ("q1", "q2", "q3")]
    which = Which("partly", tuple(drags), (), (), "", {str(drags[1]): "it does nothing"})
    assert effect_text.lacks(which, lambda effects: " and ".join(map(str, effects))) == (
        "The model lacks quadratic_drag at q1 and quadratic_drag at q3, perhaps quadratic_drag at q2, and something more that no "
        "known effect explains."
    )


def test_reasons_claim_nothing_of_what_is_doubted():
    reasons = (
        Lacks("drag at q", 2.0),
        LacksInPart("drag at q", 0.9, 2.0),
        FollowsFitRuns("drag at q", 0.9, 2.0),
    )
    verdict = Verdict("partly", reasons)
    assert verdict.text.count("The model lacks drag at q") == 3
    assert (
        verdict.unclaimed().text.count("Nearest comes drag at q") == 3
        and "The model lacks" not in verdict.unclaimed().text
    )
    assert verdict.unclaimed().name == "partly"


def test_one_law_at_many_joints_is_said_once():
    value = Estimate(0.2, 0.01, "N m s^2/rad^2", 0.0, 1e6)

    def drag(*at):
        return tuple(EffectEstimate("quadratic_drag", q, {"coefficient": value}) for q in at)

    lag = (EffectEstimate("actuator_lag", "tau1"),)
    assert (
        effect_text.at_places(drag("q1", "q2") + lag)
        == "quadratic drag at q1 and q2 and actuator lag at tau1"
    )
    assert effect_text.at_places(drag("q1", "q2", "q3", "q4")) == "quadratic drag at 4 places"
    said = effect_text.meaning(Which("partly", drag("q1", "q2"), (), (), ""))
    assert len(said) == 1 and said[0].startswith("q1 and q2: ")


@many
@given(st.lists(st.tuples(st.sampled_from(["run_1", "run_2"]), gaps), max_size=4), gaps)
def test_what_is_left_on_report_data_is_said_with_its_figures(places, gap):
    words = ReportNotReached(gap, tuple(places)).sentence
    check_numbers(words)
    for name, left in places[:3]:
        assert f"{wording.times(left)} times the noise in {name}" in words
    assert f"{wording.times(gap)} times the noise away there" in words


def _flat(card: tuple[str, list[str]]) -> list[str]:
    return [card[0], *card[1]]


def test_one_effect_at_two_places_is_looked_for_at_the_machine():
    same, apart = (
        advice("named", ["payload"], ["payload"]),
        advice("named", ["sensor_bias"], ["gravity_offset"]),
    )
    assert "at which place payload acts" in same and "weigh what is mounted" in same
    assert "for sensor_bias:" in apart and "for gravity_offset:" in apart


def test_a_page_without_a_gap_is_written(tmp_path):
    """Nothing moves in the data kept for the report."""
    nothing = float("nan")
    far = HowFar(
        nothing,
        nothing,
        nothing,
        1.0,
        None,
        None,
        "what is kept stands still",
        {},
        "what is kept stands still",
    )
    found = replace(
        SAMPLE, which=Which("unknown", (), (), (), "It stands still."), how_far=far, where=()
    )
    page = write(found, tmp_path / "report.html").read_text()
    assert "Nothing can be judged" in page and "nan" not in re.sub(r"<[^>]*>", " ", page).split()


@many
@given(st.sampled_from(["converged", "stalled", "failed", "budget"]), losses, gaps)
def test_the_state_of_a_fit_is_said(state, loss, relative):
    fit = sample_fit(samples=50)
    score = replace(fit.scores["fit"]["q"], nrmse=relative, relative_error=relative)
    fit = replace(
        fit,
        converged=state == "converged",
        failed=state == "failed",
        stalled=state == "stalled",
        loss=loss,
        scores={"fit": {"q": score}},
    )
    content = json.loads(json.dumps(finite(fit.to_dict()), allow_nan=False))
    assert content["state"] == state and content["converged"] == (state == "converged")
    words = text.fit_text(fit)
    assert (
        ("stalled" in words) == (state == "stalled")
        and (", converged" in words) == (state == "converged")
        and not re.search(r"\d{12,}", words)
    )
