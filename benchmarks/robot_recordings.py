"""Position-controlled and torque-driven robots as recorded: error of each joint with its file as it stands and re-tuned.

A quadruped hung by its trunk (free runs from the goals; its maintainers' identified numbers leave 0.0066 rad), a hobby arm of
six servos (free runs; by hand 5.6 mrad at joint 1, 21.7 mrad at joint 2), a seven-joint arm (torque; file: 38 to 101 %).

Data: the folder named by JAXID_DATA (default `../shared/data` beside the repository); they are not part of the repository.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

import jaxid


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


def recording(name: str) -> jaxid.Dataset:
    if not (DATA / name).is_dir():
        raise FileNotFoundError(f"{name} is not in {DATA.name}; set JAXID_DATA")
    return jaxid.load_dataset(DATA / name)


def fitted(name: str, split: str = "report") -> list[dict[str, Any]]:
    """Free runs of the joints of a robot under its law."""
    fit = jaxid.fit(None, recording(name))
    rows = [
        {
            "recording": name,
            "joint": r["joint"],
            "file as it stands": r["as_it_stands"],
            "re-tuned": r["retuned"],
            "unit": r["unit"],
        }
        for r in fit.per_joint
        if r["split"] == split
    ]
    rms = lambda column: float(np.sqrt(np.mean([r[column] ** 2 for r in rows])))
    total = {c: rms(c) for c in ("file as it stands", "re-tuned")}
    seconds = f"{fit.wall_time_s:.0f} s, {fit.compile_time_s:.0f} s of it compiling"
    return [*rows, {"recording": name, "joint": "all", **total, "unit": f"rad; {seconds}"}]


def identified(name: str) -> list[dict[str, Any]]:
    """Torque of the joints, relative error on each recording that was not fitted."""
    found = jaxid.identify(None, recording(name))
    return [
        {"recording": f"{name} {r['experiment']}", "joint": r["joint"], "file as it stands": r["as_it_stands"],
         "re-tuned": r["retuned"], "unit": r["unit"]}
        for r in found.per_joint
        if r["split"] != "fit"
    ]  # fmt: skip


def main() -> dict[str, Any]:
    rows = [*identified("kinova_gen3"), *fitted("so101_chirps"), *fitted("go2_chirp")]
    return {"title": "Recorded robots: their files as they stand", "text": " ".join((__doc__ or "").split()), "rows": rows}


if __name__ == "__main__":
    from jaxid.runtime import prepare

    prepare()
    print(*main()["rows"], sep="\n")
