"""An identification carried back: base parameters are combinations, so the nearest bodies that can
exist are taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.wording import stem_and_number
from jaxid.dynamics.base_parameters import standard_values
from jaxid.models.effects import ConstantTorque, PowerLawFriction, StribeckFriction
from jaxid.robots.arms import table_of
from jaxid.robots.chain_table import z_to
from jaxid.robots.export.apply import carried
from jaxid.robots.export.outcome import ExportOutcome, Named, Number, number, tables
from jaxid.robots.export.sheet import body_before, from_ten, of_tree, RobotChange, Sheet
from jaxid.robots.tree import Tree, turned


TEN = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "mx", "my", "mz", "m")
#: Rounds of projections, and the share of a base parameter's size at which they end.
ROUNDS, CLOSE = 5000, 1e-8
#: Speed over which the extra dry friction of the stribeck law fades, rad/s: see
#: `identification.regression`.
FADES = 0.1
NEAREST = (
    "a combination of several bodies' numbers: the bodies nearest to the file's that can exist"
    " (positive, triangle inequality) and have it were taken"
)


def identified(found: ExportOutcome, tree: Tree, path: Path | None) -> Sheet:
    """The sheet of an identification. Raises `UsageError` where its parameters are not those of the
    file's joints.
    """
    own = found.robot.get("joints") or []
    if own and all(j in tree.joints for j in own):
        tree = tree.locked(_held(tree, own, found.robot["held"]))
    friction = found.content.get("friction") or []
    if not isinstance(friction, list):
        raise UsageError("friction of the result is not a list")
    tree = _chain(tree, [str(row.get("joint")) for row in tables(friction)], path)
    sheet = of_tree(tree, tree.joints, found.robot)
    _bodies(sheet, found, tree)
    return carried(
        sheet,
        replace(found, parameters=_friction(friction, tree), effects=_effects(friction, tree)),
    )


def _held(tree: Tree, own: list[str], held: Mapping[str, float]) -> dict[str, float]:
    """Where joints stand that are not the identification's `own`: as it says, else neutral."""
    out = dict(held)
    for joint in tree.leading:
        if joint not in own and joint not in held:
            out[joint] = tree.neutral(joint)
    return out


def _chain(tree: Tree, names: list[str], path: Path | None) -> Tree:
    """The tree with all joints held that were not identified: as in the identification, they stand
    at zero, and what hangs on them belongs to the link that carries it. Raises `UsageError` where
    it is not plain which were.
    """
    if len(names) == tree.n:
        return tree
    chain = _in_file(tree, names)
    if chain is None:
        raise UsageError(
            f"{path} has the joints {', '.join(tree.joints)}, the identification"
            f" {', '.join(names)}: say which these are under [model.joints] of dataset.toml (q1 ="
            ' "NAME"), and identify again'
        )
    return tree.locked({j: 0.0 for j in tree.joints if j not in chain})


def _in_file(tree: Tree, names: list[str]) -> tuple[str, ...] | None:
    """The joints of that name, else those of the one chain from the base that has as many."""
    if all(name in tree.joints for name in names):
        return tuple(names)
    chains = [tree.path_to(link) for link in tree.links if link]
    as_long = [chain for chain in chains if len(chain) == len(names)]
    return as_long[0] if len(as_long) == 1 else None


def _friction(rows: list[Any], tree: Tree) -> dict[str, Number]:
    """Friction under the names of a fit."""
    out: dict[str, Number] = {}
    for joint, row in zip(tree.joints, rows, strict=True):
        power = "exponent" in row
        for key, name in (("F_c", "frictionloss"), ("F_v", "damping"), ("F_3", "cubic_damping")):
            if key in row and not (key == "F_v" and power):
                out[f"{name}@{joint}"] = _entry(key, row[key])
    return out


