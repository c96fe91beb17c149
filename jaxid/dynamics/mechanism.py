"""Mechanisms: what moves between the drive and the sensor.

Every mechanism is a pure JAX ODE, `vector_field(t, x, tau)`; that is its definition and the
reference of every test. And it brings its best step as two answers at the joint port: how fast it
would move under this torque (`free`), and the state once the final joint velocity is known
(`close`). A rigid mechanism gets both from its equation of motion; friction, sticking and
compliance are then solved in one place for all of them.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxid.dynamics.parameter import ParameterSpec
from jaxid.numerics.fast_math import dot, inverse


if TYPE_CHECKING:
    from jaxid.data.dataset import ParameterPrior
    from jaxid.dynamics.ode import ODE


class Signature(NamedTuple):
    """The channels a model takes and gives: (name, unit) pairs, the names of its joints, and
    whether they translate (`linear` all of them, `prismatic` one by one, or a joint's own output is
    in m).

    `speeds`: the joints whose speeds are the last outputs. Those before are what the mechanism's
    `output` gives: its `shown` places, or the first ones (None). `beside`: how many of the last
    inputs are no commands of joints, but what is known of the motion beside them; the first `rates`
    of these are the commands' own rates, which arrive with them.
    """

    inputs: tuple[tuple[str, str], ...]
    outputs: tuple[tuple[str, str], ...]
    joints: tuple[str, ...]
    linear: bool = False
    prismatic: tuple[bool, ...] = ()
    shown: tuple[int, ...] | None = None
    speeds: tuple[int, ...] = ()
    beside: int = 0
    rates: int = 0

    @property
    def input_names(self) -> list[str]:
        return [name for name, _ in self.inputs]

    @property
    def output_names(self) -> list[str]:
        return [name for name, _ in self.outputs]

    @property
    def commands(self) -> tuple[tuple[str, str], ...]:
        """The inputs that command joints."""
        return self.inputs[: len(self.inputs) - self.beside]

    def unit(self, template: str, joint: int = 0) -> str:
        """A parameter's unit with {F} force, {X} coordinate and {I} inertia of that joint filled
        in.
        """
        linear = (
            self.linear
            or (joint < len(self.prismatic) and self.prismatic[joint])
            or self._reads_length(joint)
        )
        force, coordinate, inertia = ("N", "m", "kg") if linear else ("N m", "rad", "kg m^2")
        return template.replace("{F}", force).replace("{X}", coordinate).replace("{I}", inertia)

    def read(self, body: Mechanism, x: Any, tau: Array, rests: Array) -> Array:
        """What ideal sensors of these outputs read in state x, [ny]: see `Mechanism.output`."""
        y = body.output(x, tau, rests)
        y = (
            y[: len(self.outputs) - len(self.speeds)]
            if self.shown is None
            else y[np.array(self.shown, int)]
        )
        return jnp.concatenate([y, body.port(x)[1][np.array(self.speeds)]]) if self.speeds else y

    def renamed(self, names: Mapping[str, str]) -> Signature:
        """The same with other names of joints, and channels called after these (`JOINT_cmd`) called
        after the new ones.
        """

        def named(channel: str) -> str:
            for old in sorted(names, key=len, reverse=True):
                if channel == old or channel.startswith(f"{old}_"):
                    return names[old] + channel[len(old) :]
            return channel

        return self._replace(
            inputs=tuple((named(name), unit) for name, unit in self.inputs),
            outputs=tuple((named(name), unit) for name, unit in self.outputs),
            joints=tuple(map(named, self.joints)),
        )

    def _reads_length(self, joint: int) -> bool:
        """Whether an output reads the joint's position in m, or its speed in m/s."""
        units = dict(self.outputs)
        own = self.joints[joint] if joint < len(self.joints) else ""
        return units.get(own) == "m" or any(
            units.get(n) == "m/s" for n in speed_names(self.joints, joint)
        )


def speed_names(joints: tuple[str, ...], joint: int) -> tuple[str, ...]:
    """Names that a channel of a joint's speed may have: qd or qd2 by its number, the joint's own
    with _qd, velocity.
    """
    if joint >= len(joints):
        return ()
    return (
        *(("qd", "velocity") if len(joints) == 1 else (f"qd{joint + 1}",)),
        f"{joints[joint]}_qd",
    )


