"""Entries of the public benchmark (docs/benchmark.md) in one table; anybody's may stand among them.

    python benchmarks/public.py seal DIR --cases 40
    python benchmarks/entries.py DIR/1/cases --entry stepwise --out DIR/1/answers     # and 2, 3
    python benchmarks/public.py enter DIR/1 DIR/2 DIR/3 --entry stepwise --about "what it is" --version COMMIT

`seal` draws the seeds of a release and publishes the hashes of their keys in `sealed.json`, before
anything is answered. `enter` scores the answers to all of them together and keeps the score as
`leaderboard/NAME.json`. The table in RESULTS.md and the page of the documentation are made of that
folder.
"""

from __future__ import annotations

import argparse
import datetime
import itertools
import json
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any


HERE = Path(__file__).resolve().parent
LEADERBOARD = HERE / "leaderboard"
SEALED = HERE / "sealed.json"
sys.path[:0] = [str(HERE.parent), str(HERE)]

from jaxid.benchmark import score as scoring  # noqa: E402
from jaxid.benchmark.intervals import cell  # noqa: E402
from jaxid.benchmark.make import ALL, make  # noqa: E402


#: Sealed sets of a release, and the digits of a seed.
SEEDS, DIGITS = 3, 15
#: Characters of a key that are shown.
SHOWN = 8
#: Measure -> heading of its column.
COLUMNS = {
    "class": "class",
    "place": "place",
    "size": "size",
    "where": "where",
    "how_far": "how far",
    "how_far_held": "interval holds",
    "sure_and_wrong": "sure and wrong",
    "brier": "Brier",
    "calibration_error": "calibration error",
}


def seal(folder: Path, name: str = ALL, cases: int | None = None, kept: Path = SEALED) -> list[str]:
    """Makes the sets of a release, each of a seed that nobody chose, and publishes the hashes of
    their keys. The seeds stand in the keys alone.
    """
    made = []
    for number in range(1, SEEDS + 1):
        made.append(make(name, secrets.randbelow(10**DIGITS), folder / str(number), cases))
    sealed = json.loads(kept.read_text()) if kept.is_file() else []
    sealed.append(
        {
            "date": datetime.date.today().isoformat(),
            "sets": list(made[0].sets),
            "cases": [one.cases for one in made],
            "key_sha256": [one.key_sha256 for one in made],
        }
    )
    kept.write_text(json.dumps(sealed, indent=1) + "\n")
    return [one.key_sha256 for one in made]


def enter(
    folders: Sequence[Path],
    entry: str,
    about: str,
    version: str,
    kept: Path = LEADERBOARD,
    first: Sequence[int] = (),
) -> Path:
    """Scores the answers that lie in each folder's `answers/ENTRY.json`, all cases together, and
    keeps the score under the name of the entry and the first key. `first`: of so many cases of
    each folder, by their names, whose order is drawn by the seed; default: all.
    """
    from run_all import machine

    marks: dict[str, scoring.Marks] = {}
    answered, sets, keys = 0, [], []
    for folder, most in itertools.zip_longest(folders, first):
        found = scoring.score(folder, folder / "answers" / f"{entry}.json")
        made = json.loads((folder / "cases" / "benchmark.json").read_text())
        given = json.loads((folder / "answers" / f"{entry}.json").read_text())["answers"]
        sets += made["sets"]
        keys.append(made["key_sha256"])
        for case in sorted(found.cases)[:most]:
            own = found.cases[case]
            answered += case in given
            marks[f"{keys[-1]}/{case}"] = own
    overall, by_set = scoring.of_all(marks)
    content = {
        "entry": entry,
        "about": about,
        "version": version,
        "date": datetime.date.today().isoformat(),
        "machine": machine(),
        "sets": list(dict.fromkeys(sets)),
        "cases": len(marks),
        "answered": answered,
        "key_sha256": keys,
        "overall": overall,
        "class_by_set": {name: own["class"] for name, own in by_set.items()},
    }
    kept.mkdir(exist_ok=True)
    path = kept / f"{entry.replace(' ', '_')}_{keys[0][:SHOWN]}.json"
    path.write_text(json.dumps(content, indent=1) + "\n")
    return path


def rows(folder: Path = LEADERBOARD) -> list[dict[str, Any]]:
    """A row an entry, the best class first within the same cases."""
    kept = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    kept.sort(key=lambda one: (one["key_sha256"], -one["overall"]["class"]["value"]))
    out = []
    for one in kept:
        row = {"entry": one["entry"], "cases": f"{one['answered']} of {one['cases']}"}
        for measure, heading in COLUMNS.items():
            row[heading] = cell(one["overall"][measure])
        row["seconds, median"] = cell(one["overall"]["seconds_median"])
        row["version"], row["date"] = one["version"], one["date"]
        row["key"] = " ".join(key[:SHOWN] for key in one["key_sha256"])
        row["what it is"] = one["about"]
        out.append(row)
    return out


