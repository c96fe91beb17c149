"""The flexible link against the measured frequency response of a Quanser rotary flexible link (volts to hub angle).

The source states neither units nor the loop the hub stood in: its response is flat towards low frequency, so that a spring at
the hub (a position loop) belongs to the model, and the input's gain is free. What can be judged is the shape: zeros at the
clamped frequencies, poles, phase. Four days of recordings: one is fitted, the other three are predicted.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

import jaxid
from jaxid.experiment import Channel, Dataset, FrequencyResponse, ModelSpec, ParameterPrior
from jaxid.frequency import merged


#: Dimensions of the maker's data sheet: a steel strip of 0.419 m and 65 g.
LINK = {"L": 0.419, "h": 0.00098, "b": 0.0203, "rho": 7800.0, "m_p": 0.0, "tau_c": 0.0}
#: N m per volt that the response is divided by, so that the free gain is near one.
DRIVE = 0.128
DAYS = ("2025-05-07", "2025-04-16", "2025-04-18", "2025-05-09")
EFFECTS = ("spring_torque@phi", "torque_scale@tau", "input_delay@tau")
HIGHEST = 400.0  # rad/s; beyond is noise with gross outliers, as the data's notes say


def folder() -> Path:
    root = Path(os.environ.get("JAXID_DATA", Path(__file__).parent.parent.parent / "shared" / "data"))
    return root / "quanser_flexlink_frf"


def response(day: str, highest: float) -> FrequencyResponse:
    import pandas as pd

    d = pd.read_parquet(folder() / f"frf_{day}.parquet")
    d = d[d.omega_rad_s <= highest]
    value = d.gain.to_numpy() * np.exp(1j * d.phase_rad.to_numpy()) / DRIVE
    return FrequencyResponse(day, "fit" if day == DAYS[0] else "report", d.omega_rad_s.to_numpy(), value, "tau", "phi")


def data(highest: float = HIGHEST) -> Dataset:
    priors = {
        "E": ParameterPrior(2e11, 1e10, 1e12),
        "I_m": ParameterPrior(0.002, 1e-4, 0.2),
        "v": ParameterPrior(0.1, 0.0, 10.0),
    }
    model = ModelSpec("flexible_link", without=(), constants=LINK, parameters=priors)
    channels = (Channel("tau", "input", "N m"), Channel("phi", "output", "rad"))
    return Dataset("quanser_flexlink", channels, responses=tuple(response(d, highest) for d in DAYS), model=model)


def errors(fit: jaxid.Fit, dataset: Dataset, effects: tuple[str, ...]) -> dict[str, float]:
    """Median over lines of |model - data| / |data|, per day."""
    import jax.numpy as jnp

    from jaxid.binding import bind
    from jaxid.frequency import transfer
    from jaxid.precision import float64

    layout = bind(None, dataset, effects=effects).layout
    out = {}
    with float64():
        model = layout.model(jnp.asarray(fit.theta))
        for measured in dataset.responses:
            lines = merged(measured)
            re, im = (np.asarray(a)[:, 0, 0] for a in transfer(model, jnp.asarray(lines.omega)))
            out[measured.name] = float(np.median(np.abs(re + 1j * im - lines.response) / np.abs(lines.response)))
    return out


def main() -> dict:
    if not folder().exists():
        return {"skipped": f"no {folder()}"}
    dataset, rows = data(), {}
    for label, effects, link in (
        ("one rigid link", EFFECTS[:2], {"n_modes": 1, "E": 1e12}),
        ("one mode", EFFECTS, {"n_modes": 1}),
        ("no delay", EFFECTS[:2], {}),
        ("full", EFFECTS, {}),
    ):
        spec = dataset.model
        assert spec is not None
        parameters = {k: v for k, v in spec.parameters.items() if k not in link}
        own = Dataset(
            dataset.name, dataset.channels, responses=dataset.responses,
            model=ModelSpec(spec.name, constants=spec.constants | link, parameters=parameters),
        )  # fmt: skip
        fit = jaxid.fit(None, own, effects=effects, fitter=jaxid.fitters.LevenbergMarquardt(restarts=8))
        found = {k: (p.value, p.std) for k, p in fit.parameters.items()}
        found |= {f"{e.effect}.{k}": (p.value, p.std) for e in fit.effects for k, p in e.parameters.items()}
        rows[label] = {"loss": fit.loss, "relative_error": errors(fit, own, effects), "parameters": found}
    spoilt = jaxid.fit(None, data(2000.0), effects=EFFECTS, fitter=jaxid.fitters.LevenbergMarquardt(restarts=8))
    rows["with the lines above 400 rad/s"] = {
        "loss": spoilt.loss,
        "relative_error": errors(spoilt, dataset, EFFECTS),
        "parameters": {k: (p.value, p.std) for k, p in spoilt.parameters.items()},
    }
    return {"columns": "median |model - data| / |data| over the lines up to 400 rad/s", "rows": rows}


if __name__ == "__main__":
    result = main()
    for label, row in result.get("rows", {}).items():
        print(label, f"loss {row['loss']:.4g}", {k: round(v, 4) for k, v in row["relative_error"].items()})
        for name, (value, std) in row["parameters"].items():
            print(f"    {name:24} {value:.5g}" + (f" +- {std:.2g}" if std else ""))
