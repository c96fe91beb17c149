"""Runs of the product's chains for the tests: many parameter sets on one command, in one compiled
program.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import diffrax
import jax
import numpy as np

from jaxid.data.dataset import Channel, Dataset, Experiment
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter import TypicalMagnitudes
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.simulation import sample_buffers as samples
from jaxid.simulation.batch import BatchSimulator
from jaxid.simulation.rollout import simulate_rollout
from jaxid.simulation.sample_buffers import Record


#: `jax.jit` for a program that runs a few times only: compiling it is what takes time.
quick_jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})


class Simulator:
    """A chain on one command u [time nu], in steps no longer than `step`; programs are shared by
    equal `size`.
    """

    def __init__(
        self,
        chain: Chain,
        t: np.ndarray,
        u: np.ndarray,
        step: float = 2e-3,
        hold: str = "zero",
        size: int = 4096,
        whole: bool = False,
    ):
        signature = chain.signature
        channels = [Channel(n, "input", unit, hold=hold) for n, unit in signature.inputs]
        channels += [Channel(n, "output", unit) for n, unit in signature.outputs]
        run = Experiment("run", "fit", t, u, np.zeros((len(t), len(signature.outputs))))
        dataset = Dataset("data", tuple(channels), (run,))
        self.layout = ParameterVector(chain)
        buffers, (self.positions,) = samples.build(
            dataset, [run], chain, np.ones(len(signature.outputs)), step, size=size
        )
        nq, count = chain.nq, samples.step_count(run, step)
        still, known = np.zeros(nq), np.zeros(2 * nq, bool)
        record = Record(0, 0, count, 0, count - 1, 0, still, still, known, self.positions)
        self.engine = BatchSimulator(
            self.layout,
            buffers,
            [record],
            np.full((1, len(self.layout)), np.nan),
            simulate_rollout,
            size,
            whole,
        )

    def theta(self, values: Mapping[str, float]) -> np.ndarray:
        """All numbers of the chain: its own start values, and these."""
        out = self.layout.values.copy()
        for name, value in values.items():
            out[self.layout.index(name)] = value
        return out

    def outputs(
        self,
        values: Sequence[Mapping[str, float]] | np.ndarray,
        start: Sequence[float] | None = None,
    ) -> np.ndarray:
        """Outputs [sets time ny] of several parameter sets; `start` (q, qd)."""
        theta = (
            values if isinstance(values, np.ndarray) else np.array([self.theta(v) for v in values])
        )
        x = np.zeros(2 * self.layout.chain.nq) if start is None else np.asarray(start, float)
        y = self.engine.outputs(theta, np.tile(x, (len(theta), 1)), np.zeros(len(theta), int))
        return y[:, self.positions]

    def tangents(
        self, theta: np.ndarray, start: Sequence[float] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Outputs [time ny] at one parameter set and their derivatives [size time ny] by each of
        its numbers.
        """
        size, nx = len(theta), 2 * self.layout.chain.nq
        x = np.zeros(nx) if start is None else np.asarray(start, float)
        y, dy = self.engine.tangents(
            np.tile(theta, (size, 1)),
            np.tile(x, (size, 1)),
            np.eye(size),
            np.zeros((size, nx)),
            np.zeros(size, int),
        )
        return y[0][self.positions], dy[:, self.positions]


def flow(field: Callable[[Any], Any], x0: Any, seconds: float) -> Any:
    """State after so long, at 1e-11."""
    tight = diffrax.PIDController(rtol=1e-11, atol=1e-13)
    term, forward = diffrax.ODETerm(lambda t, x, args: field(x)), diffrax.ForwardMode()
    found = diffrax.diffeqsolve(
        term,
        diffrax.Dopri8(),
        0.0,
        seconds,
        1e-4,
        x0,
        stepsize_controller=tight,
        max_steps=10**6,
        adjoint=forward,
    )
    return jax.tree.map(lambda x: x[-1], found.ys)


def relative(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of a from b as a share of b, over everything."""
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


#: Magnitudes of the test runs.
REFERENCE = TypicalMagnitudes(torque=1.0, speed=3.0, angle=1.0, duration=1.0, step=0.01)


def within_bounds(
    layout: ParameterVector,
    references: list[TypicalMagnitudes],
    rng: np.random.Generator,
    power: int = 1,
) -> np.ndarray:
    """A random draw of all numbers but the known constants; `power` > 1 prefers the lower end."""
    lower, upper, _ = layout.boxes(references)
    theta = layout.values.copy()
    for i, e in enumerate(layout.entries):
        x = rng.uniform() ** power
        if not e.spec.fixed:
            theta[i] = (
                lower[i] * (upper[i] / lower[i]) ** x
                if e.spec.log
                else lower[i] + x * (upper[i] - lower[i])
            )
    return theta
