"""Blind cases: what is in each twin, its recordings, and the key, in files of their own.

A set of cases is a folder: `case_NN/` holds a recording and question.json (model, and which of its
effects it lacks), all that a diagnosis is told; key.json and later.npz (further runs of the same
twins) are for the scorer alone. Recordings come from the twins of
`jaxid.benchmark`, in NumPy or MuJoCo, which share no code with the product; excitation, nominal parameters,
joint and strength vary from case to case.
"""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.benchmark import mujoco_twin, numpy_twin
from jaxid.benchmark.plants import PLANTS
from jaxid.benchmark.rigs import chain_of, dataset, lanes, names_of, twin
from jaxid.benchmark.withheld import BUILTIN, commands, outsiders, steps
from jaxid.data.dataset import Dataset
from jaxid.data.io import save_dataset


KINDS = {
    "effect": "one effect, medium",
    "strong": "one effect, three times as strong",
    "weak": "one effect, a fifth of it",
    "poor": "one effect, fitted to steps at one joint at a time",
    "many": "one effect, eight report runs",
    "control": "nothing missing",
    "outsider": "an effect of no library",
    "pair": "two effects",
    "clutter": "ten small effects",
    "mujoco": "one effect, medium, by MuJoCo",
    "mujoco_control": "nothing missing, by MuJoCo",
    "moving": "one effect, medium, runs that begin in motion, splits not stated",
    "moving_control": "nothing missing, runs that begin in motion, splits not stated",
}
STRENGTH = {
    "effect": 1.0,
    "strong": 3.0,
    "weak": 0.2,
    "poor": 1.0,
    "many": 1.0,
    "mujoco": 1.0,
    "moving": 1.0,
}
#: Cases of a model in which nothing is missing.
CONTROLS = {"control": 25, "mujoco_control": 10, "moving_control": 10}
SPLITS = ("fit", "fit", "validation", "report")
#: Of kinds whose runs begin in motion: what is not recorded of each, and runs, of whose ends the
#: diagnosis keeps back a part.
BEFORE_S, MOVING_SPLITS = 2.0, ("fit", "fit", "fit")
#: Runs of every twin of kind `many` that are recorded for the scorer alone (the others' report run
#: is too short for an interval): so many that their own scatter hardly matters beside that of eight
#: report runs.
LATER = 40


def plan(model: str, seed: int, kinds: tuple[str, ...]) -> list[dict[str, Any]]:
    """The cases of a model: what is in the twin, and the key."""
    plant, chain = PLANTS[model], chain_of(model)
    alone = names_of(plant, chain)
    cases: list[dict[str, Any]] = []

    # A seed of its own for every case, so that a part of the plan is the same as in the whole.
    def own_seed(*words):
        return np.random.default_rng([seed, zlib.crc32(" ".join((model, *words)).encode())])

    def add(kind: str, effects: list[str], strength: float, rng: np.random.Generator) -> None:
        made = twin(plant, chain, effects, strength, rng, outside=kind == "outsider")
        cases.append({"kind": kind, "strength": strength} | made)

    for kind in STRENGTH:
        for e in alone if kind in kinds else []:
            there = kind != "mujoco" or mujoco_twin.expressed(model, e)
            if there and (
                kind != "weak" or (e not in BUILTIN and e not in ("input_hold", "timestamp_jitter"))
            ):
                add(kind, [e], STRENGTH[kind], own_seed(kind, e))
    for kind in CONTROLS:
        for k in range(CONTROLS[kind] if kind in kinds else 0):
            add(kind, [], 1.0, own_seed(kind, str(k)))
    if "outsider" in kinds:
        for k in range(25):
            rng = own_seed("outsider", str(k))
            add("outsider", [rng.choice(list(outsiders(plant, 0, rng)))], 1.0, rng)
    if "pair" in kinds:
        for k in range(10):
            rng = own_seed("pair", str(k))
            pair = [
                str(x) for x in rng.choice([e for e in alone if e not in BUILTIN], 2, replace=False)
            ]
            add("pair", pair, 1.0, rng)
    if "clutter" in kinds:
        small = [
            e
            for e in alone
            if e not in BUILTIN and e not in ("input_hold", "timestamp_jitter", "joint_elasticity")
        ]
        for k in range(5):
            rng = own_seed("clutter", str(k))
            add("clutter", [str(x) for x in rng.choice(small, 10, replace=False)], 0.06, rng)
    return cases


def recordings(
    cases: list[dict[str, Any]], seed: int
) -> tuple[list[Dataset], np.ndarray, np.ndarray]:
    """The datasets of cases of one model and kind, and commands and readings of later runs [cases
    runs samples channels], all of them integrated side by side.
    """
    plant = PLANTS[cases[0]["model"]]
    kind = cases[0]["kind"]
    rng = np.random.default_rng([seed, 1, zlib.crc32(f"{plant.model} {kind}".encode())])
    moving = kind.startswith("moving")
    before = int(plant.rate * BEFORE_S) if moving else 0
    splits, more = (
        ((*SPLITS, *["report"] * 7), LATER)
        if kind == "many"
        else (MOVING_SPLITS if moving else SPLITS, 0)
    )
    first, drives = len(splits), []
    for case in cases:
        u = commands(plant, rng, first, before)
        for r, split in enumerate(splits):
            if case["kind"] == "poor" and split == "fit":
                u[r] = steps(plant, rng, r)
        drives += [u, commands(plant, rng, more, before)]
    u = np.concatenate(drives)
    runs = first + more
    numbers = lanes(plant, [c["numbers"] for c in cases], runs)
    simulator = mujoco_twin if kind.startswith("mujoco") else numpy_twin
    y = simulator.recorded(plant, u, numbers, rng)
    u, y = (x.reshape(len(cases), runs, *x.shape[1:])[:, :, before:] for x in (u, y))
    return (
        [dataset(plant, u[k, :first], y[k, :first], splits, not moving) for k in range(len(cases))],
        u[:, first:],
        y[:, first:],
    )


def write_set(model: str, seed: int, kind: str, folder: Path) -> Path:
    """Writes the set of one kind of cases of a model, unless it is there; returns its folder, whose
    name says nothing.
    """
    place = folder / f"{zlib.crc32(f'{model} {seed} {kind}'.encode()):08x}"
    if (place / "key.json").exists():
        return place
    cases = plan(model, seed, (kind,))
    datasets, u, y = recordings(cases, seed)
    for k, (case, data) in enumerate(zip(cases, datasets, strict=True)):
        own = place / f"case_{k:02d}"
        save_dataset(data, own, overwrite=True)
        (own / "question.json").write_text(json.dumps({"model": model, "without": case["without"]}))
    np.savez_compressed(place / "later.npz", u=u, y=y)
    key = [
        case
        | {"seed": seed, "numbers": {k: np.asarray(x).tolist() for k, x in case["numbers"].items()}}
        for case in cases
    ]
    (place / "key.json").write_text(json.dumps(key, indent=1))
    return place
