"""A law of a robot's drive in an MJCF: which of its numbers are other ones than the file's, and
where they stand.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from jaxid.robots.export.mjcf_drive import attribute_of, ENDLESS, HISTORY
from jaxid.robots.export.sheet import JointNumbers, RobotChange, Sheet
from jaxid.robots.export.target import APPROXIMATE, EXACT, Field, joined
from jaxid.robots.tree import Actuator


#: Numbers of a drive's limit; and those that count at the joint, behind the gear.
LIMITS = {"force", "lowest", "highest"}
AT_JOINT = {"kp", "kd", "offset", "torque", *LIMITS}


def apart_from(actuator: Actuator, now: JointNumbers) -> dict[str, tuple[float, float]]:
    """(of the file, new) of each number of a position law that is another one than the file's."""
    lowest, highest = actuator.force
    numbers = {
        "kp": (actuator.kp, now.kp),
        "kd": (actuator.kd, now.kd),
        "lowest": (lowest, now.lowest),
        "highest": (highest, now.highest),
        "delay": (actuator.delay, now.delay),
        "lag": (actuator.lag, now.lag),
        "offset": (actuator.offset, now.offset),
    }
    apart = {}
    for name, (file, new) in numbers.items():
        if abs(file - new) > 1e-9 * abs(new) or np.isinf(file) != np.isinf(new):
            apart[name] = file, new
    return apart


def stated_changes(
    sheet: Sheet, joint: str, apart: Mapping[str, tuple[float, float]]
) -> Iterator[RobotChange]:
    """Numbers of a law that are other ones than the file's because the recording states them."""
    named = {c.quantity for c in sheet.changes if c.place == joint}
    force = sheet.force_unit(joint)
    x = "m" if sheet.slides(joint) else "rad"
    units = {"kp": f"{force}/{x}", "kd": f"{force} s/{x}", "delay": "s", "lag": "s"}
    for name, unit in units.items():
        if name not in apart or name in named:
            continue
        file, new = apart[name]
        yield RobotChange(
            effect=name,
            location=joint,
            quantity=name,
            place=joint,
            value=new,
            before=file,
            unit=unit,
            note="the law of [controller], under which the recording was made",
        )
    if {"lowest", "highest"}.isdisjoint(apart) or not named.isdisjoint(LIMITS):
        return
    yield RobotChange(
        effect="saturation",
        location=joint,
        quantity="force",
        place=joint,
        value=None,
        before=None,
        unit=force,
        note="the limit of [controller], under which the recording was made",
    )


def drive_fields(
    sheet: Sheet, place: str, names: set[str], now: JointNumbers, gear: float
) -> dict[str, Field]:
    """Where the numbers of a joint's drive stand: `place` is `position[elbow]@`."""
    tag = place.partition("[")[0]
    how, steps = EXACT, ""
    if sheet.driven and sheet.sampled > 0:
        how = APPROXIMATE
        steps = f"the law ran every {sheet.sampled:g} s, MuJoCo's runs at each of its steps"
    at_joint = steps
    if gear != 1:
        geared = f"at the joint: the file's number stands before gear {gear:g}"
        at_joint = joined(steps, geared)
    out: dict[str, Field] = {}
    for name in names:
        note = at_joint if name in AT_JOINT else steps
        out[name] = Field(place + attribute_of(name, tag), how, note)
    limited = np.isfinite([now.lowest, now.highest])
    if "torque" in names:
        shifted = "forcerange is shifted by as much" if limited.any() else ""
        out["torque"] = Field(f"{place}biasprm", EXACT, joined(shifted, at_joint))
    if "delay" in names:
        field = place + attribute_of("delay", tag)
        out["delay"] = Field(field, EXACT, joined(HISTORY, steps))
    if limited.all():
        return out
    endless = f"no limit in one direction: {ENDLESS:g} stands for it"
    for name in names & LIMITS:
        out[name] = Field(f"{place}forcerange", APPROXIMATE, joined(endless, at_joint))
    return out
