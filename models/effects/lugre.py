"""Friction by bristles, which give before they slide."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.effect import JointEffect
from jaxid.dynamics.export_law import ExportLaw
from jaxid.dynamics.parameter import ANGLE, param, Quantity, TORQUE


#: Once a step of `dt` s, in a simulator.
CODE = '''class LuGre:
    """level (z + relaxation dz/dt), dz/dt = (qd - |qd| z) / presliding."""

    def __init__(self, level, presliding, relaxation=0.0):
        self.level, self.presliding, self.relaxation, self.z = level, presliding, relaxation, 0.0

    def __call__(self, q, qd, load, dt):
        x = qd * dt / self.presliding
        end = xp.sign(x) + (self.z - xp.sign(x)) * xp.exp(-abs(x))
        f = self.level * ((self.z + end) / 2 + self.relaxation * (end - self.z) / dt)
        self.z = end
        return f
'''


class LuGreFriction(JointEffect):
    """Bristle friction: dry friction that builds up over a distance, with presliding before it.

    The bristle is followed exactly at the step's middle speed and enters the step implicitly, so it
    may be as stiff as it likes. It gives over a small distance, and its own damping is over in
    milliseconds: what is softer is a spring or play.
    """

    name: ClassVar[str] = "lugre_friction"
    equation: ClassVar[str] = (
        "f = level (z + relaxation dz/dt);  dz/dt = (qd - |qd| z) / presliding,  |z| <= 1"
    )
    signature: ClassVar[str] = (
        "hysteresis after each reversal over a fixed distance, not a fixed time; motion below"
        " breakaway"
    )
    source: ClassVar[str] = (
        "Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE TAC 40(3), 1995, equations (1) to (3),"
        " constant g: level = g, presliding = g / sigma_0, relaxation = sigma_1 / sigma_0"
    )
    excitation: ClassVar[str] = "micro-reversals of a few milliradians around rest, and slow ramps"
    axis: ClassVar[str] = "position"
    seen: ClassVar[str] = "in the first {presliding} after every reversal"
    plain: ClassVar[str] = (
        "The joint gives before it slides: friction builds up over {presliding} after each reversal."
    )
    check: ClassVar[str] = "Push with small forces and watch for a spring-like give at standstill."
    export_law: ClassVar = ExportLaw("force", memory=CODE)
    level: Array = param(
        0.0,
        0.0,
        2 * TORQUE,
        scale=0.05 * TORQUE,
        unit="{F}",
        meaning="friction level while sliding",
    )
    presliding: Array = param(
        0.01,
        1e-5 * ANGLE,
        (0.3 * ANGLE).up_to(0.1),
        scale=1e-3 * ANGLE,
        unit="{X}",
        meaning="distance over which friction builds up",
        log=True,
    )
    relaxation: Array = param(
        0.0, 0.0, 0.01, scale=0.002, unit="s", meaning="damping of the bristle over its stiffness"
    )
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"level": 0.05 * TORQUE, "presliding": 3e-4 * ANGLE},
        {"level": 0.05 * TORQUE, "presliding": 3e-3 * ANGLE},
        {"level": 0.05 * TORQUE, "presliding": 0.03 * ANGLE},
    )
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = (
        {"level": 0.05 * TORQUE, "presliding": 0.1, "relaxation": 0.0},
        {"level": 0.1 * TORQUE, "presliding": 0.05, "relaxation": 0.005},
        {"level": 0.2 * TORQUE, "presliding": 0.02, "relaxation": 0.01},
    )

    def start(self, q):
        return jnp.zeros_like(q)

    def __call__(self, s, z):
        x = s.qd * s.h / self.presliding
        end = z * jnp.exp(-jnp.abs(x)) - jnp.sign(x) * jnp.expm1(-jnp.abs(x))
        end = jnp.where(
            jnp.abs(x) < 1e-8, z + x - jnp.abs(x) * z, end
        )  # the slope of |x| and sign x at rest
        return self.level * ((z + end) / 2 + self.relaxation * (end - z) / s.h), 0.0, 0.0, end
