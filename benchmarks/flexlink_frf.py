"""The flexible link against the measured frequency response of a Quanser rotary flexible link
(volts to hub angle).

The source states neither units nor the loop the hub stood in: its response is flat towards low
frequency, so that a spring at the hub (a position loop) belongs to the model, and the input's gain
is free. What can be judged is the shape: zeros at the clamped frequencies, poles, phase. Four days
of recordings: one is fitted, the other three are predicted.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jaxid  # noqa: E402
from jaxid.data.dataset import Channel, Dataset, FrequencyResponse, ModelSpec, ParameterPrior  # noqa: E402
from jaxid.problem.response_lines import merged  # noqa: E402


#: Dimensions of the maker's data sheet: a steel strip of 0.419 m and 65 g.
LINK = {"L": 0.419, "h": 0.00098, "b": 0.0203, "rho": 7800.0, "m_p": 0.0, "tau_c": 0.0}
#: N m per volt that the response is divided by, so that the free gain is near one.
DRIVE = 0.128
DAYS = ("2025-05-07", "2025-04-16", "2025-04-18", "2025-05-09")
EFFECTS = ("spring_torque@phi", "torque_scale@tau", "input_delay@tau")
HIGHEST = 400.0  # rad/s; beyond is noise with gross outliers, as the data's notes say


def folder() -> Path:
    root = Path(
        os.environ.get("JAXID_DATA", Path(__file__).parent.parent.parent / "shared" / "data")
    )
    return root / "quanser_flexlink_frf"


def response(day: str, highest: float) -> FrequencyResponse:
    import pandas as pd

    d = pd.read_parquet(folder() / f"frf_{day}.parquet")
    d = d[d.omega_rad_s <= highest]
    value = d.gain.to_numpy() * np.exp(1j * d.phase_rad.to_numpy()) / DRIVE
    return FrequencyResponse(
        day, "fit" if day == DAYS[0] else "report", d.omega_rad_s.to_numpy(), value, "tau", "phi"
    )


def data(highest: float = HIGHEST) -> Dataset:
    priors = {
        "E": ParameterPrior(2e11, 1e10, 1e12),
        "I_m": ParameterPrior(0.002, 1e-4, 0.2),
        "v": ParameterPrior(0.08, 0.0, 10.0),
        "spring_torque.stiffness@phi": ParameterPrior(0.2, 0.0, 10.0),
    }
    model = ModelSpec("flexible_link", without=(), constants=LINK, parameters=priors)
    channels = (Channel("tau", "input", "N m"), Channel("phi", "output", "rad"))
    return Dataset(
        "quanser_flexlink",
        channels,
        responses=tuple(response(d, highest) for d in DAYS),
        model=model,
    )


def errors(
    fit: jaxid.Fit, own: Dataset, dataset: Dataset, effects: tuple[str, ...]
) -> dict[str, float]:
    """Median over lines of |model - data| / |data|, per day."""
    import jax.numpy as jnp

    from jaxid.numerics.precision import float64
    from jaxid.problem.binding import bind
    from jaxid.simulation.transfer import transfer

    layout = bind(None, own, effects=effects).layout
    out = {}
    with float64():
        model = layout.model(jnp.asarray(fit.theta))
        for measured in dataset.responses:
            lines = merged(measured)
            re, im = (np.asarray(a)[:, 0, 0] for a in transfer(model, jnp.asarray(lines.omega)))
            out[measured.name] = float(
                np.median(np.abs(re + 1j * im - lines.response) / np.abs(lines.response))
            )
    return out


def main() -> dict:
    about = (__doc__ or "").split("\n", 2)[2].strip()
    dataset, rows = data(), []
    cases = (
        ("one mode", EFFECTS, {"n_modes": 1}, HIGHEST),
        ("all modes, no delay", EFFECTS[:2], {}, HIGHEST),
        ("all modes and a delay", EFFECTS, {}, HIGHEST),
        ("the same, with the noisy lines above 400 rad/s", EFFECTS, {}, 2000.0),
    )
    for label, effects, settings, highest in cases:
        own = data(highest)
        spec = own.model
        assert spec is not None
        own = replace(own, model=replace(spec, constants=spec.constants | settings))
        fit = jaxid.fit(
            None, own, effects=effects, fitter=jaxid.fitters.LevenbergMarquardt(restarts=8)
        )
        found = {k: p.value for k, p in fit.parameters.items()}
        found |= {f"{e.effect}.{k}": p.value for e in fit.effects for k, p in e.parameters.items()}
        rows.append(
            {
                "model": label,
                **{f"error {k}": v for k, v in errors(fit, own, dataset, effects).items()},
                **found,
            }
        )
    return {
        "title": "Flexible link: a measured frequency response",
        "text": f"{about} Errors are medians of |model - data| / |data| over the lines up to "
        f"400 rad/s; {DAYS[0]} is fitted. Units of the parameters as in `jaxid models flexible_link`, on the assumed drive of "
        f"{DRIVE} N m per volt.",
        "rows": rows,
    }


if __name__ == "__main__":
    for row in main()["rows"]:
        print(row)
