"""Targets that take a text of settings: a table of fields and a writer. What cannot be run here
says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from jaxid.robots.export.law_code import c_code, code, lawful
from jaxid.robots.export.sheet import JointNumbers, LinkInertia, Sheet
from jaxid.robots.export.target import (
    by_joint,
    CODE,
    coded,
    ExportRow,
    Field,
    joined,
    NONE,
    rows_of,
    Written,
)


QUANTITIES = (*JointNumbers.__dataclass_fields__, "force")
Writer = Callable[[Sheet, Mapping[str, dict[str, Any]], Mapping[str, LinkInertia]], str]


def written(
    sheet: Sheet,
    fields: Mapping[str, Field],
    elsewhere: Mapping[str, str],
    file: str,
    writer: Writer,
    version: str,
    library: str | None = "numpy",
    tail: str = "",
    how: str = CODE,
) -> Written:
    """Rows by the table of fields, the text that `writer` makes of the numbers that have one, and
    the code of the laws that have none (`library` "c": for a plugin, without laws that remember;
    None: this framework runs no such code).
    """
    plugin = library == "c"
    if library is None or plugin:
        how = NONE
    effects = {None: "", "c": "effects.h"}.get(library, "effects.py")
    lacking = coded(effects, elsewhere, how, remembers=not plugin)
    untried = f"written for {version}, not run"
    out = Written(_noted(rows_of(sheet, fields, lacking), untried))
    numbers = by_joint(sheet, [q for q in QUANTITIES if q in fields])
    bodies = {}
    if "inertial" in fields:
        bodies = {link: after for link, (_, after) in sheet.bodies.items()}
    turned = "gravity" in fields and "gravity" in {c.quantity for c in sheet.changes}
    if numbers or bodies or turned:
        out.files[file] = writer(sheet, numbers, bodies)
    if library and (
        laws := lawful(c for c, r in zip(sheet.changes, out.rows, strict=True) if r.how == "code")
    ):
        head = f"Laws that no field says; {untried}."
        out.files[effects] = c_code(laws, head) if plugin else code(laws, head, tail, library)
    out.notes.append(untried)
    return out


def _noted(rows: Sequence[ExportRow], note: str) -> list[ExportRow]:
    """The rows, those that have a field with a note."""
    return [replace(r, note=joined(r.note, note)) if r.field else r for r in rows]


def central(body: LinkInertia) -> list[float]:
    """Ixx Iyy Izz Ixy Ixz Iyz about the centre of mass."""
    I = body.inertia
    return [float(v) for v in (I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])]
