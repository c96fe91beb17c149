"""From what a result says to the numbers of a robot after it: each effect and each fitted number,
one after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from jaxid.base.wording import stem_and_number
from jaxid.dynamics.export_law import StandsFor
from jaxid.robots.bodies import BODY
from jaxid.robots.export.law_code import kind_of, own_number
from jaxid.robots.export.outcome import ExportOutcome, Named, Number
from jaxid.robots.export.sheet import (
    body_before,
    from_numbers,
    LinkInertia,
    numbers_of,
    RobotChange,
    Sheet,
    turned_gravity,
)
from jaxid.robots.tree import roll_pitch_yaw, rotation


#: Fitted number `FIELD@JOINT` -> quantity of the joint.
JOINT = {
    "damping": "damping",
    "quadratic_damping": "quadratic",
    "cubic_damping": "cubic",
    "frictionloss": "frictionloss",
    "armature": "armature",
    "stiffness": "stiffness",
    "springref": "springref",
    "encoder_bias": "bias",
    "kp": "kp",
    "kd": "kd",
    "ki": "ki",
    "offset": "offset",
    "lowest": "lowest",
    "highest": "highest",
    "delay": "delay",
    "timeconst": "lag",
}
#: Numbers of models that are no robot's -> quantity of their joint.
#: The friction of a shape on the ground.
GROUND = "sliding_friction"
PLAIN = {"viscous": "damping", "coulomb": "frictionloss", "armature": "armature"}
#: Numbers of a joint that are one thing to say.
FORCE = ("lowest", "highest")


def carried(sheet: Sheet, found: ExportOutcome) -> Sheet:
    """The sheet after everything that the result names. Each effect and each number has at least
    one `RobotChange`.
    """
    done = set()
    for effect in found.effects:
        if own := own_number(effect.effect):
            done.add(f"{own.fitted}@{sheet.joint(effect.location)}")
    _numbers(sheet, found, done)
    for effect in found.effects:
        before = len(sheet.changes)
        _effect(sheet, effect)
        if len(sheet.changes) == before:
            _law(sheet, effect)
    _left_out(sheet, found)
    sheet.changes = [_final(sheet, c) for c in sheet.changes]
    return sheet


def _final(sheet: Sheet, change: RobotChange) -> RobotChange:
    """The change with the number that stands there in the end: several may act on one."""
    if change.place not in sheet.after or not hasattr(sheet.after[change.place], change.quantity):
        return change
    value = getattr(sheet.after[change.place], change.quantity)
    return replace(change, value=value, before=getattr(sheet.before[change.place], change.quantity))


def _numbers(sheet: Sheet, found: ExportOutcome, done: set[str]) -> None:
    links: dict[str, dict[str, float]] = {}
    for name, number in found.parameters.items():
        field, _, place = name.partition("@")
        if name in done:
            continue
        tree = sheet.tree
        if field in JOINT and place in sheet.after:
            _joint_number(sheet, field, place, JOINT[field], number)
        elif tree is not None and field in BODY and place in tree.links:
            links.setdefault(place, numbers_of(tree, place))[field] = number.value
        elif tree is not None and field == GROUND:
            _record(sheet, number, effect=GROUND, location=place, quantity=GROUND, place=place)
        elif not (tree is not None and field in ("base_roll", "base_pitch")):
            _plain_number(sheet, name, number)
    for link, numbers in links.items():
        _body_numbers(sheet, found, link, numbers)
    _base(sheet, found)


def _record(
    sheet: Sheet,
    number: Number,
    *,
    effect: str,
    location: str = "",
    quantity: str = "",
    place: str = "",
    before: Any = None,
) -> None:
    """Notes what a number changes, as it stands."""
    change = RobotChange(
        effect=effect,
        location=location,
        quantity=quantity,
        place=place,
        value=number.value,
        before=before,
        unit=number.unit,
        note=number.doubt,
    )
    sheet.record([change])


def _body_numbers(
    sheet: Sheet, found: ExportOutcome, link: str, numbers: Mapping[str, float]
) -> None:
    """The inertia of a link by its ten numbers."""
    tree = sheet.own_tree
    own = {}
    for name, number in found.parameters.items():
        field, _, place = name.partition("@")
        if place == link and field in BODY:
            own[field] = number
    if not all(number.kept for number in own.values()):
        sheet.bodies[link] = body_before(tree, link), from_numbers(dict(numbers))
    was = numbers_of(tree, link)
    for field, number in own.items():
        _record(
            sheet,
            number,
            effect=field,
            location=link,
            quantity="inertial",
            place=link,
            before=was[field],
        )


def _joint_number(sheet: Sheet, effect: str, joint: str, quantity: str, number: Number) -> None:
    before = getattr(sheet.after[joint], quantity)
    sheet.set(joint, **{quantity: number.value})
    _record(
        sheet,
        number,
        effect=effect,
        location=joint,
        quantity=quantity,
        place=joint,
        before=before,
    )


def _plain_number(sheet: Sheet, name: str, number: Number) -> None:
    """A number of a model that is no robot: friction and armature have a field, others have
    none.
    """
    stem, joint = stem_and_number(name)
    joints = list(sheet.after)
    place = int(joint or 1) - 1
    if stem in PLAIN and place < len(joints):
        _joint_number(sheet, name, joints[place], PLAIN[stem], number)
    elif stem == "offset" and place < len(joints):
        _torque(sheet, name, joints[place], joints[place], number)
    else:
        _record(sheet, number, effect=name)


def _torque(sheet: Sheet, effect: str, location: str, joint: str, number: Number) -> None:
    sheet.set(joint, torque=sheet.after[joint].torque - number.value)
    sheet.record(
        [
            RobotChange(
                effect=effect,
                location=location,
                quantity="torque",
                place=joint,
                value=None,
                before=None,
                unit=number.unit,
                note=number.doubt,
            )
        ]
    )


def _base(sheet: Sheet, found: ExportOutcome) -> None:
    base = found.robot.get("base") or {"roll": 0.0, "pitch": 0.0, "yaw": 0.0}
    now, own = dict(base), {}
    for k in ("roll", "pitch"):
        if f"base_{k}" in found.parameters:
            own[k] = found.parameters[f"base_{k}"]
            now[k] = own[k].value
    if not own or sheet.gravity is None:
        return
    before = (base["roll"], base["pitch"], base["yaw"])
    g = turned_gravity(sheet.gravity[1], now["roll"], now["pitch"], now["yaw"], before)
    sheet.gravity = sheet.gravity[0], g
    sheet.record(
        [
            RobotChange(
                effect=f"base_{k}",
                location="base",
                quantity="gravity",
                place="",
                value=None,
                before=None,
                unit="m/s^2",
                note=n.doubt,
            )
            for k, n in own.items()
        ]
    )


def _left_out(sheet: Sheet, found: ExportOutcome) -> None:
    """Laws of the file that the model did without."""
    named = {e.effect for e in found.effects}
    for name in found.robot.get("without", ()):
        own = own_number(name)
        if own is not None and name not in named:
            quantity = own.quantity
            for joint in sheet.after:
                if getattr(sheet.after[joint], quantity) != 0:
                    sheet.set(joint, **{quantity: 0.0})
                    note = "the model was asked to do without it, and the data did not ask for it"
                    sheet.record(
                        [
                            RobotChange(
                                effect=name,
                                location=joint,
                                quantity=quantity,
                                place=joint,
                                value=0.0,
                                before=None,
                                unit="",
                                note=note,
                            )
                        ]
                    )


# ---- effects


def _unit(effect: Named, number: str) -> str:
    return effect.numbers[number].unit if number in effect.numbers else ""


def _law(sheet: Sheet, effect: Named) -> None:
    """An effect that no number of the robot can say."""
    values = {k: n.value for k, n in effect.numbers.items()}
    units = ", ".join(dict.fromkeys(n.unit for n in effect.numbers.values() if n.unit))
    place = sheet.joint(effect.location)
    sheet.record(
        [RobotChange(effect.effect, effect.location, effect.effect, place, values, None, units)]
    )


def _effect(sheet: Sheet, effect: Named) -> None:
    """What an effect changes of the number that it stands for; nothing where it stands for none."""
    kind = kind_of(effect.effect)
    number = None if kind is None else kind.stands_for
    if kind is None or number is None:
        return
    if number.quantity in PLACED:
        return PLACED[number.quantity](sheet, effect, number)
    joint = sheet.joint(effect.location)
    at_goal = kind.acts_on == "drive" and effect.location.endswith("_cmd")
    if joint and not at_goal:
        _joint_effect(sheet, effect, number, joint)


def _joint_effect(sheet: Sheet, effect: Named, own: StandsFor, joint: str) -> None:
    value = effect.value(own.number)
    after = {own.quantity: value}
    if own.after is not None:
        after = own.after(sheet.after[joint], value, sheet.driven)
    sheet.set(joint, **after)
    said: dict[str, None] = {}
    for name in after:
        said["force" if name in FORCE else name] = None
    for quantity in said:
        if quantity != own.quantity and not _stated(sheet, joint, quantity):
            continue
        unit = None if own.fitted else _units(sheet, joint).get(quantity)
        note = "" if sheet.driven else own.note
        sheet.record([_change(effect, quantity, joint, own.number, note, unit)])


def _stated(sheet: Sheet, joint: str, quantity: str) -> bool:
    """Whether a joint has a number at all, not just a place for it."""
    now = sheet.after[joint]
    if quantity == "force":
        return bool(np.isfinite([now.lowest, now.highest]).any())
    return bool(getattr(now, quantity))


def _units(sheet: Sheet, joint: str) -> dict[str, str]:
    """Units of numbers in which an effect's own is not given."""
    force, x = sheet.force_unit(joint), "m" if sheet.slides(joint) else "rad"
    return {
        "kp": f"{force}/{x}",
        "kd": f"{force} s/{x}",
        "ki": f"{force}/({x} s)",
        "offset": force,
        "force": force,
        "damping": f"{force} s/{x}",
        "drive": "1",
        "springref": x,
    }


