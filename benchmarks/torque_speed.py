"""How long a diagnosis by torque takes with the whole library, in process: recorded arms, and twins
with something missing.

UR10e: its model is robbed of friction, whole library. Panda, double pendulum: as they are. Twins: a
UR10e by Pinocchio whose held-out runs carry 1.5 kg, and one whose last two joints share gears.
Errors are those of the torque on report data, both sides through the low-pass of the diagnosis,
|measured - predicted| / |measured| over all joints.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
RECORDED: dict[str, dict[str, Any]] = {
    "ur10e": {"without": ["coulomb_friction", "power_law_friction"]},
    "panda_exciting": {},
    "double_pendulum_c0": {},
}


def cases() -> Iterator[tuple[str, Any, Any, dict[str, Any]]]:
    """(label, model, dataset, settings)."""
    import jaxid
    import test_torque_diagnosis as twins

    for name, settings in RECORDED.items():
        if (DATA / name).is_dir():
            yield name, None, jaxid.load_dataset(DATA / name), settings
    arm, load = twins.ARMS["ur10e"], twins.body(1.5, 0.05, 0.02, 0.1)
    yield (
        "UR10e twin, 1.5 kg in held-out runs",
        arm,
        twins.recorded([twins.run(arm, k + 1, load if k else None) for k in range(3)]),
        {},
    )
    yield (
        "UR10e twin, wrist with shared gears",
        arm,
        twins.recorded([twins.run(arm, k + 1, more=twins.wrist) for k in range(3)]),
        {},
    )


def error(d: Any) -> dict[str, float]:
    """Model -> relative error over all joints of the report runs, in percent."""
    own = [t for t in d.traces if t.split == "report"] or [
        t for t in d.traces if t.split == "validation"
    ]
    size = sum(float(np.sum(t.measured**2)) for t in own)
    return {
        k: 100 * np.sqrt(sum(float(np.sum((t.measured - t.simulated[k]) ** 2)) for t in own) / size)
        for k in own[0].simulated
    }


def main() -> dict[str, Any]:
    import jaxid

    rows = []
    for label, model, data, settings in cases():
        for state in ("first", "again"):
            began, spent = time.perf_counter(), time.process_time()
            d = jaxid.diagnose(model, data, residual="inverse_dynamics", **settings)
            times = {
                "wall time": time.perf_counter() - began,
                "CPU time": time.process_time() - spent,
            }
            row = {"recording": label, "run": state} | {k: f"{v:.1f} s" for k, v in times.items()}
            row["verdict"] = (
                f"{d.which.verdict}: {', '.join(str(e) for e in d.which.effects) or '-'}"
            )
            row["error re-tuned, and after"] = ", ".join(f"{v:.3g} %" for v in error(d).values())
            row["gap re-tuned, and after"] = (
                f"{d.how_far.gap_retuned:.3g}, {d.how_far.gap_after:.3g}"
            )
            row["ceiling"] = (
                "-" if d.how_far.ceiling is None else f"{100 * d.how_far.ceiling:.0f} %"
            )
            rows.append(row)
            print(row, flush=True)
    return {
        "title": "Time of a diagnosis by torque",
        "text": " ".join((__doc__ or "").split()),
        "rows": rows,
    }


if __name__ == "__main__":
    from jaxid.runtime import prepare

    prepare()
    main()
