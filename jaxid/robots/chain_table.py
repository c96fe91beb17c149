"""A tree without branches as the table of a serial arm: frames turned so that z is each axis."""

from __future__ import annotations

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.dynamics.kinematics import ArmTable, geometry_of
from jaxid.robots.tree import Tree, turned


def table_of(tree: Tree) -> ArmTable:
    """The chain of a tree that has one limb, frames turned so that z is each joint's axis."""
    if tree.couplings or any(up != k - 1 for k, up in enumerate(tree.parent)):
        raise UsageError(
            f"{tree.file}: the recorded joints are {len(tree.limbs())} limbs or branch; identify"
            " takes one chain at a time: name its end by --tip (or [model] tip):"
            f" {', '.join(tree.ends)}"
        )
    geometry, inertia, before = [], [], np.eye(4)
    for k in range(tree.n):
        turn = np.eye(4)
        turn[:3, :3] = z_to(tree.axis[k])
        offset = -tree.reference[k]
        here = before @ tree.place[k] @ turn
        geometry.append(geometry_of(here))
        if tree.slides[k]:
            geometry[-1] = (*geometry[-1][:2], geometry[-1][2] + offset, *geometry[-1][3:])
        else:
            geometry[-1] = (*geometry[-1][:3], geometry[-1][3] + offset, *geometry[-1][4:])
        before = np.linalg.inv(turn)
        inertia.append(turned(tree.inertia[k], before))
    a, alpha, d, theta, b, gamma = np.array(geometry).T
    return ArmTable(
        a=a,
        alpha=alpha,
        d=d,
        theta=theta,
        b=b,
        gamma=gamma,
        prismatic=tree.slides,
        inertia=np.array(inertia),
        drive_inertia=tree.armature.copy(),
        tool=before,
        joints=tree.joints,
        lower=tree.lower,
        upper=tree.upper,
        velocity=tree.velocity,
        effort=tree.effort,
        viscous=tree.damping[:, 0].copy(),
        coulomb=tree.frictionloss.copy(),
    )


def z_to(axis: np.ndarray) -> np.ndarray:
    """The smallest rotation that takes z into the axis; about x where the axis is -z."""
    c = axis[2]
    if c < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    v = np.array([-axis[1], axis[0], 0.0])  # z x axis
    S = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + S + S @ S / (1 + c)
