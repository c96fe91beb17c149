"""How numbers, lists and names are written, the same wherever they stand."""

from __future__ import annotations

import math
import shutil
import sys
import textwrap
import unicodedata
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any, Protocol


# Format characters that turn the direction of text around or hide it; control characters are
# category Cc.
_INVISIBLE = {"Cc", "Cf", "Zl", "Zp", "Cs"}


def one_line(text: object) -> str:
    """The text with every control and direction character (names from files may hold escape
    sequences) as `?`.
    """
    return "".join(map(_visible, str(text)))


def names_of(things: Iterable[Any]) -> list[str]:
    """The `name` of each: channels, effects, runs, files."""
    return [thing.name for thing in things]


def stem_and_number(name: str) -> tuple[str, str]:
    """`Ixx12` as `Ixx` and `12`, which is empty where a name ends with no number."""
    stem = name.rstrip("0123456789")
    return stem, name[len(stem) :]


def _visible(character: str) -> str:
    return "?" if unicodedata.category(character) in _INVISIBLE else character


def first_sentence(text: str) -> str:
    """Without its full stop, on one line."""
    return " ".join(text.split()).split(". ")[0].rstrip(".")


def clean(text: object) -> str:
    """Like `one_line`, keeping line breaks."""
    return "\n".join(one_line(line) for line in str(text).split("\n"))


def number(value: float | None, digits: int = 3) -> str:
    """A number with `digits` significant digits; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        exponent = int(
            f"{value:.{digits - 1}e}".split("e")[1]
        )  # of the rounded number: 0.09999 has that of 0.1
        return f"{value:.{max(0, digits - 1 - exponent)}f}"
    return f"{value:.{digits - 1}e}"


class Measured(Protocol):
    """A number with its standard deviation (None where there is none) and its unit."""

    @property
    def value(self) -> float: ...
    @property
    def std(self) -> float | None: ...
    @property
    def unit(self) -> str: ...


#: A standard deviation below this share of its number is said as that: four digits tell the number.
CLOSE = 1e-4


def unit_after(unit: str) -> str:
    """A unit as it stands behind a number: " N m"; nothing where there is none, or it is 1."""
    return "" if unit in ("", "1") else f" {one_line(unit)}"


def value_with_std(estimate: Measured, unit: bool = True) -> str:
    """`0.0812 ± 0.0004 kg m^2`, rounded to two digits of the standard deviation; four digits where
    it is known better.
    """
    value, std = estimate.value, estimate.std
    tail = unit_after(estimate.unit) if unit else ""
    if std is None or not math.isfinite(std) or std <= 0 or not math.isfinite(value):
        return number(value) + tail
    if std < CLOSE * abs(value):
        return f"{number(value, 4)}{tail} (± under 0.01 %)"
    exponent = math.floor(math.log10(std)) - 1
    if -7 <= exponent <= 3 and abs(value) < 1e6:
        decimals = max(0, -exponent)
        return f"{value:.{decimals}f} ± {std:.{decimals}f}{tail}"
    digits = 2 if value == 0 else max(2, math.floor(math.log10(abs(value))) - exponent + 1)
    return f"{value:.{min(digits, 15) - 1}e} ± {std:.1e}{tail}"


def short(value: float | None) -> str:
    """A number that is exact as written (a bound, a time): no zeros at its end."""
    return "–" if value is None or math.isnan(value) else f"{value:.4g}".replace("inf", "∞")


def times(multiple: float | None) -> str:
    """A multiple of the noise, as exact as a person reads it."""
    if multiple is None or not math.isfinite(multiple):
        return "–"
    return (
        f"{multiple:.2f}"
        if abs(multiple) < 2
        else f"{multiple:.1f}"
        if abs(multiple) < 9.95
        else number(multiple, 2)
    )


def percent(fraction: float | None) -> str:
    """A fraction in percent, with the digits that still tell 99.8 from 99.98 and 0.1 from 0.01."""
    if fraction is None or not math.isfinite(fraction):
        return "–"
    if fraction < -1:
        return "below −100 %"
    if fraction > 10:
        return f"{number(100 * fraction)} %"
    rest = min(abs(fraction), abs(1 - abs(fraction)))
    if 0 < rest < 5e-5 and fraction > 0.5:
        return "over 99.99 %" if fraction < 1 else "100 %"
    decimals = 0 if rest > 0.05 or rest == 0 else 1 if rest >= 1e-3 else 2
    return f"{100 * fraction:.{decimals}f} %"


def run_words(name: str) -> str:
    """A run as a person says it: `run_1#2#fit` is run_1, part 2 (fit data)."""
    base, *marks = name.split("#")
    parts = [mark for mark in marks if mark.isdigit()]
    splits = [mark for mark in marks if mark in ("fit", "validation", "report")]
    if not base or len(parts) + len(splits) < len(marks):  # a name of the user's own
        return name
    part = f", part {'.'.join(parts)}" if parts else ""
    return f"{base}{part}" + "".join(f" ({split} data)" for split in splits)


def listed(names: Iterable[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    *first, last = [*names] or [""]
    if not first:
        return last
    return f"{', '.join(first)} and {last}"


def as_unit(have: str, wanted: str) -> str:
    """What to write for a channel in one unit (SI) where another one is needed."""
    line = f'unit = "{wanted}"'
    if have == wanted:
        return line
    of_current = "of a current torque constant times gear ratio"
    return f"{line} and scale = … (in {wanted}, of each 1 recorded: {of_current})"


def by_effect(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Places of each effect, of (effect, place), in their order."""
    places: dict[str, list[str]] = {}
    for effect, place in pairs:
        places.setdefault(effect, []).append(place)
    return places


def placed(names: Iterable[str]) -> str:
    """`lag at tau1 and tau2 and drag at q1` of `lag at tau1`, `lag at tau2`, `drag at q1`: every
    effect once, with its places.
    """
    pairs = []
    for name in names:
        effect, _, place = name.partition(" at ")
        pairs.append((effect, place))
    said = []
    for effect, at in by_effect(pairs).items():
        said.append(f"{effect} at {listed(at)}" if any(at) else effect)
    return " and ".join(said)


def regime_words(regime: str) -> str:
    return one_line(regime).replace("_", " ")


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Left-aligned columns, two spaces apart."""
    cells = [list(map(one_line, row)) for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = []
    for row in cells:
        padded = map(str.ljust, row, widths)
        lines.append("  ".join(padded).rstrip())
    return "\n".join(lines)


def paragraph(label: str, sentences: Iterable[str]) -> str:
    """Sentences wrapped to the terminal, each on a line of its own behind one label."""
    lines = []
    for sentence in filter(None, sentences):
        lines.append(wrapped(sentence, f"{'' if lines else label:10}", " " * 10))
    return "\n".join(lines)


def wrapped(sentence: str, first: str = "", others: str = "") -> str:
    width = max(40, min(shutil.get_terminal_size((100, 24)).columns, 110))
    lines = textwrap.TextWrapper(
        width, initial_indent=first, subsequent_indent=others, break_on_hyphens=False
    )
    return "\n".join(lines.wrap(one_line(sentence)))


def complain(text: object) -> None:
    """Says a sentence on standard error, where it still exists."""
    with suppress(OSError):  # the terminal is gone
        print(f"jaxid: {clean(text)}", file=sys.stderr, flush=True)
