"""Diagnosis of a recorded UR10e whose model has no friction: by torque, laws compared at all joints.

Relative torque error |measured - predicted| / |measured| over all joints, both filtered at 5 Hz without phase, as published with
the recordings. `ident_50s` and `valid_ptp` choose between laws; no number is fitted to them.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")) / "ur10e"
#: The laws that are offered: those of a joint's speed and load alone.
LAWS = ["coulomb_friction", "viscous_friction", "power_law_friction", "asymmetric_friction", "load_dependent_friction",
        "stribeck_friction", "quadratic_drag"]  # fmt: skip
BUILTIN = ["coulomb_friction", "power_law_friction"]
CUTOFF_HZ = 5.0


def relative_errors(traces: Any) -> dict[str, dict[str, float]]:
    """Experiment -> model -> relative error over all joints and all parts of the experiment, in percent."""
    from jaxid.signals import zero_phase

    smooth = lambda trace, y: zero_phase(trace.t, y[:, None], CUTOFF_HZ)
    whole = lambda trace: trace.experiment.split("#")[0]
    found: dict[str, dict[str, float]] = {}
    for name in dict.fromkeys(whole(t) for t in traces):
        own = [t for t in traces if whole(t) == name]
        measured = [smooth(t, t.measured) for t in own]
        size = sum(np.sum(y**2) for y in measured)
        for label in own[0].simulated:
            error = sum(np.sum((y - smooth(t, t.simulated[label])) ** 2) for t, y in zip(own, measured, strict=True))
            found.setdefault(name, {})[label] = float(100 * np.sqrt(error / size))
    return found


def main() -> dict[str, Any]:
    import jaxid

    if not DATA.is_dir():
        raise FileNotFoundError(f"{DATA.name} is not in {DATA.parent.name}; set JAXID_DATA")
    began = time.process_time()
    d = jaxid.diagnose(
        None, jaxid.load_dataset(DATA), without=BUILTIN, residual="inverse_dynamics", effects=LAWS, max_effects=3, seed=0
    )
    spent = time.process_time() - began
    errors = {name: list(e.values()) for name, e in relative_errors(d.traces).items()}
    rows = [
        {"what": "verdict", "result": d.which.verdict},
        {"what": "named", "result": ", ".join(str(e) for e in d.which.effects)},
        {"what": "not to be told apart from them", "result": ", ".join(str(e) for e in d.which.confusable_with) or "nothing"},
        {
            "what": "gap, re-tuned and after (multiples of the noise)",
            "result": f"{d.how_far.gap_retuned:.3g}, {d.how_far.gap_after:.3g}",
        },
        *(
            {
                "what": f"relative torque error, {name}: re-tuned without friction, and after",
                "result": f"{before:.3g} %, {after:.3g} %",
            }
            for name, (before, after) in errors.items()
        ),
    ]
    text = f"{' '.join((__doc__ or '').split())} Offered: {', '.join(LAWS)}. {spent:.0f} CPU s."
    return {"title": "A recorded arm without friction: diagnosis by torque", "text": text, "rows": rows}


if __name__ == "__main__":
    from jaxid.runtime import prepare

    prepare()
    print(*main()["rows"], sep="\n")
