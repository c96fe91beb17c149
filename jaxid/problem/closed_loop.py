"""Simulation of a model under the controller of the recording, and the residual that compares it
with the record.

A recording of a real drive is closed-loop: what disturbs the motion comes back through the
controller as torque. A simulation under the same law and reference is free of that noise: its
output error is unbiased, and its motion serves as instruments.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Experiment
from jaxid.dynamics import controller as feedback
from jaxid.dynamics.carry import Carry
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.controller import ControllerInput, Law, law_of, Memory
from jaxid.dynamics.effect import Command, InputEffect
from jaxid.problem.residual import (
    OutputError,
    overrides,
    record_of,
    Residual,
    Runs,
    Simulation,
)
from jaxid.simulation import sample_buffers as recorded
from jaxid.simulation.batch import BatchSimulator
from jaxid.simulation.rollout import Lane, over_time
from jaxid.simulation.sample_buffers import Samples


#: Which signals the simulation is compared by.
SIGNALS = ("outputs", "inputs", "both")


def closed_loop_lane(law: Law, signals: str = "outputs") -> Lane:
    """A lane that simulates a chain under a controller; its columns are the outputs, the model's
    inputs, or both.

    The reference, its rate, the disturbance and the controller's sampling instants are data, in
    `Samples.x` (`reference_data`). Equal laws give the same lane, so that they share compiled
    programs.
    """
    return _lane(law, signals)


@functools.cache
def _lane(law: Law, signals: str) -> Lane:
    n = len(law.kp)

    def reading(row) -> ControllerInput:
        return ControllerInput(row[:n], row[n : 2 * n], row[2 * n : 3 * n])

    def lane(chain, samples, where, start, steps, length, reach, burn):
        begin, _, last, _ = where
        body = chain.body().prepare(None)

        def step(carry: tuple[Carry, Memory], k) -> tuple[tuple[Carry, Memory], Any]:
            state, memory = carry
            i = jnp.minimum(begin + k, last)
            row, t, h = samples.x[i], samples.t[i], samples.h[i]
            y, z = chain.sense(
                body,
                state,
                jnp.zeros(n),
                jnp.zeros(n, bool),
                Command(t, h, memory.u, memory.u, lambda d: memory.u),
            )
            state = state._replace(z=z)
            new = feedback.update(law, memory, y, body.port(state.x)[1], reading(row))
            memory = jax.tree.map(lambda a, b: jnp.where(row[3 * n] > 0, a, b), new, memory)
            u = memory.u
            out = {"outputs": y, "inputs": u, "both": jnp.concatenate([y, u])}[signals]
            return (chain.advance(body, state, Command(t, h, u, u, lambda d: u))[0], memory), out

        q, qd, u = start[:n], start[n : 2 * n], samples.u[begin]
        carry = chain.start(q, qd, u), feedback.begin(law, q, qd, u, reading(samples.x[begin]))
        return over_time(step, carry, steps, length, 2 * n if signals == "both" else n)

    return lane


def reference_data(
    law: Law, experiments: Sequence[Experiment], samples: Samples, positions: Sequence[np.ndarray]
) -> np.ndarray:
    """What the controller is told at every step of the buffers, [n 3 nq + 1]: reference, its rate,
    disturbance, and 1 where the controller samples. The rate is the difference to the controller's
    previous sample.
    """
    n = len(law.kp)
    out = np.zeros((len(samples.t), 3 * n + 1))
    for e, p in zip(experiments, positions, strict=True):
        at = np.arange(p[0], p[-1] + 1)
        t, h = np.asarray(samples.t)[at], np.asarray(samples.h)[at]
        if law.every_sample:
            ticks = np.isin(at, p)
        else:
            count = np.floor(
                (t - t[0]) / law.sample_time + 0.5 * np.minimum(1.0, h / law.sample_time)
            )
            ticks = np.append(True, np.diff(count) > 0)
        for j in range(n):
            q_cmd = _auxiliary(e, law.references[j])
            out[at, j] = np.interp(t, e.t, q_cmd)
            if law.reference_velocity == "difference":
                before = np.interp(np.maximum(t - law.sample_time, t[0]), e.t, q_cmd)
                out[at, n + j] = (out[at, j] - before) / law.sample_time
            if law.disturbances[j]:
                held = np.clip(np.searchsorted(e.t, t + 1e-9, side="right") - 1, 0, len(e.t) - 1)
                out[at, 2 * n + j] = _auxiliary(e, law.disturbances[j])[held]
        out[at, 3 * n] = ticks
    return out


def _auxiliary(e: Experiment, name: str) -> np.ndarray:
    if name not in e.auxiliary:
        raise UsageError(
            f"experiment {e.name} has no auxiliary channel {name!r}, which [controller] needs"
        )
    return e.auxiliary[name]


@dataclass(frozen=True)
class ClosedLoopOutputError(Residual):
    """The simulation under the recording's controller against the record; beyond the contract's
    four residuals.

    `signals` says which record: the measured `outputs` (default), the model's `inputs` (the drive
    torque that the simulated loop asks for), or `both`. Needs `[controller]` and the reference;
    effects that shift the command in time (`input_delay`, `input_hold`) are not simulated here.
    """

    name: ClassVar[str] = "closed_loop"
    simulation: ClassVar[Simulation] = "closed_loop"
    signals: str = "outputs"

    def runs(self, dataset, experiments, layout, noise, motions, step=recorded.STEP, shape=(0, 0)):
        if self.signals not in SIGNALS:
            raise UsageError(f"signals is {self.signals!r}; it is one of {', '.join(SIGNALS)}")
        chain: Chain = layout.chain
        if (
            getattr(chain.mechanism, "drive_law", None) is not None
        ):  # its free run is the one under the law
            if self.signals != "outputs":
                raise UsageError("a robot that its goals drive is compared by its outputs alone")
            return OutputError().runs(dataset, experiments, layout, noise, motions, step, shape)
        law = law_of(dataset, chain.signature)
        commands = [e for e in chain.effects if isinstance(e, InputEffect)]
        shifted = {e.name for e in commands if e.acts_on == "timing"}
        if shifted:
            raise UsageError(
                f"closed_loop does not simulate {' and '.join(sorted(shifted))}: use output_error"
                " for them"
            )
        step = min(step, 1.01 * law.sample_time)
        samples, positions = recorded.build(dataset, experiments, chain, noise, step, size=shape[0])
        iu, _ = recorded.columns(dataset, chain)
        levels = input_noise(experiments, iu)
        u, wu = np.zeros_like(samples.y), np.zeros_like(samples.w)
        for e, p in zip(experiments, positions, strict=True):
            u[p], wu[p] = e.u[:, iu], 1 / levels
        y, w = {
            "outputs": (samples.y, samples.w),
            "inputs": (u, wu),
            "both": (np.concatenate([samples.y, u], 1), np.concatenate([samples.w, wu], 1)),
        }[self.signals]
        samples = samples._replace(y=y, w=w, x=reference_data(law, experiments, samples, positions))
        records = [
            record_of(
                number=i,
                e=e,
                p=positions[i],
                a=0,
                b=len(e.t),
                dataset=dataset,
                chain=chain,
                burn=False,
            )
            for i, e in enumerate(experiments)
        ]
        engine = BatchSimulator(
            layout,
            samples,
            records,
            overrides(layout, experiments, records),
            closed_loop_lane(law, self.signals),
            shape[1],
        )
        columns = {
            "outputs": (chain.signature.outputs, noise),
            "inputs": (chain.signature.inputs, levels),
            "both": ((*chain.signature.outputs, *chain.signature.inputs), np.append(noise, levels)),
        }
        channels, levels = columns[self.signals]
        return Runs(
            experiments=tuple(experiments),
            layout=layout,
            channels=channels,
            noise=levels,
            engine=engine,
            records=tuple(range(len(records))),
            heads=(),
            statement=f"simulation under the {law.text}, compared by {self.signals}",
        )


def input_noise(experiments: Sequence[Experiment], inputs: Sequence[int]) -> np.ndarray:
    """White noise of the recorded inputs (third differences), at least a thousandth of their span,
    [inputs].
    """
    out = []
    for i in inputs:
        series = [e.u[:, i] for e in experiments]
        third = np.concatenate([np.diff(u, 3) for u in series]) / np.sqrt(20.0)
        span = float(np.percentile(np.abs(np.concatenate(series)), 99))
        out.append(max(1.4826 * float(np.median(np.abs(third))), 1e-3 * span, 1e-12))
    return np.array(out)