def _effects(rows: list[Any], tree: Tree) -> tuple[Named, ...]:
    """What of friction is an effect: an offset, extra dry friction at low speed, a power of the
    speed.
    """
    out = []
    for joint, row in zip(tree.joints, rows, strict=True):
        if "offset" in row:
            out.append(
                Named(ConstantTorque.name, joint, {"torque": _entry("offset", row["offset"])})
            )
        if "F_s" in row:
            out.append(
                Named(
                    StribeckFriction.name,
                    joint,
                    {"extra": _entry("F_s", row["F_s"]), "speed": Number(FADES, None, "rad/s")},
                )
            )
        if "exponent" in row and "F_v" in row:
            numbers = {
                "coefficient": _entry("F_v", row["F_v"]),
                "exponent": _entry("exponent", row["exponent"]),
            }
            out.append(Named(PowerLawFriction.name, joint, numbers))
    return tuple(out)


def _entry(name: str, entry: Any) -> Number:
    std = entry.get("std") if isinstance(entry, Mapping) else None
    return Number(
        number(name, entry),
        float(std) if isinstance(std, int | float) else None,
        str(entry.get("unit") or "")[:40],
    )


def _bodies(sheet: Sheet, found: ExportOutcome, tree: Tree) -> None:
    from jaxid.models import SerialArm

    arm: Any = SerialArm(table_of(tree))
    base = arm.base()
    rows = _base_rows(found, tree, base.names)
    start = standard_values(arm, base.standard)
    phi, off = _standard(found, base, rows, start)
    _set_bodies(sheet, tree, dict(zip(base.standard, phi, strict=True)))
    for name, before, value in zip(base.standard, start, phi, strict=True):
        kind, j = _kind_and_joint(name)
        if kind == "Ia" and value != before and tree.links[j]:
            sheet.set(tree.joints[j], armature=float(value))
    note = NEAREST
    if off > 1e-4:
        note += f"; they are {100 * off:.2g} % of the largest parameter off"
    sheet.record(_base_change(tree, name, rows[name], note) for name in base.names)


def _base_rows(
    found: ExportOutcome, tree: Tree, names: tuple[str, ...]
) -> dict[str, Mapping[str, Any]]:
    """What the result says of each base parameter. Raises `UsageError` where it has others."""
    rows = {str(row.get("name")): row for row in tables(found.content.get("base_parameters"))}
    lacking = [name for name in names if name not in rows]
    if lacking or len(rows) != len(names):
        raise UsageError(
            f"the base parameters of the result are not those of {tree.file}:"
            f" {', '.join(lacking or rows)}"
        )
    return rows


def _standard(
    found: ExportOutcome, base: Any, rows: Mapping[str, Mapping[str, Any]], start: np.ndarray
) -> tuple[np.ndarray, float]:
    """(standard parameters, how far their base parameters are off): the result's own where it has
    all of them, else the nearest of bodies that can exist.
    """
    stated = found.content.get("standard_parameters")
    if isinstance(stated, Mapping) and all(name in stated for name in base.standard):
        return np.array([number(name, stated[name]) for name in base.standard]), 0.0
    beta = np.array([number(name, rows[name]) for name in base.names])
    return nearest_bodies(start, base.K, beta, base.standard)


def _set_bodies(sheet: Sheet, tree: Tree, standard: Mapping[str, float]) -> None:
    """Each link's inertia by its ten standard parameters."""
    for k in range(tree.n):
        link = tree.links[k]
        if not link:
            continue
        ten = np.array([standard[f"{kind}{k + 1}"] for kind in TEN])
        turn = np.eye(4)
        turn[:3, :3] = z_to(tree.axis[k])
        shift = np.eye(4)
        shift[:3, 3] = tree.anchor[k]
        after, _ = from_ten(turned(turned(ten, turn), shift))
        sheet.bodies[link] = body_before(tree, link), after


def _kind_and_joint(name: str) -> tuple[str, int]:
    """`Ixx3` is Ixx of joint number 2, counted from 0."""
    kind, joint = stem_and_number(name)
    return kind, int(joint) - 1


def _base_change(tree: Tree, name: str, row: Mapping[str, Any], note: str) -> RobotChange:
    """What is said of a base parameter, at the first link with a name that it moves."""
    kind, j = _kind_and_joint(name)
    quantity, place = "inertial", next(filter(None, tree.links[j:]), tree.links[j])
    if kind == "Ia":
        quantity, place = "armature", tree.joints[j]
    if not row.get("identifiable", True):
        note += "; the data do not determine it"
    return RobotChange(
        effect=name,
        location=tree.joints[j],
        quantity=quantity,
        place=place,
        value=number(name, row),
        before=None,
        unit=str(row.get("unit") or "")[:40],
        note=note,
    )


