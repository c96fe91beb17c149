"""Two flexible links in a plane, each on a motor: finite elements in clamped modes, moving in the
frames of the bent links.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxid.dynamics.beam import Beam, matrices, modes, steady_load
from jaxid.dynamics.mechanism import Free, Mechanism, Signature
from jaxid.dynamics.parameter import constant, param, setting, with_fields
from jaxid.models.effects import CoulombFriction, ViscousFriction
from jaxid.numerics.fast_math import dot, inverse, sincos


class LinkIntegrals(NamedTuple):
    """Integrals of a link over its length, with modes phi: mass, first and second moment about its
    hub; of the modes the integrals of phi and x phi, mass and stiffness, deflection and slope at
    the tip, curvature at the hub; and what it carries at its tip (kg, kg m^2).
    """

    length: Array
    mass: Array
    moment: Array
    inertia: Array
    shift: Float[Array, " modes"]
    turn: Float[Array, " modes"]
    M: Float[Array, "modes modes"]
    K: Float[Array, "modes modes"]
    tip: Float[Array, " modes"]
    slope: Float[Array, " modes"]
    curvature: Float[Array, " modes"]
    carried: Array
    carried_inertia: Array
    shapes: Float[Array, "nodes modes"]

    @classmethod
    def of(cls, beam: Beam, elements: int, count: int) -> LinkIntegrals:
        bare = matrices(beam._replace(payload=0.0, payload_inertia=0.0), elements)
        V = modes(matrices(beam._replace(stiffness=1.0), elements), count).shapes
        le = beam.length / elements
        root = jnp.zeros(V.shape[0]).at[:2].set(jnp.stack([6 / le**2, -2 / le]))
        mass = beam.density * beam.length
        return cls(
            beam.length,
            mass,
            mass * beam.length / 2,
            bare.inertia,
            steady_load(beam, elements) @ V,
            bare.coupling @ V,
            V.T @ bare.M @ V,
            V.T @ bare.K @ V,
            V[-2],
            V[-1],
            root @ V,
            beam.payload,
            beam.payload_inertia,
            V,
        )


class Frame(NamedTuple):
    """Where a link begins: position, m, and angle; and their rates, the velocity along the link's
    own axes.
    """

    at: Float[Array, " 2"]
    angle: Array
    velocity: Float[Array, " 2"]
    rate: Array


class FlexibleArm(Mechanism):
    """Two flexible links in a plane; q = 0 is straight (with gravity: hangs down), q2 is relative
    to the bent end of link 1.

    Each link deflects across the axis of its own clamped end; the second motor and the payload are
    bodies at the ends. Angles, also those that the bending makes, are taken as they are; the
    shortening of a bent link is not counted. `kinetic_energy`, `potential_energy` and
    `strain_energy` define the equations; `matrices` are their closed form, for speed. A step takes
    stiffness and damping of the links by the trapezoidal rule, so that stiff modes limit no step,
    and everything else at the middle of the step.
    """

    name: ClassVar[str] = "flexible_arm"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature(
            (("tau1", "N m"), ("tau2", "N m")), (("q1", "rad"), ("q2", "rad"), ("strain1", "1"), ("strain2", "1")), ("q1", "q2"),
            shown=(0, 1, 2, 3),
        ),
        Signature(
            (("tau1", "N m"), ("tau2", "N m")), (("q1", "rad"), ("q2", "rad"), ("tip_x", "m"), ("tip_y", "m")), ("q1", "q2"),
            shown=(0, 1, 4, 5),
        ),
        Signature((("tau1", "N m"), ("tau2", "N m")), (("q1", "rad"), ("q2", "rad")), ("q1", "q2"), shown=(0, 1)),
    )  # fmt: skip
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
    )
    equations: ClassVar[str] = (
        "M(p) pdd + h(p, pd) + D ed + K e + (viscous qd + coulomb sign qd, 0) = (tau, 0),  p = (q1,"
        " q2, e1, e2)\nfrom T - V of both links, of the second motor at the end of the first and of"
        " the payload; D = alpha M_e + beta K_e\nstrain = h/2 times the curvature at the clamped"
        " end; tip_x along the straight arm, tip_y across"
    )
    source: ClassVar[str] = (
        "the beam of paper 002 (Machines 12(6), 409, 2024) twice; De Luca, Siciliano 1991 for the"
        " kinematics"
    )
    hidden_states: ClassVar[bool] = True

    E1: Array = param(7e10, 5e9, 3e11, unit="Pa", meaning="elastic modulus of link 1", log=True)
    E2: Array = param(7e10, 5e9, 3e11, unit="Pa", meaning="elastic modulus of link 2", log=True)
    I_m1: Array = param(
        0.01, 1e-4, 1.0, unit="kg m^2", meaning="inertia of hub and rotor at joint 1", log=True
    )
    I_m2: Array = param(
        0.001, 1e-5, 1.0, unit="kg m^2", meaning="inertia of hub and rotor at joint 2", log=True
    )
    alpha: Array = param(
        0.3, 1e-3, 4.0, unit="1/s", meaning="damping in proportion to mass", log=True
    )
    beta: Array = param(
        1e-4, 1e-7, 1e-2, unit="s", meaning="damping in proportion to stiffness", log=True
    )
    L1: Array = constant(0.5, unit="m", meaning="length of link 1")
    L2: Array = constant(0.4, unit="m", meaning="length of link 2")
    h1: Array = constant(0.003, unit="m", meaning="thickness of link 1 in the direction of bending")
    h2: Array = constant(0.002, unit="m", meaning="thickness of link 2 in the direction of bending")
    b1: Array = constant(0.05, unit="m", meaning="width of link 1")
    b2: Array = constant(0.04, unit="m", meaning="width of link 2")
    rho1: Array = constant(2700.0, unit="kg/m^3", meaning="density of link 1")
    rho2: Array = constant(2700.0, unit="kg/m^3", meaning="density of link 2")
    m_h: Array = constant(0.3, unit="kg", meaning="mass of the second motor, at the end of link 1")
    J_h: Array = constant(1e-4, unit="kg m^2", meaning="rotary inertia of its housing")
    m_p: Array = constant(0.1, unit="kg", meaning="payload at the tip")
    J_p: Array = constant(0.0, unit="kg m^2", meaning="rotary inertia of the payload")
    gravity: Array = constant(0.0, unit="m/s^2", meaning="9.81 where the plane is vertical")
    n_elements: int = setting(3, 1, 16, meaning="finite elements of each link")
    n_modes: int = setting(2, 0, 32, meaning="elastic modes kept of each link; 0: all")

    prepared: Any = eqx.field(
        default=None, repr=False
    )  # integrals over the links; their stiffness and damping

    def links(self) -> tuple[LinkIntegrals, LinkIntegrals]:
        """Both links' integrals."""
        if self.prepared is not None:
            return self.prepared[0]
        count = min(self.n_modes or 2 * self.n_elements, 2 * self.n_elements)
        sizes = (
            (self.L1, self.E1, self.b1, self.h1, self.rho1, self.m_h, self.J_h),
            (self.L2, self.E2, self.b2, self.h2, self.rho2, self.m_p, self.J_p),
        )
        each = (jnp.stack([jnp.asarray(v) for v in pair]) for pair in zip(*sizes, strict=True))

        def own(L, E, b, h, rho, m, J):
            return LinkIntegrals.of(
                Beam(L, E * b * h**3 / 12, rho * b * h, m, J), self.n_elements, count
            )

        both = jax.vmap(own)(*each)  # side by side: half the program
        return LinkIntegrals(*(v[0] for v in both)), LinkIntegrals(*(v[1] for v in both))

    def prepare(self, h):
        return eqx.tree_at(
            lambda s: s.prepared, self, (self.links(), self._elastic()), is_leaf=lambda x: x is None
        )

    def _elastic(self) -> tuple[Array, Array]:
        """Stiffness and damping [2 modes, 2 modes] of both links."""
        if self.prepared is not None:
            return self.prepared[1]
        first, second = self.links()
        K = jax.scipy.linalg.block_diag(first.K, second.K)
        return K, self.alpha * jax.scipy.linalg.block_diag(first.M, second.M) + self.beta * K

    def _frames(self, p: Array, pd: Array) -> tuple[Frame, Frame, Frame]:
        """Clamped ends of both links, and the tip."""
        first, second = self.links()
        e, z = (v[2:].reshape(2, -1) for v in (p, pd))
        base = Frame(jnp.zeros(2), p[0], jnp.zeros(2), pd[0])
        elbow = _end(first, base, e[0], z[0])
        turned = elbow._replace(
            angle=elbow.angle + p[1], velocity=_seen(p[1], elbow.velocity), rate=elbow.rate + pd[1]
        )
        return base, turned, _end(second, turned, e[1], z[1])

    def kinetic_energy(self, p: Float[Array, " n"], pd: Float[Array, " n"]) -> Float[Array, ""]:
        """Energy of links, rotors, second motor and payload, J."""
        first, second = self.links()
        e, z = (v[2:].reshape(2, -1) for v in (p, pd))
        base, elbow, tip = self._frames(p, pd)
        moving = _kinetic(first, base, e[0], z[0]) + _kinetic(second, elbow, e[1], z[1])
        moving += (self.I_m1 * base.rate**2 + self.I_m2 * elbow.rate**2) / 2
        for link, end, rate in ((first, elbow, elbow.rate - pd[1]), (second, tip, tip.rate)):
            moving += (link.carried * jnp.sum(end.velocity**2) + link.carried_inertia * rate**2) / 2
        return moving

    def potential_energy(self, p: Float[Array, " n"]) -> Float[Array, ""]:
        """Energy of height alone, J; what bending stores is not in it."""
        first, second = self.links()
        e = p[2:].reshape(2, -1)
        base, elbow, tip = self._frames(p, jnp.zeros_like(p))
        down = first.carried * elbow.at[0] + second.carried * tip.at[0]
        for link, frame, bent in ((first, base, e[0]), (second, elbow, e[1])):
            s, c = _sincos(frame.angle)
            down += link.mass * frame.at[0] + c * link.moment - s * dot(link.shift, bent)
        return -self.gravity * down

    def strain_energy(self, p: Float[Array, " n"]) -> Float[Array, ""]:
        """Energy of bending, J."""
        e = p[2:]
        return dot(e, dot(self._elastic()[0], e)) / 2

    def matrices(
        self, p: Float[Array, " n"], pd: Float[Array, " n"]
    ) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """M(p) and h(p, pd) of joints and modes; stiffness and damping of the links are not in h.

        d'Alembert's forces of every point, which are Lagrange's equations: along a link's axes a
        point moves with J pd = (U0 - w turn, U1 + x turn + phi) pd, and J' times its acceleration
        where pdd = 0 is integrated. Gravity is an acceleration of the base.
        """
        first, second = self.links()
        one = jnp.eye(p.shape[0])
        modal = one[2:].reshape(2, -1, p.shape[0])
        e, z = (v[2:].reshape(2, -1) for v in (p, pd))
        turn, move = one[0], jnp.zeros((2, p.shape[0]))
        pull = _seen(p[0], jnp.stack([-self.gravity, 0.0 * self.gravity]))
        M = self.I_m1 * turn[:, None] * turn
        h = jnp.zeros_like(p)
        for k, link in enumerate((first, second)):
            own_M, own_h = _inertia_forces(
                link=link,
                turn=turn,
                move=move,
                pull=pull,
                e=e[k],
                z=z[k],
                rate=dot(turn, pd),
                own=modal[k],
            )
            M, h = M + own_M, h + own_h
            turn, move, pull, M, h = _carried(
                link=link,
                turn=turn,
                move=move,
                pull=pull,
                e=e[k],
                z=z[k],
                pd=pd,
                own=modal[k],
                M=M,
                h=h,
            )
            if k == 0:
                angle = dot(link.slope, e[0]) + p[1]
                turn, move, pull = turn + one[1], _seen(angle, move), _seen(angle, pull)
                M = M + self.I_m2 * turn[:, None] * turn
        return M, h

    def start(self, q, qd):
        """Bent as gravity holds it."""
        K, _ = self._elastic()
        sag = jax.grad(self.potential_energy)
        e = jnp.zeros(K.shape[0])
        for _ in range(3):  # what bending itself turns is small
            e = -jnp.linalg.solve(K, sag(jnp.concatenate([q, e]))[2:])
        return q, qd, e, jnp.zeros_like(e)

    def follow(self, x, q, qd):
        return q, qd, *x[2:]

    def port(self, x):
        return x[0], x[1]

    def vector_field(self, t, x, tau):
        p, pd = jnp.concatenate([x[0], x[2]]), jnp.concatenate([x[1], x[3]])
        K, D = self._elastic()
        M, bias = self.matrices(p, pd)
        held = jnp.concatenate([tau, -dot(K, x[2]) - dot(D, x[3])])
        pdd = dot(inverse(M), held - bias)
        return x[1], pdd[:2], x[3], pdd[2:]

    def free(self, h, x, tau):
        p, pd = jnp.concatenate([x[0], x[2]]), jnp.concatenate([x[1], x[3]])
        K, D = self._elastic()
        implicit = jnp.zeros((p.shape[0],) * 2).at[2:, 2:].set(h / 2 * D + h * h / 4 * K)
        force = jnp.concatenate([tau, -dot(K, x[2])])

        def middle(carry, _):
            after, _ = carry
            M, bias = self.matrices(p + h / 4 * (pd + after), (pd + after) / 2)
            W = inverse(M + implicit)
            return (dot(W, dot(M - implicit, pd) + h * (force - bias)), W), None

        # In a loop, so that the equations are compiled once.
        (after, W), _ = jax.lax.scan(middle, (pd, jnp.zeros_like(implicit)), length=2)
        A = W[:2, :2]
        return Free(after[:2], h * A, (after[2:], dot(W[2:, :2], inverse(A))))

    def close(self, h, x, free, dtau, qd, shift):
        z, along = free.aux
        z = z + dot(along, qd - free.qd)
        return x[0] + h / 2 * (x[1] + qd) + shift, qd, x[2] + h / 2 * (x[3] + z), z

    def inverse(self, q, qd, qdd):
        """Torque of the arm moved as if its links were rigid (the deflection is no function of the
        joints' motion).
        """
        _, _, e, z = self.start(q, qd)
        M, bias = self.matrices(jnp.concatenate([q, e]), jnp.concatenate([qd, z]))
        return dot(M[:2, :2], qdd) + bias[:2]

    def output(self, x, tau, rests):
        first, second = self.links()
        e = x[2].reshape(2, -1)
        strains = jnp.stack(
            [self.h1 / 2 * dot(first.curvature, e[0]), self.h2 / 2 * dot(second.curvature, e[1])]
        )
        _, _, tip = self._frames(jnp.concatenate([x[0], x[2]]), jnp.zeros(2 + x[2].shape[0]))
        return jnp.concatenate([x[0], strains, tip.at])

    def loaded(self, mass):
        """With a point mass [2] more at the far end of each link."""
        return with_fields(self, {"m_h": self.m_h + mass[0], "m_p": self.m_p + mass[1]})

    def outline(self, x, signature):
        p = jnp.concatenate([x[0], x[2]])
        base, elbow, _ = self._frames(p, jnp.zeros_like(p))
        lines = []
        for link, frame, e in zip(self.links(), (base, elbow), x[2].reshape(2, -1), strict=True):
            across = jnp.concatenate([jnp.zeros(1), (link.shapes @ e)[0::2]])
            along = jnp.linspace(0.0, 1.0, self.n_elements + 1) * link.length
            s, c = _sincos(frame.angle)
            lines.append(frame.at + jnp.stack([c * along - s * across, s * along + c * across], 1))
        down = jnp.concatenate(lines)
        return jnp.stack([down[:, 1], -down[:, 0]], 1)


