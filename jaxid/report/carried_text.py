"""What an export and a replay say on a terminal."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

from jaxid.base.wording import (
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
    rows, same, notes = [], [], {}
    for r in exported.rows:
        effect, location = one_line(r.effect), one_line(r.location)
        if r.kept:
            same.append((effect, location))
            continue
        value = f"{_short(r.value)} {one_line(r.unit)}".strip()
        rows.append((effect, location, one_line(r.field) or "-", value, r.how))
        if r.how != "exact":
            place = f" at {location}" if r.location else ""
            notes[f"{effect}{place}: {one_line(r.note)}"] = None
    lines = [table(head, rows)]
    if same:
        kept = [f"{effect} at {listed(at)}" for effect, at in by_effect(same).items()]
        lines.append(f"as the file has them, which the data allow: {'; '.join(kept)}")
    lines += [*notes, *map(one_line, exported.notes)]
    names = [one_line(name) for name in (*exported.files, "export.json")]
    if folder:
        lines.append(f"written: {listed(f'{folder}/{name}' for name in names)}")
    else:
        lines.append(f"files: {listed(names)}")
    return "\n".join(lines)


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_short(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return "[" + " ".join(_short(v) for v in value) + "]"
    return f"{value:.5g}" if isinstance(value, float) else one_line(str(value))


def replay_text(result: Replay) -> str:
    """Each joint's error in every run of a simulator beside the other's."""
    other = result.other
    columns = ["mujoco", other, "difference"]
    titles = ["rms error in MuJoCo", f"in {'the other file' if other == 'against' else 'jaxid'}"]
    if any("before" in r for r in result.rows):
        columns.insert(0, "before")
        titles[0:1] = ["rms error in MuJoCo before", "patched"]

    def value(v):
        return "-" if v is None else number(v)

    rows = []
    for r in result.rows:
        values = [value(r.get(column)) for column in columns]
        rows.append((one_line(r["experiment"]), one_line(r["joint"]), *values, r["unit"]))
    head = ("run", "joint", *titles, "between both", "unit")
    return "\n".join(
        [
            f"{one_line(result.robot)} on {one_line(result.dataset)}",
            table(head, rows),
            *map(one_line, result.notes),
        ]
    )
