"""What to do with the result of a robot: the commands that carry it back into a simulator."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from jaxid.base import wording
from jaxid.report.page import Section


def section(result: Any, file: str) -> Section | None:
    """For the result of a robot; None for another one. `file` is the name of its JSON."""
    robot = getattr(result, "robot", None) or {}
    if not robot.get("file"):
        return None
    name = Path(robot["file"])
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
    for r in (r for r in rows if not r.kept):
        value = f"{wording.number(r.value, 4) if isinstance(r.value, float) else r.value} {r.unit}".strip()
        told.append(
            (
                f"{r.effect} at {r.location}" if r.location else r.effect,
                r.field or f"no field ({r.how})",
                value,
                r.note,
            )
        )
    return told