def by_set(folder: Path = LEADERBOARD) -> list[dict[str, Any]]:
    """A row a set of the same cases (`key`): how many, and the class of each entry."""
    kept = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    entries = sorted({one["entry"] for one in kept})
    found: dict[tuple[str, str], dict[str, str]] = {}
    for one in kept:
        key = one["key_sha256"][0][:SHOWN]
        for name, own in one["class_by_set"].items():
            row = found.setdefault((key, name), dict.fromkeys(entries, ""))
            row[one["entry"]] = f"{own['value']:.2f} of {own['count']}"
    return [{"key": key, "set": name, **row} for (key, name), row in sorted(found.items())]


def table(found: Sequence[dict[str, Any]]) -> list[str]:
    """Rows as lines of Markdown."""
    columns = list(found[0])
    head = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
    return head + ["| " + " | ".join(row[c] for c in columns) + " |" for row in found]


def page(folder: Path = LEADERBOARD) -> str:
    """The leaderboard as a page."""
    found = rows(folder)
    text = [
        "# Leaderboard",
        "",
        "Entries of the [public benchmark](../benchmark.md). Shares and means have 95 % intervals; `key` begins the hash of the",
        "set's key, and entries compare only where it is the same. `cases`: answered, of how many. To enter, send the score and",
        "what made it: it becomes a file of `benchmarks/leaderboard/`.",
        "",
    ]
    if found:
        text += [*table(found), "", "## The right class, by set", "", *table(by_set(folder))]
    return "\n".join([*text, ""])


def main() -> dict[str, Any]:
    """The table of what was entered so far."""
    if not (found := rows()):
        raise FileNotFoundError("nothing is entered; see benchmarks/public.py")
    text = (
        "Blind cases of `jaxid benchmark make`, answered by jaxid and by simple programs "
        "(benchmarks/entries.py), scored by the rules of docs/benchmark.md; 95 % intervals. Entries with "
        "the same key answered the same cases, the first by name of sets whose seeds were drawn for them. "
        "Key 1572c086: 16 of 30 cases, three of each of the ten sets. "
        "Key 4c5bd2de: 100 of 460 cases, which are whole sets: those without rigs. "
        "The samples are small: the intervals are wide, and entries whose intervals overlap are not told "
        "apart. jaxid had up to 600 s on the clock for a case (300 s for five of them), on two cores with "
        "some fifteen other processes, about 150 s of one core. "
        "The seconds in the table are of the processor and hold its compilation. Where it knew nothing by "
        "then, it said what it holds likely beforehand; so do the others of what they cannot do. "
        "mujoco.sysid alone simulates, none of them reads conventions. The neural residual predicts exams "
        "by torque, jaxid the others; elsewhere how far is 0. Of the first key one case lacks a floor that "
        "its recording never touches; the maker has been mended since. By set: the leaderboard's page. "
        "All 1,200 cases took one command 20.7 minutes on the clock of a busy machine with two cores, 26.3 "
        "of the processor; 1,200 answers of a stranger's script took 1.6 s of the processor to score, 3.6 s "
        "on the clock. 250 cases that other processes made again, arms, conventions and rigs of MuJoCo, "
        "were the same to the byte."
    )
    return {"title": "The public benchmark", "text": text, "rows": found}


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    sealing = commands.add_parser("seal", help="draw three seeds, publish the hashes of their keys")
    sealing.add_argument("folder", type=Path)
    sealing.add_argument("--set", dest="name", default=ALL)
    sealing.add_argument("--cases", type=int, help="of each set; default: all")
    entering = commands.add_parser("enter", help="score answers and keep them")
    entering.add_argument("folders", type=Path, nargs="+")
    entering.add_argument("--entry", required=True)
    entering.add_argument("--about", default="")
    entering.add_argument("--version", default="")
    entering.add_argument(
        "--first",
        type=int,
        nargs="+",
        default=(),
        help="so many cases of each folder; default: all",
    )
    return parser.parse_args()


if __name__ == "__main__":
    chosen = _arguments()
    if chosen.command == "seal":
        print("\n".join(seal(chosen.folder, chosen.name, chosen.cases)))
    else:
        path = enter(
            chosen.folders,
            chosen.entry,
            chosen.about,
            chosen.version,
            first=chosen.first,
        )
        print(path)
