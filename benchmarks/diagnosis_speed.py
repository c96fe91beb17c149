"""How long one diagnosis takes: 8 s of a two-link arm at 500 Hz, with every effect of the library at both joints.

The recording is of the separate twin of the blind cases, with noise and one withheld effect. Each run is a process of its own:
cold with an empty cache of compiled programs, then warm with that cache.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

RATE, SECONDS = 500, 8.0
WITHHELD = {
    "actuator lag at joint 2": {"lag": (0.0, 0.02)},
    "load-dependent friction at joint 1": {"load": (0.08, 0.0)},
    "nothing": {},
}


def datasets() -> list[Any]:
    """One recording for each entry of `WITHHELD`, from rest, integrated side by side."""
    from blind_cases import commands, PLANTS
    from twins import NEUTRAL, recorded

    import jaxid

    plant, cases = dataclasses.replace(PLANTS["planar_arm"], rate=RATE), list(WITHHELD.values())
    rng = np.random.default_rng(8)
    u = np.repeat(commands(plant, rng, 1)[:, : int(RATE * SECONDS)], len(cases), 0)
    own = lambda c, k: c.get(k, plant.nominal.get(k, (NEUTRAL.get(k, 0.0),) * plant.n))
    y = recorded(plant, u, {k: np.array([own(c, k) for c in cases], float) for k in {**NEUTRAL, **plant.nominal}}, rng)
    t = np.arange(u.shape[1]) / RATE
    return [
        jaxid.Dataset.from_arrays(
            [t],
            inputs={n: [u[0, :, i]] for i, (n, _) in enumerate(plant.inputs)},
            outputs={n: [own_y[:, i]] for i, (n, _) in enumerate(plant.outputs)},
            units=dict((*plant.inputs, *plant.outputs)),
            at_rest=True,
            noise_std={n: plant.noise for n, _ in plant.outputs},
            resolution={n: plant.resolution for n, _ in plant.outputs},
            model="planar_arm",
        )
        for own_y in y
    ]


def timed(folder: Path) -> None:
    """In a process of its own: one diagnosis of a stored dataset, as JSON."""
    import time

    began, spent = time.perf_counter(), time.process_time()
    from jaxid.runtime import prepare

    prepare()
    import jaxid

    loaded = time.perf_counter()
    d = jaxid.diagnose(None, jaxid.load_dataset(folder), seed=0)
    now = time.perf_counter()
    answer = f"{d.which.verdict}: {', '.join(str(e) for e in d.which.effects) or '-'}"
    print(json.dumps({"wall": now - loaded, "import": loaded - began, "cpu": time.process_time() - spent, "answer": answer}))


def main() -> dict[str, Any]:
    import jaxid

    rows = []
    with tempfile.TemporaryDirectory() as place:
        for k, (label, data) in enumerate(zip(WITHHELD, datasets(), strict=True)):
            folder = Path(place) / f"case_{k}"
            jaxid.save_dataset(data, folder)
            for state in ("cold", "warm", "warm") if k == 0 else ("cold for this case", "warm"):
                environment = os.environ | {"JAXID_CACHE_DIR": f"{place}/cache"}
                environment.pop("JAX_COMPILATION_CACHE_DIR", None)
                done = subprocess.run([sys.executable, __file__, str(folder)], env=environment, capture_output=True, text=True)
                if done.returncode:
                    raise RuntimeError(done.stderr[-2000:])
                r = json.loads(done.stdout.splitlines()[-1])
                times = {"importing": r["import"], "wall time": r["wall"], "CPU time": r["cpu"]}
                row = {"withheld": label, "cache": state} | {k: f"{v:.1f} s" for k, v in times.items()}
                rows.append(row | {"answer": r["answer"]})
                print(rows[-1], flush=True)
    return {"title": "Time of one diagnosis", "text": " ".join((__doc__ or "").split()), "rows": rows}


if __name__ == "__main__":
    timed(Path(sys.argv[1]))
