"""Anybody's answers to blind cases: a JSON of probabilities, read and checked."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jaxid.base.errors import nearest, UsageError
from jaxid.base.numbers import is_finite


#: Keys of one answer.
KEYS = ("missing", "nothing", "other", "where", "size", "exam", "how_far", "seconds")
#: How many complaints of a file are printed.
MOST = 20


@dataclass(frozen=True)
class CaseAnswer:
    """What was said of a case. `missing`: probabilities by "effect@joint"; `nothing`: that nothing
    is missing; `other`: that something is which no word of the list names.
    """

    missing: Mapping[str, float] = field(default_factory=dict)
    nothing: float = 0.0
    other: float = 0.0
    where: Mapping[str, float] = field(default_factory=dict)
    size: Mapping[str, float] = field(default_factory=dict)
    exam: Mapping[str, Sequence[float]] = field(default_factory=dict)
    how_far: tuple[float, float] | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class BenchmarkEntry:
    """A name, and answers by case; a case without one is one of which nothing was said."""

    name: str
    answers: Mapping[str, CaseAnswer]


@dataclass(frozen=True)
class AnswerForm:
    """What the answers to a case may say: effects and conventions, joints, variables, and the
    readings of the exam by output.
    """

    effects: Sequence[str]
    variables: Sequence[str]
    joints: Sequence[str]
    outputs: Mapping[str, int]


def read_entry(path: Path, asked: Mapping[str, AnswerForm]) -> BenchmarkEntry:
    """The entry of a file. Raises `UsageError` that names each case and key which is wrong."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise UsageError(f"{path} is not JSON: {error}") from None
    wanted = '{"entry": "name", "answers": {"0001": {"missing": {...}, "nothing": 0.1}}}'
    if not isinstance(content, dict) or not isinstance(content.get("answers"), dict):
        raise UsageError(f"{path} holds no object `answers`; it should be {wanted}")
    complaints: list[str] = []
    answers: dict[str, CaseAnswer] = {}
    for case, answer in content["answers"].items():
        if case not in asked:
            complaints.append(f"case {case!r}: there is no such case{nearest(case, asked)}")
            continue
        found = list(_wrong(answer, asked[case]))
        complaints += [f"case {case!r}, {text}" for text in found]
        if not found:
            answers[case] = _answer(answer)
    if complaints:
        more = len(complaints) - MOST
        if more > 0:
            complaints = [*complaints[:MOST], f"and {more} more"]
        raise UsageError(f"{path} cannot be scored:\n  " + "\n  ".join(complaints))
    return BenchmarkEntry(str(content.get("entry", path.stem)), answers)


def _answer(content: Mapping[str, Any]) -> CaseAnswer:
    far = content.get("how_far")
    return CaseAnswer(
        missing=content.get("missing", {}),
        nothing=content.get("nothing", 0.0),
        other=content.get("other", 0.0),
        where=content.get("where", {}),
        size=content.get("size", {}),
        exam=content.get("exam", {}),
        how_far=(far[0], far[1]) if far is not None else None,
        seconds=content.get("seconds"),
    )


def _wrong(answer: Any, asked: AnswerForm) -> Iterator[str]:
    """What is wrong with the answer to one case, each with its key."""
    if not isinstance(answer, dict):
        yield "the whole: it is not an object"
        return
    for key in answer:
        if key not in KEYS:
            yield f"key {key!r}: there is no such key{nearest(str(key), KEYS)}"
    for key in ("nothing", "other"):
        if not _probability(answer.get(key, 0.0)):
            yield f"key {key!r}: {answer[key]!r} is not a probability"
    yield from _wrong_names(answer, asked)
    yield from _wrong_exam(answer.get("exam", {}), asked)
    far = answer.get("how_far")
    if far is not None and not _interval(far):
        yield f"key 'how_far': {far!r} is not [low, high]"
    seconds = answer.get("seconds")
    if seconds is not None and not (is_finite(seconds) and seconds >= 0):
        yield f"key 'seconds': {seconds!r} is not a time"


def _wrong_names(answer: Mapping[str, Any], asked: AnswerForm) -> Iterator[str]:
    for key, test, what in (
        ("missing", _probability, "probability"),
        ("size", is_finite, "number"),
        ("where", _probability, "probability"),
    ):
        part = answer.get(key, {})
        if not isinstance(part, dict):
            yield f"key {key!r}: it is not an object"
            continue
        for name, value in part.items():
            where = f"key {key!r}, {name!r}"
            if not test(value):
                yield f"{where}: {value!r} is not a {what}"
            if key == "where":
                if name not in asked.variables:
                    yield f"{where}: it is none of {', '.join(asked.variables)}"
                continue
            effect, _, joint = name.partition("@")
            if effect not in asked.effects:
                yield f"{where}: no effect is called so{nearest(effect, asked.effects)}"
            if joint not in asked.joints:
                yield f"{where}: the joint after @ is none of {', '.join(asked.joints)}"


def _wrong_exam(exam: Any, asked: AnswerForm) -> Iterator[str]:
    if not isinstance(exam, dict):
        yield "key 'exam': it is not an object"
        return
    for name, values in exam.items():
        count = asked.outputs.get(name)
        if count is None:
            yield f"key 'exam', {name!r}: the exam asks for {', '.join(asked.outputs) or 'nothing'}"
        elif not isinstance(values, list) or len(values) != count:
            yield f"key 'exam', {name!r}: it is not a list of {count} numbers"
        elif not all(map(is_finite, values)):
            yield f"key 'exam', {name!r}: a value is not a number"
    if exam and set(asked.outputs) - set(exam):
        yield f"key 'exam': it lacks {', '.join(sorted(set(asked.outputs) - set(exam)))}"


def _probability(value: Any) -> bool:
    return is_finite(value) and 0 <= value <= 1


def _interval(value: Any) -> bool:
    if not isinstance(value, list) or len(value) != 2:
        return False
    return is_finite(value[0]) and is_finite(value[1]) and value[0] <= value[1]