def _sincos(angle: Array) -> tuple[Array, Array]:
    s, c = sincos(angle[None])
    return s[0], c[0]


def _seen(angle: Array, v: Float[Array, " 2 *n"]) -> Float[Array, " 2 *n"]:
    """Vectors along the axes of a frame turned by an angle."""
    s, c = _sincos(angle)
    return jnp.stack([c * v[0] + s * v[1], c * v[1] - s * v[0]])


def _end(link: LinkIntegrals, frame: Frame, e: Array, z: Array) -> Frame:
    """The far end of a bent link, with the frame that it carries."""
    across, bend, s, c = dot(link.tip, e), dot(link.slope, e), *_sincos(frame.angle)
    at = frame.at + jnp.stack([c * link.length - s * across, s * link.length + c * across])
    u = frame.velocity + jnp.stack(
        [-frame.rate * across, frame.rate * link.length + dot(link.tip, z)]
    )
    return Frame(at, frame.angle + bend, _seen(bend, u), frame.rate + dot(link.slope, z))


def _kinetic(link: LinkIntegrals, frame: Frame, e: Array, z: Array) -> Array:
    """Energy of a bent link without what it carries: points move with (ux - rate w, uy + rate x +
    wd) along its axes.
    """
    (ux, uy), rate = frame.velocity, frame.rate
    alone = (
        link.mass * (ux**2 + uy**2)
        + rate**2 * (link.inertia + dot(e, dot(link.M, e)))
        + dot(z, dot(link.M, z))
    )
    mixed = (
        uy * (rate * link.moment + dot(link.shift, z))
        - ux * rate * dot(link.shift, e)
        + rate * dot(link.turn, z)
    )
    return alone / 2 + mixed


