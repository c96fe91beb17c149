"""Euler-Bernoulli beams by finite elements (Hermite cubics), clamped at a hub that turns.

The definition is energy: `kinetic_energy` and `strain_energy` integrate over the elements.
`matrices` are the closed forms of the same integrals, for speed. Nodal coordinates psi = (u1,
theta1, ..., un, thetan): deflection across the hub-fixed axis and slope of every free node.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.numerics.linalg import eigh, whitening


class Beam(NamedTuple):
    """A uniform beam with a payload at its tip: length m, bending stiffness E I in N m^2, mass per
    length kg/m, payload kg and its rotary inertia kg m^2.
    """

    length: Any
    stiffness: Any
    density: Any
    payload: Any
    payload_inertia: Any


class Matrices(NamedTuple):
    """M, K of the clamped beam, its coupling to the hub's rotation, inertia about the hub, and the
    geometric stiffness per squared hub speed.
    """

    M: Float[Array, "n n"]
    K: Float[Array, "n n"]
    coupling: Float[Array, " n"]
    inertia: Float[Array, ""]
    geometric: Float[Array, "n n"]


class Modes(NamedTuple):
    """Clamped modes, mass-normalised: squared frequencies 1/s^2, participation of the hub's
    rotation, tip deflection, and the geometric stiffness between modes.
    """

    shapes: Float[Array, "n modes"]
    squares: Float[Array, " modes"]
    participation: Float[Array, " modes"]
    tip: Float[Array, " modes"]
    geometric: Float[Array, "modes modes"]


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)  # exact for every integrand below


def _shapes(xi: np.ndarray, le: Any) -> tuple[Any, Any, Any]:
    """Hermite cubics [4 points] at xi in 0 ... 1 of an element, their slope and curvature."""
    N = jnp.stack(
        [
            1 - 3 * xi**2 + 2 * xi**3,
            le * (xi - 2 * xi**2 + xi**3),
            3 * xi**2 - 2 * xi**3,
            le * (xi**3 - xi**2),
        ]
    )
    dN = (
        jnp.stack(
            [
                -6 * xi + 6 * xi**2,
                le * (1 - 4 * xi + 3 * xi**2),
                6 * xi - 6 * xi**2,
                le * (3 * xi**2 - 2 * xi),
            ]
        )
        / le
    )
    ddN = jnp.stack([-6 + 12 * xi, le * (-4 + 6 * xi), 6 - 12 * xi, le * (6 * xi - 2)]) / le**2
    return N, dN, ddN


def _elements(psi: Float[Array, " n"]) -> Float[Array, "elements 4"]:
    """Nodal coordinates of each element; the hub's node is clamped."""
    nodes = jnp.concatenate([jnp.zeros(2), psi]).reshape(-1, 2)
    return jnp.concatenate([nodes[:-1], nodes[1:]], 1)


def kinetic_energy(
    beam: Beam, phid: Any, psi: Float[Array, " n"], psid: Float[Array, " n"], rotating: bool = True
) -> Array:
    """Energy of the moving beam and payload, J; `rotating` includes (w phid)^2, the motion by a
    deflection's rotation.
    """
    n = psi.shape[0] // 2
    le = beam.length / n
    xi = (_NODES + 1) / 2
    N, _, _ = _shapes(xi, le)
    x = (jnp.arange(n)[:, None] + xi) * le
    w, wd = _elements(psi) @ N, _elements(psid) @ N
    speed = (x * phid + wd) ** 2 + (rotating * w * phid) ** 2
    tip = (beam.length * phid + psid[-2]) ** 2 + (rotating * psi[-2] * phid) ** 2
    energy = beam.density * jnp.sum(speed * _WEIGHTS) * le / 2 + beam.payload * tip
    return (energy + beam.payload_inertia * (phid + psid[-1]) ** 2) / 2


