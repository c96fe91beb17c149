"""Motion that comes before its cause: an input that is reported late by any time, and silence where
causes come first.
"""

from dataclasses import replace

import numpy as np
import pytest

import jaxid
from jaxid.benchmark.broken import recording, SoundRecording
from jaxid.conventions import checking


def moved(r: SoundRecording, rows: float) -> SoundRecording:
    """The recording with its inputs that many rows later (before 0: earlier, as where a drive has a
    delay).
    """
    u = r.u.copy()
    for run in range(len(u)):
        for k in range(u.shape[2]):
            u[run, :, k] = np.interp(r.t - rows * r.t[1], r.t, r.u[run, :, k])
    return replace(r, u=u)


def found(r: SoundRecording) -> list:
    return [(f.kind, f.channel, f.applied) for f in checking.run_check(None, r.dataset()).findings]


@pytest.mark.parametrize(
    ("model", "rows", "effect"),
    [("joint", 1.5, ""), ("joint", 5.5, "drag"), ("joint", 13.3, ""), ("pendulum", 3.4, "drag")],
)
def test_a_motion_before_its_cause_is_told_in_time(model, rows, effect):
    r = moved(recording(model, 0, effect), rows)
    (finding,) = checking.run_check(None, r.dataset()).findings
    assert (finding.kind, finding.channel, finding.applied) == ("row_shift", "tau", True)
    assert finding.value == pytest.approx(rows, abs=0.1)
    assert finding.value is not None and finding.interval_95 is not None
    low, high = finding.interval_95
    assert low < rows < high
    assert float(finding.line.removeprefix("delay_s = ")) == pytest.approx(
        rows * r.t[1], abs=0.1 * r.t[1]
    )
    assert f"{1e3 * finding.value * r.t[1]:.3g} ±" in finding.text


@pytest.mark.parametrize("rows", [-4.4, 0.0, 0.4])
def test_a_cause_that_comes_first_is_no_finding(rows):
    assert not [
        f for seed in range(2) for f in found(moved(recording("joint", seed), rows)) if f[2]
    ]


def test_a_line_composes_with_the_delay_that_is_stated():
    r = moved(recording("joint", 0), 5.5)
    stated = r.dataset(delay_s={"tau": 2 * float(r.t[1])})
    (finding,) = checking.run_check(None, stated).findings
    assert float(finding.line.removeprefix("delay_s = ")) == pytest.approx(
        5.5 * r.t[1], abs=0.1 * r.t[1]
    )
    mended = r.dataset(delay_s={"tau": float(finding.line.removeprefix("delay_s = "))})
    assert checking.run_check(None, mended).findings == ()


def test_uneven_clocks_and_what_is_missing_make_no_cause_late():
    rng = np.random.default_rng(3)
    t = np.cumsum(np.where(np.arange(1500) % 2, 1.2, 0.8)) * 0.005
    f, phase = rng.uniform(0.15, 1.6, 6), rng.uniform(0, 6.28, 6)
    x, w = 2 * np.pi * f * t[:, None] + phase, 2 * np.pi * f
    q, v, a = np.sin(x).sum(1), (w * np.cos(x)).sum(1), -(w * w * np.sin(x)).sum(1)
    for lacking in (
        0 * q,
        0.3 * np.sin(q),
        0.02 * v * np.abs(v),
        0.2 * np.exp(-(v**2)) * np.sign(v),
    ):
        u = 0.05 * a + 0.1 * v + 0.1 * np.sign(v) + lacking
        noisy = q + 2e-4 * rng.standard_normal(len(t))
        data = jaxid.Dataset.from_arrays(
            t, {"tau": u}, {"q": noisy}, units={"tau": "N m", "q": "rad"}, hold={"tau": "linear"}
        )
        assert not [f for f in checking.run_check("joint", data).findings if f.decisive]
