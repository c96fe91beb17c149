"""`jaxid benchmark make`: a set of blind cases in a folder, and its key apart.

    DIR/cases/benchmark.json        what the set is: cases, words, the key's SHA-256
    DIR/cases/0001/case.json        the question
    DIR/cases/0001/dataset.toml     with run_1.csv ..., and model.xml or another file of the model
    DIR/cases/0001/exam.csv         inputs of one further run
    DIR/key.json                    the truth; `cases` is published, this file is not

The same set, seed and number of cases give the same bytes, on one kind of processor with the same
versions of NumPy, SciPy, MuJoCo and jaxid.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import multiprocessing
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.computer import cores
from jaxid.base.errors import DatasetWarning, nearest, UsageError
from jaxid.base.serialise import SCHEMA
from jaxid.benchmark import arm_sets, bench_sets, paper_sets, rig_sets
from jaxid.benchmark.case import (
    BlindCase,
    CONVENTIONS,
    DEPENDS_ON,
    Draft,
    generator,
    SIZES,
    VARIABLES,
)
from jaxid.data.write import write_files


@dataclass(frozen=True)
class BlindSet:
    """Makes drafts of cases by (name of the set, seed, their numbers); `cases`: how many there are
    in the whole benchmark.
    """

    drafts: Callable[[str, int, Sequence[int]], list[Draft]]
    cases: int


SETS: dict[str, BlindSet] = {
    "rigs": BlindSet(rig_sets.drafts, 240),
    "poor": BlindSet(rig_sets.drafts, 100),
    "pairs": BlindSet(rig_sets.drafts, 100),
    "outsiders": BlindSet(rig_sets.drafts, 300),
    "arms": BlindSet(arm_sets.torque_drafts, 120),
    "robots": BlindSet(arm_sets.goal_drafts, 80),
    "loose": BlindSet(arm_sets.goal_drafts, 80),
    "contact": BlindSet(arm_sets.goal_drafts, 40),
    "carts": BlindSet(bench_sets.cart_drafts, 40),
    "conventions": BlindSet(bench_sets.convention_drafts, 100),
}
#: Sets beside the benchmark's own, which `all` does not hold.
BESIDE: dict[str, BlindSet] = {"papers": BlindSet(paper_sets.drafts, 40)}
KNOWN = SETS | BESIDE
#: The name that stands for all sets of the benchmark.
ALL = "all"
#: Groups after which a process gives its memory back by ending; each may take a gigabyte.
GROUPS_PER_PROCESS = 2
#: Most lanes of one group: cases that are integrated side by side in one process.
AT_ONCE = 60


@dataclass(frozen=True)
class Made:
    """Where the cases lie, how many there are, and the hash of their key."""

    folder: Path
    sets: tuple[str, ...]
    cases: int
    key_sha256: str

    def to_dict(self) -> dict[str, Any]:
        return {
            "schema": SCHEMA,
            "kind": "benchmark",
            "folder": str(self.folder),
            "sets": list(self.sets),
            "cases": self.cases,
            "key_sha256": self.key_sha256,
        }


def make(
    name: str, seed: int, folder: Path, cases: int | None = None, workers: int | None = None
) -> Made:
    """Makes a set, several with commas or all of them, each with its own number of cases or with
    `cases` of them, drawn by the seed.

    Raises `UsageError` where there is no such set or the folder holds something.
    """
    names = tuple(SETS) if name == ALL else tuple(name.split(","))
    for one in names:
        if one not in KNOWN:
            known = ", ".join((*KNOWN, ALL))
            raise UsageError(f"no set is called {one!r}{nearest(one, KNOWN)}; there are: {known}")
    if folder.exists() and any(folder.iterdir()):
        raise UsageError(f"{folder} holds files already; choose another folder")
    drafts: list[Draft] = []
    for one in names:
        drafts += KNOWN[one].drafts(one, seed, numbers_of(one, seed, cases))
    order = np.random.default_rng([seed, len(drafts)]).permutation(len(drafts))
    places = {(drafts[k].set, drafts[k].number): f"{n + 1:04d}" for n, k in enumerate(order)}
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        key = _written(drafts, places, temporary / "cases", workers)
        about = {"set": name, "seed": seed, "cases": dict(sorted(key.items()))}
        text = json.dumps(about, indent=1) + "\n"
        digest = hashlib.sha256(text.encode()).hexdigest()
        (temporary / "key.json").write_text(text, encoding="utf-8")
        _describe(temporary / "cases", names, key, digest)
        temporary.chmod(0o755)
        if folder.exists():
            folder.rmdir()
        temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return Made(folder, names, len(drafts), digest)


def numbers_of(name: str, seed: int, cases: int | None) -> list[int]:
    """The cases of a set that are made: all of it, or so many of it, drawn by the seed. A part is
    thus a sample of the set: of its machines and simulators, too.
    """
    whole = KNOWN[name].cases
    if cases is None or cases >= whole:
        return list(range(cases or whole))
    drawn = generator(seed, f"part of {name}").choice(whole, cases, replace=False)
    return sorted(map(int, drawn))


def _written(
    drafts: Sequence[Draft], places: dict[tuple[str, int], str], folder: Path, workers: int | None
) -> dict[str, Any]:
    """Simulates and writes the cases, group by group; returns the key of each."""
    jobs = list(_groups(drafts))
    named = []
    for group in jobs:
        named.append([places[draft.set, draft.number] for draft in group])
    count = min(workers or cores(), len(jobs))
    key: dict[str, Any] = {}
    if count == 1:
        for group, names in zip(jobs, named, strict=True):
            key |= _write_group(group, names, folder)
        return key
    chunks = math.ceil(len(jobs) / GROUPS_PER_PROCESS)
    threads = ThreadPoolExecutor(count)
    try:
        each = [
            threads.submit(_in_a_process, jobs[k::chunks], named[k::chunks], folder)
            for k in range(chunks)
        ]
        for one in each:
            key |= one.result()
    finally:
        threads.shutdown(cancel_futures=True)
    return key


def _in_a_process(
    groups: Sequence[list[Draft]], named: Sequence[list[str]], folder: Path
) -> dict[str, Any]:
    """Writes some groups in a process that then ends; a pool whose processes end by themselves may
    wait for ever for new ones (Python 3.11).
    """
    key: dict[str, Any] = {}
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        for found in pool.map(_write_group, groups, named, itertools.repeat(folder)):
            key |= found
    return key


def _groups(drafts: Sequence[Draft]) -> Iterator[list[Draft]]:
    """Drafts that are simulated side by side; those that take longest first."""
    groups: dict[str, list[Draft]] = {}
    for draft in drafts:
        groups.setdefault(draft.group, []).append(draft)
    slow = sorted(groups, key=lambda name: (not name.endswith(("arm", "tracker")), name))
    for name in slow:
        group = groups[name]
        for first in range(0, len(group), AT_ONCE):
            yield group[first : first + AT_ONCE]


def _write_group(group: list[Draft], names: list[str], folder: Path) -> dict[str, Any]:
    """Writes the cases of a group under their names; returns their truths. What is odd about the
    data, such as an input that stands still, is meant.
    """
    key = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DatasetWarning)
        cases = group[0].simulate(group)
    for draft, name, case in zip(group, names, cases, strict=True):
        _write_case(case, draft, name, folder / name)
        key[name] = _truth(case, draft)
    return key


def _write_case(case: BlindCase, draft: Draft, name: str, folder: Path) -> None:
    folder.mkdir(parents=True)
    write_files(case.dataset, folder, "csv")
    if case.model_toml:
        with (folder / "dataset.toml").open("a", encoding="utf-8") as stream:
            stream.write(f"\n[model]\n{case.model_toml}")
    for number, table in enumerate(case.tables, 1):
        _write_table(folder / f"run_{number}.csv", table)
    for file, text in case.files.items():
        (folder / file).write_text(text, encoding="utf-8")
    question = {"case": name, "set": draft.set, "simulator": case.simulator, **case.question}
    if case.exam is not None:
        _write_table(folder / "exam.csv", case.exam.given)
        question["exam"] = {
            "file": "exam.csv",
            "outputs": list(case.exam.truth),
            "rows": case.exam.rows.tolist(),
        }
    (folder / "case.json").write_text(json.dumps(question, indent=1) + "\n", encoding="utf-8")


def _write_table(path: Path, columns: dict[str, np.ndarray]) -> None:
    table = np.column_stack(list(columns.values()))
    header = ",".join(columns)
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.12g")


def _truth(case: BlindCase, draft: Draft) -> dict[str, Any]:
    exam = None
    if case.exam is not None:
        exam = {
            "truth": {n: x.tolist() for n, x in case.exam.truth.items()},
            "stated": {n: x.tolist() for n, x in case.exam.stated.items()},
            "noise": dict(case.exam.noise),
        }
    return {
        "set": draft.set,
        "number": draft.number,
        "simulator": case.simulator,
        "missing": [asdict(one) for one in case.missing],
        "outside": case.outside,
        "over": list(case.over),
        "joints": list(case.question["joints"]),
        "exam": exam,
    }


def _describe(folder: Path, names: Sequence[str], key: dict[str, Any], digest: str) -> None:
    """benchmark.json: the words that an answer may use, and the hash of the key."""
    effects = {}
    for effect in DEPENDS_ON:
        size = SIZES.get(effect)
        effects[effect] = {"size": " ".join(size) if size else None}
    about = {
        "schema": SCHEMA,
        "kind": "benchmark",
        "sets": list(names),
        "cases": sorted(key),
        "effects": effects,
        "conventions": list(CONVENTIONS),
        "variables": list(VARIABLES),
        "key_sha256": digest,
    }
    (folder / "benchmark.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
