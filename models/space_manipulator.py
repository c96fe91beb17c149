"""Two-joint arm on a spacecraft: an unknown last body behind a known link, in the plane and without
gravity.
"""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxid.dynamics.effect import JointEffect
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import constant, param, setting
from jaxid.numerics.fast_math import dot, inverse, sincos


class StribeckLevels(JointEffect):
    """Dry and viscous friction whose level falls from breakaway to sliding: the friction of paper
    000 as one law.
    """

    name: ClassVar[str] = "stribeck_friction"
    contains: ClassVar[tuple[str, ...]] = ("coulomb_friction", "viscous_friction")
    equation: ClassVar[str] = "f = (F_c + (F_s - F_c) exp(-(qd / v_s)^2)) sign(qd) + F_v qd"
    signature: ClassVar[str] = (
        "a bump of the missing torque at low speed; breakaway above the sliding level"
    )
    source: ClassVar[str] = "paper 000 (which names the law; form by Armstrong-Helouvry 1991)"
    excitation: ClassVar[str] = "slow ramps through zero speed"
    probes: ClassVar[tuple] = ()
    F_c: Array = param(1.0, 0.1, 5.0, unit="{F}", meaning="sliding level")
    F_s: Array = param(1.5, 0.1, 6.0, unit="{F}", meaning="breakaway level")
    v_s: Array = param(0.05, 0.005, 0.3, unit="{X}/s", meaning="Stribeck velocity", log=True)
    F_v: Array = param(1.0, 0.0, 6.0, unit="{F} s/{X}", meaning="viscous coefficient")

    def start(self, q):
        return ()

    def __call__(self, s, z):
        level = self.F_c + (self.F_s - self.F_c) * jnp.exp(-((s.qd / self.v_s) ** 2))
        return self.F_v * s.qd, level, level, z