def _change(
    effect: Named, quantity: str, joint: str, number: str, note: str = "", unit: str | None = None
) -> RobotChange:
    doubt = effect.numbers[number].doubt
    return RobotChange(
        effect=effect.effect,
        location=effect.location,
        quantity=quantity,
        place=joint,
        value=effect.value(number),
        before=None,
        unit=_unit(effect, number) if unit is None else unit,
        note="; ".join(t for t in (note, doubt) if t),
    )


def _payload(sheet: Sheet, effect: Named, own: StandsFor) -> None:
    """A point mass where `Robot.loaded` has it: beyond the next joint, else the link's centre of
    mass.
    """
    joint, tree = sheet.joint(effect.location), sheet.tree
    if tree is None or not joint:
        return
    k = tree.joints.index(joint)
    while not tree.links[k]:
        k = tree.parent.index(k)
    link, ends = tree.links[k], [i for i, up in enumerate(tree.parent) if up == k]
    before, after = sheet.bodies.get(link, (body_before(tree, link),) * 2)
    at = tree.anchor[k] + tree.place[ends[0]][:3, 3] if ends else after.com
    beyond = np.zeros(3)
    for axis, name in enumerate(("dx", "dy", "dz")):
        if name in effect.numbers:
            beyond[axis] = effect.value(name)
    at = at + beyond
    sheet.bodies[link] = before, with_point(after, effect.value(own.number), at)
    where = "where the next joint is" if ends else "at the link's centre of mass"
    where = f"at {np.round(at, 6).tolist()} m in its frame" if beyond.any() else where
    sheet.record(
        [
            _change(
                effect,
                "inertial",
                link,
                own.number,
                f"a point mass of {effect.value('mass'):.4g} kg {where}",
                "kg",
            )
        ]
    )