class Free(NamedTuple):
    """Answer of a mechanism to a held torque: end velocity, A = d qd / d tau over the step, and
    what `close` needs.
    """

    qd: Float[Array, " nq"]
    A: Float[Array, "nq nq"]
    aux: Any


class Mechanism(eqx.Module):
    """Abstract: a mechanical system seen from its joints.

    Class attributes of a final class: `name`, `signatures`, `equations`, `source`, and `builtin`:
    pairs (effect class, {effect parameter: id in this model}) that the model contains by default.
    """

    name: eqx.AbstractClassVar[str]
    signatures: eqx.AbstractClassVar[tuple[Signature, ...]]
    builtin: eqx.AbstractClassVar[tuple[tuple[type, dict[str, str]], ...]]
    equations: eqx.AbstractClassVar[str]
    source: eqx.AbstractClassVar[str]
    #: Whether the state holds more than joint positions and velocities: such a motion cannot be
    #: inverted without a simulation.
    hidden_states: ClassVar[bool] = False
    #: How it is stepped: an integrator of `jaxid.dynamics.mujoco_step`, "" by its own best step.
    integrator: ClassVar[str] = ""
    #: What it touches (a `jaxid.robots.ground.Ground`), where contacts are simulated.
    ground: ClassVar[Any] = None
    #: Effects that have more numbers on this mechanism: id of the effect -> a class of the same
    #: name.
    variants: ClassVar[dict[str, type]] = {}

    def ode(self, *, smoothing_velocity: float = 0.0) -> ODE:
        """The model with its built-in effects as a differential equation: see `ode.ODE`.
        `smoothing_velocity` (rad/s or m/s) smooths their dry friction; without, one that has some
        raises `UsageError`.
        """
        from jaxid.dynamics.chain import Chain

        return Chain(self, smoothing_velocity=smoothing_velocity).ode()

    def prepare(self, h: Any | None) -> Mechanism:
        """The same mechanism with everything worked out that does not depend on the state; `h` None
        where steps differ.
        """
        return self

    def drive(
        self,
        signature: Signature,
        u: Float[Array, " nu"],
        q: Float[Array, " nq"],
        qd: Float[Array, " nq"],
    ) -> Float[Array, " nq"]:
        """Joint torque that the inputs make; a mechanism whose inputs are not joint torques has its
        own law.
        """
        return u if signature.inputs else jnp.zeros_like(q)

    @property
    def touches(self) -> bool:
        """Whether contacts are simulated."""
        return self.ground is not None

    @property
    def own_step(self) -> float | None:
        """The length of step (s) that its simulator is told to take; None: any that is short."""
        return None

    @property
    def first_order_steps(self) -> Any:
        """Steps of first order that its simulator is told to take (`jaxid.robots.steps.Steps`): no
        machine takes them. None where steps leave nothing behind.
        """
        return None

    @property
    def of_one_joint(self) -> frozenset[str]:
        """Fields whose numbers act each at its own joint alone."""
        return frozenset()

    def behind_law(self, effect: Any) -> bool:
        """Whether an effect at the inputs acts on the torque that a law makes of a goal, and not on
        the goal.
        """
        return False

    @property
    def idle(self) -> frozenset[str]:
        """Names of commands and torques that do nothing: those of joints without a drive."""
        return frozenset()

    def told_by_torque(
        self, q: Float[np.ndarray, "time nq"], beside: int
    ) -> Bool[np.ndarray, " time"]:
        """Samples of a motion whose torque is that of the drives alone; what does not count reaches
        `beside` samples further.
        """
        return np.ones(len(q), bool)

    def places(self, effect: Any, signature: Signature) -> tuple[str, ...]:
        """Names of the places of an effect at the inputs or outputs, one for each channel."""
        channels = signature.commands if effect.location == "input" else signature.outputs
        return tuple(name for name, _ in channels)

    def nominal_effects(self) -> list[Any]:
        """The built-in effects with what is known of them; by default at their start values."""
        return [kind() for kind, _ in self.builtin]

    def held(self) -> frozenset[str]:
        """Names of numbers, its own and those of built-in effects, that a fit leaves as they are
        unless the dataset names them under [model.parameters]: what no motion determines beside the
        others.
        """
        return frozenset()

    def nameless(self, signature: Signature) -> tuple[Mechanism, Signature]:
        """The same, as programs are made of it, without what does not change a result: mechanisms
        of one shape are then equal but for their numbers.
        """
        return self, signature

    def number_name(self, field: str, place: int) -> str:
        """Printed name of one number of a field that has one for each joint or link."""
        return f"{field}{place + 1}"

    def known(self) -> dict[str, ParameterPrior]:
        """What is known, by name, of numbers that this model has fitted though it would hold
        them.
        """
        return {}

    def spec_of(self, field: str, place: int, spec: ParameterSpec) -> ParameterSpec:
        """What is known beforehand of one number of a field; a model may set bounds by its size."""
        return spec

    @abc.abstractmethod
    def start(self, q: Float[Array, " nq"], qd: Float[Array, " nq"]) -> Any:
        """State x with these joint positions and velocities."""

    def follow(self, x: Any, q: Float[Array, " nq"], qd: Float[Array, " nq"]) -> Any:
        """State x with its joints moved to these positions and velocities. What moves beside the
        joints (springs, beams) stays as it is where a mechanism says so; by default the state
        begins anew.
        """
        return self.start(q, qd)

    @abc.abstractmethod
    def port(self, x: Any) -> tuple[Float[Array, " nq"], Float[Array, " nq"]]:
        """Joint positions and velocities of a state."""

    @abc.abstractmethod
    def vector_field(self, t: Any, x: Any, tau: Float[Array, " nq"]) -> Any:
        """dx/dt under joint torque `tau`."""

    @abc.abstractmethod
    def free(self, h: Any, x: Any, tau: Float[Array, " nq"]) -> Free:
        """Motion over a step of length h under held torque."""

    def damped(
        self,
        h: Any,
        x: Any,
        tau: Float[Array, " nq"],
        qd: Float[Array, " nq"],
        slope: Float[Array, " nq"] | Float[Array, "nq nq"],
        stiffness: Float[Array, " nq"],
    ) -> tuple[Free, Float[Array, " nq"], Float[Array, "nq nq"]]:
        """`free`; and velocity and compliance at the end of the step where the joints are damped
        beside it: by `slope` (of each, or a matrix) times what their mean speed exceeds `qd`, the
        one predicted for the middle of the step. `stiffness` is how tightly a law holds them,
        torque per position.
        """
        free, v = self.free(h, x, tau), self.port(x)[1]
        B = inverse(
            jnp.eye(v.shape[0]) + (free.A * slope if slope.ndim == 1 else dot(free.A, slope)) / 2
        )
        push = slope * (qd - v / 2) if slope.ndim == 1 else dot(slope, qd - v / 2)
        return free, dot(B, free.qd + dot(free.A, push)), dot(B, free.A)

    @abc.abstractmethod
    def close(
        self,
        h: Any,
        x: Any,
        free: Free,
        dtau: Float[Array, " nq"],
        qd: Float[Array, " nq"],
        shift: Float[Array, " nq"],
    ) -> Any:
        """State at the end of the step, given the torque correction `dtau`, the final joint
        velocity `qd`, and the `shift` of the joint position of a joint that stopped or reversed
        inside the step.
        """

    def rotors(self) -> Array | float:
        """Inertia [nq] of what turns before the gears and is no load to them."""
        return 0.0

    @abc.abstractmethod
    def inverse(
        self, q: Float[Array, " nq"], qd: Float[Array, " nq"], qdd: Float[Array, " nq"]
    ) -> Float[Array, " nq"]:
        """Joint torque that this motion needs (friction excluded)."""

    def outline(self, x: Any, signature: Signature) -> Float[Array, "points d"] | None:
        """Points of a line drawing of state x, m, in the plane or in space (z upwards); None: not
        to be drawn.
        """
        return None

    def transfer(
        self,
        omega: Float[Array, " lines"],
        slope: Float[Array, " nq"],
        stiffness: Float[Array, " nq"],
    ) -> tuple[Float[Array, "lines ny nq"], Float[Array, "lines ny nq"]] | None:
        """Real and imaginary part of outputs / joint torques at omega, with viscous friction
        `slope` and springs at the joints. None: no closed form, the equation of motion is
        linearised and solved at each line.
        """
        return None

    @abc.abstractmethod
    def output(
        self, x: Any, tau: Float[Array, " nq"], rests: Bool[Array, " nq"]
    ) -> Float[Array, " ny"]:
        """What ideal sensors read in state x, [ny] of the signature with most outputs (others take
        the first of them).

        For accelerations: `tau` the net joint torque (drive minus friction) that acts, `rests`
        which joints stand still under it.
        """


