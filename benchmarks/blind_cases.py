"""Blind cases: what is in each twin, its recordings, and the key, in files of their own.

A set of cases is a folder: `case_NN/` holds a recording and question.json (model, and which of its
effects it lacks), all that a diagnosis is told; key.json and later.npz (further runs of the same
twins) are for the scorer alone. Recordings come from benchmarks/twins.py or from MuJoCo
(benchmarks/twins_mujoco.py), which share no code with the product; excitation, nominal parameters,
joint and strength vary from case to case.
"""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import twins, twins_mujoco
from benchmarks.twins import NEUTRAL, Plant, PLANTS
from jaxid import catalogue
from jaxid.data.dataset import Dataset
from jaxid.data.io import save_dataset
from jaxid.dynamics.chain import Chain


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
SECONDS = {"flexible_link": 4.0}


def medium(plant: Plant, j: int, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """effect -> numbers of the twin at medium strength, at joint j; what has no strength (speeds,
    widths, orders) is a tuple.
    """
    T, V, J = plant.torque[j], plant.speed[j], plant.inertia[j]
    U = 1.0 if plant.model == "servo" else T  # size of a command

    def any_of(a, b):
        return (rng.uniform(a, b),)

    out: dict[str, Any] = {
        "dead_zone": {"dead_zone": 0.08 * U},
        "saturation": {"limit": 0.35 * U},
        "supply_droop": {"droop": 0.15 / U},
        "torque_scale": {"scale": 0.1},
        "actuator_lag": {"lag": 0.015},
        "input_delay": {"delay": 0.008},
        "input_hold": {"linear": (1.0,)},
        "back_emf": {"back_emf": 0.1 * T / V},
        "torque_ripple": {"ripple": 0.08 * T, "ripple_order": any_of(5.0, 12.0)},
        "coulomb_friction": {"coulomb": 0.08 * T},
        "asymmetric_friction": {"dry_asymmetry": 0.05 * T, "viscous_asymmetry": 0.03 * T / V},
        "stribeck_friction": {"stribeck": 0.12 * T, "stribeck_speed": any_of(0.04 * V, 0.1 * V)},
        "load_dependent_friction": {"load": 0.12},
        "quadratic_drag": {"drag": 0.15 * T / V**2},
        "power_law_friction": {"power": 0.1 * T / np.sqrt(V), "exponent": any_of(0.4, 0.6)},
        "lugre_friction": {"lugre": 0.12 * T, "presliding": any_of(0.03, 0.08)},
        "position_dependent_friction": {"uneven": 0.05 * T, "uneven_order": any_of(2.0, 5.0)},
        "temperature_dependent_friction": {"warm": 0.3 * T / V**3, "warm_time": any_of(1.5, 3.0)},
        "coupled_friction": {
            "shared_viscous": 0.1 * T / V,
            "shared_dry": 0.03 * T,
            "shared_speed": (0.05 * V,),
        },
        "backlash": {"play": 0.03, "motor_share": (0.4,), "compliance": (0.02 / T,)},
        "joint_elasticity": {
            "compliance": 0.03 / T,
            "motor_share": any_of(0.3, 0.5),
            "spring_damping": (0.1,),
        },
        "hysteresis": {"loop": 0.1 * T, "loop_width": any_of(0.05, 0.15)},
        "payload": {"payload": 0.3 * J / 0.1},
        "constant_torque": {"offset": 0.06 * T},
        "gravity_offset": {"tilt": 0.05},
        "spring_torque": {"spring": 0.2 * T},
        "reflected_inertia": {"reflected": 0.2 * J},
        "flexible_mode": {
            "swing": 0.25 * J,
            "swing_frequency": any_of(3.0, 8.0),
            "swing_damping": (0.05,),
        },
        "sensor_bias": {"bias": 0.03},
        "sensor_scale": {"gain_error": 0.05},
        "sensor_lag": {"sensor_lag": 0.012},
        "sensor_delay": {"sensor_delay": 0.009},
        "timestamp_jitter": {"jitter": 0.003},
    }
    out["viscous_friction"] = {
        "viscous": plant.nominal["viscous"][min(j, len(plant.nominal["viscous"]) - 1)]
    }
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
        "a periodic torque from outside": {
            "outside": 0.08 * T,
            "outside_hz": rng.uniform(0.6, 2.0),
        },
        "a push of 0.6 s": {
            "outside": 0.3 * T,
            "outside_hz": 0.01,
            "outside_from": 0.4 * end,
            "outside_until": 0.4 * end + 0.6,
        },
        "damping that depends on position": {"bent_damping": 0.25 * T / V},
        "damping that changes at half time": {
            "later_damping": 0.2 * T / V,
            "outside_from": end / 2,
        },
    }
    if plant.n > 1:
        found["a torque that follows the other joint"] = {"other_joint": 0.2 * T}
    return found


