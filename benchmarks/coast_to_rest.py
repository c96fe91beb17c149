"""Coverage of fits of a joint that coasts to rest without any force: 200 recordings that differ in
their noise.

python benchmarks/coast_to_rest.py [N]
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from jaxid.runtime import prepare


prepare()
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402

import jaxid  # noqa: E402
from tests.test_rest import coast_down, deviations, TRUE  # noqa: E402


def main(count: int = 200) -> dict[str, Any]:
    off, states = [], []
    for seed in range(count):
        fit = jaxid.fit("joint", coast_down(seed), without=("constant_torque",))
        off.append([deviations(fit)[name] for name in TRUE])
        states.append(fit.state)
    inside = np.abs(np.array(off)) < 1.96
    rows: list[dict[str, Any]] = [
        {
            "parameter": name,
            "truth": TRUE[name],
            "coverage of 95 % intervals": f"{100 * share:.1f} %",
        }
        for name, share in zip(TRUE, inside.mean(0), strict=True)
    ]
    text = (
        f"A joint that two pulses of torque push and that coasts to rest without any force, {count} noise seeds; "
        f"{states.count('converged')} fits say converged, {100 * inside.mean():.1f} % of all intervals hold the truth."
    )
    return {"title": "Coasting to rest: coverage of the intervals", "text": text, "rows": rows}


if __name__ == "__main__":
    import json

    print(json.dumps(main(*map(int, sys.argv[1:])), indent=1))
