"""URDF: the user's own text with damping, friction, limits, inertials and origins changed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.small_files import read_small
from jaxid.robots.export.law_code import code, lawful
from jaxid.robots.export.outcome import ExportOutcome
from jaxid.robots.export.sheet import from_ten, JointNumbers, LinkInertia, Sheet
from jaxid.robots.export.target import (
    APPROXIMATE,
    coded,
    EXACT,
    Field,
    joined,
    NONE,
    rows_of,
    Written,
)
from jaxid.robots.export.xml_text import Element, number as digits, numbers, XmlText
from jaxid.robots.tree import motion, roll_pitch_yaw
from jaxid.robots.urdf import read_links


NAME, VERSION, FILES = "urdf", "URDF of ROS 2", (".urdf",)
FIELDS = {
    "damping": Field("joint[{joint}]/dynamics@damping"),
    "frictionloss": Field("joint[{joint}]/dynamics@friction", note="MuJoCo reads it as frictionloss, Drake and "
                          "Gazebo's bullet ignore it"),
    "force": Field("joint[{joint}]/limit@effort", one=True),
    "highest": Field("joint[{joint}]/limit@effort", one=True),
    "bias": Field("joint[{joint}]/origin", note="turned back by as much, limits shifted"),
    "inertial": Field("link[{link}]/inertial"),
}  # fmt: skip
ELSEWHERE = {
    "armature": "a URDF has no field for it: set it in the simulator (MuJoCo armature, Drake rotor_inertia x gear_ratio^2)",
    "gravity": "a URDF has no gravity: turn the root link's origin, or set it in the simulator",
    "kp": "a URDF has no drive: set it in the controller", "kd": "a URDF has no drive: set it in the controller",
    "ki": "a URDF has no drive: set it in the controller", "offset": "a URDF has no drive: set it in the controller",
    "delay": "a URDF has no drive: delay the command in the controller", "lag": "a URDF has no drive: filter the command",
    "drive": "a URDF has no drive: multiply the torque by it", "lowest": "a URDF has one limit for both directions",
    "torque": "a URDF has no drive: add it to the joint's torque each step",
}  # fmt: skip


def write(sheet: Sheet, found: ExportOutcome, path: Path | None) -> Written:
    """The patched file, and `effects.py` for laws that no field says."""
    fields = dict(FIELDS)
    out = Written()
    if path is None:
        out.notes += (
            []
            if sheet.tree
            else ["no robot's file is known, so nothing was patched: give it with --robot FILE"]
        )
    else:
        text = read_small(path).decode("utf-8-sig")
        patch = XmlText(text)
        _patch(patch, sheet, path, text, fields)
        new = patch.result()
        read_links(path, new)  # what was written can be read
        out.files[path.name] = new
    out.rows = rows_of(sheet, fields, coded("effects.py", ELSEWHERE, NONE))
    if path is not None and not any(r.how in (EXACT, APPROXIMATE) for r in out.rows):
        out.files.clear()
    if laws := lawful(c for c, r in zip(sheet.changes, out.rows, strict=True) if r.how == "code"):
        out.files["effects.py"] = code(
            laws, "Laws that no field of a URDF says: call them in your simulator at each step."
        )
    return out


def _patch(patch: XmlText, sheet: Sheet, path: Path, text: str, fields: dict[str, Field]) -> None:
    root = patch.elements[0]

    def named(tag, name):
        return next(
            (c for c in root.children if c.name == tag and c.attributes.get("name") == name), None
        )

    for joint, now in sheet.changed.items():
        if element := named("joint", joint):
            _joint(patch, element, sheet, joint, sheet.before[joint], now)
    robot, _ = read_links(path, text)
    for link, (before, after) in sheet.bodies.items():
        element = named("link", link)
        if element is None:
            raise UsageError(f"{path}: there is no link {link!r}")
        new, off = from_ten(robot.inertia[link] + after.ten - before.ten)
        _inertial(patch, element, new)
        if off > 1e-6:
            note = f"the nearest body that can exist, {100 * off:.2g} % of its largest number off"
            fields["inertial"] = Field(
                FIELDS["inertial"].name,
                APPROXIMATE,
                joined(fields["inertial"].note, f"{link}: {note}"),
            )


def _child(patch: XmlText, element: Element, tag: str, attributes: dict[str, str]) -> None:
    """Attributes at a child element, which is made where there is none."""
    child = element.child(tag)
    if child is not None:
        patch.set(child, attributes)
    else:
        inside = " ".join(f'{k}="{v}"' for k, v in attributes.items())
        patch.insert(element, f"<{tag} {inside}/>")


def _joint(
    patch: XmlText, element: Element, sheet: Sheet, joint: str, was: JointNumbers, now: JointNumbers
) -> None:
    tree = sheet.own_tree
    k = tree.joints.index(joint)
    own: dict[str, str] = {}
    if now.damping != was.damping:
        own["damping"] = digits(tree.damping[k, 0] + now.damping - was.damping)
    if now.frictionloss != was.frictionloss:
        own["friction"] = digits(tree.frictionloss[k] + now.frictionloss - was.frictionloss)
    if own:
        _child(patch, element, "dynamics", own)
    limit: dict[str, str] = {}
    if (now.lowest, now.highest) != (was.lowest, was.highest) and np.isfinite(
        [now.lowest, now.highest]
    ).any():
        limit["effort"] = digits(max(abs(v) for v in (now.lowest, now.highest) if np.isfinite(v)))
    if now.bias != was.bias:
        shift = now.bias - was.bias
        T = _origin(element) @ motion(tree.axis[k], tree.slides[k], -shift)
        _child(
            patch,
            element,
            "origin",
            {"xyz": numbers(T[:3, 3]), "rpy": numbers(roll_pitch_yaw(T[:3, :3]))},
        )
        if np.isfinite([tree.lower[k], tree.upper[k]]).all():
            limit |= {
                "lower": digits(tree.lower[k] + shift),
                "upper": digits(tree.upper[k] + shift),
            }
    if limit:
        full = {"effort": "0", "velocity": "0"} if element.child("limit") is None else {}
        _child(patch, element, "limit", full | limit)


def _origin(element: Element) -> np.ndarray:
    from jaxid.robots.tree import rotation

    T, origin = np.eye(4), element.child("origin")
    if origin is not None:

        def vector(key):
            return [float(v) for v in origin.attributes.get(key, "0 0 0").split()]

        T[:3, :3], T[:3, 3] = rotation(*vector("rpy")), vector("xyz")
    return T


def _inertial(patch: XmlText, element: Element, body: LinkInertia) -> None:
    I = body.inertia
    tensor: dict[str, str] = dict(
        zip(
            ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
            map(digits, I[np.triu_indices(3)]),
            strict=True,
        )
    )
    inertial = element.child("inertial")
    if inertial is None:
        inside = " ".join(f'{k}="{v}"' for k, v in tensor.items())
        place = (
            f'<origin xyz="{numbers(body.com)}" rpy="0 0 0"/><mass value="{digits(body.mass)}"/>'
        )
        return patch.insert(element, f"<inertial>{place}<inertia {inside}/></inertial>")
    _child(patch, inertial, "origin", {"xyz": numbers(body.com), "rpy": "0 0 0"})
    _child(patch, inertial, "mass", {"value": digits(body.mass)})
    _child(patch, inertial, "inertia", tensor)
