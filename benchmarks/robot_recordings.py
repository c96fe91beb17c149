"""Position-controlled and torque-driven robots as recorded: error of each joint with its file,
re-tuned, and with effects.

A quadruped hung by its trunk (free runs from the goals; its maintainers' identified numbers leave
0.0066 rad), a hobby arm of six servos (free runs; by hand 5.6 mrad at joint 1, 21.7 mrad at joint
2), a seven-joint arm (torque; file: 38 to 101 %).

Data: the folder named by JAXID_DATA (default `../shared/data` beside the repository); they are not
part of the repository.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxid


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


def recording(name: str) -> jaxid.Dataset:
    if not (DATA / name).is_dir():
        raise FileNotFoundError(f"{name} is not in {DATA.name}; set JAXID_DATA")
    return jaxid.load_dataset(DATA / name)


def table(
    name: str, per_joint: Sequence[Mapping[str, Any]], said: str, split: str = "report"
) -> list[dict[str, Any]]:
    """Free runs of the joints of a robot under its law; the row of all joints has what was
    `said`.
    """
    columns = {
        "file as it stands": "as_it_stands",
        "re-tuned": "retuned",
        "with effects": "with_effects",
    }
    own = [r for r in per_joint if r["split"] == split]
    rows = [
        {
            "recording": name,
            "joint": r["joint"],
            **{c: r.get(k) or r["retuned"] for c, k in columns.items()},
            "unit": r["unit"],
        }
        for r in own
    ]
    total = {c: float(np.sqrt(np.mean([r[c] ** 2 for r in rows]))) for c in columns}
    return [*rows, {"recording": name, "joint": "all", **total, "unit": "rad", "answer": said}]


def diagnosed(name: str) -> list[dict[str, Any]]:
    began, spent = time.perf_counter(), time.process_time()
    found = jaxid.diagnose(None, recording(name))
    effects = ", ".join(f"{e.effect} at {e.location}" for e in found.which.effects)
    seconds = f"{time.process_time() - spent:.0f} s of processor time, {time.perf_counter() - began:.0f} s"
    return table(
        name, found.how_far.per_joint, f"{found.which.verdict}: {effects or 'no name'}; {seconds}"
    )


def identified(name: str) -> list[dict[str, Any]]:
    """Torque of the joints, relative error on each recording that was not fitted; none of a joint
    that stands still.
    """
    found = jaxid.identify(None, recording(name))
    rows = []
    for r in found.per_joint:
        if r["split"] == "fit":
            continue
        row = {"recording": f"{name} {r['experiment']}", "joint": r["joint"]}
        if np.isnan(r["retuned"]):
            row["answer"] = "stands still"
        else:
            errors = {"file as it stands": r["as_it_stands"], "re-tuned": r["retuned"]}
            row |= errors | {"unit": r["unit"]}
        rows.append(row)
    return rows


def main() -> dict[str, Any]:
    rows = [*identified("kinova_gen3"), *diagnosed("so101_chirps"), *diagnosed("go2_chirp")]
    return {
        "title": "Recorded robots: their files as they stand",
        "text": " ".join((__doc__ or "").split()),
        "rows": rows,
    }


if __name__ == "__main__":
    from jaxid.runtime import prepare

    prepare()
    print(*main()["rows"], sep="\n")
