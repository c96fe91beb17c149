# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     name: python3
# ---

# %% [markdown]
# # Write your own model, effect and fitter
#
# Each is one small class. It works at once, without registration; registered in the `__init__.py` of its folder it gets an id that
# every command knows, and the conformance tests run over it.

# %%
from jaxid.runtime import prepare


prepare()

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Array, Float
from scipy.integrate import solve_ivp

import jaxid
from jaxid.dynamics.effect import JointEffect
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import ANGLE, param, TORQUE
from jaxid.fitting.population import AbstractPopulation
from jaxid.models.effects import CoulombFriction, ViscousFriction


# %% [markdown]
# ## A recording
#
# A cart on a rail between two springs, 4 s at 100 Hz, integrated by SciPy. The springs stiffen with the cube of the displacement,
# which the first model will not know.


# %%
def cart(seed: int) -> tuple[np.ndarray, ...]:
    """t (s), force (N), position (m): 2 kg, 40 N/m, 1.5 N s/m, and 900 N/m^3."""
    rng = np.random.default_rng(seed)
    t = np.arange(401) / 100
    f = np.geomspace(0.4, 4.0, 6)
    force = (
        4.0
        * np.sin(2 * np.pi * np.outer(t, f) + rng.uniform(0, 6, 6)).sum(1)
        * np.clip(t / 0.3, 0, 1)
    )
    x, position = np.zeros(2), []
    for u in force:
        position.append(x[0])

        def field(time, s, u=u):
            return [s[1], (u - 40 * s[0] - 900 * s[0] ** 3 - 1.5 * s[1]) / 2]

        x = solve_ivp(field, (0, 0.01), x, rtol=1e-8, atol=1e-10).y[:, -1]
    return t, force, np.array(position) + 1e-4 * rng.standard_normal(t.size)


runs = [cart(seed) for seed in (1, 2, 3)]
data = jaxid.Dataset.from_arrays(
    [t for t, _, _ in runs], {"force": [u for _, u, _ in runs]}, {"position": [y for _, _, y in runs]},
    units={"force": "N", "position": "m"}, noise_std={"position": 1e-4}, at_rest=True,
    split=["fit", "validation", "report"], name="cart", check_model=False,
)  # fmt: skip
ax = data.plot("position")

# %% [markdown]
# ## A model
#
# Mass matrix and forces, parameters with unit, bounds and meaning, and the friction it has by default. Everything else (stepping,
# sticking, derivatives, start values, uncertainty) comes from the base class.


# %%
class SpringCart(Rigid):
    """mass qdd + stiffness q = force - friction."""

    name: ClassVar[str] = "spring_cart"
    signatures: ClassVar = (
        Signature((("force", "N"),), (("position", "m"),), ("position",), linear=True),
    )
    builtin: ClassVar = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
    )
    equations: ClassVar[str] = "mass qdd + stiffness q + viscous qd + coulomb sign(qd) = force"
    source: ClassVar[str] = "textbook"

    mass: Array = param(1.0, 1e-3, 1e3, unit="kg", log=True)
    stiffness: Array = param(50.0, 0.0, 1e5, unit="N/m", scale=10.0)

    def matrices(self, q, qd):
        return self.mass[None, None], self.stiffness * q


fit = jaxid.fit(SpringCart(), data)
fit

# %% [markdown]
# The loss is far above 1: something is missing.
#
# ## An effect
#
# One equation at one place between command and sensor. At its neutral value, here 0, it must change nothing. Bounds, scale and
# probes are multiples of what the data show, so that the same class serves a drive of 60 N and one of 0.1 N m.


# %%
class CubicSpring(JointEffect):
    """A spring that stiffens with the cube of the displacement."""

    name: ClassVar[str] = "cubic_spring"
    equation: ClassVar[str] = "f = coefficient q^3"
    signature: ClassVar[str] = "missing torque at the ends of travel, against the displacement"
    source: ClassVar[str] = "Duffing, 1918"
    excitation: ClassVar[str] = "slow motion over the whole travel, both ways"
    coefficient: Array = param(
        0.0,
        -50 * TORQUE / ANGLE**3,
        50 * TORQUE / ANGLE**3,
        scale=0.05 * TORQUE / ANGLE**3,
        unit="{F}/{X}^3",
    )
    probes: ClassVar = ({"coefficient": 0.1 * TORQUE / ANGLE**3},)

    def start(self, q):  # state at the beginning of a run; () for none
        return ()

    def __call__(self, s, z):  # smooth opposing force, dry level backwards and forwards, state
        return self.coefficient * s.q**3, 0.0, 0.0, z


better = jaxid.fit(jaxid.Chain(SpringCart()).with_effects(CubicSpring()), data)
better

# %%
(effect,) = [e for e in better.effects if e.effect == "cubic_spring"]
assert abs(effect.parameters["coefficient"].value / 900 - 1) < 0.05 and better.loss < 1.3

# %% [markdown]
# The gap on the recording that neither fit has seen:

# %%
figure, (top, bottom) = plt.subplots(2, 1, figsize=(8, 5), layout="constrained")
for ax, result in ((top, fit), (bottom, better)):
    next(t for t in result.traces if t.split == "report").plot(ax=ax)

# %% [markdown]
# ## A fitter
#
# A population fitter writes four functions; loop, bounds, candidates that diverge, restarts, budget and history are common to all.


# %%
class Best(NamedTuple):
    z: Float[Array, " dim"]
    loss: Float[Array, ""]
    radius: Float[Array, ""]


class RandomSearch(AbstractPopulation):
    """Uniform draws in a box around the best point, which shrinks with every generation."""

    name: ClassVar[str] = "random_search"
    source: ClassVar[str] = "textbook"
    popsize: int = 64
    generations: int = 60
    shrink: float = 0.9

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


comparison = jaxid.compare(
    SpringCart(), data, fitters=[RandomSearch(), "de", "lm"], seeds=2, budget=1500
)
ax = comparison.plot()

# %% [markdown]
# ## Registration
#
# Move the class into a file of `models/`, `models/effects/` or `fitters/`, import it in the `__init__.py` beside it, and
# run `make test ARGS="-k spring_cart"`. `jaxid models spring_cart` prints what stands above.
