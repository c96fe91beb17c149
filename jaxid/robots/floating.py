"""A base that floats freely: its freedom as joints of the tree, its momentum conserved.

Between the world and the base stand six joints without mass: three slides, then hinges Rz(yaw)
Ry(pitch) Rx(roll). Nothing acts there, so linear momentum is conserved: the slides are eliminated
exactly, and what is left has the three angles beside the joints. A uniform gravity accelerates all
of it alike and shows nowhere. With M and b of all nodes, T the slides, R the rest:

    M_R = M_RR - M_RT M_TT^-1 M_TR,    b_R = b_R - M_RT M_TT^-1 b_T,    M_TT = mass of all times the unit matrix

Source: Dubowsky and Papadopoulos, The kinematics, dynamics, and control of free-flying and
free-floating space robotic systems, IEEE Trans. Robotics and Automation 9 (1993). The angles are
singular at pitch = +-pi/2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Dataset
from jaxid.robots.tree import FLOATS, Tree, turned


#: The angles of the base, as channels and as the last joints of the model.
ANGLES = FLOATS[:2:-1]
#: Words of the note of a reader that takes a free joint as fixed.
AS_FIXED = "is free: the base is taken as fixed where the file puts it"
#: A recording whose base pitches beyond this is refused: there the angles are no coordinates, rad.
STEEPEST = 1.4


def wanted(dataset: Dataset) -> bool:
    """Whether [model.base] says that the base floats."""
    return dataset.stated.base.get("kind") == "free"


def floating(tree: Tree) -> Tree:
    """The tree on a base that floats; the base's angles are those of the frame of its body in the
    world.

    Raises `UsageError` for a base without mass, and for a file with several bodies that are free to
    move.
    """
    if tree.floats:
        return tree
    bodies = [n for n in tree.notes if AS_FIXED in n]
    if len(bodies) > 1:
        raise UsageError(
            f"{tree.file}: {len(bodies)} bodies of it are free to move; one base can float: take"
            " the others out"
        )
    if tree.lifted is not None:
        raise UsageError(
            f"{tree.file}: gravcomp cancels weight, which a base that floats has not: take it out"
        )
    if taken := [n for n in FLOATS if n in tree.joints]:
        raise UsageError(
            f"{tree.file}: a joint is called {taken[0]!r}, which is the name of a coordinate of a"
            " free base: rename it"
        )
    root = np.array(tree.root).reshape(4, 4)
    into = np.linalg.inv(root)
    trunk = turned(np.array(tree.trunk), into)
    if not trunk[9] > 0:
        raise UsageError(
            f'{tree.file}: [model.base] kind = "free" needs mass and inertia of the base'
            f" ({tree.carrier}), which it does not state: add its <inertial>"
        )

    def six(a, fill=0.0):
        return np.concatenate([np.full((6, *a.shape[1:]), fill), a])

    place = np.concatenate([np.tile(np.eye(4), (6, 1, 1)), tree.place])
    for k, up in enumerate(tree.parent):
        if up < 0:
            place[6 + k] = into @ tree.place[k]
    inertia = six(tree.inertia)
    inertia[5] = trunk
    axes = np.eye(3)[[0, 1, 2, 2, 1, 0]]
    endless = {"lower": -np.inf, "upper": np.inf, "velocity": np.inf, "effort": np.inf}
    parent = [-1, 0, 1, 2, 3, 4]
    for up in tree.parent:
        parent.append(5 if up < 0 else up + 6)
    zero = ("reference", "anchor", "armature", "damping", "frictionloss", "stiffness", "spring")
    return replace(
        tree,
        joints=(*FLOATS, *tree.joints),
        links=(*("",) * 5, tree.carrier, *tree.links),
        parent=tuple(parent),
        slides=(True,) * 3 + (False,) * 3 + tree.slides,
        axis=np.concatenate([axes, tree.axis]),
        place=place,
        inertia=inertia,
        **{k: six(getattr(tree, k)) for k in zero},
        **{k: six(getattr(tree, k), fill) for k, fill in endless.items()},
        notes=tuple(n for n in tree.notes if n not in bodies),
        floats=True,
    )


def based(tree: Tree, free: bool) -> Tree:
    """The tree on the base that is meant."""
    return floating(tree) if free else tree


def without_slides(M: Any, bias: Any) -> tuple[Any, Any]:
    """Mass matrix and bias [n] of all nodes with the base's slides eliminated; their rows are 0."""
    T = slice(0, 3)
    across, m = M[:, T], M[0, 0]
    kept = np.arange(M.shape[0]) >= 3
    M = jnp.where(kept[:, None] & kept, M - across @ across.T / m, 0.0)
    return M, jnp.where(kept, bias - across @ bias[T] / m, 0.0)


def balanced(force: Callable[[Any], Any], a: Any, body: Any) -> Any:
    """Forces at all nodes of accelerations `a`, the base's slides accelerated so that none is left
    there; `force` is affine.
    """
    return force(a.at[:3].set(-force(a)[:3] / jnp.sum(body.bodies.inertia[9])))


def refuse_unmeasured(tree: Tree, dataset: Dataset) -> None:
    """Raises `UsageError` where a recording does not show how a free base turns, or shows it where
    the angles are singular.
    """
    outputs = dataset.output_names
    if lacking := [a for a in ANGLES if a not in outputs]:
        raise UsageError(
            f"a free base needs its attitude as outputs {', '.join(ANGLES)} (rad; Rz(yaw) Ry(pitch)"
            " Rx(roll) of its body's frame "
            f"in the world, unwrapped), and {', '.join(lacking)} is missing: record it, or give it"
            ' role = "output"'
        )
    at = outputs.index("base_pitch")
    for e in dataset.experiments:
        steepest = float(np.max(np.abs(e.y[:, at])))
        if steepest > STEEPEST:
            raise UsageError(
                f"experiment {e.name!r}: the base pitches to {steepest:.3g} rad, and at 1.57 roll"
                " and yaw are not coordinates any more: turn the frame of the base in the file so"
                " that it pitches less, or cut the run there (window_s)"
            )


def refuse_free(command: str, dataset: Dataset) -> None:
    """Raises `UsageError` for a command that takes no robot on a free base."""
    if wanted(dataset):
        raise UsageError(
            f'jaxid {command} takes no robot on a free base ([model.base] kind = "free"). Fit it'
            " (jaxid fit), identify it by its momentum (jaxid fit --residual momentum) or simulate"
            " it; or state a base that is fixed"
        )
