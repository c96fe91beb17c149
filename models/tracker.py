"""Two-axis target tracker: a yawing base with a tilting barrel that points back over it."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.mechanism import Lagrangian, Signature
from jaxid.dynamics.parameter import constant, param, setting, with_fields
from jaxid.models.effects import ViscousFriction
from jaxid.numerics.fast_math import sincos


#: Measured torque of the gear motors (paper 003, Table 1): (V, N m), odd in V, and continued beyond
#: along its last secant.
MOTOR_TABLE = ((1.68, 0.0), (2.4, 0.0882), (3.6, 0.1176))


class Tracker(Lagrangian):
    """Base yaw theta, barrel tilt alpha from the horizontal; gravity acts on the tilt.

    The barrel, a uniform rod, starts at distance R from the yaw axis and points back over it; the
    camera is a point mass on it. As in the paper J_alpha stands in both the tilt inertia and the
    terms that couple it to the yaw; `rotor_alpha` is the part of it that only tilts (a motor's
    reflected rotor does not yaw with the tilt angle). Driven by torque, or by voltage through the
    motor's dead zone (equation 6, the default) or its measured table (`motor_table`), which
    contradict each other.
    """

    name: ClassVar[str] = "tracker"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature(
            (("tau_theta", "N m"), ("tau_alpha", "N m")),
            (("theta", "rad"), ("alpha", "rad")),
            ("theta", "alpha"),
        ),
        Signature(
            (("u_theta", "V"), ("u_alpha", "V")),
            (("theta", "rad"), ("alpha", "rad")),
            ("theta", "alpha"),
        ),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "b_{joint}"}),
    )
    equations: ClassVar[str] = (
        "with k = m l + 2 m_c u:\nT_theta = (J_theta + (m + m_c) R^2 - k R cos a + J cos^2 a)"
        " thetadd + s ad thetad + b_theta thetad\nT_alpha = J_alpha add - s thetad^2 / 2 + b_alpha"
        " ad + (m l / 2 + m_c u) gravity cos a,  s = (k R - 2 J cos a) sin a\na = alpha, J ="
        " J_alpha - rotor_alpha;  driven by voltage: T = gain (v - v0 sign v) for |v| >= v0, else 0"
    )
    source: ClassVar[str] = (
        "paper 003, equations (4) with its printed m + 2 m_c u corrected, (5), (6), Tables 1 and 2"
    )

    J_theta: Array = param(0.1, 0.005, 0.5, unit="kg m^2", meaning="yaw inertia", log=True)
    J_alpha: Array = param(0.05, 0.001, 0.5, unit="kg m^2", meaning="tilt inertia", log=True)
    m: Array = constant(0.043, unit="kg", meaning="mass of the barrel")
    m_c: Array = constant(0.103, unit="kg", meaning="mass of the camera")
    l: Array = constant(0.26, unit="m", meaning="length of the barrel")
    u: Array = constant(0.036, unit="m", meaning="camera's distance along the barrel")
    R: Array = constant(0.09, unit="m", meaning="distance of the tilt joint from the yaw axis")
    gravity: Array = constant(9.81, unit="m/s^2")
    rotor_alpha: Array = constant(0.0, unit="kg m^2", meaning="part of J_alpha that only tilts")
    gain: Array = constant(0.1, unit="N m/V", meaning="torque of the motors per volt")
    v0: Array = constant(1.68, unit="V", meaning="dead zone of the motors")
    motor_table: bool = setting(
        False, meaning="the measured torques of Table 1 instead of equation (6)"
    )

    def loaded(self, mass: Array) -> Tracker:
        """The same with mass [2] more: at the tilt joint, and at the end of the barrel."""
        total = self.m_c + mass[1]
        centre = self.u + mass[1] * (self.l - self.u) / jnp.where(total > 0, total, 1.0)
        more = {
            "J_theta": self.J_theta + mass[0] * self.R**2,
            "J_alpha": self.J_alpha + mass[1] * self.l**2,
        }
        return with_fields(self, {**more, "m_c": total, "u": centre})

    def outline(self, x, signature):
        theta, alpha = x[0]
        out = jnp.stack([jnp.cos(theta), jnp.sin(theta), 0 * theta])
        up = jnp.array([0.0, 0.0, 1.0])
        barrel = self.R * out + self.l * (jnp.sin(alpha) * up - jnp.cos(alpha) * out)
        return jnp.stack([-0.1 * up, jnp.zeros(3), self.R * out, barrel])

    def kinetic_energy(self, q, qd):
        _, c = sincos(q)
        k = self.m * self.l + 2 * self.m_c * self.u
        yaw = (
            self.J_theta
            + (self.m + self.m_c) * self.R**2
            - k * self.R * c[1]
            + (self.J_alpha - self.rotor_alpha) * c[1] ** 2
        )
        return (yaw * qd[0] ** 2 + self.J_alpha * qd[1] ** 2) / 2

    def potential_energy(self, q):
        return (self.m * self.l / 2 + self.m_c * self.u) * self.gravity * sincos(q)[0][1]

    def drive(self, signature, u, q, qd):
        if not signature.inputs:
            return jnp.zeros_like(q)
        if signature.inputs[0][1] != "V":
            return u
        size = jnp.abs(u)
        if not self.motor_table:
            return jnp.sign(u) * self.gain * jnp.maximum(size - self.v0, 0.0)
        torque, points = 0.0, ((0.0, 0.0), *MOTOR_TABLE)
        slope = 0.0
        for (v0, t0), (v1, t1) in zip(points[:-1], points[1:], strict=True):
            new = (t1 - t0) / (v1 - v0)
            torque, slope = torque + (new - slope) * jnp.maximum(size - v0, 0.0), new
        return jnp.sign(u) * torque
