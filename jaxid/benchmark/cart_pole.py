"""A cart on a rail with a hanging pole, as a user of jaxid would write it: an own model."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.mechanism import Lagrangian, Signature
from jaxid.dynamics.parameter import constant, param
from jaxid.models.effects import CoulombFriction, ViscousFriction


OF_EACH_JOINT = (
    (ViscousFriction, {"coefficient": "viscous_{joint}"}),
    (CoulombFriction, {"level": "coulomb_{joint}"}),
)


class CartPole(Lagrangian):
    """A cart on a rail, driven by a motor's volts through a pinion; a pole hangs from it (theta = 0
    hangs down).
    """

    name: ClassVar[str] = "cart_pole"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("u", "V"),), (("x", "m"), ("theta", "rad")), ("x", "theta")),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = OF_EACH_JOINT
    equations: ClassVar[str] = "Lagrange's, with force = gear k / (R r) (u - gear k v / r)"
    source: ClassVar[str] = "textbook"
    cart: Array = param(1.5, 0.05, 20.0, unit="kg", log=True)
    J: Array = param(0.02, 1e-3, 1.0, unit="kg m^2", log=True)
    moment: Array = constant(0.23 * 0.33, unit="kg m")
    pole: Array = constant(0.23, unit="kg")
    k: Array = constant(0.00767, unit="N m/A")
    R: Array = constant(2.6, unit="ohm")
    gear: Array = constant(3.71, unit="1")
    r: Array = constant(0.00635, unit="m")

    def drive(self, signature, u, q, qd):
        ratio = self.gear / self.r
        return jnp.stack([ratio * self.k / self.R * (u[0] - ratio * self.k * qd[0]), 0.0 * u[0]])

    def kinetic_energy(self, q, qd):
        moving = (self.cart + self.pole) * qd[0] ** 2 + self.J * qd[1] ** 2
        return moving / 2 + self.moment * jnp.cos(q[1]) * qd[0] * qd[1]

    def potential_energy(self, q):
        return -self.moment * 9.81 * jnp.cos(q[1])
