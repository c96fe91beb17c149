"""Blind cases: recordings with one withheld effect, several, one of no library, or none; diagnosed, then scored.

The diagnosis sees recordings and the nominal model; the key (effect, location, strength) stays here and is compared afterwards.
Recordings come from benchmarks/twins.py, which shares no code with the product; excitation, nominal parameters, joint and
strength vary from case to case.

    python benchmarks/blind.py [--models joint,pendulum] [--seed N] [--only effect,weak,control,outsider,pair] [--share 0.5]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import zlib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.twins import NEUTRAL, Plant, PLANTS, recorded  # noqa: E402
from jaxid.runtime import prepare  # noqa: E402


prepare()

from jaxid import catalogue  # noqa: E402
from jaxid.api import diagnose  # noqa: E402
from jaxid.chain import Chain  # noqa: E402
from jaxid.equivalence import equivalences  # noqa: E402
from jaxid.experiment import Dataset  # noqa: E402


SECONDS = {"flexible_link": 4.0}
SPLITS = ("fit", "fit", "validation", "report")
RESULTS = Path(__file__).with_name("results") / "blind.jsonl"


def medium(plant: Plant, j: int, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """effect -> numbers of the twin at medium strength, at joint j; what has no strength (speeds, widths, orders) is a tuple."""
    T, V, J = plant.torque[j], plant.speed[j], plant.inertia[j]
    U = 1.0 if plant.model == "servo" else T  # size of a command
    any_of: Any = lambda a, b: (rng.uniform(a, b),)
    out: dict[str, Any] = {
        "dead_zone": {"dead_zone": 0.08 * U}, "saturation": {"limit": 0.35 * U}, "supply_droop": {"droop": 0.15 / U},
        "torque_scale": {"scale": 0.1}, "actuator_lag": {"lag": 0.015}, "input_delay": {"delay": 0.008},
        "input_hold": {"linear": (1.0,)}, "back_emf": {"back_emf": 0.1 * T / V},
        "torque_ripple": {"ripple": 0.08 * T, "ripple_order": any_of(5.0, 12.0)}, "coulomb_friction": {"coulomb": 0.08 * T},
        "asymmetric_friction": {"dry_asymmetry": 0.05 * T, "viscous_asymmetry": 0.03 * T / V},
        "stribeck_friction": {"stribeck": 0.12 * T, "stribeck_speed": any_of(0.04 * V, 0.1 * V)},
        "load_dependent_friction": {"load": 0.12}, "quadratic_drag": {"drag": 0.15 * T / V**2},
        "power_law_friction": {"power": 0.1 * T / np.sqrt(V), "exponent": any_of(0.4, 0.6)},
        "lugre_friction": {"lugre": 0.12 * T, "presliding": any_of(0.03, 0.08)},
        "position_dependent_friction": {"uneven": 0.05 * T, "uneven_order": any_of(2.0, 5.0)},
        "temperature_dependent_friction": {"warm": 0.3 * T / V**3, "warm_time": any_of(1.5, 3.0)},
        "coupled_friction": {"shared_viscous": 0.1 * T / V, "shared_dry": 0.03 * T, "shared_speed": (0.05 * V,)},
        "backlash": {"play": 0.03, "motor_share": (0.4,), "compliance": (0.02 / T,)},
        "joint_elasticity": {"compliance": 0.03 / T, "motor_share": any_of(0.3, 0.5), "spring_damping": (0.1,)},
        "hysteresis": {"loop": 0.1 * T, "loop_width": any_of(0.05, 0.15)}, "payload": {"payload": 0.3 * J / 0.1},
        "constant_torque": {"offset": 0.06 * T}, "gravity_offset": {"tilt": 0.05}, "spring_torque": {"spring": 0.2 * T},
        "reflected_inertia": {"reflected": 0.2 * J},
        "flexible_mode": {"swing": 0.25 * J, "swing_frequency": any_of(3.0, 8.0), "swing_damping": (0.05,)},
        "sensor_bias": {"bias": 0.03}, "sensor_scale": {"gain_error": 0.05}, "sensor_lag": {"sensor_lag": 0.012},
        "sensor_delay": {"sensor_delay": 0.009}, "timestamp_jitter": {"jitter": 0.003},
    }  # fmt: skip
    out["viscous_friction"] = {"viscous": plant.nominal["viscous"][min(j, len(plant.nominal["viscous"]) - 1)]}
    if "coulomb" in plant.nominal:
        out["coulomb_friction"] = {"coulomb": plant.nominal["coulomb"][j]}
    if "offset" in plant.nominal:
        out["constant_torque"] = {"offset": 5 * plant.nominal["offset"][j]}
    if plant.model == "flexible_link":  # a motor behind a spring is not in its twin
        del out["backlash"], out["joint_elasticity"]
    return out


def outsiders(plant: Plant, j: int, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """What no effect of the library is."""
    T, V, end = plant.torque[j], plant.speed[j], SECONDS.get(plant.model, 8.0)
    found = {
        "a periodic torque from outside": {"outside": 0.08 * T, "outside_hz": rng.uniform(0.6, 2.0)},
        "a push of 0.6 s": {"outside": 0.3 * T, "outside_hz": 0.01, "outside_from": 0.4 * end, "outside_until": 0.4 * end + 0.6},
        "damping that depends on position": {"bent_damping": 0.25 * T / V},
        "damping that changes at half time": {"later_damping": 0.2 * T / V, "outside_from": end / 2},
    }
    if plant.n > 1:
        found["a torque that follows the other joint"] = {"other_joint": 0.2 * T}
    return found


def commands(plant: Plant, rng: np.random.Generator, runs: int) -> np.ndarray:
    """A multisine with steps and rests for each input, [runs samples nu]."""
    count = int(plant.rate * SECONDS.get(plant.model, 8.0))
    t = np.arange(count) / plant.rate
    u = np.zeros((runs, count, plant.n))
    for r in range(runs):
        for j in range(plant.n):
            reach = 1.2 if plant.model == "servo" else plant.torque[j]
            lines, base = rng.integers(5, 10), rng.uniform(0.15, 0.4)
            for k in range(1, lines + 1):
                f = k * base * rng.uniform(0.7, 1.3)
                u[r, :, j] += reach * np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) / np.sqrt(lines)
            for _ in range(4):
                a = rng.integers(0, count - count // 8)
                part = slice(a, a + rng.integers(count // 40, count // 10))
                u[r, part, j] = rng.uniform(-reach, reach) if rng.uniform() < 0.6 else 0.0
            if plant.model in ("joint", "flexible_link"):  # nothing holds them: keep them from running away
                u[r, :, j] -= u[r, :, j].mean()
    return u


def plan(model: str, seed: int, kinds: tuple[str, ...]) -> list[dict[str, Any]]:
    """The cases of a model: what is in the twin, and the key."""
    plant = PLANTS[model]
    chain = Chain(catalogue.model_class(model)())
    names = [n for n in catalogue.effect_names() if chain.offers(catalogue.effect_class(n)) or n in chain.contents]
    cases: list[dict[str, Any]] = []

    def add(kind: str, effects: list[str], strength: float, rng: np.random.Generator, own=None) -> None:
        numbers: dict[str, np.ndarray] = {}
        for k, x in plant.nominal.items():
            numbers[k] = np.array(x) * rng.uniform(0.88, 1.12, len(x))
        key, without = [], []
        for e in effects:
            j = int(rng.integers(plant.n))
            if e in ("gravity_offset", "coupled_friction"):
                j = 0
            if e == "payload" and model == "tracker":
                j = 1
            found = own(j) if own else medium(plant, j, rng)[e]
            size = strength * rng.uniform(0.7, 1.4) * (1 if own else rng.choice([-1, 1]) if e in EITHER else 1)
            for k, x in found.items():
                value = np.array(numbers.get(k, np.full(plant.n, float(NEUTRAL[k]))), float)
                if e == "saturation":
                    value[j] = x * (0.6 + 0.4 * rng.uniform()) if strength >= 1 else x * 1.7
                elif isinstance(x, tuple):
                    value[j] = x[0]
                elif own and k in ("outside_hz", "outside_from", "outside_until"):
                    value[j] = x
                elif e not in BUILTIN or k not in plant.nominal:
                    value[j] = x * size
                numbers[k] = value
            builtin = e in chain.contents
            without += [e] if builtin else []
            if builtin and e in BUILTIN:  # taken out of the model at every joint, so that only this one has it
                numbers |= {k: numbers[k] * (np.arange(plant.n) == j) for k in found}
            if builtin and e == "constant_torque":
                numbers["offset"] = numbers["offset"] * 4
            location = chain.signature.inputs[j][0] if e in AT_INPUT else chain.signature.joints[j]
            if e in AT_OUTPUT:
                location = chain.signature.outputs[j][0]
            key.append((e, location))
        cases.append({"model": model, "kind": kind, "effects": key, "numbers": numbers, "without": without, "strength": strength})

    alone = [
        n for n in names if n in medium(plant, 0, np.random.default_rng(0)) and not (plant.n == 1 and n == "coupled_friction")
    ]
    # A seed of its own for every case, so that a part of the plan is the same as in the whole.
    own_seed = lambda *words: np.random.default_rng([seed, zlib.crc32(" ".join((model, *words)).encode())])
    if "effect" in kinds:
        for e in alone:
            add("effect", [e], 1.0, own_seed("effect", e))
    if "weak" in kinds:
        for e in alone:
            if e not in BUILTIN and e not in ("input_hold", "timestamp_jitter"):
                add("weak", [e], 0.2, own_seed("weak", e))
    if "control" in kinds:
        for k in range(25):
            add("control", [], 1.0, own_seed("control", str(k)))
    if "outsider" in kinds:
        for k in range(25):
            rng = own_seed("outsider", str(k))
            name = rng.choice(list(outsiders(plant, 0, rng)))
            add("outsider", [name], 1.0, rng, own=lambda j, name=name, rng=rng: outsiders(plant, j, rng)[name])
    if "pair" in kinds:
        for k in range(10):
            rng = own_seed("pair", str(k))
            pair = [str(x) for x in rng.choice([e for e in alone if e not in BUILTIN], 2, replace=False)]
            add("pair", pair, 1.0, rng)
    return cases


EITHER = ("asymmetric_friction", "torque_ripple", "constant_torque", "gravity_offset", "sensor_bias", "sensor_scale",
          "position_dependent_friction", "torque_scale")  # fmt: skip
BUILTIN = ("viscous_friction", "coulomb_friction")
AT_INPUT = ("dead_zone", "saturation", "supply_droop", "torque_scale", "actuator_lag", "input_delay", "input_hold", "back_emf")
AT_OUTPUT = ("sensor_bias", "sensor_scale", "sensor_lag", "sensor_delay", "timestamp_jitter")


def recordings(cases: list[dict[str, Any]], seed: int) -> list[Dataset]:
    """The datasets of one model's cases, integrated side by side."""
    plant = PLANTS[cases[0]["model"]]
    rng = np.random.default_rng([seed, 1, zlib.crc32(plant.model.encode())])
    u = np.concatenate([commands(plant, rng, len(SPLITS)) for _ in cases])
    keys = dict.fromkeys(k for c in cases for k in (*c["numbers"], *NEUTRAL))
    width = plant.n
    column = lambda c, k: np.broadcast_to(np.asarray(c["numbers"].get(k, NEUTRAL.get(k, 0.0)), float), (width,))
    numbers = {k: np.repeat(np.array([column(c, k) for c in cases]), len(SPLITS), 0) for k in keys}
    y = recorded(plant, u, numbers, rng)
    t = np.arange(u.shape[1]) / plant.rate
    out = []
    for k in range(len(cases)):
        own = range(k * len(SPLITS), (k + 1) * len(SPLITS))
        out.append(
            Dataset.from_arrays(
                [t] * len(SPLITS),
                inputs={n: [u[r, :, i] for r in own] for i, (n, _) in enumerate(plant.inputs)},
                outputs={n: [y[r, :, i] for r in own] for i, (n, _) in enumerate(plant.outputs)},
                units=dict((*plant.inputs, *plant.outputs)),
                split=list(SPLITS),
                at_rest=True,
                noise_std={n: plant.noise if i < plant.n else 0.05 for i, (n, _) in enumerate(plant.outputs)},
                resolution={n: plant.resolution for n, _ in plant.outputs[: plant.n]},
                model=plant.model,
            )
        )
    return out


