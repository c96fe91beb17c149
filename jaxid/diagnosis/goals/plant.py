"""A robot under its drive law as columns: the force that its model lacks along a measured motion,
and derivatives of that.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.diagnosis.goals.loop import Loop, loop_of
from jaxid.diagnosis.torque.plant import AnyPlant
from jaxid.diagnosis.torque.rows import TorqueRun
from jaxid.dynamics.effect import Command, InputEffect, JointEffect, neutral, Signals
from jaxid.dynamics.parameter_vector import ChainForm, ParameterVector
from jaxid.numerics.kept import shared
from jaxid.numerics.precision import float64


#: Differences by which derivatives are taken: of positions (rad, m), as a share of the top speed,
#: of numbers in their scale.
MOVED, FASTER, CHANGED = 1e-5, 1e-4, 1e-4


class LedPlant(AnyPlant):
    """The missing force of a model that goals drive. Along the measured motion dry friction turns
    about within `eps`; a joint that stands still is held by any force up to its dry friction, and
    nothing is missing there.
    """

    def balance(
        self, run: TorqueRun, theta: np.ndarray, q: Any = 0.0, qd: Any = 0.0, qdd: Any = 0.0
    ) -> tuple[np.ndarray, ...]:
        """Force [time n] that the motion of a run, moved by so much, leaves to dry friction, and
        its levels (minus, plus).
        """
        series = [run.padded(x) for x in (run.u, run.q + q, run.qd + qd, run.qdd + qdd)]
        with float64():
            found = shared("balance", self.form, lambda: _balance(self.form))(
                theta, run.step, *series
            )
        return tuple(np.asarray(x)[: len(run.q)] for x in found)

    def friction(self, run: TorqueRun, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the motion leaves to dry friction and what friction takes of it, [time n]."""
        return self.taken(run, *self.balance(run, theta))

    def taken(
        self, run: TorqueRun, left: np.ndarray, minus: np.ndarray, plus: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What is `left` to dry friction of these levels and what friction takes of it, [time
        n].
        """
        way = np.tanh(run.qd / self.eps)
        room = 1 - np.abs(way)
        turned = np.where(way > 0, plus, minus) * way
        return left, np.clip(left, turned - room * minus, turned + room * plus)

    def missing(self, run: TorqueRun, theta: np.ndarray) -> np.ndarray:
        """Force [time n] that the model lacks along the motion of a run."""
        left, taken = self.friction(run, theta)
        return left - taken

    def linearised(self, run, theta):
        at, out = self.missing(run, theta), self.columns(run, theta)
        return at + out @ theta[self.free], out

    def columns(self, run: TorqueRun, theta: np.ndarray) -> np.ndarray:
        """Minus the derivatives of the missing force by the numbers that are fitted, [time n
        size].
        """
        out, at = np.zeros((*run.q.shape, self.size)), self.missing(run, theta)
        for group in self._alone():
            own = [self.free[k] for k in group]
            apart = CHANGED * self.binding.scale[own]
            apart = np.where(theta[own] + apart <= self.binding.upper[own], apart, -apart)
            moved = theta.copy()
            moved[own] += apart
            slope = at - self.missing(run, moved)
            for k, i, width in zip(group, own, apart, strict=True):
                place = slice(None) if len(group) == 1 else self.binding.layout.entries[i].place
                out[:, place, k] = slope[:, place] / width
        return out

    def _alone(self) -> list[list[int]]:
        """Positions among the free numbers, those together that each act at their own joint
        alone.
        """
        b, groups = self.binding, {}
        for k, i in enumerate(self.free):
            e = b.layout.entries[i]
            effect = b.chain.effects[e.owner] if e.owner >= 0 else None
            own = isinstance(effect, JointEffect | InputEffect) and not effect.couples
            own |= e.owner < 0 and e.field in b.chain.mechanism.of_one_joint
            groups.setdefault((e.owner, e.field) if own else k, []).append(k)
        return list(groups.values())

    def slopes(
        self, run: TorqueRun, theta: np.ndarray, left: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Minus the derivatives of what is `left` to dry friction by accelerations, speeds and
        positions, each [time n n].
        """
        n = run.q.shape[1]
        top = np.maximum(np.percentile(np.abs(run.qd), 99, axis=0), 1e-6)
        made: list[np.ndarray] = []
        for field, size in (
            ("qdd", np.ones(n)),
            ("qd", np.minimum(FASTER * top, self.turn / 4)),
            ("q", np.full(n, MOVED)),
        ):
            moved = (self.balance(run, theta, **{field: step})[0] for step in np.diag(size))
            made.append(
                np.stack([(left - ahead) / h for ahead, h in zip(moved, size, strict=True)], 2)
            )
        return made[0], made[1], made[2]

    def loop(self, run: TorqueRun, theta: np.ndarray) -> tuple[Loop, np.ndarray]:
        """The free run to first order about the measured motion, a joint that friction holds being
        moved by no force; and the force [time n] that the model lacks there.
        """
        left, minus, plus = self.balance(run, theta)
        left, taken = self.taken(run, left, minus, plus)
        inertia, damping, stiffness = self.slopes(run, theta, left)
        level = self._dry(theta)
        slow = 1 / np.cosh(np.clip(run.qd / self.eps, -300, 300)) ** 2
        moves = np.where(left == taken, np.abs(np.tanh(run.qd / self.eps)), 1.0)
        matrices = (inertia, damping, level / self.eps * slow, stiffness, moves)
        return loop_of(run.step, *map(run.padded, matrices)), left - taken

    def _dry(self, theta: np.ndarray) -> np.ndarray:
        """Level of the model's own dry friction [n]."""
        chain = self.binding.layout.model(theta)
        own = [np.asarray(e.level) for e in chain.effects if e.quantity() == "frictionloss"]  # pyright: ignore
        return sum(own, np.zeros(chain.nq))


def _command(h: Any, u: Any, other: Any, k: Any) -> Command:
    """What arrives at sample k of inputs u [time nu], which lie on straight lines between the
    samples.
    """

    def delayed(delay: Any) -> Any:
        at = jnp.clip(k - delay / h, 0.0, u.shape[0] - 1.0)
        low = jnp.minimum(jnp.floor(at).astype(int), u.shape[0] - 2)
        channel = jnp.arange(u.shape[1])
        share = at - low
        return (1 - share) * u[low, channel] + share * u[low + 1, channel]

    return Command(k * h, h, u[k], other[k], delayed)


def _balance(form: ChainForm) -> Any:
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
    """The law with effects on its way, without the mechanism: the joint torque along a measured
    motion.
    """

    def __init__(self, plant: LedPlant, kinds: Sequence[Any]):
        chain = plant.binding.chain
        law = [e for e in chain.effects if isinstance(e, InputEffect)]
        lacking = [neutral(k) for k in kinds if k.name not in chain.contents]
        self.plant, self.names = plant, plant.binding.layout.names
        self.chain = chain._with([*law, *lacking])
        self.layout = ParameterVector(self.chain)

    def theta(self, theta: np.ndarray) -> np.ndarray:
        """Numbers of the whole model as those of the drive."""
        own = dict(zip(self.names, theta, strict=True))
        return np.array(
            [own.get(n, v) for n, v in zip(self.layout.names, self.layout.values, strict=True)]
        )

    def torque(self, run: TorqueRun, other: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """[time n]; `other` [time nu] the inputs under the other hold."""
        series = [run.padded(x) for x in (run.u, other, run.q, run.qd)]
        with float64():
            program = shared("torque", self.layout.form, lambda: _torque(self.layout.form))
            return np.asarray(program(theta, run.step, *series))[: len(run.q)]


def _torque(form: ChainForm) -> Any:
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
