"""Coverage of fits of a joint that coasts to rest without any force: 200 recordings that differ in their noise.

python benchmarks/coast_to_rest.py [N]
"""

from __future__ import annotations

import sys
from pathlib import Path

from jaxid.runtime import prepare


prepare()
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np  # noqa: E402

import jaxid  # noqa: E402
from test_rest import coast_down, deviations, TRUE  # noqa: E402


def main(count: int) -> None:
    off, states, losses = [], [], []
    for seed in range(count):
        fit = jaxid.fit("joint", coast_down(seed), without=("constant_torque",))
        off.append([deviations(fit)[name] for name in TRUE])
        states.append(fit.state)
        losses.append(fit.loss)
    inside = np.abs(np.array(off)) < 1.96
    print(f"{count} fits, {states.count('converged')} converged, loss {min(losses):.3f} to {max(losses):.3f}")
    each = ", ".join(f"{name} {100 * share:.1f} %" for name, share in zip(TRUE, inside.mean(0), strict=True))
    print(f"95 % intervals hold the truth: {100 * inside.mean():.1f} % ({each})")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