def _inertia_forces(
    link: LinkIntegrals,
    turn: Array,
    move: Array,
    pull: Array,
    e: Array,
    z: Array,
    rate: Array,
    own: Array,
):
    """(M, h) of a bent link without what it carries. `turn` [n] and `move` [2 n]: how its frame
    turns and moves with each coordinate; `pull` [2]: acceleration of the frame; `own` [modes n]:
    its modes among the coordinates.
    """
    shift, turning, bent = link.shift @ own, link.turn @ own, dot(link.M, e)
    across, leaned = dot(link.shift, e), dot(link.turn, e)
    mixed = (
        move[1][:, None] * (link.moment * turn + shift)
        - move[0][:, None] * turn * across
        + turn[:, None] * turning
    )
    M = link.mass * (move[0][:, None] * move[0] + move[1][:, None] * move[1]) + mixed + mixed.T
    M = M + (link.inertia + dot(e, bent)) * turn[:, None] * turn + own.T @ link.M @ own
    ax = link.mass * pull[0] - rate**2 * link.moment - 2 * rate * dot(link.shift, z)
    ay = link.mass * pull[1] - rate**2 * across
    about = (
        link.moment * pull[1]
        - rate**2 * leaned
        - (across * pull[0] - rate**2 * leaned - 2 * rate * dot(bent, z))
    )
    return (
        M,
        move[0] * ax + move[1] * ay + turn * about + (link.shift * pull[1] - rate**2 * bent) @ own,
    )


def _carried(link: LinkIntegrals, turn, move, pull, e, z, pd, own, M, h):
    """The far end's turn, move and pull, still along the link's own axes, and (M, h) with what it
    carries.
    """
    across, rate = dot(link.tip, e), dot(turn, pd)
    pull = pull - rate * jnp.stack([rate * link.length + 2 * dot(link.tip, z), rate * across])
    move = move + jnp.stack([-across * turn, link.length * turn + link.tip @ own])
    turn = turn + link.slope @ own
    M = M + link.carried * (move[0][:, None] * move[0] + move[1][:, None] * move[1])
    M = M + link.carried_inertia * turn[:, None] * turn
    return turn, move, pull, M, h + link.carried * (move[0] * pull[0] + move[1] * pull[1])
