"""`jaxid benchmark score`: what answers to blind cases are worth, with 95 % intervals.

The key is read here and nowhere else.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.serialise import SCHEMA
from jaxid.benchmark.answers import AnswerForm, BenchmarkEntry, CaseAnswer, read_entry
from jaxid.benchmark.intervals import cell, mean_interval, wilson


NOTHING, OTHER = "nothing", "other"
#: A probability from which a name is a claim; share by which a size may be off; edges of the bins
#: in which probabilities are compared with what is true.
SURE, CLOSE = 0.95, 0.25
EDGES = np.linspace(0.0, 1.0, 11)
#: A how-far counts where the model as stated leaves more than this times the noise (mean square).
SHOWS = 2.0


@dataclass(frozen=True)
class Marks:
    """Of one case; None where it is not asked. `said`: probability of every word and whether it is
    true; `claims`: of every sure one whether it is right.
    """

    set: str
    right: bool
    placed: bool | None
    sized: tuple[bool, ...]
    where: bool | None
    brier: float
    said: tuple[tuple[float, bool], ...]
    claims: tuple[bool, ...]
    how_far: float | None
    held: bool | None
    seconds: float | None


@dataclass(frozen=True)
class ScoreCard:
    """All cases, and those of each set: measure -> value, 95 % interval, number of cases."""

    entry: str
    answered: int
    overall: dict[str, Any]
    sets: dict[str, dict[str, Any]]
    cases: dict[str, Marks]

    def to_dict(self) -> dict[str, Any]:
        about = {"schema": SCHEMA, "kind": "score", "entry": self.entry, "answered": self.answered}
        cases = {}
        for name, marks in self.cases.items():
            cases[name] = asdict(marks)
            del cases[name]["said"]
        return {**about, "overall": self.overall, "sets": self.sets, "cases": cases}


def score(folder: Path, answers: Path) -> ScoreCard:
    """Scores a file of answers to the cases of a folder that `make` wrote.

    Raises `UsageError` where the folder or the answers cannot be used, or the key is not the one
    whose hash was published.
    """
    about, key = _read(folder)
    entry = read_entry(answers, asked_of(about, key))
    marks = {}
    for name, truth in key.items():
        answer = entry.answers.get(name, CaseAnswer())
        marks[name] = marks_of(truth, answer, _words(about))
    return card(entry, marks)


def card(entry: BenchmarkEntry, marks: Mapping[str, Marks]) -> ScoreCard:
    """The measures of all cases, and of each set."""
    overall, sets = of_all(marks)
    return ScoreCard(entry.name, len(entry.answers), overall, sets, dict(marks))


def of_all(marks: Mapping[str, Marks]) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """The measures of all cases together, and of each set."""
    sets: dict[str, dict[str, Any]] = {}
    for name in sorted({one.set for one in marks.values()}):
        sets[name] = measures([one for one in marks.values() if one.set == name])
    return measures(list(marks.values())), sets


def _read(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """benchmark.json, and the cases of the key."""
    try:
        about = json.loads((folder / "cases" / "benchmark.json").read_text(encoding="utf-8"))
        text = (folder / "key.json").read_bytes()
    except OSError as error:
        wanted = "a folder with cases/benchmark.json and key.json, as `jaxid benchmark make` writes"
        raise UsageError(f"{error.filename} cannot be read; {folder} should be {wanted}") from None
    if hashlib.sha256(text).hexdigest() != about["key_sha256"]:
        raise UsageError(f"{folder / 'key.json'} is not the key whose hash stands in the cases")
    return about, json.loads(text)["cases"]


def _words(about: Mapping[str, Any]) -> list[str]:
    return [*about["effects"], *about["conventions"]]


def asked_of(about: Mapping[str, Any], key: Mapping[str, Any]) -> dict[str, AnswerForm]:
    """What answers may say of each case."""
    out = {}
    for name, truth in key.items():
        outputs: dict[str, int] = {}
        if truth["exam"] is not None:
            outputs = {n: len(x) for n, x in truth["exam"]["truth"].items()}
        out[name] = AnswerForm(_words(about), about["variables"], truth["joints"], outputs)
    return out


def marks_of(truth: Mapping[str, Any], answer: CaseAnswer, words: Sequence[str]) -> Marks:
    """What the answer to one case is worth."""
    missing = truth["missing"]
    names = _as_true(answer.missing, missing)
    true = {one["effect"] for one in missing}
    if truth["outside"]:
        true = {OTHER}
    elif not missing:
        true = {NOTHING}
    by_word = {NOTHING: answer.nothing, OTHER: answer.other}
    by_word |= _summed(names, lambda name: name.partition("@")[0])
    said = tuple((p, word in true) for word, p in by_word.items())
    silent = [word for word in true if word not in by_word]
    right_names = {f"{one['effect']}@{one['joint']}" for one in missing}
    claims = tuple(name in right_names for name, p in names.items() if p >= SURE)
    placed = None
    if missing and len(truth["joints"]) > 1:
        joints = {one["joint"] for one in missing}
        placed = (
            _leading(_summed(names, lambda name: name.partition("@")[2]), len(joints)) == joints
        )
    where = None
    if truth["over"]:
        where = bool(_leading(answer.where, 1) & set(truth["over"]))
    far = how_far(truth["exam"], answer)
    held = None
    if far is not None and answer.how_far is not None:
        held = answer.how_far[0] <= far <= answer.how_far[1]
    return Marks(
        set=truth["set"],
        right=_leading(by_word, len(true)) == true,
        placed=placed,
        sized=_sized(missing, answer),
        where=where,
        brier=float(sum((p - y) ** 2 for p, y in said) + len(silent)),
        said=said,
        claims=claims,
        how_far=far,
        held=held,
        seconds=answer.seconds,
    )


def _as_true(said: Mapping[str, float], missing: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Probabilities by effect@joint; what no recording tells from a true one counts as that one."""
    own = {}
    for one in missing:
        own |= dict.fromkeys(one["alike"], f"{one['effect']}@{one['joint']}")
    return _summed(said, lambda name: own.get(name, name))


