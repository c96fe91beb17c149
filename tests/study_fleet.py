"""A study without fits: `solve` answers tasks by arithmetic and misbehaves to order, `run`
coordinates such solvers.

python study_fleet.py run STUDY --workers 2 -- --sleep 0.01 --poison 7
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import time
from pathlib import Path


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


def number(key: str) -> float:
    """What a task comes to: a number that depends on the task alone."""
    return int(hashlib.sha256(key.encode()).hexdigest()[:12], 16) / 2**48


def answer(task: dict) -> dict:
    x = number(task["key"])
    return {
        "done": task["key"],
        "status": "converged",
        "reason": "tolerance",
        "loss": 1 + x,
        "evaluations": int(1000 * x),
        "wall_time_s": 0.001,
        "compile_time_s": 0.0,
        "parameters": {"inertia": x, "viscous": -x},
        "history": [[1, 2.0], [2, 1 + x]],
        "result": {"kind": "fit", "loss": 1 + x},
    }


def solve(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--sleep", type=float, default=0.0)
    for name in ("poison", "hang", "fail", "raise"):
        parser.add_argument(f"--{name}", type=int, default=-1, help="seed of the task that does so")
    parser.add_argument(
        "--together", action="store_true", help="begin whole batches, as fits of many seeds do"
    )
    parser.add_argument("--broken", action="store_true", help="do not even start")
    o = parser.parse_args(arguments)
    if o.broken:
        print("no module named jax", file=sys.stderr)
        sys.exit(3)
    from jaxid.study.solver import serve

    def work(tasks):
        if o.together:
            yield {"begin": [t["key"] for t in tasks]}
        for task in tasks:
            if not o.together:
                yield {"begin": [task["key"]]}
            time.sleep(o.sleep)
            if task["seed"] == o.poison:
                print("about to die of seed", o.poison, file=sys.stderr, flush=True)
                os.abort()
            if task["seed"] == o.hang:
                time.sleep(1e6)
            if task["seed"] == getattr(o, "raise"):
                raise RuntimeError("a solver's mistake")
            failed = {"status": "failed", "reason": "it diverges", "loss": None}
            yield answer(task) | (failed if task["seed"] == o.fail else {})

    serve(work)


def run(arguments: list[str]) -> int:
    from jaxid.study import run_study

    split = arguments.index("--") if "--" in arguments else len(arguments)
    parser = argparse.ArgumentParser()
    parser.add_argument("study")
    parser.add_argument("--workers", type=int, default=2)
    o = parser.parse_args(arguments[:split])
    command = (str(Path(__file__).resolve()), "solve", *arguments[split + 1 :])
    from jaxid.base.errors import UsageError

    began = time.process_time()
    try:
        result = run_study(o.study, workers=o.workers, solver=command, check=False)
    except UsageError as error:
        print(error, file=sys.stderr)
        return 2
    print(
        json.dumps(
            result.status.to_dict() | {"new": result.new, "cpu_s": time.process_time() - began}
        )
    )
    return 130 if result.interrupted else 1 if result.status.failed else 0


if __name__ == "__main__":
    sys.exit(run(sys.argv[2:]) if sys.argv[1] == "run" else solve(sys.argv[2:]))
