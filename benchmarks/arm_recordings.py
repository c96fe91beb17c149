"""Identification of recorded arms: a UR10e by motor current, a Panda by its torque sensors.

Relative torque error |measured - predicted| / |measured| over all joints, both filtered at 5 Hz
without phase, as published with the recordings (the Panda with 20 Hz, its test part is the last
third of one run). The friction law is the simplest that no richer one beats on every held-out
recording; each law that was tried is listed.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import jaxid


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
#: Recording, filter in Hz, and the figures of the recording's own notes: without friction, and with
#: viscous and dry friction.
ARMS = (
    ("ur10e", 5.0, "44.7, 48.8, 39.2 %", "3.90, 4.64, 4.54 %"),
    ("panda_exciting", 20.0, "6.18, 7.41 %", "4.75, 6.09 %"),
)


def main() -> dict[str, Any]:
    rows = []
    for name, cutoff, without, known in ARMS:
        if not (DATA / name).is_dir():
            raise FileNotFoundError(f"{name} is not in {DATA.name}; set JAXID_DATA")
        found = jaxid.identify(None, jaxid.load_dataset(DATA / name), cutoff_hz=cutoff)

        def percent(values):
            return ", ".join(f"{100 * v:.3g}" for v in values)

        rows.append(
            {
                "recording": name,
                "what": "from the notes: no friction",
                "runs": "",
                "relative error %": without,
            }
        )
        rows.append(
            {
                "recording": name,
                "what": "from the notes: viscous and dry friction",
                "runs": "",
                "relative error %": known,
            }
        )
        for trial in found.laws:
            what = f"friction law {trial.law}{', chosen' * trial.chosen}"
            rows.append(
                {
                    "recording": name,
                    "what": what,
                    "runs": "all",
                    "relative error %": percent([trial.fit, *trial.held_out]),
                }
            )
        for e in found.experiments:
            rows.append(
                {
                    "recording": name,
                    "what": "joint by joint",
                    "runs": f"{e.file}, {e.split}",
                    "relative error %": f"{100 * e.relative_error:.3g} ({percent(e.relative_error_per_joint)}); "
                    f"unfiltered {100 * e.unfiltered_relative_error:.3g}",
                }
            )
    return {
        "title": "Recorded arms: torque error of the identification",
        "text": " ".join((__doc__ or "").split()),
        "rows": rows,
    }


if __name__ == "__main__":
    from jaxid.runtime import prepare

    prepare()
    print(*main()["rows"], sep="\n")
