"""A model is a signal chain: command -> input effects -> joint -> mechanism -> output effects ->
sensor.

An effect sits at ONE port of the chain and is called once a step. Nominal friction is an effect
like any other, so "a candidate unless the model has it" is a set difference, and no mechanism
writes friction or sensor code. Every parameter of an effect is one number per location (joint,
input or output channel); at its neutral value the effect is the identity, bitwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TYPE_CHECKING, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxid.base.wording import names_of
from jaxid.dynamics import mujoco_step
from jaxid.dynamics.carry import Carry, first_command, first_state
from jaxid.dynamics.drive_torque import is_direct, records_torque
from jaxid.dynamics.dry_friction import solve_dry
from jaxid.dynamics.effect import (
    BodyEffect,
    chosen,
    Command,
    Effect,
    InputEffect,
    JointEffect,
    NumberEffect,
    OutputEffect,
    RecordEffect,
    Signals,
)
from jaxid.dynamics.mechanism import Mechanism, Signature
from jaxid.dynamics.parameter import specs, with_fields
from jaxid.dynamics.present import at_time, numbers_of
from jaxid.numerics.fast_math import dot, fence


if TYPE_CHECKING:
    from jaxid.dynamics.ode import ODE


Port = TypeVar("Port", bound=Effect)


#: Structure of a chain -> which of its effects have states: tracing takes a while.
_REMEMBERING: dict[Any, tuple[bool, ...]] = {}


def _widened(effect: Effect, places: int) -> Effect:
    """The effect with each of its fields an array of one number per place."""
    own = {name: getattr(effect, name) for name in specs(effect)}

    def done(x):
        return isinstance(x, np.ndarray) and x.shape == (places,) and x.dtype == np.float64

    wide = {
        k: np.broadcast_to(np.asarray(x, np.float64), (places,))
        for k, x in own.items()
        if not done(x)
    }
    return with_fields(effect, {k: np.array(x) for k, x in wide.items()})


class Chain(eqx.Module):
    """A model: a mechanism and the effects on the way to and from it.

    `smoothing_velocity` 0 is Coulomb friction with true sticking; v > 0 replaces sign(qd) by
    tanh(qd / v), another model.
    """

    mechanism: Mechanism
    effects: tuple[Effect, ...] = ()
    signature: Signature = eqx.field(static=True, default=None)  # type: ignore[assignment]
    smoothing_velocity: float = eqx.field(static=True, default=0.0)

    def __init__(
        self,
        mechanism: Mechanism,
        effects: Iterable[Effect] | None = None,
        *,
        signature: Signature | None = None,
        smoothing_velocity: float = 0.0,
    ):
        """`effects` None takes the mechanism's built-in ones at their start values."""
        self.mechanism = mechanism
        self.signature = signature or mechanism.signatures[0]
        self.smoothing_velocity = float(smoothing_velocity)
        given = tuple(mechanism.nominal_effects() if effects is None else effects)
        self.effects = tuple(
            e for e in given if not isinstance(e, NumberEffect)
        )  # whose numbers are places of such
        places = self.places  # equinox makes a module of each method that is looked up
        self.effects = tuple(_widened(e, len(places(e))) for e in given)

    @property
    def nq(self) -> int:
        return len(self.signature.joints)

    @property
    def direct(self) -> bool:
        """Whether each input, times its drive gain, is the drive torque or force of a joint."""
        return is_direct(self)

    @property
    def torque_channels(self) -> tuple[tuple[str, str], ...]:
        """(name, unit) of each joint's drive torque: the input channels, or the joints where inputs
        are something else.
        """
        if self.direct and records_torque(self):
            return self.signature.commands
        return tuple(
            (f"torque at {joint}", self.signature.unit("{F}", j))
            for j, joint in enumerate(self.signature.joints)
        )

    @property
    def joint_outputs(self) -> list[int]:
        """Positions of the joints' own coordinates among the outputs; empty where not every joint
        is measured.
        """
        names, joints = self.signature.output_names, self.signature.joints
        return [names.index(j) for j in joints] if set(joints) <= set(names) else []

    def places(self, effect: Effect | type[Effect]) -> tuple[str, ...]:
        """Names of the locations that an effect's parameters are counted by in this model."""
        if effect.location == "joint":
            return self.signature.joints
        if effect.location == "number":
            return tuple(names_of(self.numbers))
        return self.mechanism.places(effect, self.signature)

    def offers(self, effect: Effect | type[Effect]) -> tuple[str, ...]:
        """Those of its places where an effect makes sense in this model: its candidates in a
        diagnosis.
        """
        idle, places = self.mechanism.idle, self.places(effect)
        if self.mechanism.behind_law(effect):
            places = places[: self.nq]
        elif effect.offered is not None:
            places = effect.offered(self.mechanism, self.signature)
        return tuple(place for place in places if place not in idle)

    @property
    def contents(self) -> set[str]:
        """Ids of all effects that the model comprises; none of them can be a candidate."""
        contents: set[str] = set()
        for effect in self.effects:
            contents |= {effect.name, *effect.contains}
        return contents

    def without(self, *names: str) -> Chain:
        """The same model with these effects taken out."""
        return self._with(e for e in self.effects if e.name not in names)

    def with_effects(self, *effects: Effect) -> Chain:
        """The same model with more effects; one that it already has is replaced."""
        return self._with([*self.without(*names_of(effects)).effects, *effects])

    def with_mechanism(self, mechanism: Mechanism) -> Chain:
        """The same effects on another mechanism with the same places."""
        return Chain(
            mechanism,
            self.effects,
            signature=self.signature,
            smoothing_velocity=self.smoothing_velocity,
        )

    def _with(self, effects: Iterable[Effect]) -> Chain:
        return Chain(
            self.mechanism,
            effects,
            signature=self.signature,
            smoothing_velocity=self.smoothing_velocity,
        )

    def smoothed(self, smoothing_velocity: float) -> Chain:
        """The same model with dry friction smoothed as tanh(qd / smoothing_velocity); 0 restores
        true sticking.
        """
        return Chain(
            self.mechanism,
            self.effects,
            signature=self.signature,
            smoothing_velocity=smoothing_velocity,
        )

    def nameless(self) -> Chain:
        """The same as programs are made of it: see `Mechanism.nameless`. Where numbers are told
        apart by name it is unchanged.
        """
        if self.timed:
            return self
        mechanism, signature = self.mechanism.nameless(self.signature)
        return Chain(
            mechanism, self.effects, signature=signature, smoothing_velocity=self.smoothing_velocity
        )

    # ---- numbers that change in time

    @property
    def numbers(self) -> tuple[Any, ...]:
        """Entries (`parameter_vector.Entry`) of its own numbers that may change during a run."""
        return numbers_of(self)

    @property
    def timed(self) -> bool:
        """Whether its numbers depend on time."""
        return any(isinstance(e, NumberEffect) for e in self.effects)

    def present(self, t: Float[Array, ""], h: Float[Array, ""]) -> Chain:
        """The chain with its numbers as they are in a step."""
        return at_time(self, t, h)

    # ---- one step

    def at(self, port: type[Port]) -> list[tuple[int, Port]]:
        """The effects at one port with their positions, in the order in which they act."""
        found = [(i, e) for i, e in enumerate(self.effects) if isinstance(e, port)]
        return sorted(found, key=lambda pair: (self.mechanism.behind_law(pair[1]), pair[1].stage))

    def body(self) -> Mechanism:
        """The mechanism with all body effects applied."""
        mechanism = self.mechanism
        for _, e in self.at(BodyEffect):
            mechanism = e(mechanism)
        return mechanism

    @property
    def transmits(self) -> bool:
        """Whether an effect looks at the torque that the gears transmit."""
        return any(e.transmits for _, e in self.at(JointEffect))

    def has_states(self) -> bool:
        """Whether an effect, or the mechanism beside its joints, remembers the motion before a
        record.
        """
        return self.mechanism.hidden_states or any(self.stateful())

    def stateful(self) -> tuple[bool, ...]:
        """Which effects remember the motion before a record; sensors do not, they begin anew with
        it.
        """
        key = jax.tree.structure(self)
        if key not in _REMEMBERING:
            q, u = jnp.zeros(self.nq), jnp.zeros(len(self.signature.commands))

            def states(e: Effect) -> Any:
                hidden = isinstance(e, BodyEffect) and e(self.mechanism).hidden_states
                return (
                    q
                    if hidden
                    else ()
                    if isinstance(e, OutputEffect)
                    else first_state(e, q, u, u, u)
                )

            _REMEMBERING[key] = tuple(
                bool(jax.tree.leaves(jax.eval_shape(states, e))) for e in self.effects
            )
        return _REMEMBERING[key]

    def start(
        self,
        q: Float[Array, " nq"],
        qd: Float[Array, " nq"],
        u: Float[Array, " nu"],
        body: Mechanism | None = None,
    ) -> Carry:
        """State at the beginning of a run that has seen the input `u` for long; `body` the
        mechanism ready with its effects.
        """
        body = self.body().prepare(None) if body is None else body
        x = body.start(q, qd)
        y, rate = (
            self.begins(body, q, qd) if self.at(OutputEffect) else (jnp.zeros(0), jnp.zeros(0))
        )
        u = u[: len(self.signature.commands)]
        z = [first_state(e, q, u, y, rate) for e in self.effects]
        for i, e in self.at(InputEffect):
            z[i] = e.settled(
                z[i], u, q, lambda: body.inverse(q, jnp.zeros_like(q), jnp.zeros_like(q))
            )
        net = body.inverse(q, qd, jnp.zeros_like(q)) if self.transmits else ()
        return Carry(x, tuple(z), jnp.zeros_like(q), jnp.zeros_like(q), net)

    def sensed_anew(self, z: tuple, fresh: tuple, here: Array) -> tuple:
        """States z, with those of the sensors as in `fresh` where `here`."""

        states = []
        for effect, new, old in zip(self.effects, fresh, z, strict=True):
            if isinstance(effect, OutputEffect):
                old = jax.tree.map(lambda a, b: jnp.where(here, a, b), new, old)
            states.append(old)
        return tuple(states)

    def begins(
        self, body: Mechanism, q: Float[Array, " nq"], qd: Float[Array, " nq"]
    ) -> tuple[Float[Array, " ny"], Float[Array, " ny"]]:
        """Outputs without effects of a run that begins at (q, qd) without acceleration, and their
        rate of change.
        """

        def outputs(q: Float[Array, " nq"]) -> Float[Array, " ny"]:
            return self.signature.read(
                body, body.start(q, qd), jnp.zeros_like(q), jnp.ones_like(q, bool)
            )

        return jax.jvp(outputs, (q,), (qd,))

    def _off(self) -> Array | float:
        """By how much the encoders of the joints are off, [nq]."""
        names = self.signature.output_names
        total: Array | float = 0.0
        for _, e in self.at(OutputEffect):
            off = e.offset()
            if off is None:
                continue
            of_joints = []
            for joint in self.signature.joints:
                of_joints.append(off[names.index(joint)] if joint in names else 0.0 * off[0])
            total += jnp.stack(of_joints)
        return total

    def commanded(self, s: Signals, z: tuple) -> tuple[Float[Array, " nu"], tuple]:
        """Inputs after the input effects, which act on what commands joints alone."""
        whole, n = s.command, len(self.signature.commands)
        u, beside, z_new = whole.u[:n], whole.u[n:], list(z)
        if n < whole.u.shape[0]:
            s = s._replace(command=first_command(whole, n), beside=beside)
        for i, e in self.at(InputEffect):
            late = e.late()
            if self.signature.rates and late is not None:
                still = jnp.zeros(beside.shape[0] - self.signature.rates)
                s = s._replace(beside=whole.delayed(jnp.concatenate([late, late, still]))[n:])
            u, z_new[i] = e(u, s._replace(q=s.q + self._off()) if e.reads_encoders else s, z[i])
            if late is not None:
                s = s._replace(command=s.command.behind(late))
        return (jnp.concatenate([u, beside]) if n < whole.u.shape[0] else u), tuple(z_new)

    def friction(self, s: Signals, z: tuple) -> tuple[Array, Array, Array, tuple]:
        """Smooth opposing torque, dry levels (minus, plus), effect states at the end of the
        step.
        """
        smooth, minus, plus, z_new = (
            jnp.zeros_like(s.qd),
            jnp.zeros_like(s.qd),
            jnp.zeros_like(s.qd),
            list(z),
        )
        for i, e in self.at(JointEffect):
            f, m, p, z_new[i] = e(s, z[i])
            smooth, minus, plus = smooth + f, minus + m, plus + p
        return smooth, jnp.maximum(minus, 0.0), jnp.maximum(plus, 0.0), tuple(z_new)

    def step(
        self, body: Mechanism, carry: Carry, command: Command
    ) -> tuple[Carry, Float[Array, " ny"]]:
        """State at the end of a step, and what the sensors record at its beginning, under the
        torque that then begins to act.
        """
        after, tau = self.advance(body, carry, command)
        v0, v1 = body.port(carry.x)[1], body.port(after.x)[1]
        y, z = self.sense(body, carry, tau, (v0 == 0) & (v1 == 0), command)
        sensors = [isinstance(e, OutputEffect) for e in self.effects]
        return after._replace(z=chosen(sensors, z, after.z)), y

    def sense(
        self,
        body: Mechanism,
        carry: Carry,
        tau: Float[Array, " nq"],
        rests: Bool[Array, " nq"],
        command: Command,
    ) -> tuple[Float[Array, " ny"], tuple]:
        """What the sensors record at the beginning of a step with net joint torque `tau`, and the
        effects' next states.
        """
        if self.timed:
            now = self.present(command.t, command.h)
            return now.sense(now.body().prepare(None), carry, tau, rests, command)
        q, v = body.port(carry.x)
        s = Signals(command.t, q, v, jnp.zeros_like(q), command.h, command, v)
        y, z = self.signature.read(body, carry.x, tau, rests), list(carry.z)
        for i, e in self.at(OutputEffect):
            y, z[i] = e(y, s, carry.z[i])
        return y, tuple(z)

    def advance(
        self, body: Mechanism, carry: Carry, command: Command
    ) -> tuple[Carry, Float[Array, " nq"]]:
        """One step of length command.h, and the net joint torque in it: friction law at the
        predicted middle, smooth friction linearly implicit, dry friction solved exactly
        (`jaxid.dynamics.dry_friction`). A mechanism with an `integrator` steps as MuJoCo does.
        """
        if self.timed:
            now = self.present(command.t, command.h)
            return now.advance(now.body().prepare(None), carry, command)
        if body.integrator:
            return mujoco_step.advance(self, body, carry, command)
        x, z, lam, acc, net = carry
        h, eps = command.h, self.smoothing_velocity
        q, v = body.port(x)
        s = Signals(
            command.t + h / 2, q + h / 2 * v, v + h / 2 * acc, jnp.zeros_like(q), h, command, v
        )
        u, after = self.commanded(s, z)
        s = s._replace(load=body.drive(self.signature, u, s.q, s.qd))
        if self.transmits:  # that of the last step: it depends on the friction that it makes
            s = s._replace(transmitted=net - body.rotors() * acc)

        def law(qd):
            now = s._replace(qd=qd)
            F, minus, plus, _ = self.friction(now, z)
            return F - body.drive(self.signature, self.commanded(now, z)[0], s.q, qd), minus, plus

        F, minus, plus, slope = (fence(a) for a in self._linearised(law, s.qd))
        if eps == 0:
            lam = jnp.where(v > 0, plus, jnp.where(v < 0, -minus, jnp.clip(lam, -minus, plus)))
        else:
            lam = jnp.where(s.qd > 0, plus, minus) * jnp.tanh(s.qd / eps)

        # Smooth law, linearised at the prediction, at the middle velocity (v + w) / 2: stable at
        # any slope.
        free, w, A = body.damped(h, x, -F - lam, s.qd, slope, self._stiffness())

        def push(dv):
            return slope * dv if slope.ndim == 1 else dot(slope, dv)

        dry, end, bend = solve_dry(v, w + dot(A, lam), A, minus, plus, lam, eps)
        # A joint that sticks stands exactly still: rounding left here would ruin every later
        # decision and gradient.
        sticks = (end == 0) & (minus + plus > 0)
        w = jnp.where(sticks, 0.0, w + dot(A, lam - dry))
        correction, shift = lam - dry - push((v + w) / 2 - s.qd), h * bend
        moved = body.port(body.close(h, x, free, correction, w, shift))[0] - q
        x = body.close(h, x, free, correction, w, shift - jnp.where(sticks & (v == 0), moved, 0.0))
        _, _, _, z = self.friction(s._replace(qd=(v + w) / 2), after)
        net = correction - F - lam
        return Carry(x, z, dry, (w - v) * (1 / h), net if self.transmits else ()), net

    def _linearised(
        self, law: Callable, qd: Float[Array, " nq"]
    ) -> tuple[Array, Array, Array, Array]:
        """The law at qd, and its slope: [nq] where each joint's torque depends on its own speed
        alone, else [nq nq].
        """
        if not any(e.couples for e in self.effects):
            (F, minus, plus), (slope, _, _) = jax.jvp(law, (qd,), (jnp.ones_like(qd),))
            return F, minus, plus, slope
        F, minus, plus = law(qd)
        return F, minus, plus, jax.jacfwd(lambda qd: law(qd)[0])(qd)

    def _stiffness(self) -> Float[Array, " nq"]:
        """How tightly a law holds each joint where it stands in a step, as torque per position."""
        own = [k for _, e in self.at(InputEffect) if (k := e.stiffness()) is not None]
        return sum(
            (jnp.pad(k, (0, self.nq - k.shape[0])) for k in own), jnp.zeros(self.nq)
        )  # none at the angles of a base

    def recorded(
        self,
        t: Float[Array, " time"],
        y: Float[Array, "time ny"],
        h: Float[Array, ""] | None,
        rate: Float[Array, " ny"],
    ) -> Float[Array, "time ny"]:
        """The sensors' series as the file holds it; times strictly increasing, by equal steps `h`
        where that is given; `rate` of change before the series begins.
        """
        for _, e in self.at(RecordEffect):
            y = e(t, y, h, rate)
        return y

    # ---- the same objects without integration

    def inverse(
        self,
        command: Command,
        z: tuple,
        q: Float[Array, " nq"],
        qd: Float[Array, " nq"],
        qdd: Float[Array, " nq"],
    ) -> tuple[Float[Array, " nq"], tuple]:
        """Missing torque of a measured motion, drive(u) - (M qdd + bias + friction), and the
        effects' next states.
        """
        left, minus, plus, z = self.balance(command, z, q, qd, qdd)
        eps = self.smoothing_velocity
        direction = jnp.sign(qd) if eps == 0 else jnp.tanh(qd / eps)
        return left - jnp.where(direction > 0, plus, minus) * direction, z

    def balance(
        self,
        command: Command,
        z: tuple,
        q: Float[Array, " nq"],
        qd: Float[Array, " nq"],
        qdd: Float[Array, " nq"],
    ) -> tuple[Float[Array, " nq"], Float[Array, " nq"], Float[Array, " nq"], tuple]:
        """What a measured motion leaves to dry friction, drive(u) - (M qdd + bias + smooth
        friction), the dry levels (minus, plus), and the effects' next states.
        """
        if self.timed:
            return self.present(command.t, command.h).balance(command, z, q, qd, qdd)
        body = self.body()
        s = Signals(command.t, q, qd, jnp.zeros_like(q), command.h, command, qd)
        u, z = self.commanded(s, z)
        tau = body.drive(self.signature, u, q, qd)
        needed = body.inverse(q, qd, qdd)
        F, minus, plus, z = self.friction(
            s._replace(load=tau, transmitted=needed - body.rotors() * qdd), z
        )
        return tau - needed - F, minus, plus, z

    def ode(self) -> ODE:
        """The model as dy/dt = f(t, y, (parameters, u)), for diffrax and other solvers: see
        `jaxid.dynamics.ode.ODE`.

        Raises `UsageError` for dry friction that is not smoothed (`chain.smoothed(1e-3)`): no such
        equation says what sticks.
        """
        from jaxid.dynamics.ode import ODE

        return ODE(self)
