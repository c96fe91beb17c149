"""SDF (Gazebo): a text of joints and links to copy."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from jaxid.robots.export.config import central, written
from jaxid.robots.export.outcome import ExportOutcome
from jaxid.robots.export.sheet import LinkInertia, Sheet
from jaxid.robots.export.target import Field, limit, Written
from jaxid.robots.export.xml_text import number, numbers as listed


NAME, VERSION, FILES = "sdf", "SDF 1.11 (Gazebo, dartsim)", ()
READ = "bullet-featherstone reads it and ignores it (gz-physics 712): use dartsim"
FIELDS = {
    "damping": Field("joint[{joint}]/axis/dynamics/damping", note=READ),
    "frictionloss": Field("joint[{joint}]/axis/dynamics/friction", note=READ),
    "stiffness": Field("joint[{joint}]/axis/dynamics/spring_stiffness"),
    "springref": Field("joint[{joint}]/axis/dynamics/spring_reference"),
    "force": Field("joint[{joint}]/axis/limit/effort", one=True),
    "highest": Field("joint[{joint}]/axis/limit/effort", one=True),
    "kp": Field("plugin JointPositionController/p_gain", note="the system plugin of Gazebo"),
    "kd": Field("plugin JointPositionController/d_gain", note="its derivative is of the error"),
    "inertial": Field("link[{link}]/inertial"),
    "gravity": Field("world/gravity"),
}  # fmt: skip
ELSEWHERE = {
    "bias": "turn the joint's <pose> back by as much",
    "torque": "a joint force from a plugin: gz topic, JointForceCmd",
    "ki": "plugin JointPositionController/i_gain",
}


def write(sheet: Sheet, _found: ExportOutcome, _path: Path | None) -> Written:
    """`joints.sdf`."""
    return written(sheet, FIELDS, ELSEWHERE, "joints.sdf", _text, VERSION, "c")


def _text(
    sheet: Sheet, numbers: Mapping[str, dict[str, Any]], bodies: Mapping[str, LinkInertia]
) -> str:
    lines = [
        f"<!-- Copy these elements to the joints and links of your model; written for {VERSION},"
        " not run. -->"
    ]
    names = {
        "damping": "damping",
        "frictionloss": "friction",
        "stiffness": "spring_stiffness",
        "springref": "spring_reference",
    }
    for joint, own in numbers.items():
        dynamics = "".join(
            f"<{tag}>{number(own[k])}</{tag}>" for k, tag in names.items() if k in own
        )
        now = sheet.after[joint]
        effort = limit([now.lowest, now.highest]) if {"force", "highest"} & own.keys() else None
        lines += [f"<joint name={quoteattr(joint)}>", "  <axis>"]
        lines += [f"    <dynamics>{dynamics}</dynamics>"] if dynamics else []
        lines += (
            [f"    <limit><effort>{number(effort)}</effort></limit>"] if effort is not None else []
        )
        lines += ["  </axis>", "</joint>"]
        if {"kp", "kd"} & own.keys():
            gains = f"<p_gain>{number(now.kp)}</p_gain><d_gain>{number(now.kd)}</d_gain>"
            plugin = 'filename="gz-sim-joint-position-controller-system" '
            plugin += 'name="gz::sim::systems::JointPositionController"'
            lines += [
                f"<plugin {plugin}>",
                f"  <joint_name>{quoteattr(joint)[1:-1]}</joint_name>{gains}",
                "</plugin>",
            ]
    for link, body in bodies.items():
        tensor = zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), central(body), strict=True)
        inertia = "".join(f"<{k}>{number(v)}</{k}>" for k, v in tensor)
        place = f"<pose>{listed(body.com)} 0 0 0</pose><mass>{number(body.mass)}</mass>"
        lines += [
            f"<link name={quoteattr(link)}>",
            f"  <inertial>{place}<inertia>{inertia}</inertia></inertial>",
            "</link>",
        ]
    if sheet.gravity is not None and any(c.quantity == "gravity" for c in sheet.changes):
        lines.append(f"<gravity>{listed(sheet.gravity[1])}</gravity>")
    return "\n".join([*lines, ""])