class Rigid(Mechanism):
    """Abstract: M(q) qdd + bias(q, qd) = tau, stepped by the classical Runge-Kutta scheme. Write
    `matrices`, nothing else.
    """

    @abc.abstractmethod
    def matrices(
        self, q: Float[Array, " nq"], qd: Float[Array, " nq"]
    ) -> tuple[Float[Array, "nq nq"], Float[Array, " nq"]]:
        """Mass matrix and bias (Coriolis, centrifugal, gravity, springs)."""

    def start(self, q, qd) -> Any:
        return q, qd

    def port(self, x) -> Any:
        return x

    def output(self, x, tau, rests):
        return x[0]

    def vector_field(self, t, x, tau) -> Any:
        M, bias = self.matrices(*x)
        return x[1], dot(inverse(M), tau - bias)

    def inverse(self, q, qd, qdd):
        M, bias = self.matrices(q, qd)
        return dot(M, qdd) + bias

    def free(self, h, x, tau):
        q, v = x

        def acceleration(q, v):
            M, bias = self.matrices(q, v)
            W = inverse(M)
            return dot(W, tau - bias), W

        a1, _ = acceleration(q, v)
        a2, W = acceleration(q + h / 2 * v, v + h / 2 * a1)
        a3, _ = acceleration(q + h / 2 * v + h * h / 4 * a1, v + h / 2 * a2)
        a4, _ = acceleration(q + h * v + h * h / 2 * a2, v + h * a3)
        qd = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        return Free(qd, h * W, q + h * v + h * h / 6 * (a1 + a2 + a3))

    def close(self, h, x, free, dtau, qd, shift) -> Any:
        return free.aux + h / 2 * (qd - free.qd) + shift, qd


