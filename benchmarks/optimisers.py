"""Whether the choice of an optimiser changes a diagnosis: the same candidates, fitted by gradients
and by populations under the same budget of free runs.

Rigs of the papers with gaps of their own (benchmarks/paper_gaps.py). Each candidate model, the
nominal one and that with one effect, is fitted to the fit runs by Levenberg-Marquardt, SHADE and
differential evolution, from the same start and within the same bounds. The diagnosis by an
optimiser is the candidate whose fit comes nearest on the validation run, of a loss in units of the
noise (1 is the noise). `margin` is the runner-up's loss over it.
The start is a member of each population: a loss that does not change with the budget is the start's.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np


sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jaxid  # noqa: E402
from benchmarks import paper_gaps  # noqa: E402
from jaxid.models import FlexibleLink, Joint  # noqa: E402


#: Free runs of all fit runs that each fit may take.
BUDGETS = (200, 2000, 20000)
FITTERS = {"gradients": "lm", "SHADE": "shade", "differential evolution": "de"}
#: Rig -> model, what makes its recording, what the model goes without, candidates.
RIGS: dict[str, tuple[Any, Any, tuple[str, ...], tuple[str, ...]]] = {
    "flexible link, the paper's pulse": (
        FlexibleLink(),
        paper_gaps.rubbing_link,
        ("coulomb_friction",),
        ("", "coulomb_friction", "quadratic_drag", "dead_zone", "input_delay"),
    ),
    "joint, friction with the square root of the speed": (
        Joint(),
        paper_gaps.joint,
        (),
        ("", "power_law_friction", "quadratic_drag", "stribeck_friction", "dead_zone"),
    ),
}


def loss(found: jaxid.Fit, data: jaxid.Dataset, split: str) -> float:
    """Mean square of the errors of a split over its channels, in units of their noise."""
    noise = {c.name: c.noise_std for c in data.outputs}
    parts = [(s.rmse / (noise[name] or 1.0)) ** 2 for name, s in found.scores[split].items()]
    return float(np.mean(parts))


def row(
    rig: str,
    model: Any,
    data: jaxid.Dataset,
    without: tuple[str, ...],
    candidates: Sequence[str],
    fitter: str,
    budget: int,
) -> dict[str, Any]:
    """What one optimiser names."""
    began = time.process_time()
    left: dict[str, float] = {}
    for name in candidates:
        effects = (name,) if name else ()
        bare = tuple(one for one in without if one != name)
        found = jaxid.fit(
            model,
            data,
            fitter=FITTERS[fitter],
            effects=effects if name not in without else (),
            without=bare,
            budget=budget,
            as_recorded=True,
        )
        left[name or "nothing"] = np.inf if found.failed else loss(found, data, "validation")
    order = sorted(left, key=lambda name: left[name])
    return {
        "rig": rig,
        "budget": budget,
        "optimiser": fitter,
        "names": order[0],
        "loss": round(left[order[0]], 3),
        "runner-up": order[1],
        "margin": round(left[order[1]] / left[order[0]], 2),
        "loss with nothing": round(left["nothing"], 3),
        "processor s": round(time.process_time() - began, 1),
    }


def main(rigs: Sequence[str] = tuple(RIGS)) -> dict[str, Any]:
    rows = []
    for rig in rigs:
        model, make, without, candidates = RIGS[rig]
        data = make()
        for budget in BUDGETS:
            for fitter in FITTERS:
                rows.append(row(rig, model, data, without, candidates, fitter, budget))
                print(rows[-1], flush=True)
    return told(rows)


def told(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What the rows say of the question."""
    about = (__doc__ or "").strip().replace("\n\n", "\n")
    named: dict[tuple[str, int], set[str]] = {}
    for one in rows:
        named.setdefault((one["rig"], one["budget"]), set()).add(one["names"])
    changed = [f"{rig} at {budget}" for (rig, budget), names in named.items() if len(names) > 1]
    said = f"The optimiser changes what is named in {len(changed)} of {len(named)}"
    text = f"{about}\n\n{said}{': ' + '; '.join(changed) if changed else ''}."
    return {"title": "Does the optimiser change the diagnosis?", "text": text, "rows": rows}


if __name__ == "__main__":
    main()
