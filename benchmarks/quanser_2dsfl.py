"""A stage with a flexible beam (Quanser 2-DOF serial flexible link): does the diagnosis name the
dry friction that the maker's model lacks?

The maker models a stage as a motor behind a gear, viscous friction, a torsional spring and a load.
The diagnosis gets this model, recorded motor current as input, hub angle and beam angle (strain
gauge) as outputs: 14 s under one controller are fitted, 14 s under another judge, the rest reports.
Written here as a user would write a model.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

import jaxid
from jaxid.data.dataset import Channel, Dataset, Experiment, ModelSpec
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import constant, param
from jaxid.models.effects import ViscousFriction


class FlexibleStage(Rigid):
    """Hub and beam of one stage; the beam is a load on a torsional spring."""

    name: ClassVar[str] = "flexible_stage"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("current", "A"),), (("hub", "rad"), ("beam", "rad")), ("hub", "beam")),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "B_{joint}"}),
    )
    equations: ClassVar[str] = (
        "(J_hub + J_load) hub'' + J_load beam'' + B_hub hub' = gear k_t current\\n"
        "J_load (hub'' + beam'') + stiffness beam + B_beam beam' = 0"
    )
    source: ClassVar[str] = "the maker's model of a stage"

    J_hub: Array = param(0.3, 1e-3, 10.0, unit="kg m^2", log=True)
    J_load: Array = param(0.15, 1e-3, 10.0, unit="kg m^2", log=True)
    stiffness: Array = param(30.0, 0.5, 200.0, unit="N m/rad", log=True)
    gear: Array = constant(100.0, unit="1")
    k_t: Array = constant(0.119, unit="N m/A")

    def drive(self, signature, u, q, qd):
        return jnp.stack([self.gear * self.k_t * u[0], 0.0 * u[0]])

    def matrices(self, q, qd):
        both = self.J_hub + self.J_load
        M = jnp.stack([jnp.stack([both, self.J_load]), jnp.stack([self.J_load, self.J_load])])
        return M, jnp.stack([0.0 * q[0], self.stiffness * q[1]])


def dataset() -> Dataset:
    import pandas as pd

    root = Path(
        os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
    )
    if not (root / "quanser_2dsfl").is_dir():
        raise FileNotFoundError("quanser_2dsfl is not there; set JAXID_DATA")
    runs = []
    for name, split, stop in (
        ("psf", "fit", 7000),
        ("fsf", "validation", 7000),
        ("psf", "report", None),
    ):
        d = pd.read_parquet(root / "quanser_2dsfl" / f"manual_{name}.parquet")
        d = d.iloc[:stop] if stop else d.iloc[7000:]
        y = np.deg2rad(d[["th11_deg", "th12_deg"]].to_numpy())
        runs.append(
            Experiment(f"{name} {split}", split, d.t.to_numpy(), d[["I1_meas_A"]].to_numpy(), y)
        )
    channels = (
        Channel("current", "input", "A"),
        Channel("hub", "output", "rad", noise_std=1e-3),
        Channel("beam", "output", "rad", noise_std=3e-4),
    )
    return Dataset("quanser_2dsfl", channels, tuple(runs), model=ModelSpec("flexible_stage"))


#: The maker's figures of the first stage: the spring by theory and by an older test, viscous
#: friction of the hub.
MAKER = {"stiffness": "40.0 (theory), 27.0 (older test)", "B_hub": "4.0", "B_beam": "0"}


def main() -> dict[str, Any]:
    d = jaxid.diagnose(FlexibleStage(), dataset())
    rows: list[dict[str, Any]] = [
        {
            "what": "verdict",
            "measured": f"{d.which.verdict}: {', '.join(map(str, d.which.effects)) or 'nothing named'}",
        },
        {
            "what": "cannot be told apart from it",
            "measured": ", ".join(map(str, d.which.confusable_with)) or "nothing",
        },
    ]
    for split in ("fit", "validation", "report"):
        for channel in ("hub", "beam"):
            before, after = (1e3 * f.scores[split][channel].rmse for f in (d.nominal, d.final))
            rows.append(
                {
                    "what": f"free run, {split}, {channel}",
                    "measured": f"{before:.3g} mrad, then {after:.3g} mrad",
                }
            )
    for name, p in d.final.parameters.items():
        rows.append(
            {
                "what": name,
                "measured": f"{p.value:.4g} ± {p.std or 0:.2g} {p.unit}",
                "maker": MAKER.get(name, ""),
            }
        )
    for e in d.final.effects:
        for name, p in e.parameters.items():
            rows.append(
                {
                    "what": f"{e.effect}.{name} at {e.location}",
                    "measured": f"{p.value:.4g} ± {p.std or 0:.2g} {p.unit}",
                }
            )
    return {
        "title": "Real recording of a flexible stage (Quanser): its hub's dry friction",
        "text": " ".join((__doc__ or "").split()),
        "rows": rows,
    }


if __name__ == "__main__":
    from jaxid.runtime import prepare

    prepare()
    print(*main()["rows"], sep="\n")
