"""Transfer functions of a linearised chain."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Command, Signals
from jaxid.dynamics.mechanism import Mechanism
from jaxid.numerics.linalg import solve


Complex = tuple[Array, Array]


def transfer(
    chain: Chain,
    omega: Float[Array, " lines"],
    q0: Float[Array, " nq"] | None = None,
    body: Mechanism | None = None,
) -> tuple[Float[Array, "lines ny nu"], Float[Array, "lines ny nu"]]:
    """Real and imaginary part of outputs / inputs at omega (rad/s), linearised at rest in q0
    (default 0). Traceable. `body` is the chain's mechanism with its effects, prepared, where that
    has been done.
    """
    body = chain.body().prepare(None) if body is None else body
    q0 = jnp.zeros(chain.nq) if q0 is None else q0
    still = jnp.zeros_like(q0)
    u0 = jnp.zeros(len(chain.signature.inputs))
    command = Command(jnp.zeros(()), jnp.ones(()), u0, u0, lambda d: u0)
    z0 = chain.start(q0, still, u0).z

    def opposing(q, qd, load):
        return chain.friction(Signals(command.t, q, qd, load, command.h, command, qd), z0)[0]

    ny, ones = len(chain.signature.outputs), jnp.ones_like(still)
    stiffness, slope = (
        jax.jvp(lambda q, qd: opposing(q, qd, still), (q0, still), along)[1]
        for along in ((ones, still), (still, ones))
    )
    own = None if chain.signature.speeds else body.transfer(omega, slope, stiffness)
    if own is not None:
        re, im = (a[:, :ny] for a in own)
    else:
        x0, unravel = ravel_pytree(body.start(q0, still))

        def torque(x, u):
            q, qd = body.port(unravel(x))
            tau = body.drive(chain.signature, u, q, qd)
            return tau - opposing(q, qd, tau)

        def field(x, u):
            return ravel_pytree(body.vector_field(0.0, unravel(x), torque(x, u)))[0]

        moving = jnp.zeros(chain.nq, bool)

        def sensors(x, u):
            return chain.signature.read(body, unravel(x), torque(x, u), moving)

        A, B = jax.jacfwd(field, (0, 1))(x0, u0)
        C, D = jax.jacfwd(sensors, (0, 1))(x0, u0)
        X = jax.vmap(lambda w: solve(1j * w * jnp.eye(x0.size) - A, B))(omega)
        response = C @ X + D
        re, im = response.real, response.imag
    for e in chain.effects:
        if (factor := e.transfer(omega)) is not None:
            re, im = _times((re, im), factor, -2 if e.location == "input" else -1)
    return re, im


def _times(response: Complex, factor: Complex, axis: int) -> Complex:
    """Response times a factor per channel [lines channels]."""
    a, b = (jnp.expand_dims(f, axis) for f in factor)
    re, im = response
    return re * a - im * b, re * b + im * a
