"""One step of a robot as MuJoCo takes it, with the effects of a chain in the same step.

MuJoCo's forces are those of the step's beginning. Dry friction and stops are soft constraints
(`soft_constraints`) on the acceleration that these make. By integrator, with D what damps a joint
more the faster it is:

    EULER         (M + h D) dv = h M a, D of the joints alone; q' = q + h v'
    EXPLICIT      dv = h a, as Euler's with `eulerdamp` disabled
    IMPLICITFAST  as EULER, D of the drives, too
    IMPLICIT      as IMPLICITFAST, with what speeds change of Coriolis forces
    RK4           Runge and Kutta's, all forces anew at each of four stages

An effect that is not the file's acts as a force of the step's beginning, and its slope is a part
of D. What it remembers is carried on once a step.

Source: MuJoCo's documentation, chapter Computation, "Numerical integration".
"""

from __future__ import annotations

from typing import Any, NamedTuple, TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.dynamics.carry import Carry
from jaxid.dynamics.effect import Command, Signals
from jaxid.dynamics.soft_constraints import constrained, rows_of, Slip, Stops
from jaxid.numerics.fast_math import dot, inverse


if TYPE_CHECKING:
    from jaxid.dynamics.chain import Chain


#: Integrators that are known.
INTEGRATORS = ("EULER", "EXPLICIT", "IMPLICIT", "IMPLICITFAST", "RK4")
#: Stages of Runge and Kutta: where in the step each stands by the one before it, and its weight.
STAGES = ((0.0, 1 / 6), (0.5, 1 / 3), (0.5, 1 / 3), (1.0, 1 / 6))

Vector = Float[Array, " nq"]


class SoftJoints(NamedTuple):
    """How the joints of a file give way: dry friction, stops (None: the file has none), and the
    inverse inertia of each joint [nq] in the file's reference pose.
    """

    slip: Slip
    stops: Stops | None
    weight: Vector


class _Forces(NamedTuple):
    """What acts at one instant: inertia, acceleration, torque that dry friction opposes, and net
    torque of the joints.
    """

    M: Array
    acceleration: Vector
    opposed: Vector
    net: Vector


def advance(chain: Chain, body: Any, carry: Carry, command: Command) -> tuple[Carry, Vector]:
    """State after a step of length command.h, and the net joint torque in it; `body` is a mechanism
    that has an `integrator`, `soft_joints` and `edges`.
    """
    x, z, _, before, net = carry
    q, v = body.port(x)
    h, zero = command.h, jnp.zeros_like(q)
    s = Signals(command.t, q, v, load=zero, h=h, command=command, qd0=v, q0=q)
    if chain.transmits:  # that of the last step: it depends on the friction that it makes
        s = s._replace(transmitted=net - body.rotors() * before)
    now = _forces(chain, body, s, z, before)
    if body.integrator == "RK4":
        moved, change = _runge_kutta(chain, body, s, z, now)
    else:
        change = h * _implicit(chain, body, s, z, now)
        moved = h * (v + change)
    after = chain.commanded(s, z)[1]
    middle = s._replace(qd=v + change / 2, load=_load(chain, body, s, z))
    after = chain.friction(middle, after)[3]
    kept = now.net if chain.transmits else ()
    return Carry((q + moved, v + change), after, now.opposed, now.acceleration, kept), now.net


def _load(chain: Chain, body: Any, s: Signals, z: tuple) -> Vector:
    """Torque of the drives at the joints."""
    return body.drive(chain.signature, chain.commanded(s, z)[0], s.q, s.qd)


def _forces(chain: Chain, body: Any, s: Signals, z: tuple, guess: Vector) -> _Forces:
    """What acts at the positions and speeds of `s`."""
    M, bias = body.matrices(s.q, s.qd)
    drive = _load(chain, body, s, z)
    smooth, minus, plus, _ = chain.friction(s._replace(load=drive), z)
    soft: SoftJoints = body.soft_joints()
    rows = rows_of(s.q, s.qd, minus, plus, soft.slip, soft.stops, soft.weight)
    edges = body.edges(s.q, s.qd)
    acceleration, opposed = constrained(M, drive - smooth - bias, rows, guess, edges)
    return _Forces(M, acceleration, opposed, dot(M, acceleration) + bias)


def _implicit(chain: Chain, body: Any, s: Signals, z: tuple, now: _Forces) -> Vector:
    """Acceleration of a step whose damping is taken at its end."""
    if body.integrator == "EXPLICIT":
        return now.acceleration
    D = _damping(chain, body, s, z)
    M = now.M + s.h * (jnp.diag(D) if D.ndim == 1 else D)
    return dot(inverse(M), dot(now.M, now.acceleration))


def _damping(chain: Chain, body: Any, s: Signals, z: tuple) -> Array:
    """By how much the joints are braked more where they are faster: [nq], or [nq nq] where one
    brakes another.
    """
    of_drives = body.integrator != "EULER"
    load = _load(chain, body, s, z)
    fixed = chain.commanded(s, z)[0]

    def braked(qd: Vector) -> Vector:
        now = s._replace(qd=qd, qd0=qd)
        u = chain.commanded(now, z)[0] if of_drives else fixed
        smooth = chain.friction(now._replace(load=load), z)[0]
        return smooth - body.drive(chain.signature, u, s.q, qd)

    if body.integrator == "IMPLICIT":
        return jax.jacfwd(lambda qd: braked(qd) + body.matrices(s.q, qd)[1])(s.qd)
    if any(e.couples for e in chain.effects):
        return jax.jacfwd(braked)(s.qd)
    return jax.jvp(braked, (s.qd,), (jnp.ones_like(s.qd),))[1]


def _runge_kutta(
    chain: Chain, body: Any, s: Signals, z: tuple, now: _Forces
) -> tuple[Vector, Vector]:
    """Changes of positions and speeds over a step."""
    h, zero = s.h, jnp.zeros_like(s.q)

    def stage(carry, c):
        v, a, moved, change = carry
        share, weight = c
        q_here, v_here = s.q + share * h * v, s.qd + share * h * a
        here = s._replace(q=q_here, qd=v_here, qd0=v_here, q0=q_here)
        a_here = _forces(chain, body, here, z, now.acceleration).acceleration
        return (v_here, a_here, moved + weight * v_here, change + weight * a_here), None

    (_, _, moved, change), _ = jax.lax.scan(stage, (zero, zero, zero, zero), jnp.array(STAGES))
    return h * moved, h * change
