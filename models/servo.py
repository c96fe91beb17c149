"""A position-controlled servo with a pendulum on its horn: what enters is the goal position, not a
torque.
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import constant, param, with_fields
from jaxid.models.effects import CoulombFriction, ViscousFriction
from jaxid.numerics.fast_math import sin


class Servo(Rigid):
    """Goal -> duty by the firmware's proportional gain -> voltage -> current, limited -> torque
    against back-EMF.

    Torque and back-EMF constants are apart, as they are found by a fit: `torque_constant` is the
    stall torque per volt (k_t / R), `back_emf` the torque lost per speed (k_t k_e / R). With the
    input `enable` (0: motor released) a run may let go of the load.
    """

    name: ClassVar[str] = "servo"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("q_cmd", "rad"), ("enable", "1")), (("q", "rad"),), ("q",)),
        Signature((("q_cmd", "rad"),), (("q", "rad"),), ("q",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
    )
    equations: ClassVar[str] = (
        "(mass length^2 + armature) qdd + mass gravity length sin(q - q_offset) + viscous qd +"
        " coulomb sign qd = tau\ntau = torque_constant U - back_emf qd, 0 while released;  U ="
        " supply_voltage duty, at most current_limit\nduty = gain_scale kp (q_cmd - q), at most 1"
    )
    source: ClassVar[str] = (
        "DC motor behind a gear; structure of Duclusaud et al., arXiv 2410.08650"
    )

    torque_constant: Array = param(
        0.1, 0.005, 2.0, unit="N m/V", meaning="stall torque per volt, k_t / R", log=True
    )
    back_emf: Array = param(
        0.04, 1e-4, 2.0, unit="N m s/rad", meaning="torque lost per speed, k_t k_e / R", log=True
    )
    armature: Array = param(
        0.002, 1e-5, 0.5, unit="kg m^2", meaning="rotor inertia seen at the horn", log=True
    )
    q_offset: Array = param(
        0.0, -0.5, 0.5, scale=0.02, unit="rad", meaning="angle at which the load hangs"
    )
    gain_scale: Array = param(
        1e-3, 1e-5, 1e-1, unit="1/rad", meaning="duty per position error and unit of kp", log=True
    )
    kp: Array = constant(400.0, unit="1", meaning="proportional gain in the firmware's unit")
    supply_voltage: Array = constant(7.4, unit="V")
    mass: Array = constant(0.5, unit="kg", meaning="load")
    length: Array = constant(0.1, unit="m", meaning="its distance from the axis")
    gravity: Array = constant(9.81, unit="m/s^2")
    current_limit: Array = constant(
        1e6, unit="V", meaning="highest voltage over the winding that the current limit admits"
    )

    def loaded(self, mass: Array) -> Servo:
        """The same with mass [1] more at the load's place."""
        return with_fields(self, {"mass": self.mass + mass[0]})

    def outline(self, x, signature):
        q = x[0][0]
        return self.length * jnp.stack([jnp.zeros(2), jnp.stack([jnp.sin(q), -jnp.cos(q)])])

    def matrices(self, q, qd):
        inertia = self.mass * self.length**2 + self.armature
        return jnp.reshape(inertia, (1, 1)), self.mass * self.gravity * self.length * sin(
            q - self.q_offset
        )

    def drive(self, signature, u, q, qd):
        if not signature.inputs:
            return jnp.zeros_like(q)
        duty = jnp.clip(self.gain_scale * self.kp * (u[:1] - q), -1.0, 1.0)
        voltage = jnp.clip(self.supply_voltage * duty, -self.current_limit, self.current_limit)
        tau = self.torque_constant * voltage - self.back_emf * qd
        return tau * u[1:] if len(signature.inputs) > 1 else tau
