"""Python for MuJoCo: `apply(spec)`, the callback for laws without a field, and a text of attributes
where no file is given.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import quoteattr

from jaxid.robots.export.law_code import code, law_of, lawful
from jaxid.robots.export.outcome import ExportOutcome
from jaxid.robots.export.sheet import RobotChange, Sheet
from jaxid.robots.export.target import coded, Field, rows_of, Written
from jaxid.robots.export.xml_text import number, numbers


#: Names of MJCF -> names of MjSpec.
SPEC = {"solreffriction": "solref_friction", "solimpfriction": "solimp_friction"}
PLAIN = {
    "damping": Field("joint[{joint}]@damping"), "quadratic": Field("joint[{joint}]@damping"),
    "cubic": Field("joint[{joint}]@damping"),
    "frictionloss": Field("joint[{joint}]@frictionloss", "approximate", "a soft constraint that creeps"),
    "armature": Field("joint[{joint}]@armature"), "stiffness": Field("joint[{joint}]@stiffness"),
    "springref": Field("joint[{joint}]@springref", note="in the file's angles; radians here"),
    "kp": Field("position[{joint}]@kp"), "kd": Field("position[{joint}]@kv"), "force": Field("position[{joint}]@forcerange"),
    "highest": Field("position[{joint}]@forcerange"), "lowest": Field("position[{joint}]@forcerange"),
    "delay": Field("actuator[{joint}]@delay, nsample, interp", note="seconds; nsample at least delay / timestep + 2"),
    "lag": Field("position[{joint}]@timeconst"), "torque": Field("general[{joint}]@biasprm", note="its first number"),
    "offset": Field("general[{joint}]@biasprm", note="its first number"),
    "bias": Field("joint[{joint}]@ref", note="added; radians here"),
    "drive": Field("motor[{joint}]@gear", note="times this"),
}  # fmt: skip


@dataclass(frozen=True)
class Op:
    """Attributes of one element of the file: `kind` joint, body, geom, actuator or option."""

    kind: str
    name: str
    attributes: Mapping[str, Any]


def spec_code(ops: Iterable[Op], file: str, version: str) -> str:
    """A module whose `apply(spec)` makes the same changes on a `mujoco.MjSpec` of the unpatched
    file.
    """
    shown = file.replace("\\", "/").replace('"', "'")
    lines = [
        f'"""What was found, for `mujoco.MjSpec` ({version}):',
        "",
        "    import mujoco",
        f"    spec = mujoco.MjSpec.from_file({shown!r})",
        "    model = apply(spec).compile()",
        '"""',
        "",
        "import mujoco",
        "",
        "",
        "def actuator_of(spec, joint):",
        '    """The actuator that acts on a joint."""',
        "    return next(a for a in spec.actuators if a.target == joint)",
        "",
        "",
        "def apply(spec):",
        (
            '    """Changes the spec of the file as it stood and returns it. Angles are in the'
            ' file\'s own unit."""'
        ),
    ]
    for op in ops:
        lines += [f"    {line}" for line in _lines(op)]
    return "\n".join([*lines, "    return spec", ""])


def _lines(op: Op) -> list[str]:
    if op.kind == "option":
        return [f"spec.option.gravity = {_plain(op.attributes['gravity'])}"]
    if op.kind == "body":
        out = [f"b = spec.body({op.name!r})"]
        values = dict(op.attributes)
        if "fullinertia" in values:
            out += ["b.iquat, b.inertia = [1, 0, 0, 0], [0, 0, 0]"]
        return out + [f"b.{k} = {_plain(v)}" for k, v in values.items()]
    if op.kind == "geom":
        out = [f"g = spec.geom({op.name!r})"]
        return out + [f"g.{k} = {_plain(v)}" for k, v in op.attributes.items()]
    if op.kind == "joint":
        out = [f"j = spec.joint({op.name!r})"]
        for k, v in op.attributes.items():
            out += _joint_line(k, v)
        return out
    out = [f"a = actuator_of(spec, {op.name!r})"]
    for k, v in op.attributes.items():
        out += _actuator_line(k, v)
    return out