def strain_energy(beam: Beam, psi: Float[Array, " n"]) -> Array:
    """Bending energy, J."""
    le = beam.length / (psi.shape[0] // 2)
    _, _, ddN = _shapes((_NODES + 1) / 2, le)
    return beam.stiffness * jnp.sum((_elements(psi) @ ddN) ** 2 * _WEIGHTS) * le / 4


def foreshortening_energy(beam: Beam, phid: Any, psi: Float[Array, " n"]) -> Array:
    """What the centrifugal tension phid^2 (m_p L + rhoA (L^2 - x^2) / 2) adds to the potential of a
    bent beam, J.
    """
    n = psi.shape[0] // 2
    le = beam.length / n
    xi = (_NODES + 1) / 2
    _, dN, _ = _shapes(xi, le)
    x = (jnp.arange(n)[:, None] + xi) * le
    tension = beam.payload * beam.length + beam.density * (beam.length**2 - x**2) / 2
    return phid**2 * jnp.sum(tension * (_elements(psi) @ dN) ** 2 * _WEIGHTS) * le / 4


def _places(n_elements: int) -> np.ndarray:
    """Which coordinate of all nodes each coordinate of an element is, [elements 4 coordinates],
    ones and zeros.
    """
    return np.eye(2 * n_elements + 2)[2 * np.arange(n_elements)[:, None] + np.arange(4)]


def matrices(beam: Beam, n_elements: int) -> Matrices:
    """The beam's matrices by assembly of closed-form elements (standard Hermite element)."""
    le, at = beam.length / n_elements, _places(n_elements)
    first = np.arange(n_elements)[:, None]

    # one product, however many elements
    def whole(parts):
        return jnp.einsum("eai,eab,ebj->ij", at, parts, at)

    unit = (
        np.array([1, 0, 1, 0]) + np.array([0, 1, 0, 1]) * le
    )  # a slope coordinate counts le times
    scale = unit[:, None] * unit
    mass = (
        np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
        * scale
        / 420
        * le
    )
    bend = (
        np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) * scale / le**3
    )
    # Tension under rotation: int T(x) N'N' with T = m_p L + rhoA (L^2 - x^2) / 2, by quadrature (a
    # polynomial).
    xi = (_NODES + 1) / 2
    _, dN, _ = _shapes(xi, le)
    tension = (
        beam.payload * beam.length + beam.density * (beam.length**2 - ((first + xi) * le) ** 2) / 2
    )
    steady = (
        np.array([0.5, 1 / 12, 0.5, -1 / 12]) * (first * le)
        + np.array([3 / 20, 1 / 30, 7 / 20, -1 / 20]) * le
    )
    each = np.ones((n_elements, 1, 1))
    M, K = whole(each * (beam.density * mass)), whole(each * (beam.stiffness * bend))
    G = whole(jnp.einsum("ap,ep,bp->eab", dN, tension * _WEIGHTS * le / 2, dN))
    c = jnp.einsum("ea,eai->i", beam.density * le * steady * unit, at)
    M = M.at[-2, -2].add(beam.payload).at[-1, -1].add(beam.payload_inertia)
    c = c.at[-2].add(beam.payload * beam.length).at[-1].add(beam.payload_inertia)
    J = beam.density * beam.length**3 / 3 + beam.payload * beam.length**2 + beam.payload_inertia
    return Matrices(M[2:, 2:], K[2:, 2:], c[2:], J, G[2:, 2:])


def steady_load(beam: Beam, n_elements: int) -> Float[Array, " n"]:
    """Density times the integral of each nodal coordinate's shape over the length, kg and kg m."""
    le = beam.length / n_elements
    load = (
        beam.density
        * le
        * (np.array([0.5, 0.0, 0.5, 0.0]) + np.array([0.0, 1 / 12, 0.0, -1 / 12]) * le)
    )
    return (load @ _places(n_elements).sum(0))[2:]


def modes(m: Matrices, count: int) -> Modes:
    """The `count` lowest clamped modes."""
    size = jnp.sqrt(jnp.diagonal(m.M))  # equal units, hence a well-conditioned factor
    white = whitening(m.M / (size[:, None] * size)) / size
    squares, V = eigh(white @ m.K @ white.T)
    V = white.T @ V
    V = (V * jnp.sign(V[-2]))[:, :count]
    return Modes(V, squares[:count], V.T @ m.coupling, V[-2], V.T @ m.geometric @ V)


class Decay(NamedTuple):
    """Exponential of [[0, 1], [-squares, -damping]] over a step, [modes] each: x' = a x + b v, v' =
    -squares b x + d v.
    """

    a: Float[Array, " modes"]
    b: Float[Array, " modes"]
    d: Float[Array, " modes"]


def decay(squares: Float[Array, " modes"], damping: Float[Array, " modes"], h: Any) -> Decay:
    """Exact step of damped oscillators; under- and over-damped ones alike, without overflow."""
    gap = squares - damping**2 / 4
    under = gap >= 0
    rate = jnp.sqrt(jnp.maximum(jnp.abs(gap), 1e-12 * squares))
    x = rate * h
    fade = jnp.exp(-damping * h / 2)
    # Over-damped: the slow rate squares / (damping / 2 + rate) has no cancellation.
    slow = jnp.exp(-squares / (damping / 2 + rate) * h)
    fast = jnp.exp(-(damping / 2 + rate) * h)
    cosine = jnp.where(under, fade * jnp.cos(x), (slow + fast) / 2)
    sine = jnp.where(under, fade * jnp.sin(x), (slow - fast) / 2) / rate
    return Decay(cosine + damping / 2 * sine, sine, cosine - damping / 2 * sine)
