"""What `jaxid models`, `jaxid effects` and `jaxid fitters` print."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from jaxid.base.errors import nearest, UsageError
from jaxid.base.serialise import finite, SCHEMA
from jaxid.base.wording import first_sentence, one_line, stem_and_number, table


def find(kind: str, name: str | None) -> list[Any]:
    """The descriptions of everything of a kind (`models`, `effects`, `fitters`), or of the one
    named.
    """
    from jaxid.data.model_names import is_model_file
    from jaxid.dynamics import catalogue
    from jaxid.fitters import by_name

    list_names, describe = {
        "models": (catalogue.model_names, catalogue.describe),
        "effects": (catalogue.effect_names, catalogue.describe_effect),
        "fitters": (by_name.fitter_names, by_name.describe_fitter),
    }[kind]
    known = list_names()
    if name is None:
        return list(map(describe, known))
    own = kind == "models" and is_model_file(name)
    if name not in known and not own:
        raise UsageError(f"there is no {kind[:-1]} {name!r}{nearest(name, known)}")
    return [describe(name)]


def plain(value: Any) -> Any:
    """Named tuples as dictionaries, whatever JSON has no word for as text."""
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return list(map(plain, value))
    if isinstance(value, bool | int | float | str | None):
        return finite(value)
    return str(value)


def to_dict(kind: str, name: str | None, found: Sequence[Any]) -> dict[str, Any]:
    """The JSON of a list, or of one description."""
    if name is None:
        return {"schema": SCHEMA, "kind": kind, kind: [plain(info) for info in found]}
    return {"schema": SCHEMA, "kind": kind[:-1], **plain(found[0])}


def summary(kind: str, found: Sequence[Any]) -> str:
    """One line for each."""
    head, row = {
        "models": (("model", "inputs → outputs", "fitted parameters"), _model_row),
        "effects": (("effect", "family", "location", "equation"), _effect_row),
        "fitters": (("fitter", "what it does"), _fitter_row),
    }[kind]
    return table(head, list(map(row, found)))


def _model_row(m: Any) -> tuple[str, ...]:
    return m.name, "; ".join(map(signature, m.signatures)), ", ".join(numbered(m.parameters))


def _effect_row(e: Any) -> tuple[str, ...]:
    return e.name, e.family, e.locations, one_line(e.equation)


def _fitter_row(f: Any) -> tuple[str, ...]:
    return f.name, first_sentence(f.text)


def numbered(names: Sequence[str]) -> list[str]:
    """The same with numbers one to n of a name in one: `m1 … m6`."""
    groups: list[list[str]] = []
    for name in names:
        if groups and _is_next(name, groups[-1][-1]):
            groups[-1].append(name)
        else:
            groups.append([name])
    out: list[str] = []
    for group in groups:
        out += group if len(group) < 3 else [f"{group[0]} … {group[-1]}"]
    return out


def _is_next(name: str, before: str) -> bool:
    """Whether a name is that before it with the next number: `m2` behind `m1`."""
    stem, count = stem_and_number(before)
    digits = name.removeprefix(stem)
    return digits.isdecimal() and count != "" and int(digits) == int(count) + 1


def channels(pairs: Sequence[tuple[str, str]]) -> str:
    """`tau (N m)`, or `tau1 … tau6 (N m)` where many have one unit."""
    groups: dict[str, list[str]] = {}
    for name, unit in pairs:
        groups.setdefault(unit, []).append(name)
    if all(len(names) < 3 for names in groups.values()):
        return ", ".join(f"{name} ({unit})" for name, unit in pairs)
    return ", ".join(f"{', '.join(numbered(names))} ({unit})" for unit, names in groups.items())


def signature(of: Any) -> str:
    """`tau (N m) → q (rad)`."""
    return " → ".join(channels(side) for side in (of.inputs, of.outputs))


def description(info: Any) -> str:
    """Everything about one model, effect or fitter: long tables last."""
    lines, tables = [info.name], []
    for label, value in plain(info).items():
        title = label.replace("_", " ")
        if label == "name" or not value:
            continue
        if label == "signatures":
            lines += [f"  inputs → outputs: {signature(s)}" for s in info.signatures]
        elif isinstance(value, list) and isinstance(value[0], dict):
            rows = [list(map(str, row.values())) for row in value]
            tables += ["", title.removesuffix(" info"), indented(table(list(value[0]), rows))]
        elif "\n" in str(value):
            lines += [f"  {title}:", indented(str(value).strip(), 4)]
        else:
            lines.append(f"  {title}: {_in_words(value)}")
    return "\n".join(lines + tables)


def _in_words(value: Any) -> str:
    """A list, numbers by name, or anything else as text on one line."""
    if isinstance(value, list):
        return ", ".join(numbered(list(map(str, value))))
    if isinstance(value, dict):
        return ", ".join(f"{k} = {v}" for k, v in value.items())
    return str(value)


def indented(text: str, by: int = 2) -> str:
    return "\n".join(" " * by + line for line in text.split("\n"))
