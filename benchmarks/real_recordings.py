"""Diagnosis of real recordings: EMPS (a ball-screw drive) and a free pendulum on ball bearings.

Data: the folder named by JAXID_DATA (default `../shared/data` beside the repository); they are not
part of the repository.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import jaxid
from jaxid.diagnosis.probability import RULE


DATA = Path(os.environ.get("JAXID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


def rows_of(name: str, channel: str, unit: float) -> list[dict[str, Any]]:
    """Nominal and diagnosed model: free-run error on each whole recording, started from its first
    samples.
    """
    folder = DATA / name
    if not folder.is_dir():
        raise FileNotFoundError(f"{name} is not in {DATA.name}; set JAXID_DATA")
    data = jaxid.load_dataset(folder)
    d = jaxid.diagnose(None, data)
    models = [("nominal, re-tuned", d.nominal)]
    if d.which.effects:
        models.append((" + ".join(map(str, d.which.effects)), d.final))
    elif d.which.belief and (possible := d.which.belief.possible(RULE.possible)):
        effect, _, probability = possible[0]
        fit = jaxid.fit(None, data, effects=[effect])
        models.append((f"with {effect}, the most probable ({probability:.2f})", fit))
    out = []
    for label, fit in models:
        rmse = [unit * run[channel] for run in jaxid.simulate(None, data, fit).rmse]
        out.append(
            {
                "recording": name,
                "model": label,
                "verdict": d.which.verdict,
                "fit split, free run": round(unit * fit.scores["fit"][channel].rmse, 3),
                "first recording": round(rmse[0], 3),
                "second recording": round(rmse[1], 3),
                "parameters": ", ".join(f"{k} {v.value:.4g}" for k, v in fit.parameters.items()),
            }
        )
    out.append(
        {
            "recording": name,
            "model": "ranking: "
            + "; ".join(f"{r.text.split(':')[0]} {r.validation_gap:.3g}" for r in d.which.ranking)
            + "; cannot be told apart: "
            + (", ".join(map(str, d.which.confusable_with)) or "nothing"),
            "verdict": "",
        }
    )
    return out


def main() -> dict[str, Any]:
    rows = rows_of("emps", "position", 1e3) + rows_of("multiarm_single_pendulum", "q", 1e3)
    text = (
        "Errors in mm (EMPS) and mrad (pendulum). `fit split`: the fitted run with its fitted start; the recordings: free run of "
        "the whole, start estimated from its first 0.1 s. In the ranking, the gap on validation data in multiples of the noise."
    )
    return {"title": "Real recordings: what the nominal model lacks", "rows": rows, "text": text}


if __name__ == "__main__":
    from jaxid.runtime import prepare

    prepare()
    for row in main()["rows"]:
        print(row)
