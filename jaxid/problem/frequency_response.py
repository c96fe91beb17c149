"""Frequency responses: of a model, and as a residual.

A response is compared in one of two ways. `linear`: that of the model linearised at rest (smooth
friction counts, dry friction and dead zones do not exist in it). `simulated`: the model is run on
the record's own input and its output goes through the estimator that the data went through, so that
dry friction bends both alike; with short or weak pulses a linear response is wrong by half (paper
002's pulse: the elastic modulus 38 % off).
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxid.base.errors import nearest, UsageError
from jaxid.data.dataset import Dataset, Experiment, FrequencyResponse as Measured
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.mechanism import Mechanism
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.problem.residual import overrides, record_of, Residual, Runs, Simulation
from jaxid.problem.response_lines import estimate, merged, parts_of
from jaxid.simulation import sample_buffers as recorded
from jaxid.simulation.batch import BatchSimulator
from jaxid.simulation.rollout import EVEN, Lane, simulate_rollout
from jaxid.simulation.sample_buffers import Record, Samples
from jaxid.simulation.transfer import transfer


# ---- measured responses


# ---- lanes: rows 2k and 2k + 1 of a response column are real and imaginary part of line k


def _interleaved(re: Array, im: Array, length: int) -> Array:
    return jnp.stack([re, im], 1).reshape(length, -1)


def _of_lines(
    chain: Chain,
    samples: Samples,
    begin: Array,
    last: Array,
    length: int,
    magnitude: bool,
    body: Mechanism | None = None,
) -> Array:
    """Linear response at the lines of a record, [length 1]; `samples.x` holds omega, output and
    input of each line.
    """
    x = samples.x[jnp.minimum(begin + 2 * jnp.arange(length // 2), last)]
    re, im = transfer(chain, jnp.where(x[:, 0] > 0, x[:, 0], 1.0), body=body)  # rows without a line

    def pick(a):
        return a[jnp.arange(length // 2), x[:, 1].astype(int), x[:, 2].astype(int)]

    re, im = pick(re), pick(im)
    if magnitude:
        re, im = jnp.sqrt(re * re + im * im), jnp.zeros_like(im)
    return _interleaved(re, im, length)


@functools.cache
def line_lane(magnitude: bool) -> Lane:
    """Linear response at measured lines."""

    def lane(chain, samples, where, start, steps, length, reach, burn):
        return _of_lines(chain, samples, where[0], where[2], length, magnitude)

    return lane


@functools.cache
def record_lane(
    magnitude: bool,
    linear: bool,
    output: int,
    timed: tuple[int, ...],
    count: int,
    pieces: int,
    room: int,
) -> Lane:
    """Columns: the response to `output`, then the simulated outputs `timed`; records of `count`
    samples, `pieces` steps each, and at most `room` / 2 lines in any of them.

    `samples.x` holds, per line, omega, output, input, the bin, and 1 / U.
    """

    def lane(chain, samples, where, start, steps, length, reach, burn):
        begin, _, last, _ = where
        body = chain.body().prepare(samples.h[begin] if reach == EVEN else None)
        y = simulate_rollout(
            chain=chain,
            samples=samples,
            where=where,
            start=start,
            steps=steps,
            length=length,
            reach=reach,
            burn=burn,
            body=body,
            wanted=timed if linear else None,
        )
        size = min(room, length)
        if linear:
            response = _of_lines(chain, samples, begin, last, size, magnitude, body)
        else:
            x = samples.x[jnp.minimum(begin + 2 * jnp.arange(size // 2), last)]
            Y = jnp.fft.rfft(y[: count * pieces : pieces, output])
            Y = Y[jnp.clip(x[:, 3].astype(int), 0, Y.size - 1)]
            a, b = Y.real, Y.imag
            re, im = a * x[:, 4] - b * x[:, 5], a * x[:, 5] + b * x[:, 4]
            if magnitude:
                power = re * re + im * im
                re, im = jnp.sqrt(jnp.where(power > 0, power, 1e-300)), jnp.zeros_like(im)
            response = _interleaved(re, im, size)
        response = jnp.concatenate([response, jnp.zeros((length - size, 1))])
        return jnp.concatenate([response, y[:, jnp.array(timed, int)]], 1)

    return lane


# ---- the residual


@dataclass(frozen=True)
class FrequencyResponseError(Residual):
    """Measured against modelled frequency response.

    Experiments of kind "frequency_response" are compared with the linear response. From records the
    response is estimated: `output` (default: the last output) over the model's only input, in
    `band_hz`, from records of equal length and sampling; `linear` compares it with the linear
    response, else with that of the simulated record. `timed` outputs are compared in time besides;
    with measured responses in the dataset those are the lines, and the records are compared in
    time. `magnitude` takes gains alone (paper 002's loss); else real and imaginary part, which a
    wrong sign cannot pass.
    """

    name: ClassVar[str] = "frequency_response"
    simulation: ClassVar[Simulation] = "frequency_response"
    magnitude: bool = False
    linear: bool = False
    output: str | None = None
    timed: tuple[str, ...] = ()
    band_hz: tuple[float, float] = (0.0, 50.0)
    least_input: float = 0.1

    def _alone(self, dataset: Dataset) -> bool:
        """Whether measured responses are all there is to compare."""
        return bool(dataset.responses) and not (self.timed and dataset.experiments)

    def select(self, dataset, split):
        if self._alone(dataset):
            return tuple(as_experiment(r, dataset) for r in dataset.responses if r.split == split)
        return dataset.split(split)

    def runs(self, dataset, experiments, layout, noise, motions, step=recorded.STEP, shape=(0, 0)):
        if self._alone(dataset):
            return self._lines(dataset, experiments, layout)
        return self._records(dataset, experiments, layout, noise, step, shape)

    def _lines(
        self, dataset: Dataset, experiments: Sequence[Experiment], layout: ParameterVector
    ) -> Runs:
        chain = layout.chain
        outputs, inputs = list(dict(chain.signature.outputs)), list(dict(chain.signature.inputs))
        table = {r.name: r for r in dataset.responses}
        x, y, w, records, first, statements = [], [], [], [], 0, []
        for number, e in enumerate(experiments):
            measured = table[e.name]
            lines = merged(measured)
            where = (
                _position(measured.output, outputs, "output"),
                _position(measured.input, inputs, "input"),
            )
            x.append(
                np.repeat(
                    np.column_stack([lines.omega, np.tile(where, (lines.omega.size, 1))]), 2, 0
                )
            )
            target, weight = parts_of(lines.response, lines.std, self.magnitude)
            y.append(target)
            w.append(weight)
            rows = np.arange(first, first + len(target))
            still = np.zeros(chain.nq)
            kept = rows[weight > 0]
            records.append(
                Record(
                    experiment=number,
                    offset=first,
                    count=len(rows),
                    first=first,
                    last=int(rows[-1]),
                    lead=0,
                    q0=still,
                    qd0=still,
                    free=np.zeros(2 * chain.nq, bool),
                    samples=kept,
                )
            )
            first += len(rows)
            statements.append(lines.statement)
        size = recorded.bucket(first)

        def pad(a):
            return np.concatenate([a, np.zeros((size - len(a), *a.shape[1:]))])

        nu = len(inputs)
        zeros = np.zeros((size, nu))
        samples = Samples(
            t=np.arange(size) * 1.0,
            h=np.ones(size),
            u=zeros,
            other=zeros,
            total=zeros,
            y=pad(np.concatenate(y))[:, None],
            w=pad(np.concatenate(w))[:, None],
            x=pad(np.concatenate(x)),
        )
        engine = BatchSimulator(
            layout,
            samples,
            records,
            overrides(layout, experiments, records),
            line_lane(self.magnitude),
        )
        pairs = {(table[e.name].output, table[e.name].input) for e in experiments}
        channel = _ratio(chain, *pairs.pop()) if len(pairs) == 1 else ("response", "SI")
        part = "gain of the" if self.magnitude else "complex"
        return Runs(
            experiments=tuple(experiments),
            layout=layout,
            channels=(channel,),
            noise=np.array([float(np.median(1 / np.concatenate(w)[np.concatenate(w) > 0]))]),
            engine=engine,
            records=tuple(range(len(records))),
            heads=(),
            statement=f"{part} linear frequency response ({'; '.join(dict.fromkeys(statements))})",
        )

    def _records(self, dataset, experiments, layout, noise, step, shape) -> Runs:
        chain = layout.chain
        if len(chain.signature.inputs) != 1:
            raise UsageError(
                "a frequency response from records needs a model with one input; measure responses,"
                " or output_error"
            )
        outputs = chain.signature.output_names
        output = (
            len(outputs) - 1 if self.output is None else _position(self.output, outputs, "output")
        )
        timed = tuple(_position(n, outputs, "output") for n in self.timed)
        if dataset.responses:
            return self._mixed(dataset, experiments, layout, noise, step, shape, timed)
        count, spacing = _alike(experiments)
        (iu,), iy = recorded.columns(dataset, chain)
        samples, positions = recorded.build(dataset, experiments, chain, noise, step, size=shape[0])
        pieces = int(recorded.pieces(experiments[0], step)[0])
        n = len(samples.t)
        y, w, x = np.zeros((n, 1 + len(timed))), np.zeros((n, 1 + len(timed))), np.zeros((n, 6))
        records, lines = [], 0
        for number, e in enumerate(experiments):
            p = positions[number]
            bins, U, Y = estimate(
                e.t, e.u[:, iu], e.motion()[:, iy[output]], self.band_hz, self.least_input
            )
            if not bins.size and e.split == "fit":
                raise UsageError(
                    f"{e.name}: the input excites no line between {self.band_hz[0]:g} and"
                    f" {self.band_hz[1]:g} Hz"
                )
            omega = 2 * np.pi * bins / (count * np.median(np.diff(e.t)))
            std = noise[output] * np.sqrt(count / 2) / np.abs(U)
            target, weight = parts_of(Y / U, std, self.magnitude)
            rows = p[0] + np.arange(target.size)
            y[rows, 0], w[rows, 0] = target, weight
            inverse = 1 / U
            each = np.column_stack(
                [
                    omega,
                    np.full(omega.size, output),
                    np.zeros(omega.size),
                    bins,
                    inverse.real,
                    inverse.imag,
                ]
            )
            x[rows] = np.repeat(each, 2, 0)
            for c, k in enumerate(timed):
                y[p, 1 + c], w[p, 1 + c] = e.y[:, iy[k]], e.read[:, iy[k]] / noise[k]
            records.append(_record(dataset, chain, number, e, p, w))
            lines += bins.size
        samples = samples._replace(y=y, w=w, x=x)
        inside = (self.band_hz[1] - self.band_hz[0]) * count * np.median(
            spacing
        ) + 1  # lines of a record in the band, at most
        room = recorded.bucket(2 * min(int(inside), count // 2 + 1), 64)
        lane = record_lane(self.magnitude, self.linear, output, timed, count, pieces, room)
        engine = BatchSimulator(
            layout, samples, records, overrides(layout, experiments, records), lane, shape[1]
        )
        ratio = _ratio(chain, outputs[output], chain.signature.inputs[0][0])
        own = [
            float(np.median(1 / w[w[:, 0] > 0, 0])) if lines else 1.0,
            *(noise[k] for k in timed),
        ]
        part, kind = (
            "gain of the" if self.magnitude else "complex",
            "linear" if self.linear else "simulated",
        )
        return Runs(
            experiments=tuple(experiments),
            layout=layout,
            channels=(ratio, *(chain.signature.outputs[k] for k in timed)),
            noise=np.array(own),
            engine=engine,
            records=tuple(range(len(records))),
            heads=(),
            statement=(
                f"{part} response of the records against the {kind} one, {lines} lines where the"
                f" input has at least {self.least_input:.0%} of its largest amplitude, no"
                f" window{'; ' * bool(timed)}{', '.join(self.timed)}{' in time' * bool(timed)}"
            ),
        )

    def _mixed(self, dataset, experiments, layout, noise, step, shape, timed) -> Runs:
        """Measured lines (in the first record's rows) beside records that are compared in time."""
        if not self.linear:
            raise UsageError(
                "measured responses are compared with the linear one: say linear=True, or leave"
                " `timed` empty"
            )
        chain, split = layout.chain, experiments[0].split
        outputs, inputs = list(dict(chain.signature.outputs)), list(dict(chain.signature.inputs))
        samples, positions = recorded.build(dataset, experiments, chain, noise, step, size=shape[0])
        _, iy = recorded.columns(dataset, chain)
        n = len(samples.t)
        y, w, x = np.zeros((n, 1 + len(timed))), np.zeros((n, 1 + len(timed))), np.zeros((n, 3))
        row, records, statements = int(positions[0][0]), [], []
        measured = [r for r in dataset.responses if r.split == split]
        for one in measured:
            lines = merged(one)
            low, high = (
                2 * np.pi * np.asarray(self.band_hz) * [1 - 1e-9, 1 + 1e-9]
            )  # a line at an end is in it, rounded or not
            inside = (lines.omega >= low) & (lines.omega <= high)
            where = _position(one.output, outputs, "output"), _position(one.input, inputs, "input")
            target, weight = parts_of(lines.response[inside], lines.std[inside], self.magnitude)
            rows = slice(row, row + target.size)
            if rows.stop > positions[0][-1] + 1:
                raise UsageError("there are more lines than steps in the first run: narrow band_hz")
            y[rows, 0], w[rows, 0] = target, weight
            x[rows] = np.repeat(
                np.column_stack([lines.omega[inside], np.tile(where, (inside.sum(), 1))]), 2, 0
            )
            row += target.size
            statements.append(lines.statement)
        for number, e in enumerate(experiments):
            p = positions[number]
            for c, k in enumerate(timed):
                y[p, 1 + c], w[p, 1 + c] = e.y[:, iy[k]], e.read[:, iy[k]] / noise[k]
            records.append(_record(dataset, chain, number, e, p, w))
        lines_of_split: Counter[str] = Counter()
        for r in dataset.responses:
            lines_of_split[r.split] += r.omega.size
        room = recorded.bucket(2 * max(lines_of_split.values()), 64)
        lane = record_lane(self.magnitude, True, 0, timed, 0, 1, room)
        stated = overrides(layout, experiments, records)
        engine = BatchSimulator(
            layout, samples._replace(y=y, w=w, x=x), records, stated, lane, shape[1]
        )
        pairs = {(r.output, r.input) for r in measured}
        ratio = _ratio(chain, *pairs.pop()) if len(pairs) == 1 else ("response", "SI")
        own = [
            float(np.median(1 / w[w[:, 0] > 0, 0])) if measured else 1.0,
            *(noise[k] for k in timed),
        ]
        return Runs(
            experiments=tuple(experiments),
            layout=layout,
            channels=(ratio, *(chain.signature.outputs[k] for k in timed)),
            noise=np.array(own),
            engine=engine,
            records=tuple(range(len(records))),
            heads=(),
            statement=(
                f"{'gain of the' if self.magnitude else 'complex'} linear frequency response "
                f"({'; '.join(dict.fromkeys(statements))}), {', '.join(self.timed)} in time"
            ),
        )


def as_experiment(measured: Measured, dataset: Dataset) -> Experiment:
    """A response as a run of a split, for bookkeeping: its lines in place of time."""
    omega = np.unique(measured.omega)

    def blank(n):
        return np.zeros((omega.size, n))

    return Experiment(
        measured.name,
        measured.split,
        omega,
        blank(len(dataset.inputs)),
        blank(len(dataset.outputs)),
    )


def _ratio(chain: Chain, output: str, input: str) -> tuple[str, str]:
    units = dict((*chain.signature.outputs, *chain.signature.inputs))
    return f"{output} / {input}", f"({units[output]})/({units[input]})"


def _position(name: str, names: Sequence[str], kind: str) -> int:
    if name not in names:
        raise UsageError(f"the model has no {kind} {name!r}{nearest(name, names)}")
    return list(names).index(name)


def _alike(experiments: Sequence[Experiment]) -> tuple[int, np.ndarray]:
    """Samples of each run, and their spacing. Raises `UsageError` where runs are not alike."""
    counts = {len(e.t) for e in experiments}
    spacing = np.concatenate([np.diff(e.t) for e in experiments])
    if len(counts) > 1 or np.ptp(spacing) > 1e-3 * np.median(spacing):
        raise UsageError(
            "a frequency response from records needs runs of equal length at one sampling rate;"
            " cut them with `rows` or `window_s`, or use output_error"
        )
    return counts.pop(), spacing


def _record(
    dataset: Dataset, chain: Chain, number: int, e: Experiment, p: np.ndarray, w: np.ndarray
) -> Record:
    """The record of a run at rows p, of which those with a weight in w [rows columns] count."""
    record = record_of(
        number=number, e=e, p=p, a=0, b=len(e.t), dataset=dataset, chain=chain, burn=False
    )
    kept = np.flatnonzero((w[p[0] : p[-1] + 1] > 0).any(1)) + p[0]
    return Record(**{**record.__dict__, "samples": kept})