class SpaceManipulator(Rigid):
    """Joint 1 at the base, joint 2 before the last body, whose mass, first moments and inertia
    about joint 2 are unknown.

    As in the paper the base stands still (its "second assumption": joint torques hardly move it).
    With `floating = true` it floats freely: the exact reduced dynamics at zero momentum, with M_r =
    M_mm - M_mb M_bb^-1 M_bm. Angles of the last body are relative to link 1, those of link 1 to the
    base; the base's attitude is the rotation it has made.
    """

    name: ClassVar[str] = "space_manipulator"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature(
            (("tau1", "N m"), ("tau2", "N m")),
            (("q1", "rad"), ("q2", "rad"), ("base_attitude", "rad")),
            ("q1", "q2"),
        ),
        Signature((("tau1", "N m"), ("tau2", "N m")), (("q1", "rad"), ("q2", "rad")), ("q1", "q2")),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (StribeckLevels, {"F_c": "F_c", "F_s": "F_s", "v_s": "v_s", "F_v": "F_v"}),
    )
    equations: ClassVar[str] = (
        "c = cos q2, s = sin q2:\ntau2 = I2 (qdd1 + qdd2) + l1 (hx (c qdd1 + s qd1^2) + hy (-s qdd1"
        " + c qd1^2)) + f2\ntau1 = (I1 + m2 l1^2) qdd1 + (tau2 - f2)\n       + l1 (hx (c (qdd1 +"
        " qdd2) - s (qd1 + qd2)^2) + hy (-s (qdd1 + qdd2) - c (qd1 + qd2)^2)) + f1\nf = (F_c + (F_s"
        " - F_c) exp(-(qd / v_s)^2)) sign qd + F_v qd;  floating base: M_r = M_mm - M_mb M_bb^-1"
        " M_bm"
    )
    source: ClassVar[str] = (
        "paper 000 (Int. J. Adv. Robotic Systems, 2016, doi 10.5772/63935); its lost equations"
        " rederived"
    )

    m2: Array = param(30.0, 5.0, 100.0, unit="kg", meaning="mass of the last body", log=True)
    hx: Array = param(10.0, 0.0, 60.0, unit="kg m", meaning="its first moment along the body")
    hy: Array = param(0.0, -20.0, 20.0, unit="kg m", meaning="its first moment across")
    I2: Array = param(15.0, 1.0, 60.0, unit="kg m^2", meaning="its inertia about joint 2", log=True)
    l1: Array = constant(1.2, unit="m", meaning="length of link 1")
    I1: Array = constant(3.0, unit="kg m^2", meaning="inertia of link 1 about joint 1")
    m1: Array = constant(5.0, unit="kg", meaning="mass of link 1 (floating base)")
    c1: Array = constant(0.5, unit="m", meaning="its centre of mass along the link (floating base)")
    base_mass: Array = constant(2500.0, unit="kg", meaning="mass of the base (floating base)")
    base_inertia: Array = constant(
        2000.0, unit="kg m^2", meaning="inertia of the base about its centre (floating base)"
    )
    base_x: Array = constant(
        0.6, unit="m", meaning="joint 1 from the base's centre, along the base"
    )
    base_y: Array = constant(0.2, unit="m", meaning="joint 1 from the base's centre, across")
    floating: bool = setting(False, meaning="the base floats freely; false: it stands still")

    base_lightness: Any = eqx.field(default=None, repr=False)  # of a base that an effect loosens

    def start(self, q, qd):
        return q, qd, jnp.zeros(1)

    def port(self, x):
        return x[0], x[1]

    def _full(self, q):
        """Mass matrix [3 3] of (base rotation, q1, q2) and its mixed block [2 3] with the base's
        translation, in the base's frame, from the Jacobians of the three centres.
        """
        s, c = sincos(jnp.stack([q[0], q[0] + q[1]]))
        x1, y1 = self.base_x + self.l1 * c[0], self.base_y + self.l1 * s[0]  # joint 2
        hx, hy = (
            self.hx * c[1] - self.hy * s[1],
            self.hx * s[1] + self.hy * c[1],
        )  # first moment of the last body
        gx, gy = self.m1 * self.c1 * c[0], self.m1 * self.c1 * s[0]  # of link 1 about joint 1
        arm = (
            self.I1 + self.m2 * self.l1**2
        )  # link 1 and the last body's mass at its end, about joint 1
        swing = self.l1 * (c[0] * hx + s[0] * hy)  # l1 . h
        ox, oy = (
            gx + self.m2 * self.l1 * c[0] + hx,
            gy + self.m2 * self.l1 * s[0] + hy,
        )  # about joint 1, both bodies
        a11 = arm + self.I2 + 2 * swing
        a12 = self.I2 + swing
        carried = self.m1 + self.m2
        lever = self.base_x * ox + self.base_y * oy
        short = self.base_x * hx + self.base_y * hy
        a00 = self.base_inertia + carried * (self.base_x**2 + self.base_y**2) + a11 + 2 * lever
        rows = [
            [a00, a11 + lever, a12 + short],
            [a11 + lever, a11, a12],
            [a12 + short, a12, self.I2],
        ]
        px, py = (
            self.m1 * self.base_x + gx + self.m2 * x1 + hx,
            self.m1 * self.base_y + gy + self.m2 * y1 + hy,
        )
        mixed = [[-py, -oy, -hy], [px, ox, hx]]
        return jnp.stack([jnp.stack(r) for r in rows]), jnp.stack([jnp.stack(r) for r in mixed])

    def _reduced(self, q):
        """Mass matrix [2 2] of the joints at zero momentum, and the base's rate per joint rate [2].

        The base's mass and inertia count 1 / lightness times: 0 is a base that stands still.
        """
        M, P = self._full(q)
        light = 1.0 if self.base_lightness is None else self.base_lightness
        M = M - light * dot(P.T, P) / (self.base_mass + light * (self.m1 + self.m2))
        turn = -light * M[0, 1:] / (self.base_inertia + light * (M[0, 0] - self.base_inertia))
        return M[1:, 1:] + M[1:, :1] * turn, turn

    def outline(self, x, signature):
        (q1, q2), turn = x[0], x[2][0]
        a, b = turn + q1, turn + q1 + q2
        c, s = jnp.cos(turn), jnp.sin(turn)
        first = jnp.stack([c * self.base_x - s * self.base_y, s * self.base_x + c * self.base_y])
        second = first + self.l1 * jnp.stack([jnp.cos(a), jnp.sin(a)])
        return jnp.stack(
            [jnp.zeros(2), first, second, second + jnp.stack([jnp.cos(b), jnp.sin(b)])]
        )

    def mass(self, q):
        if not self.floating:
            return self._full(q)[0][1:, 1:]
        reduced = self._reduced(q)[0]
        if self.base_lightness is None:
            return reduced
        return jnp.where(self.base_lightness > 0, reduced, self._full(q)[0][1:, 1:])

    def loosened(self, share: Array) -> SpaceManipulator:
        """The same on a base that gives way: share [1] 0 stands still, 1 floats with the known mass
        and inertia.
        """
        return dataclasses.replace(self, floating=True, base_lightness=share[0])

    def matrices(self, q, qd):
        # bias = dM/dt qd - d/dq (qd' M qd) / 2
        slopes = [jax.jvp(self.mass, (q,), (e,))[1] for e in jnp.eye(2)]
        rate = slopes[0] * qd[0] + slopes[1] * qd[1]
        return (
            self.mass(q),
            dot(rate, qd) - jnp.stack([jnp.sum(qd * dot(s, qd)) for s in slopes]) / 2,
        )

    def free(self, h, x, tau):
        return super().free(h, x[:2], tau)

    def close(self, h, x, free, dtau, qd, shift):
        q1, v1 = super().close(h, x[:2], free, dtau, qd, shift)
        if not self.floating:
            return q1, v1, x[2]

        # The base turns by the mean of its rates at both ends, corrected by the middle (Simpson).
        def rate(q, v):
            return dot(self._reduced(q)[1][None], v)

        middle = (x[0] + q1) / 2 + h / 8 * (x[1] - v1)
        speed = 1.5 * (q1 - x[0]) / h - (x[1] + v1) / 4
        return q1, v1, x[2] + h / 6 * (rate(x[0], x[1]) + 4 * rate(middle, speed) + rate(q1, v1))

    def vector_field(self, t, x, tau):
        q, v, _ = x
        M, bias = self.matrices(q, v)
        turn = dot(self._reduced(q)[1][None], v) if self.floating else jnp.zeros(1)
        return v, dot(inverse(M), tau - bias), turn

    def output(self, x, tau, rests):
        return jnp.concatenate([x[0], x[2]])
