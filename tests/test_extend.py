"""A mechanism, an effect with a state, and two fitters, written from outside: what a user adds in
one file each.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from jaxtyping import Array, Float

import jaxid
import reference as ref
from jaxid.dynamics.effect import InputEffect
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import DURATION, param
from jaxid.fitting.fitter import AbstractFitter, Minimum
from jaxid.fitting.population import AbstractPopulation
from jaxid.models.effects import CoulombFriction, ViscousFriction
from jaxid.numerics.precision import float64


# ---- a mechanism


class SpringCart(Rigid):
    """A cart on a rail, tied to the wall by a spring."""

    name: ClassVar[str] = "spring_cart"
    signatures: ClassVar[tuple] = (
        Signature((("force", "N"),), (("position", "m"),), ("position",), linear=True),
    )
    builtin: ClassVar[tuple] = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
    )
    equations: ClassVar[str] = "mass qdd + stiffness q + viscous qd + coulomb sign(qd) = force"
    source: ClassVar[str] = "textbook"

    mass: Array = param(1.0, 1e-3, 1e3, unit="{I}", meaning="mass of the cart", log=True)
    stiffness: Array = param(10.0, 0.0, 1e4, unit="{F}/{X}", meaning="stiffness of the spring")

    def matrices(self, q, qd):
        return self.mass[None, None], self.stiffness * q


# ---- an effect that remembers


class ActuatorLag(InputEffect):
    """A drive of first order; its state follows the exact solution for a command that is held over
    the step.
    """

    name: ClassVar[str] = "actuator_lag"
    equation: ClassVar[str] = "lag du'/dt = u - u'"
    signature: ClassVar[str] = "phase lag and loss of gain towards high frequency"
    source: ClassVar[str] = "textbook"
    excitation: ClassVar[str] = "steps of the command"
    probes: ClassVar[tuple] = ({"lag": 0.003}, {"lag": 0.03})
    lag: Array = param(
        0.0, 0.0, 0.1 * DURATION, scale=0.01, unit="s", meaning="time constant of the drive"
    )

    def start(self, u):
        return u

    def __call__(self, u, s, z):
        present = self.lag > 0
        lag = jnp.where(present, self.lag, 1.0)
        share = jnp.exp(-s.h / lag)
        mean = u + (z - u) * lag / s.h * (1 - share)
        return jnp.where(present, mean, u), jnp.where(present, u + (z - u) * share, u)


# ---- fitters


class Best(NamedTuple):
    z: Float[Array, " dim"]
    loss: Float[Array, ""]
    radius: Float[Array, ""]


class RandomSearch(AbstractPopulation):
    """Uniform draws in a box around the best point, which shrinks with every generation."""

    name: ClassVar[str] = "random_search"
    source: ClassVar[str] = "textbook"
    popsize: int = 64
    generations: int = 150
    shrink: float = 0.93

    def init(self, key, population, losses):
        i = jnp.argmin(losses)
        return Best(population[i], losses[i], jnp.ones(()))

    def ask(self, key, state, lower, upper):
        step = jax.random.uniform(key, (self.popsize, lower.shape[0]), minval=-0.5, maxval=0.5)
        return state.z + step * state.radius * (upper - lower)

    def tell(self, state, candidates, losses):
        i = jnp.argmin(losses)
        better = losses[i] < state.loss
        return Best(
            jnp.where(better, candidates[i], state.z),
            jnp.where(better, losses[i], state.loss),
            state.radius * self.shrink,
        )

    def spread(self, state):
        return state.radius


class Bfgs(AbstractFitter):
    """BFGS of optimistix, each variable in twentieths of its guess."""

    name: ClassVar[str] = "optimistix_bfgs"
    source: ClassVar[str] = "optimistix"
    steps: int = 100

    def minimise(self, problem, starts, key, budget=None, progress=None, seconds=None):
        low, high, data = problem.lower, problem.upper, problem.data
        scale = 0.05 * np.maximum(np.abs(starts[0]), 1e-3 * (high - low))

        def inside(x):
            return jnp.clip(starts[0] + scale * x, low, high)

        def loss(x, data):
            return problem.pure_losses(inside(x)[None], data)[0]

        with float64():
            solver = optimistix.BFGS(1e-8, 1e-8)
            x0 = jnp.zeros(problem.size)
            found = optimistix.minimise(
                loss,
                solver,
                x0,
                data,
                options={"autodiff_mode": "fwd"},
                max_steps=self.steps,
                throw=False,
            )
            z = np.asarray(inside(found.value))
        done = bool(found.result == optimistix.RESULTS.successful)
        return Minimum(
            z,
            problem.loss(z),
            done,
            "tolerance" if done else "step limit",
            int(found.stats["num_steps"]),
        )


# ---- used in fits


NOISE = 2e-4
TRUTH = {"mass": 2.0, "stiffness": 40.0, "viscous": 1.5, "coulomb": 0.6}


def recording(lag: float = 0.0, seconds: float = 4.0) -> jaxid.Dataset:
    t = np.arange(round(seconds / 0.01) + 1) * 0.01
    u = ref.multisine(t, [14.0], 1, periods=2, lines=8)
    u[:20] = 0.0
    truth = ref.Truth(viscous=TRUTH["viscous"], coulomb=TRUTH["coulomb"], lag_s=lag)
    q, _ = ref.simulate(ref.spring_cart(TRUTH["mass"], TRUTH["stiffness"]), truth, t, u)
    y = ref.measured(q[:, 0], NOISE, 3)
    return jaxid.Dataset.from_arrays(
        t,
        {"force": u[:, 0]},
        {"position": y},
        units={"force": "N", "position": "m"},
        noise_std={"position": NOISE},
        at_rest=True,
        check_model=False,
    )


@pytest.fixture(scope="module")
def plain():
    return recording()


@pytest.fixture(scope="module")
def lagging():
    return recording(0.03, 8.0)


def near(fit: jaxid.Fit, truth: dict[str, float], sigmas: float = 4.5) -> None:
    found = dict(fit.parameters) | {
        f"{e.effect}.{k}": p for e in fit.effects for k, p in e.parameters.items()
    }
    for name, value in truth.items():
        p = found[name]
        assert p.std is not None
        assert abs(p.value - value) <= sigmas * p.std, (name, p.value, value, p.std)


def test_a_mechanism_from_outside(plain):
    fit = jaxid.fit(SpringCart(), plain)
    assert fit.converged and 0.8 < fit.loss < 1.2
    near(fit, TRUTH)


def with_lag(lag: float = 0.01) -> jaxid.Chain:
    return jaxid.Chain(SpringCart()).with_effects(ActuatorLag(lag=lag))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    "residual", ["output_error", pytest.param("multiple_shooting", marks=pytest.mark.slow)]
)
def test_an_effect_with_a_state(lagging, residual):
    """Also in windows, whose starts bring the state of the effect along."""
    fit = jaxid.fit(with_lag(), lagging, residual=residual)
    assert 0.8 < fit.loss < 1.2
    near(fit, TRUTH | {"actuator_lag.lag": 0.03})


def test_without_the_lag_the_fit_is_far_off(lagging):
    assert jaxid.fit(SpringCart(), lagging).loss > 5


def test_a_population_fitter_from_outside(plain):
    fit = jaxid.fit(SpringCart(), plain, fitter=RandomSearch(), seed=2)
    assert fit.fitter == "random_search"
    assert fit.scores["fit"]["position"].nrmse < 0.1
    again = jaxid.fit(SpringCart(), plain, fitter=RandomSearch(), seed=2)
    assert fit.loss == again.loss


def test_a_gradient_fitter_from_outside(plain):
    best = jaxid.fit(SpringCart(), plain).loss
    fit = jaxid.fit(SpringCart(), plain, fitter=Bfgs())
    assert fit.loss < (1 + 1e-4) * best


def test_the_lag_is_exact_for_a_held_command(lagging):
    """The neutral lag is bitwise absent, and a step response of the drive follows the
    exponential.
    """
    from simulated import relative, Simulator

    e = lagging.experiments[0]
    chain = with_lag(0.0)
    s = Simulator(chain, e.t, e.u, 1e-3)
    values: dict[str, Any] = {**TRUTH, "coulomb": 0.0}
    bare = Simulator(jaxid.Chain(SpringCart()), e.t, e.u, 1e-3)
    assert np.array_equal(s.outputs([values]), bare.outputs([values]))
    truth = ref.Truth(viscous=TRUTH["viscous"], lag_s=0.03)
    q, _ = ref.simulate(ref.spring_cart(2.0, 40.0), truth, e.t, e.u)
    assert relative(s.outputs([values | {"actuator_lag.lag@force": 0.03}])[0], q) < 2e-6
