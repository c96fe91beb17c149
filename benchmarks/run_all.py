"""Runs the benchmarks and writes RESULTS.md: every module of this folder with a function `main() ->
dict`.

    python benchmarks/run_all.py [NAME ...] [--write-only]

`main` returns {"title": ..., "text": ..., "rows": [{column: value, ...}, ...]}; each result is kept
as results/NAME.json, and RESULTS.md is written from all of them. A benchmark whose data are absent
raises `FileNotFoundError` and keeps its old figures.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import json
import os
import platform
import sys
import time
from pathlib import Path


HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parent / "tests"), str(HERE)]


def machine() -> str:
    """Processor and number of cores."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = [
            x.split(":", 1)[1].strip()
            for x in info.read_text().splitlines()
            if x.startswith("model name")
        ]
        name = lines[0] if lines else name
    return f"{name}, {os.cpu_count()} cores, Python {platform.python_version()}"


def modules() -> list[str]:
    return sorted(
        p.stem for p in HERE.glob("*.py") if p.stem != "run_all" and "\ndef main(" in p.read_text()
    )


def run(name: str) -> None:
    """Runs one benchmark and keeps its result."""
    began = time.perf_counter()
    result = importlib.import_module(name).main()
    if not isinstance(result, dict):
        print(f"{name}: main() returns no result, left out")
        return
    result |= {
        "date": datetime.date.today().isoformat(),
        "machine": machine(),
        "wall_time_s": round(time.perf_counter() - began, 1),
    }
    (HERE / "results").mkdir(exist_ok=True)
    (HERE / "results" / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n")


def cell(value: object) -> str:
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text.replace("|", "\\|").replace("\n", " ")


def write() -> None:
    """RESULTS.md from every kept result."""
    parts = [
        "# Measured results\n\nWritten by `make benchmark` (benchmarks/run_all.py); do not edit.\n"
    ]
    for path in sorted((HERE / "results").glob("*.json")):
        r = json.loads(path.read_text())
        parts.append(f"## {r['title']}\n\n{r.get('text', '')}\n")
        rows = r.get("rows", [])
        if rows:
            columns = list(dict.fromkeys(c for row in rows for c in row))
            lines = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
            lines += [
                "| " + " | ".join(cell(row.get(c, "")) for c in columns) + " |" for row in rows
            ]
            parts.append("\n".join(lines) + "\n")
        spent = f"{r['wall_time_s']} s, " if "wall_time_s" in r else ""
        parts.append(
            f"`benchmarks/{path.stem}.py`, {r.get('date', '')}, {spent}{r.get('machine', '')}\n"
        )
    (HERE / "RESULTS.md").write_text("\n".join(parts))


def main_() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[[], *modules()])
    parser.add_argument("--write-only", action="store_true")
    arguments = parser.parse_args()
    if not arguments.write_only:
        from jaxid.runtime import prepare

        prepare()
        for name in arguments.names or modules():
            print(name, flush=True)
            sys.argv = [name]
            try:
                run(name)
            except FileNotFoundError as problem:
                print(f"{name}: {problem}")
    write()


if __name__ == "__main__":
    main_()
