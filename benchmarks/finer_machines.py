"""Machines that take no steps, and files whose simulator does.

An arm of `blind_robots.py` is recorded with steps of 0.1 ms by Runge and Kutta's rule; its file has
MuJoCo's own friction and longer steps, and armature, damping and dry friction that are 10 % off. A
diagnosis is asked for what was withheld. What the steps leave behind has no name of its own.

    python benchmarks/finer_machines.py [--seed N] [--cases 24] [--only saturation,none]

Cases that were done are kept in results/finer_machines.jsonl; a seed goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.blind_robots import answered, score  # noqa: E402
from benchmarks.blind_summary import share  # noqa: E402
from benchmarks.loose_robots import kept, revision  # noqa: E402
from jaxid.benchmark.goal_arms import (  # noqa: E402
    FINE,
    GoalArm,
    goals,
    KINDS,
    limited,
    MujocoSteps,
    recorded,
    withheld,
)


RESULTS = Path(__file__).with_name("results") / "finer_machines.jsonl"
RATE, SECONDS, OFF = 250, 20.0, 0.1
#: How a file steps: MuJoCo's own setting, a shorter and a longer step.
FILES = (
    MujocoSteps(step=2e-3, integrator="Euler", stiff=False),
    MujocoSteps(step=1e-3, integrator="implicitfast", stiff=False),
    MujocoSteps(step=4e-3, integrator="implicitfast", stiff=False),
)


def case(seed: int, number: int) -> dict[str, Any]:
    """A case with its key: file, goals, readings."""
    rng = np.random.default_rng([seed, number, 59])
    kind = KINDS[number % len(KINDS)]
    stated = GoalArm.drawn(rng)
    stated.solver = FILES[int(rng.integers(len(FILES)))]
    real, joint, beside = withheld(stated, kind, rng)
    real.solver = FINE
    for numbers in (real.armature, real.damping, real.frictionloss):
        numbers *= 1 + OFF * rng.uniform(-1, 1, stated.n)
    u = goals(stated.n, SECONDS, rng, RATE)
    beside = limited(real, joint, beside, u, rng, RATE)
    return {
        "kind": kind,
        "joint": f"j{joint + 1}",
        "beside": beside,
        "arm": stated,
        "rate": RATE,
        "u": u,
        "q": recorded(real, kind, joint, beside, u, rng, RATE),
    }


def asked(seed: int, cases: int, only: list[str]) -> None:
    """Makes and diagnoses what is not done yet; of some kinds `only`."""
    done = {(row["seed"], row["number"]) for row in kept(RESULTS)}
    for number in range(cases):
        if (seed, number) in done or KINDS[number % len(KINDS)] not in only:
            continue
        c = case(seed, number)
        processor = time.process_time()
        try:
            found, _ = answered(c)
            row = score(c, found)
        except Exception as error:  # a case that cannot be diagnosed is one that is not right
            row = {"kind": c["kind"], "verdict": f"failed: {error}"[:200], "named": []}
            row |= {"right": False, "wrong": False, "gaps": []}
        solver = c["arm"].solver
        row |= {
            "seed": seed,
            "number": number,
            "file": f"{1e3 * solver.step:g} ms {solver.integrator}",
            "joints": c["arm"].n,
            "seconds": round(time.process_time() - processor, 1),
            "revision": revision(),
        }
        with RESULTS.open("a") as file:
            file.write(json.dumps(row) + "\n")
        right = "right" if row["right"] else "WRONG" if row["wrong"] else "-"
        print(number, row["kind"], row["file"], row["verdict"], row["named"], right, flush=True)


def main() -> dict[str, Any]:
    """What was kept, by what was withheld and by the file's steps."""
    rows = kept(RESULTS)
    if not rows:
        raise FileNotFoundError("nothing was diagnosed: run benchmarks/finer_machines.py first")
    groups = {kind: [r for r in rows if r["kind"] == kind] for kind in KINDS}
    for file in sorted({r["file"] for r in rows}):
        groups[f"all, file of {file}"] = [r for r in rows if r["file"] == file]
    groups["all"] = rows
    out = []
    for group, own in groups.items():
        if not own:
            continue
        seconds = [r["seconds"] for r in own]
        out.append(
            {
                "withheld": group,
                "cases": len(own),
                "right": share([r["right"] for r in own]),
                "wrong name": sum(r["wrong"] for r in own),
                "processor seconds, median (longest)": (
                    f"{np.median(seconds):.0f} ({max(seconds):.0f})"
                ),
            }
        )
    seeds = ", ".join(map(str, sorted({r["seed"] for r in rows})))
    revisions = ", ".join(sorted({r["revision"] for r in rows}))
    text = (
        "Arms of two and three joints under position actuators, recorded by MuJoCo in steps of "
        "0.1 ms by Runge and Kutta's rule, 20 s at 250 Hz, noise 1e-4 rad. The file takes steps of "
        "1 to 4 ms, and its armature, damping and dry friction are up to 10 % off. Right as for "
        "blind robots; a number that is told only as a ratio or a product with another counts as "
        f"not told. Seeds {seeds}, each case once; commits {revisions}."
    )
    return {"title": "Machines finer than their file", "text": text, "rows": out}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--only", type=lambda text: text.split(","), default=list(KINDS))
    given = parser.parse_args()
    asked(given.seed, given.cases, given.only)
