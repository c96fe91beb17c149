"""A position-controlled servo as it was recorded: Dynamixel XL330 on a pendulum bench, three gains,
four trajectories.

Free runs of 6 s from the goal position alone. Mean absolute error per log, averaged over the logs
(reference of the recording's notes: 0.0492 rad with Coulomb and viscous friction, 0.0320 with
load-dependent and Stribeck friction). Then one gain is left out of the fit and predicted. In the
end what the diagnosis names of the first model's gap, of all effects (the gap in multiples of 1
mrad).
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jaxid  # noqa: E402
from jaxid.data.dataset import ModelSpec, ParameterPrior  # noqa: E402


PRIORS = {
    "gain_scale": (2e-3, 1e-5, 1e-1),
    "torque_constant": (0.1, 0.005, 2.0),
    "back_emf": (0.04, 1e-4, 2.0),
    "armature": (0.002, 1e-5, 0.05),
}
MODELS = {
    "Coulomb and viscous": (),
    "with load-dependent and Stribeck friction": (
        "load_dependent_friction@q",
        "stribeck_friction@q",
    ),
}


def file() -> Path:
    root = Path(
        os.environ.get("JAXID_DATA", Path(__file__).parent.parent.parent / "shared" / "data")
    )
    return root / "xl330_pendulum" / "xl330.parquet"


def data(held_out: int | None = None) -> jaxid.Dataset:
    """All logs; those recorded with the gain `held_out` are for the report."""
    import pandas as pd

    logs = [one for _, one in pd.read_parquet(file()).groupby("log")]

    def column(name):
        return [one[name].to_numpy(float) for one in logs]

    kp = [float(one.kp.iloc[0]) for one in logs]
    dataset = jaxid.Dataset.from_arrays(
        column("t"),
        {"q_cmd": column("q_goal_rad"), "enable": column("torque_enable")},
        {"q": column("q_rad")},
        units={"q_cmd": "rad", "enable": "1", "q": "rad"},
        noise_std={"q": 1e-3},
        names=[str(one.log.iloc[0]) for one in logs],
        constants=[
            {"kp": k, "supply_voltage": float(one.vin.iloc[0])}
            for k, one in zip(kp, logs, strict=True)
        ],
        initial=[{"q": float(one.q_rad.iloc[0]), "qd": 0.0} for one in logs],
        split=["report" if k == held_out else "fit" for k in kp],
    )
    constants = {"mass": 0.49, "length": 0.1, "gravity": 9.81}
    model = ModelSpec(
        "servo", constants=constants, parameters={k: ParameterPrior(*v) for k, v in PRIORS.items()}
    )
    return replace(dataset, model=model)


def errors(fit: jaxid.Fit, dataset: jaxid.Dataset) -> dict[str, float]:
    """Mean absolute error of the free run per log, rad; the start is the measured one."""
    out = {}
    for e, run in zip(dataset.experiments, jaxid.simulate(None, dataset, fit).runs, strict=True):
        out[e.name] = float(np.mean(np.abs(run["q"] - e.y[:, 0])))
    return out


def numbers(fit: jaxid.Fit) -> dict[str, float]:
    """All fitted numbers."""
    own = {k: p.value for k, p in fit.parameters.items()}
    return own | {f"{e.effect}.{k}": p.value for e in fit.effects for k, p in e.parameters.items()}


def diagnosed() -> dict[str, Any]:
    """What a diagnosis of the model with Coulomb and viscous friction names, one gain left out."""
    dataset = data(200)
    d = jaxid.diagnose(None, dataset)
    found = errors(d.final, dataset)

    def mean(report):
        return float(
            np.mean([found[e.name] for e in dataset.experiments if (e.split == "report") == report])
        )

    return {
        "friction": f"{d.which.verdict}: {', '.join(map(str, d.which.effects)) or 'no effect'}",
        "MAE of the fitted logs, rad": mean(False),
        "MAE of the logs with gain 200, held out, rad": mean(True),
        "gap on the logs with gain 200": f"{d.how_far.gap_retuned:.3g} -> {d.how_far.gap_after:.3g}",
    } | numbers(d.final)


def main() -> dict:
    about = (__doc__ or "").split("\n", 2)[2].strip()
    rows = []
    for label, effects in MODELS.items():
        for held_out in (None, 200):
            dataset = data(held_out)
            fit = jaxid.fit(None, dataset, effects=effects)
            found = errors(fit, dataset)

            def part(split):
                return [found[e.name] for e in dataset.experiments if e.split == split]

            row = {"friction": label, "MAE of the fitted logs, rad": float(np.mean(part("fit")))}
            row["MAE of the logs with gain 200, held out, rad"] = (
                "" if held_out is None else float(np.mean(part("report")))
            )
            rows.append(row | numbers(fit))
    rows.append(diagnosed())
    return {
        "title": "A position-controlled servo as it was recorded",
        "text": about,
        "rows": rows,
    }


if __name__ == "__main__":
    for row in main()["rows"]:
        print(row)
