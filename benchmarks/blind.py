"""Blind cases: recordings with one withheld effect, several, one of no library, or none; diagnosed,
then scored.

The diagnosis sees recordings and the nominal model; the key (effect, location, strength) lies in a
file of its own and is compared afterwards. `benchmarks/blind_cases.py` makes the cases,
`benchmarks/blind_summary.py` compares with what was asked.

    python benchmarks/blind.py [--models joint,pendulum] [--seed N] [--only effect,weak,control,outsider,pair] [--share 0.5]

or `make benchmark-blind`. Every set runs in a process of its own, and goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

from benchmarks.blind_cases import CONTROLS, KINDS, STRENGTH, write_set  # noqa: E402
from jaxid.api import diagnose, fit  # noqa: E402
from jaxid.base.serialise import save_json  # noqa: E402
from jaxid.benchmark.plants import PLANTS  # noqa: E402
from jaxid.benchmark.rigs import dataset  # noqa: E402
from jaxid.data.dataset import Dataset  # noqa: E402
from jaxid.data.io import load_dataset  # noqa: E402
from jaxid.diagnosis.budget import shrink  # noqa: E402
from jaxid.diagnosis.equivalence import equivalences  # noqa: E402
from jaxid.diagnosis.evidence import held_out  # noqa: E402
from jaxid.diagnosis.result import Diagnosis  # noqa: E402
from jaxid.dynamics import catalogue  # noqa: E402
from jaxid.fitting.problem_builder import ProblemBuilder  # noqa: E402
from jaxid.problem.binding import bind, resolve_model  # noqa: E402


RESULTS = Path(__file__).with_name("results") / "blind.jsonl"


def answer(folder: Path) -> tuple[Diagnosis, float]:
    """What the diagnosis says of a case, of which it gets no more than this folder; and the CPU
    seconds that it took.
    """
    question = json.loads((folder / "question.json").read_text())
    data = load_dataset(folder)
    began = time.process_time()
    found = diagnose(question["model"], data, without=question["without"], seed=0)
    spent = time.process_time() - began
    save_json(found, folder / "diagnosis.json")
    return found, spent


@cache
def classes(model: str, without: tuple[str, ...]) -> tuple[list[set[str]], set[str]]:
    """Effects that are exactly equivalent on a model (names; by the joint where they act), and
    those it absorbs.
    """
    found = equivalences(model, without)
    groups = [{str(p) for p in c} for c in found.classes]
    return groups, {str(p) for p in (*found.absorbed, *found.invisible)}


def score(
    case: dict[str, Any], diagnosis: Diagnosis, groups: list[set[str]], absorbed: set[str]
) -> dict[str, Any]:
    """What was claimed against the key."""
    named = [(e.effect, e.location) for e in diagnosis.which.effects]
    mates = [(e.effect, e.location) for e in diagnosis.which.confusable_with]

    def text(p):
        return f"{p[0]} at {p[1]}"

    def alike(p):
        return next((g for g in groups if text(p) in g), {text(p)})

    truth = (
        [p for p in case["effects"] if text(p) not in absorbed]
        if case["kind"] != "outsider"
        else []
    )
    hit = [p for p in truth if alike(p) & {text(x) for x in named}]
    covered = [p for p in truth if alike(p) & {text(x) for x in (*named, *mates)}]
    plain = [
        f"{r.effect} at {r.location}" for r in diagnosis.which.ranking if " beside " not in r.text
    ]
    return {
        "truth": [text(p) for p in truth],
        "named": [text(p) for p in named],
        "mates": [text(p) for p in mates],
        "verdict": diagnosis.which.verdict,
        "right": len(hit) == len(truth) == len(named),
        "in_set": len(covered) == len(truth) if truth else not named,
        "wrong": bool(named) and bool(truth) and not covered,
        "extra": len(named) > len(truth),
        "second": len(truth) == 1 and bool(alike(truth[0]) & set(plain[:2])),
        "place": len(truth) == 1 and len(named) == 1 and named[0][1] == truth[0][1],
        "gap": diagnosis.how_far.gap_retuned,
        "after": diagnosis.how_far.gap_after,
        "shrinkage": diagnosis.how_far.shrinkage,
        "interval": diagnosis.how_far.shrinkage_interval_95,
    }


def oracle(case: dict[str, Any], row: dict[str, Any], data: Dataset) -> float | None:
    """Shrinkage on report data where the fit is told what is missing, and where."""
    if not row["truth"] or row["gap"] <= 1:
        return None
    settings = {
        "effects": [t.replace(" at ", "@") for t in row["truth"]],
        "without": case["without"],
    }
    told = fit(case["model"], data, **settings)
    if told.failed:
        return None
    bench = ProblemBuilder(bind(case["model"], data, **settings))
    return shrink(row["gap"] ** 2, held_out(bench, "report", [told.theta])[0].gap ** 2)


def later(case: dict[str, Any], diagnosis: Diagnosis, u: np.ndarray, y: np.ndarray) -> list[float]:
    """Shrinkage in each of further runs of the same twin, of which the interval is to hold nineteen
    in twenty.
    """
    model = case["model"]
    data = dataset(PLANTS[model], u, y, ("fit", *["report"] * (len(u) - 1)))
    chain = resolve_model(model, data, case["without"])
    absent = [n for n in catalogue.effect_names() if n not in chain.contents]
    library = [k for n in absent if chain.offers(k := catalogue.effect_class(n))]
    bench = ProblemBuilder(bind(model, data, without=case["without"], candidates=library))
    before, after = held_out(bench, "report", [diagnosis.nominal.theta, diagnosis.final.theta])

    def square(r):
        return float(np.mean(r**2))

    return [
        shrink(square(b), square(a)) for b, a in zip(before.residual, after.residual, strict=True)
    ]


def run(model: str, seed: int, kind: str, share: float, store: Path, sets: Path) -> None:
    """Diagnoses and scores what is not yet in `store`."""
    done = set()
    if store.exists():
        for line in store.read_text().splitlines():
            row = json.loads(line)
            done.add((row["model"], row["kind"], row["case"], row["seed"]))
    store.parent.mkdir(exist_ok=True)
    place = write_set(model, seed, kind, sets)
    key, more = json.loads((place / "key.json").read_text()), np.load(place / "later.npz")
    for k, case in enumerate(key):
        label = " + ".join(f"{e} at {p}" for e, p in case["effects"]) or "nothing"
        if kind in (*CONTROLS, "outsider"):  # several of a kind
            label += f", {k}"
        if (k * 0.6180339887) % 1 >= share or (model, kind, label, seed) in done:
            continue
        folder = place / f"case_{k:02d}"
        found, spent = answer(folder)
        case["effects"] = [(e, p) for e, p in case["effects"]]
        row = {"model": model, "kind": kind, "case": label, "seed": seed}
        alike = (
            classes(model, tuple(case["without"]))
            if kind not in (*CONTROLS, "outsider")
            else ([], set())
        )
        row |= score(case, found, *alike) | {"cpu_s": spent}
        if kind in (*STRENGTH, "pair"):
            row["oracle"] = oracle(case, row, load_dataset(folder))
        if (
            kind == "many" and row["interval"] and "timestamp_jitter" not in str(row["named"])
        ):  # (readings then count otherwise)
            row["later"] = later(case, found, more["u"][k], more["y"][k])
        with store.open("a") as f:
            f.write(json.dumps(row, default=float) + "\n")
        mark = "ok " if row["right"] else "set" if row["in_set"] else "---"
        gap = f"gap {row['gap']:.3g} -> {row['after']:.3g} {spent:.0f} s"
        print(
            mark,
            model,
            kind,
            f"{label}:",
            row["verdict"],
            row["named"],
            "~",
            row["mates"],
            gap,
            flush=True,
        )


def main() -> dict[str, Any]:
    """The table of what was run so far (`python benchmarks/blind.py` runs cases, hours of them)."""
    lines = RESULTS.read_text().splitlines() if RESULTS.exists() else []
    rows = [json.loads(line) for line in lines]
    text = (
        "Recordings of separately written twins (jaxid.benchmark), written to folders without their key, which was read "
        "afterwards. The search was tuned on seeds 1, 3 and 20 to 23 and on two real recordings; each row is of the seed that "
        "stands in it, run once with the rules as they were then. Rules that came after rows they would change: several effects "
        "are `partly` if they leave 1.5 times the noise (after the flexible link's outsider that got a name; on report data too, "
        "after small effects of a pendulum that got one together, seed 27, a row that gave way to seed 28); numbers that data "
        "leave open are put back (after the servo's rows of seed 26: its class was right, but a delay and a scale of the sensor "
        "did not hold on report data); an effect that only led the model out of a local minimum, of fit or validation runs, is "
        "not named (after two controls of the servo, one of seed 28 and one of seed 29, which both gave way to seed 30); "
        "something small is looked for beside what was found (after pairs of the tracker of seed 28 and of the "
        "flexible link of seed 25, which gave way to seed 30); a single effect is `partly`, too, if it closes less than 97 % of "
        "the gap of fit or report runs and leaves 1.5 times the noise (after a tracker on other motors: paper_gaps.py). "
        "Rows of seed 17 are of earlier rules altogether. Where fit runs show no gap, what only leads along what they leave open "
        "gets no name since a servo of seed 62 (counted as it was) that began in motion: an input delay was seen where viscous "
        "friction was missing, which back EMF absorbs. What would be `partly` and stands further from report data than "
        "the model without it is `unknown` since a tracker of seed 62 fitted to steps (counted as it was, "
        "too). Rules after sets by MuJoCo of seed 40, not counted: a "
        "small effect beside others must show on report data and explain more than two simulations of one law differ. Parts "
        "of a recording start before the cut after sets of seed 50, not counted, whose runs begin in motion; a hypothesis is led "
        "out of a local minimum by one that contains it after the wrong name in such a set of the pendulum (seed 51, counted as "
        "it was). Of a large gap only the front of both screens was refitted for a while: in seeds 351129 and 351130, not "
        "counted, a flexible link's scale of the drive was named a flexible mode and a pendulum's spring a scale of its sensor: "
        "all near the best are refitted again; a servo's limit at 14 % of its commands was `unknown` (seed 351129) and is looked "
        "for down to 7 % since. How effects are left out again came after the single effects of seed 351131 and before its pairs "
        "(the planar arm's viscous friction of seed 24, asked once more, had a scale of 0.002 % beside it). The planar "
        "arm swings freely and over the top, and a case of it that ends in `unknown` takes up to 25 minutes: its poor "
        "excitations were not run, and the weak effects (seed 60) partly before, partly after "
        "hopeless starts were given up. Controls of the planar arm by MuJoCo (seed 40, rules before those): of four, "
        "one was named, two were `partly` and one `unknown`, at 1.1 to 2.4 times the noise of 1e-4 rad: there the simulators "
        "themselves differ by more than that noise. "
        "`right`: exactly the withheld effects, or equals of them on that model, were named; `in set`: they are among those "
        "named or reported as not to be told apart; `wrong`: a name outside the set. Effects that a model's parameters "
        "absorb count as `nothing missing`; torque_scale and flexible_mode of the tracker are absorbed to within the noise "
        "and count as missed, and so does what is too weak to show at a fifth of its strength."
    )
    return {"title": "Blind cases", "rows": summary(rows), "text": text}


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    out = []
    for model in dict.fromkeys(r["model"] for r in rows):
        for kind, label in KINDS.items():
            part = [r for r in rows if r["model"] == model and r["kind"] == kind]
            if not part:
                continue

            def count(key, part=part):
                return f"{sum(bool(r[key]) for r in part)} of {len(part)}"

            shares = [r["shrinkage"] for r in part if r["shrinkage"] is not None]
            missed = [
                f"{r['case']}: {r['verdict']} {' + '.join(r['named'])}"
                for r in part
                if not r["right"]
            ]
            if kind == "outsider":

                def said(verdict, part=part):
                    return sum(r["verdict"] == verdict for r in part)

                named = f"of {len(part)}: {said('named')} named, {said('partly')} partly, {said('unknown')} unknown"
                row = {"right": named, "in set": "", "wrong": ""}
            else:
                row = {"right": count("right"), "in set": count("in_set"), "wrong": count("wrong")}
            out.append(
                {
                    "model": model,
                    "cases": label,
                    "seed": ", ".join(sorted({str(r["seed"]) for r in part})),
                    **row,
                    "shrinkage, median": round(float(np.median(shares)), 3) if shares else "",
                    "CPU s a case, median": round(float(np.median([r["cpu_s"] for r in part])), 1),
                    "not right": "; ".join(missed) if kind != "outsider" else "",
                }
            )
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--models", default=",".join(PLANTS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--only", default="effect,control", help=", ".join(f"{k} ({w})" for k, w in KINDS.items())
    )
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--store", type=Path, default=RESULTS)
    parser.add_argument("--sets", type=Path, default=Path("out/blind"), help="folder of the cases")
    o = parser.parse_args()
    pairs = [(m, k) for m in o.models.split(",") for k in o.only.split(",")]
    for model, kind in pairs:
        if len(pairs) == 1:
            run(model, o.seed, kind, o.share, o.store, o.sets)
        else:  # a process for each set: programs of hundreds of different models would fill what a process may map
            own = [
                "--models",
                model,
                "--only",
                kind,
                "--seed",
                o.seed,
                "--share",
                o.share,
                "--store",
                o.store,
                "--sets",
                o.sets,
            ]
            subprocess.run([sys.executable, __file__, *map(str, own)], check=True)
