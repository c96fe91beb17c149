"""Objectives: a loss over a box of search vectors, with residuals and Jacobian. What every fitter,
gradient or population, works on; `jaxid.problem.problem.FitProblem` makes one of a model and its
runs, `FunctionProblem` of any JAX function.
"""

from __future__ import annotations

import abc
import copy
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import UsageError
from jaxid.numerics.pool import default_platform, Pool
from jaxid.numerics.precision import float64


#: Loss of a candidate that diverges: finite, above anything that a simulation can give.
PENALTY = 1e30

#: Blocks of candidates run side by side, one per core; which thread runs a block changes nothing in
#: its result.
_POOL = Pool("losses")
_COMPILING = threading.Lock()
#: Programs that depend on no problem.
_PROGRAMS: dict[Any, Any] = {}

Losses = Callable[[Array, Any], Array]


def penalised(value: Array) -> Array:
    """What is not finite gets PENALTY, nothing is larger."""
    return jnp.minimum(jnp.where(jnp.isfinite(value), value, PENALTY), PENALTY)


#: Most candidates that are evaluated side by side by one call of a program.
CANDIDATES = 64


class Loss(NamedTuple):
    """A loss from residuals: what is summed over the samples of a column, of the error e in its
    unit and of r = e / noise; and (sums [pop columns], samples [columns], sum of squares of the
    measured signal [columns]) -> loss [pop].
    """

    summed: Callable[[Array, Array], Array]
    total: Callable[[Array, Any, Any], Array]


LOSSES: dict[str, Loss] = {
    # mean square of residual / noise: 1.0 is down to the noise
    "sum_of_squares": Loss(
        lambda e, r: r**2, lambda sums, count, norm: jnp.sum(sums, -1) / jnp.sum(count)
    ),
    # paper 002, equation (6): sum over channels of |e| / |y|
    "sum_of_norms": Loss(
        lambda e, r: e**2,
        lambda sums, count, norm: jnp.sum(jnp.sqrt(sums / jnp.maximum(norm, 1e-300)), -1),
    ),
    # paper 003, equation (7): sum of absolute errors, in the channel's unit
    "sum_of_abs": Loss(lambda e, r: jnp.abs(e), lambda sums, count, norm: jnp.sum(sums, -1)),
}


class ResidualRows(NamedTuple):
    """Residual and Jacobian of one record of one job: r [samples columns], J [samples columns
    len(z_columns)], and the weights in them, 1 / noise [samples columns].
    """

    job: int
    record: int
    r: np.ndarray
    J: np.ndarray
    z_columns: list[int]
    w: np.ndarray


def rows(
    jobs: Sequence[tuple[AbstractProblem, np.ndarray]], share: float = 1.0, pieces: bool = False
) -> Iterator[ResidualRows]:
    """Residuals and Jacobians of many (problem, z) in one batch; `share` < 1: of the first part of
    each record only. `pieces`: a long record may come in several, one after the other, so that its
    Jacobian is never in memory as a whole.
    """
    return type(jobs[0][0]).rows(jobs, share, pieces)


@dataclass(frozen=True)
class Linear:
    """Sum of squares at z with gradient and Gauss-Newton matrix (of half the sum), and the number
    of residuals.
    """

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray
    count: int