@cache
def classes(model: str, without: tuple[str, ...]) -> tuple[list[set[str]], set[str]]:
    """Effects that are exactly equivalent on a model (names; by the joint where they act), and those it absorbs."""
    found = equivalences(model, without)
    groups = [{str(p) for p in c} for c in found.classes]
    return groups, {str(p) for p in (*found.absorbed, *found.invisible)}


def score(case: dict[str, Any], diagnosis: Any, groups: list[set[str]], absorbed: set[str]) -> dict[str, Any]:
    """What was claimed against the key."""
    named = [(e.effect, e.location) for e in diagnosis.which.effects]
    mates = [(e.effect, e.location) for e in diagnosis.which.confusable_with]
    text = lambda p: f"{p[0]} at {p[1]}"
    alike = lambda p: next((g for g in groups if text(p) in g), {text(p)})
    truth = [p for p in case["effects"] if text(p) not in absorbed] if case["kind"] != "outsider" else []
    hit = [p for p in truth if alike(p) & {text(x) for x in named}]
    covered = [p for p in truth if alike(p) & {text(x) for x in (*named, *mates)}]
    return {
        "truth": [text(p) for p in truth],
        "named": [text(p) for p in named],
        "mates": [text(p) for p in mates],
        "verdict": diagnosis.which.verdict,
        "right": len(hit) == len(truth) == len(named),
        "in_set": len(covered) == len(truth) if truth else not named,
        "wrong": bool(named) and bool(truth) and not covered,
        "extra": len(named) > len(truth),
        "place": len(truth) == 1 and len(named) == 1 and named[0][1] == truth[0][1],
        "gap": diagnosis.how_far.gap_retuned,
        "after": diagnosis.how_far.gap_after,
        "shrinkage": diagnosis.how_far.shrinkage,
    }


