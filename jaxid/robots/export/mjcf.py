"""MJCF: the user's own text with attributes of its joints, links and actuators changed, and the
same as `apply(spec)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.wording import listed
from jaxid.robots.export.law_code import code, lawful
from jaxid.robots.export.mjcf_code import callback, Op, snippet, spec_code
from jaxid.robots.export.mjcf_drive import DriveWords, OF_LAW
from jaxid.robots.export.mjcf_file import compiled, MjcfFile
from jaxid.robots.export.mjcf_friction import friction_field, UNTRIED
from jaxid.robots.export.mjcf_ground import on_the_ground
from jaxid.robots.export.mjcf_law import apart_from, drive_fields, stated_changes
from jaxid.robots.export.outcome import AS_STATED, ExportOutcome
from jaxid.robots.export.sheet import from_ten, JointNumbers, LinkInertia, RobotChange, Sheet
from jaxid.robots.export.target import (
    APPROXIMATE,
    CODE,
    coded,
    EXACT,
    ExportRow,
    Field,
    joined,
    nearer,
    row,
    Trial,
    value_of,
    was,
    Written,
)
from jaxid.robots.export.xml_text import Element, number as digits, numbers, XmlText


NAME, VERSION, FILES = "mjcf", "MuJoCo 4.0", (".xml", ".mjcf")
UNLIMITED = (
    "[controller] states no limit (saturation), so that the runs were simulated without the file's:"
    " it is left as it is at {}"
)
CALLBACK = "effects.py"


def write(
    sheet: Sheet, found: ExportOutcome, path: Path | None, trial: Trial | None = None
) -> Written:
    """The patched file, `apply.py`, and `effects.py` for laws that no attribute says. How hard
    friction is, is written where the result's numbers are those with hard friction, or else the
    recording is nearer with it in MuJoCo, which `trial` says.
    """
    if path is None:
        return snippet(sheet, found)

    def patch(holding):
        return _Patch(deepcopy(sheet), MjcfFile(path), holding).written()

    out = patch(frozenset())
    stick = [
        j
        for j, n in sheet.changed.items()
        if n.frictionloss > 0 and n.frictionloss != sheet.before[j].frictionloss
    ]
    if not stick or path.name not in out.files:
        return out
    if found.robot.get("simulator", {}).get("hard"):
        return patch(frozenset(stick))
    if trial is None:
        out.notes.append(UNTRIED)
        return out
    chosen, off = frozenset[str](), trial(out.files, path.name, out.rows)
    for joint in stick:
        more = patch(chosen | {joint})
        off_then = trial(more.files, path.name, more.rows)
        if nearer(off_then, off):
            chosen, off, out = chosen | {joint}, off_then, more
    return out


def texts_of(path: Path) -> dict[str, str]:
    """The file and what it includes, as they stand."""
    return {name: text.result() for name, text in MjcfFile(path).texts.items()}


class _Patch:
    """`holding`: joints whose dry friction is hardened beside being written."""

    def __init__(self, sheet: Sheet, file: MjcfFile, holding: frozenset[str]):
        self.sheet, self.file, self.holding = sheet, file, holding
        self.ops: list[Op] = []
        self.rows: list[ExportRow] = []
        self.notes: list[str] = []
        self.lacking = coded(CALLBACK)

    def written(self) -> Written:
        fields: dict[tuple[str, str], Field | None] = {}
        for joint, now in self.sheet.changed.items():
            fields |= self._joint(joint, self.sheet.before[joint], now)
        self._stated_law(fields)
        for link, (before, after) in self.sheet.bodies.items():
            fields["inertial", link] = self._body(link, before, after)
        if any(c.quantity == "gravity" for c in self.sheet.changes):
            fields["gravity", ""] = self._gravity()
        grounded, ops = on_the_ground(self.sheet.changes, self.file)
        fields |= grounded
        self.ops += ops
        self.rows += [self._row(c, fields) for c in self.sheet.changes]
        if not any(r.how in (EXACT, APPROXIMATE) for r in self.rows):
            out = Written(self.rows, {}, self.notes)
        else:
            out = Written(self.rows, self._texts(), self.notes)
            out.files["apply.py"] = spec_code(self.ops, self.file.path.name, VERSION)
        if laws := lawful(
            c for r, c in zip(self.rows, self.sheet.changes, strict=False) if r.how == CODE
        ):
            out.files[CALLBACK] = code(
                laws, f"Laws that no field of an MJCF says; written for {VERSION}.", callback(laws)
            )
        return out

    def _row(
        self, change: RobotChange, fields: Mapping[tuple[str, str], Field | None]
    ) -> ExportRow:
        own = fields.get((change.quantity, change.place))
        if own is not None:
            return row(self.sheet, change, own)
        if (change.quantity, change.place) in fields:
            return ExportRow(
                change.effect,
                change.location,
                "",
                value_of(self.sheet, change),
                change.unit,
                CODE,
                joined(self._why(change), was(change), change.note),
            )
        known = change.place in self.sheet.after and hasattr(
            self.sheet.after[change.place], change.quantity
        )
        if (known or change.quantity == "inertial") and change.value == change.before:
            note = change.note or AS_STATED
            return ExportRow(
                change.effect, change.location, "", change.value, change.unit, EXACT, note
            )
        return self.lacking(change)

    def _why(self, change: RobotChange) -> str:
        joint = change.place
        if change.quantity == "inertial":
            return f"body {joint!r} has no name of its own in the file: give it one"
        if self.file.joint(joint) is None:
            return f"joint {joint!r} has no name of its own in the file: give it one"
        law = (
            f'<position joint="{joint}" kp="{digits(self.sheet.after[joint].kp)}"'
            f' kv="{digits(self.sheet.after[joint].kd)}"/>'
        )
        if through := self._through(joint):
            return through
        if change.quantity in (*OF_LAW, "force"):
            return (
                f"the file has no position actuator at {joint}, and [controller] drives: set it in"
                f" your controller, or add {law}"
            )
        return f"the file has no one actuator at {joint} that jaxid knows"

    def _through(self, joint: str) -> str:
        """What to say of a joint that the file drives through one that is coupled to it."""
        tree = self.sheet.tree
        coupled = [] if tree is None else [c for c in tree.couplings if c.leader == joint]
        driven = [c for c in coupled if self.file.actuator(c.follower) is not None]
        if not driven or self.file.actuator(joint) is not None:
            return ""
        name, ratio = driven[0].follower, digits(driven[0].ratio)
        at = f"the file drives {joint} through {name} = {ratio} {joint}"
        return f"{at}: there, divide kp and kd by {ratio}^2 and forces by {ratio}"

    # ---- joints

    def _joint(
        self, joint: str, was_: JointNumbers, now: JointNumbers
    ) -> dict[tuple[str, str], Field | None]:
        """Attributes of the joint and its actuator; quantity -> the field that carries it, None
        where nothing does.
        """
        found = self.file.joint(joint)
        changed = {k for k in vars(now) if getattr(now, k) != getattr(was_, k)}
        fields: dict[tuple[str, str], Field | None] = {}
        if found is None:
            return {(k, joint): None for k in changed}
        text, element = found
        every = self._joint_attributes(joint, changed, was_, now, fields, element.attributes)
        own = {k: v for k, v in every.items() if v is not None}
        if own:
            text.set(element, {k: _as_text(v) for k, v in own.items()})
            self.ops.append(Op("joint", joint, own))
        drive = changed & {*OF_LAW, "torque", "drive"}
        if drive:
            fields |= self._actuator(joint, drive, now)
        return fields

    def _joint_attributes(self, joint, changed, was_, now, fields, present) -> dict[str, Any]:
        at = f"joint[{joint}]@"
        own: dict[str, Any] = {}
        file = self._file_numbers(joint)

        # mimic joints have a share of their own
        def more(k):
            return file[k] + getattr(now, k) - getattr(was_, k)

        if changed & {"damping", "quadratic", "cubic"}:
            poly = [more(k) for k in ("damping", "quadratic", "cubic")]
            while len(poly) > 1 and poly[-1] == 0:
                poly.pop()
            own["damping"] = poly
            fields |= {(k, joint): Field(f"{at}damping") for k in ("damping", "quadratic", "cubic")}
        if "frictionloss" in changed:
            own["frictionloss"] = more("frictionloss")
            hardened = joint in self.holding
            field, more_of_it = friction_field(joint, now.frictionloss, present, hardened)
            fields["frictionloss", joint] = field
            own |= more_of_it
        if "armature" in changed:
            own["armature"] = more("armature")
            fields["armature", joint] = Field(f"{at}armature")
        shift = now.bias - was_.bias
        turn = 1.0 if self.sheet.slides(joint) else self.file.degrees
        if changed & {"stiffness", "springref"} or (shift and now.stiffness):
            own |= {"stiffness": now.stiffness, "springref": turn * (now.springref + shift)}
            fields |= {
                (k, joint): Field(f"{at}{k}", note="springref in the file's angles")
                for k in ("stiffness", "springref")
            }
        if shift:
            own |= self._shifted(joint, shift, turn)
            note = "ref and range shifted; add it to the joint's value in keyframes too"
            fields["bias", joint] = Field(f"{at}ref", EXACT, note)
        return own

    def _file_numbers(self, joint: str) -> dict[str, float]:
        tree = self.sheet.own_tree
        k = tree.joints.index(joint)
        d = tree.damping[k]
        a, m = self.file.actuator_id(joint), self.file.model
        gear2 = float(m.actuator_gear[a, 0]) ** 2 if a >= 0 else 0.0

        # Armature and damping that stand at the actuator stay there.
        def extra(name):
            return (
                float(np.ravel(getattr(m, name)[a])[0]) * gear2
                if a >= 0 and hasattr(m, name)
                else 0.0
            )

        return {
            "damping": d[0] - extra("actuator_damping"),
            "quadratic": d[1],
            "cubic": d[2],
            "frictionloss": tree.frictionloss[k],
            "armature": tree.armature[k] - extra("actuator_armature"),
        }

    def _shifted(self, joint: str, shift: float, turn: float) -> dict[str, Any]:
        tree = self.sheet.own_tree
        k = tree.joints.index(joint)
        own: dict[str, Any] = {"ref": turn * (float(tree.reference[k]) + shift)}
        if np.isfinite([tree.lower[k], tree.upper[k]]).all():
            own["range"] = [turn * (tree.lower[k] + shift), turn * (tree.upper[k] + shift)]
        return own

    # ---- actuators

    def _stated_law(self, fields: dict[tuple[str, str], Field | None]) -> None:
        """A law that the recording states goes into the file's position actuators, where those are
        of another law.
        """
        sheet, tree = self.sheet, self.sheet.tree
        if not sheet.driven or sheet.own_law or tree is None or sheet.kind != "pd":
            return
        left: list[str] = []
        for joint, stated in sheet.after.items():
            actuator = tree.actuators.get(joint)
            if actuator is None or actuator.kind != "position":
                continue
            now = self._limited(joint, stated)
            if (now.lowest, now.highest) != (stated.lowest, stated.highest):
                low, high = actuator.force
                left.append(f"{joint} ({low:g} to {high:g} {sheet.force_unit(joint)})")
            apart = apart_from(actuator, now)
            if apart:
                fields |= self._actuator(joint, set(apart), now)
            sheet.record(list(stated_changes(sheet, joint, apart)))
        if left:
            self.notes.append(UNLIMITED.format(listed(left)))

    def _actuator(
        self, joint: str, changed: set[str], now: JointNumbers
    ) -> dict[tuple[str, str], Field | None]:
        names = set(changed)
        if changed & {"lowest", "highest"}:
            names.add("force")
        found = self._drive_of(joint, changed)
        if found is None:
            return {(name, joint): None for name in names}
        text, element = found
        now = self._limited(joint, now)
        words = DriveWords(self.file.model, self.file.actuator_id(joint), self.sheet.driven)
        attributes, tag = words.attributes(changed, now, element.name)
        if tag != element.name:
            text.rename(element, tag)
        text.set(element, {k: _as_text(v) for k, v in attributes.items()})
        self._widen(joint, now)
        self.ops.append(Op("actuator", joint, words.general(changed, now)))
        place = f"{tag}[{joint}]@"
        fields = drive_fields(self.sheet, place, names, now, words.gear)
        return {(name, joint): field for name, field in fields.items()}

    def _drive_of(self, joint: str, changed: set[str]) -> tuple[XmlText, Element] | None:
        """The one actuator of a joint, where an element of its kind can say what changed."""
        sheet = self.sheet
        actuator = sheet.own_tree.actuators.get(joint)
        wanted = "position" if sheet.driven else "motor"
        if actuator is None or actuator.kind != wanted or self.file.actuator_id(joint) < 0:
            return None
        other_law = sheet.driven and sheet.kind != "pd"
        if other_law or "ki" in changed:
            return None
        return self.file.actuator(joint)

    def _limited(self, joint: str, now: JointNumbers) -> JointNumbers:
        """The numbers with the file's limits where a law of the recording states none: what it does
        not say it does not change.
        """
        tree = self.sheet.tree
        if self.sheet.own_law or tree is None or joint not in tree.actuators:
            return now
        lowest, highest = tree.actuators[joint].force
        return replace(
            now,
            lowest=now.lowest if np.isfinite(now.lowest) else lowest,
            highest=now.highest if np.isfinite(now.highest) else highest,
        )

    def _widen(self, joint: str, now: JointNumbers) -> None:
        """A limit at the joint that is narrower than the new one would still hold."""
        tree, found = self.sheet.own_tree, self.file.joint(joint)
        limit = tree.effort[tree.joints.index(joint)]
        new = max(abs(now.lowest), abs(now.highest))
        if found is not None and np.isfinite([limit, new]).all() and new > limit:
            found[0].set(
                found[1],
                {"actuatorfrcrange": numbers([now.lowest + now.torque, now.highest + now.torque])},
            )
            self.ops.append(
                Op(
                    "joint",
                    joint,
                    {"actfrcrange": [now.lowest + now.torque, now.highest + now.torque]},
                )
            )

    # ---- bodies, gravity

    def _body(self, link: str, before: LinkInertia, after: LinkInertia) -> Field | None:
        found = self.file.body(link)
        if found is None:
            return None
        own = self._own_body(link)
        new, off = from_ten(own.ten + after.ten - before.ten)
        text, element = found
        inertial = element.child("inertial")
        I = new.inertia
        full = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
        same = np.abs(I - own.inertia).max() <= 1e-9 * np.abs(own.inertia).max()
        attributes: dict[str, str | None] = {"pos": numbers(new.com), "mass": digits(new.mass)}
        if not same:
            turn = ("quat", "axisangle", "xyaxes", "zaxis", "euler", "diaginertia")
            attributes |= {**dict.fromkeys(turn), "fullinertia": numbers(full)}
        if inertial is None:
            where = f'pos="{numbers(new.com)}" mass="{digits(new.mass)}"'
            text.insert(element, f'<inertial {where} fullinertia="{numbers(full)}"/>')
        else:
            text.set(inertial, attributes)
        self.ops.append(
            Op(
                "body",
                link,
                {
                    "mass": new.mass,
                    "ipos": list(new.com),
                    **({} if same else {"fullinertia": full}),
                },
            )
        )
        together = "mass, pos and inertia together; they are of bodies that can exist"
        note = joined(together, self.file.lifted(link))
        if off > 1e-6:
            note += f"; the nearest such body is {100 * off:.2g} % of its largest number off"
        lumped = np.abs(own.ten - before.ten).max() > 1e-6 * np.abs(before.ten).max()
        return Field(
            "body[{link}]/inertial",
            EXACT if off <= 1e-6 else APPROXIMATE,
            joined(note, "what is fixed to it keeps its own numbers" if lumped else ""),
        )

    def _own_body(self, link: str) -> LinkInertia:
        from jaxid.robots.mjcf import pose
        from jaxid.robots.mjcf_spec import library

        m, mj = self.file.model, library()
        b = mj.mj_name2id(m, mj.mjtObj.mjOBJ_BODY, link)
        R = pose(np.zeros(3), m.body_iquat[b])[:3, :3]
        return LinkInertia(
            float(m.body_mass[b]), m.body_ipos[b].copy(), R @ np.diag(m.body_inertia[b]) @ R.T
        )

    def _gravity(self) -> Field:
        assert self.sheet.gravity is not None
        g = [float(v) for v in self.sheet.gravity[1]]
        text, option = self.file.option()
        if option is None:
            text.before_end(f'<option gravity="{numbers(g)}"/>')
        else:
            text.set(option, {"gravity": numbers(g)})
        self.ops.append(Op("option", "gravity", {"gravity": g}))
        return Field(
            "option@gravity",
            note="gravity turned in place of the base: right while the base does not move",
        )

    # ---- the end

    def _texts(self) -> dict[str, str]:
        """The edited files, compiled as a last check."""
        path = self.file.path
        out = {name: text.result() for name, text in self.file.texts.items()}
        if len(out) == 1:
            self._check(compiled(path, out[path.name]))
        return out

    def _check(self, new: Any) -> None:
        """MuJoCo takes the file, and nothing but what was meant is another number than before."""
        old = self.file.model
        meant = {
            "joint": ("dof_", "jnt_", "qpos"),
            "body": ("body_",),
            "actuator": ("actuator_", "opt"),
        }
        allowed = ("tendon_length0", "stat", "cam_", "light_")
        for op in self.ops:
            allowed += meant.get(op.kind, ())
        for name in (
            "dof_damping",
            "dof_frictionloss",
            "dof_armature",
            "body_mass",
            "body_pos",
            "jnt_axis",
            "actuator_gainprm",
        ):
            a, b = getattr(old, name), getattr(new, name)
            if a.shape != b.shape or (not name.startswith(allowed) and not np.array_equal(a, b)):
                raise UsageError(
                    f"{self.file.path}: the patched file would change {name}, which was not meant;"
                    " nothing was written"
                )


def _as_text(value: Any) -> str | None:
    """The value of an attribute; None takes it out."""
    if value is None or isinstance(value, str):
        return value
    return numbers(np.atleast_1d(value))
