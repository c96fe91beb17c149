"""A page for everybody: a table of contents, and tables that a screen reader can announce.

The templates say what stands where; this adds what follows from it: an id for every heading, the
list of them, the scope of every head of a column or row, a caption for every table, which is the
heading or the sentence that it stands under, and a box in which it scrolls on a narrow screen.
What is long is folded, so that a page of many joints is seen at a glance; print shows all of it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator


_HEADING = re.compile(r"<h2>(.*?)</h2>", re.DOTALL)
_TAG = re.compile(r"<[^>]*>")
#: Fewer headings than this are seen at a glance.
FEW = 3
#: Of the class `folds`, a table of more rows is folded, and of pictures in a row that are more than
#: these all but the first two.
ROWS, PICTURES, SHOWN = 10, 3, 2
_FIGURE = r'<figure class="folds">(?:(?!</figure>).)*</figure>\s*'
_FIGURES = re.compile(f"(?:{_FIGURE}){{{PICTURES + 1},}}", re.DOTALL)


def accessible(body: str) -> str:
    """A body with scopes and captions, and long parts folded."""
    return _FIGURES.sub(_few_shown, "".join(_with_captions(body)))


def _few_shown(figures: re.Match[str]) -> str:
    """The first pictures of a row, the others folded."""
    every = re.findall(_FIGURE, figures[0], re.DOTALL)
    more = every[SHOWN:]
    return "".join(every[:SHOWN]) + _folded(f"{len(more)} more pictures", "".join(more))


def _folded(summary: str, content: str) -> str:
    return f"<details>\n<summary>{summary}</summary>\n{content}\n</details>\n"


def with_contents(body: str) -> str:
    """The body of a page with an id for each heading, and the list of them below its answer."""
    body, headings = _with_ids(body)
    if len(headings) < FEW:
        return body
    links = "".join(f'<li><a href="#{place}">{title}</a></li>' for place, title in headings)
    contents = f'<nav class="contents" aria-label="On this page"><ul>{links}</ul></nav>'
    place = _below_the_answer(body)
    return f"{body[:place]}\n{contents}\n{body[place:]}"


def _below_the_answer(body: str) -> int:
    """Where the section of the first heading ends, or its first part where it has several."""
    answer = max(body.find("<h1"), 0)
    ends = [body.find("</section>", answer) + len("</section>"), body.find("<h2", answer)]
    return min(end for end in ends if end > answer)


def _with_ids(body: str) -> tuple[str, list[tuple[str, str]]]:
    """The body with an id in each second heading, and the headings."""
    headings: list[tuple[str, str]] = []

    def named(match: re.Match[str]) -> str:
        title = _TAG.sub("", match[1]).strip()
        words = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:40]
        taken = {place for place, _ in headings}
        place = words if words and words not in taken else f"{words}-{len(headings)}"
        headings.append((place, title))
        return f'<h2 id="{place}">{match[1]}</h2>'

    return _HEADING.sub(named, body), headings


def _with_captions(body: str) -> Iterator[str]:
    """The body in parts, with captions and scopes in its tables."""
    said = ""
    for part in re.split(r"(<table.*?</table>)", body, flags=re.DOTALL):
        if not part.startswith("<table"):
            found = re.findall(r"<(h[12]|figcaption)[^>]*>(.*?)</\1>", part, re.DOTALL)
            said = _TAG.sub("", found[-1][1]).strip() if found else said
            yield part
            continue
        captioned = part if "<caption" in part else _captioned(part, said)
        table = _scrolling(_scoped(captioned))
        rows = part.count("<tr>") - part.count("<thead")
        if rows > ROWS and part.startswith('<table class="folds"'):
            table = _folded(f"{_name_of(captioned)}: a table of {rows} rows", table)
        yield table


def _name_of(table: str) -> str:
    """The caption of a table as text."""
    found = re.search(r"<caption>(.*?)</caption>", table, re.DOTALL)
    return _TAG.sub("", found[1]).strip() if found else "table"


def _captioned(table: str, said: str) -> str:
    return re.sub(r"^(<table[^>]*>)", rf"\1<caption>{_literal(said)}</caption>", table, count=1)


def _scrolling(table: str) -> str:
    """The table in a box that a narrow screen scrolls, also by the keyboard."""
    name = _name_of(table).replace('"', "&quot;")
    return f'<div class="scrolls" role="group" aria-label="{name}" tabindex="0">{table}</div>'


def _literal(text: str) -> str:
    """The text where a backslash is one."""
    return text.replace("\\", "\\\\")


def _scoped(table: str) -> str:
    """A head above several columns is that of a column, one that begins a row that of the row."""
    head, end, rest = table.partition("</thead>")
    if not end:
        first, close, rest = table.partition("</tr>")
        if first.count("<th") > 1:
            return _heads(first, "col") + close + _heads(rest, "row")
        return _heads(table, "row")
    return _heads(head, "col") + end + _heads(rest, "row")


def _heads(part: str, scope: str) -> str:
    return re.sub(r"<th(?=[ >])", f'<th scope="{scope}"', part)
