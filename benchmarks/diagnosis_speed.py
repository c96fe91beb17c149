"""How long one diagnosis takes, with every effect of the library at every joint.

Recordings of the separate twins of the blind cases, from rest, with noise and one withheld effect:
8 s (of a flexible link four runs of 4 s), and 20 runs of 60 s. Cold: a process of its own with an
empty cache of compiled programs, but for what the rows above have left there. Warm: another one
with that cache, importing JAX included. Again: the same diagnosis once more in that process.
Command: `jaxid diagnose` with its page. Steps: those of all candidates, simulated or along the
measured motion, which no machine changes. The answer is the first name: what a recording cannot
tell from it stands beside it on the page (of the tracker the lag).
"""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

SECONDS = 8.0
#: (what, model, samples per second, runs, length s, withheld: name -> numbers of the twin)
CASES: list[tuple[str, str, int, int, float, dict[str, dict[str, tuple[float, ...]]]]] = [
    ("one joint", "pendulum", 500, 1, SECONDS, {"load-dependent friction": {"load": (0.08,)}, "nothing": {}}),
    (
        "two joints", "planar_arm", 500, 1, SECONDS,
        {"actuator lag, joint 2": {"lag": (0.0, 0.02)}, "load-dependent friction, joint 1": {"load": (0.08, 0.0)}, "nothing": {}},
    ),
    ("tracker", "tracker", 100, 1, SECONDS, {"actuator lag at theta": {"lag": (0.02, 0.0)}}),
    ("one joint, long", "pendulum", 250, 20, 60.0, {"load-dependent friction": {"load": (0.08,)}}),
]  # fmt: skip


def datasets(
    model: str, rate: int, runs: int, seconds: float, withheld: list[dict[str, Any]]
) -> list[Any]:
    """A recording for each set of withheld effects, from rest, all integrated side by side."""
    import jaxid
    from jaxid.benchmark.numpy_twin import recorded
    from jaxid.benchmark.plants import NEUTRAL, PLANTS
    from jaxid.benchmark.withheld import commands

    plant = dataclasses.replace(PLANTS[model], rate=rate)
    rng = np.random.default_rng(8)
    count = int(rate * seconds)
    each = [
        np.concatenate(
            [commands(plant, rng, 1)[0] for _ in range(-(-count // int(rate * SECONDS)))]
        )[:count]
        for _ in range(runs)
    ]
    u = np.repeat(np.array(each)[None], len(withheld), 0).reshape(-1, count, plant.n)

    def own(c, k):
        return c.get(k, plant.nominal.get(k, (NEUTRAL.get(k, 0.0),) * plant.n))

    numbers = {
        k: np.repeat([own(c, k) for c in withheld], runs, 0).astype(float)
        for k in {**NEUTRAL, **plant.nominal}
    }
    y = recorded(plant, u, numbers, rng).reshape(len(withheld), runs, count, plant.n)
    t = np.arange(count) / rate
    return [
        jaxid.Dataset.from_arrays(
            [t] * runs,
            inputs={n: [one[:, i] for one in each] for i, (n, _) in enumerate(plant.inputs)},
            outputs={n: [one[:, i] for one in own_y] for i, (n, _) in enumerate(plant.outputs)},
            units=dict((*plant.inputs, *plant.outputs)),
            at_rest=True,
            noise_std={n: plant.noise for n, _ in plant.outputs},
            resolution={n: plant.resolution for n, _ in plant.outputs},
            model=model,
        )
        for own_y in y
    ]


def recordings() -> Iterator[tuple[str, str, Any]]:
    """(what, withheld, dataset) of every row."""
    for what, model, rate, runs, seconds, withheld in CASES:
        for label, data in zip(
            withheld, datasets(model, rate, runs, seconds, list(withheld.values())), strict=True
        ):
            yield what, label, data
    yield "flexible link", "actuator lag", link()


def link() -> Any:
    """The blind case of a flexible link whose drive lags."""
    from blind_cases import plan, recordings

    case = next(
        c for c in plan("flexible_link", 8, ("effect",)) if c["effects"][0][0] == "actuator_lag"
    )
    return recordings([case], 8)[0][0]


def timed(folder: Path, again: bool) -> None:
    """In a process of its own: a diagnosis of a stored dataset, as JSON; `again`: twice."""
    from jaxid.runtime import prepare

    prepare()
    import jaxid

    rows, answer, steps = [], "", counted()
    for _ in range(1 + again):
        began, before = time.perf_counter(), steps[0]
        d = jaxid.diagnose(None, jaxid.load_dataset(folder), seed=0)
        rows.append({"wall": time.perf_counter() - began, "steps": (steps[0] - before) / 1e6})
        answer = f"{d.which.verdict}: {', '.join(str(e) for e in d.which.effects) or '-'}"
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(json.dumps({"rows": rows, "answer": answer, "peak": peak}))


def counted() -> list[int]:
    """Counts from now on, in its only entry, what all engines of this process step through, also
    those that are let go.
    """
    from jaxid.simulation.batch import BatchSimulator

    total = [0]

    def count(engine: Any, value: int) -> None:
        total[0] += value - vars(engine).get("simulated", 0)
        vars(engine)["simulated"] = value

    BatchSimulator.simulated = property(lambda engine: vars(engine)["simulated"], count)  # pyright: ignore[reportAttributeAccessIssue]
    return total


def main() -> dict[str, Any]:
    import jaxid

    rows = []
    with tempfile.TemporaryDirectory() as place:
        environment = os.environ | {"JAXID_CACHE_DIR": f"{place}/cache"}
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)

        def ran(*command: str) -> str:
            done = subprocess.run(
                [sys.executable, *command], env=environment, capture_output=True, text=True
            )
            if done.returncode:
                raise RuntimeError(done.stderr[-2000:])
            return done.stdout

        for n, (what, label, data) in enumerate(recordings()):
            folder = Path(place) / f"case_{n}"
            jaxid.save_dataset(data, folder)
            cold = json.loads(ran(__file__, str(folder), "once").splitlines()[-1])
            warm = json.loads(ran(__file__, str(folder), "twice").splitlines()[-1])
            began = time.perf_counter()
            ran("-m", "jaxid", "diagnose", str(folder), "--out", f"{folder}_out", "--quiet")
            command = time.perf_counter() - began
            first, second = warm["rows"]
            times = {
                "cold": cold["rows"][0]["wall"],
                "warm": first["wall"],
                "again": second["wall"],
                "command": command,
            }
            row = {"model": what, "withheld": label} | {k: f"{v:.1f} s" for k, v in times.items()}
            rows.append(
                row
                | {
                    "steps, millions": round(first["steps"], 1),
                    "GB": round(warm["peak"], 2),
                    "answer": warm["answer"],
                }
            )
            print(rows[-1], flush=True)
    return {
        "title": "Time of one diagnosis",
        "text": " ".join((__doc__ or "").split()),
        "rows": rows,
    }


if __name__ == "__main__":
    if len(sys.argv) > 2:
        timed(Path(sys.argv[1]), sys.argv[2] == "twice")
    else:
        main()
