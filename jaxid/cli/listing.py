"""What `jaxid models`, `jaxid effects` and `jaxid fitters` print."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from jaxid.base.errors import nearest, UsageError
from jaxid.base.serialise import finite, SCHEMA
from jaxid.base.wording import first_sentence, one_line, table


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
    own = kind == "models" and is_model_file(name)
    if name is not None and name not in known and not own:
        raise UsageError(f"there is no {kind[:-1]} {name!r}{nearest(name, known)}")
    return [describe(n) for n in known] if name is None else [describe(name)]


def plain(value: Any) -> Any:
    """Named tuples as dictionaries, whatever JSON has no word for as text."""
    if isinstance(value, tuple) and callable(as_dict := getattr(value, "_asdict", None)):
        return {name: plain(v) for name, v in as_dict().items()}  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return [plain(v) for v in value]
    return (
        finite(value)
        if value is None or isinstance(value, bool | int | float | str)
        else str(value)
    )


def to_dict(kind: str, name: str | None, found: Sequence[Any]) -> dict[str, Any]:
    """The JSON of a list, or of one description."""
    if name is None:
        return {"schema": SCHEMA, "kind": kind, kind: [plain(info) for info in found]}
    return {"schema": SCHEMA, "kind": kind[:-1], **plain(found[0])}


def summary(kind: str, found: Sequence[Any]) -> str:
    """One line for each."""
    if kind == "models":
        rows = [
            (m.name, "; ".join(map(signature, m.signatures)), ", ".join(numbered(m.parameters)))
            for m in found
        ]
        return table(("model", "inputs → outputs", "fitted parameters"), rows)
    if kind == "effects":
        rows = [(e.name, e.family, e.locations, one_line(e.equation)) for e in found]
        return table(("effect", "family", "location", "equation"), rows)
    return table(("fitter", "what it does"), [(f.name, first_sentence(f.text)) for f in found])


def numbered(names: Sequence[str]) -> list[str]:
    """The same with numbers one to n of a name in one: `m1 … m6`."""
    out: list[str] = []
    first = last = ""
    for name in [*names, ""]:
        stem, digits = name.rstrip("0123456789"), name[len(name.rstrip("0123456789")) :]
        old, count = last.rstrip("0123456789"), last[len(last.rstrip("0123456789")) :]
        if last and digits and stem == old and count and int(digits) == int(count) + 1:
            last = name
            continue
        if first:
            short = int(count or 0) - int(first[len(old) :] or 0) < 2
            out += (
                [n for n in dict.fromkeys((first, last)) if n] if short else [f"{first} … {last}"]
            )
        first = last = name
    return out


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
        elif isinstance(value, list):
            lines.append(f"  {title}: {', '.join(numbered([str(v) for v in value]))}")
        elif isinstance(value, dict):
            lines.append(f"  {title}: {', '.join(f'{k} = {v}' for k, v in value.items())}")
        elif "\n" in str(value):
            lines += [f"  {title}:", indented(str(value).strip(), 4)]
        else:
            lines.append(f"  {title}: {value}")
    return "\n".join(lines + tables)


def indented(text: str, by: int = 2) -> str:
    return "\n".join(" " * by + line for line in text.split("\n"))
