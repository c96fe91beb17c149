"""What a robot's file, or a dataset, states beside what the data say; and the model with the
numbers of the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxid.numerics.stated_numbers import apart, REFUTED
from jaxid.robots.steps import nearest
from jaxid.robots.tree import Tree


#: Numbers that are always in the file, whatever their value.
ALWAYS = ("mass", "com_x", "com_y", "com_z", "kp", "kd", "lowest", "highest")


def stated(binding: Any, found: Mapping[int, Any]) -> dict[int, dict[str, Any]]:
    """Rows of the table by place in the layout: numbers that a file or the dataset states and that
    were fitted, each by itself; `found` by place in the layout.
    """
    tree = _tree_of(binding)
    rows: dict[int, dict[str, Any]] = {}
    for i in found:
        if i not in binding.nominal:  # an effect's: no file has it
            continue
        if states(binding, i):
            rows[i] = _row(binding, found, i, tree)
    return rows


#: Numbers of a shape, which may have the name of a link.
OF_SHAPES = ("sliding_friction",)


def _row(binding: Any, found: Mapping[int, Any], i: int, tree: Tree | None) -> dict[str, Any]:
    """One number as it is stated and as it was fitted."""
    kind, _, place = binding.layout.entries[i].name.partition("@")
    estimate, value = found[i], float(binding.theta[i])
    added, off = 0.0, estimate.value - value
    exact = binding.chain.mechanism.first_order_steps is None  # else these were simulated
    if tree is not None and kind == "armature" and exact:
        added = added_by_steps(binding, found, tree, place)
    if added:
        off = nearest(value, estimate.value, added) - value
    deviation = apart(value + off, value, estimate.std)
    # Of a number that is another one the file has to state what its simulator's steps do not
    # add by themselves.
    refuted = deviation is not None and abs(deviation) > REFUTED
    fitted = estimate.value - added if added and refuted else estimate.value
    link, joint = _link_and_joint(tree, kind, place)
    unit = "" if estimate.unit == "1" else f" {estimate.unit}"
    text = (
        f"{kind.replace('_', ' ')} of {place or binding.chain.mechanism.name}: {fitted:.4g}{unit},"
        f" stated {value:.4g}"
    )
    if added:
        text += f"; the file's own steps add {added:.2g} to it"
    if deviation is not None:
        text += f" ({abs(deviation):.1f} standard deviations)"
    return {
        "joint": joint,
        "link": link,
        "parameter": kind,
        "stated": value,
        "fitted": fitted,
        "std": estimate.std,
        "unit": estimate.unit,
        "deviation": deviation,
        "text": text,
    }


def _link_and_joint(tree: Tree | None, kind: str, place: str) -> tuple[str, str]:
    """The link and the joint of a number at a place: a joint, a link or a shape."""
    link, joint = _link(tree, place), place
    if tree is None:
        return link, joint
    if place in tree.links:
        link = place
    if place not in tree.joints:
        joint = tree.joints[tree.links.index(place)] if place == link else ""  # "": of a shape
    if kind in OF_SHAPES:
        link = place
    return link, joint


def added_by_steps(binding: Any, found: Mapping[int, Any], tree: Tree, joint: str) -> float:
    """What the steps of the file's simulator add to a joint's armature."""
    if tree.steps is None:
        return 0.0

    def value(name: str) -> float:
        if name not in binding.layout.names:
            return 0.0
        i = binding.layout.index(name)
        return float(found[i].value if i in found else binding.theta[i])

    return tree.steps.inertia(
        value(f"damping@{joint}"), value(f"kd@{joint}") * (value(f"gain@{joint}") or 1.0)
    )


def states(binding: Any, i: int) -> bool:
    """Whether a robot's file or the dataset states the number at this position of the layout."""
    if i in binding.stated:
        return True
    tree = _tree_of(binding)
    kind = binding.layout.entries[i].name.partition("@")[0]
    return tree is not None and _states(tree, kind, float(binding.theta[i]))


def _tree_of(binding: Any) -> Tree | None:
    """The tree of a robot; None of any other model."""
    held = getattr(binding.chain.mechanism, "tree", None)
    return None if held is None else held.tree


def _states(tree: Tree, kind: str, value: float) -> bool:
    """Whether the file says this number: a URDF has no armature, and a zero in it is no
    statement.
    """
    if kind in ALWAYS or value != 0:
        return True
    of_mjcf = not tree.file.lower().endswith(".urdf")
    return of_mjcf and kind in ("armature", "damping", "frictionloss")


def _link(tree: Tree | None, joint: str) -> str:
    return tree.links[tree.joints.index(joint)] if tree is not None and joint in tree.joints else ""


def sentences(rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """What differs from the file, most certain first: one sentence for the first moment of a link,
    one for each other number.
    """
    out: list[tuple[float, str]] = []
    wrong = [r for r in rows if r["deviation"] is not None and abs(r["deviation"]) > REFUTED]
    moments = [r for r in rows if r["parameter"].startswith("com_")]
    for link in dict.fromkeys(r["link"] for r in wrong if r["parameter"].startswith("com_")):
        own = {r["parameter"][-1]: r for r in moments if r["link"] == link}
        out += _first_moment(link, list(own.values()))
    for r in wrong:
        if not r["parameter"].startswith("com_"):
            out.append((abs(r["deviation"]), r["text"]))
    return tuple(text for _, text in sorted(out, key=lambda one: -one[0]))


def _first_moment(link: str, rows: Sequence[Mapping[str, Any]]) -> list[tuple[float, str]]:
    """(deviation, sentence) where a link's first moment is another one along that of the file."""
    was, now = np.array([r["stated"] for r in rows]), np.array([r["fitted"] for r in rows])
    std = np.array([r["std"] or np.nan for r in rows])
    size = float(was @ was)
    if size < 1e-12 or not np.isfinite(std).all():
        return []
    share = float((now - was) @ was / size)
    doubt = float(np.sqrt(np.sum((was * std) ** 2)) / size)
    if abs(share) <= max(REFUTED * doubt, 0.01):
        return []
    more = f"{100 * abs(share):.0f} % {'more' if share > 0 else 'less'}"
    return [(abs(share) / doubt, f"link {link} carries {more} first moment than the file says")]


def as_it_stands(binding: Any) -> tuple[np.ndarray, str]:
    """(numbers of the model as the file has them, a sentence on its drive)."""
    from jaxid.robots.drives import file_law

    theta, mechanism = binding.theta.copy(), binding.chain.mechanism
    tree: Tree = mechanism.tree.tree
    joints = binding.chain.signature.joints
    if mechanism.drive_law is None or not all(
        j in tree.actuators and tree.actuators[j].kind == "position" for j in joints
    ):
        return (
            theta,
            f"the file as it stands{', under the stated law' if mechanism.drive_law else ''}",
        )
    law = file_law(tree, tree.leading)
    for field, values in law.numbers.items():
        for joint, value in zip(joints, values, strict=True):
            theta[binding.layout.index(f"{field}@{joint}")] = value
    return theta, "the file as it stands, under its own actuators"
