"""One joint without gravity: a drive, a slide, a spindle. Rotary (`tau` -> `q`) or linear (`force`
-> `position`).
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import param
from jaxid.models.effects import ConstantTorque, CoulombFriction, ViscousFriction


class Joint(Rigid):
    """inertia qdd = u - friction - offset."""

    name: ClassVar[str] = "joint"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("tau", "N m"),), (("q", "rad"),), ("q",)),
        Signature((("force", "N"),), (("position", "m"),), ("position",), linear=True),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
        (ConstantTorque, {"torque": "offset"}),
    )
    equations: ClassVar[str] = "inertia qdd + viscous qd + coulomb sign(qd) + offset = u"
    source: ClassVar[str] = (
        "Janot, Gautier, Brunot, Data Set and Reference Models of EMPS, 2019 (sign conventions)"
    )

    inertia: Array = param(0.1, 1e-7, 1e5, unit="{I}", meaning="moving inertia or mass", log=True)

    def outline(self, x, signature):
        q = x[0][0]
        if signature.linear:
            return jnp.stack([jnp.stack([q - 0.05, 0 * q]), jnp.stack([q + 0.05, 0 * q])])
        return jnp.stack([jnp.zeros(2), jnp.stack([jnp.cos(q), jnp.sin(q)])])

    def matrices(self, q, qd):
        return self.inertia[None, None], jnp.zeros_like(q)
