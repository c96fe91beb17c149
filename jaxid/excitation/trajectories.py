"""Exciting motion for arms: periodic Fourier trajectories, optimised by gradient through the torque
regressor.

q_j(t) = c_j + sum_l a_lj / (w l) sin(w l t) - b_lj / (w l) cos(w l t)       (Swevers et al. 1997;
paper 001, equation (17))

with sum_l a_l = 0 and sum_l l b_l = 0, so that it starts and ends at rest without acceleration. Any
numbers become a trajectory within all limits: the constraints are projected out, and each joint is
scaled to the limit that it meets first. What is minimised is the condition number of the
noise-weighted columns of what can be identified, or minus log det of their Gram matrix, or
(`paper001`) the objective (18) of paper 001: 10 cond of all columns + 5 cond of those of inertia
tensors + cond of those of first moments + cond of those of friction. With that one the paper's
constraints hold, too: the motion begins at its middle, which is the home pose (sum_l b_l / l = 0),
and it is the sums of its amplitudes, sqrt(a_l^2 + b_l^2) times 1 / (w l), 1 and w l, that are
within the limits, not the peaks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import UsageError
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Command, Signals
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.dynamics.rigid_body import chain_of, regressor, still
from jaxid.excitation.bounds import Bounds
from jaxid.excitation.clearance import gaps, heights, Links, links_of, nodes
from jaxid.excitation.paper001 import sums_18, terms_18, WEIGHTS_18
from jaxid.identification.regression import friction_columns, FrictionLaw, power
from jaxid.numerics.linalg import array_module
from jaxid.numerics.precision import float64


#: Samples of one period of the highest harmonic while searching.
GRID = 20
#: Share of a limit that the search may use, for peaks lie between the samples of its grid.
SAFE = 0.995
SHARP = 8.0  # of the smooth largest and smallest eigenvalue
ROUND = 25  # steps of one compiled call
RATE = 0.03  # of Adam, in units of the shape's numbers
CRITERIA = ("condition", "d_optimal", "paper001")


class Shape(NamedTuple):
    """Unconstrained numbers of a trajectory: `a`, `b` [harmonics n], `middle`, `share` [n]."""

    a: Array
    b: Array
    middle: Array
    share: Array


class Fourier(NamedTuple):
    """A trajectory: `a`, `b` [harmonics n] rad/s, `middle` [n] rad, `omega` rad/s."""

    a: np.ndarray
    b: np.ndarray
    middle: np.ndarray
    omega: float

    def __call__(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """q, qd, qdd [time n]."""
        return series(self.a, self.b, self.middle, self.omega, np.asarray(t, float))


def series(a: Any, b: Any, middle: Any, omega: float, t: Any) -> tuple[Any, Any, Any]:
    """Position, speed and acceleration [time n] of a Fourier trajectory."""
    xp = array_module(a)
    w = omega * np.arange(1, len(a) + 1)
    s, c, wide = xp.sin(t[:, None] * w), xp.cos(t[:, None] * w), w[:, None]
    return middle + s @ (a / wide) - c @ (b / wide), c @ a + s @ b, c @ (b * wide) - s @ (a * wide)


class TrajectoryTask(eqx.Module):
    """Abstract: what a trajectory is to make identifiable. `columns` gives torque per number, [time
    n p].
    """

    def columns(self, q: Array, qd: Array, qdd: Array) -> Float[Array, "time n p"]:
        raise NotImplementedError


class ArmTask(TrajectoryTask):
    """Base parameters and a friction law of a serial arm."""

    arm: Any
    exponent: np.ndarray
    coefficient: np.ndarray
    kept: tuple[int, ...] = eqx.field(static=True)
    law: FrictionLaw = eqx.field(static=True)

    def columns(self, q, qd, qdd):
        n = q.shape[1]
        bodies, base = chain_of(self.arm.prismatic, batch=1), still(self.arm.free_fall())
        Y = regressor(self.arm.placements(q.T), bodies, base, qd.T, qdd.T)
        drives = jnp.eye(n)[:, :, None] * qdd.T[:, None]
        Y = jnp.moveaxis(jnp.concatenate([Y, drives[:, :, None]], 2), 3, 0).reshape(len(q), n, -1)[
            :, :, np.array(self.kept)
        ]
        F = friction_columns(self.law, qd, self.exponent)
        if self.law.nonlinear:
            slope = self.coefficient * power(qd, self.exponent) * jnp.log(qd**2 + 1e-6) / 2
            F = jnp.concatenate([F, slope[:, None]], 1)
        rows = F[..., None] * jnp.eye(n)  # [time laws n n]
        return jnp.concatenate([Y, jnp.moveaxis(rows, 1, 2).reshape(len(q), n, -1)], 2)


class ChainTask(TrajectoryTask):
    """The free numbers of any rigid model, those that depend on others left out; the torque is
    linearised at its values.
    """

    theta: np.ndarray
    scale: np.ndarray
    layout: ParameterVector = eqx.field(static=True)
    kept: tuple[int, ...] = eqx.field(static=True)

    def columns(self, q, qd, qdd):
        index = np.array(self.kept)
        theta = jnp.asarray(self.theta)

        def torque(part, q, qd, qdd):
            return required(self.layout.model(theta.at[index].set(part)), q, qd, qdd)

        J = jax.vmap(jax.jacfwd(torque), (None, 0, 0, 0))(theta[index], q, qd, qdd)
        return J * jnp.asarray(self.scale)[index]


def required(chain: Chain, q: Array, qd: Array, qdd: Array) -> Array:
    """Joint torque [n] that a motion needs, friction with sign(qd) as tanh(qd / 0.01) included."""
    from jaxid.identification.regression import REST

    zero = jnp.zeros(())
    u = jnp.zeros(len(chain.signature.inputs))
    command = Command(zero, zero + 1.0, u, u, lambda d: u)
    body = chain.body()
    s = Signals(zero, q, qd, jnp.zeros_like(q), zero + 1.0, command, qd)
    F, minus, plus, _ = chain.friction(s, chain.start(q, qd, u).z)
    return body.inverse(q, qd, qdd) + F + jnp.where(qd > 0, plus, minus) * jnp.tanh(qd / REST)


class SearchSetting(eqx.Module):
    """Everything else that the search needs: bounds, weights, geometry."""

    bounds: Bounds
    weight: np.ndarray  # [n] 1 / noise
    arm: Any  # None: no geometry
    radius: float
    floor: float
    omega: float
    links: Links = eqx.field(static=True)
    criterion: str = eqx.field(static=True)
    grid: int = eqx.field(static=True)
    groups: tuple[tuple[int, ...], ...] = eqx.field(
        static=True, default=()
    )  # columns of each term of (18)


def feasible(shape: Shape, setting: SearchSetting, t: Any) -> tuple[Any, Any, Any]:
    """(a, b, middle) within all limits on the times t."""
    bounds = setting.bounds
    l = np.arange(1, len(shape.a) + 1)[:, None]
    a = shape.a - jnp.mean(shape.a, 0)
    if setting.criterion == "paper001":
        C = np.concatenate([l, 1 / l], 1).astype(float)
        b = shape.b - C @ np.linalg.solve(C.T @ C, C.T) @ shape.b
        middle = jnp.asarray(bounds.home, float)
        sums = sums_18(a, b, setting.omega)
        room = jnp.minimum(bounds.upper - middle, middle - bounds.lower) / sums["position"]
        rates = jnp.minimum(
            bounds.speed / sums["speed"], bounds.acceleration / sums["acceleration"]
        )
        scale = jnp.minimum(room, rates) * jax.nn.sigmoid(shape.share)
        return a * scale, b * scale, middle
    b = shape.b - l * jnp.sum(l * shape.b, 0) / np.sum(l * l)
    lower, upper = jnp.asarray(bounds.lower), jnp.asarray(bounds.upper)
    middle = lower + (upper - lower) * jax.nn.sigmoid(shape.middle)
    q, qd, qdd = series(a, b, 0.0, setting.omega, t)
    room = jnp.minimum((upper - middle) / jnp.max(q, 0), (middle - lower) / jnp.max(-q, 0))
    rates = jnp.minimum(
        bounds.speed / jnp.max(jnp.abs(qd), 0), bounds.acceleration / jnp.max(jnp.abs(qdd), 0)
    )
    scale = SAFE * jnp.minimum(room, rates) * jax.nn.sigmoid(shape.share)
    return a * scale, b * scale, middle


def spectrum(W: Float[Array, "time n p"], weight: Any) -> Float[Array, " p"]:
    """Eigenvalues, rising, of the weighted columns' mean Gram matrix."""
    flat = (W * weight[:, None]).reshape(-1, W.shape[2])
    return jnp.linalg.eigvalsh(flat.T @ flat / len(W))


