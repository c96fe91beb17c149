"""Fits on data of separately written equations: what comes back, with what certainty, by which
method.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import jaxid
import reference as ref
from jaxid.data.dataset import ModelSpec, ParameterPrior
from jaxid.fitters import DifferentialEvolution, FITTERS, LevenbergMarquardt
from jaxid.fitting.covariance import covariance
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.binding import bind
from jaxid.problem.objective import FunctionProblem
from jaxid.problem.problem import PENALTY, rows
from jaxid.problem.residual import OutputError


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from jaxid.benchmark import numpy_twin as twins, plants  # noqa: E402


NOISE = 1e-3
PENDULUM = {
    "inertia": 0.06,
    "gravity_torque": 1.3,
    "viscous": 0.04,
    "coulomb": 0.12,
    "offset": -0.03,
}
JOINT = {"inertia": 0.12, "viscous": 0.3, "coulomb": 0.15, "offset": 0.02}
SLIDE = {"inertia": 4.0, "viscous": 9.0, "coulomb": 5.0, "offset": -0.6}


def truth_of(values: dict[str, float]) -> ref.Truth:
    return ref.Truth(viscous=values["viscous"], coulomb=values["coulomb"], offset=values["offset"])


def recording(
    values,
    plant,
    names=("tau", "q"),
    amplitude=1.0,
    noise=NOISE,
    seeds=(0,),
    seconds=4.0,
    **settings,
):
    """One dataset of runs at 100 Hz, each with another command and noise."""
    t = np.arange(round(seconds * 100) + 1) * 0.01
    us, ys = [], []
    for seed in seeds:
        u = ref.multisine(t, [amplitude], seed, periods=2)
        u[:20] = 0.0
        q, _ = ref.simulate(plant, truth_of(values), t, u)
        us.append(u[:, 0])
        ys.append(ref.measured(q[:, 0], noise, 100 + seed))
    one = len(seeds) == 1
    settings = {"at_rest": True, "check_model": False, "noise_std": {names[1]: noise}} | settings
    return jaxid.Dataset.from_arrays(
        t if one else [t] * len(seeds),
        {names[0]: us[0] if one else us},
        {names[1]: ys[0] if one else ys},
        **settings,
    )


def near(fit: jaxid.Fit, truth: dict[str, float], sigmas: float = 4.0) -> None:
    for name, value in truth.items():
        p = fit.parameters[name]
        assert p.std is not None and p.std > 0 and p.identifiable
        assert abs(p.value - value) <= sigmas * p.std, (name, p.value, value, p.std)


@pytest.fixture(scope="module")
def swing():
    """Recording of the driven pendulum."""
    known = {
        "inertia": (0.01, 0.5),
        "gravity_torque": (0.1, 5.0),
        "viscous": (0.0, 1.0),
        "coulomb": (0.0, 1.0),
    }
    known["offset"] = (-0.5, 0.5)
    model = ModelSpec(
        "pendulum", parameters={k: ParameterPrior(None, *v) for k, v in known.items()}
    )
    return recording(
        PENDULUM, ref.pendulum(PENDULUM["inertia"], PENDULUM["gravity_torque"]), model=model
    )


@pytest.fixture(scope="module")
def problem(swing):
    binding = bind(None, swing)
    return ProblemBuilder(binding).problem(OutputError(), "fit", binding.free, binding.theta)


# ---- recovery


def test_pendulum(swing):
    fit = jaxid.fit(None, swing)
    assert fit.converged and not fit.failed and 0.8 < fit.loss < 1.2
    near(fit, PENDULUM)
    assert fit.scores["validation"]["q"].rmse < 1.3 * NOISE
    assert fit.compile_time_s >= 0 and fit.evaluations > 0


def test_a_recording_that_is_not_for_fitting_can_be_simulated(swing):
    alone = dataclasses.replace(
        swing, experiments=tuple(dataclasses.replace(e, split="report") for e in swing.experiments)
    )
    known = {"parameters": {k: {"value": v} for k, v in PENDULUM.items()}}
    assert jaxid.simulate(None, alone, known).rmse[0]["q"] < 1.3 * NOISE


def test_rotary_and_linear_joint():
    rotary = recording(JOINT, ref.joint(JOINT["inertia"]), model="joint")
    near(jaxid.fit(None, rotary), JOINT)
    slide = recording(
        SLIDE, ref.joint(SLIDE["inertia"]), ("force", "position"), 30.0, model="joint"
    )
    fit = jaxid.fit(None, slide)
    near(fit, SLIDE)
    assert fit.parameters["inertia"].unit == "kg" and fit.parameters["viscous"].unit == "N s/m"


@pytest.mark.slow
def test_planar_arm():
    """Its base parameters: with the lengths and the two centres of mass known, all others are
    determined.
    """
    t = np.arange(401) * 0.01
    u = ref.multisine(t, [14.0, 4.0], 3, periods=2)
    q, _ = ref.simulate(
        ref.planar_arm(m1=3.6, I2=0.06),
        ref.Truth(viscous=np.array([1.0, 0.5]), coulomb=np.array([2.0, 0.5])),
        t,
        u,
    )
    data = jaxid.Dataset.from_arrays(
        t,
        {"tau1": u[:, 0], "tau2": u[:, 1]},
        {f"q{j + 1}": ref.measured(q[:, j], NOISE, j) for j in range(2)},
        at_rest=True,
        noise_std={"q1": NOISE, "q2": NOISE},
        model=ModelSpec(
            "planar_arm",
            constants={"c1": 0.25, "c2": 0.2, "I1": 0.12},
            parameters={"m1": ParameterPrior(4.0), "m2": ParameterPrior(2.2)},
        ),
    )
    fit = jaxid.fit(None, data, fitter=LevenbergMarquardt(restarts=0))
    truth = {
        "m1": 3.6,
        "m2": 2.5,
        "I2": 0.06,
        "viscous1": 1.0,
        "viscous2": 0.5,
        "coulomb1": 2.0,
        "coulomb2": 0.5,
    }
    near(fit, truth)
    assert set(fit.parameters) == set(truth)


def test_several_experiments_with_constants_of_their_own():
    """Two runs with different known gravity torques share all other parameters."""
    t = np.arange(301) * 0.01
    us, ys = [], []
    for k, gravity in enumerate((1.3, 2.1)):
        u = ref.multisine(t, [1.0], k, periods=2)
        u[:20] = 0.0
        q, _ = ref.simulate(ref.pendulum(0.06, gravity), truth_of(PENDULUM), t, u)
        us.append(u[:, 0])
        ys.append(ref.measured(q[:, 0], NOISE, k))
    data = jaxid.Dataset.from_arrays(
        [t, t],
        {"tau": us},
        {"q": ys},
        at_rest=True,
        noise_std={"q": NOISE},
        model=ModelSpec("pendulum", constants={"gravity_torque": 1.3}),
        constants=[{}, {"gravity_torque": 2.1}],
    )
    fit = jaxid.fit(None, data)
    assert "gravity_torque" not in fit.parameters
    near(fit, {k: v for k, v in PENDULUM.items() if k != "gravity_torque"})

    # Free in the fit, the number is the record's own where the record states it.
    binding = bind(None, data)
    free = [*binding.free, binding.layout.index("gravity_torque")]
    problem = ProblemBuilder(binding).problem(OutputError(), "fit", free, binding.theta)
    z = 0.9 * problem.z(binding.theta)
    residual = np.concatenate(problem.residuals(z))
    assert problem.loss(z) == pytest.approx(np.mean(residual**2), rel=1e-12)


def test_residuals_agree(swing):
    for residual in ("multiple_shooting", "inverse_dynamics"):
        fit = jaxid.fit(None, swing, residual=residual)
        for name in ("inertia", "gravity_torque"):
            assert fit.parameters[name].value == pytest.approx(PENDULUM[name], rel=0.02)
        for trace in fit.traces:  # the picture shows what was compared
            rms = np.sqrt(np.mean((trace.measured - trace.simulated["fit"]) ** 2))
            assert trace.windows and rms == pytest.approx(
                fit.scores[trace.split]["q"].rmse, rel=1e-6
            )
        assert bool(fit.traces) == (residual == "multiple_shooting")


# ---- what the data do not determine, bounds


def free_swing(**model) -> jaxid.Dataset:
    t = np.arange(401) * 0.01
    q, _ = ref.simulate(
        ref.pendulum(0.06, 1.3),
        ref.Truth(viscous=0.01, coulomb=0.02),
        t,
        np.zeros((401, 0)),
        1.2,
        0.0,
        nq=1,
    )
    return jaxid.Dataset.from_arrays(
        t,
        {},
        {"q": ref.measured(q[:, 0], NOISE, 5)},
        noise_std={"q": NOISE},
        model=ModelSpec("pendulum", free=True, **model),
    )


def test_free_motion_shows_ratios_only():
    fit = jaxid.fit(None, free_swing(), without=["constant_torque"])
    assert [p.std for p in fit.parameters.values()] == [None] * 4
    assert not any(p.identifiable for p in fit.parameters.values())
    assert fit.to_dict()["parameters"]["inertia"]["std"] is None
    ratio = fit.parameters["gravity_torque"].value / fit.parameters["inertia"].value
    assert ratio == pytest.approx(1.3 / 0.06, rel=1e-3)


def test_free_motion_with_known_inertia():
    fit = jaxid.fit(None, free_swing(constants={"inertia": 0.06}))
    near(fit, {"gravity_torque": 1.3, "viscous": 0.01, "coulomb": 0.02, "offset": 0.0})


def test_a_parameter_at_its_bound_is_named(swing):
    spec = ModelSpec("pendulum", parameters={"viscous": ParameterPrior(0.01, 0.0, 0.02)})
    data = jaxid.Dataset(**{**swing.__dict__, "model": spec})
    fit = jaxid.fit(None, data)
    p = fit.parameters["viscous"]
    assert p.at_bound and p.value == pytest.approx(0.02)
    assert any("viscous" in note and "bound" in note for note in fit.notes)
    assert p.lower == 0.0 and p.upper == 0.02
    assert not fit.parameters["inertia"].at_bound


def test_a_prior_outside_its_bounds_is_refused(swing):
    spec = ModelSpec("pendulum", parameters={"viscous": ParameterPrior(0.5, 0.0, 0.02)})
    with pytest.raises(jaxid.UsageError, match="viscous"):
        jaxid.fit(None, jaxid.Dataset(**{**swing.__dict__, "model": spec}))


# ---- one loss for all methods


def test_loss_is_the_same_number_in_every_batch(problem):
    rng = np.random.default_rng(0)
    low, high = problem.lower, problem.upper
    z0 = problem.z(problem.base)
    z = np.clip(z0 + 0.05 * rng.normal(size=(37, problem.size)) * np.abs(z0), low, high)
    alone = np.array([problem.loss(x) for x in z])
    assert np.array_equal(problem.losses(z), alone)
    assert np.array_equal(problem.losses(z[5:22]), alone[5:22])
    assert np.array_equal(problem.losses(z[::-1]), alone[::-1])
    assert len(np.unique(alone)) == len(alone)


@pytest.mark.parametrize(("order", "error"), [(1, 1e-5), (2, 1e-6)])
def test_differences_agree_with_tangents(swing, order, error):
    """Also of a start, of a logarithm and at a bound; the residual is the same number."""
    free_start = dataclasses.replace(
        swing, experiments=tuple(dataclasses.replace(e, at_rest=False) for e in swing.experiments)
    )
    binding = bind(None, free_start)
    bench = ProblemBuilder(binding)
    exact = bench.problem(OutputError(), "fit", binding.free, binding.theta)
    twin = dataclasses.replace(bench, differences=order).problem(
        OutputError(), "fit", binding.free, binding.theta
    )
    rng = np.random.default_rng(0)
    z = exact.lower + rng.uniform(0.2, 0.8, exact.size) * (exact.upper - exact.lower)
    z[exact.names.index("viscous")] = exact.upper[exact.names.index("viscous")]
    assert exact.size > exact.free.size and exact.log.any()
    a, b = next(rows([(exact, z)])), next(rows([(twin, z)]))
    assert np.array_equal(a.r, b.r) and a.z_columns == b.z_columns
    size = np.linalg.norm(a.J, axis=(0, 1))
    assert (size > 0).all() and np.all(np.linalg.norm(a.J - b.J, axis=(0, 1)) < error * size)
    assert twin.precise().differences == 2 and exact.precise().differences == 0


def test_gradient_method_and_population_reach_the_same_minimum(problem):
    key = jax.random.key(0)
    guess = [problem.z(problem.base)]
    lm = LevenbergMarquardt().minimise(problem, guess, key)
    de = DifferentialEvolution(popsize=40, generations=350, strategy="best/1").minimise(
        problem, guess, key
    )
    print("loss by lm and de:", lm.loss, de.loss)
    assert lm.loss == problem.loss(lm.z) and de.loss == problem.loss(de.z)
    assert abs(lm.loss - de.loss) <= 1e-6 * lm.loss


def test_divergent_candidates_disturb_nobody(problem):
    """A tenth of a population diverges: the others get the same numbers to the last bit, at no more
    than three times the cost.
    """
    rng = np.random.default_rng(1)
    z0 = problem.z(problem.base)
    healthy = np.clip(
        z0 * (1 + 0.02 * rng.normal(size=(160, problem.size))), problem.lower, problem.upper
    )
    mixed = healthy.copy()
    bad = np.arange(0, 160, 10)
    mixed[bad] = np.nan
    mixed[bad[::2]] = 1e308
    clean, dirty = problem.losses(healthy), problem.losses(mixed)
    kept = np.setdiff1d(np.arange(160), bad)
    assert np.array_equal(clean[kept], dirty[kept])
    assert np.all(dirty[bad] >= PENALTY) and np.all(np.isfinite(dirty))

    def cost(z):
        times = []
        for _ in range(5):
            began = time.process_time()
            problem.losses(z)
            times.append(time.process_time() - began)
        return min(times)

    ratio = cost(mixed) / cost(healthy)
    print("cost of a population with 10 % divergent candidates:", ratio)
    assert ratio <= 3


@pytest.mark.parametrize("kind", FITTERS, ids=lambda k: k.name)
def test_fitters_keep_bounds_and_repeat(problem, kind):
    fields = {f.name for f in dataclasses.fields(kind)}
    if not {"popsize", "restarts"} & fields:
        pytest.skip("not a search: models linear in their parameters only")
    small = {
        k: v
        for k, v in {
            "popsize": 16,
            "generations": 10,
            "restarts": 2,
            "iterations": 6,
            "steps": 200,
        }.items()
        if k in fields
    }
    for seed in (0, 1):
        found = [
            kind(**small).minimise(problem, [problem.z(problem.base)], jax.random.key(seed))
            for _ in range(2)
        ]
        assert np.array_equal(found[0].z, found[1].z) and found[0].loss == found[1].loss
        assert np.all((found[0].z >= problem.lower) & (found[0].z <= problem.upper))
        losses = [loss for _, loss in found[0].history]
        assert all(b <= a for a, b in zip(losses, losses[1:], strict=False))


# ---- precision


def test_a_float32_program_beside_a_fit_is_unchanged(swing):
    """A fit computes in float64 and leaves neither the setting nor the numbers of the program
    around it changed.
    """
    before = {
        k: getattr(jax.config, k)
        for k in ("jax_enable_x64", "jax_platforms", "jax_default_matmul_precision")
    }
    f = jax.jit(lambda x: jnp.sin(x) @ x)
    x = jnp.linspace(0, 1, 100)
    first = f(x)
    assert first.dtype == jnp.float32
    jaxid.fit(None, swing, fitter=LevenbergMarquardt(restarts=0))
    assert jnp.linspace(0, 1, 3).dtype == jnp.float32
    assert f(x).dtype == jnp.float32 and np.array_equal(first, f(x))
    assert before == {k: getattr(jax.config, k) for k in before}


@pytest.mark.slow
def test_a_part_cut_from_a_run_starts_with_what_effects_remember():
    """A slow drive under a steep command: what it still delivers at the cut is nothing that the
    part's own samples show.
    """
    t = np.arange(801) * 0.005
    u = ref.multisine(t, [1.5], 3, periods=3, lines=12)
    u[:20] = 0.0
    q, _ = ref.simulate(
        ref.joint(JOINT["inertia"]), ref.Truth(viscous=JOINT["viscous"], lag_s=0.06), t, u
    )
    noise = 2e-5
    data = jaxid.Dataset.from_arrays(
        t,
        {"tau": u[:, 0]},
        {"q": ref.measured(q[:, 0], noise, 1)},
        at_rest=True,
        noise_std={"q": noise},
        model="joint",
    )
    found = jaxid.fit(None, data, effects=["actuator_lag"])
    assert found.effects[0].parameters["lag"].value == pytest.approx(0.06, rel=0.01)
    assert all(
        found.scores[split]["q"].rmse < 1.2 * noise for split in ("fit", "validation", "report")
    )
    blind = [dataclasses.replace(e, past=None) for e in data.with_splits().experiments]
    without = jaxid.fit(
        None, dataclasses.replace(data, experiments=tuple(blind)), effects=["actuator_lag"]
    )
    assert without.scores["validation"]["q"].rmse > 100 * noise  # the test sees the difference


def cut_in_time(
    q: np.ndarray, u: np.ndarray, t: np.ndarray, noise: float, effect: str
) -> jaxid.Fit:
    """A pendulum's one recording from rest, of which the last third is kept for validation and
    report.
    """
    data = jaxid.Dataset.from_arrays(
        t,
        {"tau": u[:, 0]},
        {"q": ref.measured(q, noise, 1)},
        at_rest=True,
        noise_std={"q": noise},
        model="pendulum",
    )
    return jaxid.fit(None, data, effects=[effect])


@pytest.mark.slow
def test_a_part_cut_from_a_run_starts_before_its_sensor():
    """What was measured has gone through the sensor already: taken for the motion, it would be late
    twice.
    """
    t, lag, noise = np.arange(1001) * 0.005, 0.02, 1e-4
    u = ref.multisine(t, [0.5], 3, periods=3, lines=8)
    u[:20] = 0.0
    q, _ = ref.simulate(ref.pendulum(0.06, 0.9), ref.Truth(viscous=0.03, coulomb=0.04), t, u)
    motion = CubicSpline(t, q[:, 0])
    read = solve_ivp(
        lambda t, y: (motion(t) - y) / lag,
        (0, t[-1]),
        [0.0],
        t_eval=t,
        rtol=1e-9,
        atol=1e-10,
        max_step=0.005,
    ).y[0]
    found = cut_in_time(read, u, t, noise, "sensor_lag")
    assert found.effects[0].parameters["lag"].value == pytest.approx(lag, rel=0.02)
    assert found.scores["fit"]["q"].rmse < 1.1 * noise
    assert all(
        found.scores[split]["q"].rmse < 1.2 * noise for split in ("validation", "report")
    )  # 4500 where it is late twice


@pytest.mark.slow
def test_a_part_cut_from_a_run_knows_how_its_spring_is_twisted():
    """A link behind a spring swings on as it did: it follows the measured motor up to the cut."""
    plant = dataclasses.replace(plants.PLANTS["pendulum"], resolution=0.0, noise=0.0)
    t, noise = np.arange(1600) * 0.005, 3e-4
    u = ref.multisine(t, [0.5], 3, periods=3, lines=8)
    own = {
        "compliance": np.array([0.06]),
        "motor_share": np.array([0.4]),
        "spring_damping": np.array([0.1]),
    }
    q = twins.recorded(
        plant,
        u[None],
        {k: np.atleast_2d(x) for k, x in (plant.nominal | own).items()},
        np.random.default_rng(0),
    )[0, :, 0]
    found = cut_in_time(q, u, t, noise, "joint_elasticity")
    assert found.effects[0].parameters["compliance"].value == pytest.approx(0.06, rel=0.02)
    assert all(
        found.scores[split]["q"].rmse < 1.2 * noise for split in ("fit", "validation", "report")
    )


def test_a_number_whose_derivative_is_undefined_has_no_deviation(monkeypatch):
    """At its neutral value, say; the others keep theirs."""
    problem = FunctionProblem(
        lambda z: 1e2 * jnp.stack([z[0] - 1, 2 * z[0] - 2, z[0] + z[1] - 1]), [-5.0] * 2, [5.0] * 2
    )

    def broken(jobs):
        return (part._replace(J=np.where([False, True], np.nan, part.J)) for part in rows(jobs))

    monkeypatch.setattr("jaxid.fitting.covariance.rows", broken)
    found = covariance(cast(Any, problem), np.array([1.0, 0.0]))
    assert found.identifiable.tolist() == [True, False] and np.isnan(found.std[1])
    assert found.std[0] == pytest.approx(1e-2 / np.sqrt(6), rel=1e-6)
