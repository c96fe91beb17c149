"""Two links in a vertical plane; q = 0 hangs down, q2 is relative to the first link."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.compliance import turned
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import constant, param, with_fields
from jaxid.models.effects import CoulombFriction, ViscousFriction
from jaxid.numerics.fast_math import sincos


class PlanarArm(Rigid):
    """Masses m, distances c from the joint to the centre of mass along the link, inertias I about
    the centre of mass.
    """

    name: ClassVar[str] = "planar_arm"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("tau1", "N m"), ("tau2", "N m")), (("q1", "rad"), ("q2", "rad")), ("q1", "q2")),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
    )
    equations: ClassVar[str] = (
        "M(q) qdd + C(q, qd) qd + g(q) + viscous qd + coulomb sign(qd) = tau, with k = m2 l1"
        " c2:\nM11 = I1 + m1 c1^2 + m2 l1^2 + M22 + 2 k cos q2, M12 = M22 + k cos q2, M22 = I2 + m2"
        " c2^2\ng1 = gravity ((m1 c1 + m2 l1) sin q1 + m2 c2 sin(q1 + q2)), g2 = gravity m2 c2"
        " sin(q1 + q2)"
    )
    source: ClassVar[str] = "textbook"

    m1: Array = param(4.0, 0.01, 100.0, unit="kg", meaning="mass of link 1", log=True)
    m2: Array = param(2.5, 0.01, 100.0, unit="kg", meaning="mass of link 2", log=True)
    c1: Array = param(0.25, 0.005, 2.0, unit="m", meaning="centre of mass of link 1", log=True)
    c2: Array = param(0.2, 0.005, 2.0, unit="m", meaning="centre of mass of link 2", log=True)
    I1: Array = param(0.12, 1e-4, 10.0, unit="kg m^2", meaning="inertia of link 1", log=True)
    I2: Array = param(0.05, 1e-4, 10.0, unit="kg m^2", meaning="inertia of link 2", log=True)
    l1: Array = constant(0.5, unit="m", meaning="length of link 1")
    l2: Array = constant(0.4, unit="m", meaning="length of link 2")
    gravity: Array = constant(9.81, unit="m/s^2")

    def outline(self, x, signature):
        a = jnp.cumsum(x[0])
        links = jnp.stack([self.l1, self.l2])[:, None] * jnp.stack([jnp.sin(a), -jnp.cos(a)], 1)
        return jnp.concatenate([jnp.zeros((1, 2)), jnp.cumsum(links, 0)])

    def matrices(self, q, qd):
        k = self.m2 * self.l1 * self.c2
        (s1, s2), (c1, c2) = sincos(q)
        s12 = s1 * c2 + c1 * s2
        M22 = self.I2 + self.m2 * self.c2**2
        M12 = M22 + k * c2
        M11 = self.I1 + self.m1 * self.c1**2 + self.m2 * self.l1**2 + M22 + 2 * k * c2
        g2 = self.gravity * self.m2 * self.c2 * s12
        g1 = self.gravity * (self.m1 * self.c1 + self.m2 * self.l1) * s1 + g2
        M = jnp.stack([jnp.stack([M11, M12]), jnp.stack([M12, M22])])
        bias = jnp.stack(
            [-k * s2 * (2 * qd[0] * qd[1] + qd[1] ** 2) + g1, k * s2 * qd[0] ** 2 + g2]
        )
        return M, bias

    def loaded(self, mass):
        """With a point mass [2] at the far end of each link."""
        held = {}
        for k, m, c, I, p, l in (
            (1, self.m1, self.c1, self.I1, mass[0], self.l1),
            (2, self.m2, self.c2, self.I2, mass[1], self.l2),
        ):
            share = p / (m + p)
            held |= {
                f"m{k}": m + p,
                f"c{k}": c + share * (l - c),
                f"I{k}": I + share * m * (l - c) ** 2,
            }
        return with_fields(self, held)

    def tilted(self, angle):
        """On a base turned by angle[0] about the first joint's axis."""
        return turned(self, jnp.asarray(angle).at[1:].set(0.0))
