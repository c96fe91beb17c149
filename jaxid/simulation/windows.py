"""Long records window by window: what lanes predict is taken a stretch of steps at a time, and only
their states stay.

A record of millions of samples would need gigabytes for every lane's prediction and derivative; of
a window they need megabytes. The arithmetic is that of the whole record, step by step.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, TYPE_CHECKING

import jax
import numpy as np

from jaxid.dynamics.parameter_vector import ChainForm
from jaxid.numerics.batch_loop import batched_vmap
from jaxid.numerics.pool import Pool
from jaxid.numerics.precision import float64
from jaxid.simulation.rollout import Lane, WINDOWED


if TYPE_CHECKING:
    from jaxid.simulation.batch import BatchSimulator, Programs

#: Records of more steps than LONG are taken in windows of this many.
WINDOW = 1 << 15
#: Lanes of one program; at most this many lanes go side by side.
WIDTH, TOGETHER = 16, 64

_POOL = Pool("windows")


class WindowPrograms(NamedTuple):
    """What a window of many lanes is computed by: predictions, those with derivatives, and the
    state with which a lane begins.
    """

    outputs: Callable[..., Any]
    tangents: Callable[..., Any]
    begins: Callable[..., Any]


def windowed(form: ChainForm, lane: Lane, reach: int, burn: bool) -> WindowPrograms:
    """Functions to compile; states go in and out as tuples of arrays."""
    window, begin = WINDOWED.get(lane, (None, None))

    def begins(theta, start, where, samples):
        return begin(form.model(theta), samples, where, start, reach, burn) if begin else ()

    def predict(theta, start, carry, where, samples, at, steps):
        assert window is not None
        x = jax.tree.unflatten(jax.tree.structure(begins(theta, start, where, samples)), carry)
        x, y = window(form.model(theta), samples, where, start, at, x, steps, WINDOW, reach, burn)
        return tuple(jax.tree.leaves(x)), y

    def tangent(theta, start, carry, dtheta, dstart, dcarry, where, samples, at, steps):
        def f(theta, start, carry):
            return predict(theta, start, carry, where, samples, at, steps)

        (carry, y), (dcarry, dy) = jax.jvp(f, (theta, start, carry), (dtheta, dstart, dcarry))
        return carry, y, dcarry, dy

    along = 0, 0, 0
    rest = None, None, None
    return WindowPrograms(
        batched_vmap(predict, (*along, 0, *rest)),
        batched_vmap(tangent, (*along, *along, 0, *rest)),
        begins,
    )


class _Block(NamedTuple):
    """Lanes of one call; `carry` holds the states after the last window (and their tangents)."""

    lanes: np.ndarray
    padded: np.ndarray
    carry: list[Any]


class Windows:
    """Lanes in windows of WINDOW steps; iterating gives (position of the first step in each lane's
    record [lanes], predictions [lanes WINDOW ny], with tangents also derivatives). What lies before
    or behind a lane's record is no prediction.
    """

    def __init__(
        self,
        engine: BatchSimulator,
        programs: Programs,
        index: np.ndarray,
        numbers: Sequence[np.ndarray],
        states: Sequence[np.ndarray],
        where: np.ndarray,
        steps: np.ndarray,
    ):
        self._engine, self._programs = engine, programs
        self._numbers, self._states = [a[:, index] for a in numbers], states
        self._where, self._steps = where, steps
        with float64():
            shapes = jax.eval_shape(
                programs.begins, self._numbers[0][0], states[0][0], where[0], engine.samples
            )
        self._carry = tuple(np.zeros((WIDTH, *x.shape), x.dtype) for x in jax.tree.leaves(shapes))
        self._name = "tangent_windows" if len(numbers) > 1 else "output_windows"

    def __iter__(self) -> Iterator[tuple[np.ndarray, tuple[np.ndarray, ...]]]:
        order = np.argsort(-self._steps, kind="stable")
        blocks = []
        for k in range(0, order.size, WIDTH):
            lanes = order[k : k + WIDTH]
            padded = np.concatenate([lanes, np.repeat(lanes[-1:], WIDTH - lanes.size)])
            blocks.append(_Block(lanes, padded, [self._carry for _ in self._numbers]))
        made: list[np.ndarray] = []
        for at in range(0, int(self._steps.max()), WINDOW):
            going = [b for b in blocks if at < self._steps[b.lanes[0]]]
            first = []
            if self._name not in self._programs.ready:  # the first call compiles
                began = time.perf_counter()
                with self._programs.first_call(self._name):
                    first = [self._run(going.pop(0), at)]
                self._engine.compile_time_s += time.perf_counter() - began
            for lanes, out in (*first, *_POOL.map(lambda b, at=at: self._run(b, at), going)):
                made = made or [np.zeros((order.size, *o.shape[1:])) for o in out]
                for whole, part in zip(made, out, strict=True):
                    whole[lanes] = part[: lanes.size]
            yield at - self._where[:, 3], tuple(made)

    def _run(self, block: _Block, at: int) -> tuple[np.ndarray, list[np.ndarray]]:
        own, carry = block.padded, block.carry
        steps = np.int32(min(max(int(self._steps[block.lanes].max()) - at, 0), WINDOW))
        arrays = []
        for numbers, states, c in zip(self._numbers, self._states, carry, strict=True):
            arrays += [numbers[own], states[own], c]
        with float64():  # the setting belongs to the thread
            found = getattr(self._programs, self._name)(
                *arrays, self._where[own], self._engine.samples, np.int32(at), steps
            )
        block.carry[:] = found[::2]
        return block.lanes, [np.asarray(o) for o in found[1::2]]

    def together(self, length: int) -> np.ndarray:
        """Predictions of the whole records [lanes length ny]."""
        whole: np.ndarray | None = None
        for first, (y, *_) in self:
            if whole is None:
                whole = np.zeros((len(y), length, y.shape[2]))
            for row, part, a in zip(whole, y, first, strict=True):
                b = min(a + WINDOW, length)
                row[max(a, 0) : max(b, 0)] = part[max(-a, 0) : max(b - a, 0)]
        assert whole is not None
        return whole