def _summed(said: Mapping[str, float], word: Callable[[str], str]) -> dict[str, float]:
    """Probabilities by what `word` makes of the names, at most 1."""
    out: dict[str, float] = {}
    for name, p in said.items():
        out[word(name)] = min(1.0, out.get(word(name), 0.0) + p)
    return out


def _leading(said: Mapping[str, float], count: int) -> set[str]:
    """The words with the highest probabilities; none where they do not stand out."""
    order = sorted(said, key=lambda word: -said[word])
    if len(order) < count or said[order[count - 1]] <= 0:
        return set()
    if len(order) > count and said[order[count]] == said[order[count - 1]]:
        return set()
    return set(order[:count])


def _sized(missing: Iterable[Mapping[str, Any]], answer: CaseAnswer) -> tuple[bool, ...]:
    """Of each size that is asked, whether it is about right."""
    out = []
    for one in missing:
        if one["size"] is None:
            continue
        told = answer.size.get(f"{one['effect']}@{one['joint']}")
        out.append(told is not None and abs(told - one["size"]) <= CLOSE * abs(one["size"]))
    return tuple(out)


def how_far(exam: Mapping[str, Any] | None, answer: CaseAnswer) -> float | None:
    """Share of the gap of the model as stated that the answer's readings close, from -1 (worse) to
    1 (down to the noise); 0 without readings. None where there is no gap to close.
    """
    if exam is None:
        return None
    before, after = [], []
    for name, truth in exam["truth"].items():
        true, noise = np.array(truth), exam["noise"][name]
        before.append(np.mean((np.array(exam["stated"][name]) - true) ** 2) / noise**2)
        told = answer.exam.get(name, exam["stated"][name])
        after.append(np.mean((np.array(told) - true) ** 2) / noise**2)
    gap = float(np.mean(before))
    if gap <= SHOWS:
        return None
    left = max(float(np.mean(after)) - 1.0, 0.0)
    return float(np.clip(1 - left / (gap - 1.0), -1.0, 1.0))


def measures(marks: Sequence[Marks]) -> dict[str, Any]:
    """Measure -> value, its interval, and of how many."""
    claims = list(itertools.chain(*(one.claims for one in marks)))
    sized = list(itertools.chain(*(one.sized for one in marks)))
    said = list(itertools.chain(*(one.said for one in marks)))
    shares = [one.how_far for one in marks if one.how_far is not None]
    seconds = [one.seconds for one in marks if one.seconds is not None]
    return {
        "class": wilson([one.right for one in marks]),
        "place": wilson([one.placed for one in marks if one.placed is not None]),
        "size": wilson(sized),
        "where": wilson([one.where for one in marks if one.where is not None]),
        "how_far": mean_interval(shares, least=-1.0, most=1.0),
        "how_far_held": wilson([one.held for one in marks if one.held is not None]),
        "sure": len(claims),
        "sure_and_wrong": wilson([not x for x in claims]),
        "brier": mean_interval([one.brier for one in marks], least=0.0),
        "calibration_error": calibration_error(said),
        "seconds_median": float(np.median(seconds)) if seconds else None,
    }


def calibration_error(said: Sequence[tuple[float, bool]]) -> float | None:
    """Expected calibration error: of ten bins how far what was said is from what was true, by the
    number of words in each. Words of which nothing was said do not count.
    """
    told = np.array([(p, y) for p, y in said if p > 0], float).reshape(-1, 2)
    if not len(told):
        return None
    bins = np.clip(np.digitize(told[:, 0], EDGES) - 1, 0, len(EDGES) - 2)
    error = 0.0
    for k in np.unique(bins):
        own = told[bins == k]
        error += abs(float(own[:, 0].sum() - own[:, 1].sum()))
    return error / len(told)


def card_text(found: ScoreCard) -> str:
    """The score as a table, one row a measure."""
    from jaxid.base.wording import table

    rows = []
    for name, value in found.overall.items():
        count = str(value["count"]) if isinstance(value, dict) else ""
        rows.append((name.replace("_", " "), cell(value, blank="-"), count))
    head = f"{found.entry}: {found.answered} of {len(found.cases)} cases answered"
    sets = []
    for name, own in found.sets.items():
        sets.append((name, cell(own["class"]), str(own["class"]["count"])))
    measures_table = table(("measure", "all", "of"), rows)
    sets_table = table(("set", "class", "of"), sets)
    return f"{head}\n\n{measures_table}\n\n{sets_table}"
