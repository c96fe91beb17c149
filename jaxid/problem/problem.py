"""A model and its runs as numbers: what every fitter, gradient or population, works on.

z = (free parameters in their search scale, unknown starts). `loss(z)` is one compiled number;
`linearise` gives what a least-squares method needs for many (problem, z) at once, all in the same
batch of lanes.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import UsageError
from jaxid.dynamics.joint_readings import joint_readings, sizes
from jaxid.numerics.batch_loop import batched_vmap
from jaxid.problem.gauss_newton import gauss_newton_model
from jaxid.problem.objective import (
    AbstractProblem,
    CANDIDATES,
    Linear,
    linearise,
    Loss,
    LOSSES,
    Losses,
    penalised,
    PENALTY,
    ResidualRows,
    rows,
)
from jaxid.problem.record_rows import lanes_of, rows_of_records
from jaxid.problem.residual import Runs
from jaxid.simulation.sample_buffers import Samples


#: Step of forward and of central differences, in typical changes of a number (logarithms: in
#: factors of e); 0 is for tangents.
STEPS = (0.0, 1e-6, 1e-5)


class Data(NamedTuple):
    """Arguments of the compiled loss."""

    samples: Samples
    fixed: Any
    open: Any
    log: Any
    start0: Any
    start_rows: Any
    start_columns: Any
    where: Any
    scored: Any  # first step of each record that counts
    counts: Any
    steps: Any
    count: Any
    norm: Any
    known: Any  # of the free parameters without the data: `NumberPrior`


class NumberPrior(NamedTuple):
    """What is known of the free parameters without the data: R (values - mean) + e are residuals
    more. R [free free], with 1 / standard deviation on its diagonal for priors of single numbers;
    rows of zeros say nothing.
    """

    mean: np.ndarray
    R: np.ndarray
    e: np.ndarray

    def at(self, values: Any) -> Any:
        """The residuals [... free] at values [... free]."""
        return jnp.sum((values - self.mean)[..., None, :] * self.R, -1) + self.e


class FitProblem(AbstractProblem):
    """Free numbers of a model on some runs.

    `base` holds every number of the layout, `free` the positions of those that are fitted between
    `lower` and `upper` (both over the whole layout, like `scale`, a typical change). `records`
    selects records of the runs, by default all that the residual made. With `differences` the
    Jacobian is made of forward (1) or central (2) differences and not of tangents (0): it is good
    to about 1e-6 or 1e-9, and needs no program but the one that simulates, which compiles faster.
    `priors` has mean and standard deviation of numbers of the layout: each is one more residual of
    a sum of squares.
    """

    def __init__(
        self,
        runs: Runs,
        base: np.ndarray,
        free: Sequence[int] | np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        records: Sequence[int] | None = None,
        loss: str = "sum_of_squares",
        scale: np.ndarray | None = None,
        differences: int = 0,
        priors: Mapping[int, tuple[float, float]] | None = None,
    ):
        if loss not in LOSSES:
            raise UsageError(f"unknown loss {loss!r}; there is: {', '.join(LOSSES)}")
        self.differences = differences
        self.runs, self.base, self.loss_name = runs, np.asarray(base, np.float64), loss
        self.free = np.asarray(free, int)
        known = (
            {k: priors[int(i)] for k, i in enumerate(self.free) if int(i) in priors}
            if priors
            else {}
        )
        if known and loss != "sum_of_squares":
            raise UsageError(
                f"a prior is one more square: it has no place in {loss}; leave it out, or use"
                " sum_of_squares"
            )
        n = self.free.size
        self.known = NumberPrior(np.zeros(n), np.zeros((n, n)), np.zeros(n))
        for k, (mean, std) in known.items():
            self.known.mean[k], self.known.R[k, k] = mean, 1 / std
        self.records = list(runs.records if records is None else records)
        self.log = runs.layout.log[self.free] & (lower[self.free] > 0)
        self.start0 = np.array(
            [np.concatenate([runs.record(r).q0, runs.record(r).qd0]) for r in self.records]
        )
        self.start_free = np.array([runs.record(r).free for r in self.records], bool)
        rows, columns = np.nonzero(self.start_free)
        self.start_rows, self.start_columns = rows, columns
        reach = self._start_reach()
        self.lower = np.concatenate(
            [self._search(lower[self.free]), (self.start0 - reach)[rows, columns]]
        )
        self.upper = np.concatenate(
            [self._search(upper[self.free]), (self.start0 + reach)[rows, columns]]
        )
        typical = (
            0.02 * (self.upper - self.lower)[: self.free.size]
            if scale is None
            else scale[self.free]
        )
        self.scale = np.concatenate([np.where(self.log, 1.0, typical), 0.1 * reach[rows, columns]])
        self.whole, self.priors = (lower, upper, scale), priors
        self.predict, self.programs = runs.engine.predictor(self.base, self.free)
        self._bounds = runs.engine.bounds(self.base, self.free, self.records)
        self.work = int(self._bounds[1].max()) * len(self.records)
        self.targets, self.weights = runs.targets, runs.weights
        self._data: Data | None = None
        self._pure: Any = None

    def _start_reach(self) -> np.ndarray:
        """How far an unknown start may lie from its guess: a fifth of the travel, the travel per
        tenth of the run; the largest speed where that is read, and the whole travel (at least half
        a turn) where nothing else is.
        """
        out, chain = [], self.runs.layout.chain
        own, linear = (
            joint_readings(chain),
            [chain.signature.unit("{X}", j) == "m" for j in range(chain.nq)],
        )
        for r in self.records:
            record = self.runs.record(r)
            e = self.runs.experiments[record.experiment]
            nq = len(record.q0)
            y = e.motion()
            travel = np.ptp(y, axis=0)[:nq] if y.shape[1] >= nq else np.full(nq, np.ptp(y))
            q, qd = (
                0.2 * travel + 1e-6,
                10 * travel / (e.t[-1] - e.t[0]) + 2 * np.abs(record.qd0) + 1e-6,
            )
            if self.start_free.any() and any(r.qd is not None for r in own):
                at = np.arange(record.first, record.last + 1)
                at = at[(self.runs.weights[at] > 0).any(1)]
                travel, speed = sizes(
                    chain, np.asarray(self.runs.engine.samples.t)[at], self.runs.targets[at]
                )
                for j, r in enumerate(own):
                    q[j] = q[j] if r == (None, None) else 0.2 * travel[j] + 1e-6
                    if r.qd is not None:
                        qd[j] = speed[j] + 1e-6
                        q[j] = (
                            q[j]
                            if r.q is not None
                            else travel[j] + 1e-6
                            if linear[j]
                            else max(travel[j], np.pi)
                        )
            out.append(np.concatenate([q, qd]))
        return np.array(out)

    def _search(self, values: np.ndarray) -> np.ndarray:
        return np.where(self.log, np.log(np.where(self.log, values, 1.0)), values)

    @property
    def names(self) -> list[str]:
        """Printed names of z."""
        joints = self.runs.layout.chain.signature.joints
        states = [*joints, *(f"{j} velocity" for j in joints)]
        params = [self.runs.layout.names[i] for i in self.free]
        return params + [
            f"start of record {r}: {states[c]}"
            for r, c in zip(self.start_rows, self.start_columns, strict=True)
        ]

    def z(self, theta: np.ndarray, starts: np.ndarray | None = None) -> np.ndarray:
        """Search vector of a full parameter vector and starts [records 2 nq]."""
        starts = self.start0 if starts is None else starts
        z = np.concatenate(
            [self._search(theta[self.free]), starts[self.start_rows, self.start_columns]]
        )
        return np.clip(z, self.lower, self.upper)

    def theta(self, z: np.ndarray) -> np.ndarray:
        """Every number of the model at z."""
        out = self.base.copy()
        part = z[: self.free.size]
        out[self.free] = np.where(self.log, np.exp(np.where(self.log, part, 0.0)), part)
        return out

    def starts(self, z: np.ndarray) -> np.ndarray:
        """Start of each record, [records 2 nq]."""
        out = self.start0.copy()
        out[self.start_rows, self.start_columns] = z[self.free.size :]
        return out

    def dtheta(self, z: np.ndarray) -> np.ndarray:
        """d theta / d z of the free parameters."""
        return np.where(self.log, self.theta(z)[self.free], 1.0)

    def columns(self, row: int) -> list[int]:
        """Columns of z on which one record depends: the parameters and its own start."""
        return [
            *range(self.free.size),
            *(self.free.size + np.flatnonzero(self.start_rows == row)).tolist(),
        ]

    def steps(self, z: np.ndarray) -> dict[int, np.ndarray]:
        """Steps within the bounds to either side of z, by side; for forward differences one, to
        where there is room.
        """
        h = STEPS[self.differences] * self.scale
        if self.differences == 2:
            return {1: np.minimum(h, self.upper - z), -1: -np.minimum(h, z - self.lower)}
        return {1: np.where(z + h <= self.upper, h, -h), -1: np.zeros_like(h)}

    def precise(self) -> FitProblem:
        twin = copy.copy(self)
        twin.differences = 2 if self.differences else 0
        return twin

    # ---- the one loss

    @property
    def data(self) -> Data:
        if self._data is None:
            engine, records = self.runs.engine, self.records
            count, norm = self._scales()
            own = self.weights is not self.runs.weights
            samples = self.runs.samples
            if own:
                samples = samples._replace(w=self.weights)
            stated = engine.overrides[records]
            self._data = Data(
                samples=samples,
                fixed=np.where(np.isnan(stated), self.base, stated),
                open=np.isnan(stated[:, self.free]),
                log=self.log,
                start0=self.start0,
                start_rows=self.start_rows,
                start_columns=self.start_columns,
                where=self._bounds[0],
                scored=np.array([self.runs.record(r).samples[0] for r in records], np.int32),
                counts=np.array([self.runs.record(r).count for r in records], np.int32),
                steps=self._bounds[1],
                count=count,
                norm=norm,
                known=self.known,
            )
        return self._data

    @property
    def pure(self) -> Losses:
        predict, length, loss = self.predict, self.runs.engine.length, LOSSES[self.loss_name]

        def losses(z: Array, data: Data) -> Array:
            own = sums(predict, length, loss, z, data)
            part = z[:, : data.log.shape[0]]
            values = jnp.where(data.log, jnp.exp(jnp.where(data.log, part, 0.0)), part)
            own = own.at[:, 0].add(jnp.sum(data.known.at(values) ** 2, -1))
            return penalised(loss.total(own, data.count, data.norm))

        return losses

    def known_before(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        known = self.known
        J = np.zeros((self.free.size, self.size))
        J[:, : self.free.size] = known.R * self.dtheta(z)
        told = np.any(known.R != 0, 1)
        return (known.R @ (self.theta(z)[self.free] - known.mean) + known.e)[told], J[told]

    def knowing(self, known: NumberPrior) -> FitProblem:
        """The same problem with other numbers known without its data."""
        twin = copy.copy(self)
        twin.known, twin._data, twin._pure = known, None, None
        return twin

    def begun(self, z):
        if not self.runs.engine.long:
            return super().begun(z)
        from jaxid.problem.long_records import losses_by_windows

        return lambda: losses_by_windows(
            self, np.atleast_2d(np.asarray(z, np.float64)), super(FitProblem, self).begun
        )

    def compile_losses(self):
        return (lambda: None) if self.runs.engine.long else super().compile_losses()

    def residual_function(self):
        from jaxid.problem.pure_problem import pure, residual_of

        if self._pure is None:
            self._pure = pure(self, np.clip(self.z(self.base), self.lower, self.upper))
        return residual_of, self._pure

    @property
    def compile_time_s(self) -> float:
        return self.runs.engine.compile_time_s

    def add_compile_time(self, seconds: float) -> None:
        self.runs.engine.compile_time_s += seconds

    @classmethod
    def rows(
        cls, jobs: Sequence[tuple[FitProblem, np.ndarray]], share: float = 1.0, pieces: bool = False
    ) -> Iterator[ResidualRows]:
        """A record's residual depends on the parameters and on its own start only, so the lanes of
        a record carry just those tangents. All jobs are on the same runs.
        """
        lanes = lanes_of(jobs)
        if not jobs[0][0].runs.engine.long:
            return rows_of_records(jobs, lanes, share)
        from jaxid.problem.long_records import rows_by_windows

        return rows_by_windows(
            jobs, lanes, share, pieces, functools.partial(rows_of_records, share=share)
        )

    @property
    def pieces(self) -> int:
        return len(self.records)

    @property
    def weighted(self) -> bool:
        return self.loss_name == "sum_of_squares"

    @property
    def by_windows(self) -> bool:
        return len(self.records) > len(self.runs.experiments)

    def part(self, pieces, weights):
        records = [self.records[k] for k in pieces]
        lower, upper, scale = self.whole
        twin = FitProblem(
            runs=self.runs,
            base=self.base,
            free=self.free,
            lower=lower,
            upper=upper,
            records=records,
            loss=self.loss_name,
            scale=scale,
            differences=self.differences,
            priors=self.priors,
        )
        if any(w != 1 for w in weights):
            twin.weights = self.weights.copy()
            for number, w in zip(records, weights, strict=True):
                twin.weights[self.runs.record(number).samples] *= np.sqrt(w)
        return twin

    def with_targets(self, targets: np.ndarray) -> FitProblem:
        """The same problem with other measurements (the shape of `runs.targets`) in its residual
        and Jacobian. `losses` goes on to compare with the recorded ones.
        """
        twin = copy.copy(self)
        twin.targets, twin._pure = targets, None
        return twin

    def _scales(self) -> tuple[np.ndarray, np.ndarray]:
        """Per residual column: the number of samples (by their weight), and the sum of squares of
        the measured signal.
        """
        count, norm = 0.0, 0.0
        for r in self.records:
            record = self.runs.record(r)
            w = self.weights[record.samples] > 0
            share = self.weights[record.samples] / np.where(
                w, self.runs.weights[record.samples], 1.0
            )
            count = count + (share**2).sum(0)
            norm = norm + np.sum(np.where(w, self.runs.targets[record.samples], 0.0) ** 2, 0)
        return np.asarray(count, float), np.asarray(norm, float)

    def predictions(self, z: np.ndarray) -> list[np.ndarray]:
        """Prediction of each record at its samples, [samples columns]."""
        lanes = np.array(self.records)
        theta = np.tile(self.theta(z), (lanes.size, 1))
        y = self.runs.engine.outputs(theta, self.starts(z), lanes)
        return [self.runs.sample_prediction(r, row) for r, row in zip(self.records, y, strict=True)]

    def residuals(self, z: np.ndarray) -> list[np.ndarray]:
        """Residual of each record at its samples over the noise, [samples columns]."""
        at = [self.runs.record(r).samples for r in self.records]
        return [
            self.weights[k] * (y - self.targets[k])
            for k, y in zip(at, self.predictions(z), strict=True)
        ]


def sums(
    predict: Callable, length: int, loss: Loss, z: Float[Array, "pop size"], data: Data
) -> Float[Array, "pop columns"]:
    """What a loss sums, per candidate and residual column. Pure.

    Blocks of candidates, of like size, on one record each: what depends neither on the candidate
    nor on the step is worked out once.
    """
    pop, R, nfree = z.shape[0], data.where.shape[0], data.log.shape[0]
    part = z[:, :nfree]
    values = jnp.where(data.log, jnp.exp(jnp.where(data.log, part, 0.0)), part)
    starts = jnp.broadcast_to(data.start0, (pop, *data.start0.shape))
    starts = starts.at[:, data.start_rows, data.start_columns].set(z[:, nfree:])
    blocks = -(-pop // CANDIDATES)
    lanes = 4 * -(-pop // (4 * blocks))

    def pad(a):
        return jnp.concatenate([a, jnp.broadcast_to(a[-1:], (blocks * lanes - pop, *a.shape[1:]))])

    values, starts = (pad(a).reshape(blocks, lanes, *a.shape[1:]) for a in (values, starts))
    k = jnp.arange(length)

    def block(number):
        r = number % R
        where, count = data.where[r], data.counts[r]
        offset, _, last, _ = where
        at = jnp.minimum(offset + k, last)
        inside = ((offset + k >= data.scored[r]) & (k < count))[:, None]
        w = jnp.where(inside, data.samples.w[at], 0.0)
        y = data.samples.y[at]

        def lane(values, start):
            prediction = predict(
                values, data.open[r], data.fixed[r], start, where, data.samples, data.steps[r]
            )
            e = jnp.where(w > 0, prediction - y, 0.0)
            return jnp.sum(loss.summed(e, w * e), 0)

        return batched_vmap(lane)(values[number // R], starts[number // R, :, r])

    totals = jax.lax.map(block, jnp.arange(blocks * R)).reshape(blocks, R, lanes, -1)
    return jnp.sum(totals, 1).reshape(blocks * lanes, -1)[:pop]


__all__ = [
    "LOSSES",
    "PENALTY",
    "Data",
    "Linear",
    "FitProblem",
    "ResidualRows",
    "gauss_newton_model",
    "linearise",
    "rows",
    "sums",
]
