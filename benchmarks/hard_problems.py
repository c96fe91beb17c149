"""Gradient against population on three hard problems: a joint that sticks and slips, backlash, and
the flexible link's response.

Every fitter gets the same compiled loss, the same random starts in the sampling box and at most
20,000 evaluations (a Jacobian counts one for each number and one more). A run succeeds within a
thousandth of the best known loss. The joints' recordings come from the blind cases' twins, the
link's from the paper study's: neither shares code with the product.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


sys.path[:0] = [
    str(Path(__file__).resolve().parents[1]),
    str(Path(__file__).resolve().parents[1] / "tests"),
]

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jaxid  # noqa: E402
from jaxid import fitters  # noqa: E402
from jaxid.benchmark.numpy_twin import recorded  # noqa: E402
from jaxid.benchmark.plants import PLANTS  # noqa: E402
from jaxid.data.dataset import Dataset  # noqa: E402
from jaxid.study.papers import flexible_link  # noqa: E402


BUDGET = 20_000


def joint(numbers: dict[str, float], reach: float) -> Dataset:
    """4 s of a joint under a slow multisine, from rest; the twin's own friction and these
    numbers.
    """
    plant, rng = PLANTS["joint"], np.random.default_rng(3)
    t = np.arange(int(4 * plant.rate)) / plant.rate
    u = (
        reach
        * sum(np.sin(2 * np.pi * f * t + p) for f, p in ((0.5, 0.2), (1.1, 1.3), (1.9, 2.9)))
        / np.sqrt(3)
    )
    values = {
        k: np.array([x])
        for k, x in {**plant.nominal, **{k: (v,) for k, v in numbers.items()}}.items()
    }
    y = recorded(plant, (u - u.mean())[None, :, None], values, rng)[0]
    return Dataset.from_arrays(
        t,
        {"tau": u - u.mean()},
        {"q": y[:, 0]},
        units={"tau": "N m", "q": "rad"},
        split="fit",
        initial={"q": 0.0, "qd": 0.0},
        noise_std={"q": plant.noise},
        resolution={"q": plant.resolution},
        model="joint",
    )


def problems() -> dict[str, tuple[Dataset, dict[str, Any]]]:
    T, V = PLANTS["joint"].torque[0], PLANTS["joint"].speed[0]
    stuck = joint({"stribeck": 0.25 * T, "stribeck_speed": 0.05 * V}, 0.9 * T)
    loose = joint({"play": 0.03, "motor_share": 0.4, "compliance": 0.02 / T}, T)
    return {
        "joint that sticks and slips": (stuck, {"effects": ["stribeck_friction"]}),
        "backlash": (loose, {"effects": ["backlash"]}),
        "flexible link, response and hub angle": (
            flexible_link.data(linear=False),
            {"residual": flexible_link.RESIDUAL, "loss": "sum_of_norms"},
        ),
    }


def whole(number: float) -> int | str:
    return round(number) if np.isfinite(number) else "not reached"


def study(seeds: int) -> list[dict]:
    rows = []
    for label, (data, settings) in problems().items():
        methods = {
            "LM, one start": fitters.LevenbergMarquardt(restarts=0),
            "LM, 16 starts": fitters.LevenbergMarquardt(restarts=15),
            "BFGS": fitters.BFGS(),
            "DE": fitters.DifferentialEvolution(generations=10**4),
            "SHADE": fitters.Shade(generations=10**4),
            "hybrid": fitters.Hybrid(),
        }
        c = jaxid.compare(
            None, data, fitters=methods.values(), seeds=seeds, budget=BUDGET, **settings
        )
        names = dict(zip(dict.fromkeys(r.fitter for r in c.runs), methods, strict=True))
        for s in c.table:
            low, high = s.success_interval_95
            rows.append(
                {
                    "problem": label,
                    "fitter": names[s.fitter],
                    "reached": f"{s.successes} of {s.runs} ({low:.0%} to {high:.0%})",
                    "evaluations to the target, median": whole(s.evaluations_to_target.median),
                    "evaluations of a success, failures counted": whole(s.expected_evaluations),
                    "loss, median / best": round(s.loss.median / c.best_loss, 4),
                    "s a run": round(s.seconds, 2),
                }
            )
    return rows


def main() -> dict:
    text = f"{(__doc__ or '').split(chr(10), 2)[2].strip()} 30 seeds."
    return {
        "title": "Gradient against population on hard problems",
        "text": text,
        "rows": study(30),
    }


if __name__ == "__main__":
    began = time.perf_counter()
    for row in study(int(sys.argv[1]) if len(sys.argv) > 1 else 3):
        print(row)
    print(round(time.perf_counter() - began, 1), "s")
