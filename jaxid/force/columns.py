"""The force that a model lacks at all samples of a motion, and its columns where it is linear in
the model's numbers.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.dynamics.effect import Command
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.force.drive import drive_torque
from jaxid.force.sampled_motion import SampledMotion
from jaxid.numerics.export_cache import ExportedFunction, key_of
from jaxid.numerics.kept import shared
from jaxid.numerics.precision import float64


#: Rows at which the force is looked at, and at which readings are gone through; samples of one
#: call: what is compiled is compiled for these alone.
ROWS, FEW, AT_ONCE = 1200, 150, 750


def force(
    chain: Any,
    q: Float[Array, " nq"],
    qd: Float[Array, " nq"],
    qdd: Float[Array, " nq"],
    u: Float[Array, " nu"],
) -> Float[Array, " nq"]:
    """Missing torque [nq] of one sample."""
    still = chain.start(q, jnp.zeros_like(q), u).z
    command = Command(jnp.zeros(()), jnp.full((), 1e-3), u, u, lambda d: u)
    missing, _ = chain.inverse(command, still, q, qd, qdd)
    return missing


def _program(layout: ParameterVector, free: tuple[int, ...]) -> ExportedFunction:
    """`force` at sets of those numbers of a layout that are `free`, one program for all chains of
    its structure: the others [numbers], the sets [sets free] and a motion [samples nq] give [sets
    samples nq].
    """
    form = layout.form

    def made() -> ExportedFunction:
        key = key_of(force, form.bare, free)
        place = {i: k for k, i in enumerate(free)}

        def sets(theta, own, *motion):
            def at(own, *sample):
                numbers = list(theta)  # one by one: what depends on none is worked out once
                for i, k in place.items():
                    numbers[i] = own[k]
                return force(form.model(numbers), *sample)

            return jax.vmap(lambda own: jax.vmap(lambda *sample: at(own, *sample))(*motion))(own)

        return ExportedFunction(sets, key)

    return shared("forces", (form, free), made)


class Forces:
    """The missing force of a model along motions, at its numbers `theta` of usual size `scale`, of
    which those at `free` may change; at the samples of `motion` it is seen whether it is linear.
    """

    def __init__(
        self,
        layout: ParameterVector,
        theta: Float[np.ndarray, " numbers"],
        scale: Float[np.ndarray, " numbers"],
        free: list[int],
        motion: SampledMotion,
    ):
        self.layout, self.theta, self.scale = layout, theta, scale
        self.free, self.motion = free, motion
        self._known: tuple[Any, ...] = ()

    def at(
        self,
        thetas: Float[np.ndarray, "sets numbers"],
        m: SampledMotion,
        u: Float[np.ndarray, "rows nu"] | None = None,
    ) -> Float[np.ndarray, "sets rows nq"]:
        """Missing force [sets rows nq] at sets of numbers, of which those that are free may differ
        from the binding's; `u` in place of the motion's inputs. One set, or as many as give the
        slopes, are one call for `AT_ONCE` samples.
        """
        run = _program(self.layout, tuple(self.free))
        own = _padded(thetas[:, self.free], 1 if len(thetas) == 1 else 1 + len(self.free))
        motion = m.q, m.qd, m.qdd, m.u if u is None else u
        found = []
        with float64():
            for a in range(0, len(m.q), AT_ONCE):
                part = [_padded(x[a : a + AT_ONCE], AT_ONCE) for x in motion]
                found.append(run(self.theta, own, *part))
        found = np.concatenate([np.asarray(f) for f in found], 1)[: len(thetas), : len(m.q)]
        return np.nan_to_num(found, nan=1e12, posinf=1e12, neginf=-1e12)

    def missing(
        self, theta: Float[np.ndarray, " numbers"], m: SampledMotion
    ) -> Float[np.ndarray, "rows nq"]:
        """Missing force [rows nq] at these numbers, of which those that are free may differ from
        the model's.
        """
        if not self.linear:
            return self.at(theta[None], m)[0]
        base, slopes = self.columns(m)
        found = base + slopes @ (theta - self.theta)[self.free]
        return found + self._driven(m) if self.additive else found

    def _driven(self, m: SampledMotion) -> np.ndarray:
        """Joint torque [rows nq] of the inputs, whose gains no fit of these moves."""
        return drive_torque(self.layout, self.theta, m.u, np.concatenate([m.q, m.qd], 1))

    def columns(
        self, m: SampledMotion
    ) -> tuple[Float[np.ndarray, "rows nq"], Float[np.ndarray, "rows nq free"]]:
        """Of a linear model: the force [rows nq] at the model's numbers, without the drive where
        that is but added, and its columns [rows nq free]. They are kept: a reading of the inputs
        alone leaves them as they are.
        """
        key = (m.q, m.qd, m.qdd) if self.additive else (m.q, m.qd, m.qdd, m.u)
        known = self._known  # several threads ask
        if not known or any(a is not b for a, b in zip(known[0], key, strict=True)):
            here, slopes = self._with_slopes(m, 0 * m.u if self.additive else m.u)
            known = self._known = key, (here - slopes @ self._steps[0, self.free], slopes)
        return known[1]

    @cached_property
    def linear(self) -> bool:
        """Whether the force is linear in the free numbers, as an arm's is, seen at three sets of
        them.
        """
        m = self.motion
        here, slopes = self._with_slopes(m, m.u)
        others = self.at(np.stack([self._inside[1], self.theta]), m)
        moves = self._steps[1] - self._steps[0], -self._steps[0]
        size = 1e-9 * (max(float(np.abs(f).max()) for f in (here, *others)) + 1e-300)
        return all(
            np.allclose(here + slopes @ s[self.free], f, rtol=0, atol=size)
            for s, f in zip(moves, others, strict=True)
        )

    @cached_property
    def additive(self) -> bool:
        """Whether the inputs are the joints' drive and nothing else depends on them."""
        m = self.motion
        if not self.layout.chain.direct or m.u.shape != m.q.shape:
            return False
        (driven, by), (still, without) = (self._with_slopes(m, u) for u in (m.u, 0 * m.u))
        size = 1e-9 * (float(np.abs(driven).max()) + 1e-300)
        return np.allclose(driven - still, self._driven(m), rtol=0, atol=size) and np.allclose(
            by, without, rtol=1e-9, atol=size
        )

    @cached_property
    def _steps(self) -> np.ndarray:
        """Two steps into the inside of the box [2 numbers]: at its edges a law's slope may have two
        values.
        """
        steps = np.zeros((2, len(self.theta)))
        by = np.random.default_rng(0).uniform(0.1, 1.0, (2, len(self.free)))
        steps[:, self.free] = by * np.maximum(self.scale[self.free], 1e-9)
        return steps

    @property
    def _inside(self) -> np.ndarray:
        return self.theta + self._steps

    def _with_slopes(self, m: SampledMotion, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The force [rows nq] at numbers inside the box, and how it changes by a step of each [rows
        nq free]: of a linear model its slopes.
        """
        h = self._steps[0, self.free]
        thetas = np.repeat(self._inside[:1], 1 + len(h), 0)
        thetas[1 + np.arange(len(h)), self.free] += h
        found = self.at(thetas, m, u)
        return found[0], np.moveaxis((found[1:] - found[0]) / h[:, None, None], 0, -1)


def _padded(x: np.ndarray, room: int) -> np.ndarray:
    """A series [rows ...] with its last sample repeated up to `room`."""
    return np.concatenate([x, np.repeat(x[-1:], room - len(x), 0)]) if len(x) < room else x
