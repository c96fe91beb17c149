"""The core as users of optimistix, diffrax and blackjax meet it: each test is what one of them
would write.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from click.testing import CliRunner

import jaxid
from jaxid.cli.app import main
from jaxid.cli.compare import compare as compare_command
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.dry_friction import solve_dry
from jaxid.dynamics.effect import Command, InputEffect
from jaxid.dynamics.parameter import param, TORQUE
from jaxid.fitters import DifferentialEvolution, FITTERS, Optimistix
from jaxid.fitters.by_name import describe_fitter, fitter_names, fitter_of
from jaxid.fitting.result import EffectEstimate, Estimate
from jaxid.fitting.settings import label_of, split_outside_brackets
from jaxid.models import FlexibleArm, Joint, MODELS, Panda, Pendulum, UR10e
from jaxid.models.effects import ActuatorLag, SensorLag
from jaxid.numerics.precision import float64
from jaxid.numerics.reverse import in_reverse
from jaxid.problem.objective import FunctionProblem
from jaxid.problem.pure_problem import Problem


TRUTH = {"inertia": 0.09, "gravity_torque": 1.4, "viscous": 0.1, "coulomb": 0.2, "offset": 0.02}
NOISE = 1e-3


def as_parameters(numbers: dict[str, float]) -> dict[str, Any]:
    return {"parameters": {name: {"value": value} for name, value in numbers.items()}}


def recorded(
    y: np.ndarray | None = None, u: np.ndarray | None = None, **settings: Any
) -> jaxid.Dataset:
    t = np.arange(0, 1.5, 0.01)
    u = 2.5 * np.sin(6 * t) * (t > 0.1) if u is None else u
    return jaxid.Dataset.from_arrays(
        t,
        {"tau": u},
        {"q": np.sin(t) if y is None else y},
        initial={"q": 0.0, "qd": 0.0},
        noise_std={"q": NOISE},
        model="pendulum",
        **settings,
    )


@pytest.fixture(scope="module")
def data() -> jaxid.Dataset:
    y = jaxid.simulate("pendulum", recorded(), as_parameters(TRUTH)).runs[0]["q"]
    return recorded(y + NOISE * np.random.default_rng(0).normal(size=len(y)))


@pytest.fixture(scope="module")
def problem(data) -> Problem:
    return jaxid.make_problem("pendulum", data)


def central(f: Any, z: Any, h: float = 1e-6) -> np.ndarray:
    return np.array(
        [float(f(z.at[i].add(h)) - f(z.at[i].add(-h))) / (2 * h) for i in range(z.size)]
    )


# ---- a problem


def test_gradients_of_a_problem_agree_with_central_differences(problem):
    with float64():
        z = problem.from_physical(inertia=0.085, gravity_torque=1.3, viscous=0.09, coulomb=0.22)
        loss = jax.jit(problem.loss)
        reverse, forward = jax.jit(jax.grad(problem.loss))(z), jax.jacfwd(problem.loss)(z)
        differences = central(loss, z)
        both = jax.vmap(loss)(jnp.stack([z, z]))
        physical = problem.to_physical(z)
    np.testing.assert_allclose(
        reverse, differences, rtol=1e-6, atol=1e-6 * np.abs(differences).max()
    )
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    assert both[0] == both[1] and physical["coulomb"] == 0.22
    assert problem.names == tuple(TRUTH) and np.all(
        (problem.lower <= problem.z0) & (problem.z0 <= problem.upper)
    )


def test_optimistix_solves_a_problem_to_the_noise(problem):
    with float64():
        solver = optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8)
        found = optimistix.least_squares(problem.residual, solver, jnp.asarray(problem.z0))
        loss, numbers = float(problem.loss(found.value)), problem.to_physical(found.value)
    assert 0.7 < loss < 1.3
    assert {name: float(numbers[name]) for name in TRUTH} == pytest.approx(
        TRUTH, rel=0.05, abs=0.02
    )


def test_a_random_walk_samples_the_posterior(problem):
    with float64():
        density = jax.jit(problem.log_density)
        z0 = problem.from_physical(TRUTH)
        inside, draw, now = 0, np.random.default_rng(1), (z0, density(z0))
        for _ in range(50):
            trial = now[0] + 5e-5 * draw.normal(size=problem.size)
            value = density(trial)
            if np.log(draw.uniform()) < value - now[1]:
                inside, now = inside + 1, (trial, value)
        constant = float(density(z0) + problem.residual(z0) @ problem.residual(z0) / 2)
        outside = float(density(jnp.asarray(problem.upper + 1)))
    assert inside > 5 and outside == -np.inf
    assert constant == pytest.approx(
        -len(problem._weights) * (np.log(NOISE) + np.log(2 * np.pi) / 2)
    )


def test_a_problem_in_float32_says_what_to_type(problem):
    with pytest.raises(jaxid.UsageError, match="jax_enable_x64"):
        problem.loss(problem.z0)
    with float64(), pytest.raises(jaxid.UsageError, match="did you mean 'inertia'"):
        problem.from_physical(inertai=1.0)


def test_a_prior_of_a_parameter_is_in_the_density(problem):
    i = problem.names.index("inertia")
    stated = np.array(problem._prior)
    stated[i] = 0.08, 0.01
    with float64():
        z = problem.from_physical(TRUTH)
        with_prior = replace(problem, _prior=stated)
        gained = float(with_prior.log_density(z) - problem.log_density(z))
    assert gained == pytest.approx(-0.5 - np.log(0.01) - np.log(2 * np.pi) / 2 + np.log(0.09))


@partial(jax.jit, static_argnums=2)
def total_of_dry(x, v, eps):
    """A number that depends on all that two joints with dry friction are solved for."""
    A = jnp.array([[0.5, 0.2], [0.2, 0.4]])
    levels = jnp.array([0.3, 0.1])
    weights = jnp.arange(1.0, 7.0).reshape(3, 2)
    with in_reverse():
        solved = solve_dry(v, x[:2], A * x[2], levels * x[3], levels, jnp.zeros(2), eps)
    return jnp.sum(weights * jnp.stack(solved))


backward_of_dry = jax.jit(jax.grad(total_of_dry), static_argnums=2)
forward_of_dry = jax.jit(jax.jacfwd(total_of_dry), static_argnums=2)


@pytest.mark.parametrize("eps", [0.0, 0.05])
@pytest.mark.parametrize("v0", [[0.5, -0.4], [0.0, 0.02], [0.0, 0.5], [0.0, 0.0]])
def test_sticking_joints_are_differentiable_in_reverse(eps, v0):
    with float64():
        x, v = jnp.array([0.3, -0.2, 1.1, 0.9]), jnp.array(v0)
        backward = backward_of_dry(x, v, eps)
        forward = forward_of_dry(x, v, eps)
        differences = central(lambda at: total_of_dry(at, v, eps), x)
    np.testing.assert_allclose(backward, differences, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(forward, backward, rtol=1e-10, atol=1e-12)


# ---- a differential equation


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(
            m, marks=pytest.mark.slow if m in (UR10e, Panda, FlexibleArm) else (), id=m.name
        )
        for m in MODELS
    ],
)
def test_diffrax_solves_every_model_as_its_own_stepping_does(kind):
    with float64():
        chain = Chain(kind()).smoothed(0.1)
        ode, n = chain.ode(), len(chain.signature.inputs)
        u = jnp.linspace(0.3, 0.1, n)
        args = (ode.parameters, lambda t: u)
        y0 = ode.y0(jnp.full(chain.nq, 0.2), jnp.full(chain.nq, 0.1), args)
        solver = diffrax.Kvaerno5() if chain.mechanism.hidden_states else diffrax.Tsit5()
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(ode),
            solver,
            0.0,
            0.1,
            1e-4,
            y0,
            args,
            max_steps=10**5,
            adjoint=diffrax.ForwardMode(),
            stepsize_controller=diffrax.PIDController(1e-9, 1e-11),
        )
        last = jax.tree.map(lambda a: a[-1], found.ys)
        h = jnp.asarray(
            2e-5 if kind is FlexibleArm else 2e-4
        )  # whose highest modes turn a quarter of the way in the longer one
        body = chain.body().prepare(h)

        def step(carry, k):
            return (
                chain.advance(body, carry, Command(k * h, h, u, u, lambda d: u))[0],
                None,
            )

        start = chain.start(jnp.full(chain.nq, 0.2), jnp.full(chain.nq, 0.1), u, body)
        own = jax.jit(
            lambda start: jax.lax.scan(step, start, jnp.arange(round(0.1 / float(h))))[0]
        )(start).x
        q, qd = body.port(own)
        np.testing.assert_allclose(
            body.port(last)[0], q, atol=2e-6 * max(1.0, float(np.abs(q).max()))
        )
        np.testing.assert_allclose(
            body.port(last)[1], qd, atol=2e-4 * max(1.0, float(np.abs(qd).max()))
        )
        assert ode.outputs(0.1, last, args).shape == (len(chain.signature.outputs),)


def test_gradients_flow_through_parameters_and_input():
    ode = Pendulum().ode(smoothing_velocity=0.1)

    def end(x):
        args = (ode.with_parameters(inertia=x[0]), lambda t: x[1] * jnp.sin(5 * t)[None])
        solved = diffrax.diffeqsolve(
            diffrax.ODETerm(ode),
            diffrax.Tsit5(),
            0.0,
            0.5,
            5e-3,
            ode.y0(0.1, 0.0, args),
            args,
            max_steps=128,
        )
        return jnp.asarray(solved.ys[0])[-1, 0]  # pyright: ignore[reportOptionalSubscript]

    with float64():
        x = jnp.array([0.08, 1.0])
        np.testing.assert_allclose(
            jax.jit(jax.grad(end))(x), central(jax.jit(end), x, 1e-5), rtol=1e-6
        )


def test_an_effect_that_remembers_extends_the_state():
    with float64():
        chain = (
            Chain(Joint()).without("coulomb_friction").with_effects(ActuatorLag(jnp.array([0.05])))
        )
        ode = chain.ode()
        args = (None, lambda t: jnp.ones(1))
        (q, qd), (lagged,) = ode.y0(0.0, 0.0)
        (dq, dqd), (dlagged,) = ode(0.0, ((q, qd), (lagged,)), args)
        moved, _ = ode(0.0, ((q, qd), (lagged + 0.5,)), ({"actuator_lag.lag@tau": 0.05}, args[1]))
    assert dqd[0] == pytest.approx(0.0, abs=1e-6) and dlagged[0] == pytest.approx(20.0, rel=1e-6)
    assert moved[1][0] == pytest.approx(5.0, rel=1e-6)  # half of the command over an inertia of 0.1


def test_friction_that_sticks_and_sensors_with_memory_are_refused():
    with pytest.raises(jaxid.UsageError, match=r"coulomb_friction.*chain.smoothed\(1e-3\)"):
        Pendulum().ode()
    with pytest.raises(jaxid.UsageError, match="sensor_lag"):
        Chain(Pendulum(), smoothing_velocity=0.1).with_effects(SensorLag()).ode()


# ---- solvers of diffrax


def test_a_solver_of_diffrax_checks_the_own_stepping(data):
    model = Chain(Pendulum(), smoothing_velocity=0.05)
    own = jaxid.simulate(model, data)
    other = jaxid.simulate(model, data, solver=diffrax.Tsit5())
    assert (
        other.solver == "diffrax:Tsit5" == other.to_dict()["solver"]
        and own.to_dict()["solver"] == "own"
    )
    np.testing.assert_allclose(own.runs[0]["q"], other.runs[0]["q"], atol=1e-6)
    for wrong, message in (
        ("diffrax:Tsit", "did you mean 'Tsit5'"),
        ("scipy", "diffrax:NAME"),
        (3, "one of diffrax"),
    ):
        with pytest.raises(jaxid.UsageError, match=message):
            jaxid.simulate(model, data, solver=wrong)
    with pytest.raises(jaxid.UsageError, match="true sticking"):
        jaxid.fit("pendulum", data, solver="diffrax:Tsit5")
    with pytest.raises(jaxid.UsageError, match="inverse_dynamics has its own way"):
        jaxid.fit(model, data, solver="diffrax:Tsit5", residual="inverse_dynamics")


@pytest.mark.slow
def test_a_fit_by_a_solver_of_diffrax_finds_the_same(data):
    model = Chain(Pendulum(), smoothing_velocity=0.05)
    own = jaxid.fit(model, data)
    other = jaxid.fit(model, data, solver=diffrax.Tsit5(), fitter="lm(restarts=0)")
    assert other.solver == "diffrax:Tsit5" and other.fitter == "lm(restarts=0)"
    for name, found in own.parameters.items():
        assert (
            found.std is not None
            and abs(other.parameters[name].value - found.value) < 0.1 * found.std
        ), name


# ---- fitters


SLOW = [pytest.param(f"optimistix_{m}", marks=pytest.mark.slow) for m in ("dogleg", "bfgs")]


@pytest.mark.parametrize("fitter", ["optimistix_lm", *SLOW])
def test_fitters_of_optimistix_reach_the_noise(data, fitter):
    found = jaxid.fit("pendulum", data, fitter=fitter)
    assert not found.failed and found.loss < 1.3, found.stopped_because
    assert found.parameters["gravity_torque"].value == pytest.approx(1.4, rel=0.05)


def test_the_simplex_of_optimistix_finds_the_bottom_of_a_bent_valley():
    def valley(z):
        return jnp.stack([10 * (z[1] - z[0] ** 2), 1 - z[0]])

    found = fitter_of("optimistix_nelder_mead").minimise(
        FunctionProblem(valley, [-3.0, -3.0], [3.0, 3.0]),
        [np.array([-1.2, 1.0])],
        jax.random.key(0),
    )
    assert found.loss < 1e-6 and found.z == pytest.approx([1.0, 1.0], abs=5e-3), found


@pytest.mark.slow
def test_any_solver_of_optimistix_is_a_fitter(data):
    solver = optimistix.GaussNewton(rtol=1e-8, atol=1e-8)
    found = jaxid.compare(
        "pendulum", data, fitters=[Optimistix(solver), "lm"], seeds=1, starts="guess"
    )
    assert {r.fitter: r.loss < 1.3 for r in found.runs} == {"optimistix": True, "lm": True}
    frame = found.to_frame()
    assert list(frame["fitter"]) == ["optimistix", "lm"] and not any(frame["inertia"].isna())


def test_settings_of_a_fitter_are_written_as_a_text():
    made = fitter_of("de(popsize=20, F=0.5, CR=0.8, strategy='best/1')")
    assert made == DifferentialEvolution(20, F=(0.5, 0.5), CR=0.8, strategy="best/1")
    assert (
        label_of(made) == "de(popsize=20, F=(0.5, 0.5), CR=0.8, strategy='best/1')"
        and fitter_of(label_of(made)) == made
    )
    assert (
        label_of(fitter_of("hybrid(population='shade(popsize=8)', rounds=2)"))
        == "hybrid(Shade, rounds=2)"
    )
    assert split_outside_brackets("lm, de(popsize=20, F=(0.5, 0.9)),pso") == (
        "lm",
        "de(popsize=20, F=(0.5, 0.9))",
        "pso",
    )


@pytest.mark.parametrize(
    "text, message",
    [
        ("de(popsiz=20)", "did you mean 'popsize'"),
        ("de(popsize=2.5)", "a whole number"),
        ("de(popsize=3)", "at least 4"),
        ("de(CR=1e999)", "at most 1"),
        ("de(popsize=__import__('os').getpid())", "not a number"),
        ("de(20)", "looks like de"),
        ("de(popsize=20", "looks like de"),
        ("de(strategy='none')", "rand/1"),
        ("hybrid(population='lm')", "it is a population"),
        ("dee(popsize=20)", "there is no fitter 'dee'"),
    ],
)
def test_wrong_settings_are_refused(text, message):
    with pytest.raises(jaxid.UsageError, match=message):
        fitter_of(text)


def test_every_setting_has_a_meaning_and_can_be_given():
    for name in fitter_names():
        for setting in describe_fitter(name).settings:
            assert setting.meaning, f"{name}: {setting.name}"
        assert fitter_of(f"{name}()") == next(f for f in FITTERS if f.name == name)()


def test_the_command_line_takes_settings(data, tmp_path, capsys):
    jaxid.save_dataset(data, tmp_path / "data")
    run = [
        "fit",
        str(tmp_path / "data"),
        "--out",
        str(tmp_path / "out"),
        "--quiet",
        "--fitter",
        "lm(restarts=0, iterations=9)",
    ]
    assert main(run) == 0
    assert (
        json.loads((tmp_path / "out" / "fit.json").read_text())["fitter"]
        == "lm(restarts=0, iterations=9)"
    )
    assert main([*run[:-1], "de(popsize=1)"]) == 2 and "at least 4" in capsys.readouterr().err
    assert main(["fitters", "de"]) == 0 and "members of the population" in capsys.readouterr().out
    assert "F,…" in CliRunner().invoke(compare_command, ["--help"]).output


# ---- results, and effects of one's own


class Droop(InputEffect):
    """A drive that loses a share of the square of its command."""

    name: ClassVar[str] = "my_droop"
    equation: ClassVar[str] = "u -> u - share u |u|"
    signature: ClassVar[str] = "missing torque with the square of the command"
    source: ClassVar[str] = "made up"
    excitation: ClassVar[str] = "large commands"
    probes: ClassVar[tuple] = ({"share": 0.1 / TORQUE},)
    share: Any = param(0.0, 0.0, 0.5 / TORQUE, scale=0.02 / TORQUE, unit="1/({u})", meaning="share")

    def start(self, u):
        return ()

    def __call__(self, u, s, z):
        return u - self.share * u * jnp.abs(u), z


def test_a_fit_gives_its_model_and_a_table(data):
    fit = jaxid.fit("pendulum", data)
    zone = EffectEstimate("dead_zone", "tau", {"width": Estimate(0.1, 0.01, "N m", 0.0, 1.0)})
    assert list(replace(fit, effects=(zone,)).to_frame()["parameter"]) == [
        *TRUTH,
        "dead_zone.width@tau",
    ]
    again, before = jaxid.simulate(fit.chain, data), jaxid.simulate(None, data, parameters=fit)
    np.testing.assert_allclose(again.runs[0]["q"], before.runs[0]["q"], atol=1e-12)
    with pytest.warns(DeprecationWarning, match=r"jaxid.simulate\(model, dataset"):
        old = jaxid.simulate(fit, data)  # pyright: ignore[reportArgumentType]
    np.testing.assert_array_equal(old.runs[0]["q"], before.runs[0]["q"])


def test_an_effect_of_ones_own_is_a_candidate_that_is_found():
    t = np.arange(0, 8, 0.01)
    u = np.concatenate([(1 + 0.4 * k) * np.sin((3 + k) * t[:200]) for k in range(4)])

    def free(y):
        return jaxid.Dataset.from_arrays(
            t,
            {"tau": u},
            {"q": y},
            initial={"q": 0.0, "qd": 0.0},
            noise_std={"q": NOISE},
            model="pendulum",
        )

    true = {
        **as_parameters(TRUTH),
        "effects": [{"effect": "supply_droop", "location": "tau", "parameters": {"droop": 0.15}}],
    }
    y = jaxid.simulate("pendulum", free(np.sin(t)), true).runs[0]["q"]
    found = jaxid.diagnose(
        "pendulum",
        free(y + NOISE * np.random.default_rng(0).normal(size=t.size)),
        effects=[Droop(), "dead_zone"],
    )
    assert [str(e) for e in found.which.effects] == ["my_droop at tau"]
    assert found.to_frame()["named"].iloc[0] and found.final.chain is not None
    assert (
        "my_droop" in found.final.chain.contents and "dead_zone" not in found.final.chain.contents
    )


def test_an_effect_with_several_places_asks_for_one():
    from jaxid.models import PlanarArm
    from jaxid.problem.added_effects import parse_effect

    arm = Chain(PlanarArm())
    with pytest.raises(jaxid.UsageError, match="say where, as in dead_zone@"):
        parse_effect("dead_zone", arm)
    assert (
        parse_effect(f"dead_zone@{arm.signature.inputs[1][0]}", arm)[1]
        == arm.signature.inputs[1][0]
    )
    with pytest.raises(jaxid.UsageError, match="has the name 'dead_zone'"):
        parse_effect(type("Mine", (Droop,), {"name": "dead_zone"}), arm)


def test_tables_without_pandas_say_what_to_install(monkeypatch):
    from jaxid.base.frames import frame

    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(jaxid.UsageError, match="pip install pandas"):
        frame([], ())
