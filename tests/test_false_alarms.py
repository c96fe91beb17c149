"""Clean recordings in odd forms, in which the check must find nothing that it applies; all 1,000
are in benchmarks/.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.false_alarms import alarms, CLOCKS, Form, forms, instants, twins
from jaxid.benchmark.broken import broken, recording
from jaxid.conventions.checking import run_check
from jaxid.conventions.runs import _first_speed
from jaxid.conventions.samples import _lone
from jaxid.data.forms import glitches


def test_nothing_is_applied_to_clean_twins():
    """Of each clock two joints; of every third what a joint's model says, too."""
    made = twins(forms(2 * len(CLOCKS), seed=77, machines=("joint",), longest=2.0))
    for k, twin in enumerate(made):
        applied, asked, refused = alarms(twin, simulate=False, model=k % 3 == 0)
        assert not applied and not asked, (twin.form, [f.text for f in (*applied, *asked)])
        assert not refused or "problems" in refused or "never moves" in refused


def quick_moves(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A servo that steps every 0.2 s, and rests in between."""
    goals = rng.uniform(-1, 1, int(t[-1] / 0.2) + 2)
    return np.interp(
        t,
        np.ravel([[0.2 * k, 0.2 * k + 0.07] for k in range(len(goals))]),
        np.repeat(goals, 2)[: 2 * len(goals)],
    )


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_sample_on_the_curve_is_no_glitch_whatever_the_clock(clock):
    form = Form(
        "joint", clock, "steps", "fine", "none", 100.0, 8.0, 1, False, 0.0, 0.0, 0.0, 0.0, 0
    )
    for seed in range(20):
        rng = np.random.default_rng(seed)
        true, stamps = instants(form, rng)
        smooth = (
            np.sin(5 * true) * np.where(true % 0.7 < 0.1, 1.0, 0.0)
            if seed % 2
            else quick_moves(true, rng)
        )
        q = smooth + 2e-4 * rng.standard_normal(len(true))
        assert not _lone(q, stamps).any(), (clock, seed)


def test_glitches_on_an_uneven_clock_are_found_where_they_are():
    t = np.cumsum(np.tile([0.010, 0.012], 300))
    q = np.sin(4 * t) + 2e-4 * np.random.default_rng(0).standard_normal(len(t))
    bad = np.array([60, 200, 201, 450])
    q[bad] += 0.3
    np.testing.assert_array_equal(np.flatnonzero(glitches(q, t)), bad)
    np.testing.assert_array_equal(np.flatnonzero(_lone(q, t)), bad)


@pytest.mark.parametrize("first", [0.15, 0.01])
def test_a_gap_at_the_beginning_is_no_speed(first):
    """From rest under a constant force: at even times it goes one, three, five; after a gap it does
    not.
    """
    t = np.concatenate([[0.0], first + 0.01 * np.arange(200)])
    q = (
        0.5 * np.minimum(t, 0.16) ** 2
        + np.maximum(t - 0.16, 0) * 0.1
        + 1e-5 * np.random.default_rng(0).standard_normal(len(t))
    )
    assert _first_speed(t, q, 1e-5)[0] == 0.0
    assert _first_speed(t, q + 0.4 * t, 1e-5)[0] == pytest.approx(
        0.0 if first > 0.1 else 0.4, abs=0.02
    )


@pytest.mark.parametrize(("recorded", "mended", "kinds"), [(0.8, 1.3, []), (4.0, 5.0, ["sign"])])
def test_what_leaves_more_than_nothing_is_no_question(recorded, mended, kinds):
    """A recording at the noise as it stands has no gap that a finding could be the answer to."""
    wrong, _, _ = broken("sign", recording("pendulum", 5), np.random.default_rng(0))
    gaps = iter((recorded, mended))
    checked = run_check(None, wrong.dataset(), gap=lambda *_: next(gaps))
    assert [f.kind for f in checked.findings] == kinds
    assert not any(f.applied for f in checked.findings)
