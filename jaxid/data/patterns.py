"""Patterns of a `dataset.toml`: one table for the channels of many joints (`[channels."q*"]`), one
for many runs (`files`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from jaxid.base.errors import DatasetProblem
from jaxid.data.places import Places
from jaxid.data.schema import ChannelEntry, Document, ExperimentEntry
from jaxid.data.table import Table


def expanded_files(
    document: Document, places: Places, folder: Path, suffixes: tuple[str, ...]
) -> list[DatasetProblem]:
    """Puts one experiment a file in the place of each that names `files`; what matches nothing
    comes back as a problem.
    """
    problems: list[DatasetProblem] = []
    runs: dict[int, ExperimentEntry] = {}
    free = max([*document.experiments, 0]) + 1000
    for index, entry in document.experiments.items():
        if entry.files is None:
            runs[index] = entry
            continue
        key = ("experiments", index, "files")
        found = _matching(folder, entry.files, suffixes)
        if isinstance(found, str):
            problems.append(
                places.problem(
                    key, f"{entry.files!r} {found}", 'Write it with `*`: files = "run_*.csv"'
                )
            )
            document.sound.discard("experiments")
            continue
        for k, file in enumerate(found):
            new = index if k == 0 else (free := free + 1)
            runs[new] = entry.model_copy(update={"file": file, "files": None})
            places.stated[("experiments", new)] = ("experiments", index)
    document.experiments = runs
    return problems


def _matching(folder: Path, pattern: str, suffixes: tuple[str, ...]) -> list[str] | str:
    """Files of the folder that match, in the order in which people count them; or what is wrong
    with the pattern.
    """
    parts = re.split(r"[/\\]", pattern)
    if ".." in parts or Path(pattern).is_absolute() or pattern[1:2] == ":":
        return "lies outside the folder"
    try:
        matching = list(folder.glob("/".join(parts)))
    except (ValueError, OSError) as error:
        return f"is not a pattern ({error})"
    found = [p.relative_to(folder).as_posix() for p in matching if p.suffix.lower() in suffixes]
    if found:
        return sorted(found, key=_as_counted)
    there = []
    if folder.is_dir():
        there = sorted(p.name for p in folder.iterdir() if p.suffix.lower() in suffixes)
    if not there:
        return "matches no file"
    return f"matches no file (there is: {', '.join(there[:12])})"


def _as_counted(name: str) -> list[str | int]:
    """A key by which `run_2` comes before `run_10`."""
    words: list[str | int] = list(re.split(r"(\d+)", name))
    words[1::2] = [int(number) for number in words[1::2]]
    return words


def expanded_channels(
    document: Document,
    places: Places,
    open_table: Callable[[int, ExperimentEntry], Table | DatasetProblem],
) -> list[DatasetProblem]:
    """Puts a channel a joint in the place of each pattern, by the columns of the first run.

    What `*` stands for is the joint: numbers count as they are (from 0 they are moved to 1), names
    in the order of the columns, and kept as names of the joints.
    """
    if not any("*" in name for name in document.channels):
        return []
    names = _columns(document, open_table)
    if names is None:
        return []
    problems: list[DatasetProblem] = []
    channels: dict[str, ChannelEntry] = {}
    joints: dict[str, int] = {}
    for name, entry in document.channels.items():
        if "*" not in name:
            channels[name] = entry
            continue
        found, why = _captured(name, entry, names)
        if not found:
            remedy = f'Write column = "pos_*" (there is: {", ".join(names[:12])})'
            problems.append(places.problem(("channels", name, "column"), why, remedy))
            document.sound.discard("channels")
            continue
        numbered = joint_numbers(list(found), joints)
        for capture in sorted(found, key=lambda capture: numbered[capture]):
            new = name.replace("*", str(numbered[capture]))
            if new in channels or new in document.channels:
                why = f"channel {new!r} stands there twice"
                problems.append(places.problem(("channels", name), why, "Remove one of them"))
                continue
            channels[new] = entry.model_copy(update={"column": found[capture]})
            places.stated[("channels", new)] = ("channels", name)
        listed = ", ".join(f"{numbered[capture]} = {at}" for capture, at in found.items())
        document.notes.append(f"{name}: {listed}")
    document.channels = channels
    if joints:
        named = {f"q{k}": joint for joint, k in joints.items()}
        model = document.stated
        document.model = model.model_copy(update={"joints": named | model.joints})
    return problems


def _captured(
    name: str, entry: ChannelEntry, columns: Sequence[str]
) -> tuple[dict[str, str] | None, str]:
    """What `*` stands for -> its column; or nothing, and why."""
    column = name if entry.column is None else entry.column
    found = None
    if isinstance(column, str) and entry.columns is None:
        found = captures_of(column, columns)
    if found is None:
        return None, "a pattern of channels needs a `column` with one `*`"
    return found, f"no column matches {column!r}"


def joint_numbers(captures: list[str], joints: dict[str, int]) -> dict[str, int]:
    """The joint, from 1, of each text that a `*` stood for; names are added to `joints` in their
    order.
    """
    if all(c.isdigit() for c in captures):
        first = 1 if any(int(c) == 0 for c in captures) else 0
        return {c: int(c) + first for c in captures}
    for capture in captures:
        joints.setdefault(capture, len(joints) + 1)
    return {c: joints[c] for c in captures}


def captures_of(pattern: str, names: Sequence[str]) -> dict[str, str] | None:
    """Text that the `*` of a pattern stands for -> the column; None for a pattern with another
    number of `*`.
    """
    if pattern.count("*") != 1:
        return None
    form = re.compile(re.escape(pattern).replace(r"\*", "(.+)"))
    return {m[1]: name for name in names if (m := form.fullmatch(name))}


def _columns(
    document: Document, open_table: Callable[[int, ExperimentEntry], Table | DatasetProblem]
) -> list[str] | None:
    for index, entry in document.experiments.items():
        table = open_table(index, entry) if entry.kind == "record" else None
        if isinstance(table, Table) and table.columns:
            return list(table.columns)
    return None


def by_number(document: Document) -> bool:
    """Whether columns are named by their numbers, so that files need no header."""
    asked: list[str | int | None] = [document.time]
    for entry in document.channels.values():
        asked += [entry.column, entry.valid, *(entry.columns or ())]
    return any(isinstance(c, int) for c in asked)
