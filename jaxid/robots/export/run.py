"""`jaxid export`: a result carried back into the terms of a framework."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxid.base.display import Printed
from jaxid.base.errors import nearest, UsageError
from jaxid.base.small_files import read_small, TooLarge
from jaxid.base.wording import listed, number, stem_and_number
from jaxid.robots.export import mjcf
from jaxid.robots.export.apply import carried
from jaxid.robots.export.code_beside import left_out
from jaxid.robots.export.kept import kept
from jaxid.robots.export.outcome import ExportOutcome, outcome, tables
from jaxid.robots.export.ranges import ranges_of
from jaxid.robots.export.sheet import of_tree, Sheet
from jaxid.robots.export.stepped import shifted, stepped
from jaxid.robots.export.target import ExportRow, joined, NEARER, Trial, Written
from jaxid.robots.export.targets import TARGETS
from jaxid.robots.floating import based
from jaxid.robots.followers import led_as
from jaxid.robots.mjcf import read_mjcf
from jaxid.robots.origin import digest
from jaxid.robots.tree import Tree
from jaxid.robots.urdf_tree import read_urdf_tree


@dataclass(frozen=True, repr=False)
class Exported(Printed):
    """Rows (one at least for each effect and each fitted number), files (name -> text), ranges
    (None where not asked for).
    """

    to: str
    rows: tuple[ExportRow, ...]
    files: Mapping[str, str]
    notes: tuple[str, ...]
    source: Mapping[str, Any]
    ranges: Mapping[str, Any] | None = None

    @property
    def carries(self) -> bool:
        """Whether anything can be carried over."""
        return any(r.how != "none" and not r.kept for r in self.rows)

    def to_list(self) -> list[dict[str, Any]]:
        """The rows as `export.json` holds them."""
        return [r.to_dict() for r in self.rows]


def export(
    content: Any,
    to: str,
    robot: str | Path | None = None,
    ranges: bool = False,
    beside: Path | None = None,
    trial: Trial | None = None,
) -> Exported:
    """What a result (the content of its JSON) says, in the terms of a framework; nothing is
    written.

    `robot` is the file to patch, else the one that the result is of, looked for as it was named and
    then in `beside`, the folder of the result. `trial` runs a patch on the recording: see
    `target.Trial`.

    Raises `UsageError` for an unknown framework, a content that is no result, and a file that is
    missing, has changed since, or has not the joints of the result.
    """
    if to not in TARGETS:
        raise UsageError(f"--to {to}: no such target{nearest(to, TARGETS)}")
    found = outcome(content)
    path = _file(found, robot, beside)
    target = TARGETS[to]
    tree = None if path is None else _tree(found, path)
    in_steps, said = _in_steps(found, tree, path) if to == "mjcf" else (found, ())
    told = kept(in_steps)
    sheet = _sheet(told, tree, path)
    sheet.notes += said
    patches = path is not None and path.suffix.lower() in target.FILES
    if target.FILES and path is not None and not patches and to in ("mjcf", "urdf"):
        sheet.notes.append(
            f"{path.name} is not {to.upper()}, so nothing was patched: give one with --robot FILE"
        )
    if to == "mjcf" and patches and path is not None:
        written = mjcf.write(sheet, told, path, trial)
        written.notes += _compared(written, path, trial)
        written.rows = [_with_step(r, tree) for r in written.rows]
    else:
        written = target.write(sheet, told, path if patches else None)
    rows, files = tuple(written.rows), dict(written.files)
    notes = [*_caveats(found), *sheet.notes, *written.notes]
    table = None
    if ranges:
        more = ranges_of(found, to, told)
        files |= more.files
        notes += more.notes
        table = more.table
    by_its_steps = in_steps.robot.get("simulator", {}).get("kind") == "mujoco"
    simulated = in_steps if by_its_steps else found
    source = {
        "schema": 1,
        "kind": "export",
        "to": to,
        "robot": _of_file(simulated, path),
        "result": _numbers(simulated),
    }
    return Exported(to, rows, files, tuple(notes), source, table)


def _tree(found: ExportOutcome, path: Path) -> Tree:
    """The tree of the file, on a base that floats where that of the result does."""
    base = found.robot.get("base") or {}
    return based(read_tree(path), base.get("kind") == "free")


def _with_step(row: ExportRow, tree: Tree | None) -> ExportRow:
    """The row with the step for which its value holds."""
    if tree is None or tree.steps is None or row.kept or not row.field:
        return row
    if not shifted(row.effect):
        return row
    return replace(row, note=joined(row.note, f"holds for {tree.steps.said}"))


def _compared(written: Written, path: Path, trial: Trial | None) -> list[str]:
    """What a patch changes of the robot's run on the recording."""
    if trial is None or path.name not in written.files:
        return []
    now = trial(written.files, path.name, written.rows)
    before = trial(mjcf.texts_of(path), path.name, ())
    if now is None or before is None:
        return []
    moved = [j for j in now if abs(now[j] - before[j]) > NEARER * before[j]]
    if not moved:
        return []
    course = listed(f"{j} {number(before[j])} → {number(now[j])}" for j in moved)
    said = f"in MuJoCo on the recording, rms error before and after (rad or m): {course}"
    left = left_out(written.rows)
    if left:
        return [f"{said}; without {left}, which effects.py adds"]
    worse = [j for j in moved if now[j] > before[j]]
    if worse:
        said += f"; {listed(worse)} further off than before: do not take that over unseen"
    return [said]


