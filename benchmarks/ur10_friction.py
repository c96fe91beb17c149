"""Table VIII of paper 001 on a twin: what is left of the friction torque by a linear law and by one
with an exponent.

The twin (benchmarks/ur10_payload.py) gets white noise of the size that the paper's law with an
exponent leaves, by joint, so that the columns can be compared: what the linear law leaves beyond it
is the law's own error along this motion. The paper fits friction alone; here base parameters and
friction are fitted together, filtered at 40 Hz, and judged on another motion.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import jaxid
from benchmarks.ur10_payload import arm_of, EXPONENT, LEVEL, LOADS, OFFSET, VISCOUS


#: Exponents of Table VI without and with the payload, and Table VIII: RMSE (N m) by the linear law
#: and by the one with exponent.
CASES = {
    "no load": (
        None, EXPONENT,
        (1.7499, 3.0599, 1.4170, 0.3913, 0.2965, 0.3726), (1.3102, 2.5186, 1.1437, 0.3914, 0.2793, 0.3325),
    ),
    "3.5256 kg": (
        LOADS["3.5256 kg"], np.array([0.5430, 0.2603, 0.3984, 0.9568, 0.8151, 0.6969]),
        (1.6726, 4.7629, 2.3821, 0.4182, 0.3712, 0.3782), (1.1982, 4.2579, 1.8470, 0.4176, 0.3603, 0.3333),
    ),
}  # fmt: skip


def recordings(load: np.ndarray | None, exponent: np.ndarray, noise: np.ndarray) -> jaxid.Dataset:
    """Two designed motions of 10 s at 125 Hz: one to fit, one to judge."""
    rng, dynamics, t = np.random.default_rng(0), arm_of(load), np.arange(1250) / 125.0
    designs: list[Any] = [jaxid.excite("ur10", seed=seed) for seed in (0, 1)]
    motions = [design.fourier(t) for design in designs]
    taus = []
    for q, qd, qdd in motions:
        friction = (LEVEL + VISCOUS * np.abs(qd) ** exponent) * np.sign(qd) + OFFSET
        taus.append(dynamics(q, qd, qdd) + friction + noise * rng.normal(size=q.shape))
    return jaxid.Dataset.from_arrays(
        [t, t],
        {f"tau{j + 1}": [tau[:, j] for tau in taus] for j in range(6)},
        {f"q{j + 1}": [q[:, j] for q, _, _ in motions] for j in range(6)},
        model="ur10",
        split=["fit", "validation"],
    )


def main() -> dict[str, Any]:
    rows = []
    for name, (load, exponent, linear, power) in CASES.items():
        data = recordings(load, exponent, np.array(power))
        found = {
            law: jaxid.identify(None, data, friction=law, cutoff_hz=40.0)
            for law in ("linear", "power")
        }
        chosen = jaxid.identify(None, data, cutoff_hz=40.0).law
        left = {
            law: np.array(r.experiments[1].unfiltered_rmse_per_joint) for law, r in found.items()
        }
        estimates = found["power"].exponents
        assert estimates is not None
        for j in range(6):
            rows.append(
                {
                    "load": name,
                    "joint": j + 1,
                    "linear law, N m": round(float(left["linear"][j]), 3),
                    "with exponent, N m": round(float(left["power"][j]), 3),
                    "less by": f"{100 * (1 - left['power'][j] / left['linear'][j]):.0f} %",
                    "paper: less by": f"{100 * (1 - power[j] / linear[j]):.0f} % ({linear[j]:.3g} to {power[j]:.3g})",
                    "exponent (truth)": f"{estimates[j]:.3f} ({exponent[j]:.3f})",
                    "law chosen on the other motion": chosen,
                }
            )
    text = " ".join((__doc__ or "").split())
    return {
        "title": "Friction laws of a UR10 twin (paper 001, Table VIII)",
        "text": text,
        "rows": rows,
    }


if __name__ == "__main__":
    from jaxid.runtime import prepare

    prepare()
    print(*main()["rows"], sep="\n")
