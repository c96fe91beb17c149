"""Which numbers of a robot a fit moves, and within which bounds."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Any

import numpy as np

from jaxid.base.wording import names_of
from jaxid.dynamics.parameter import ParameterSpec
from jaxid.robots.bodies import BODY
from jaxid.robots.floating import ANGLES
from jaxid.robots.tree import Tree


def held(robot: Any) -> frozenset[str]:
    """Names of the numbers that no fit moves unless it is told to."""
    tree = robot.tree.tree
    joints, fitted = robot.signatures[0].joints, set(names_of(robot.fitted))
    out = _all(BODY, robot.links) - tree.free_moments()
    out |= _all(("encoder_bias", "stiffness", "quadratic_damping"), robot.joints)
    out |= {"base_roll", "base_pitch"}
    out |= {f"armature@{j}" for j in robot.joints if j not in tree.driven}
    if robot.floats:
        out |= _all(("damping", "frictionloss"), ANGLES)
    law = ("kp", "kd", "ki", "lowest", "highest", "delay", "timeconst")
    return frozenset(out | _all(law, joints) - fitted)


def _all(fields: Iterable[str], places: Iterable[str]) -> set[str]:
    return {f"{field}@{place}" for field, place in product(fields, places)}


def spec_of(robot: Any, field: str, place: int, spec: ParameterSpec) -> ParameterSpec:
    """Bounds by the robot's own size."""
    tree: Tree = robot.tree.tree
    total = max(float(np.sum(tree.inertia[:, 9])), 1e-6)
    reach = max(float(np.sum(np.linalg.norm(tree.place[:, :3, 3], axis=1))), 1e-2)
    if field == "mass":
        return spec._replace(upper=10 * total, scale=0.01 * total)
    if field.startswith("com_"):  # within about the link's own size of where the file has it
        about = float(getattr(robot, field)[place])
        size = 0.5 * tree.size(robot.carriers[place])
        return spec._replace(lower=about - size, upper=about + size, scale=0.05 * size)
    if field in BODY:
        lower = 0.0 if field in ("gyration_xx", "gyration_yy", "gyration_zz") else -reach
        return spec._replace(lower=lower, upper=reach, scale=0.01 * reach)
    if field == "armature":
        size = max(float(tree.swung()[place]), float(tree.armature[place]))
        return spec._replace(upper=20 * size, scale=0.1 * size)
    return spec
