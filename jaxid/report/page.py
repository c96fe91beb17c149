"""Puts sections into a page. Everything that comes from files is escaped by the templates."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from jaxid.base import wording
from jaxid.base.wording import one_line
from jaxid.report import text
from jaxid.report.accessible import accessible, with_contents


class Section(NamedTuple):
    """A template and what it shows."""

    template: str
    context: dict[str, Any]


_environment = Environment(
    loader=PackageLoader("jaxid.report", "."),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    # Names from files may hold control and direction characters, which HTML does not escape.
    finalize=lambda value: value if isinstance(value, Markup) else one_line(value),
)
_environment.filters.update(
    number=wording.number,
    short=wording.short,
    percent=wording.percent,
    estimate=text.value_with_std,
)


def render(title: str, sections: Iterable[Section | None], result: str, content: bytes) -> str:
    """The whole page; sections that are None are left out. `result`: name of the file it belongs
    to, with its content.
    """
    digest = hashlib.sha256(content).hexdigest()
    return _environment.get_template("page.html").render(
        title=title,
        style=_style(),
        body=Markup(with_contents(_body(sections))),
        result=result,
        digest=digest,
    )


def render_fragment(sections: Iterable[Section | None]) -> str:
    return f'<style>{_style()}</style>\n<div class="jaxid">\n{_body(sections)}\n</div>'


def _body(sections: Iterable[Section | None]) -> Markup:
    parts = [
        _environment.get_template(s.template).render(s.context) for s in sections if s is not None
    ]
    return Markup(accessible("\n".join(parts)))


def _style() -> Markup:
    source = _environment.loader.get_source(_environment, "style.css")[0]  # pyright: ignore[reportOptionalMemberAccess]
    return Markup(source)
