"""Sets of rigs: one effect or none, pairs, poor excitation, what is of no library."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxid.benchmark import mujoco_twin, numpy_twin
from jaxid.benchmark.case import (
    asked_rows,
    BlindCase,
    depends_on,
    Draft,
    Exam,
    generator,
    SIZES,
    SPLITS,
    WithheldEffect,
)
from jaxid.benchmark.plants import Lanes, PLANTS, TwinPlant
from jaxid.benchmark.rigs import chain_of, dataset, lanes, names_of, twin
from jaxid.benchmark.withheld import BUILTIN, commands, outsiders, SECONDS, steps
from jaxid.data.dataset import Dataset, ModelSpec
from jaxid.dynamics import catalogue


MODELS = ("joint", "pendulum", "servo", "tracker", "planar_arm", "flexible_link")
#: Share of a set in which nothing is missing, and how much of a run the exam takes.
NOTHING, EXAM_S = 0.15, 3.0
#: Sets whose runs for the fit are a few steps at one joint at a time.
STEPPED = ("poor", "papers")
#: Seconds of a run of an arm that swings over the top, whose steps are small.
SHORT = {"planar_arm": 4.0}
#: Number of the twin that is the size of an effect.
NUMBERS = {
    "dead_zone": "dead_zone",
    "saturation": "limit",
    "supply_droop": "droop",
    "torque_scale": "scale",
    "actuator_lag": "lag",
    "input_delay": "delay",
    "viscous_friction": "viscous",
    "coulomb_friction": "coulomb",
    "stribeck_friction": "stribeck",
    "load_dependent_friction": "load",
    "quadratic_drag": "drag",
    "backlash": "play",
    "joint_elasticity": "compliance",
    "hysteresis": "loop",
    "payload": "payload",
    "constant_torque": "offset",
    "gravity_offset": "tilt",
    "spring_torque": "spring",
    "reflected_inertia": "reflected",
    "sensor_bias": "bias",
    "sensor_scale": "gain_error",
    "sensor_lag": "sensor_lag",
    "sensor_delay": "sensor_delay",
}
#: Effects that no recording tells apart on a model, as `jaxid effects --model M` lists them.
ALIKE: dict[str, tuple[tuple[str, ...], ...]] = {
    "joint": (("input_delay", "sensor_delay"), ("joint_elasticity", "flexible_mode")),
    "pendulum": (
        ("input_delay", "sensor_delay"),
        ("gravity_offset", "sensor_bias"),
        ("spring_torque", "sensor_scale"),
    ),
    "servo": (
        ("input_delay", "sensor_delay"),
        ("torque_scale", "spring_torque", "sensor_scale"),
        ("constant_torque", "sensor_bias"),
    ),
    "flexible_link": (("input_delay", "sensor_delay"),),
}
#: Effects that a model's own numbers take in: nothing is missing where one of them is withheld.
ABSORBED: dict[str, tuple[str, ...]] = {
    "joint": ("torque_scale", "back_emf", "reflected_inertia", "sensor_bias", "sensor_scale"),
    "pendulum": ("torque_scale", "back_emf", "reflected_inertia"),
    "servo": ("payload", "reflected_inertia"),
    "tracker": ("torque_scale", "flexible_mode"),
    "flexible_link": ("back_emf",),
}
#: What the forces of no library depend on.
OUTSIDE = {
    "a periodic torque from outside": ("time",),
    "a push of 0.6 s": ("time",),
    "damping that depends on position": ("position", "speed"),
    "damping that changes at half time": ("time", "speed"),
    "a torque that follows the other joint": ("position",),
}


def drafts(name: str, seed: int, numbers: Sequence[int]) -> list[Draft]:
    """Cases of a set of rigs, one rig after another: of five rounds through them two are by MuJoCo,
    where it has the rig and the forces; the others are by NumPy.
    """
    return [draft_of(MODELS[number % len(MODELS)], name, seed, number) for number in numbers]


def draft_of(model: str, name: str, seed: int, number: int) -> Draft:
    """A case of one rig."""
    rng = generator(seed, name, number)
    plant, chain = PLANTS[model], chain_of(model)
    by = _simulator(name, model, number)
    possible = [e for e in names_of(plant, chain) if e not in ABSORBED.get(model, ())]
    if by == "mujoco":
        possible = [e for e in possible if mujoco_twin.expressed(model, e)]
    effects: list[str] = []
    if name == "outsiders":
        effects = [str(rng.choice(list(outsiders(plant, 0, rng))))]
    elif name == "pairs":
        free = [e for e in possible if e not in BUILTIN]
        effects = [str(e) for e in rng.choice(free, 2, replace=False)]
    elif rng.uniform() > NOTHING:
        effects = [str(rng.choice(possible))]
    strength = float(rng.choice([0.5, 1.0, 2.0]))
    made = twin(plant, chain, effects, strength, rng, outside=name == "outsiders")
    return Draft(name, seed, number, f"{by} {model}", simulate, {"by": by} | made)


def _simulator(name: str, model: str, number: int) -> str:
    """What simulates a case."""
    rounds = number // len(MODELS) % 5
    if name != "outsiders" and model in mujoco_twin.PLANTS and rounds in (0, 3):
        return "mujoco"
    return "numpy"


def shown(data: Dataset, model: str, without: Sequence[str] = ()) -> Dataset:
    """With the model that it is to be read against."""
    return replace(data, model=ModelSpec(model, without=tuple(without)))


def simulate(group: Sequence[Draft]) -> list[BlindCase]:
    """The cases of one plant by one simulator, side by side."""
    plant, by = PLANTS[group[0].plan["model"]], group[0].plan["by"]
    runs = len(SPLITS) + 1
    drives, numbers = [], []
    for draft in group:
        drives.append(_driven(draft, plant, runs))
        own = draft.plan["numbers"]
        numbers += [own] * runs + [_stated(plant, own, draft.plan["without"])]
    u = np.concatenate([np.concatenate([x, x[-1:]]) for x in drives])
    simulator = {"numpy": numpy_twin, "mujoco": mujoco_twin}[by]
    rng = generator(group[0].seed, group[0].group, len(group))
    y = simulator.recorded(plant, u, lanes(plant, numbers, 1), rng)
    out = []
    for k, draft in enumerate(group):
        own = slice(k * (runs + 1), (k + 1) * (runs + 1))
        out.append(_case(draft, plant, u[own], y[own]))
    return out


def _driven(draft: Draft, plant: TwinPlant, runs: int) -> np.ndarray:
    """Commands of the runs of a case [runs samples inputs]; the last one is the exam's."""
    rng = draft.rng(1)
    u = commands(plant, rng, runs)
    if draft.set in STEPPED:
        for run in range(2):
            u[run] = steps(plant, rng, run)
    seconds = SHORT.get(plant.model, SECONDS.get(plant.model, 8.0))
    return u[:, : int(seconds * plant.rate)]


