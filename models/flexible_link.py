"""One flexible link on a motor hub: finite elements in clamped modes, stepped exactly."""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from jaxid.beam import Beam, decay, matrices, Modes, modes
from jaxid.mechanism import Free, Mechanism, Signature
from jaxid.models.effects import CoulombFriction, ViscousFriction
from jaxid.parameter import constant, param, setting, with_fields


class FlexibleLink(Mechanism):
    """Hub angle phi and elastic deflection psi across the hub-fixed axis, clamped at the hub; no gravity.

    The state holds phi, its velocity, and modal deflections and velocities of the beam. A step takes each mode by its exact
    exponential under the hub acceleration of that step and closes the hub's momentum balance, so that stiff modes cost
    nothing; friction at the hub sticks truly (`jaxid.joint`).
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
        "M qdd + h + C qd + K q + (v phid + tau_c sign phid) e1 = tau e1,  q = (phi, u1, theta1, ... un, thetan)\n"
        "C = diag(0, alpha M_psi + beta K_psi);  h = 0, or with nonlinear = true\n"
        "h_phi = 2 phid psi' M_psi psid,  h_psi = -phid^2 (M_psi - K_G) psi,  K_G times stiffening\n"
        "tip_acceleration = L phidd + undd (and - un phid^2 with rotating_sensor = true)"
    )
    source: ClassVar[str] = "paper 002, Machines 12(6), 409, 2024: equations (3) to (6), Table 1 for the bounds"
    hidden_states: ClassVar[bool] = True

    E: Array = param(5e10, 20e9, 100e9, unit="Pa", meaning="elastic modulus", log=True)
    I_m: Array = param(0.006, 1e-3, 0.2, unit="kg m^2", meaning="inertia of hub and rotor", log=True)
    alpha: Array = param(1.0, 1e-3, 4.0, unit="1/s", meaning="damping in proportion to mass", log=True)
    beta: Array = param(5e-5, 1e-7, 2e-4, unit="s", meaning="damping in proportion to stiffness", log=True)
    L: Array = constant(0.197, unit="m", meaning="length of the link")
    h: Array = constant(0.001, unit="m", meaning="thickness in the direction of bending")
    b: Array = constant(0.0266, unit="m", meaning="width")
    rho: Array = constant(6404.3, unit="kg/m^3", meaning="density")
    m_p: Array = constant(0.09466, unit="kg", meaning="payload at the tip")
    J_p: Array = constant(0.0, unit="kg m^2", meaning="rotary inertia of the payload")
    stiffening: Array = constant(0.0, unit="1", meaning="share of the centrifugal tension's stiffening that counts (nonlinear)")
    n_elements: int = setting(4, 1, 32, meaning="finite elements")
    n_modes: int = setting(0, 0, 64, meaning="elastic modes kept; 0: all")
    nonlinear: bool = setting(False, meaning="centrifugal and Coriolis terms of the deflection")
    rotating_sensor: bool = setting(False, meaning="the tip accelerometer also senses the deflection's rotation")

    prepared: Any = eqx.field(default=None, repr=False)  # modes, and with a step length their exponentials

    def beam(self) -> Beam:
        area = self.b * self.h
        return Beam(self.L, self.E * self.b * self.h**3 / 12, self.rho * area, self.m_p, self.J_p)

    def prepare(self, h):
        m = matrices(self.beam(), self.n_elements)
        kept = modes(m, min(self.n_modes or 2 * self.n_elements, 2 * self.n_elements))
        damping = self.alpha + self.beta * kept.squares
        inertia = self.I_m + m.inertia
        exact = None if h is None else decay(kept.squares, damping, h)
        return eqx.tree_at(lambda s: s.prepared, self, (kept, damping, inertia, exact), is_leaf=lambda x: x is None)

    def _parts(self) -> tuple[Modes, Array, Array, Any]:
        return self.prepared if self.prepared is not None else self.prepare(None).prepared

    def _rotation(self, e: Array) -> Array:
        """S eta, with S = I - stiffening K_G between modes: the part of a deflection that turns with the hub."""
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

    def port(self, x):
        return x[0], x[1]

    def pull(self, w: Array, e: Array, z: Array) -> Array:
        """Modal forces of stiffness, damping and, with the nonlinear terms, of the hub's rotation at speed w [1]."""
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
            inertia, tau = inertia + jnp.dot(e, turned), tau - 2 * w * jnp.dot(turned, z)
        phidd = (tau - jnp.dot(kept.participation, pull)) / (inertia - jnp.dot(kept.participation, kept.participation))
        return phidd, pull - kept.participation * phidd

    def vector_field(self, t, x, tau):
        phidd, edd = self.acceleration(x, tau)
        return x[1], phidd, x[3], edd

    def free(self, h, x, tau):
        kept, damping, inertia, exact = self._parts()
        exact = decay(kept.squares, damping, h) if exact is None else exact
        _, w, e, z = x
        push, bend = exact.b, (1 - exact.a) / kept.squares  # answer of velocity and deflection to a held modal force

        def homogeneous(force):
            return exact.a * e + exact.b * z + bend * force, exact.d * z - kept.squares * exact.b * e + push * force

        G = kept.participation

        def hub(force, momentum, moving):
            """Change of the hub's speed: moving w' + G z' = momentum + G z + h tau, where z' = z1 - push G (w' - w) / h."""
            e1, z1 = homogeneous(force)
            effective = moving - jnp.dot(G * G, push) / h
            return (momentum - moving * w - jnp.dot(G, z1 - z) + h * tau) / effective, effective, e1, z1

        force, momentum, moving = jnp.zeros_like(e), inertia * w, inertia
        if self.nonlinear:
            # The deflection's rotation as a force held at its middle value; the hub's inertia at both ends. Values from a
            # first pass with those of the beginning.
            turned = self._rotation(e)
            moving = inertia + jnp.dot(e, turned)
            momentum = moving * w
            change, _, e1, _ = hub(w * w * turned, momentum - 2 * h * w * jnp.dot(turned, z), moving)
            e1 = e1 - bend * G * change / h
            force = (w + change / 2) ** 2 * self._rotation((e + e1) / 2)
            moving = inertia + jnp.dot(e1, self._rotation(e1))
        change, effective, e1, z1 = hub(force, momentum, moving)
        return Free(w + change, (h / effective)[None, None], (e1, z1, bend * G / h, push * G / h))

    def close(self, h, x, free, dtau, qd, shift):
        e, z, bend, push = free.aux
        change = qd - x[1]
        return x[0] + h / 2 * (x[1] + qd) + shift, qd, e - bend * change, z - push * change

    def transfer(self, omega, slope, stiffness):
        """Sum over the clamped modes, in real arithmetic: eta / phi = omega^2 G / (squares - omega^2 + i omega damping)."""
        kept, damping, inertia, _ = self._parts()
        w2 = omega**2
        jr, ji, tr, ti = inertia, 0.0, self.L, 0.0  # inertia seen at the hub, and tip deflection per hub angle
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
        """Torque of the link moved as a rigid body (the deflection is no function of the hub's motion)."""
        return self._parts()[2] * qdd

    def output(self, x, tau, rests):
        kept = self._parts()[0]
        _, w, e, z = x
        phidd, edd = self.acceleration(x, tau)
        phidd, edd = jnp.where(rests, 0.0, phidd), jnp.where(rests, self.pull(w, e, z), edd)
        tip = self.L * phidd + jnp.dot(kept.tip, edd)
        if self.rotating_sensor:
            tip = tip - jnp.dot(kept.tip, e) * w * w
        return jnp.concatenate([x[0], tip])