def goodness(shape: Shape, task: TrajectoryTask, setting: SearchSetting) -> tuple[Array, Array]:
    """(what is descended on, what is minimised) of one trajectory: log of the condition number, or
    minus mean log eigenvalue.
    """
    period = 2 * np.pi / setting.omega
    t = jnp.arange(setting.grid) * (period / setting.grid)
    a, b, middle = feasible(shape, setting, t)
    q, qd, qdd = series(a, b, middle, setting.omega, t)
    if setting.criterion == "paper001":
        W = (task.columns(q, qd, qdd) * setting.weight[:, None]).reshape(
            setting.grid * q.shape[1], -1
        )
        logs = terms_18(W.T @ W / setting.grid, setting.groups)
        near, weight = 30.0 * tightness(q, setting), np.log(WEIGHTS_18)

        def bound(v):
            return (jax.nn.logsumexp(SHARP * v) + jax.nn.logsumexp(-SHARP * v)) / SHARP

        smooth = jnp.stack([bound(v) for v in logs])
        exact = jnp.stack([v[-1] - v[0] for v in logs])
        return jax.nn.logsumexp(smooth + weight) + near, jax.nn.logsumexp(exact + weight) + near
    e = spectrum(task.columns(q, qd, qdd), setting.weight)
    low = jnp.maximum(e, 1e-14 * e[-1])
    logs = 0.5 * jnp.log(low)
    near = 30.0 * tightness(q, setting)
    if setting.criterion == "d_optimal":
        return -jnp.mean(logs) + near, -jnp.mean(logs) + near
    # Eigenvalues cross, where the smallest has no slope: descend on its smooth bound.
    smooth = (jax.nn.logsumexp(SHARP * logs) + jax.nn.logsumexp(-SHARP * logs)) / SHARP
    return smooth + near, logs[-1] - logs[0] + near


