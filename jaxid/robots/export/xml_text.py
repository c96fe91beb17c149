"""Edits of an XML file as text: attributes of elements, with everything else (comments, order,
spaces) left as it stands.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from jaxid.base.errors import UsageError


_ATTRIBUTE = re.compile(rb"""\s+([^\s=/>]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass
class Element:
    """A start tag at bytes [start, end) of the text; `close` is where its end tag begins, -1 where
    it has none.
    """

    name: str
    attributes: dict[str, str]
    parent: Element | None
    start: int
    end: int = 0
    close: int = -1
    children: list[Element] = field(default_factory=list)

    def above(self) -> list[str]:
        """Names of the elements around it, the nearest first."""
        out, one = [], self.parent
        while one is not None:
            out.append(one.name)
            one = one.parent
        return out

    def child(self, name: str) -> Element | None:
        return next((c for c in self.children if c.name == name), None)


class XmlText:
    """A text, its elements, and edits that are made all at once at the end. Texts that were parsed
    safely before only.
    """

    def __init__(self, text: str):
        self.text = text.encode()
        self.elements: list[Element] = []
        self._edits: list[tuple[int, int, bytes]] = []
        self._wanted: dict[int, dict[str, str | None]] = {}
        self._tags: dict[int, str] = {}
        self._parse()

    def _parse(self) -> None:
        parser = expat.ParserCreate()
        stack: list[Element] = []

        def start(name: str, attributes: dict[str, str]) -> None:
            one = Element(name, attributes, stack[-1] if stack else None, parser.CurrentByteIndex)
            one.end = self._tag_end(one.start)
            if stack:
                stack[-1].children.append(one)
            self.elements.append(one)
            stack.append(one)

        def end(_name: str) -> None:
            one = stack.pop()
            if self.text[one.end - 2 : one.end] != b"/>":
                one.close = parser.CurrentByteIndex

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.Parse(self.text, True)

    def _tag_end(self, start: int) -> int:
        """Behind the `>` that ends a start tag; `>` may stand in quotes."""
        quote = 0
        for i in range(start, len(self.text)):
            c = self.text[i]
            if quote:
                quote = 0 if c == quote else quote
            elif c in (34, 39):
                quote = c
            elif c == 62:
                return i + 1
        raise UsageError("an XML tag that does not end")

    def set(self, element: Element, attributes: Mapping[str, str | None]) -> None:
        """These attributes at this element; None takes one away."""
        self._wanted.setdefault(id(element), {}).update(attributes)

    def rename(self, element: Element, name: str) -> None:
        """Another name for an element that has no end tag, or one with it."""
        self._tags[id(element)] = name

    def insert(self, element: Element, text: str) -> None:
        """A line of XML as the last child of an element."""
        line, inside = self._indent(element.start), self._indent(element.start) + "  "
        if element.children:
            inside = self._indent(element.children[0].start)
        if element.close < 0:
            at = element.end - 2
            self._edits.append(
                (
                    at,
                    element.end,
                    f">\n{inside}{text}\n{line}</{self._tags.get(id(element), element.name)}>".encode(),
                )
            )
        else:
            # Before the indent of the end tag, where that stands on a line of its own.
            begin = self.text.rfind(b"\n", 0, element.close) + 1
            alone = not self.text[begin : element.close].strip()
            at = begin if alone else element.close
            self._edits.append(
                (at, at, (f"{inside}{text}\n" if alone else f"\n{inside}{text}\n{line}").encode())
            )

    def before_end(self, text: str) -> None:
        """A line of XML at the end of the outermost element."""
        self.insert(self.elements[0], text)

    def _indent(self, at: int) -> str:
        begin = self.text.rfind(b"\n", 0, at) + 1
        line = self.text[begin:at]
        return line[: len(line) - len(line.lstrip())].decode()

    def result(self) -> str:
        """The text with all edits."""
        edits = list(self._edits)
        for one in self.elements:
            edits += self._of(one)
        out = self.text
        for start, end, new in sorted(edits, key=lambda e: (e[0], e[1]), reverse=True):
            out = out[:start] + new + out[end:]
        return out.decode()

    def _of(self, one: Element) -> list[tuple[int, int, bytes]]:
        edits: list[tuple[int, int, bytes]] = []
        if name := self._tags.get(id(one)):
            edits.append((one.start + 1, one.start + 1 + len(one.name.encode()), name.encode()))
            if one.close >= 0:
                edits.append((one.close + 2, one.close + 2 + len(one.name.encode()), name.encode()))
        wanted = dict(self._wanted.get(id(one), {}))
        for found in _ATTRIBUTE.finditer(self.text, one.start, one.end):
            key = found[1].decode()
            if key in wanted:
                value = wanted.pop(key)
                edits.append(
                    (*found.span(2), quoteattr(value).encode())
                    if value is not None
                    else (*found.span(0), b"")
                )
        new = "".join(f" {k}={quoteattr(v)}" for k, v in wanted.items() if v is not None)
        if new:
            at = one.end - (2 if self.text[one.end - 2 : one.end] == b"/>" else 1)
            at -= len(self.text[one.start : at]) - len(self.text[one.start : at].rstrip())
            edits.append((at, at, new.encode()))
        return edits


def number(value: float) -> str:
    """A number as it goes into a file: ten digits."""
    return f"{float(value):.10g}"


def numbers(values) -> str:
    return " ".join(map(number, values))
