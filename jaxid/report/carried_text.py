"""What an export and a replay say on a terminal."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from jaxid.wording import (
    by_effect,
    listed,
    number,
    one_line,
    table,
)


if TYPE_CHECKING:
    from jaxid.fitting.replay import Replay
    from jaxid.robots.export.run import Exported


def export_text(exported: Exported, folder: Any = "") -> str:
    """What went where, a line for each row, and the files, which stand in `folder` where they were
    written.
    """
    head = ("effect or number", "at", "field", "value", "how")
    rows = [
        (
            one_line(r.effect),
            one_line(r.location),
            one_line(r.field) or "-",
            f"{_short(r.value)} {one_line(r.unit)}".strip(),
            r.how,
        )
        for r in exported.rows
        if not r.kept
    ]
    same = by_effect((one_line(r.effect), one_line(r.location)) for r in exported.rows if r.kept)
    notes = dict.fromkeys(
        f"{one_line(r.effect)}{f' at {one_line(r.location)}' if r.location else ''}:"
        f" {one_line(r.note)}"
        for r in exported.rows
        if r.how != "exact" and not r.kept
    )
    names = [one_line(name) for name in (*exported.files, "export.json")]
    files = (
        f"written: {listed(f'{folder}/{name}' for name in names)}"
        if folder
        else f"files: {listed(names)}"
    )
    kept = (
        [
            "as the file has them, which the data allow:"
            f" {'; '.join(f'{k} at {listed(at)}' for k, at in same.items())}"
        ]
        if same
        else []
    )
    return "\n".join([table(head, rows), *kept, *notes, *map(one_line, exported.notes), files])


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_short(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return "[" + " ".join(_short(v) for v in value) + "]"
    return f"{value:.5g}" if isinstance(value, float) else one_line(str(value))


def replay_text(result: Replay) -> str:
    """Each joint's error in every run of a simulator beside the other's."""
    other, patched = result.other, any("before" in r for r in result.rows)
    columns = (*(["before"] if patched else []), "mujoco", other, "difference")

    def value(v):
        return "-" if v is None else number(v)

    rows = [
        (
            one_line(r["experiment"]),
            one_line(r["joint"]),
            *(value(r.get(c)) for c in columns),
            r["unit"],
        )
        for r in result.rows
    ]
    head = (
        "run",
        "joint",
        *(["rms error in MuJoCo before"] if patched else []),
        "patched" if patched else "rms error in MuJoCo",
        f"in {'the other file' if other == 'against' else 'jaxid'}",
        "between both",
        "unit",
    )
    return "\n".join(
        [
            f"{one_line(result.robot)} on {one_line(result.dataset)}",
            table(head, rows),
            *map(one_line, result.notes),
        ]
    )