def tightness(q: Array, setting: SearchSetting) -> Array:
    """How much links come too near to each other or to the floor, with 3 cm to spare; 0:
    nowhere.
    """
    if setting.arm is None:
        return jnp.zeros(())
    node = nodes(setting.arm, q)
    short = [
        2 * setting.radius + 0.03 - gaps(setting.links, node),
        setting.floor + setting.radius + 0.03 - heights(setting.links, node),
    ]
    return sum((jnp.sum(jnp.mean(jnp.maximum(s / 0.1, 0.0) ** 2, 0)) for s in short), jnp.zeros(()))


@eqx.filter_jit
def _descend(
    shapes: Shape,
    moments: Any,
    task: TrajectoryTask,
    setting: SearchSetting,
    first: Any,
    total: Any,
    count: int,
):
    """`count` steps of Adam for all starts at once; also the best shape that each start has had."""
    slope = jax.vmap(jax.value_and_grad(lambda s: goodness(s, task, setting), has_aux=True))

    def step(carry, k):
        shapes, (m, v), (best, least) = carry
        (_, value), g = slope(shapes)
        better = value < least

        def keep(new, old):
            return jnp.where(better.reshape(-1, *(1,) * (new.ndim - 1)), new, old)

        best, least = jax.tree.map(keep, shapes, best), jnp.where(better, value, least)
        g = jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), x, 0.0), g)
        m = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, m, g)
        v = jax.tree.map(lambda v, g: 0.99 * v + 0.01 * g * g, v, g)
        rate = RATE * 0.5 * (1 + jnp.cos(jnp.pi * k / total)) + 1e-3
        i = k + 1.0

        def move(x, m, v):
            return x - rate * (m / (1 - 0.9**i)) / (jnp.sqrt(v / (1 - 0.99**i)) + 1e-10)

        return (jax.tree.map(move, shapes, m, v), (m, v), (best, least)), None

    return jax.lax.scan(step, (shapes, *moments), first + jnp.arange(count))[0]


@eqx.filter_jit
def _values(shapes: Shape, task: TrajectoryTask, setting: SearchSetting) -> Array:
    return jax.lax.map(lambda s: goodness(s, task, setting)[1], shapes, batch_size=8)


