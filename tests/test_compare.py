"""`jaxid compare`: what it writes, its statistics against separately computed ones, interruption,
refusals.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given, settings, strategies as st

import jaxid
from jaxid.base.stopping import Interrupted
from jaxid.cli import app as cli
from jaxid.fitters import DifferentialEvolution, LevenbergMarquardt
from jaxid.fitting.comparison import BestKnown, Comparison, FitterRun, typical, wilson
from test_fitters import data_of
from test_report import assert_harmless


@pytest.fixture(scope="module")
def small() -> Comparison:
    return jaxid.compare(
        None, data_of("joint"), fitters=["lm", "hybrid", "ade"], seeds=3, budget=900
    )


def made(losses: dict[str, list[float]], best: float = 1.0) -> Comparison:
    """A comparison of runs that halve their excess every 10 evaluations, 0.1 s each."""
    runs = []
    for fitter, ends in losses.items():
        for seed, end in enumerate(ends):
            n = 10 * np.arange(1, 11)
            history = np.stack([n, n / 100, end + 64 * 0.5 ** (n / 10) - 64 * 0.5**10], 1)
            runs.append(
                FitterRun(
                    fitter,
                    seed,
                    "stopped",
                    "budget",
                    end,
                    100,
                    1.0,
                    2.0,
                    1.0,
                    {"a": end, "b": 2 * end},
                    history,
                )
            )
    known = {"a": BestKnown(1.0, 0.1, "kg", 0.0, 5.0), "b": BestKnown(2.0, None, "N m", 0.0, 5.0)}
    return Comparison(
        "m",
        "d",
        "0" * 64,
        (),
        "output_error",
        "sum_of_squares",
        100,
        None,
        "random",
        0.01,
        best,
        known,
        tuple(runs),
        3.0,
    )


# ---- statistics


@given(n=st.integers(1, 60), share=st.floats(0, 1))
@settings(max_examples=60, deadline=None)
def test_wilson_interval(n, share):
    """Solves (p - share)^2 = z^2 p (1 - p) / n, holds the rate, stays within 0 and 1."""
    k = round(share * n)
    low, high = wilson(k, n)
    assert 0 <= low <= k / n <= high <= 1 and high - low < 1
    for p in (low, high):
        if 0 < p < 1:
            assert (k / n - p) ** 2 == pytest.approx(
                1.959964**2 * p * (1 - p) / n, rel=1e-6, abs=1e-12
            )


def test_interval_of_a_median_covers():
    """800 draws of ten from a skewed distribution; the interval by order statistics covers at least
    95 %.
    """
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(800):
        t = typical(rng.exponential(size=10))
        covered += t.lower <= np.log(2) <= t.upper
        assert t.lower <= t.median <= t.upper
    assert 0.95 <= covered / 800 <= 0.995
    few = typical(np.array([3.0, np.inf, 5.0]))
    assert few.median == 5.0 and few.lower == 3.0 and np.isinf(few.upper)


def test_summaries_of_known_runs():
    c = made(
        {
            "good": [1.0, 1.005, 1.0, 1.0],
            "mixed": [1.0, 2.0, 2.0, 2.0],
            "never": [4.0, 4.0, 4.0, 4.0],
        }
    )
    good, mixed, never = c.table
    assert [s.fitter for s in c.table] == ["good", "mixed", "never"]
    assert (good.successes, mixed.successes, never.successes) == (4, 1, 0)
    assert c.target == pytest.approx(1.01)
    # 64 * 0.5^k - 0.0625 <= 0.01 first holds at the last point
    assert (
        good.evaluations_to_target.median == 100
        and good.seconds_to_target.median == pytest.approx(1.0)
    )
    assert mixed.expected_evaluations == 400 and np.isinf(mixed.evaluations_to_target.median)
    assert np.isinf(never.expected_evaluations) and never.success_interval_95[0] == 0
    assert json.loads(json.dumps(c.to_dict()["fitters"][0]))["successes"] == 4


def test_the_drawn_median_never_rises():
    """Runs that come to a loss late do not lift the line of those that came early: without one, a
    run stands above all.
    """
    from matplotlib.figure import Figure

    c = made({"a": [1.0, 1.0, 3.0, 3.0, 5.0]})
    c.runs[3].history[:, :2] += 150  # no loss until all others are done
    c.runs[4].history[:6, 2] = 1e200  # diverges at first
    axes = Figure().add_subplot()
    c.plot("evaluations", ax=axes)
    middle = np.asarray(axes.lines[0].get_ydata(), float)
    assert np.all(np.diff(middle) <= 0) and middle[-1] == pytest.approx(2.0)
    assert middle[0] < 100


# ---- the real thing


def test_comparison_of_three_fitters(small, tmp_path):
    assert small.fitters == ("lm", "hybrid", "ade") and len(small.runs) == 9
    assert all(0 < r.evaluations <= 900 for r in small.runs)
    assert all(
        np.all(np.diff(r.history[:, 2]) <= 0) and np.all(np.diff(r.history[:, :2], axis=0) >= 0)
        for r in small.runs
    )
    assert all(r.loss >= small.best_loss * (1 - 1e-9) for r in small.runs)
    assert small.table[0].fitter in ("lm", "hybrid") and small.table[0].successes >= 2
    assert 0.7 < small.best_loss < 1.3
    assert (
        small.best["inertia"].value == pytest.approx(0.12, rel=0.05)
        and small.best["inertia"].unit == "kg m^2"
    )
    # all but the first run of a fitter find its programs compiled
    assert all(r.compile_time_s == 0 for r in small.runs if r.seed > 0)

    folder = small.save(tmp_path / "out")
    assert sorted(p.name for p in folder.iterdir()) == [
        "comparison.json",
        "report.html",
        "runs.parquet",
    ]
    content = json.loads((folder / "comparison.json").read_text())
    assert content["schema"] == 1 and content["kind"] == "comparison" and len(content["runs"]) == 9
    table = pyarrow.parquet.read_table(folder / "runs.parquet")
    for column in (
        "dataset",
        "model",
        "effects",
        "fitter",
        "seed",
        "status",
        "loss",
        "evaluations",
        "wall_time_s",
        "compile_time_s",
    ):
        assert column in table.column_names
    assert set(small.best) <= set(table.column_names)
    assert table.column("loss").to_pylist() == [r.loss for r in small.runs]
    page = (folder / "report.html").read_text()
    assert page.count("<figure") == 3 and page.count("<table") == 2 and "hybrid" in page


def test_same_seeds_same_losses(small):
    again = jaxid.compare(None, data_of("joint"), fitters=["ade"], seeds=2, budget=900, seed=1)
    assert [r.loss for r in again.runs] == [r.loss for r in small.of("ade")[1:]]
    assert {r.seed for r in again.runs} == {1, 2}


def test_plot_and_notebook(small):
    from matplotlib.figure import Figure

    for by in ("evaluations", "seconds"):
        axes = Figure().add_subplot()
        assert small.plot(by, axes) is axes
        assert (
            len(axes.get_lines()) == 4 and by in axes.get_xlabel()
        )  # three fitters and the target
    with pytest.raises(jaxid.UsageError, match="seconds"):
        small.plot("hours", Figure().add_subplot())
    html = small._repr_html_()
    assert html.count("<figure") == 3 and "<html" not in html and len(html) < 400_000


def test_a_comparison_shows_itself_short_and_escaped():
    bad = "<script>alert(1)</script>\x1b]0;x\x07\u202e"
    c = replace(
        made({"good": [1.0, 1.0], bad: [2.0, 3.0]}),
        dataset=bad,
        model=bad,
        best={k: BestKnown(1.0, 0.1, bad, 0.0, 5.0) for k in "ab"},
    )
    html = c._repr_html_()
    page = assert_harmless(html)
    assert "<script>alert(1)</script>" in page.text and "good" in page.text and "<html" not in html
    words = repr(c)
    assert (
        "good" in words
        and len(words.splitlines()) < 20
        and not any(x in words for x in "\x1b\x07\u202e")
    )


def test_ctrl_c_keeps_what_was_finished(tmp_path, monkeypatch, capsys):
    """The third run is interrupted; the first two are saved, and the command says so."""
    from jaxid.fitting import comparison_runs as comparison_study

    real, count = comparison_study.one_run, []

    def interrupted(*args):
        count.append(1)
        if len(count) == 3:
            raise KeyboardInterrupt
        return real(*args)

    monkeypatch.setattr(comparison_study, "one_run", interrupted)
    with pytest.raises(Interrupted) as stop:
        jaxid.compare(None, data_of("joint"), fitters=["lm"], seeds=5, budget=300)
    assert len(stop.value.partial.runs) == 2

    count.clear()
    monkeypatch.setattr(jaxid, "load_dataset", lambda *_: data_of("joint"), raising=False)
    assert (
        cli.main(
            [
                "compare",
                "x",
                "--out",
                str(tmp_path),
                "--fitters",
                "lm",
                "--seeds",
                "5",
                "--budget",
                "300",
            ]
        )
        == 130
    )
    assert "partial" in capsys.readouterr().err
    assert len(json.loads((tmp_path / "partial" / "comparison.json").read_text())["runs"]) == 2
    assert not (tmp_path / "comparison.json").exists()


def test_command(tmp_path, monkeypatch, capsys):
    seen = {}
    monkeypatch.setattr(jaxid, "load_dataset", lambda *_: "the dataset", raising=False)
    result = made({"lm": [1.0, 1.0], "de": [1.0, 3.0]})
    monkeypatch.setattr(
        jaxid,
        "compare",
        lambda *args, **kwargs: seen.update(args=args, **kwargs) or result,
        raising=False,
    )
    line = "compare data --fitters lm,de --seeds 2 --budget 50 --seconds 3 --effect dead_zone@tau --loss sum_of_abs --starts guess"
    assert cli.main([*line.split(), "--out", str(tmp_path), "--model", "joint"]) == 0
    assert seen["args"] == ("joint", "the dataset") and seen["fitters"] == ("lm", "de")
    assert (seen["seeds"], seen["budget"], seen["seconds"], seen["starts"]) == (2, 50, 3.0, "guess")
    assert seen["effects"] == ("dead_zone@tau",) and seen["loss"] == "sum_of_abs"
    out = capsys.readouterr().out
    assert "lm reached the best known loss in 2 of 2 runs" in out and "1/2" in out
    assert cli.main(["compare", "data", "--out", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["kind"] == "comparison"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"fitters": ["lmm"]}, "lm"),
        ({"fitters": []}, "no fitter"),
        ({"fitters": ["ls"]}, "inverse_dynamics"),
        ({"seeds": 0}, "seeds"),
        ({"budget": 0}, "budget"),
        ({"starts": "anywhere"}, "random"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"loss": "squares"}, "sum_of_squares"),
    ],
)
def test_senseless_arguments_are_refused(settings, words):
    with pytest.raises(jaxid.UsageError, match=words):
        jaxid.compare(None, data_of("joint"), **settings)


def test_two_settings_of_one_method_have_two_labels():
    from jaxid.fitters.by_name import labelled

    labels = [
        label
        for label, _ in labelled(
            [DifferentialEvolution(CR=0.5), "de", LevenbergMarquardt()], 600, None
        )
    ]
    assert labels == ["de", "de 2", "lm"]
    assert dict(labelled(["de"], 600, None))["de"].generations == 10  # pyright: ignore[reportAttributeAccessIssue]


def test_import_stays_light():
    code = "import sys; from jaxid.cli.app import main; main(['compare', '--help'])\nprint({'jax', 'numpy'} & set(sys.modules))"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(__file__).parents[1]
    )
    assert result.stdout.strip().endswith("set()") and "--seeds" in result.stdout
