"""How far the numbers that the diagnosis decides by may move before an answer changes.

Each number is halved and doubled (a cosine goes half and twice as far from 1, a ratio from 1), and
blind cases are diagnosed again in one process. An answer is the verdict with the effects named. The
answers of the numbers as they are come first.

    python benchmarks/thresholds.py [--seed N] [--cases N] [--models joint,pendulum] [--only alike,far]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

from benchmarks.blind_cases import write_set  # noqa: E402
from jaxid.api import diagnose  # noqa: E402
from jaxid.data.dataset import Dataset  # noqa: E402
from jaxid.data.io import load_dataset  # noqa: E402
from jaxid.diagnosis.thresholds import LIMITS  # noqa: E402


SETS = ("effect", "weak", "control", "outsider", "pair")
RESULTS = Path(__file__).with_name("results") / "thresholds.json"
#: Units of numbers that are measured from 1.
FROM_ONE = ("cosine", "ratio of mean squares", "mean square, noise 1", "ratio of errors")

Question = tuple[str, Dataset, tuple[str, ...]]


def questions(models: list[str], seed: int, each: int, folder: Path) -> dict[str, Question]:
    """The first cases of every kind and model by a name."""
    found: dict[str, Question] = {}
    for model in models:
        for kind in SETS:
            place = write_set(model, seed, kind, folder)
            for own in sorted(place.glob("case_*"))[:each]:
                without = json.loads((own / "question.json").read_text())["without"]
                found[f"{model} {kind} {own.name}"] = model, load_dataset(own), tuple(without)
    return found


def answer(question: Question) -> list[str]:
    """Verdict and effects of a case."""
    model, data, without = question
    which = diagnose(model, data, without=without, seed=0).which
    return [which.verdict, *sorted(f"{e.effect} at {e.location}" for e in which.effects)]


def moved(value: float, unit: str) -> dict[str, float]:
    """The number halved and doubled, by what was done."""
    if unit in FROM_ONE and 0.5 < value < 2:
        return {"half": 1 + (value - 1) / 2, "twice": 1 + (value - 1) * 2}
    if unit == "probability":
        return {"half": value**0.5, "twice": value**2}
    return {"half": value / 2, "twice": value * 2}


@contextmanager
def with_limit(name: str, value: float) -> Iterator[None]:
    """The diagnosis with another number, for this process alone."""
    before = getattr(LIMITS, name)
    object.__setattr__(LIMITS, name, value)
    try:
        yield
    finally:
        object.__setattr__(LIMITS, name, before)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--cases", type=int, default=1, help="of every kind and model")
    parser.add_argument("--models", default="joint,pendulum")
    parser.add_argument("--only", default="", help="names of numbers, else those without a case")
    options = parser.parse_args()
    rows = {name: (value, unit, case) for name, value, unit, _, case in LIMITS.table()}
    chosen = [n for n in options.only.split(",") if n]
    names = chosen or [n for n, (*_, case) in rows.items() if case == "not recorded"]
    with tempfile.TemporaryDirectory() as folder:
        models = options.models.split(",")
        asked = questions(models, options.seed, options.cases, Path(folder))
        plain = {case: answer(question) for case, question in asked.items()}
        for case, found in plain.items():
            print(f"{case}: {', '.join(found)}", flush=True)
        told = {}
        for name in names:
            value, unit, _ = rows[name]
            for how, other in moved(value, unit).items():
                with with_limit(name, other):
                    now = {case: answer(question) for case, question in asked.items()}
                changed = {c: [plain[c], now[c]] for c in plain if now[c] != plain[c]}
                told[f"{name} {how}"] = {"from": value, "to": other, "changed": changed}
                print(f"{name} {value:g} -> {other:g}: {len(changed)} of {len(asked)}", flush=True)
                for case, (before, after) in changed.items():
                    print(f"    {case}: {before} -> {after}", flush=True)
    content = {"seed": options.seed, "cases": plain, "moved": told}
    RESULTS.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
