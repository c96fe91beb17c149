"""Words that readers stumble over stand in no page and in no message."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest


ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
SOURCES = [
    file for top in ("jaxid", "models", "fitters") for file in sorted((ROOT / top).rglob("*.py"))
]
#: What is written instead, and what it replaces.
PLAIN = {
    "is not a …": r"(?<!here )\b(?:is|are|was|were) no (?!longer|more|less|better|nearer|need|way|one\b)[a-z]",
    "number of": r"\bso many\b",
}
#: Words that a sentence of the pages has at most, and the sentences that still have more: lists of
#: keys and of sources for the most part. The number may only fall.
LONGEST, LONGER_ONES = 30, 15


def prose(page: Path) -> str:
    """A page without its code, its names in code, its formulas and the targets of its links."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.S)
    text = re.sub(r"\$\$.*?\$\$", "X", text, flags=re.S)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    return re.sub(r"`[^`]*`|\$[^$]*\$", "X", text)


@cache
def messages(source: Path) -> list[tuple[int, str]]:
    """(line, text) of each string that is no docstring and no name."""
    return list(_messages(source))


def _messages(source: Path) -> Iterator[tuple[int, str]]:
    tree = ast.parse(source.read_text())
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = set()
    for node in ast.walk(tree):
        if isinstance(node, documented) and node.body and isinstance(node.body[0], ast.Expr):
            docstrings.add(id(node.body[0].value))
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield node.lineno, "".join(_part(value) for value in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if " " in node.value and id(node) not in docstrings:
                yield node.lineno, node.value


def _part(value: ast.expr) -> str:
    return value.value if isinstance(value, ast.Constant) and isinstance(value.value, str) else "x"


@pytest.mark.parametrize("instead", PLAIN)
def test_pages_and_messages_are_in_plain_words(instead):
    pattern = re.compile(PLAIN[instead], re.I)
    found = []
    for page in PAGES:
        found += [f"{page.name}: {m[0]}" for m in pattern.finditer(prose(page))]
    for source in SOURCES:
        for line, text in messages(source):
            if m := pattern.search(text):
                found.append(f"{source.relative_to(ROOT)}:{line}: {m[0]} in {text[:80]!r}")
    assert not found, f"write {instead!r}:\n" + "\n".join(found)


def sentences(page: Path) -> Iterator[str]:
    """Sentences of a page: those of its paragraphs, of each item of a list, of each cell of a table."""
    lines = prose(page).splitlines()
    blocks: list[str] = []
    for line in map(str.strip, lines):
        if line.startswith("|"):
            blocks += [*line.strip("|").split("|"), ""]
        elif not line or line.startswith("#"):
            blocks.append("")
        elif re.match(r"(?:[-*]|\d+\.)\s", line) or not blocks or not blocks[-1]:
            blocks.append(re.sub(r"^(?:[-*]|\d+\.)\s+", "", line))
        else:
            blocks[-1] += f" {line}"
    for block in blocks:
        yield from re.split(r"(?<=[.!?:;*)])(?<![a-z]\*)(?<![a-z]\))\s+(?=[A-Z*(\[])", block)


def words_in(sentence: str) -> int:
    return len(re.findall(r"[\w.'’-]+", sentence))


def test_sentences_are_short():
    found = []
    for page in PAGES:
        for sentence in sentences(page):
            if words_in(sentence) > LONGEST:
                found.append(f"{page.name}, {words_in(sentence)} words: {sentence}")
    told = "\n".join(found)
    assert len(found) <= LONGER_ONES, f"{len(found)} sentences are too long:\n{told}"
