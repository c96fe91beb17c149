"""XML of a stranger's file, read without anything that XML lets a file ask of its reader."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn
from xml.etree.ElementTree import Element, TreeBuilder, XMLParser


class Declares(ValueError):
    """The file has a document type: its entities could name other files, or grow without end."""


class _WithoutDeclarations(TreeBuilder):
    """Builds the tree, and stops at a document type, which comes before anything that uses it."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> NoReturn:
        raise Declares("declares entities or external content")


def xml_root(source: Path | str) -> Element:
    """The outermost element of an XML file, or of the text itself.

    Raises `Declares` for a document type, `xml.etree.ElementTree.ParseError` for what is not XML,
    and `OSError` for a file that cannot be read.
    """
    content = source.read_bytes() if isinstance(source, Path) else source
    parser = XMLParser(target=_WithoutDeclarations())
    parser.feed(content)
    return parser.close()
