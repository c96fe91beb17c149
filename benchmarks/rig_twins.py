"""Models of benches as their users would write them, and twins of the same benches by equations of
their own.

A model follows the recipe of the README: its numbers, its mass matrix or energies, its `drive`. A
twin is simulated by `jaxid.benchmark.scipy_twin.motion`.
"""

from __future__ import annotations

from math import pi
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxid.benchmark.cart_pole import OF_EACH_JOINT
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import constant, param
from jaxid.models.effects import CoulombFriction, StribeckFriction, ViscousFriction


# ---- the models that users would write

OF_ONE_AXIS = (
    (ViscousFriction, {"coefficient": "viscous"}),
    (CoulombFriction, {"level": "coulomb"}),
)


class Furuta(Rigid):
    """An arm turned by a motor's volts; a pendulum hangs from its end (alpha = 0 hangs down)."""

    name: ClassVar[str] = "furuta"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("u", "V"),), (("theta", "rad"), ("alpha", "rad")), ("theta", "alpha")),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = OF_EACH_JOINT
    equations: ClassVar[str] = "M(alpha) qdd + c(q, qd) = (k (u - k qd1) / R, 0)"
    source: ClassVar[str] = "textbook"
    J_arm: Array = param(5e-4, 1e-5, 1e-2, unit="kg m^2", log=True)
    J_pendulum: Array = param(3e-4, 1e-5, 1e-2, unit="kg m^2", log=True)
    mass: Array = constant(0.024, unit="kg")
    arm: Array = constant(0.085, unit="m")
    centre: Array = constant(0.0645, unit="m")
    k: Array = constant(0.042, unit="N m/A")
    R: Array = constant(8.4, unit="ohm")

    def drive(self, signature, u, q, qd):
        return jnp.stack([self.k / self.R * (u[0] - self.k * qd[0]), 0.0 * u[0]])

    def matrices(self, q, qd):
        s, c = jnp.sin(q[1]), jnp.cos(q[1])
        across = self.mass * self.arm * self.centre
        off = across * c
        M = jnp.array(
            [
                [self.J_arm + self.mass * self.arm**2 + self.J_pendulum * s**2, off],
                [off, self.J_pendulum],
            ]
        )
        turning = 2 * self.J_pendulum * s * c * qd[0] * qd[1] - across * s * qd[1] ** 2
        swinging = -self.J_pendulum * s * c * qd[0] ** 2 + self.mass * 9.81 * self.centre * s
        return M, jnp.stack([turning, swinging])


class Cylinder(Rigid):
    """A pneumatic cylinder's piston and load under the pressures of both chambers."""

    name: ClassVar[str] = "cylinder"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("p_a", "Pa"), ("p_b", "Pa")), (("position", "m"),), ("position",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = OF_ONE_AXIS
    equations: ClassVar[str] = "mass qdd = bore p_a - ring p_b - friction"
    source: ClassVar[str] = "textbook"
    mass: Array = param(1.0, 0.01, 100.0, unit="kg", log=True)
    bore: Array = constant(pi / 4 * 0.025**2, unit="m^2")
    ring: Array = constant(pi / 4 * (0.025**2 - 0.010**2), unit="m^2")

    def drive(self, signature, u, q, qd):
        return (self.bore * u[0] - self.ring * u[1])[None]

    def matrices(self, q, qd):
        return self.mass[None, None], jnp.zeros_like(q)


class Rack(Rigid):
    """A slide that a motor's current moves by a pinion."""

    name: ClassVar[str] = "rack"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("i", "A"),), (("position", "m"),), ("position",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        *OF_ONE_AXIS,
        (StribeckFriction, {}),
    )
    equations: ClassVar[str] = "mass qdd = k / r i - friction"
    source: ClassVar[str] = "textbook"
    mass: Array = param(3.0, 0.01, 100.0, unit="kg", log=True)
    k: Array = constant(0.0467, unit="N m/A")
    r: Array = constant(0.0127, unit="m")

    def drive(self, signature, u, q, qd):
        return self.k / self.r * u

    def matrices(self, q, qd):
        return self.mass[None, None], jnp.zeros_like(q)


class Wheel(Rigid):
    """A wheel of known inertia that was spun up and let go; a tachometer reads its speed."""

    name: ClassVar[str] = "wheel"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((), (("qd", "rad/s"),), ("q",), speeds=(0,)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = OF_ONE_AXIS
    equations: ClassVar[str] = "inertia qdd = -friction"
    source: ClassVar[str] = "textbook"
    inertia: Array = constant(0.012, unit="kg m^2")

    def matrices(self, q, qd):
        return self.inertia[None, None], jnp.zeros_like(q)


# ---- the twins: equations of their own


class FurutaTwin:
    """Lagrange's equations of arm and pendulum by hand; a cable may pull the arm back."""

    def __init__(self, cable: float = 0.0):
        self.cable = cable

    def __call__(self, q, v, u):
        m, r, l, J = 0.024, 0.085, 0.0645, 1.33e-4
        sin, cos = np.sin(q[1]), np.cos(q[1])
        current = (u[0] - 0.042 * v[0]) / 8.4
        M = np.array([[2.3e-4 + m * r * r + J * sin * sin, m * r * l * cos], [m * r * l * cos, J]])
        arm = 0.042 * current - 1.2e-4 * v[0] - self.cable * q[0]
        arm += m * r * l * sin * v[1] ** 2 - J * np.sin(2 * q[1]) * v[0] * v[1]
        return M, np.array([arm, J * sin * cos * v[0] ** 2 - m * 9.81 * l * sin - 4e-5 * v[1]])

    def dry(self, speed: float) -> float:
        return 6e-4


class SlideTwin:
    """A mass on a guide: force per input, friction that may fall with the speed, a load."""

    def __init__(self, gains, mass, viscous, coulomb, more=0.0, at=1.0, load=0.0, drag=0.0):
        self.gains, self.mass, self.viscous, self.level = np.array(gains), mass, viscous, coulomb
        self.more, self.at, self.load, self.drag = more, at, load, drag

    def __call__(self, q, v, u):
        force = float(self.gains @ u) if len(self.gains) else 0.0
        return np.array([[self.mass]]), np.array(
            [force - self.load - self.viscous * v[0] - self.drag * v[0] * abs(v[0])]
        )

    def dry(self, speed: float) -> float:
        return self.level + self.more * np.exp(-((speed / self.at) ** 2))


def multisine(
    rng: np.random.Generator, t: np.ndarray, size: float, low: float, high: float
) -> np.ndarray:
    """Five sines, then steps for the last third."""
    f, phase = np.exp(rng.uniform(np.log(low), np.log(high), 5)), rng.uniform(0, 2 * pi, 5)
    u = np.sin(2 * pi * t[:, None] * f + phase).sum(1) / 2
    steps = np.repeat(rng.uniform(-1.2, 1.2, 40), max(1, len(t) // 20))[: len(t)]
    return size * np.where(t < 0.65 * t[-1], u, steps)