def read_tree(path: Path) -> Tree:
    """The tree of a robot's file by its ending."""
    try:
        if path.suffix.lower() == ".urdf":
            return read_urdf_tree(path, read_small(path).decode("utf-8-sig"))
        return read_mjcf(path)
    except UnicodeDecodeError as error:
        raise UsageError(
            f"{path}: a character that is not UTF-8; save the file as UTF-8"
        ) from error
    except TooLarge as error:
        raise UsageError(f"{path}: {error}") from error


def _file(found: ExportOutcome, robot: str | Path | None, beside: Path | None) -> Path | None:
    """The robot's file, None where there is none to patch."""
    if robot is not None:
        path = Path(robot)
        if not path.is_file():
            raise UsageError(f"--robot {path}: no such file, or none that is plain")
        if path.suffix.lower() not in (".xml", ".mjcf", ".urdf"):
            raise UsageError(f"--robot {path}: give an MJCF (.xml) or a URDF (.urdf)")
        return path
    named = found.robot.get("file", "")
    if not named or Path(named).suffix.lower() not in (".xml", ".mjcf", ".urdf"):
        return None
    places = [Path(named), *([beside / Path(named).name] if beside is not None else [])]
    path = next((p for p in places if p.is_file()), None)
    if path is None:
        raise UsageError(
            f"the robot's file {named} is not there any more: say where it is with --robot FILE"
        )
    if found.robot.get("sha256") and digest(str(path)) != found.robot["sha256"]:
        raise UsageError(
            f"{path} has changed since the result: give it with --robot {path} if it is to be"
            " patched as it stands now"
        )
    return path


def _sheet(found: ExportOutcome, tree: Tree | None, path: Path | None) -> Sheet:
    joints = _joints(found)
    if tree is None:
        sheet = of_tree(None, joints, found.robot)
    elif found.kind == "identification":
        return _identified(found, tree, path)
    else:
        tree = _as_recorded(found, tree, path)
        if not found.robot and [*tree.leading] != joints and len(tree.leading) == len(joints):
            found = found.renamed(dict(zip(joints, tree.leading, strict=True)))
        sheet = of_tree(tree, joints, found.robot)
    return carried(sheet, found)