def run(
    models: tuple[str, ...] = tuple(PLANTS),
    seed: int = 0,
    kinds: tuple[str, ...] = ("effect", "control"),
    share: float = 1.0,
    store: Path | None = None,
) -> list[dict[str, Any]]:
    """Runs what is not yet in `store`, and returns the rows of these cases."""
    done = {}
    if store and store.exists():
        for line in store.read_text().splitlines():
            row = json.loads(line)
            done[row["model"], row["kind"], row["case"], row["seed"]] = row
    rows = []
    for model in models:
        cases = plan(model, seed, kinds)
        keep = [k for k in range(len(cases)) if (k * 0.6180339887) % 1 < share]
        data = recordings(cases, seed)
        for k in keep:
            case = cases[k]
            label = " + ".join(f"{e} at {p}" for e, p in case["effects"]) or "nothing"
            if case["kind"] in ("control", "outsider"):  # several of a kind
                label += f", {k}"
            key = (model, case["kind"], label, seed)
            if key not in done:
                groups = classes(model, tuple(case["without"]))
                began = time.process_time()
                d = diagnose(model, data[k], without=case["without"], seed=0)
                row = {"model": model, "kind": case["kind"], "case": label, "seed": seed, **score(case, d, *groups),
                       "cpu_s": time.process_time() - began}  # fmt: skip
                done[key] = row
                if store:
                    store.parent.mkdir(exist_ok=True)
                    with store.open("a") as f:
                        f.write(json.dumps(row, default=float) + "\n")
                mark = "ok " if row["right"] else "set" if row["in_set"] else "---"
                gap = f"gap {row['gap']:.3g} -> {row['after']:.3g} {row['cpu_s']:.0f} s"
                print(mark, model, case["kind"], f"{label}:", row["verdict"], row["named"], "~", row["mates"], gap, flush=True)
            rows.append(done[key])
    return rows


