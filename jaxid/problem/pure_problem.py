"""A model on a dataset as pure functions of a search vector: what optimistix, pyPESTO, blackjax or
a user's own loop works on.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import nearest, UsageError
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.numerics.reverse import in_reverse
from jaxid.problem.objective import LOSSES, penalised
from jaxid.problem.problem import Data, FitProblem as Runnable
from jaxid.simulation.rollout import Lane
from jaxid.simulation.sample_buffers import BLOCK


Vector = Float[Array, " size"]


class Problem(eqx.Module):
    """Free numbers of a model and what they make of the recorded runs. Made by
    `jaxid.make_problem`; frozen, and a pytree: every number and every array of the data is a leaf.

    z [size] holds the free parameters, those that may span decades by their logarithm, then the
    starts of runs that are not known; `lower`, `upper`, `z0` [size] are its bounds and start.
    `residual`, `loss` and `log_density` pass `jax.jit`, `jax.vmap`, `jax.jacfwd` and `jax.grad`.
    They compute in float64: where JAX is not allowed to (`jax.config.update("jax_enable_x64",
    True)`) they raise `UsageError`, which says so.
    """

    lower: np.ndarray
    upper: np.ndarray
    z0: np.ndarray
    _data: Data
    _rows: np.ndarray  # [n 3]: record, step of it and column of each residual
    _weights: np.ndarray  # [n] 1 / noise
    _targets: np.ndarray  # [n]
    _prior: np.ndarray  # [free 2] mean and standard deviation of each free parameter; nan: none
    names: tuple[str, ...] = eqx.field(static=True)
    loss_name: str = eqx.field(static=True)
    statement: str = eqx.field(static=True)
    _predict: Callable[..., Array] = eqx.field(static=True, repr=False)

    @property
    def size(self) -> int:
        """Length of z."""
        return len(self.names)

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:
        return id(self)

    # Plain bound methods, hashed by this problem: those of equinox hash arrays, which
    # `jax.jit(problem.loss)` cannot.

    @property
    def residual(self) -> Callable[..., Float[Array, " n"]]:
        """residual(z, args=None) -> [n]: (simulated - measured) / noise, sample by sample; a mean
        square of 1 is the noise.
        """
        return types.MethodType(_residual, self)

    @property
    def loss(self) -> Callable[..., Float[Array, ""]]:
        """loss(z, args=None) -> []: by default the mean square of the residual, each Gaussian prior
        one more square; huge where the simulation diverges.
        """
        return types.MethodType(_loss, self)

    @property
    def log_density(self) -> Callable[..., Float[Array, ""]]:
        """log_density(z, args=None) -> []: log-likelihood under Gaussian noise, and Gaussian priors
        of parameters where the dataset states them (with |d parameter / d z|, so that a sampler of
        z meets them in the parameter's unit); -inf beyond the bounds, between which z is flat
        otherwise.
        """
        return types.MethodType(_log_density, self)

    def to_physical(self, z: Vector) -> dict[str, Array]:
        """Name -> number in its unit."""
        values = _physical(self, jnp.asarray(z))
        return {name: values[i] for i, name in enumerate(self.names)}

    def from_physical(self, values: Mapping[str, Any] | None = None, **more: Any) -> Array:
        """The z of these numbers; those that are left out are at z0. Raises `UsageError` for a name
        that is no free number.
        """
        given = {**(values or {}), **more}
        for name in given:
            if name not in self.names:
                raise UsageError(
                    f"the problem has no free number {name!r}{nearest(name, self.names)}"
                )
        z = [self.z0[i] for i in range(self.size)]
        for name, value in given.items():
            value = value["value"] if isinstance(value, Mapping) else getattr(value, "value", value)
            i = self.names.index(name)
            z[i] = jnp.log(value) if i < len(self._data.log) and self._data.log[i] else value
        return jnp.stack([jnp.asarray(v) for v in z])


def pure(problem: Runnable, z0: np.ndarray, priors: np.ndarray | None = None) -> Problem:
    """A problem of compiled lanes as one of pure functions; `priors` [free 2]: mean and standard
    deviation, nan where none.
    """
    runs, engine = problem.runs, problem.runs.engine
    rows, weights, targets = [], [], []
    for row, number in enumerate(problem.records):
        record = runs.record(number)
        sample, column = np.nonzero(problem.weights[record.samples] > 0)
        at = record.samples[sample]
        rows.append(np.stack([np.full(at.size, row), at - record.offset, column], 1))
        weights.append(problem.weights[at, column])
        targets.append(problem.targets[at, column])
    layout, index = engine.free_layout(problem.base, problem.free)
    length = -(-int(problem.data.steps.max()) // BLOCK) * BLOCK
    free = tuple(problem.free.tolist())
    predict = _Predict(
        layout, tuple(index.tolist()), free, engine.lane, length, engine.reach, engine.burns(layout)
    )
    priors = np.full((problem.free.size, 2), np.nan) if priors is None else priors
    data = jax.tree.map(np.asarray, problem.data)
    return Problem(
        lower=problem.lower,
        upper=problem.upper,
        z0=z0,
        _data=data,
        _rows=np.concatenate(rows),
        _weights=np.concatenate(weights),
        _targets=np.concatenate(targets),
        _prior=priors,
        names=tuple(problem.names),
        loss_name=problem.loss_name,
        statement=runs.statement,
        _predict=predict,
    )


def residual_of(z: Vector, problem: Problem) -> Float[Array, " n"]:
    """`problem.residual(z)` as a function of both."""
    return _residual(problem, z)


def log_density_of(z: Vector, problem: Problem) -> Float[Array, ""]:
    """`problem.log_density(z)` as a function of both."""
    return _log_density(problem, z)


def with_noise(problem: Problem, factor: float) -> Problem:
    """The same problem with the noise of every channel this many times as large."""
    return eqx.tree_at(lambda p: p._weights, problem, problem._weights / factor)


@dataclass(frozen=True, eq=False)
class _Predict:
    """Prediction of one record, [length columns], as a pure function."""

    layout: ParameterVector
    index: tuple[int, ...]  # positions of its numbers among all of the model's
    free: tuple[int, ...]
    lane: Lane
    length: int
    reach: int
    burn: bool

    @property
    def _all(self) -> Any:
        chain = jax.tree.structure(self.layout.chain)
        return chain, self.index, self.free, self.lane, self.length, self.reach, self.burn

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Predict) and self._all == other._all

    def __hash__(self) -> int:
        return hash(self._all)

    def __call__(
        self,
        values: Array,
        still_open: Array,
        fixed: Array,
        start: Array,
        where: Array,
        samples: Any,
        steps: Array,
    ):
        place = {i: k for k, i in enumerate(self.free)}

        def own(i):
            return (
                jnp.where(still_open[place[i]], values[place[i]], fixed[i])
                if i in place
                else fixed[i]
            )

        chain = self.layout.model([own(i) for i in self.index])
        return self.lane(chain, samples, where, start, steps, self.length, self.reach, self.burn)


def _physical(problem: Problem, z: Vector) -> Vector:
    """The numbers that z stands for, each in its unit."""
    log = jnp.concatenate(
        [jnp.asarray(problem._data.log), jnp.zeros(problem.size - len(problem._data.log), bool)]
    )
    return jnp.where(log, jnp.exp(jnp.where(log, z, 0.0)), z)


def _checked(problem: Problem, z: Any) -> Vector:
    z = jnp.asarray(z)
    if z.dtype != jnp.float64:
        raise UsageError(
            f"z is {z.dtype}, and a simulation needs float64: before anything else of JAX is used,"
            ' type jax.config.update("jax_enable_x64", True), or set JAX_ENABLE_X64=1 in the'
            " environment"
        )
    if z.shape != (problem.size,):
        raise UsageError(
            f"z has the shape {z.shape}; there are {problem.size} free numbers:"
            f" {', '.join(problem.names)}"
        )
    return z


def _residual(problem: Problem, z: Vector, args: Any = None) -> Float[Array, " n"]:
    z, d = _checked(problem, z), problem._data
    values = _physical(problem, z)[: len(d.log)]
    starts = jnp.asarray(d.start0).at[d.start_rows, d.start_columns].set(z[len(d.log) :])
    samples = jax.tree.map(jnp.asarray, d.samples)

    def one(still_open, fixed, start, where, steps):
        return problem._predict(values, still_open, fixed, start, where, samples, steps)

    with in_reverse():
        y = jax.vmap(one)(*(jnp.asarray(a) for a in (d.open, d.fixed, starts, d.where, d.steps)))
    record, k, column = problem._rows.T
    return jnp.asarray(problem._weights) * (y[record, k, column] - problem._targets)


def _loss(problem: Problem, z: Vector, args: Any = None) -> Float[Array, ""]:
    loss, d = LOSSES[problem.loss_name], problem._data
    r = _residual(problem, z)
    sums = (
        jnp.zeros(d.count.shape).at[problem._rows[:, 2]].add(loss.summed(r / problem._weights, r))
    )
    if (
        problem.loss_name == "sum_of_squares"
    ):  # no other has room for a prior, as `Problem` of fits says
        sums = sums.at[0].add(jnp.sum(_beside_priors(problem, z) ** 2))
    return penalised(loss.total(sums, d.count, d.norm))


def _beside_priors(problem: Problem, z: Vector) -> Float[Array, " free"]:
    """How many standard deviations each free parameter is from the mean of its prior; 0 where it
    has none.
    """
    mean, std = problem._prior.T
    there = ~jnp.isnan(mean)
    values = _physical(problem, jnp.asarray(z))[: mean.shape[0]]
    return jnp.where(there, values - mean, 0.0) / jnp.where(there, std, 1.0)


def _log_density(problem: Problem, z: Vector, args: Any = None) -> Float[Array, ""]:
    r, z = _residual(problem, z), jnp.asarray(z)
    likelihood = jnp.sum(jnp.log(problem._weights) - r * r / 2) - r.shape[0] / 2 * np.log(2 * np.pi)
    mean, std = problem._prior.T
    part = z[: mean.shape[0]]
    there = ~jnp.isnan(mean)
    error = _beside_priors(problem, z)
    slope = jnp.where(problem._data.log, part, 0.0)  # log |d parameter / d z|
    prior = jnp.where(
        there,
        slope - error**2 / 2 - jnp.log(jnp.where(there, std, 1.0)) - np.log(2 * np.pi) / 2,
        0.0,
    )
    density = likelihood + jnp.sum(prior)
    inside = jnp.all((z >= problem.lower) & (z <= problem.upper)) & jnp.isfinite(density)
    return jnp.where(inside, density, -jnp.inf)
