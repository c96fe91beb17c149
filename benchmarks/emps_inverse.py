"""EMPS, nominal model: inverse-dynamics least squares against the published estimate, and the
simulation in closed loop.

Data: the folder named by JAXID_DATA (default `../shared/data` beside the repository); they are not
part of the repository. Run: `python -m benchmarks.emps_inverse`.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import jaxid
from jaxid.data.dataset import Controller, Dataset
from jaxid.fitting.controlled_motion import simulate_closed_loop
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.result import Fit
from jaxid.fitting.scores import torque_scores
from jaxid.problem.binding import bind
from jaxid.problem.residual import InverseDynamics


#: Janot, Gautier, Brunot 2019: value and two standard deviations.
PUBLISHED = {
    "inertia": (95.1089, 0.30),
    "viscous": (203.5034, 3.2),
    "coulomb": (20.3935, 0.28),
    "offset": (-3.1648, 0.12),
}
GAIN = 35.15065  # N/V of the drive
CONTROLLER: dict[str, Any] = {
    "kp": 160.18,
    "kv": 243.45,
    "gain": GAIN,
    "saturation": 10.0,
    "sample_time": 1e-3,
    "velocity": "averaged_difference",
    "disturbance": "pulses",
}
FILES = {"emps_train": "fit", "emps_test_pulses": "validation"}


def folder() -> Path:
    """Where the recordings lie."""
    return (
        Path(os.environ.get("JAXID_DATA") or Path(__file__).parents[2] / "shared" / "data") / "emps"
    )


def load() -> Dataset:
    """Both recordings with reference, pulses (V, contained in the recorded force) and the drive's
    controller.
    """
    import pyarrow.parquet as pq

    tables = [pq.read_table(folder() / f"{name}.parquet").to_pydict() for name in FILES]

    def column(name):
        return [np.array(t.get(name, np.zeros(len(t["t"])))) for t in tables]

    data = Dataset.from_arrays(
        column("t"),
        {"force": [GAIN * u for u in column("u_V")]},
        {"position": column("q_m")},
        auxiliary={"position_cmd": column("q_ref"), "pulses": column("pulse_N")},
        units={"position_cmd": "m", "pulses": "V"},
        resolution={"position": 5e-8},
        split=list(FILES.values()),
        names=list(FILES),
        name="emps",
        model="joint",
    )
    return replace(data, controller=Controller("cascade", CONTROLLER))


def nominal(data: Dataset, fitter: str = "ls") -> Fit:
    """The nominal model on the training recording."""
    return jaxid.fit("joint", data, fitter=fitter)


def force_errors(data: Dataset, fit: Fit) -> list[float]:
    """Relative error of the inverse-dynamics force on the whole training and the whole test
    recording.
    """
    bench = ProblemBuilder(bind("joint", data, splits=False))
    theta = np.asarray(fit.theta)
    return [
        torque_scores(bench, InverseDynamics(), split, theta, bench.binding.free)[
            "force"
        ].relative_error
        for split in FILES.values()
    ]


def closed_loop(data: Dataset, fit: Fit) -> list[tuple[float, float]]:
    """(relative force error, position error rms in m) of the simulation under the drive's
    controller, per recording.
    """
    b = bind("joint", data, splits=False)
    made = simulate_closed_loop(
        b.dataset, data.experiments, b.layout, np.asarray(fit.theta), b.sigma
    )
    return [
        (
            float(np.linalg.norm(u - e.u) / np.linalg.norm(e.u)),
            float(np.sqrt(np.mean((q - e.y) ** 2))),
        )
        for e, (q, u) in zip(data.experiments, made, strict=True)
    ]


def main() -> dict:
    """Measured figures beside the published ones."""
    data = load()
    rows: list[dict[str, str]] = []
    for fitter in ("ls", "wls", "iv"):
        fit = nominal(data, fitter)
        row = {"method": fitter}
        for name, e in fit.parameters.items():
            row[name] = f"{e.value:.4g} +- {2 * (e.std or np.nan):.2g}"
        train, test = force_errors(data, fit)
        row["force error, train / test"] = f"{100 * train:.2f} % / {100 * test:.2f} %"
        loops = closed_loop(data, fit)
        row["closed loop: force error"] = " / ".join(f"{100 * f:.2f} %" for f, _ in loops)
        row["closed loop: position rms"] = " / ".join(f"{1e3 * q:.4f} mm" for _, q in loops)
        rows.append(row)
    published = {name: f"{value:.4g} +- {two:.2g}" for name, (value, two) in PUBLISHED.items()}
    rows.append(
        {
            "method": "published (reference figures of the data's README)",
            **published,
            "force error, train / test": "3.55 % / 4.30 %",
            "closed loop: force error": "5.26 % / 7.41 %",
            "closed loop: position rms": "0.0018 mm / 0.0028 mm",
        }
    )
    text = (
        "Whole recordings. +- is two standard deviations: the published ones take the residual as white, these are the "
        "sandwich's for coloured residuals. Closed loop: the drive's own cascade controller on its recorded reference."
    )
    return {"title": "EMPS, nominal model by linear estimators", "rows": rows, "text": text}


if __name__ == "__main__":
    from jaxid.runtime import prepare

    prepare()
    result = main()
    print(
        result["title"],
        *(" | ".join(f"{k}: {v}" for k, v in r.items()) for r in result["rows"]),
        result["text"],
        sep="\n",
    )
