"""The one door from a value to what shows it: pages, pictures and texts stand above the values that
they show, and are read when somebody asks for them (`jaxid.report.display`).
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any


def displays() -> Any:
    """The module `jaxid.report.display`: text, page, fragment, picture of a value."""
    return import_module("jaxid.report.display")


class Printed:
    """Abstract: prints as the text that the command line shows."""

    def __repr__(self) -> str:
        return displays().text(self)


class Displayed(Printed):
    """Abstract: a result with a text, a fragment for notebooks, and a page of its own."""

    def report(self, path: str | Path) -> Path:
        """Writes the report page (one self-contained HTML file) and returns its path.

        Raises `NotSaved` where it cannot be written.
        """
        return displays().write(self, path)

    def _repr_html_(self) -> str:
        return displays().fragment(self)
