"""A driven or free pendulum; q = 0 hangs down."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.compliance import turned
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import param
from jaxid.models.effects import ConstantTorque, CoulombFriction, ViscousFriction
from jaxid.numerics.fast_math import sin


class Pendulum(Rigid):
    """inertia qdd + gravity_torque sin q = u - friction - offset."""

    name: ClassVar[str] = "pendulum"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("tau", "N m"),), (("q", "rad"),), ("q",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
        (ConstantTorque, {"torque": "offset"}),
    )
    equations: ClassVar[str] = (
        "inertia qdd + gravity_torque sin(q) + viscous qd + coulomb sign(qd) + offset = tau"
    )
    source: ClassVar[str] = "textbook"

    inertia: Array = param(
        0.08, 1e-6, 1e4, unit="kg m^2", meaning="inertia about the pivot", log=True
    )
    gravity_torque: Array = param(
        1.5, 0.0, 1e5, unit="N m", meaning="m g l: gravity torque at q = 90 deg", scale=0.1
    )

    def outline(self, x, signature):
        q = x[0][0]
        return jnp.stack([jnp.zeros(2), jnp.stack([jnp.sin(q), -jnp.cos(q)])])

    def matrices(self, q, qd):
        return self.inertia[None, None], self.gravity_torque * sin(q)

    def tilted(self, angle):
        """On a base turned by `angle` [1] about the pivot."""
        return turned(self, angle)
