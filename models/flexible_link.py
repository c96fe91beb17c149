"""One flexible link on a motor hub: finite elements in clamped modes, stepped exactly."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.dynamics.beam import Beam, decay, matrices, Modes, modes
from jaxid.dynamics.mechanism import Free, Mechanism, Signature
from jaxid.dynamics.parameter import constant, param, setting, with_fields
from jaxid.models.effects import CoulombFriction, ViscousFriction


class ModalStep(NamedTuple):
    """A step of length h of the clamped modes: e' = a e + b z, z' = d z - c e; what a change of the
    hub's speed takes off both; the inertia that the modes bear in the meantime, and how far the hub
    gives way to an impulse.
    """

    a: Float[Array, " modes"]
    b: Float[Array, " modes"]
    c: Float[Array, " modes"]
    d: Float[Array, " modes"]
    bent: Float[Array, " modes"]
    pushed: Float[Array, " modes"]
    borne: Float[Array, ""]
    compliance: Float[Array, ""]

    @classmethod
    def of(cls, kept: Modes, damping: Array, inertia: Array, h: Any) -> ModalStep:
        exact, G = decay(kept.squares, damping, h), kept.participation
        bent, pushed = (1 - exact.a) / kept.squares * G / h, exact.b * G / h
        borne = jnp.sum(G * pushed)
        return cls(
            exact.a,
            exact.b,
            kept.squares * exact.b,
            exact.d,
            bent,
            pushed,
            borne,
            1 / (inertia - borne),
        )


class FlexibleLink(Mechanism):
    """Hub angle phi and elastic deflection psi across the hub-fixed axis, clamped at the hub; no
    gravity.

    The state holds phi, its velocity, and modal deflections and velocities of the beam. A step
    takes each mode by its exact exponential under the hub acceleration of that step and closes the
    hub's momentum balance, so that stiff modes cost nothing; friction at the hub sticks truly
    (`jaxid.dynamics.dry_friction`).
    """

    name: ClassVar[str] = "flexible_link"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("tau", "N m"),), (("phi", "rad"), ("tip_acceleration", "m/s^2")), ("phi",)),
        Signature((("tau", "N m"),), (("phi", "rad"),), ("phi",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "v"}),
        (CoulombFriction, {"level": "tau_c"}),
    )
    equations: ClassVar[str] = (
        "M qdd + h + C qd + K q + (v phid + tau_c sign phid) e1 = tau e1,  q = (phi, u1, theta1,"
        " ... un, thetan)\nC = diag(0, alpha M_psi + beta K_psi);  h = 0, or with nonlinear ="
        " true\nh_phi = 2 phid psi' M_psi psid,  h_psi = -phid^2 (M_psi - K_G) psi,  K_G times"
        " stiffening\ntip_acceleration = L phidd + undd (and - un phid^2 with rotating_sensor ="
        " true)"
    )
    source: ClassVar[str] = (
        "paper 002, Machines 12(6), 409, 2024: equations (3) to (6), Table 1 for the bounds"
    )
    hidden_states: ClassVar[bool] = True

    E: Array = param(5e10, 20e9, 100e9, unit="Pa", meaning="elastic modulus", log=True)
    I_m: Array = param(
        0.006, 1e-3, 0.2, unit="kg m^2", meaning="inertia of hub and rotor", log=True
    )
    alpha: Array = param(
        1.0, 1e-3, 4.0, unit="1/s", meaning="damping in proportion to mass", log=True
    )
    beta: Array = param(
        5e-5, 1e-7, 2e-4, unit="s", meaning="damping in proportion to stiffness", log=True
    )
    L: Array = constant(0.197, unit="m", meaning="length of the link")
    h: Array = constant(0.001, unit="m", meaning="thickness in the direction of bending")
    b: Array = constant(0.0266, unit="m", meaning="width")
    rho: Array = constant(6404.3, unit="kg/m^3", meaning="density")
    m_p: Array = constant(0.09466, unit="kg", meaning="payload at the tip")
    J_p: Array = constant(0.0, unit="kg m^2", meaning="rotary inertia of the payload")
    stiffening: Array = constant(
        0.0,
        unit="1",
        meaning="share of the centrifugal tension's stiffening that counts (nonlinear)",
    )
    n_elements: int = setting(4, 1, 32, meaning="finite elements")
    n_modes: int = setting(0, 0, 64, meaning="elastic modes kept; 0: all")
    nonlinear: bool = setting(False, meaning="centrifugal and Coriolis terms of the deflection")
    rotating_sensor: bool = setting(
        False, meaning="the tip accelerometer also senses the deflection's rotation"
    )

    prepared: Any = eqx.field(
        default=None, repr=False
    )  # modes, and with a step length their exponentials

    def beam(self) -> Beam:
        area = self.b * self.h
        return Beam(self.L, self.E * self.b * self.h**3 / 12, self.rho * area, self.m_p, self.J_p)

    def prepare(self, h):
        beam = self.beam()
        m = matrices(
            beam._replace(stiffness=1.0), self.n_elements
        )  # a stiffer beam has the same shapes
        kept = modes(m, min(self.n_modes or 2 * self.n_elements, 2 * self.n_elements))
        kept = kept._replace(squares=beam.stiffness * kept.squares)
        damping = self.alpha + self.beta * kept.squares
        inertia = self.I_m + m.inertia
        exact = None if h is None else ModalStep.of(kept, damping, inertia, h)
        return eqx.tree_at(
            lambda s: s.prepared, self, (kept, damping, inertia, exact), is_leaf=lambda x: x is None
        )

    def _parts(self) -> tuple[Modes, Array, Array, Any]:
        return self.prepared if self.prepared is not None else self.prepare(None).prepared

    def _rotation(self, e: Array) -> Array:
        """S eta, with S = I - stiffening K_G between modes: the part of a deflection that turns
        with the hub.
        """
        return e - self.stiffening * (self._parts()[0].geometric @ e)

    def stiffened(self, share: Array) -> FlexibleLink:
        """The same with more (share [1]) of the geometric stiffening."""
        return with_fields(self, {"stiffening": self.stiffening + share[0]})

    def loaded(self, mass: Array) -> FlexibleLink:
        """The same with mass [1] more at the tip."""
        return with_fields(self, {"m_p": self.m_p + mass[0]})

    def start(self, q, qd):
        still = jnp.zeros(self._parts()[0].squares.shape)
        return q, qd, still, still

    def follow(self, x, q, qd):
        return q, qd, *x[2:]

    def port(self, x):
        return x[0], x[1]

    def pull(self, w: Array, e: Array, z: Array) -> Array:
        """Modal forces of stiffness, damping and, with the nonlinear terms, of the hub's rotation
        at speed w [1].
        """
        kept, damping, _, _ = self._parts()
        force = -kept.squares * e - damping * z
        return force + w * w * self._rotation(e) if self.nonlinear else force

    def acceleration(self, x: Any, tau: Array) -> tuple[Array, Array]:
        """(phidd [1], modal accelerations) under hub torque tau [1]."""
        kept, _, inertia, _ = self._parts()
        _, w, e, z = x
        pull = self.pull(w, e, z)
        if self.nonlinear:
            turned = self._rotation(e)
            inertia, tau = inertia + jnp.sum(e * turned), tau - 2 * w * jnp.sum(turned * z)
        phidd = (tau - jnp.sum(kept.participation * pull)) / (
            inertia - jnp.sum(kept.participation * kept.participation)
        )
        return phidd, pull - kept.participation * phidd

    def vector_field(self, t, x, tau):
        phidd, edd = self.acceleration(x, tau)
        return x[1], phidd, x[3], edd

    def free(self, h, x, tau):
        kept, damping, inertia, step = self._parts()
        step = ModalStep.of(kept, damping, inertia, h) if step is None else step
        G = kept.participation
        _, w, e, z = x
        e1, z1 = step.a * e + step.b * z, step.d * z - step.c * e
        # Momentum of hub and beam, moving w + G z, grows by h tau. A change of w moves the modes by
        # -bent and -pushed of it.
        if not self.nonlinear:
            compliance = step.compliance
            change = (h * tau - jnp.sum(G * (z1 - z))) * compliance
        else:
            # The deflection's rotation as a force held at its middle value; the hub's inertia at
            # both ends. Values from a first pass with those of the beginning.
            bend, push = (1 - step.a) / kept.squares, step.b
            turned = self._rotation(e)
            moving = inertia + jnp.sum(e * turned)
            momentum = moving * w

            def hub(force, momentum, moving):
                compliance = 1 / (moving - step.borne)
                gained = momentum - moving * w - jnp.sum(G * (z1 + push * force - z)) + h * tau
                return gained * compliance, compliance

            force = w * w * turned
            change, _ = hub(force, momentum - 2 * h * w * jnp.sum(turned * z), moving)
            after = e1 + bend * force - step.bent * change
            force = (w + change / 2) ** 2 * self._rotation((e + after) / 2)
            change, compliance = hub(
                force, momentum, inertia + jnp.sum(after * self._rotation(after))
            )
            e1, z1 = e1 + bend * force, z1 + push * force
        return Free(w + change, (h * compliance)[None, None], (e1, z1, step.bent, step.pushed))

    def close(self, h, x, free, dtau, qd, shift):
        e, z, bend, push = free.aux
        change = qd - x[1]
        return x[0] + h / 2 * (x[1] + qd) + shift, qd, e - bend * change, z - push * change

    def transfer(self, omega, slope, stiffness):
        """Sum over the clamped modes, in real arithmetic: eta / phi = omega^2 G / (squares -
        omega^2 + i omega damping).
        """
        kept, damping, inertia, _ = self._parts()
        w2 = omega**2
        jr, ji, tr, ti = (
            inertia,
            0.0,
            self.L,
            0.0,
        )  # inertia seen at the hub, and tip deflection per hub angle
        for k in range(kept.squares.shape[0]):
            a, b = kept.squares[k] - w2, omega * damping[k]
            scale = w2 * kept.participation[k] / (a * a + b * b)
            er, ei = scale * a, -scale * b
            jr, ji = jr + kept.participation[k] * er, ji + kept.participation[k] * ei
            tr, ti = tr + kept.tip[k] * er, ti + kept.tip[k] * ei
        # phi = 1 / (stiffness - w2 J + i omega slope);  tip acceleration = -w2 (L + tip) phi
        dr, di = stiffness[0] - w2 * jr, -w2 * ji + omega * slope[0]
        size = dr * dr + di * di
        pr, pi = dr / size, -di / size
        re = jnp.stack([pr, -w2 * (tr * pr - ti * pi)], 1)
        im = jnp.stack([pi, -w2 * (tr * pi + ti * pr)], 1)
        return re[..., None], im[..., None]

    def outline(self, x, signature):
        phi, _, e, _ = x
        along = jnp.linspace(0.0, 1.0, self.n_elements + 1) * self.L
        across = jnp.concatenate([jnp.zeros(1), (self._parts()[0].shapes @ e)[0::2]])
        c, s = jnp.cos(phi), jnp.sin(phi)
        return jnp.stack([c * along - s * across, s * along + c * across], 1)

    def inverse(self, q, qd, qdd):
        """Torque of the link moved as a rigid body (the deflection is no function of the hub's
        motion).
        """
        return self._parts()[2] * qdd

    def output(self, x, tau, rests):
        kept = self._parts()[0]
        _, w, e, z = x
        phidd, edd = self.acceleration(x, tau)
        phidd, edd = jnp.where(rests, 0.0, phidd), jnp.where(rests, self.pull(w, e, z), edd)
        tip = self.L * phidd + jnp.sum(kept.tip * edd)
        if self.rotating_sensor:
            tip = tip - jnp.sum(kept.tip * e) * w * w
        return jnp.concatenate([x[0], tip])