def main() -> dict[str, Any]:
    """The table of what was run so far (`python benchmarks/blind.py` runs cases, hours of them)."""
    lines = RESULTS.read_text().splitlines() if RESULTS.exists() else []
    rows = [json.loads(line) for line in lines]
    single = [r for r in rows if r["kind"] == "effect" and len(r["truth"]) == len(r["named"]) == 1]
    alone, placed = len(single), sum(r["named"][0].split(" at ")[1] == r["truth"][0].split(" at ")[1] for r in single)
    of = {kind: [r for r in rows if r["kind"] == kind] for kind in ("control", "outsider", "pair")}
    controls, outsiders, pairs = (len(part) for part in of.values())
    blamed, both = sum(bool(r["named"]) for r in of["control"]), sum(bool(r["right"]) for r in of["pair"])
    named, partly = (sum(r["verdict"] == v for r in of["outsider"]) for v in ("named", "partly"))
    text = (
        "Recordings of separately written twins (benchmarks/twins.py); the key was read afterwards. The search was tuned on "
        "seeds 1, 3 and 20 to 23 and on two real recordings; each row is of the seed that stands in it, run once with the rules "
        "as they were. Those of seed 25 and the planar arm's pairs and controls are of the rules as they are, but for one: of "
        "several effects, as many as are allowed are `partly` now if they leave 1.5 times the noise, which the outsider of the "
        "flexible link that got a name did. The other rows were run before pairs were searched as widely, those of seeds 6 and "
        "16 with still earlier rules. The planar arm swings freely and over the top; its outsiders and weak effects were "
        "not run, nor the servo's weak ones. "
        "`right`: exactly the withheld effects, or equals of them on that model, were named; `in set`: they are among those "
        "named or reported as not to be told apart; `wrong`: a name outside the set. Effects that a model's parameters "
        "absorb count as `nothing missing`; torque_scale and flexible_mode of the tracker are absorbed to within the noise "
        "and count as missed, and so does what is too weak to show at a fifth of its strength. Of single effects named alone "
        f"{placed} of {alone} have the right place; of {controls} models that lack nothing {blamed} got a name. Of "
        f"{outsiders} with an effect of no library {named} got a name and {partly} were `partly` explained by one that comes "
        f"close (damping that depends on position as friction that does). Of {pairs} pairs both effects were named in "
        f"{both}."
    )
    return {"title": "Blind cases", "rows": summary(rows), "text": text}


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    out = []
    words = {"effect": "one effect, medium", "weak": "one effect, a fifth of it", "control": "nothing missing",
             "outsider": "an effect of no library", "pair": "two effects"}  # fmt: skip
    for model in dict.fromkeys(r["model"] for r in rows):
        for kind, label in words.items():
            part = [r for r in rows if r["model"] == model and r["kind"] == kind]
            if not part:
                continue
            count = lambda key, part=part: f"{sum(bool(r[key]) for r in part)} of {len(part)}"
            shares = [r["shrinkage"] for r in part if r["shrinkage"] is not None]
            missed = [f"{r['case']}: {r['verdict']} {' + '.join(r['named'])}" for r in part if not r["right"]]
            if kind == "outsider":
                said = lambda verdict, part=part: sum(r["verdict"] == verdict for r in part)
                named = f"of {len(part)}: {said('named')} named, {said('partly')} partly, {said('unknown')} unknown"
                row = {"right": named, "in set": "", "wrong": ""}
            else:
                row = {"right": count("right"), "in set": count("in_set"), "wrong": count("wrong")}
            out.append(
                {"model": model, "cases": label, "seed": ", ".join(sorted({str(r["seed"]) for r in part})), **row,
                 "shrinkage, median": round(float(np.median(shares)), 3) if shares else "",
                 "CPU s a case, median": round(float(np.median([r["cpu_s"] for r in part])), 1),
                 "not right": "; ".join(missed) if kind != "outsider" else ""}
            )  # fmt: skip
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", default=",".join(PLANTS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="effect,control")
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--store", type=Path, default=RESULTS)
    o = parser.parse_args()
    run(tuple(o.models.split(",")), o.seed, tuple(o.only.split(",")), o.share, o.store)
