"""A model as an ordinary differential equation, for diffrax and every other solver."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.base.errors import UsageError
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Command, JointEffect, OutputEffect, RecordEffect, Signals
from jaxid.dynamics.mechanism import Mechanism
from jaxid.dynamics.parameter import specs, with_fields
from jaxid.dynamics.parameter_vector import ParameterVector


class Numbers(NamedTuple):
    """A model's numbers made ready: its chain, and its mechanism with body effects and whatever
    does not depend on the state (the modes of a beam) worked out. A pytree; gradients flow through
    it.
    """

    chain: Chain
    body: Mechanism


class ODE(eqx.Module):
    """dy/dt = ode(t, y, args) of a model, with args = (parameters, u). Made by `model.ode()`.

    `parameters`: those of the model are `ode.parameters`, others are made by
    `ode.with_parameters(inertia=0.1)`, once and not in every call; a dictionary (name -> number), a
    vector [size] in the order of `ode.names`, and None (the model's own) serve, too, and a beam
    then works out its modes at every call. `u(t)` gives the inputs [nu]. The state y is that of the
    mechanism, (q, qd, ...); with effects that remember it is (state of the mechanism, (state of
    each such effect, ...)).
    """

    parameters: Numbers
    names: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, chain: Chain):
        """Raises `UsageError` for dry friction that is not smoothed, and for effects that act on a
        recorded series.
        """
        check_smooth(chain)
        for e in chain.effects:
            y = jnp.zeros(len(chain.places(e)))
            sensed = isinstance(e, OutputEffect) and jax.tree.leaves(e.start(y, y))
            if isinstance(e, RecordEffect) or sensed:
                raise UsageError(
                    f"{e.name} acts on a recorded series and has no differential equation:"
                    f" chain.without({e.name!r})"
                )
        self.parameters = _ready(chain)
        # The numbers themselves may be traced: their names are not.
        named = jax.tree.map(lambda a: np.zeros(np.shape(a)), chain)
        self.names = tuple(ParameterVector(named).names)

    def __call__(self, t: Any, y: Any, args: tuple[Any, Callable[[Any], Array]]) -> Any:
        chain, body = self._numbers(args)
        x, z = self._parts(y)
        dx, dz, _ = rates(chain, body, t, x, z, _command(t, args[1]))
        return self._whole(dx, dz)

    def y0(self, q: Any, qd: Any, args: tuple[Any, Callable[[Any], Array]] | None = None) -> Any:
        """State with these joint positions and velocities [nq], in which inputs and outputs have
        been for long what they are: the inputs u(0) of `args`, or none.
        """
        chain, body = self._numbers(args or (None, None))
        q, qd = (jnp.atleast_1d(jnp.asarray(a, float)) for a in (q, qd))
        nothing = jnp.zeros(len(chain.signature.inputs))
        u = (
            nothing
            if args is None
            else jnp.reshape(jnp.asarray(args[1](0.0), float), nothing.shape)
        )
        start = chain.start(q, qd, u, body)
        return self._whole(start.x, start.z)

    def outputs(
        self, t: Any, y: Any, args: tuple[Any, Callable[[Any], Array]]
    ) -> Float[Array, " ny"]:
        """What the sensors read at one time. Map it over several: `jax.vmap(lambda t, y:
        ode.outputs(t, y, args))(ts, ys)`.
        """
        chain, body = self._numbers(args)
        x, z = self._parts(y)
        command = _command(t, args[1])
        _, _, tau = rates(chain, body, t, x, z, command)
        q, qd = body.port(x)
        read = body.output(x, tau, jnp.zeros(q.shape, bool))[: len(chain.signature.outputs)]
        signals = Signals(t, q, qd, jnp.zeros_like(q), jnp.zeros(()), command, qd)
        for i, e in chain.at(OutputEffect):
            read, _ = e(read, signals, z[i])
        return read

    def with_parameters(self, values: Mapping[str, Any] | None = None, **more: Any) -> Numbers:
        """The model's numbers with some of them replaced. Raises `UsageError` for a name that it
        does not have.
        """
        return _ready(_replaced(self.parameters.chain, {**(values or {}), **more}))

    def _numbers(self, args: tuple[Any, Any]) -> Numbers:
        given = args[0]
        if given is None:
            return self.parameters
        if isinstance(given, Numbers):
            return given
        return self.with_parameters(
            given if isinstance(given, Mapping) else dict(zip(self.names, given, strict=True))
        )

    def _whole(self, x: Any, z: tuple) -> Any:
        """y of the states of the mechanism and of all effects."""
        states = tuple(s for s in z if jax.tree.leaves(s))
        return (x, states) if states else x

    def _parts(self, y: Any) -> tuple[Any, tuple]:
        """The states of the mechanism and of all effects, of y."""
        chain, body = self.parameters
        q, u = jnp.zeros(chain.nq), jnp.zeros(len(chain.signature.inputs))
        shapes = jax.eval_shape(lambda: chain.start(q, q, u, body).z)
        remembers = [bool(jax.tree.leaves(shape)) for shape in shapes]
        if not any(remembers):
            return y, ((),) * len(remembers)
        x, states = y
        own = iter(states)
        each = []
        for has in remembers:
            each.append(next(own) if has else ())
        return x, tuple(each)


def _ready(chain: Chain) -> Numbers:
    return Numbers(chain, chain.body().prepare(None))


def _replaced(chain: Chain, values: Mapping[str, Any]) -> Chain:
    layout = ParameterVector(chain)
    theta: list[Any] = list(layout.values)
    for name, value in values.items():
        theta[layout.index(name)] = value
    return layout.model([jnp.asarray(v) for v in theta])


def _command(t: Any, u: Callable[[Any], Array]) -> Command:
    """The input as it is at one time: there is no step, and no other hold."""
    now = jnp.atleast_1d(jnp.asarray(u(t)))

    def late(d):
        return (
            jnp.stack([jnp.atleast_1d(jnp.asarray(u(t - d[i])))[i] for i in range(now.shape[0])])
            if now.size
            else now
        )

    return Command(jnp.asarray(t), jnp.zeros(()), now, now, late)


def rates(
    chain: Chain, body: Mechanism, t: Any, x: Any, z: tuple, command: Command
) -> tuple[Any, tuple, Array]:
    """Rates of change of the mechanism and of the effects, and the net torque at the joints, under
    a command that is held.

    Effects are written for a step of length h and follow their states exactly over it: the rate is
    the derivative by h at 0, and what they pass on is the limit of short steps.
    """
    q, qd = body.port(x)

    def over(h: Array) -> tuple[Array, tuple]:
        now = command._replace(h=h)
        s = Signals(jnp.asarray(t), q, qd, jnp.zeros_like(q), h, now, qd)
        u, after = chain.commanded(s, z)
        tau = body.drive(chain.signature, u, q, qd)

        def net(transmitted: Any) -> tuple[Array, tuple]:
            F, minus, plus, new = chain.friction(
                s._replace(load=tau, transmitted=transmitted), after
            )
            dry = jnp.zeros_like(qd)
            if chain.smoothing_velocity > 0:
                dry = jnp.where(qd > 0, plus, minus) * jnp.tanh(qd / chain.smoothing_velocity)
            return tau - F - dry, new

        through: Any = tau
        for _ in range(
            ROUNDS if chain.transmits else 0
        ):  # what is transmitted depends on the friction that it makes
            total, _ = net(through)
            qdd = jax.jvp(body.port, (x,), (body.vector_field(t, x, total),))[1][1]
            through = total - body.rotors() * qdd
        return net(through)

    if not jax.tree.leaves(z):
        tau, _ = over(jnp.zeros(()))
        return body.vector_field(t, x, tau), z, tau
    (tau, _), (slope, dz) = jax.jvp(over, (jnp.asarray(SHORT),), (jnp.ones(()),))
    tau = tau - SHORT * slope
    return body.vector_field(t, x, tau), dz, tau


def check_smooth(chain: Chain) -> None:
    """Raises `UsageError` for a chain whose dry friction sticks: no differential equation says what
    holds a joint.
    """
    if chain.smoothing_velocity == 0 and (dry := dry_effects(chain)):
        raise UsageError(
            f"{chain.mechanism.name} has dry friction with true sticking ({', '.join(dry)}), for"
            " which there is no differential equation. Smooth it over a velocity in rad/s or m/s:"
            " chain.smoothed(1e-3) in Python, smoothing_velocity = 1e-3 under [model.constants] in"
            f" dataset.toml; or leave it out: without {', '.join(dry)}"
        )


def dry_effects(chain: Chain) -> list[str]:
    """Names of the effects that have a dry level, whatever it is now: it is tried with all numbers
    at 1.
    """
    one = jnp.full(chain.nq, 0.7)
    u = jnp.full(len(chain.signature.inputs), 0.9)
    h = jnp.asarray(1e-3)
    signals = Signals(
        jnp.zeros(()), one / 2, one, one, h, Command(jnp.zeros(()), h, u, u, lambda d: u), one
    )
    found = []
    for _, e in chain.at(JointEffect):
        e = with_fields(
            e, {name: jnp.ones_like(jnp.asarray(getattr(e, name))) for name in specs(e)}
        )
        _, minus, plus, _ = e(signals, e.start(one))
        if np.any(np.asarray(minus) != 0) or np.any(np.asarray(plus) != 0):
            found.append(e.name)
    return found


#: Rounds in which the transmitted torque and the friction that it makes are brought together.
ROUNDS = 8
#: Length of the step at which an effect's rate is taken, s: short against every time constant, and
#: not 0, by which some divide.
SHORT = 1e-9
