"""What changes a mechanism at its joints: more inertia, other zeros, and a motor behind a spring
with play.

Inertia and motor need nothing of the mechanism but its answers at the port (`free`, `close`).
"""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxid.dynamics.mechanism import Free, Mechanism, Rigid
from jaxid.numerics.fast_math import dot, inverse


Vector = Float[Array, " nq"]

#: Damping ratio of the contact in a play, and the share of the play by which the contact has to be
#: pressed to damp fully.
CONTACT_DAMPING, CONTACT_DEPTH = 0.5, 0.05


def with_inertia(mechanism: Mechanism, inertia: Vector) -> Mechanism:
    """The mechanism with more (or less) inertia at its joints, [nq]: on the diagonal of the mass
    matrix.
    """
    own_step = type(mechanism).free is not Rigid.free or type(mechanism).close is not Rigid.close
    if isinstance(mechanism, Rigid) and not own_step:
        return Adjusted(mechanism, inertia, jnp.zeros_like(inertia))
    return WithInertia(mechanism, inertia)


def turned(mechanism: Rigid, angle: Vector) -> Mechanism:
    """The mechanism with the zeros of its joints moved: at q it is what it was at q + angle."""
    return Adjusted(mechanism, jnp.zeros_like(angle), angle)


def joint_inertia(mechanism: Mechanism) -> Vector:
    """Inertia that each drive sees at q = 0 with the other joints free, [nq]."""
    still = jnp.zeros(len(mechanism_of(mechanism).signatures[0].joints))
    M = jax.vmap(
        lambda a: mechanism.inverse(still, still, a) - mechanism.inverse(still, still, still)
    )(jnp.eye(still.size))
    return 1 / jnp.diagonal(inverse(M))


class Adjusted(Rigid):
    """M(q + angle) + diag(inertia), bias(q + angle, qd)."""

    name: ClassVar[str] = "adjusted"
    signatures: ClassVar[tuple] = ()
    builtin: ClassVar[tuple] = ()
    equations: ClassVar[str] = "(M(q + angle) + diag(inertia)) qdd + bias(q + angle, qd) = tau"
    source: ClassVar[str] = "textbook"

    inner: Rigid
    inertia: Vector
    angle: Vector

    def prepare(self, h):
        return dataclasses.replace(self, inner=self.inner.prepare(h))

    def drive(self, signature, u, q, qd):
        return self.inner.drive(signature, u, q, qd)

    def output(self, x, tau, rests):
        return self.inner.output(x, tau, rests)

    def rotors(self):
        return self.inner.rotors() + self.inertia

    def matrices(self, q, qd):
        M, bias = self.inner.matrices(q + self.angle, qd)
        return M + jnp.diag(self.inertia), bias


class WithInertia(Mechanism):
    """The same for any mechanism, by its compliance alone: (1 + A inertia / h) w = w_free + A
    inertia v / h.

    The torque of the last step predicts, so that the step stays second order.
    """

    name: ClassVar[str] = "with_inertia"
    signatures: ClassVar[tuple] = ()
    builtin: ClassVar[tuple] = ()
    equations: ClassVar[str] = "tau -> tau - inertia qdd"
    source: ClassVar[str] = "textbook"
    hidden_states: ClassVar[bool] = True

    inner: Mechanism
    inertia: Vector

    def prepare(self, h):
        return dataclasses.replace(self, inner=self.inner.prepare(h))

    def drive(self, signature, u, q, qd):
        return self.inner.drive(signature, u, q, qd)

    def start(self, q, qd):
        return self.inner.start(q, qd), jnp.zeros_like(q)

    def follow(self, x, q, qd):
        return self.inner.follow(x[0], q, qd), x[1]

    def port(self, x):
        return self.inner.port(x[0])

    def output(self, x, tau, rests):
        return self.inner.output(x[0], tau - self.inertia * x[1], rests)

    def inverse(self, q, qd, qdd):
        return self.inner.inverse(q, qd, qdd) + self.inertia * qdd

    def rotors(self):
        return self.inner.rotors() + self.inertia

    def vector_field(self, t, x, tau):
        def rate(tau):
            return jax.jvp(self.inner.port, (x[0],), (self.inner.vector_field(t, x[0], tau),))[1][1]

        a0 = rate(tau)
        compliance = jax.jacfwd(rate)(tau)
        a = dot(inverse(jnp.eye(tau.size) + compliance * self.inertia), a0)
        return self.inner.vector_field(t, x[0], tau - self.inertia * a), jnp.zeros_like(x[1])

    def free(self, h, x, tau):
        inner, acc = x
        v = self.inner.port(inner)[1]
        f = self.inner.free(h, inner, tau - self.inertia * acc)
        B = inverse(jnp.eye(v.size) + f.A * self.inertia / h)
        none = jnp.all(self.inertia == 0)
        w = jnp.where(none, f.qd, dot(B, f.qd + dot(f.A, self.inertia * (v / h + acc))))
        return Free(w, jnp.where(none, f.A, dot(B, f.A)), (f, v))

    def close(self, h, x, free, dtau, qd, shift):
        f, v = free.aux
        acc = (qd - v) / h
        dtau = jnp.where(self.inertia == 0, dtau, dtau - self.inertia * (acc - x[1]))
        return self.inner.close(h, x[0], f, dtau, qd, shift), acc