class AbstractProblem(abc.ABC):
    """Abstract: a loss over a box of search vectors z, with residuals and Jacobian where it is made
    of residuals.

    A final class sets `lower`, `upper` and `scale` [size] (a typical change), `free` (positions of
    the parameters; z may go on with unknown starts), `log` (which of them are searched by their
    logarithm), `loss_name`, `programs` (compiled programs, shared by problems of the same
    structure), and `work`, the simulated steps of one evaluation.
    """

    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray
    free: np.ndarray
    log: np.ndarray
    loss_name: str
    programs: dict[Any, Any]
    work: int

    @property
    def size(self) -> int:
        return self.lower.size

    @property
    def weighted(self) -> bool:
        """Whether its loss is a sum of squares of residuals over their noise."""
        return False

    @property
    def by_windows(self) -> bool:
        """Whether its records are windows of runs, each with a start of its own."""
        return False

    @property
    @abc.abstractmethod
    def names(self) -> list[str]:
        """Printed names of z."""

    @property
    @abc.abstractmethod
    def data(self) -> Any:
        """Everything the loss reads, as arguments of its program: nothing recompiles because a
        number changed.
        """

    @property
    @abc.abstractmethod
    def pure(self) -> Losses:
        """(z [pop size], data) -> losses [pop]: traceable, holds no data; a candidate that diverges
        gets PENALTY.
        """

    @abc.abstractmethod
    def residual_function(self) -> tuple[Callable[[Array, Any], Array], Any]:
        """(z [size], data) -> residuals over their noise [n], traceable and differentiable, and the
        data.
        """

    @property
    @abc.abstractmethod
    def compile_time_s(self) -> float:
        """Seconds spent so far on compiling programs of this problem and of those that share
        them.
        """

    @abc.abstractmethod
    def add_compile_time(self, seconds: float) -> None: ...

    def known_before(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual [k] and Jacobian [k size] of what is known of the parameters without the data:
        none here.
        """
        return np.zeros(0), np.zeros((0, self.size))

    @property
    @abc.abstractmethod
    def pieces(self) -> int:
        """How many pieces the data come in."""

    @abc.abstractmethod
    def part(self, pieces: Sequence[int], weights: Sequence[float]) -> AbstractProblem:
        """The problem of some pieces of the data, their squared residuals weighted."""

    def precise(self) -> AbstractProblem:
        """The problem with the most exact Jacobian that needs no further program."""
        return self

    @classmethod
    @abc.abstractmethod
    def rows(
        cls, jobs: Sequence[tuple[Any, np.ndarray]], share: float = 1.0, pieces: bool = False
    ) -> Iterator[ResidualRows]:
        """Residuals and Jacobians of many (problem, z) in one batch; `share` < 1: of the first part
        of each record only; `pieces`: records may come in several.
        """

    def pure_losses(self, z: Float[Array, "pop size"], data: Any) -> Float[Array, " pop"]:
        """Loss of each candidate, traceable; a candidate that diverges gets PENALTY."""
        return self.pure(z, data)

    def compiled(
        self, name: Any, function: Callable, *args: Any, own: bool = True, count: bool = True
    ) -> Any:
        """The executable of a function for arguments of these shapes, compiled once for all
        problems of this structure, or for all problems if it does not depend on them (`own` False).

        `name` tells functions apart. Call it and its executable in float64. The time counts as
        spent on compiling unless somebody else does something useful in it (`count` False).
        """
        programs = self.programs if own else _PROGRAMS
        key = self._kind(name, *args)
        with _COMPILING:
            if key not in programs:
                began = time.perf_counter()
                programs[key] = jax.jit(function).lower(*args).compile()
                if count:
                    self.add_compile_time(time.perf_counter() - began)
        return programs[key]

    def _kind(self, name: Any, *args: Any) -> Any:
        """What a compiled program is found by."""
        leaves, tree = jax.tree.flatten(args)
        return (
            name,
            self.loss_name,
            default_platform(),
            tree,
            tuple((np.shape(a), getattr(a, "dtype", type(a))) for a in leaves),
        )

    def losses(self, z: np.ndarray) -> np.ndarray:
        """Loss of each row of z [pop size], on all cores; the same program and numbers for every
        fitter.
        """
        return self.begun(z)()

    def begun(self, z: np.ndarray) -> Callable[[], np.ndarray]:
        """`losses` begun on all cores; the answer waits for its end. A single block is left to who
        asks for the answer.
        """
        z = np.atleast_2d(np.asarray(z, np.float64))
        data = self.data
        program = self._losses()

        def block(k: int) -> np.ndarray:
            part = z[
                k : k + CANDIDATES
            ]  # one shape, hence one program and the same bits, for any population
            padded = np.concatenate([part, np.repeat(part[-1:], CANDIDATES - len(part), 0)])
            with float64():  # the setting belongs to the thread
                return np.asarray(program(padded, data))[: len(part)]

        if len(z) <= CANDIDATES:
            return lambda: block(0)
        waiting = [_POOL.submit(block, k) for k in range(0, len(z), CANDIDATES)]
        return lambda: np.concatenate([w.result() for w in waiting])

    def _losses(self, count: bool = True) -> Any:
        with float64():
            return self.compiled("losses", self.pure, self._block, self.data, count=count)

    @property
    def _block(self) -> np.ndarray:
        return np.zeros((CANDIDATES, self.size))

    def compile_losses(self) -> Callable[[], None]:
        """Begins to compile what `losses` runs, beside other work; the answer waits for its end."""
        if self._kind("losses", self._block, self.data) in self.programs:
            return lambda: None
        begun = _POOL.submit(self._losses, False)

        def wait() -> None:
            waited = time.perf_counter()
            begun.result()
            self.add_compile_time(time.perf_counter() - waited)

        return wait

    def loss(self, z: np.ndarray) -> float:
        """Loss of one candidate."""
        return float(self.losses(np.asarray(z)[None])[0])


class FunctionProblem(AbstractProblem):
    """Any residual in JAX as a problem: `residual(z [size])` gives r [samples] or [samples
    columns].

    The residual counts as divided by its noise. `norm` [columns] is the sum of squares of the
    measured signal, for the loss `sum_of_norms`. `log` says which entries of z are logarithms (it
    only matters for where random starts are drawn). `piece` [samples] numbers the pieces in which
    the data come, from 0.
    """

    def __init__(
        self,
        residual: Callable[[Array], Array],
        lower: Sequence[float] | np.ndarray,
        upper: Sequence[float] | np.ndarray,
        loss: str = "sum_of_squares",
        log: Sequence[bool] | np.ndarray | None = None,
        names: Sequence[str] | None = None,
        norm: Sequence[float] | np.ndarray | None = None,
        piece: Sequence[int] | np.ndarray | None = None,
    ):
        self.lower, self.upper = np.array(lower, np.float64), np.array(upper, np.float64)
        if (
            self.lower.shape != self.upper.shape
            or self.lower.ndim != 1
            or not np.all(self.lower < self.upper)
        ):
            raise UsageError(
                "`lower` and `upper` are vectors of the same length, and every lower is below its"
                " upper"
            )
        if loss not in LOSSES:
            raise UsageError(f"unknown loss {loss!r}; there is: {', '.join(LOSSES)}")
        n = self.lower.size
        self.scale, self.free = 0.02 * (self.upper - self.lower), np.arange(n)
        self.log = np.zeros(n, bool) if log is None else np.asarray(log, bool)
        self.loss_name, self.programs, self.work = loss, {}, 0
        self._names = [f"z{i + 1}" for i in range(n)] if names is None else list(names)
        self._compile_time_s = [0.0]  # shared by its parts
        self._residual = lambda z: jnp.reshape(r := residual(z), (r.shape[0], -1))
        with float64():
            samples, columns = jax.eval_shape(
                self._residual, jax.ShapeDtypeStruct((n,), np.float64)
            ).shape
        self._piece = np.zeros(samples, int) if piece is None else np.asarray(piece)
        self._data = Weighted(
            np.full(columns, float(samples)),
            np.ones(columns) if norm is None else np.array(norm, np.float64),
            np.ones(samples),
        )

    @property
    def names(self) -> list[str]:
        return self._names

    @property
    def data(self) -> Weighted:
        return self._data

    @property
    def pure(self) -> Losses:
        residual, loss = self._residual, LOSSES[self.loss_name]

        def losses(z: Array, data: Weighted) -> Array:
            w = data.w[:, None]
            e = jnp.where(w > 0, jax.vmap(residual)(z), 0.0)
            return penalised(loss.total(jnp.sum(loss.summed(e, w * e), 1), data.count, data.norm))

        return losses

    def residual_function(self):
        residual = self._residual
        return lambda z, data: jnp.ravel(data.w[:, None] * residual(z)), self._data

    @property
    def compile_time_s(self) -> float:
        return self._compile_time_s[0]

    def add_compile_time(self, seconds: float) -> None:
        self._compile_time_s[0] += seconds

    @property
    def pieces(self) -> int:
        return int(self._piece.max()) + 1

    def part(self, pieces, weights):
        twin = copy.copy(self)
        w = np.zeros(len(self._piece))
        for piece, weight in zip(pieces, weights, strict=True):
            w[self._piece == piece] = np.sqrt(weight)
        twin._data = Weighted(np.full(len(self._data.norm), np.sum(w**2)), self._data.norm, w)
        return twin

    @classmethod
    def rows(
        cls,
        jobs: Sequence[tuple[FunctionProblem, np.ndarray]],
        share: float = 1.0,
        pieces: bool = False,
    ):
        for j, (p, z) in enumerate(jobs):

            def both(z, residual=p._residual):
                return (residual(z), jax.jacfwd(residual)(z))

            with float64():
                z = np.asarray(z, np.float64)
                r, J = (np.asarray(a) for a in p.compiled("rows", both, z)(z))
            kept = np.flatnonzero(p._data.w > 0)
            kept = kept[: max(1, round(share * len(kept)))]
            w = p._data.w[kept]
            yield ResidualRows(
                j,
                0,
                w[:, None] * r[kept],
                w[:, None, None] * J[kept],
                list(range(p.size)),
                np.tile(w[:, None], r.shape[1]),
            )


class Weighted(NamedTuple):
    """Sum of the squared weights and sum of squares of the measured signal, per column; weights per
    sample.
    """

    count: Any
    norm: Any
    w: Any


def linearise(
    jobs: Sequence[tuple[AbstractProblem, np.ndarray]], share: float = 1.0
) -> list[Linear]:
    """Sum of squares, gradient and Gauss-Newton matrix of many (problem, z), in one batch of
    lanes.
    """
    out = [[0.0, np.zeros(p.size), np.zeros((p.size, p.size)), 0] for p, _ in jobs]
    with np.errstate(all="ignore"):
        for part in rows(jobs, share, pieces=True):
            # A row for each column of z, as the lanes gave them.
            job, r, J = (
                out[part.job],
                part.r.ravel(),
                np.moveaxis(part.J, -1, 0).reshape(len(part.z_columns), part.r.size),
            )
            job[0] += float(r @ r)
            job[1][part.z_columns] += J @ r
            job[2][np.ix_(part.z_columns, part.z_columns)] += J @ J.T
            job[3] += r.size
        for job, (p, z) in zip(out, jobs, strict=True):
            r, J = p.known_before(z)
            if r.size:
                job[0] += float(r @ r)
                job[1] += J.T @ r
                job[2] += J.T @ J
    return [Linear(*job) for job in out]