def nearest_bodies(
    phi: np.ndarray, K: np.ndarray, beta: np.ndarray, names: tuple[str, ...]
) -> tuple[np.ndarray, float]:
    """(standard parameters near `phi` with K phi = beta whose bodies can exist, how far K phi is
    off: share of the largest).

    Alternating projections with Dykstra's correction between the affine set and the cone of
    positive semidefinite pseudo-inertias (Wensing, Kim, Slotine 2018), in the Frobenius norm of
    those with lengths counted by the robot's own.
    """
    n = sum(name.startswith("m") and name[1:].isdigit() for name in names)
    place = {name: i for i, name in enumerate(names)}
    link = np.zeros((n, len(TEN)), int)
    for k in range(n):
        link[k] = [place[f"{kind}{k + 1}"] for kind in TEN]
    drives = np.array([i for name, i in place.items() if name.startswith("Ia")], int)
    mass = max(float(np.sum(np.abs(phi[link[:, 9]]))), 1e-6)
    length = max(float(np.sqrt(np.abs(phi[link[:, [0, 3, 5]]]).max() / mass)), 1e-3)
    scale = np.array([*[mass * length**2] * 6, *[mass * length] * 3, mass])
    D = np.ones(len(names))
    D[link] = scale
    D[drives] = mass * length**2
    # Coordinates in which the cone's projection is Euclidean: entries of the scaled pseudo-inertia,
    # off its diagonal by sqrt 2.
    B = np.zeros((10, 10))
    for c in range(10):
        P = _pseudo(np.eye(10)[c])
        B[:, c] = _vector(P)
    T = np.diag(1 / D)
    for rows in link:
        T[np.ix_(rows, rows)] = B @ np.diag(1 / scale)
    back = np.linalg.inv(T)
    A = K @ back
    size = np.maximum(np.abs(A) @ np.abs(T @ phi), 1e-9)
    A, b = A / size[:, None], beta / size
    pull = np.linalg.pinv(A)
    x, correction = T @ phi, np.zeros(len(names))
    for _ in range(ROUNDS):
        y = x + pull @ (b - A @ x)
        z = y + correction
        x = _possible(z, link, drives)
        correction = z - x
        if np.abs(A @ x - b).max() < CLOSE:
            break
    phi = back @ x
    return phi, float(np.abs(K @ phi - beta).max() / max(float(np.abs(beta).max()), 1e-300))


def _pseudo(ten: np.ndarray) -> np.ndarray:
    xx, xy, xz, yy, yz, zz, x, y, z, m = ten
    return np.array(
        [
            [(yy + zz - xx) / 2, -xy, -xz, x],
            [-xy, (xx + zz - yy) / 2, -yz, y],
            [-xz, -yz, (xx + yy - zz) / 2, z],
            [x, y, z, m],
        ]
    )


_UPPER = np.triu_indices(4)
_TWICE = np.where(_UPPER[0] == _UPPER[1], 1.0, np.sqrt(2.0))


def _vector(P: np.ndarray) -> np.ndarray:
    return P[_UPPER] * _TWICE


def _possible(v: np.ndarray, link: np.ndarray, drives: np.ndarray) -> np.ndarray:
    """The nearest point whose pseudo-inertias have no negative eigenvalue and whose drives have no
    negative inertia.
    """
    out = v.copy()
    P = np.zeros((len(link), 4, 4))
    P[:, _UPPER[0], _UPPER[1]] = P[:, _UPPER[1], _UPPER[0]] = v[link] / _TWICE
    values, vectors = np.linalg.eigh(P)
    # A little inside the cone: a body with no extent at all is none that simulators take.
    least = 1e-6 * np.maximum(values[:, -1:], 1e-9)
    P = (vectors * np.maximum(values, least)[:, None, :]) @ vectors.transpose(0, 2, 1)
    out[link] = P[:, _UPPER[0], _UPPER[1]] * _TWICE
    out[drives] = np.maximum(v[drives], 0.0)
    return out
