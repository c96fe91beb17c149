"""A flexible robot arm of the DaISy collection: torque of the structure on the ground to
acceleration of the arm.

Neither units nor the sample rate are documented, so the unit of time is the sample and the channels
are numbers. The input is one period of a sweep and the record is periodic: its transform gives the
response line by line, nothing leaks. What is judged is the free run over the record, not one step
ahead (which pure autoregression predicts to 5e-7 of the square and proves nothing by).
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

import jaxid
from jaxid.data.dataset import Channel, Dataset, Experiment, FrequencyResponse, ModelSpec
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import param


class TwoModes(Rigid):
    """Two vibration modes that one torque drives and one accelerometer sees, with a direct way
    between them.
    """

    name: ClassVar[str] = "two_modes"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("torque", "1"),), (("acceleration", "1"),), ("first", "second"), linear=True),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = ()
    equations: ClassVar[str] = (
        "q_i'' + 2 zeta_i w_i q_i' + w_i^2 q_i = torque;  acceleration = r_1 q_1'' + r_2 q_2'' + direct torque"
    )
    source: ClassVar[str] = "textbook: modal coordinates"

    w_1: Array = param(0.37, 0.05, 0.55, unit="rad/s", log=True)
    w_2: Array = param(0.78, 0.55, 1.5, unit="rad/s", log=True)
    zeta_1: Array = param(0.05, 1e-4, 0.5, unit="1", log=True)
    zeta_2: Array = param(0.02, 1e-4, 0.5, unit="1", log=True)
    r_1: Array = param(0.1, -10.0, 10.0, unit="1")
    r_2: Array = param(-0.1, -10.0, 10.0, unit="1")
    direct: Array = param(0.0, -10.0, 10.0, unit="1")

    def drive(self, signature, u, q, qd):
        return jnp.concatenate([u, u])

    def matrices(self, q, qd):
        w, zeta = jnp.stack([self.w_1, self.w_2]), jnp.stack([self.zeta_1, self.zeta_2])
        return jnp.eye(2), 2 * zeta * w * qd + w * w * q

    def output(self, x, tau, rests):
        qdd = self.vector_field(0.0, x, tau)[1]
        return (self.r_1 * qdd[0] + self.r_2 * qdd[1] + self.direct * tau[0])[None]


def record() -> tuple[np.ndarray, np.ndarray]:
    import pandas as pd

    root = Path(
        os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
    )
    if not (root / "daisy_robot_arm").is_dir():
        raise FileNotFoundError("daisy_robot_arm is not there; set JAXID_DATA")
    d = pd.read_parquet(root / "daisy_robot_arm" / "robot_arm.parquet")
    return d.u.to_numpy(float), d.y.to_numpy(float)


def dataset(u: np.ndarray, y: np.ndarray) -> tuple[Dataset, np.ndarray]:
    """Lines that the sweep excites, every second for the fit, and their numbers; weighted alike in
    absolute terms.
    """
    U, Y = np.fft.rfft(u), np.fft.rfft(y)
    lines = np.flatnonzero(np.abs(U) > 0.05 * np.abs(U).max())
    parts = {"fit": lines[::2], "report": lines[1::2]}
    responses = tuple(
        FrequencyResponse(
            split, split, 2 * np.pi * k / len(u), Y[k] / U[k], "torque", "acceleration"
        )
        for split, k in parts.items()
    )
    channels = (Channel("torque", "input", "1"), Channel("acceleration", "output", "1"))
    return Dataset("daisy", channels, (), responses, ModelSpec("two_modes")), lines


def main() -> dict:
    u, y = record()
    data, lines = dataset(u, y)
    fit = jaxid.fit(TwoModes(), data, fitter=jaxid.fitters.Hybrid())
    # From rest the first period is a transient; the second is compared.
    twice = Experiment(
        "twice",
        "report",
        np.arange(2.0 * len(u)),
        np.tile(u, 2)[:, None],
        np.tile(y, 2)[:, None],
        at_rest=True,
    )
    explained = {}
    for hold in ("zero", "linear"):
        channels = (replace(data.channels[0], hold=hold), data.channels[1])
        played = jaxid.simulate(
            TwoModes(), replace(data, channels=channels, experiments=(twice,), responses=()), fit
        )
        explained[hold] = 1 - np.var(played.runs[0]["acceleration"][len(u) :] - y) / np.var(y)
    rows = [
        {
            "what": "response at the lines between the fitted ones, relative error",
            "measured": f"{100 * fit.scores['report']['acceleration / torque'].relative_error:.3g} %",
        },
        *(
            {
                "what": f"free run, hold of the input between samples: {hold}",
                "measured": f"{100 * share:.1f} % of the variance explained",
            }
            for hold, share in explained.items()
        ),
        *(
            {"what": name, "measured": f"{p.value:.4g} ± {p.std:.2g} {p.unit}"}
            for name, p in fit.parameters.items()
        ),
    ]
    text = (
        f"{' '.join((__doc__ or '').split())} {len(lines)} lines (numbers {lines[0]} to {lines[-1]} of the transform of 1,024 "
        "samples), every second fitted; a linear model of two modes (four states), written in the benchmark as a user would."
    )
    return {
        "title": "Flexible robot arm (DaISy): vibration modes from a sweep",
        "text": text,
        "rows": rows,
    }


if __name__ == "__main__":
    print(*main()["rows"], sep="\n")