class Staged(Rigid):
    """Abstract: the scheme of `Rigid` with its stages in a loop, compiled once and not four times:
    for long recursions.
    """

    def free(self, h, x, tau):
        q, v = x

        def stage(carry, c):
            v_before, a_before, q_sum, v_sum = carry
            share, weight = c
            v_here = v + share * h * a_before
            M, bias = self.matrices(q + share * h * v_before, v_here)
            W = inverse(M)
            a = dot(W, tau - bias)
            return (v_here, a, q_sum + weight * v_here, v_sum + weight * a), W

        zero = jnp.zeros_like(v)
        shares = jnp.array([[0, 1 / 6], [1 / 2, 1 / 3], [1 / 2, 1 / 3], [1, 1 / 6]])
        (*_, q_sum, v_sum), W = jax.lax.scan(stage, (v, zero, zero, zero), shares)
        return Free(v + h * v_sum, h * W[1], q + h * q_sum)


class Lagrangian(Rigid):
    """Abstract: a rigid mechanism from its energies; the equation of motion follows by automatic
    differentiation.
    """

    @abc.abstractmethod
    def kinetic_energy(
        self, q: Float[Array, " nq"], qd: Float[Array, " nq"]
    ) -> Float[Array, ""]: ...

    @abc.abstractmethod
    def potential_energy(self, q: Float[Array, " nq"]) -> Float[Array, ""]: ...

    def matrices(self, q, qd):
        return equations_of_motion(
            lambda q, qd: self.kinetic_energy(q, qd) - self.potential_energy(q), q, qd
        )


def equations_of_motion(lagrangian, q: Float[Array, " nq"], qd: Float[Array, " nq"]):
    """(M, bias) of d/dt dL/dqd - dL/dq = tau for a Lagrangian L(q, qd)."""
    momentum = jax.grad(lagrangian, 1)
    M = jax.jacfwd(momentum, 1)(q, qd)
    return M, jax.jvp(lambda q: momentum(q, qd), (q,), (qd,))[1] - jax.grad(lagrangian, 0)(q, qd)


def joint_count(mechanism: Mechanism | type[Mechanism]) -> int:
    return len(mechanism.signatures[0].joints)


__all__ = [
    "Free",
    "Lagrangian",
    "Mechanism",
    "Rigid",
    "Signature",
    "Staged",
    "equations_of_motion",
    "joint_count",
]
