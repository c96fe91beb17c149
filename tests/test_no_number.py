"""What is no number decides nothing: neither words nor a verdict."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from jaxid.conventions import decide
from jaxid.conventions.tried_readings import ReadingQuestion
from jaxid.diagnosis import where
from jaxid.diagnosis.budget import budget, closed
from jaxid.diagnosis.goals.as_stated import Alone
from jaxid.diagnosis.goals.own_run import FileRun
from jaxid.diagnosis.how_far import not_measured
from jaxid.diagnosis.hypothesis import SearchResult
from jaxid.diagnosis.probability import RULE
from jaxid.diagnosis.result import HowFar, Regime, Which
from jaxid.diagnosis.selection import indistinct, step_from
from jaxid.diagnosis.torque import judge as torque_judge
from jaxid.diagnosis.torque.against_reference import verdict_against
from jaxid.diagnosis.torque.algebra import ColumnPrior, Gram
from jaxid.diagnosis.torque.answer import Answer
from jaxid.diagnosis.torque.choose import Chooser
from jaxid.diagnosis.torque.weigh import Weighed
from jaxid.diagnosis.verdict import astray, Gaps, judge, upheld, Verdict
from jaxid.fitting import ending, lost_runs
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
    found = judge(SearchResult(nominal, chosen))
    assert found.name != "none"
    assert at < 2 or found.name == "unknown"
    if np.isnan(losses[1]):
        assert found.name != "named" or losses[3] <= 1.1
    assert judge(SearchResult(nominal, nominal)).name == "unknown" or at >= 2


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
    steps = budget(how_far, (), verdict)
    told = SimpleNamespace(which=which, how_far=how_far, where=(), unseen=(), budget=steps)
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
    def score(x):
        return Score(x, x, x, "rad")

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


# ---- searches, endings and places


BAD_LOSSES = [(bad, 1.0) for bad in NONE] + [(1.0, bad) for bad in NONE]


@pytest.mark.parametrize("losses", BAD_LOSSES)
def test_what_has_no_loss_passes_for_nothing_and_is_told_from_nothing(losses):
    plain, broken = hypothesis(1.0, 1.0, "drag at q"), hypothesis(*losses, "drag at q")
    assert not indistinct(plain, broken) and indistinct(broken, plain)


@pytest.mark.parametrize("losses", BAD_LOSSES)
def test_no_step_is_taken_to_what_is_no_number(losses):
    broken = hypothesis(*losses, "drag at q")
    assert step_from(hypothesis(50.0, 50.0), [broken]) is None


def chooser(held: np.ndarray) -> Chooser:
    """Sets of two units beside one number; `held` [blocks 4 4] products of held-out runs."""
    *columns, noise = np.random.default_rng(0).standard_normal((4, 400))
    rows = np.column_stack([*columns, columns[0] + 2 * columns[1] + 0.1 * noise])
    fit = np.stack([part.T @ part for part in np.split(rows, 8)])
    every: Any = [
        SimpleNamespace(effect=e, joints=(0,), fields=("x",), hidden=(), shape={}, place=(e, "q"))
        for e in ("one", "two")
    ]
    for u in every:
        u.spread, u.least = np.full(1, np.inf), np.full(1, -np.inf)

    def gram_of(blocks):
        return Gram(blocks, np.zeros(len(blocks), int), 400.0, False)

    wide = np.full(3, np.inf)
    return Chooser(
        units=every,
        size=1,
        fit=gram_of(fit),
        held=gram_of(fit if held is None else held),
        known=ColumnPrior(np.zeros((3, 3)), np.zeros(3)),
        start=np.zeros(3),
        lower=-wide,
        upper=wide,
    )


@pytest.mark.parametrize("bad", NONE)
def test_a_set_that_leaves_no_number_of_the_held_out_runs_is_no_model(bad):
    good = chooser(cast(Any, None))
    found = good.model((0,))
    assert found is not None and found.units == (0,)
    blocks = good.fit.blocks.copy()
    blocks[3, 1, :] = blocks[3, :, 1] = bad
    assert chooser(blocks).model((0,)) is None
    everywhere = np.full_like(blocks, bad)
    assert chooser(everywhere).model((0,)) is None
    assert chooser(everywhere).lively((0, 1)) is None


@pytest.mark.parametrize("bad", NONE)
def test_rows_of_torque_that_are_no_numbers_are_not_at_the_noise(bad):
    run = SimpleNamespace(moves=np.ones(1, bool))
    study = SimpleNamespace(runs=[run], noise_of=lambda k: np.ones((5, 1)))
    made = Answer(cast(Any, study), cast(Any, None), np.zeros(0, int), np.zeros(0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Answer, "residual", lambda self, k: np.full((5, 1), bad))
        assert made.gap([0]) == np.inf
    run.moves[:] = False  # what does not move says nothing
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Answer, "residual", lambda self, k: np.full((5, 1), bad))
        assert np.isnan(made.gap([0]))


DRAG = SimpleNamespace(effect="quadratic_drag")


def torque_answer(gap: dict[int, float], units: tuple[Any, ...] = ()) -> Any:
    return SimpleNamespace(gap=lambda which, joint=None: gap[which[0]], units=units)


@pytest.mark.parametrize("bad", NONE)
@pytest.mark.parametrize("at", range(4))
@pytest.mark.parametrize("different", [False, True])
def test_no_verdict_by_torque_rests_on_what_is_no_number(bad, at, different):
    """Gaps of the model without and with effects, in the runs that were fitted and those that were
    not: one is no number, and the others speak for a name.
    """
    values = [1.0, 50.0, 1.0, 10.0]
    values[at] = bad
    judged, study = torque_judge.judged_by_torque, cast(Any, None)
    nominal = torque_answer({0: values[0], 1: values[1]})
    final = torque_answer({0: values[2], 1: values[3]}, (DRAG,))
    found: Any = SimpleNamespace(
        nominal=nominal,
        final=final,
        as_before=None,
        choose=[1],
        judge=[],
        fit=[0],
        base=None,
        different=different,
        claims=(),
        weighed=Weighed(cast(Any, SimpleNamespace(rule=RULE, units=())), (), (), {}),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torque_judge, "astray", lambda study, answer: ())
        told = judged(study, found)
        assert told.name in ("unknown", "partly")
        assert told.name == "unknown" or values[1] > values[3]
        if np.isinf(bad):  # nan is a set of runs in which nothing moves, and says nothing
            found.nominal = found.final = torque_answer({0: 1.0, 1: bad})
            assert judged(study, found).name == "unknown"


@pytest.mark.parametrize("bad", NONE)
@pytest.mark.parametrize("at", range(3))
def test_no_verdict_against_a_reference_rests_on_what_is_no_number(bad, at):
    """Gaps of the reference and of the model with effects, and what is usual."""
    values = [50.0, 1.0, 1.0]
    assert _against(*values) == "named"
    values[at] = bad
    assert _against(*values) == "unknown"


def _against(before: float, after: float, usual: float) -> str:
    models = torque_answer({0: before}), torque_answer({0: after})
    return verdict_against(("a",), *models, [[0]], usual).name


@pytest.mark.parametrize("bad", NONE)
def test_a_force_that_is_no_number_lies_nowhere(bad):
    force, null = np.ones((50, 1)), np.full((4, 50, 1), 0.1)
    force[7] = bad
    found: Any = SimpleNamespace(force=force, null=null, keep=np.ones(50, bool))
    signature = SimpleNamespace(
        joints=("q",), outputs=(("q", "rad"),), output_names=["q"], unit=lambda text: "N m"
    )
    bench: Any = SimpleNamespace(
        binding=SimpleNamespace(chain=SimpleNamespace(signature=signature))
    )
    row = Regime("q", "high_speed", bad, (0.9, 1.1), 30)
    assert where.findings(bench, [found], [row], {}, (), {}) == []
    after: Any = SimpleNamespace(force=np.zeros((50, 1)), null=null)
    given = where.supplied([found], [after], 0)
    assert given is None or where.findings(bench, [found], [row], {}, (), {"q": given}) == []


@pytest.mark.parametrize("bad", NONE)
def test_a_loss_that_is_no_number_is_no_end(bad):
    problem: Any = SimpleNamespace(
        loss_name="sum_of_squares",
        free=np.arange(1),
        size=1,
        data=SimpleNamespace(count=np.array([10])),
    )
    found: Any = SimpleNamespace(loss=bad, stopped_because="tolerance", converged=True)
    cov: Any = SimpleNamespace(at_bound=np.zeros(1, bool), identifiable=np.ones(1, bool))
    end = ending.ending(problem, found, cov)
    assert end.state == "failed" and "not a number" in end.because
    assert not ending.gain(problem, 5.0, bad) > ending.MATERIAL


@pytest.mark.parametrize("bad", NONE)
@pytest.mark.parametrize("first", [True, False])
def test_a_free_run_that_is_no_number_is_astray(bad, first):
    scores = {"q": Score(0.1, 0.1, 0.01, "rad"), "w": Score(bad, bad, bad, "rad")}
    ordered = dict(sorted(scores.items(), reverse=first))
    assert lost_runs._off(cast(Any, SimpleNamespace(scores={"fit": ordered}))) == np.inf


@pytest.mark.parametrize("bad", NONE)
def test_a_run_beside_which_another_diverges_grows_without_end(bad):
    signature = SimpleNamespace(outputs=(("q", "rad"),), output_names=["q"], joints=("q",))
    mechanism = SimpleNamespace(hidden_states=False)
    chain = SimpleNamespace(signature=signature, mechanism=mechanism, nq=1)
    binding = SimpleNamespace(chain=chain, motions={"a": 1}, experiments=lambda split: [1])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lost_runs, "estimate_starts", lambda *a: np.zeros((1, 1, 2)))
        runs = [[np.zeros((5, 1))], [np.full((5, 1), bad)]]
        patch.setattr(lost_runs, "free_runs", lambda *a: runs)
        bench: Any = SimpleNamespace(binding=binding)
        assert lost_runs.growth(bench, np.zeros(1)) == np.inf
        said = lost_runs._lost(
            bench, cast(Any, SimpleNamespace(theta=0)), cast(Any, SimpleNamespace(theta=0))
        )
        assert "diverges" in said and "inf" not in said


@pytest.mark.parametrize("bad", NONE)
def test_no_reading_is_claimed_by_what_is_no_number(bad):
    """What the model leaves of the recording, or what noise does."""

    def fitted(worst):
        return SimpleNamespace(worst=worst, left=worst)

    for worst, noise in ((bad, 0.01), (0.5, bad)):
        fit: Any = SimpleNamespace(least_noise=lambda *a, n=noise: n, driven=True)
        asked = ReadingQuestion(
            binding=cast(Any, None),
            fit=fit,
            m=cast(Any, None),
            names=cast(Any, None),
            many=False,
            recorded=cast(Any, fitted(worst)),
            beside=cast(Any, fitted(worst)),
            laws=False,
        )
        assert decide._claimed(asked) is None


@pytest.mark.parametrize("bad", NONE)
def test_under_goals_nothing_is_decided_by_what_is_no_number(bad):
    for losses in ((bad, 1.0), (1.0, bad)):
        assert not hypothesis(*losses).at_noise
    one: Any = SimpleNamespace(sigma=np.ones(1))
    run = FileRun({"fit": [np.full((5, 1), bad)]})
    assert not run.accounts(one)


def alone(own: set[int]) -> Alone:
    made = Alone.__new__(Alone)
    made.own, made.theta = frozenset(own), np.zeros(3)
    return made


def refitted(H: np.ndarray, z: np.ndarray, index: tuple[int, ...] = ()) -> Any:
    problem = SimpleNamespace(free=np.arange(3), z=lambda theta: theta.copy())
    path = SimpleNamespace(problem=problem, hessian=H, z=z, count=1000)
    return SimpleNamespace(
        effects=[SimpleNamespace(index=index)] if index else [],
        index=index,
        path=path,
        fit_inflation=1.0,
    )


def test_numbers_are_told_from_what_they_were_by_what_each_costs():
    """log(1000) = 6.9 chi-square units: 2.6 standard deviations, of each beside the others."""
    z = np.array([3.0, 2.0, 0.0])
    assert alone({0, 1, 2}).told(refitted(np.eye(3), z)) == [0]
    assert alone({0, 1, 2}).told(refitted(100 * np.eye(3), z)) == [0, 1]
    assert alone({0}).told(refitted(100 * np.eye(3), z)) == [0]  # numbers of the file alone
    assert alone({0}).told(refitted(100 * np.eye(3), z, (1,))) == [1]  # or what was changed
    tied = 100 * (np.eye(3) + 0.999 * (np.ones((3, 3)) - np.eye(3)))
    assert alone({0, 1, 2}).told(refitted(tied, 0.3 * z)) == []  # only their sum is known
    worse = refitted(100 * np.eye(3), z)
    worse.fit_inflation = 100.0
    assert alone({0, 1, 2}).told(worse) == [0]


@pytest.mark.parametrize("bad", NONE)
def test_no_number_is_told_by_what_is_none(bad):
    H = 100 * np.eye(3)
    H[1, 1] = bad
    assert alone({0, 1, 2}).told(refitted(H, np.full(3, 3.0))) == []
    assert alone({1}).told(refitted(100 * np.eye(3), np.full(3, np.nan))) == []