def _joint_line(k: str, v: Any) -> list[str]:
    if k in ("solreffriction", "solimpfriction"):
        parts = [float(x) for x in str(v).split()]
        return [f"j.{SPEC[k]}[:{len(parts)}] = {parts}"]
    if k == "damping":
        return [f"j.damping = {_plain([*v, *[0.0] * (3 - len(v))])}"]
    if k == "stiffness":
        return [f"j.stiffness = [{float(v)!r}, 0.0, 0.0]"]
    return [f"j.{k} = {_plain(v)}"]


def _actuator_line(k: str, v: Any) -> list[str]:
    if k in ("gainprm", "gear"):
        return [f"a.{k}[0] = {float(v)!r}"]
    if k == "biasprm":
        return ["a.biastype = mujoco.mjtBias.mjBIAS_AFFINE", f"a.biasprm[:3] = {_plain(v)}"]
    if k == "forcerange":
        return [f"a.forcerange = {_plain(v)}", "a.forcelimited = True"]
    if k == "timeconst":
        return ["a.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT", f"a.dynprm[0] = {float(v)!r}"]
    if k == "interp":
        return ["a.interp = 1  # linear"]
    return [f"a.{k} = {_plain(v)}"]


def _plain(v: Any) -> str:
    if isinstance(v, int | str):
        return repr(v)
    return (
        repr([float(x) for x in v])
        if isinstance(v, list | tuple) or hasattr(v, "__len__")
        else repr(float(v))
    )


def callback(changes: list[RobotChange]) -> str:
    """What calls the laws, before each step."""
    laws = [law_of(c.quantity) for c in changes]
    ports = {law.port for law in laws if law is not None}
    lines = [
        "",
        "",
        "class Effects:",
        '    """`effects = Effects(model)`; before every mj_step: `effects(model, data)`."""',
        "",
        "    def __init__(self, model):",
    ]
    lines += [
        "        self.base = model.dof_frictionloss.copy()",
        "",
        "    def __call__(self, model, data):",
        "        dt = model.opt.timestep",
        "        data.qfrc_applied[:] = 0.0",
        "        model.dof_frictionloss[:] = self.base",
    ]
    each = [
        "            j = model.joint(joint)",
        "            d, q = j.dofadr[0], data.qpos[j.qposadr[0]]",
        "            qd, load = data.qvel[d], data.qfrc_actuator[d]",
    ]
    if "force" in ports:
        lines += [
            "        for joint, law in FORCE:",
            *each,
            "            data.qfrc_applied[d] -= law(q, qd, load, dt)",
        ]
    if "dry" in ports:
        lines += [
            "        for joint, law in DRY:",
            *each,
            "            model.dof_frictionloss[d] += law(q, qd, load, dt)",
        ]
    if {"command", "torque"} & ports:
        lines += [
            "",
            "    # COMMAND and TORQUE act on what you write to data.ctrl: ctrl = law(ctrl, dt).",
        ]
    if "reading" in ports:
        lines += ["", "    # READING acts on what you read: y = law(q, dt)."]
    return "\n".join([*lines, ""])


def snippet(sheet: Sheet, found: ExportOutcome) -> Written:
    """Attributes to copy, where no file is known to patch."""
    lines = [
        "<!-- Copy these attributes to the joints and actuators of your file; angles in radians."
        " Written for MuJoCo 4.0. -->"
    ]
    for joint, now in sheet.after.items():
        own = {c.quantity for c in sheet.changes if c.place == joint}
        attributes: dict[str, str] = {}
        if own & {"damping", "quadratic", "cubic"}:
            attributes["damping"] = numbers([now.damping, now.quadratic, now.cubic])
        for k in ("frictionloss", "armature", "stiffness", "springref"):
            if k in own:
                attributes[k] = number(getattr(now, k))
        if attributes:
            lines.append(
                f"<joint name={quoteattr(joint)}"
                f" {' '.join(f'{k}={quoteattr(v)}' for k, v in attributes.items())}/>"
            )
    out = Written(rows_of(sheet, PLAIN, coded("effects.py")))
    if len(lines) > 1:
        out.files["joints.xml"] = "\n".join([*lines, ""])
    if laws := lawful(c for c, r in zip(sheet.changes, out.rows, strict=True) if r.how == "code"):
        out.files["effects.py"] = code(
            laws, "Laws that no field of an MJCF says; written for MuJoCo 4.0.", callback(laws)
        )
    out.notes += (
        []
        if sheet.tree
        else ["no robot's file is known, so nothing was patched: give it with --robot FILE"]
    )
    return out
