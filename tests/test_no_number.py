"""What is no number decides nothing: neither words nor a verdict."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from jaxid.diagnosis.how_far import closed, not_measured
from jaxid.diagnosis.hypothesis import Search
from jaxid.diagnosis.result import HowFar, Which
from jaxid.diagnosis.verdict import astray, Gaps, judge, upheld, Verdict
from jaxid.fitting.result import Estimate, Score
from jaxid.fitting.scores import lost
from jaxid.fitting.stated import sentence_of
from jaxid.numerics.stated_numbers import apart
from jaxid.report import answer, text
from test_sentences import hypothesis


NONE = (float("nan"), float("inf"))
#: Words that say more than is known where a gap is no number.
CLAIMS = (
    "reaches the noise",
    "Nowhere above",
    "noise floor",
    "is closed",
    "gap closed",
    "Nothing is missing",
    "falls from",
)


def far(before: float, retuned: float, after: float, reason: str = "") -> HowFar:
    return HowFar(before, retuned, after, 1.0, None, None, reason, {}, "")


@pytest.mark.parametrize("bad", NONE)
@pytest.mark.parametrize("at", range(4))
def test_no_verdict_rests_on_what_is_no_number(bad, at):
    """Nominal and chosen, on fit and validation data: one of the four is none, the others speak for
    a name.
    """
    losses = [50.0, 50.0, 1.0, 1.0]
    losses[at] = bad
    nominal, chosen = (
        hypothesis(losses[0], losses[1]),
        hypothesis(losses[2], losses[3], "drag at q"),
    )
    found = judge(Search(nominal, chosen))
    assert found.name != "none"
    assert at < 2 or found.name == "unknown"
    if np.isnan(losses[1]):
        assert found.name != "named" or losses[3] <= 1.1
    assert judge(Search(nominal, nominal)).name == "unknown" or at >= 2


@pytest.mark.parametrize("values", list(itertools.product((0.9, 5.0, *NONE), repeat=3)))
def test_report_data_that_are_no_numbers_bear_nothing_out(values):
    before, retuned, after = values
    found = upheld(Verdict("named"), Gaps(before, retuned, after))
    if not np.isfinite(after) or np.isnan(retuned):
        assert found.name == "unknown"


@pytest.mark.parametrize("values", list(itertools.product((0.9, 5.0, *NONE), repeat=3)))
@pytest.mark.parametrize("verdict", ["named", "partly", "unknown"])
def test_no_words_are_made_of_what_is_no_number(values, verdict):
    before, retuned, after = values
    reason = not_measured(before, after)
    assert (reason is None) == bool(np.isfinite([before, after]).all())
    if not np.isnan([before, after]).any():
        return
    how_far = far(before, retuned, after, reason or "")
    said = [text.how_far_sentence(how_far, verdict), text.shrinkage_sentence(how_far, verdict)]
    assert not any(claim in sentence for claim in CLAIMS for sentence in said)


@pytest.mark.parametrize("verdict", ["none", "unknown", "named"])
def test_what_was_not_measured_is_said_as_that(verdict):
    nothing = float("nan")
    how_far = far(nothing, nothing, nothing, "no sample of these data could be compared")
    which = Which(verdict, (), (), (), "")
    told = SimpleNamespace(which=which, how_far=how_far, where=(), unseen=())
    words = [
        answer.headline(cast(Any, told)),
        answer.where_card(cast(Any, told))[0],
        answer.far_card(cast(Any, told))[0],
        text.how_far_sentence(how_far, verdict),
        text.which_sentence(which, how_far),
    ]
    assert not any(claim in sentence for claim in CLAIMS for sentence in words)


def test_a_place_whose_gap_is_no_number_is_not_at_the_noise():
    assert astray((), (), float("nan")) and astray((), (), float("inf"))
    assert all(
        closed(*pair) == 0
        for pair in ((float("nan"), 1.0), (5.0, float("nan")), (5.0, float("inf")))
    )


@pytest.mark.parametrize("bad", NONE)
def test_a_score_that_is_no_number_is_no_model(bad):
    score = lambda x: Score(x, x, x, "rad")
    assert lost({"fit": {"q": score(0.01)}, "report": {"q": score(bad)}}, {"q": 0.001})
    assert not lost({"fit": {"q": score(0.01)}, "report": {"q": score(0.01)}}, {"q": 0.001})


@pytest.mark.parametrize("bad", NONE)
def test_a_stated_number_is_not_judged_by_what_is_no_number(bad):
    estimate = Estimate(1.0, 0.1, "N m", -10.0, 10.0)
    assert "neither confirmed nor refuted" in sentence_of("damping", 1.1, estimate, bad)
    assert (
        apart(bad, 1.0, 0.1) is None
        and apart(1.0, 1.1, bad) is None
        and apart(1.0, 1.1, 0.0) is None
    )
    assert apart(1.0, 1.1, 0.1) == pytest.approx(-1.0)
