"""A fitter with its settings as a text, `de(popsize=20, F=0.5)`: the same on the command line, in a
study file and in Python.
"""

from __future__ import annotations

import ast
import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

from jaxid.errors import nearest, UsageError


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
    return tuple(name for name in (part.strip() for part in parts) if name)


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
    values = {}
    for keyword in call.keywords:
        if keyword.arg is None or keyword.arg in values:
            raise wrong
        try:
            values[keyword.arg] = ast.literal_eval(keyword.value)
        except (ValueError, TypeError, RecursionError, MemoryError) as error:
            raise UsageError(
                f"{text!r}: {keyword.arg} = {ast.unparse(keyword.value)} is no number, text (in"
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
    value: Any = given
    bounds = _about(field)

    def number(v):
        return isinstance(v, int | float) and not isinstance(v, bool)

    if isinstance(default, bool):
        fits, wanted = isinstance(value, bool), "True or False"
    elif isinstance(default, int):
        fits, wanted = isinstance(value, int) and not isinstance(value, bool), "a whole number"
    elif isinstance(default, float):
        fits, wanted = number(value), "a number"
    elif isinstance(default, tuple):
        value = (
            (value, value)
            if number(value)
            else tuple(value)
            if isinstance(value, list | tuple)
            else value
        )
        wanted = f"a number, or {len(default)} in brackets"
        fits = isinstance(value, tuple) and len(value) == len(default) and all(map(number, value))
    elif isinstance(default, str):
        fits, wanted = isinstance(value, str), "a text in quotes"
    elif isinstance(value, str) and hasattr(default, "minimise"):  # a fitter inside a fitter
        value, fits, wanted = named(value), True, ""
        if not hasattr(value, "ask"):
            raise UsageError(
                f"{fitter}: {field.name} = {label_of(value)!r}; it is a population, such as 'de'"
            )
    else:
        fits, wanted = False, "the text of a fitter, in quotes"
    if not fits:
        raise UsageError(
            f"{fitter}: {field.name} = {value!r}; it is {wanted}, as in"
            f" {field.name}={_plain(default)!r}"
        )
    several: tuple[Any, ...] = value if isinstance(value, tuple) else (value,)
    for v in several:
        if not number(v):
            continue
        below = bounds.low is not None and not v >= bounds.low
        above = bounds.high is not None and not v <= bounds.high
        if below or above or not abs(v) < float("inf"):
            ends = ("at least", bounds.low), ("at most", bounds.high)
            told = " and ".join(f"{word} {b:g}" for word, b in ends if b is not None)
            raise UsageError(f"{fitter}: {field.name} = {v!r}; it is {told or 'a finite number'}")
    if isinstance(default, float | tuple):
        several = tuple(float(v) for v in several)
    return (
        several[0]
        if isinstance(default, float)
        else several
        if isinstance(default, tuple)
        else value
    )


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
