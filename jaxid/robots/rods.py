"""A robot of slender rods, for a model that is given no file."""

from __future__ import annotations

import numpy as np

from jaxid.robots.tree import Tree


def chain_of_rods(n: int, length: float, mass: float) -> Tree:
    """A planar chain of slender rods (m, kg) hanging down, joints about y."""
    m, l = mass, length
    phi = np.array([m * l * l / 3, 0, 0, m * l * l / 3, 0, 1e-4 * m, 0, 0, -m * l / 2, m])
    place = np.tile(np.eye(4), (n, 1, 1))
    place[1:, 2, 3] = -l
    zero, endless = np.zeros(n), np.full(n, np.inf)
    return Tree(
        file="",
        joints=tuple(f"joint{k + 1}" for k in range(n)),
        links=tuple(f"link{k + 1}" for k in range(n)),
        parent=tuple(range(-1, n - 1)),
        slides=(False,) * n,
        axis=np.tile([0.0, 1.0, 0.0], (n, 1)),
        place=place,
        reference=zero,
        inertia=np.tile(phi, (n, 1)),
        anchor=np.zeros((n, 3)),
        armature=zero,
        damping=np.zeros((n, 3)),
        frictionloss=zero,
        stiffness=zero,
        spring=zero,
        lower=-endless,
        upper=endless,
        velocity=endless,
        effort=endless,
    )
