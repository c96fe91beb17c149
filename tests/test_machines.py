"""Several machines of one kind in a study: what is common, what differs, where a further one lies."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from jaxid.study import run_study
from jaxid.study.machines import common, FEWEST


def machines(rng: np.random.Generator, n: int, spread: float):
    """(true value of n + 1 machines, standard deviations and measured values of the first n)."""
    true = rng.normal(3.0, spread, n + 1)
    std = rng.uniform(0.5, 2.0, n)
    return true, std, true[:n] + std * rng.normal(size=n)


def number(x, std, **more):
    each = {
        f"machine {i}": (float(a), float(s)) for i, (a, s) in enumerate(zip(x, std, strict=True))
    }
    return common("inertia", "kg m^2", each, **more)


@pytest.mark.parametrize("spread", [0.0, 1.5])
@pytest.mark.parametrize("n", [4, 8, 16])
def test_a_further_machine_lies_in_the_range(n, spread):
    """Counted over 200 kinds of machines; of 200 at 95 %, 182 are two standard deviations low."""
    rng = np.random.default_rng(7 * n)
    within = 0
    for _ in range(200):
        true, std, x = machines(rng, n, spread)
        low, high = number(x, std).interval_95
        within += low <= true[-1] <= high
    assert within >= 182


def test_equal_machines_are_rarely_said_to_differ():
    rng = np.random.default_rng(3)
    said = 0
    for _ in range(300):
        _, std, x = machines(rng, 6, spread=0.0)
        said += number(x, std).differs
    assert said <= 9  # 3 expected at 1 %


def test_the_spread_and_the_mean_come_back_from_many_machines():
    rng = np.random.default_rng(5)
    _, std, x = machines(rng, 200, spread=1.5)
    found = number(x, std)
    assert found.spread == pytest.approx(1.5, abs=0.3)
    assert abs(found.mean - 3.0) < 4 * found.std < 1.0
    assert found.differs


def test_the_machine_that_is_off_is_named():
    found = number([1.0, 1.1, 0.9, 4.0, 1.0], [0.1] * 5)
    assert found.differs and found.furthest == "machine 3"


@settings(max_examples=60, deadline=None)
@given(
    x=st.lists(st.floats(-1e3, 1e3), min_size=FEWEST, max_size=8),
    factor=st.floats(1e-6, 1e6),
    shift=st.floats(-1e3, 1e3),
    data=st.data(),
)
def test_units_and_zeros_change_nothing_but_themselves(x, factor, shift, data):
    one = st.floats(0.1, 10.0)
    std = np.array(data.draw(st.lists(one, min_size=len(x), max_size=len(x))))
    x = np.array(x)
    first, moved = number(x, std), number(factor * (x + shift), factor * std)
    size = factor * (np.std(x) + np.max(std))
    assert moved.mean == pytest.approx(factor * (first.mean + shift), abs=1e-6 * size)
    assert moved.std == pytest.approx(factor * first.std, abs=1e-6 * size)
    assert moved.spread == pytest.approx(factor * first.spread, abs=1e-6 * size)


def test_a_range_stays_within_the_bounds_of_its_number():
    found = number([0.1, 0.2, 2.0], [0.05] * 3, bounds=(0.0, np.inf))
    assert found.interval_95[0] == 0.0 < found.interval_95[1]


def test_a_number_above_zero_differs_by_factors():
    x, bounds = np.array([0.10, 0.11, 0.10, 0.16]), (1e-7, 1e5)
    low, high = number(x, 0.001 * x, bounds=bounds).interval_95
    assert 0.02 < low < 0.10 and 0.16 < high < 0.6
    grams = number(1000 * x, x, bounds=(1e-4, 1e8))
    assert grams.interval_95 == pytest.approx((1000 * low, 1000 * high), rel=1e-6)


def recorded(folder, inertia: float, seed: int) -> None:
    """A joint with this inertia (kg m^2), viscous friction 0.4 N m s/rad, by SciPy."""
    t = np.arange(300) / 100

    def torque(s):
        return 2 * np.sin(2 * np.pi * 0.7 * s) + 1.5 * np.sin(2 * np.pi * 1.9 * s + 1)

    u = torque(t)

    def equation(s, y):
        return [y[1], (u[min(int(s * 100), 299)] - 0.4 * y[1]) / inertia]

    run = solve_ivp(equation, (0, t[-1]), [0.0, 0.0], t_eval=t, max_step=0.002)
    q = run.y[0] + 1e-3 * np.random.default_rng(seed).standard_normal(300)
    folder.mkdir()
    np.savetxt(folder / "run.csv", np.c_[t, u, q], delimiter=",", header="t,tau,q", comments="")
    (folder / "dataset.toml").write_text(
        f'name = "{folder.name}"\n[model]\nname = "joint"\n'
        "[channels.tau]\nrole = 'input'\nunit = 'N m'\n"
        "[channels.q]\nrole = 'output'\nunit = 'rad'\nnoise_std = 1e-3\n"
        "[[experiments]]\nfile = 'run.csv'\nat_rest = true\n"
    )


def test_a_study_tells_what_its_machines_have_in_common(tmp_path):
    true = {"red": 0.10, "green": 0.11, "blue": 0.10, "black": 0.16}
    for k, (name, inertia) in enumerate(true.items()):
        recorded(tmp_path / name, inertia, seed=k)
    study = tmp_path / "study.toml"
    names = json.dumps(list(true))
    study.write_text(
        f'name = "fleet"\nstore = "out"\n[[runs]]\ncommand = "fit"\ndatasets = {names}\n'
    )
    assert run_study(study, workers=1).complete
    (kind,) = json.loads((tmp_path / "out" / "machines.json").read_text())["kinds"]
    assert set(kind["machines"]) == set(true) and kind["model"] == "joint"
    inertia, viscous = kind["numbers"]["inertia"], kind["numbers"]["viscous"]
    for name, value in true.items():
        each = inertia["each"][name]
        assert abs(each["value"] - value) < 5 * each["std"] + 0.002
    assert inertia["by_chance"] < 1e-6 < viscous["by_chance"]
    low, high = inertia["interval_95"]
    assert low < 0.10 and high > 0.16
    page = (tmp_path / "out" / "report.html").read_text()
    assert "What machines have in common" in page and "furthest: black" in page
