"""Where the keys of a `dataset.toml` stand: problems that name the key as people write it, and its
line.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Any

from jaxid.base.errors import DatasetProblem


class Places:
    """Makes problems of `dataset.toml`: the key as people write it, and its line."""

    def __init__(self, file: str, text: str = ""):
        self.file = file
        self.text = text.splitlines()
        self.lines = _key_lines(text)
        self.stated: dict[
            tuple[str | int, ...], tuple[str | int, ...]
        ] = {}  # what a pattern became -> the pattern's own key

    def line(self, key: tuple[str | int, ...]) -> str:
        """The text of the line that states a key, or nothing."""
        number = self.lines.get(key)
        return self.text[number - 1] if number is not None and number <= len(self.text) else ""

    def problem(self, key: tuple[str | int, ...], message: str, remedy: str) -> DatasetProblem:
        own = self.stated.get(key[:2])
        key = key if own is None else (*own, *key[2:])
        line = next(
            (self.lines[key[:n]] for n in range(len(key), 0, -1) if key[:n] in self.lines), None
        )
        return DatasetProblem(self.file, line, dotted(key) or None, message, remedy)


def dotted(key: tuple[str | int, ...]) -> str:
    text = ""
    for part in key:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if text else part
    return text


_KEY = r"""(?:"(?:[^"\\]|\\.)*"|'[^']*'|[A-Za-z0-9_-]+)"""
_DOTTED = rf"{_KEY}(?:\s*\.\s*{_KEY})*"


def _key_lines(text: str) -> dict[tuple[str | int, ...], int]:
    """The line of each key of a TOML text, by a light scan (tomllib does not tell)."""
    lines: dict[tuple[str | int, ...], int] = {}
    counts: dict[str, int] = {}
    table: tuple[str | int, ...] = ()
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(rf"\s*(\[\[?)\s*({_DOTTED})\s*\]", line):
            table = _parts(header[2])
            first = str(table[0])
            if header[1] == "[[" and len(table) == 1:
                counts[first] = counts.get(first, -1) + 1
            if first in counts:
                table = (first, counts[first], *table[1:])
            key = table
            lines.setdefault((first,), number)
        elif pair := re.match(rf"\s*({_DOTTED})\s*=", line):
            key = (*table, *_parts(pair[1]))
        else:
            continue
        lines.setdefault(key, number)
    return lines


def _parts(dotted: str) -> tuple[str, ...]:
    """The words of a dotted key, without quotes."""
    words = []
    for word in re.findall(_KEY, dotted):
        words.append(tomllib.loads(f"key = {word}")["key"] if word[0] in "\"'" else word)
    return tuple(words)


def real_path(loc: tuple[str | int, ...], raw: Any) -> tuple[str | int, ...]:
    """The part of pydantic's location that stands in the data (it also names branches of
    unions).
    """
    path: list[str | int] = []
    for part in loc:
        if isinstance(raw, Mapping) and part in raw:
            raw = raw[part]
        elif isinstance(raw, list) and isinstance(part, int) and part < len(raw):
            raw = raw[part]
        else:
            if not path and isinstance(part, str):
                path.append(part)
            elif (
                isinstance(raw, Mapping)
                and isinstance(part, str)
                and part.isidentifier()
                and part not in _BRANCHES
            ):
                path.append(part)
            break
        path.append(part)
    return tuple(path)


_BRANCHES = {"str", "int", "float", "bool", "date", "dict", "list"}
