"""How fits end, what is known beforehand, what is stated."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxid
from jaxid.base import interim
from jaxid.base.stopping import Interrupted
from jaxid.data.dataset import ModelSpec, ParameterPrior
from jaxid.fitters import DifferentialEvolution, LevenbergMarquardt
from jaxid.fitting import run as fits
from jaxid.fitting.ending import looked_again
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.fitting.problem_builder import default_residual, ProblemBuilder, start_values
from jaxid.problem.binding import bind
from jaxid.problem.objective import FunctionProblem, Linear


@pytest.fixture(scope="module")
def data():
    """A joint of 0.02 kg m^2, 0.03 N m s/rad, 0.05 N m that is pushed back and forth."""
    t = np.arange(0, 6, 0.01)
    u = 0.4 * np.sin(2 * np.pi * 0.4 * t) + 0.2 * np.sin(2 * np.pi * 1.1 * t)
    q, v, out = 0.0, 0.0, []
    for tau in u:
        out.append(q)
        for _ in range(20):
            w = v + 5e-4 * (tau - 0.03 * v) / 0.02
            w = np.sign(w) * max(0.0, abs(w) - 5e-4 * 0.05 / 0.02)
            q, v = q + 5e-4 * (v + w) / 2, w
    y = np.array(out) + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    return jaxid.Dataset.from_arrays(t, {"tau": u}, {"q": y}, noise_std={"q": 1e-3}, at_rest=True)


def fitted(data, **parameters):
    spec = ModelSpec(
        "joint",
        without=("constant_torque",),
        parameters={k: ParameterPrior(**v) for k, v in parameters.items()},
    )
    return jaxid.fit(None, replace(data, model=spec))


def test_a_second_look_is_counted_and_a_budget_without_room_for_it_is_said(data):
    spec = replace(data, model=ModelSpec("joint", without=("constant_torque",)))
    whole = jaxid.fit(None, spec, fitter=jaxid.fitters.LevenbergMarquardt(restarts=0))
    assert whole.state == "converged" and whole.to_dict()["state"] == "converged"
    for budget in (whole.evaluations // 3, 40):
        fit = jaxid.fit(
            None, spec, fitter=jaxid.fitters.LevenbergMarquardt(restarts=0), budget=budget
        )
        assert fit.evaluations <= budget and fit.state in ("budget", "converged")
    assert fit.state == "budget" and not fit.converged and not fit.failed


def test_a_look_at_the_same_minimum_ends_on_the_way_there(data):
    """From a good start a search takes a few steps; a look from beside its end took several times
    as many.
    """
    binding = bind(None, replace(data, model=ModelSpec("joint", without=("constant_torque",))))
    bench = ProblemBuilder(binding)
    guess = start_values(bench, binding.free, 0)[0]
    problem, key = (
        bench.problem(default_residual(binding), "fit", binding.free, guess),
        jax.random.key(0),
    )
    for fitter in (
        LevenbergMarquardt(restarts=0),
        DifferentialEvolution(popsize=8, generations=60),
    ):
        found = fitter.minimise(problem, [problem.z(guess)], key)
        if not found.converged:
            continue
        again = looked_again([(problem, [], key)], [found], fitter, None)[0]
        assert again.converged and again.loss == pytest.approx(found.loss, rel=1e-6)
        assert (
            4 * (1 + problem.size)
            <= again.evaluations - found.evaluations
            <= 6 * (1 + problem.size)
        )


def test_a_look_finds_a_lower_minimum_beside_the_end():
    """Three valleys, 0.4 apart, of which the outer ones are the lower ones."""

    def course(z):
        return jnp.stack(
            [20 * (z[0] - 0.6) * (z[0] - 1.0) * (z[0] - 1.4), 1 - 3 * (z[0] - 1.0) ** 2]
        )

    problem, fitter, key = (
        FunctionProblem(course, [0.0], [2.0]),
        LevenbergMarquardt(restarts=0),
        jax.random.key(0),
    )
    found = fitter.minimise(problem, [np.array([1.05])], key)
    assert found.z[0] == pytest.approx(1.0, abs=0.01)
    again = looked_again([(problem, [], key)], [found], fitter, None)[0]
    assert (
        again.converged
        and again.loss < found.loss / 2
        and abs(again.z[0] - 1.0) == pytest.approx(0.4, abs=0.1)
    )


def test_the_first_descent_is_kept_while_it_is_looked_at(data, monkeypatch):
    spec = replace(data, model=ModelSpec("joint", without=("constant_torque",)))
    whole, told = jaxid.fit(None, spec), []

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(fits, "looked_again", stopped)
    monkeypatch.setattr(fits, "WORTH_SAVING_S", 0.0)
    with interim.listening(told.append), pytest.raises(Interrupted) as stop:
        jaxid.fit(None, spec)
    kept = stop.value.partial
    assert told == [kept] and any("looked at" in n for n in kept.notes)
    assert kept.parameters["inertia"].value == pytest.approx(
        whole.parameters["inertia"].value, rel=1e-3
    )


def test_a_bound_beyond_which_the_loss_falls_stalls_a_fit(data):
    fit = fitted(data, inertia={"value": 0.005, "lower": 0.004, "upper": 0.01})
    assert fit.state == "stalled" and "inertia" in fit.stopped_because and not fit.converged


def test_a_fit_that_keeps_everything_still_has_failed(data):
    fit = fitted(data, coulomb={"value": 5.0, "lower": 4.0, "upper": 6.0})
    assert fit.state == "failed" and "still" in fit.stopped_because


def test_a_prior_pulls_by_its_width_and_is_stated(data):
    free = fitted(data)
    tight = fitted(data, viscous={"prior": {"mean": 0.04, "std": 1e-8}})
    wide = fitted(data, viscous={"prior": {"mean": 0.04, "std": 10.0}})
    own = free.parameters["viscous"]
    assert own.std is not None
    assert (
        tight.parameters["viscous"].value == pytest.approx(0.04, abs=1e-6)
        and (tight.parameters["viscous"].std or 1) < 2e-7
    )
    assert wide.parameters["viscous"].value == pytest.approx(own.value, abs=0.05 * own.std)
    middle = fitted(
        data, viscous={"prior": {"mean": own.value + 2 * own.std, "std": own.std}}
    ).parameters["viscous"]
    assert middle.value == pytest.approx(own.value + own.std, abs=0.2 * own.std)
    assert middle.std == pytest.approx(own.std / np.sqrt(2), rel=0.1)
    assert any("prior of viscous" in note for note in tight.notes)


def test_the_search_scale_is_the_users(data):
    linear = fitted(data, inertia={"log": False})
    assert any("inertia is searched linearly" in note for note in linear.notes)
    assert linear.parameters["inertia"].value == pytest.approx(
        fitted(data).parameters["inertia"].value, rel=1e-4
    )
    with pytest.raises(jaxid.UsageError, match="state `lower` above 0"):
        fitted(data, coulomb={"log": True})


def test_stated_numbers_are_answered(data):
    fit = fitted(data, inertia={"value": 0.06}, viscous={"value": 0.03})
    by_name = {s.parameter: s for s in fit.stated}
    assert (
        by_name["inertia"].refuted
        and (by_name["inertia"].deviation or 0) < -10
        and fit.stated[0].parameter == "inertia"
    )
    assert (
        "your stated inertia 0.0600 kg m^2 is" in by_name["inertia"].text
        and "standard deviations from" in by_name["inertia"].text
    )
    assert not by_name["viscous"].refuted and "agrees" in by_name["viscous"].text
    assert fit.to_dict()["stated"][0]["stated"] == 0.06 and "your stated inertia" in repr(fit)


def test_priors_and_scales_are_saved_and_read(tmp_path, data):
    spec = ModelSpec(
        "joint",
        parameters={"inertia": ParameterPrior(log=False, prior={"mean": 0.02, "std": 0.001})},
    )
    jaxid.save_dataset(replace(data, model=spec), tmp_path / "d")
    read = jaxid.load_dataset(tmp_path / "d").model
    assert read is not None and read.parameters == spec.parameters


def test_a_fast_short_record_is_cut_so_that_every_part_is_judged(recwarn):
    """Half a second at 2 kHz."""
    t = np.arange(1000) * 5e-4
    force = 60 + 80 * np.sin(2 * np.pi * 4 * t)
    v, x, out = 0.0, 0.0, []
    for u in force:
        out.append(x)
        for _ in range(5):
            v += 1e-4 * (u - 30 * v - 15 * np.sign(v or u)) / 20
            x += 1e-4 * v
    y = np.array(out) + 2e-5 * np.random.default_rng(0).standard_normal(len(t))
    fit = jaxid.fit(
        "joint",
        jaxid.Dataset.from_arrays(
            t, {"force": force}, {"position": y}, noise_std={"position": 2e-5}
        ),
    )
    assert all(
        np.isfinite(fit.scores[split]["position"].rmse) for split in ("fit", "validation", "report")
    )
    assert fit.parameters["inertia"].value == pytest.approx(20, rel=0.01)
    assert not [w for w in recwarn if issubclass(w.category, RuntimeWarning)]


def test_a_valley_in_which_steps_gain_nothing_beside_the_noise_is_at_its_end():
    """1000 residuals of about 3 times the noise; every step gains a ten-thousandth of what one of
    them varies by.
    """
    wide = np.full(1, 1e9)
    problem: Any = SimpleNamespace(
        size=1,
        free=np.zeros(1, int),
        log=np.zeros(1, bool),
        lower=-wide,
        upper=wide,
        scale=np.ones(1),
        weighted=True,
        loss_name="sum_of_squares",
    )
    asked = []

    def expansion(jobs, share):
        z = float(jobs[0][1][0])
        asked.append(z)
        return [Linear(9000.0 - 5e-4 * len(asked), np.array([-1e-2]), np.array([[1e-2]]), 1000)]

    for weighted, steps in ((True, 4), (False, 31)):
        problem.weighted = weighted
        asked.clear()
        (path,) = levenberg_marquardt(
            [(problem, np.zeros(1))], 30, 1e-10, expansion=expansion, material=True
        )
        assert len(asked) == steps and path.converged == weighted
