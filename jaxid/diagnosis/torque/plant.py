"""The nominal model as columns: its torque along a measured motion is its numbers times these."""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.diagnosis.torque.rows import TorqueRun
from jaxid.dynamics.base_parameters import STANDARD, standard_torque, torque_columns
from jaxid.dynamics.effect import JointEffect
from jaxid.dynamics.parameter import specs
from jaxid.dynamics.parameter_vector import ChainForm
from jaxid.force.drive import drive_torque
from jaxid.force.effects import force, Load, unloaded, with_numbers
from jaxid.numerics.kept import shared
from jaxid.numerics.precision import float64
from jaxid.problem.binding import Binding


class Beside(NamedTuple):
    """What is known to stand between the drive and the links of a run beside the model's rotors:
    friction [time n], and inertia [n] that the model has in its links.
    """

    friction: np.ndarray
    rotor: np.ndarray


class Plant(abc.ABC):
    """Abstract: the numbers of a model that a fit determines, and the torque equation linear in
    them.
    """

    def __init__(self, binding: Binding, turn: np.ndarray):
        self.binding, self.turn = binding, turn
        self.free = list(binding.free)

    @property
    def size(self) -> int:
        return len(self.free)

    def drive(self, run: TorqueRun, theta: np.ndarray) -> np.ndarray:
        """Joint torque that the drive makes of the recorded inputs, [time n]."""
        return drive_torque(self.binding.layout, theta, run.u, np.concatenate([run.q, run.qd], 1))

    @abc.abstractmethod
    def linearised(self, run: TorqueRun, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Target [time n] and columns [time n size] at the numbers theta (of the whole layout):
        columns times the free numbers meet the target where nothing is missing.
        """

    @abc.abstractmethod
    def rigid(self, run: TorqueRun, theta: np.ndarray) -> np.ndarray:
        """Torque [time n] that the mechanism takes without friction."""

    def load(self, run: TorqueRun, theta: np.ndarray, beside: Beside | None = None) -> Load:
        """What passes the gears: the measured torque would explain itself."""
        friction, rotor = beside or Beside(np.zeros(1), np.zeros(1))
        rigid = self.rigid(run, theta)
        with float64():
            rotors = np.asarray(self.binding.layout.model(theta).body().rotors())
        return Load(rigid + friction, rigid - (rotors + rotor) * run.qdd)

    def exact(self) -> bool:
        """Whether the torque is linear in the free numbers, so that one linearisation is enough."""
        return False


class ArmPlant(Plant):
    """A serial arm in NumPy: standard parameters from the regressor, friction by its own laws."""

    def __init__(self, binding: Binding, turn: np.ndarray):
        super().__init__(binding, turn)
        self.arm: Any = binding.chain.mechanism
        entries = [binding.layout.entries[i] for i in self.free]
        self.inertial = [k for k, e in enumerate(entries) if e.owner < 0]
        self.standard = [
            entries[k].place * len(STANDARD) + STANDARD.index(entries[k].field)
            for k in self.inertial
        ]
        self.laws = [k for k, e in enumerate(entries) if e.owner >= 0]

    def exact(self) -> bool:
        return True

    def phi(self, theta: np.ndarray) -> np.ndarray:
        """All standard parameters [11 n], a known payload in the last link's."""
        arm: Any = self.binding.layout.model(theta).mechanism
        with float64():
            return np.concatenate(
                [np.asarray(arm.inertia()), np.asarray(arm.Ia)[:, None]], 1
            ).ravel()

    def columns(self, run: TorqueRun) -> np.ndarray:
        """Standard columns [time n 11 n]."""
        return torque_columns(self.arm, run.q, run.qd, run.qdd)

    def linearised(self, run, theta):
        phi = self.phi(theta)
        every = self.columns(run)
        held = phi.copy()
        held[self.standard] -= theta[[self.free[k] for k in self.inertial]]
        target = self.drive(run, theta) - every @ held - self._held_friction(run, theta)
        out = np.zeros((*target.shape, self.size))
        out[:, :, self.inertial] = every[:, :, self.standard]
        for k in self.laws:
            e = self.binding.layout.entries[self.free[k]]
            out[:, e.place, k] = self._law(run, theta, e)[:, e.place]
        return target, out

    def rigid(self, run, theta):
        return standard_torque(self.arm, self.phi(theta), run.q, run.qd, run.qdd)

    def _effects(self, theta: np.ndarray):
        chain = self.binding.layout.model(theta)
        return [(i, e) for i, e in enumerate(chain.effects) if isinstance(e, JointEffect)]

    def _held_friction(self, run: TorqueRun, theta: np.ndarray) -> np.ndarray:
        """Friction of numbers that are not fitted."""
        entries = self.binding.layout.entries
        at = theta.copy()
        for k in self.laws:
            if entries[self.free[k]].spec.value == 0:
                at[self.free[k]] = 0.0
        total = np.zeros_like(run.q)
        for _, e in self._effects(at):
            strengths = [getattr(e, f) for f, spec in specs(e).items() if spec.value == 0]
            if any(map(np.any, strengths)):
                total += force(e, run, unloaded(run), self.turn)
        return total

    def _law(self, run: TorqueRun, theta: np.ndarray, entry: Any) -> np.ndarray:
        """Friction of one number of an effect, 1, with the others of its shape as in theta."""
        effect: Any = self.binding.chain.effects[entry.owner]
        own: dict[str, list[float]] = {}
        for e, value in zip(self.binding.layout.entries, theta, strict=True):
            if e.owner == entry.owner and e.spec.value != 0:
                own.setdefault(e.field, []).append(value)
        shape = {field: np.array(values) for field, values in own.items()}
        law = with_numbers(effect, {**shape, entry.field: 1.0}, run.q.shape[1])
        return force(law, run, unloaded(run), self.turn)


class AnyPlant(Plant):
    """Any other model: derivatives of its own equations by the numbers."""

    def __init__(self, binding: Binding, turn: np.ndarray):
        super().__init__(binding, turn)
        stated = binding.chain.smoothing_velocity
        self.form, self.eps = binding.layout.form, np.full(len(turn), stated) if stated else turn

    def linearised(self, run, theta):
        missing, slope = self._missing(run, theta)
        target = missing - np.einsum("tnp,p->tn", slope, theta[self.free])
        return target, -slope

    def rigid(self, run, theta):
        with float64():
            return inverse_of(self.form.model(theta).body(), run)

    def _missing(self, run: TorqueRun, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n, series = len(run.q), [run.padded(x) for x in (run.u, run.q, run.qd, run.qdd)]
        with float64():
            program = shared(
                "slopes", (self.form, *self.free), lambda: _slopes(self.form, tuple(self.free))
            )
            missing, slope = program(theta, self.eps, run.step, *series)
        return np.asarray(missing)[:n], np.asarray(slope)[:n]


def inverse_of(body: Any, run: TorqueRun) -> np.ndarray:
    """Torque [time n] that a mechanism takes along a run."""
    with float64():
        program = shared("inverse", jax.tree.structure(body), lambda: jax.jit(_inverse))
        return np.asarray(program(body, *(run.padded(x) for x in (run.q, run.qd, run.qdd))))[
            : len(run.q)
        ]


def _inverse(body: Any, q: Any, qd: Any, qdd: Any) -> Any:
    return jax.vmap(body.inverse)(q, qd, qdd)


def _slopes(form: ChainForm, free: tuple[int, ...]) -> Any:
    """(missing torque [time n], its slope by the free numbers [time n free])."""
    from jaxid.dynamics.effect import Command

    def missing(
        numbers: Any, theta: Any, eps: Any, h: Any, u: Any, q: Any, qd: Any, qdd: Any
    ) -> Any:
        chain = form.model(theta.at[jnp.array(free, int)].set(numbers) if free else theta)

        def step(z: Any, now: Any) -> Any:
            u, q, qd, qdd = now
            command = Command(jnp.zeros(()), h, u, u, lambda d: u)
            left, minus, plus, z = chain.balance(command, z, q, qd, qdd)
            way = jnp.tanh(qd / eps)
            return z, left - jnp.where(way > 0, plus, minus) * way

        z = chain.start(q[0], qd[0], u[0]).z
        if jax.tree.leaves(z):
            return jax.lax.scan(step, z, (u, q, qd, qdd))[1]
        return jax.vmap(lambda *now: step(z, now)[1])(u, q, qd, qdd)

    def both(theta: Any, eps: Any, h: Any, *series: Any) -> Any:
        theta = jnp.asarray(theta)
        own = theta[jnp.array(free, int)] if free else jnp.zeros(0)
        out = missing(own, theta, eps, h, *series)
        slope = (
            jax.jacfwd(missing)(own, theta, eps, h, *series) if free else jnp.zeros((*out.shape, 0))
        )
        return out, slope

    return jax.jit(both)


def plant_of(binding: Binding, turn: np.ndarray) -> Plant:
    """The columns of a binding's model."""
    arm: Any = binding.chain.mechanism
    kind = ArmPlant if hasattr(arm, "base") and hasattr(arm, "Ixx") else AnyPlant
    return kind(binding, turn)
