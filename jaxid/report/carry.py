"""What to do with a result: the values to write, the commands that carry it into a simulator."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any, NamedTuple

from jaxid.base import wording
from jaxid.dynamics.catalogue import TARGETS
from jaxid.fitting.result import Estimate, Fit
from jaxid.identification.result import Identification
from jaxid.report.page import Section


class ValueToWrite(NamedTuple):
    """A number to write: which it is, what was stated (None for a number of an effect), what the
    data say.
    """

    name: str
    stated: float | None
    found: Estimate


def section(result: Fit | Identification, file: str, believed: bool = True) -> Section | None:
    """The commands for the result of a robot, the values for another model; None where there are
    none. `file` is the name of the result's JSON, `believed` whether its numbers may be written.
    """
    robot = getattr(result, "robot", None) or {}
    if robot.get("file"):
        return _of_robot(result, file, Path(robot["file"]))
    values = values_to_write(result) if believed and isinstance(result, Fit) else []
    if not values:
        return None
    return Section("values.html", {"values": values, "file": file, "targets": TARGETS})


def values_to_write(fit: Fit) -> list[ValueToWrite]:
    """Stated numbers that the data refute, and the numbers of the effects."""
    found: list[ValueToWrite] = []
    for s in fit.stated:
        if s.refuted and s.parameter in fit.parameters:
            found.append(ValueToWrite(s.parameter, s.stated, fit.parameters[s.parameter]))
    for effect in fit.effects:
        for name, estimate in effect.parameters.items():
            found.append(ValueToWrite(f"{name} of {effect}", None, estimate))
    return found


def _of_robot(result: Any, file: str, name: Path) -> Section:
    to = "urdf" if name.suffix.lower() == ".urdf" else "mjcf"
    patched = shlex.quote(f"patched/{name.name}")
    lines = [
        (
            f"jaxid export {file} --to {to} --ranges --out patched",
            "your own file with what was found, and ranges to randomise by",
        ),
        (
            f"jaxid replay DATASET --robot {patched} --out round_trip",
            "the patched file in MuJoCo on the same log, joint by joint",
        ),
    ]
    return Section(
        "carry.html", {"lines": lines, "robot": name.name, "changes": changes(result, to)}
    )


def changes(result: Any, to: str) -> list[tuple[str, str, str, str]]:
    """What the patched file says otherwise: number, field, value, and what is to be said; none
    where the file is not at hand.
    """
    from jaxid.base.errors import UsageError

    try:
        rows = result.export(to).rows
    except (UsageError, OSError):
        return []
    told = []
    for row in rows:
        if row.kept:
            continue
        name = f"{row.effect} at {row.location}" if row.location else row.effect
        field = row.field or f"no field ({row.how})"
        value = wording.number(row.value, 4) if isinstance(row.value, float) else row.value
        told.append((name, field, f"{value} {row.unit}".strip(), row.note))
    return told