def _as_recorded(found: ExportOutcome, tree: Tree, path: Path | None) -> Tree:
    """The tree with the joints held that the result had held. Raises `UsageError` where its joints
    are others.
    """
    own = found.robot.get("joints") or []
    if own:
        lacking = [j for j in own if j not in tree.joints]
        if lacking:
            raise UsageError(
                f"{path}: there is no joint {lacking[0]!r}, of which the result"
                f" speaks{nearest(lacking[0], tree.joints)}"
            )
        held = {k: v for k, v in found.robot["held"].items() if k in tree.joints}
        return led_as(tree, _leads(found)).locked(held)
    joints = _joints(found)
    known = [j for j in joints if j in tree.joints]
    if known == joints or len(joints) == len(tree.leading):
        return tree
    raise UsageError(
        f"{path} has the joints {', '.join(tree.leading)}, the result of model {found.model!r}"
        f" speaks of {', '.join(joints)}: the robot's file goes with results of that robot"
    )


def _leads(found: ExportOutcome) -> list[str]:
    """Joints that moved by themselves in the result, as far as it says them."""
    drive = found.robot.get("drive")
    return found.robot.get("leads") or (list(drive["joints"]) if drive else [])


def _in_steps(
    found: ExportOutcome, tree: Tree | None, path: Path | None
) -> tuple[ExportOutcome, tuple[str, ...]]:
    """The result in the terms of the file's simulator, and what is to be said of that."""
    if tree is None or found.kind == "identification":
        return found, ()
    return stepped(found, of_tree(_as_recorded(found, tree, path), _joints(found), found.robot))


def _joints(found: ExportOutcome) -> list[str]:
    """Joints that a result speaks of, where no file says them."""
    if found.robot.get("joints"):
        return list(found.robot["joints"])
    if found.kind == "identification":
        return [str(row.get("joint")) for row in tables(found.content.get("friction"))]
    places, count = [], 1
    for name in found.parameters:
        field, at_sign, place = name.partition("@")
        if at_sign:
            places.append(place)
        else:
            _, joint = stem_and_number(field)
            count = max(count, int(joint or 1))
    places += [_joint_of(e.location) for e in found.effects]
    shown = [j for j in dict.fromkeys(places) if j not in ("tau", "force", "u")]
    for k in range(len(shown), count):
        shown.append(f"q{k + 1}" if count > 1 else "q")
    return shown


def _joint_of(channel: str) -> str:
    """`elbow` of `elbow_cmd`, `elbow_tau` or `elbow_qd`."""
    for end in ("_cmd", "_tau", "_qd"):
        if channel.endswith(end):
            return channel.removesuffix(end)
    return channel


def _identified(found: ExportOutcome, tree: Tree, path: Path | None) -> Sheet:
    from jaxid.robots.export.identified import identified

    return identified(found, tree, path)


def _caveats(found: ExportOutcome) -> list[str]:
    """What the result itself says against taking its numbers for the robot's."""
    out, which = [], found.content.get("which")
    if isinstance(which, Mapping):
        if which.get("verdict") in ("unknown", "partly"):
            out.append(
                "a gap is left that no known effect explains: the fitted numbers may have taken up"
                " a part of it"
            )
        others = [
            f"{e.get('effect')} at {e.get('location')}"
            for e in which.get("confusable_with") or []
            if isinstance(e, Mapping)
        ]
        out += [f"the data cannot tell what was named from {', '.join(others)}"] if others else []
    if found.content.get("state") in ("stalled", "budget"):
        out.append(
            f"the fit ended by its {found.content['state']}, not converged: the numbers are not the"
            " best ones"
        )
    return out


def _of_file(found: ExportOutcome, path: Path | None) -> dict[str, Any]:
    return {
        **found.robot,
        "file": "" if path is None else str(path),
        "sha256": "" if path is None else digest(str(path)),
    }


def _numbers(found: ExportOutcome) -> dict[str, Any]:
    """What `jaxid replay` needs to run jaxid's own model beside: the numbers alone."""

    def value(table):
        return {k: {"value": n.value, "std": n.std} for k, n in table.items()}

    effects = [
        {"effect": e.effect, "location": e.location, "parameters": value(e.numbers)}
        for e in found.effects
    ]
    return {
        "kind": found.kind,
        "model": found.model,
        "parameters": value(found.parameters),
        "effects": effects,
    }
