"""A robot under its drive law as columns: the force that its model lacks along a measured motion, and derivatives of that."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.diagnosis.goals.loop import Loop, loop_of
from jaxid.diagnosis.torque.plant import AnyPlant
from jaxid.diagnosis.torque.rows import Run
from jaxid.dynamics.effect import Command, InputEffect, JointEffect, neutral, Signals
from jaxid.dynamics.parameter_vector import Form, Layout
from jaxid.numerics.kept import shared
from jaxid.numerics.precision import float64


#: Differences by which derivatives are taken: of positions (rad, m), as a share of the top speed, of numbers in their scale.
MOVED, FASTER, CHANGED = 1e-5, 1e-4, 1e-4


class LedPlant(AnyPlant):
    """The missing force of a model that goals drive. Along the measured motion dry friction turns about within `eps`; a joint
    that stands still is held by any force up to its dry friction, and nothing is missing there."""

    def balance(self, run: Run, theta: np.ndarray, q: Any = 0.0, qd: Any = 0.0, qdd: Any = 0.0) -> tuple[np.ndarray, ...]:
        """Force [time n] that the motion of a run, moved by so much, leaves to dry friction, and its levels (minus, plus)."""
        series = [run.padded(x) for x in (run.u, run.q + q, run.qd + qd, run.qdd + qdd)]
        with float64():
            found = shared("balance", self.form, lambda: _balance(self.form))(theta, run.step, *series)
        return tuple(np.asarray(x)[: len(run.q)] for x in found)

    def friction(self, run: Run, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the motion leaves to dry friction and what friction takes of it, [time n]."""
        left, minus, plus = self.balance(run, theta)
        way = np.tanh(run.qd / self.eps)
        room = 1 - np.abs(way)
        turned = np.where(way > 0, plus, minus) * way
        return left, np.clip(left, turned - room * minus, turned + room * plus)

    def missing(self, run: Run, theta: np.ndarray) -> np.ndarray:
        """Force [time n] that the model lacks along the motion of a run."""
        left, taken = self.friction(run, theta)
        return left - taken

    def linearised(self, run, theta):
        at, out = self.missing(run, theta), self.columns(run, theta)
        return at + out @ theta[self.free], out

    def columns(self, run: Run, theta: np.ndarray) -> np.ndarray:
        """Minus the derivatives of the missing force by the numbers that are fitted, [time n size]."""
        out = np.zeros((*run.q.shape, self.size))
        for group in self._alone():
            at = [self.free[k] for k in group]
            apart = CHANGED * self.binding.scale[at]
            low, high = (
                np.maximum(theta[at] - apart, self.binding.lower[at]),
                np.minimum(theta[at] + apart, self.binding.upper[at]),
            )
            ends = []
            for value in (low, high):
                moved = theta.copy()
                moved[at] = value
                ends.append(self.missing(run, moved))
            slope = ends[0] - ends[1]
            for k, width in zip(group, high - low, strict=True):
                place = slice(None) if len(group) == 1 else self.binding.layout.entries[self.free[k]].place
                out[:, place, k] = slope[:, place] / width
        return out

    def _alone(self) -> list[list[int]]:
        """Positions among the free numbers, those together that each act at their own joint alone."""
        b, groups = self.binding, {}
        for k, i in enumerate(self.free):
            e = b.layout.entries[i]
            effect = b.chain.effects[e.owner] if e.owner >= 0 else None
            own = isinstance(effect, JointEffect | InputEffect) and not effect.couples
            groups.setdefault((e.owner, e.field) if own else k, []).append(k)
        return list(groups.values())

    def slopes(self, run: Run, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Minus the derivatives of what is left to dry friction by accelerations, speeds and positions, each [time n n]."""
        n = run.q.shape[1]
        top = np.maximum(np.percentile(np.abs(run.qd), 99, axis=0), 1e-6)
        made: list[np.ndarray] = []
        for field, size in (("qdd", np.ones(n)), ("qd", np.minimum(FASTER * top, self.turn / 4)), ("q", np.full(n, MOVED))):
            columns = []
            for j in range(n):
                step = size[j] * np.eye(n)[j]
                low, high = (self.balance(run, theta, **{field: s * step})[0] for s in (-1.0, 1.0))
                columns.append((low - high) / (2 * size[j]))
            made.append(np.stack(columns, 2))
        return made[0], made[1], made[2]

    def loop(self, run: Run, theta: np.ndarray) -> Loop:
        """The free run to first order about the measured motion; a joint that friction holds is moved by no force."""
        inertia, damping, stiffness = self.slopes(run, theta)
        level = self._dry(theta)
        slow = 1 / np.cosh(np.clip(run.qd / self.eps, -300, 300)) ** 2
        left, taken = self.friction(run, theta)
        moves = np.where(left == taken, np.abs(np.tanh(run.qd / self.eps)), 1.0)
        return loop_of(run.step, *(run.padded(x) for x in (inertia, damping, level / self.eps * slow, stiffness, moves)))

    def _dry(self, theta: np.ndarray) -> np.ndarray:
        """Level of the model's own dry friction [n]."""
        chain = self.binding.layout.model(theta)
        own = [np.asarray(e.level) for e in chain.effects if e.name == "coulomb_friction"]  # pyright: ignore
        return sum(own, np.zeros(chain.nq))


def _command(h: Any, u: Any, other: Any, k: Any) -> Command:
    """What arrives at sample k of inputs u [time nu], which lie on straight lines between the samples."""

    def delayed(delay: Any) -> Any:
        at = jnp.clip(k - delay / h, 0.0, u.shape[0] - 1.0)
        low = jnp.minimum(jnp.floor(at).astype(int), u.shape[0] - 2)
        channel = jnp.arange(u.shape[1])
        share = at - low
        return (1 - share) * u[low, channel] + share * u[low + 1, channel]

    return Command(k * h, h, u[k], other[k], delayed)


def _balance(form: Form) -> Any:
    def balance(theta: Any, h: Any, u: Any, q: Any, qd: Any, qdd: Any) -> Any:
        chain = form.model(theta)

        def step(z: Any, now: Any) -> Any:
            k, q, qd, qdd = now
            left, minus, plus, z = chain.balance(_command(h, u, u, k), z, q, qd, qdd)
            return z, (left, minus, plus)

        z, every = chain.start(q[0], qd[0], u[0]).z, (jnp.arange(u.shape[0]), q, qd, qdd)
        if jax.tree.leaves(z):
            return jax.lax.scan(step, z, every)[1]
        return jax.vmap(lambda *now: step(z, now)[1])(*every)

    return jax.jit(balance)


class Drive:
    """The law with effects on its way, without the mechanism: the joint torque along a measured motion."""

    def __init__(self, plant: LedPlant, kinds: Sequence[Any]):
        chain = plant.binding.chain
        law = [e for e in chain.effects if isinstance(e, InputEffect)]
        self.plant, self.names = plant, plant.binding.layout.names
        self.chain = chain._with([*law, *(neutral(k) for k in kinds)])
        self.layout = Layout(self.chain)

    def theta(self, theta: np.ndarray) -> np.ndarray:
        """Numbers of the whole model as those of the drive."""
        own = dict(zip(self.names, theta, strict=True))
        return np.array([own.get(n, v) for n, v in zip(self.layout.names, self.layout.values, strict=True)])

    def torque(self, run: Run, other: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """[time n]; `other` [time nu] the inputs under the other hold."""
        series = [run.padded(x) for x in (run.u, other, run.q, run.qd)]
        with float64():
            program = shared("torque", self.layout.form, lambda: _torque(self.layout.form))
            return np.asarray(program(theta, run.step, *series))[: len(run.q)]


def _torque(form: Form) -> Any:
    def torque(theta: Any, h: Any, u: Any, other: Any, q: Any, qd: Any) -> Any:
        chain = form.model(theta)
        body = chain.body()

        def step(z: Any, now: Any) -> Any:
            k, q, qd = now
            command = _command(h, u, other, k)
            s = Signals(command.t, q, qd, jnp.zeros_like(q), h, command, qd)
            asked, z = chain.commanded(s, z)
            return z, body.drive(chain.signature, asked, q, qd)

        z = chain.start(q[0], qd[0], u[0]).z
        return jax.lax.scan(step, z, (jnp.arange(u.shape[0]), q, qd))[1]

    return jax.jit(torque)