def commands(plant: Plant, rng: np.random.Generator, runs: int, before: int = 0) -> np.ndarray:
    """A multisine with steps and rests for each input, [runs samples nu], by so many samples longer
    than usual.
    """
    count = before + int(plant.rate * SECONDS.get(plant.model, 8.0))
    t = np.arange(count) / plant.rate
    u = np.zeros((runs, count, plant.n))
    for r in range(runs):
        for j in range(plant.n):
            reach = 1.2 if plant.model == "servo" else plant.torque[j]
            lines, base = rng.integers(5, 10), rng.uniform(0.15, 0.4)
            for k in range(1, lines + 1):
                f = k * base * rng.uniform(0.7, 1.3)
                u[r, :, j] += (
                    reach * np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) / np.sqrt(lines)
                )
            for _ in range(4):
                a = rng.integers(0, count - count // 8)
                part = slice(a, a + rng.integers(count // 40, count // 10))
                u[r, part, j] = rng.uniform(-reach, reach) if rng.uniform() < 0.6 else 0.0
            if plant.model in (
                "joint",
                "flexible_link",
            ):  # nothing holds them: keep them from running away
                u[r, :, j] -= u[r, :, j].mean()
    return u


def plan(model: str, seed: int, kinds: tuple[str, ...]) -> list[dict[str, Any]]:
    """The cases of a model: what is in the twin, and the key."""
    plant = PLANTS[model]
    chain = Chain(catalogue.model_class(model)())
    names = [
        n
        for n in catalogue.effect_names()
        if chain.offers(catalogue.effect_class(n)) or n in chain.contents
    ]
    cases: list[dict[str, Any]] = []

    def add(
        kind: str, effects: list[str], strength: float, rng: np.random.Generator, own=None
    ) -> None:
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
            size = (
                strength
                * rng.uniform(0.7, 1.4)
                * (1 if own else rng.choice([-1, 1]) if e in EITHER else 1)
            )
            for k, x in found.items():
                value = np.array(numbers.get(k, np.full(plant.n, float(NEUTRAL[k]))), float)
                if e == "saturation":
                    value[j] = x * (
                        0.6 + 0.4 * rng.uniform()
                        if strength >= 1
                        else 1.7
                        if strength >= 0.2
                        else 2.7
                    )
                elif isinstance(x, tuple):
                    value[j] = x[0]
                elif own and k in ("outside_hz", "outside_from", "outside_until"):
                    value[j] = x
                elif e not in BUILTIN or k not in plant.nominal:
                    value[j] = x * size
                numbers[k] = value
            builtin = e in chain.contents
            without += [e] if builtin else []
            if (
                builtin and e in BUILTIN
            ):  # taken out of the model at every joint, so that only this one has it
                numbers |= {k: numbers[k] * (np.arange(plant.n) == j) for k in found}
            if builtin and e == "constant_torque":
                numbers["offset"] = numbers["offset"] * 4
            location = chain.signature.inputs[j][0] if e in AT_INPUT else chain.signature.joints[j]
            if e in AT_OUTPUT:
                location = chain.signature.outputs[j][0]
            key.append((e, location))
        cases.append(
            {
                "model": model,
                "kind": kind,
                "effects": key,
                "numbers": numbers,
                "without": without,
                "strength": strength,
            }
        )

    alone = [
        n
        for n in names
        if n in medium(plant, 0, np.random.default_rng(0))
        and not (plant.n == 1 and n == "coupled_friction")
    ]

    # A seed of its own for every case, so that a part of the plan is the same as in the whole.
    def own_seed(*words):
        return np.random.default_rng([seed, zlib.crc32(" ".join((model, *words)).encode())])

    for kind in STRENGTH:
        for e in alone if kind in kinds else []:
            there = kind != "mujoco" or twins_mujoco.expressed(model, e)
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
            name = rng.choice(list(outsiders(plant, 0, rng)))
            add(
                "outsider",
                [name],
                1.0,
                rng,
                own=lambda j, name=name, rng=rng: outsiders(plant, j, rng)[name],
            )
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


EITHER = (
    "asymmetric_friction",
    "torque_ripple",
    "constant_torque",
    "gravity_offset",
    "sensor_bias",
    "sensor_scale",
    "position_dependent_friction",
    "torque_scale",
)
BUILTIN = ("viscous_friction", "coulomb_friction")
AT_INPUT = (
    "dead_zone",
    "saturation",
    "supply_droop",
    "torque_scale",
    "actuator_lag",
    "input_delay",
    "input_hold",
    "back_emf",
)
AT_OUTPUT = ("sensor_bias", "sensor_scale", "sensor_lag", "sensor_delay", "timestamp_jitter")


def steps(plant: Plant, rng: np.random.Generator, run: int) -> np.ndarray:
    """The papers' own excitation: two levels after each other at one joint, the others without
    drive, [samples nu].
    """
    count = int(plant.rate * SECONDS.get(plant.model, 8.0))
    u = np.zeros((count, plant.n))
    j = run % plant.n
    reach = 1.2 if plant.model == "servo" else plant.torque[j]
    first, second = rng.uniform(0.6, 1.0), rng.uniform(0.3, 0.8)
    sign = rng.choice([-1, 1])
    u[count // 16 : 6 * count // 16, j] = sign * first * reach
    u[6 * count // 16 : 11 * count // 16, j] = -sign * second * reach
    return u


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
    keys = dict.fromkeys(k for c in cases for k in (*c["numbers"], *NEUTRAL))
    width, runs = plant.n, first + more

    def column(c, k):
        return np.broadcast_to(
            np.asarray(c["numbers"].get(k, NEUTRAL.get(k, 0.0)), float), (width,)
        )

    numbers = {k: np.repeat(np.array([column(c, k) for c in cases]), runs, 0) for k in keys}
    simulator = twins_mujoco if kind.startswith("mujoco") else twins
    y = simulator.recorded(plant, u, numbers, rng)
    u, y = (x.reshape(len(cases), runs, *x.shape[1:])[:, :, before:] for x in (u, y))
    return (
        [dataset(plant, u[k, :first], y[k, :first], splits, not moving) for k in range(len(cases))],
        u[:, first:],
        y[:, first:],
    )


def dataset(
    plant: Plant, u: np.ndarray, y: np.ndarray, split: tuple[str, ...], at_rest: bool = True
) -> Dataset:
    """Runs [runs samples channels] as a dataset."""
    return Dataset.from_arrays(
        [np.arange(u.shape[1]) / plant.rate] * len(u),
        inputs={n: list(u[:, :, i]) for i, (n, _) in enumerate(plant.inputs)},
        outputs={n: list(y[:, :, i]) for i, (n, _) in enumerate(plant.outputs)},
        units=dict((*plant.inputs, *plant.outputs)),
        split=list(split),
        at_rest=at_rest,
        noise_std={
            n: plant.noise if i < plant.n else 0.05 for i, (n, _) in enumerate(plant.outputs)
        },
        resolution={n: plant.resolution for n, _ in plant.outputs[: plant.n]},
        model=plant.model,
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
