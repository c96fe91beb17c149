"""Entries of the public benchmark (docs/benchmark.md) in one table; anybody's may stand among them.

    python benchmarks/public.py DIR SCORE.json --about "what it is" --version COMMIT

keeps a score of `jaxid benchmark score DIR ANSWERS` as `leaderboard/NAME.json`. The table in
RESULTS.md and the page of the documentation are made of that folder.
"""

from __future__ import annotations

import argparse
import datetime
import json
import sys
from pathlib import Path
from typing import Any


HERE = Path(__file__).resolve().parent
LEADERBOARD = HERE / "leaderboard"
sys.path[:0] = [str(HERE.parent), str(HERE)]

from jaxid.benchmark.intervals import cell  # noqa: E402


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


def enter(folder: Path, score: Path, about: str, version: str) -> Path:
    """Keeps a score under the name of its entry."""
    from run_all import machine

    found = json.loads(score.read_text())
    made = json.loads((folder / "cases" / "benchmark.json").read_text())
    kept = {
        "entry": found["entry"],
        "about": about,
        "version": version,
        "date": datetime.date.today().isoformat(),
        "machine": machine(),
        "sets": made["sets"],
        "cases": len(made["cases"]),
        "answered": found["answered"],
        "key_sha256": made["key_sha256"],
        "overall": found["overall"],
        "class_by_set": {name: own["class"] for name, own in found["sets"].items()},
    }
    LEADERBOARD.mkdir(exist_ok=True)
    path = LEADERBOARD / f"{found['entry'].replace(' ', '_')}.json"
    path.write_text(json.dumps(kept, indent=1) + "\n")
    return path


def rows(folder: Path = LEADERBOARD) -> list[dict[str, Any]]:
    """A row an entry, the best class first within one set of cases."""
    kept = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    kept.sort(key=lambda one: (one["key_sha256"], -one["overall"]["class"]["value"]))
    out = []
    for one in kept:
        row = {"entry": one["entry"], "cases": f"{one['answered']} of {one['cases']}"}
        for measure, heading in COLUMNS.items():
            row[heading] = cell(one["overall"][measure])
        seconds = one["overall"]["seconds_median"]
        row["seconds, median"] = cell(seconds)
        row["version"], row["date"] = one["version"], one["date"]
        row["key"], row["what it is"] = one["key_sha256"][:8], one["about"]
        out.append(row)
    return out


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
        columns = list(found[0])
        text += ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
        text += ["| " + " | ".join(row[c] for c in columns) + " |" for row in found]
    return "\n".join([*text, ""])


def main() -> dict[str, Any]:
    """The table of what was entered so far."""
    if not (found := rows()):
        raise FileNotFoundError("nothing is entered; see benchmarks/public.py")
    text = (
        "Blind cases of `jaxid benchmark make`, answered by simple programs (benchmarks/entries.py; jaxid itself is not entered yet), "
        "scored by the rules of docs/benchmark.md; 95 % intervals. Entries with the same key answered the same cases. "
        "The sample is small: four cases each of arms by torque, robots under goals with exact and loose files, with a "
        "floor, broken conventions, and rigs by MuJoCo (seed 927411863, `--cases 4`), so the intervals are wide, and "
        "differences between entries that overlap say nothing. An entry that cannot do a case leaves it to what it "
        "holds likely beforehand: no entry but mujoco.sysid simulates, none reads conventions. Only the neural residual "
        "predicts the exam, by torque alone, so how far is 0 elsewhere. Cases that are not answered count as nothing said."
    )
    return {"title": "The public benchmark", "text": text, "rows": found}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("score", type=Path)
    parser.add_argument("--about", default="")
    parser.add_argument("--version", default="")
    chosen = parser.parse_args()
    print(enter(chosen.folder, chosen.score, chosen.about, chosen.version))