def _stated(plant: TwinPlant, numbers: Lanes, without: Sequence[str]) -> Lanes:
    """The numbers of the model as stated: nominal, without what is left out."""
    out = {k: np.array(x, float) for k, x in plant.nominal.items()}
    gone = {"viscous_friction": "viscous", "coulomb_friction": "coulomb"}
    for effect in without:
        key = gone.get(effect, "offset")
        if key in out:
            out[key] = 0 * out[key]
    return out


def _case(draft: Draft, plant: TwinPlant, u: np.ndarray, y: np.ndarray) -> BlindCase:
    plan, runs, model = draft.plan, len(SPLITS), plant.model
    data = dataset(plant, u[:runs], y[:runs], SPLITS)
    count = int(EXAM_S * plant.rate)
    rows = asked_rows(count, plant.rate // 10)
    given = {"t": np.arange(count) / plant.rate}
    given |= {n: u[runs, :count, i] for i, (n, _) in enumerate(plant.inputs)}
    truth = {n: y[runs, rows, i] for i, (n, _) in enumerate(plant.outputs)}
    stated = {n: y[runs + 1, rows, i] for i, (n, _) in enumerate(plant.outputs)}
    noise = {c.name: float(c.noise_std or plant.noise) for c in data.outputs}
    question = {
        "model": model,
        "equations": catalogue.model_class(model).equations,
        "without": list(plan["without"]),
        "stated": {k: list(x) for k, x in plant.nominal.items()},
        "joints": list(chain_of(model).signature.joints),
    }
    files = {}
    if model in mujoco_twin.PLANTS and model != "servo":
        own = lanes(plant, [_stated(plant, {}, plan["without"])], 1)
        stated_numbers = {k: x[0] for k, x in own.items()}
        files["model.xml"] = mujoco_twin.machine(plant, stated_numbers, mujoco_twin.STEP)
    missing = ()
    outside, over = "", ()
    if draft.set == "outsiders":
        outside = str(plan["effects"][0][0])
        over = OUTSIDE[outside]
    else:
        missing = tuple(_missing(plant, plan, e, place) for e, place in plan["effects"])
        over = depends_on(missing)
    return BlindCase(
        question=question,
        dataset=shown(data, model, plan["without"]),
        simulator=plan["by"],
        missing=missing,
        outside=outside,
        over=over,
        exam=Exam(given, rows, truth, stated, noise),
        files=files,
    )


def _missing(plant: TwinPlant, plan: dict[str, Any], effect: str, place: str) -> WithheldEffect:
    signature = chain_of(plant.model).signature
    channels = [n for n, _ in (*plant.inputs, *plant.outputs)]
    if place in signature.joints:
        j = signature.joints.index(place)
    else:
        j = channels.index(place) % plant.n
    size = None
    if effect in NUMBERS and effect in SIZES:
        size = float(np.asarray(plan["numbers"][NUMBERS[effect]])[j])
    joint = signature.joints[j]
    groups = [g for g in ALIKE.get(plant.model, ()) if effect in g]
    if effect == "viscous_friction" and "back_emf" in ABSORBED.get(plant.model, ()):
        groups.append(("viscous_friction", "back_emf"))
    names = dict.fromkeys(itertools.chain(*groups))
    alike = tuple(f"{e}@{joint}" for e in names if e != effect)
    return WithheldEffect(effect, joint, size, alike)
