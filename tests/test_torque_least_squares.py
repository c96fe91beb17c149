"""By torque against plain least squares, NumPy's on the columns of the textbook, where a model
lacks far more than noise.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import jaxid
from jaxid.data.signals import differentiate, filter_ends, speed_content, spline, zero_phase


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
CUTOFF = 5.0
TRUE = {"inertia": 0.02, "viscous": 0.05, "gravity_torque": 0.9, "coulomb": 0.1, "offset": 0.0}


def swing(seed: int, late: bool) -> tuple[np.ndarray, ...]:
    """t, torque and position of a pendulum on which a slow torque acts that depends on nothing;
    `late`: the clock limps.
    """
    rng, t = np.random.default_rng(seed), np.arange(0, 20, 0.005)
    if late:
        t[7::15] += 0.003
    a, w = rng.uniform(0.2, 0.5, (5, 1)), 2 * np.pi * rng.uniform(0.1, 1.2, (5, 1))
    angle = w * t + rng.uniform(0, 6, (5, 1))
    q, qd, qdd = (
        (a * np.sin(angle)).sum(0),
        (a * w * np.cos(angle)).sum(0),
        -(a * w * w * np.sin(angle)).sum(0),
    )
    tau = (
        TRUE["inertia"] * qdd
        + TRUE["viscous"] * qd
        + TRUE["gravity_torque"] * np.sin(q)
        + TRUE["coulomb"] * np.tanh(qd / 0.01)
    )
    slow = 0.3 * np.sin(2 * np.pi * 0.13 * t + rng.uniform(0, 6)) + 0.1 * np.sin(
        2 * np.pi * 0.7 * t + rng.uniform(0, 6)
    )
    return (
        t,
        tau + slow + 1e-3 * rng.standard_normal(t.size),
        q + 5e-5 * rng.standard_normal(t.size),
    )


def columns(t: np.ndarray, tau: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Filtered columns of inertia, viscous friction, gravity, dry friction and an offset, and
    torque, on equal steps.
    """
    even = np.linspace(t[0], t[-1], t.size)
    q, qd, qdd, _ = differentiate(even, spline(t, q, even), 2 * CUTOFF)
    both = zero_phase(
        even,
        np.column_stack(
            [qdd, qd, np.sin(q), np.tanh(qd / 0.01), 0 * q + 1, np.interp(even, t, tau)]
        ),
        CUTOFF,
    )
    ends = filter_ends(even, CUTOFF)
    return both[ends:-ends, :5], both[ends:-ends, 5]


def left(runs: list[tuple[np.ndarray, ...]], numbers: np.ndarray) -> float:
    made = [columns(*r) for r in runs]
    return float(np.sqrt(np.mean(np.concatenate([y - x @ numbers for x, y in made]) ** 2)))


@pytest.mark.parametrize("late", [False, True], ids=["even", "uneven"])
@pytest.mark.parametrize("how", ["fit", "diagnose"])
def test_as_little_is_left_as_by_least_squares(how, late):
    fit, held = [swing(s, late) for s in (1, 2)], [swing(s, late) for s in (3, 4)]
    made = [columns(*r) for r in fit]
    best = np.linalg.lstsq(
        np.concatenate([x for x, _ in made]), np.concatenate([y for _, y in made]), rcond=None
    )[0]
    runs = [*fit, *held]
    data = jaxid.Dataset.from_arrays(
        [r[0] for r in runs],
        {"tau": [r[1] for r in runs]},
        {"q": [r[2] for r in runs]},
        units={"tau": "N m", "q": "rad"},
        split=["fit", "fit", "validation", "report"],
    )
    by = {"residual": "inverse_dynamics", "cutoff_hz": CUTOFF, "as_recorded": True}
    model = jaxid.models.Pendulum()
    if how == "fit":
        found = jaxid.fit(model, data, **by).parameters
    else:
        found = jaxid.diagnose(model, data, effects=["quadratic_drag"], **by).nominal.parameters
    own = np.array([found[name].value for name in TRUE])
    assert left(held, own) < 1.02 * left(held, best)
    assert own == pytest.approx(best, rel=0.1, abs=0.01)


@pytest.mark.slow
def test_a_public_double_pendulum_is_left_with_what_least_squares_leaves():
    """0.177 and 0.168 N m of its report runs, by the columns of the textbook, equal weights and the same filter."""
    if not (DATA / "double_pendulum_c0").is_dir():
        pytest.skip(f"double_pendulum_c0 is not in {DATA}; set JAXID_DATA")
    data = jaxid.load_dataset(DATA / "double_pendulum_c0")
    by = {"residual": "inverse_dynamics", "cutoff_hz": 8.0, "as_recorded": True}
    d = jaxid.diagnose(None, data, effects=["quadratic_drag"], **by)
    f = jaxid.fit(None, data, **by)
    for table in (d.nominal.scores, f.scores):
        both = np.array([table["report"][c].rmse for c in ("tau1", "tau2")])
        assert np.all(both < 1.1 * np.array([0.177, 0.168]))
        assert np.hypot(*both) < 1.08 * np.hypot(0.177, 0.168)


def test_noise_of_a_clock_does_not_widen_the_band_of_a_motion():
    """Readings that are late by up to half a step, each by its own, make noise where the joint is
    quick.
    """
    rng, t = np.random.default_rng(0), np.arange(0, 20, 1e-3)
    y = np.sin(
        2 * np.pi * 0.5 * (t + 5e-4 * rng.uniform(-1, 1, t.size))
    ) + 1e-5 * rng.standard_normal(t.size)
    assert speed_content(t, y, 1e-5) < 1.0


def test_rows_at_standstill_are_known_to_within_dry_friction():
    """Friction 0.5 N m holds the joint for seconds: what acts on it then is not missing, and does
    not bend the numbers.
    """
    rng, step, inertia, level, viscous = np.random.default_rng(0), 1e-3, 0.1, 0.5, 0.2
    runs = []
    for seed in (1, 2, 3):
        t, (a, b) = np.arange(0, 20, step), np.random.default_rng(seed).uniform(0, 6, 2)
        u, q, v, kept = (
            0.7 * np.sin(2 * np.pi * 0.31 * t + a) + 0.5 * np.sin(2 * np.pi * 0.83 * t + b),
            0.0,
            0.0,
            [],
        )
        for x in u:
            kept.append(q)
            push = x - viscous * v
            way = np.sign(v) if v else np.sign(push) * (abs(push) > level)
            new = v + step * (push - way * level) / inertia if way else 0.0
            v = 0.0 if v and new * v < 0 else new
            q += step * v
        pick = slice(None, None, 5)
        runs.append(
            (t[pick], u[pick] + 1e-3 * rng.standard_normal(t[pick].size), np.array(kept)[pick])
        )
    data = jaxid.Dataset.from_arrays(
        [r[0] for r in runs],
        {"tau": [r[1] for r in runs]},
        {"q": [r[2] + 1e-5 * rng.standard_normal(r[2].size) for r in runs]},
        units={"tau": "N m", "q": "rad"},
        split=["fit", "validation", "report"],
    )
    d = jaxid.diagnose("joint", data, residual="inverse_dynamics", as_recorded=True)
    own = d.nominal.parameters
    for name, true in {"inertia": inertia, "viscous": viscous, "coulomb": level}.items():
        assert own[name].value == pytest.approx(true, rel=0.07), name
    assert not d.which.effects, d.which.text