def with_point(body: LinkInertia, mass: float, at: np.ndarray) -> LinkInertia:
    """A body with a point mass more."""
    m = body.mass + mass
    com = (body.mass * body.com + mass * at) / m if m else body.com

    def moved(m, d):
        return m * (d @ d * np.eye(3) - np.outer(d, d))

    return LinkInertia(
        m, com, body.inertia + moved(body.mass, body.com - com) + moved(mass, at - com)
    )


def _gravity_offset(sheet: Sheet, effect: Named, own: StandsFor) -> None:
    """Gravity turned in the base's frame, as `Robot.tilted` does it."""
    tree = sheet.tree
    if tree is None or sheet.gravity is None:
        return
    a = effect.value(own.number)
    axis = rotation(*roll_pitch_yaw(tree.place[0][:3, :3])) @ tree.axis[0]
    v = sheet.gravity[1]
    turned = v * np.cos(a) - np.cross(axis, v) * np.sin(a) + axis * (axis @ v) * (1 - np.cos(a))
    sheet.gravity = sheet.gravity[0], turned
    sheet.record(
        [
            _change(
                effect,
                "gravity",
                "",
                own.number,
                f"the base leans by {a:.4g} rad about the axis of {tree.joints[0]}",
                "m/s^2",
            )
        ]
    )


#: What is at no joint, and how it is written.
PLACED: Mapping[str, Callable[[Sheet, Named, StandsFor], None]] = {
    "inertial": _payload,
    "gravity": _gravity_offset,
}