class Compliant(Mechanism):
    """Motor | spring with damping and play | mechanism, at the joints whose `compliance` is
    positive.

    The port is the motor: drive, friction and the joint encoder act and read on its side, in units
    of the joint. The motor's inertia is a `share` of what the drive sees at q = 0 and is taken from
    the mechanism, so that compliance -> 0 is the rigid joint again. Spring torque: implicit
    midpoint, solved for all joints at once.
    """

    name: ClassVar[str] = "compliant"
    signatures: ClassVar[tuple] = ()
    builtin: ClassVar[tuple] = ()
    equations: ClassVar[str] = (
        "share J qdd_motor = tau - t,  (M - share J) qdd_link + bias = t\nt = soft(gap, play / 2) /"
        " compliance + damping d(gap)/dt,  gap = q_motor - q_link; no pull across a play"
    )
    source: ClassVar[str] = "Spong, ASME J. Dyn. Syst. 109(4), 1987 (the elastic joint)"
    hidden_states: ClassVar[bool] = True

    base: Mechanism
    share: Vector
    compliance: Vector
    damping_ratio: Vector
    play: Vector
    inner: Mechanism
    motor: Vector

    def __init__(
        self,
        base: Mechanism,
        share: Vector,
        compliance: Vector,
        damping_ratio: Vector,
        play: Vector,
    ):
        self.base, self.share, self.compliance, self.damping_ratio, self.play = (
            base,
            share,
            compliance,
            damping_ratio,
            play,
        )
        motor = jnp.where(compliance > 0, share * joint_inertia(base), 0.0)
        self.inner = with_inertia(base, -motor)
        self.motor = jnp.where(compliance > 0, motor, 1.0)

    @property
    def present(self) -> Bool[Array, " nq"]:
        return self.compliance > 0

    def rotors(self):
        return jnp.where(self.present, self.motor, self.base.rotors())

    def _spring(self) -> tuple[Vector, Vector]:
        """Stiffness, and damping of the fully pressed spring."""
        k = 1 / jnp.where(self.present, self.compliance, 1.0)
        ratio = jnp.where(self.play > 0, CONTACT_DAMPING, self.damping_ratio)
        return k, 2 * ratio * jnp.sqrt(k * self.motor * (1 - self.share))

    def _pressed(self, gap: Vector) -> tuple[Vector, Vector]:
        """How far the spring is pressed, and the share of its damping that acts: in a play both
        begin at contact.
        """
        pressed = gap - jnp.clip(gap, -self.play / 2, self.play / 2)
        depth = CONTACT_DEPTH * jnp.where(self.play > 0, self.play, 1.0)
        return pressed, jnp.where(self.play > 0, jnp.clip(jnp.abs(pressed) / depth, 0.0, 1.0), 1.0)

    def prepare(self, h):
        return eqx.tree_at(lambda m: m.inner, self, self.inner.prepare(h))

    def drive(self, signature, u, q, qd):
        return self.base.drive(signature, u, q, qd)

    def start(self, q, qd):
        """At rest under its own weight: the spring holds what the link needs to stand still."""
        link = q
        still = jnp.zeros_like(q)
        for _ in range(3):
            t = self.base.inverse(link, still, still)
            link = q - jnp.where(
                self.present, self.compliance * t + jnp.sign(t) * self.play / 2, 0.0
            )
        return (
            self.inner.start(link, qd),
            q,
            qd,
            jnp.where(self.present, self.base.inverse(link, still, still), 0.0),
        )

    def follow(self, x, q, qd):
        """The motors turn with the measured motion; links behind a spring stay where they are."""
        link, dlink = self.inner.port(x[0])

        def there(motor, link):
            return jnp.where(self.present, link, motor)

        return self.inner.follow(x[0], there(q, link), there(qd, dlink)), q, qd, x[3]

    def port(self, x):
        return x[1], x[2]

    def output(self, x, tau, rests):
        inner, q, _, t = x
        y = self.inner.output(inner, jnp.where(self.present, t, tau), rests & ~self.present)
        signature = mechanism_of(self.base).signatures[0]
        names, joints = signature.output_names, signature.joints
        for column, name in enumerate(names):
            if name in joints:  # the encoder sits at the motor
                j = joints.index(name)
                y = y.at[column].set(jnp.where(self.present[j], q[j], y[column]))
        return y

    def inverse(self, q, qd, qdd):
        """Torque of the same motion with a rigid joint (the link's motion is no function of the
        motor's).
        """
        return self.base.inverse(q, qd, qdd)

    def vector_field(self, t, x, tau):
        inner, q, v, _ = x
        link, dlink = self.inner.port(inner)
        k, d = self._spring()
        pressed, damped = self._pressed(q - link)
        torque = k * pressed + d * damped * (v - dlink)
        torque = jnp.where((self.play > 0) & (torque * pressed <= 0), 0.0, torque)
        rate = self.inner.vector_field(t, inner, jnp.where(self.present, torque, tau))
        a = jax.jvp(self.inner.port, (inner,), (rate,))[1][1]
        return rate, v, jnp.where(self.present, (tau - torque) / self.motor, a), jnp.zeros_like(v)

    def free(self, h, x, tau):
        inner, q, v, t0 = x
        on = self.present
        link, dlink = self.inner.port(inner)
        k, d = self._spring()
        f = self.inner.free(h, inner, jnp.where(on, t0, tau))
        m = jnp.where(on, h / self.motor, 0.0)
        # Middle gap and its rate without any spring torque; with that of the last step, for what
        # damps.
        w = f.qd - dot(f.A, t0)
        gap, rate = (
            q - link + h / 4 * (v - dlink + v + m * tau - w),
            (v - dlink + v + m * tau - w) / 2,
        )
        _, damped = self._pressed(q - link + h / 4 * (v - dlink + v + m * (tau - t0) - f.qd))
        pressed, _ = self._pressed(gap)
        response = jnp.diag(m) + jnp.where(on[:, None] & on[None, :], f.A, 0.0)

        def solve(acts: Array) -> tuple[Array, Array, Array]:
            K, D = jnp.where(acts, k, 0.0), jnp.where(acts, d * damped, 0.0)
            stiff = K * h / 4 + D / 2
            P = inverse(jnp.eye(q.size) + stiff[:, None] * response)
            return dot(P, K * pressed + D * rate), P, stiff

        acts = on & ((self.play == 0) | (pressed != 0))
        t, P, stiff = solve(acts)
        holds = acts & ((self.play == 0) | (t * pressed > 0))  # no pull across a play
        if q.size > 1:
            t, P, stiff = solve(holds)
        t = jnp.where(holds, t, 0.0)
        rigid = jnp.where(on, 0.0, 1.0)
        T = jnp.where(
            holds[:, None], dot(P, stiff[:, None] * (jnp.diag(m) - f.A * rigid)), 0.0
        )  # d t / d tau
        w = f.qd + dot(f.A, jnp.where(on, t - t0, 0.0))
        A = jnp.where(
            on[:, None], m[:, None] * (jnp.diag(1 - rigid) - T), dot(f.A, T + jnp.diag(rigid))
        )
        none = ~jnp.any(on)
        qd = jnp.where(on, v + m * (tau - t), jnp.where(none, f.qd, w))
        return Free(qd, jnp.where(none, f.A, A), (f, t, T))

    def close(self, h, x, free, dtau, qd, shift):
        inner, q, v, t0 = x
        on = self.present
        f, t, T = free.aux
        t = t + dot(T, dtau)
        change = jnp.where(on, t - t0, dtau)
        w = jnp.where(on, f.qd + dot(f.A, change), qd)
        inner = self.inner.close(h, inner, f, change, w, jnp.where(on, 0.0, shift))
        q1 = jnp.where(on, q + h / 2 * (v + qd) + shift, self.inner.port(inner)[0])
        return inner, q1, qd, jnp.where(on, t, 0.0)


def compliant(mechanism: Mechanism) -> Compliant:
    """The mechanism as one whose joints can be given a spring or play; the same one where it has
    them already.
    """
    if isinstance(mechanism, Compliant):
        return mechanism
    none = jnp.zeros(len(mechanism_of(mechanism).signatures[0].joints))
    return Compliant(mechanism, none + 0.5, none, none, none)


def mechanism_of(mechanism: Mechanism) -> Mechanism:
    """What was wrapped."""
    wrapped: Any = mechanism
    while isinstance(wrapped, Adjusted | WithInertia | Compliant):
        wrapped = wrapped.base if isinstance(wrapped, Compliant) else wrapped.inner
    return wrapped
