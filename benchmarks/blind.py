"""A first blind check of the diagnosis: one withheld effect per case, data from separately written equations (SciPy).

The diagnosis sees recordings and the nominal model; the key (effect, location, strength) stays in this script and is compared
afterwards. Every effect of the library on `pendulum` and `joint`, at medium strength and at a fifth of it, and controls.

    python benchmarks/blind.py [--seeds N] [--first S]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

from jaxid.api import diagnose  # noqa: E402
from jaxid.experiment import Dataset  # noqa: E402
from tests.reference import measured, multisine, PLANTS, simulate, Truth  # noqa: E402


RATE, SECONDS, NOISE, RESOLUTION = 200, 8.0, 3e-4, 2 * np.pi / 2**14

#: effect -> Truth fields at medium strength, in units of peak torque 1 N m, speed about 4 rad/s.
MEDIUM: dict[str, dict[str, float]] = {
    "dead_zone": {"dead_zone": 0.08},
    "asymmetric_friction": {"dry_asymmetry": 0.03, "viscous_asymmetry": 0.008},
    "stribeck_friction": {"stribeck": 0.08, "stribeck_speed": 0.25},
    "load_dependent_friction": {"load": 0.12},
    "quadratic_drag": {"drag": 0.006},
    "input_delay": {"delay": 0.006},
    "input_hold": {"other_hold": 1.0},
}
#: nominal terms that are taken out of the model in some cases, so that they are what is missing
BUILTIN: dict[str, dict[str, float]] = {"coulomb_friction": {}, "viscous_friction": {}, "constant_torque": {}}


def recording(model: str, truth: Truth, plant: Any, seed: int, split: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    t = np.arange(int(RATE * SECONDS)) / RATE
    reach = 0.45 if model == "pendulum" else 1.0  # a pendulum driven over the top is chaotic: no residual can rank anything
    u = multisine(t, [reach], seed=seed, periods=rng.uniform(1.5, 3), lines=8)
    for _ in range(4):  # steps and rests
        a = rng.integers(0, len(t) - 200)
        u[a : a + rng.integers(40, 160)] = rng.uniform(-reach, reach) if rng.uniform() < 0.6 else 0.0
    if model == "joint":  # nothing holds a joint: keep it from running away
        u -= u.mean(0)
    q, _ = simulate(plant, truth, t, u, rtol=1e-8, atol=1e-11)
    return t, u, measured(q, NOISE, seed + 1, RESOLUTION)


def dataset(model: str, truth: Truth, plant: Any, seed: int, without: tuple[str, ...]) -> Dataset:
    runs = [recording(model, truth, plant, 1000 * seed + k, s) for k, s in enumerate(SPLITS)]
    return Dataset.from_arrays(
        [r[0] for r in runs],
        inputs={"tau": [r[1][:, 0] for r in runs]},
        outputs={"q": [r[2][:, 0] for r in runs]},
        units={"tau": "N m", "q": "rad"},
        split=list(SPLITS),
        at_rest=True,
        noise_std={"q": NOISE},
        resolution={"q": RESOLUTION},
        model=model,
    )


SPLITS = ("fit", "fit", "validation", "report")


def case(model: str, effect: str | None, strength: float, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    vary = lambda: float(rng.uniform(0.85, 1.15))
    nominal = {"viscous": 0.03 * vary(), "coulomb": 0.04 * vary(), "offset": 0.01 * vary()}
    extra = {k: v * (strength if k not in ("stribeck_speed",) else 1.0) for k, v in MEDIUM.get(effect or "", {}).items()}
    if effect == "input_hold":
        extra = {"other_hold": 1.0}
    without = (effect,) if effect in BUILTIN else ()
    plant = PLANTS[model](
        **({"inertia": 0.06 * vary(), "gravity_torque": 0.9 * vary()} if model == "pendulum" else {"inertia": 0.06 * vary()})
    )
    data = dataset(model, Truth(**{**nominal, **extra}), plant, seed, without)
    began = time.perf_counter()
    d = diagnose(model, data, without=without, seed=0)
    names = [e.effect for e in d.which.effects]
    mates = [e.effect for e in d.which.confusable_with]
    if effect is None:
        right = not names
    else:
        right = names[:1] == [effect] and len(names) == 1
    return {
        "model": model, "effect": effect or "none", "strength": strength, "verdict": d.which.verdict, "named": names,
        "mates": mates, "right": right, "in_set": effect in names + mates if effect else not names,
        "gap": d.how_far.gap_retuned, "after": d.how_far.gap_after, "shrinkage": d.how_far.shrinkage,
        "seconds": time.perf_counter() - began,
    }  # fmt: skip


def main(seeds: int = 1, first: int = 0, models: tuple[str, ...] = ("pendulum", "joint"), echo: bool = False) -> dict[str, Any]:
    rows = []
    for seed in range(first, first + seeds):
        for model in models:
            weak = [e for e in MEDIUM if e != "input_hold"]
            plan = [(e, 1.0) for e in (*MEDIUM, *BUILTIN)] + [(e, 0.2) for e in weak] + [(None, 1.0)] * 3
            for k, (effect, strength) in enumerate(plan):
                row = case(model, effect, strength, 100 * seed + k)
                rows.append(row)
                if echo:
                    print(*(f"{x:.4g}" if isinstance(x, float) else x for x in row.values()), flush=True)
    return {"title": "Blind check: one withheld effect", "rows": summary(rows), "text": (
        f"Separately written SciPy equations, {RATE} Hz, 4 runs of {SECONDS:g} s, noise {NOISE:g} rad and quantisation "
        f"{RESOLUTION:.2g} rad; seeds {first} to {first + seeds - 1}. `right`: that effect alone was named; `in set`: it is "
        "among those named or reported as not to be told apart; `extra`: an effect beside it was named. The thresholds were "
        "looked at on seed 0."
    )}  # fmt: skip


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    out = []
    for model in dict.fromkeys(r["model"] for r in rows):
        for label, keep in (
            ("medium strength", lambda r: r["effect"] != "none" and r["strength"] == 1.0),
            ("a fifth of it", lambda r: r["effect"] != "none" and r["strength"] < 1.0),
            ("nothing missing", lambda r: r["effect"] == "none"),
        ):
            part = [r for r in rows if r["model"] == model and keep(r)]
            out.append(
                {
                    "model": model,
                    "cases": f"{label}: {len(part)}",
                    "right": sum(r["right"] for r in part),
                    "in set": sum(r["in_set"] for r in part),
                    "extra": sum(len(r["named"]) > 1 for r in part),
                    "not right": "; ".join(
                        f"{r['effect']}: {r['verdict']} {'+'.join(r['named'])}" for r in part if not r["right"]
                    ),
                    "s per case": round(float(np.median([r["seconds"] for r in part])), 1) if part else None,
                }
            )
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--models", default="pendulum,joint")
    options = parser.parse_args()
    for line in main(options.seeds, options.first, tuple(options.models.split(",")), echo=True)["rows"]:
        print(line)