def optimise(
    task: TrajectoryTask,
    setting: SearchSetting,
    harmonics: int,
    starts: int,
    seed: int,
    iterations: int = 300,
    progress: Callable[[str, int, int, str], None] | None = None,
) -> list[tuple[float, Fourier]]:
    """Trajectories, best first, each with the value that was minimised.

    Sixteen times as many random trajectories as `starts` are tried; the best of them descend
    together.
    """
    moments: Any = ()
    n, rng = len(setting.bounds.home), np.random.default_rng(seed)
    bounds = setting.bounds
    place = np.clip((bounds.home - bounds.lower) / (bounds.upper - bounds.lower), 0.1, 0.9)
    count = 16 * starts
    l = np.arange(1, harmonics + 1)[None, :, None]
    fall = rng.uniform(
        0.0, 1.0, (count, 1, n)
    )  # how fast the lines fall off, from speeds alike to accelerations alike
    with float64():
        a, b = (jnp.asarray(rng.normal(size=(count, harmonics, n)) / l**fall) for _ in range(2))
        middle = jnp.asarray(np.log(place / (1 - place)) + 0.3 * rng.normal(size=(count, n)))
        shapes = Shape(a, b, middle, jnp.full((count, n), 3.0))
        values = np.asarray(_values(shapes, task, setting))
        order = np.argsort(np.where(np.isfinite(values), values, np.inf))[:starts]
        shapes = jax.tree.map(lambda x: x[order], shapes)
        if progress:
            progress("excite", 0, iterations, f"{values[order[0]]:.3f}")
        shapes = jax.tree.map(np.asarray, shapes)
        zero = jax.tree.map(np.zeros_like, shapes)
        best, least = shapes, np.full(starts, np.inf)
        rounds = max(1, iterations // ROUND)
        for k in range(rounds):
            if (
                k and k % max(1, rounds // 4) == 0
            ):  # the worse half starts anew beside the better one
                order = np.argsort(least)
                half = starts // 2
                shapes = jax.tree.map(lambda x: x[order], best)
                for x in shapes:
                    x[starts - half :] = x[:half] + 0.2 * rng.normal(size=x[:half].shape)
                best, least = jax.tree.map(lambda x: x[order], best), least[order]
                moments = (zero, zero)
            else:
                moments = (zero, zero) if k == 0 else moments
            args = (
                shapes,
                (moments, (best, least)),
                task,
                setting,
                np.float64(k * ROUND),
                np.float64(rounds * ROUND),
            )
            shapes, moments, (best, least) = jax.tree.map(np.array, _descend(*args, ROUND))
            if progress:
                progress("excite", (k + 1) * ROUND, rounds * ROUND, f"{least.min():.3f}")
        fine = jnp.arange(64 * harmonics) * (2 * np.pi / setting.omega / (64 * harmonics))
        out = []
        for i in np.argsort(np.asarray(least)):
            one = jax.tree.map(lambda x: x[i], best)
            a, b, middle = (np.asarray(v) for v in feasible(one, setting, fine))
            out.append((float(least[i]), Fourier(a, b, middle, setting.omega)))
    return out


def geometry_of(mechanism: Any) -> tuple[Any, Links]:
    """(arm, links) for the distances between links; (None, nothing) where a model has no frames in
    space.
    """
    if not hasattr(mechanism, "frames"):
        return None, Links((), ())
    return mechanism, links_of(mechanism)


def chain_task(chain: Chain, seed: int = 0) -> ChainTask:
    """The numbers of a chain that its torque shows, each in units of its typical size."""
    from jaxid.dynamics.base_parameters import independent_columns

    layout = ParameterVector(chain)
    free = [
        i
        for i, e in enumerate(layout.entries)
        if not e.spec.fixed and e.name not in chain.mechanism.held()
    ]
    scale = np.where(layout.values == 0, 1.0, np.abs(layout.values))
    task = ChainTask(layout.values, scale, layout, tuple(free))
    rng = np.random.default_rng(seed)
    with float64():
        motion = [jnp.asarray(rng.uniform(-k, k, (200, chain.nq))) for k in (2.0, 2.0, 5.0)]
        W = np.asarray(task.columns(*motion))
    kept = independent_columns(W.reshape(-1, W.shape[2]), range(W.shape[2]), 1e-6)
    if not kept:
        raise UsageError(f"{chain.mechanism.name}: the torque shows none of its numbers")
    return ChainTask(layout.values, scale, layout, tuple(free[i] for i in kept))
