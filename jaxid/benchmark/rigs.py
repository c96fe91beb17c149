"""Twins of rigs: what a case lacks and where, its numbers, and its recordings as a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxid.benchmark.plants import Lanes, NEUTRAL, TwinPlant
from jaxid.benchmark.withheld import AT_INPUT, AT_OUTPUT, BUILTIN, EITHER, medium, outsiders
from jaxid.data.dataset import Dataset
from jaxid.dynamics import catalogue
from jaxid.dynamics.chain import Chain


#: Of the forces of no library: what is no strength.
_WHEN = ("outside_hz", "outside_from", "outside_until")


def chain_of(model: str) -> Chain:
    """The model as jaxid has it; its effects are those that a twin may lack."""
    return Chain(catalogue.model_class(model)())


def names_of(plant: TwinPlant, chain: Chain) -> list[str]:
    """Effects that one case of a rig may lack alone."""
    offered = [
        name
        for name in catalogue.effect_names()
        if chain.offers(catalogue.effect_class(name)) or name in chain.contents
    ]
    known = medium(plant, 0, np.random.default_rng(0))
    alone = [name for name in offered if name in known]
    if plant.n == 1:
        alone = [name for name in alone if name != "coupled_friction"]
    return alone


def joint_of(plant: TwinPlant, effect: str, rng: np.random.Generator) -> int:
    """The joint where an effect is withheld."""
    joint = int(rng.integers(plant.n))
    if effect in ("gravity_offset", "coupled_friction"):
        return 0
    if effect == "payload" and plant.model == "tracker":
        return 1
    return joint


def place_of(chain: Chain, effect: str, joint: int) -> str:
    """The channel or joint where jaxid says that effect of a joint acts."""
    if effect in AT_INPUT:
        return chain.signature.inputs[joint][0]
    if effect in AT_OUTPUT:
        return chain.signature.outputs[joint][0]
    return chain.signature.joints[joint]


def twin(
    plant: TwinPlant,
    chain: Chain,
    effects: Sequence[str],
    strength: float,
    rng: np.random.Generator,
    outside: bool = False,
) -> dict[str, Any]:
    """A twin that lacks `effects`: its numbers, each [joints], where they act, and the built-in
    effects that its model is told to leave out. `outside`: they are of no library.
    """
    numbers: Lanes = {}
    for name, nominal in plant.nominal.items():
        numbers[name] = np.array(nominal) * rng.uniform(0.88, 1.12, len(nominal))
    places, without = [], []
    for effect in effects:
        joint = joint_of(plant, effect, rng)
        if outside:
            found = outsiders(plant, joint, rng)[effect]
        else:
            found = medium(plant, joint, rng)[effect]
        size = strength * rng.uniform(0.7, 1.4)
        if not outside and effect in EITHER:
            size *= rng.choice([-1, 1])
        for name, number in found.items():
            blank = np.full(plant.n, float(NEUTRAL[name]))
            value = np.array(numbers.get(name, blank), float)
            if effect == "saturation":
                value[joint] = number * _clipped(strength, rng)
            elif isinstance(number, tuple):
                value[joint] = number[0]
            elif outside and name in _WHEN:
                value[joint] = number
            elif effect not in BUILTIN or name not in plant.nominal:
                value[joint] = number * size
            numbers[name] = value
        if effect in chain.contents:
            without.append(effect)
            _take_out(plant, numbers, effect, joint, found)
        places.append((effect, place_of(chain, effect, joint)))
    return {"model": plant.model, "effects": places, "numbers": numbers, "without": without}


def _clipped(strength: float, rng: np.random.Generator) -> float:
    """How far a limit lies from its medium strength."""
    if strength >= 1:
        return 0.6 + 0.4 * rng.uniform()
    return 1.7 if strength >= 0.2 else 2.7


def _take_out(
    plant: TwinPlant, numbers: Lanes, effect: str, joint: int, found: dict[str, float]
) -> None:
    """A built-in effect is taken out of the model at every joint, so that only this one has it."""
    if effect in BUILTIN:
        for name in found:
            numbers[name] = numbers[name] * (np.arange(plant.n) == joint)
    if effect == "constant_torque":
        numbers["offset"] = numbers["offset"] * 4


def lanes(plant: TwinPlant, twins: Sequence[Lanes], runs: int) -> Lanes:
    """The numbers of several twins side by side, each for so many runs: [lanes joints]."""
    keys = dict.fromkeys(NEUTRAL)
    for numbers in twins:
        keys |= dict.fromkeys(numbers)

    def column(numbers: Lanes, key: str) -> np.ndarray:
        value = np.asarray(numbers.get(key, NEUTRAL.get(key, 0.0)), float)
        return np.broadcast_to(value, (plant.n,))

    out = {}
    for key in keys:
        each = np.array([column(numbers, key) for numbers in twins])
        out[key] = np.repeat(each, runs, 0)
    return out


def dataset(
    plant: TwinPlant,
    u: np.ndarray,
    y: np.ndarray,
    split: Sequence[str],
    at_rest: bool = True,
) -> Dataset:
    """Runs [runs samples channels] as a dataset."""
    noise = {}
    for i, (name, _) in enumerate(plant.outputs):
        noise[name] = plant.noise if i < plant.n else 0.05
    return Dataset.from_arrays(
        [np.arange(u.shape[1]) / plant.rate] * len(u),
        inputs={n: list(u[:, :, i]) for i, (n, _) in enumerate(plant.inputs)},
        outputs={n: list(y[:, :, i]) for i, (n, _) in enumerate(plant.outputs)},
        units=dict((*plant.inputs, *plant.outputs)),
        split=list(split),
        at_rest=at_rest,
        noise_std=noise,
        resolution={n: plant.resolution for n, _ in plant.outputs[: plant.n]},
        model=plant.model,
    )
