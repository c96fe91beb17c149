"""Freezes what the commands answer, and says what a change of the code has changed in it.

    python benchmarks/frozen.py make FOLDER [--only WORD]
    python benchmarks/frozen.py compare BEFORE AFTER [--tolerance 1e-9]

`make` runs check, fit, identify and diagnose on the example, on a small blind set and, where
`$JAXID_DATA` and the cases beside it are there, on recorded arms and robots, each in a process of
its own, and keeps the JSON that it prints. `compare` lists each number that differs by more than
the tolerance (relative) and each text or verdict that differs at all; it exits with 1 if any does.
A change that only moves code has a tolerance of 0.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any


ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("JAXID_DATA", ROOT.parent / "shared" / "data"))
CASES = DATA.parent / "cases"
EXAMPLE = ROOT / "examples" / "servo_pendulum"
BLIND_MODELS = ("joint", "pendulum")
BLIND_SEED = 57
# What differs from run to run of the same code.
VARYING = {"wall_time_s", "compile_time_s", "cpu_time_s", "versions", "dataset", "dataset_sha256"}


def frozen_commands(blind: Path) -> Iterator[tuple[str, list[str]]]:
    """(name, arguments) of each command whose data are here."""
    yield "example_check", ["check", str(EXAMPLE)]
    yield "example_fit", ["fit", str(EXAMPLE)]
    yield "example_fit_de", ["fit", str(EXAMPLE), "--fitter", "de", "--seed", "1"]
    yield "example_diagnose", ["diagnose", str(EXAMPLE)]
    for folder in sorted(blind.glob("*/*/case_0[0-3]")):
        question = json.loads((folder / "question.json").read_text())
        command = ["diagnose", str(folder), "--model", question["model"]]
        if question["without"]:
            command += ["--without", ",".join(question["without"])]
        yield f"blind_{question['model']}_{folder.name}", command
    for name in ("rig3_02_torque_reported_22_ms_late", "rig_05_swapped_sign_no_hint"):
        yield f"check_{name}", ["check", str(CASES / name)]
    yield "robot_kd", ["diagnose", str(CASES / "robot3_kd_too_high")]
    yield "robot_force_limit", ["check", str(CASES / "robot3_force_limit_lost")]
    yield "arm_check", ["check", str(DATA / "ur10e")]
    yield "arm_identify", ["identify", str(DATA / "ur10e")]
    yield "arm_diagnose", ["diagnose", str(DATA / "ur10e"), "--residual", "inverse_dynamics"]
    yield "emps_identify", ["identify", str(DATA / "emps"), "--method", "tls"]
    yield "emps_diagnose", ["diagnose", str(DATA / "emps"), "--residual", "inverse_dynamics"]


def make_blind_sets(folder: Path) -> None:
    sys.path.insert(0, str(ROOT))
    from benchmarks.blind_cases import write_set

    for model in BLIND_MODELS:
        write_set(model, BLIND_SEED, "effect", folder / model)


def freeze(folder: Path, only: str) -> None:
    blind = folder.parent / "frozen_blind_sets"
    if not blind.exists():
        make_blind_sets(blind)
    folder.mkdir(parents=True, exist_ok=True)
    for name, arguments in frozen_commands(blind):
        if only not in name:
            continue
        if not Path(arguments[1]).is_dir():
            print(f"{name}: {arguments[1]} is not here, left out")
            continue
        command = [sys.executable, "-m", "jaxid", *arguments, "--json"]
        if arguments[0] != "check":
            command += ["--out", str(folder / "out" / name)]
            shutil.rmtree(folder / "out" / name, ignore_errors=True)
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
        answer: dict[str, Any] = {"exit": done.returncode}
        try:
            answer["json"] = json.loads(done.stdout)
        except json.JSONDecodeError:
            answer["error"] = done.stderr
        (folder / f"{name}.json").write_text(json.dumps(answer, indent=1) + "\n")
        print(f"{name}: exit {done.returncode}", flush=True)


def differences(before: Any, after: Any, tolerance: float, place: str = "") -> Iterator[str]:
    """A line for each value of two answers that is not the same."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in {**before, **after}:
            if key in VARYING:
                continue
            yield from differences(
                before.get(key), after.get(key), tolerance, f"{place}.{key}".lstrip(".")
            )
        return
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for k, (one, other) in enumerate(zip(before, after, strict=True)):
            yield from differences(one, other, tolerance, f"{place}[{k}]")
        return
    if before == after:
        return
    if isinstance(before, float) and isinstance(after, (int, float)):
        size = max(abs(before), abs(after))
        if abs(before - after) <= tolerance * size:
            return
    yield f"{place}: {before!r} -> {after!r}"


def compare(before: Path, after: Path, tolerance: float) -> int:
    """Prints what differs; 0 if nothing does."""
    found = 0
    for path in sorted(before.glob("*.json")):
        other = after / path.name
        if not other.is_file():
            print(f"{path.stem}: not made again")
            continue
        lines = differences(json.loads(path.read_text()), json.loads(other.read_text()), tolerance)
        for line in lines:
            print(f"{path.stem}: {line}"[:300])
            found += 1
    print(f"{found} values differ")
    return int(found > 0)


def main_of_arguments() -> int:
    parser = argparse.ArgumentParser(description="Freezes what the commands answer, and compares.")
    commands = parser.add_subparsers(dest="command", required=True)
    making = commands.add_parser("make")
    making.add_argument("folder", type=Path)
    making.add_argument("--only", default="", help="those whose name holds this word")
    comparing = commands.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    comparing.add_argument("--tolerance", type=float, default=1e-9)
    chosen = parser.parse_args()
    if chosen.command == "make":
        freeze(chosen.folder.resolve(), chosen.only)
        return 0
    return compare(chosen.before, chosen.after, chosen.tolerance)


if __name__ == "__main__":
    sys.exit(main_of_arguments())
