"""The force that a model lacks at all samples of a motion, and its columns where it is linear in the model's numbers."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.dynamics.effect import Command
from jaxid.dynamics.parameter_vector import Layout
from jaxid.numerics.export_cache import key_of, Traced
from jaxid.numerics.kept import shared
from jaxid.numerics.precision import float64
from jaxid.problem.binding import Binding


#: Samples at which the force is looked at, and at which readings are gone through: what is compiled is compiled for these alone.
ROWS, FEW = 1200, 150


def force(chain: Any, q: Any, qd: Any, qdd: Any, u: Any) -> Any:
    """Missing torque [nq] of one sample."""
    still = chain.start(q, jnp.zeros_like(q), u).z
    command = Command(jnp.zeros(()), jnp.full((), 1e-3), u, u, lambda d: u)
    missing, _ = chain.inverse(command, still, q, qd, qdd)
    return missing


def _program(layout: Layout, free: tuple[int, ...] | None) -> Traced:
    """`force` by all numbers of a layout, one program for all chains of its structure: at sets of numbers [sets rows nq], or at
    one with its slopes by those that are `free` [rows nq], [rows nq free]."""
    form = layout.form

    def made() -> Traced:
        key = key_of(force, form.bare, *([] if free is None else [free]))
        at = lambda theta, *sample: force(form.model(theta), *sample)

        def sets(theta, *motion):
            return jax.vmap(lambda own: jax.vmap(lambda *s: at(own, *s))(*motion))(theta)

        def with_slopes(theta, *motion):  # backwards: a sample has fewer forces than the model has numbers
            theta, index = jnp.asarray(theta), jnp.array(free, int)
            by = lambda own, *s: (found := at(theta.at[index].set(own), *s), found)
            slopes, here = jax.vmap(lambda *s: jax.jacrev(by, has_aux=True)(theta[index], *s))(*motion)
            return here, slopes

        return Traced(sets if free is None else with_slopes, key)

    return shared("forces", (form, free), made)


class Forces:
    """The missing force of a bound model along motions (anything with q, qd, qdd [rows nq] and u [rows nu]); at the samples of
    `motion` it is seen whether it is linear."""

    def __init__(self, binding: Binding, free: list[int], motion: Any):
        self.binding, self.free, self.motion = binding, free, motion
        self._known: tuple[Any, ...] = ()

    def at(self, thetas: np.ndarray, m: Any) -> np.ndarray:
        """Missing force [sets rows nq] at sets of numbers."""
        run, series = _program(self.binding.layout, None), (m.q, m.qd, m.qdd, m.u)
        with float64():
            parts = [run(thetas, *(_padded(x[a : a + ROWS], ROWS) for x in series)) for a in range(0, max(len(m.q), 1), ROWS)]
        return _finite(np.concatenate(parts, 1))[:, : len(m.q)]

    def missing(self, theta: np.ndarray, m: Any) -> np.ndarray:
        """Missing force [rows nq] at these numbers, of which those that are free may differ from the binding's."""
        if not self.linear:
            return self.at(theta[None], m)[0]
        base, slopes = self.columns(m)
        found = base + slopes @ (theta - self.binding.theta)[self.free]
        return found + m.u if self.additive else found

    def columns(self, m: Any) -> tuple[np.ndarray, np.ndarray]:
        """Of a linear model: the force [rows nq] at the binding's numbers, without the drive where that is but added, and its
        columns [rows nq free]. They are kept: a reading of the inputs alone leaves them as they are."""
        key = (m.q, m.qd, m.qdd) if self.additive else (m.q, m.qd, m.qdd, m.u)
        if not self._known or any(a is not b for a, b in zip(self._known[0], key, strict=True)):
            here, slopes = self._with_slopes(self._inside[0], m, 0 * m.u if self.additive else m.u)
            self._known = key, (here - slopes @ self._steps[0, self.free], slopes)
        return self._known[1]

    @cached_property
    def linear(self) -> bool:
        """Whether the force is linear in the free numbers, as an arm's is, seen at three sets of them."""
        m, b = self.motion, self.binding
        here, slopes = self._with_slopes(self._inside[0], m, m.u)
        others = self._with_slopes(self._inside[1], m, m.u)[0], self._with_slopes(b.theta, m, m.u)[0]
        moves = self._steps[1] - self._steps[0], -self._steps[0]
        size = 1e-9 * (max(float(np.abs(f).max()) for f in (here, *others)) + 1e-300)
        return all(np.allclose(here + slopes @ s[self.free], f, rtol=0, atol=size) for s, f in zip(moves, others, strict=True))

    @cached_property
    def additive(self) -> bool:
        """Whether the inputs are the joints' drive and nothing else depends on them."""
        m = self.motion
        if not self.binding.chain.direct or m.u.shape != m.q.shape:
            return False
        (driven, by), (still, without) = (self._with_slopes(self._inside[0], m, u) for u in (m.u, 0 * m.u))
        size = 1e-9 * (float(np.abs(driven).max()) + 1e-300)
        return np.allclose(driven - still, m.u, rtol=0, atol=size) and np.allclose(by, without, rtol=1e-9, atol=size)

    @cached_property
    def _steps(self) -> np.ndarray:
        """Two steps into the inside of the box [2 numbers]: at its edges a law's slope may have two values."""
        b = self.binding
        steps = np.zeros((2, len(b.theta)))
        by = np.random.default_rng(0).uniform(0.1, 1.0, (2, len(self.free)))
        steps[:, self.free] = by * np.maximum(b.scale[self.free], 1e-9)
        return steps

    @property
    def _inside(self) -> np.ndarray:
        return self.binding.theta + self._steps

    def _with_slopes(self, theta: np.ndarray, m: Any, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The force [rows nq] and its slopes [rows nq free], `FEW` samples at a time: one program, however many there are."""
        parts = range(0, len(m.q), FEW)
        run = _program(self.binding.layout, tuple(self.free))
        with float64():
            found = [run(theta, *(_padded(x[a : a + FEW], FEW) for x in (m.q, m.qd, m.qdd, u))) for a in parts]
        here = np.concatenate([np.asarray(f) for f, _ in found])[: len(m.q)]
        slopes = np.concatenate([np.asarray(J) for _, J in found])[: len(m.q)]
        return _finite(here), _finite(slopes)


def _padded(x: np.ndarray, room: int) -> np.ndarray:
    """A series [rows ...] with its last sample repeated up to `room`."""
    return np.concatenate([x, np.repeat(x[-1:], room - len(x), 0)]) if len(x) < room else x


def _finite(x: Any) -> np.ndarray:
    return np.nan_to_num(np.asarray(x), nan=1e12, posinf=1e12, neginf=-1e12)
