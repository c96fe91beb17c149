"""A fitter with its settings as a text, `de(popsize=20, F=0.5)`: the same on the command line, in a
study file and in Python.
"""

from __future__ import annotations

import ast
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from jaxid.base.errors import nearest, UsageError
from jaxid.base.numbers import is_number


class Setting(NamedTuple):
    """What a setting of a fitter means, and between which bounds it lies."""

    meaning: str
    low: float | None = None
    high: float | None = None


class SettingInfo(NamedTuple):
    name: str
    default: Any
    meaning: str


def option(
    default: Any, meaning: str, low: float | None = None, high: float | None = None, **more: Any
) -> Any:
    """A field of a fitter that can be set; `low` and `high` bound every number in it."""
    import equinox as eqx

    return eqx.field(default=default, metadata=about(meaning, low, high), **more)


def about(meaning: str, low: float | None = None, high: float | None = None) -> dict[str, Setting]:
    """Metadata of a field that can be set."""
    return {"option": Setting(meaning, low, high)}


def settings_of(kind: type) -> list[SettingInfo]:
    """The settings of a class of fitters."""
    return [
        SettingInfo(f.name, _plain(f.default), _about(f).meaning) for f in dataclasses.fields(kind)
    ]


def _about(field: dataclasses.Field) -> Setting:
    return field.metadata.get("option", Setting(""))


def split_outside_brackets(text: str) -> tuple[str, ...]:
    """The parts of a list written with commas, of which those in brackets or quotes belong to a
    part.
    """
    parts, depth, quote = [""], 0, ""
    for character in text:
        if quote:
            quote = "" if character == quote else quote
        elif character in "'\"":
            quote = character
        depth += 0 if quote else (character in "([{") - (character in ")]}")
        if character == "," and depth == 0 and not quote:
            parts.append("")
        else:
            parts[-1] += character
    return tuple(filter(None, map(str.strip, parts)))


def parsed(text: str) -> tuple[str, dict[str, Any]]:
    """Id and settings of a fitter's text; values are literals of Python, nothing is run.

    Raises `UsageError` for a text of another form.
    """
    if "(" not in text:
        return text.strip(), {}
    wrong = UsageError(f"{text!r}: a fitter with settings looks like de(popsize=20, F=0.5)")
    try:
        call = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise wrong from error
    if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name) or call.args:
        raise wrong
    values: dict[str, Any] = {}
    for keyword in call.keywords:
        if keyword.arg is None or keyword.arg in values:
            raise wrong
        try:
            values[keyword.arg] = ast.literal_eval(keyword.value)
        except (ValueError, TypeError, RecursionError, MemoryError) as error:
            raise UsageError(
                f"{text!r}: {keyword.arg} = {ast.unparse(keyword.value)} is not a number, text (in"
                " quotes), true or false"
            ) from error
    return call.func.id, values


def configured(kind: type, values: dict[str, Any], text: str, named: Callable[[str], Any]) -> Any:
    """The fitter of a class with its settings; `named` makes one of the text of another inside of
    it. Raises `UsageError` for a value that does not fit.
    """
    name, fields = kind.name, {f.name: f for f in dataclasses.fields(kind)}  # pyright: ignore[reportAttributeAccessIssue]
    for key in values:
        if key not in fields:
            raise UsageError(f"{name} has no setting {key!r}{nearest(key, fields)}")
    made = {key: _value(name, fields[key], value, named) for key, value in values.items()}
    try:
        return kind(**made)
    except ValueError as error:
        raise UsageError(f"{text}: {error}") from error


def _value(fitter: str, field: dataclasses.Field, given: Any, named: Callable[[str], Any]) -> Any:
    """A value as the type of the field's default; one number for a range of two."""
    default: Any = field.default
    for kind, words in _PLAIN.items():
        if isinstance(default, kind):
            if not isinstance(given, kind):
                raise _refused(fitter, field, given, words)
            return given
    if isinstance(default, tuple):
        value = _pair(given)
        if len(value) != len(default) or not all(map(is_number, value)):
            shown = value or given
            raise _refused(fitter, field, shown, f"a number, or {len(default)} in brackets")
        _check_bounds(fitter, field, value)
        return tuple(map(float, value))
    if not isinstance(default, int | float):
        return _population(fitter, field, given, named)
    whole = isinstance(default, int)
    if not is_number(given) or (whole and not isinstance(given, int)):
        raise _refused(fitter, field, given, "a whole number" if whole else "a number")
    _check_bounds(fitter, field, [given])
    return given if whole else float(given)


#: Types that are taken as they are, and what to write for them.
_PLAIN = {bool: "True or False", str: "a text in quotes"}


def _population(
    fitter: str, field: dataclasses.Field, given: Any, named: Callable[[str], Any]
) -> Any:
    """A fitter inside a fitter."""
    if not isinstance(given, str) or not hasattr(field.default, "minimise"):
        raise _refused(fitter, field, given, "the text of a fitter, in quotes")
    value = named(given)
    if not hasattr(value, "ask"):
        raise UsageError(
            f"{fitter}: {field.name} = {label_of(value)!r}; it is a population, such as 'de'"
        )
    return value


def _pair(given: Any) -> tuple[Any, ...]:
    """A range of two by what was given; empty for what is none."""
    if is_number(given):
        return given, given
    return tuple(given) if isinstance(given, list | tuple) else ()


def _refused(fitter: str, field: dataclasses.Field, value: Any, wanted: str) -> UsageError:
    return UsageError(
        f"{fitter}: {field.name} = {value!r}; it is {wanted}, as in"
        f" {field.name}={_plain(field.default)!r}"
    )


def _check_bounds(fitter: str, field: dataclasses.Field, values: Sequence[float]) -> None:
    """Numbers within the field's bounds, and finite."""
    bounds = _about(field)
    low = -math.inf if bounds.low is None else bounds.low
    high = math.inf if bounds.high is None else bounds.high
    for v in values:
        if not (low <= v <= high and math.isfinite(v)):
            ends = ("at least", bounds.low), ("at most", bounds.high)
            told = " and ".join(f"{word} {b:g}" for word, b in ends if b is not None)
            raise UsageError(f"{fitter}: {field.name} = {v!r}; it is {told or 'a finite number'}")


def _plain(value: Any) -> Any:
    """A default as it is written in a text."""
    return label_of(value) if hasattr(value, "minimise") else value


def label_of(fitter: Any) -> str:
    """A fitter's text: its id, and the settings that are not the default ones."""
    changed = []
    for f in dataclasses.fields(fitter):
        value = getattr(fitter, f.name)
        if type(value) is not type(f.default) or value != f.default:
            plain = isinstance(value, bool | int | float | str | tuple)
            changed.append(f"{f.name}={value!r}" if plain else type(value).__name__)
    return f"{fitter.name}({', '.join(changed)})" if changed else fitter.name
