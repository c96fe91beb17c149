"""An input of any model that is not an arm, chosen by simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.wording import stem_and_number
from jaxid.data.dataset import Channel, Dataset, Experiment, ModelSpec
from jaxid.data.limits import Limits
from jaxid.dynamics.chain import Chain
from jaxid.excitation.bounds import Bounds
from jaxid.excitation.inputs import (
    begun,
    by_goals,
    choose,
    determined,
    Family,
    InputDesign,
    largest_inputs,
)
from jaxid.excitation.result import content, coverage, Excitation, reached, stds


#: Noise of outputs by unit, one standard deviation, where a design needs it.
SENSOR = {"rad": 1e-3, "m": 1e-4, "m/s^2": 0.05}


def design_input(
    *,
    chain: Chain,
    bounds: Bounds,
    t: np.ndarray,
    plan: dict[str, Any],
    criterion: str,
    starts: int,
    amplitude: Sequence[float] | None,
    gain: Sequence[float] | None,
    limits: Limits | None,
    progress: Any,
) -> Excitation:
    """An input of any model. See `jaxid.excitation.design.excite`."""
    signature = chain.signature
    plain = _continuous(chain)
    if plain and signature not in plain:
        chain = Chain(chain.mechanism, chain.effects, signature=plain[0])
        signature = chain.signature
    nu = len(signature.inputs)
    if amplitude is not None:
        top = widened("amplitude", amplitude, nu)
    else:
        top = largest_inputs(chain, bounds)
    gains = None if gain is None else widened("gain", gain, nu)
    if gains is not None and limits is not None and limits.current is not None:
        top = np.minimum(top, gains * np.array(limits.widened(nu).current))
    if by_goals(chain):
        bounds = bounds._replace(home=(bounds.lower + bounds.upper) / 2)
    start, bounds = begun(chain, bounds)
    center, slew = np.zeros(nu), None
    if by_goals(chain):
        center = start[:nu]
        slew = (0.75 * bounds.speed[:nu], 0.75 * bounds.acceleration[:nu])
    omega = 2 * np.pi * plan["base_frequency_hz"]
    family = Family(t, plan["harmonics"], omega, top, center, slew)
    noise = np.array([SENSOR.get(u, 1e-3) for _, u in signature.outputs])
    bench = InputDesign(chain, start, family, bounds, noise)
    u, _ = choose(bench, criterion, starts, plan["seed"], progress)
    return described(bench, u, plan, criterion, gains)


def _continuous(chain: Chain) -> list[Any]:
    """The signatures without a switch: one that releases the motor is no excitation."""
    found = []
    for signature in chain.mechanism.signatures:
        if "1" not in {unit for _, unit in signature.inputs}:
            found.append(signature)
    return found


def described(
    bench: InputDesign,
    u: np.ndarray,
    plan: dict[str, Any],
    criterion: str,
    gains: np.ndarray | None,
) -> Excitation:
    """A designed input [time nu] as what it does to the model of a bench, and what it shows of its
    parameters.
    """
    family, bounds = bench.family, bench.bounds
    t = family.t
    bench, y, dy = _of_moving_outputs(bench, u)
    chain, noise = bench.chain, bench.noise
    signature = chain.signature
    F = bench.fisher(dy)[0]
    condition, dark = determined(F)
    std = stds(F) * bench.unit[bench.free]
    q = y[0][:, chain.joint_outputs]
    qd = np.gradient(q, float(t[1] - t[0]), axis=0)
    used = reached(signature.joints, signature, bounds, q, qd, None)
    used += _inputs_used(signature, family, u)
    inputs = signature.input_names
    outputs = signature.output_names
    commands = dict(zip(inputs, u.T, strict=True))
    currents: dict[str, np.ndarray] = {}
    if gains is not None:
        if family.slew is not None:
            raise UsageError(
                f"{chain.mechanism.name} takes positions: a gain (N m/A) has no meaning; leave out"
                " --gain"
            )
        for k, name in enumerate(inputs):
            currents[_current(name, k, len(inputs))] = u[:, k] / gains[k]
    values = dict(zip(bench.names, bench.layout.values[bench.free].tolist(), strict=True))
    notes = [_SIMULATED if by_goals(chain) else f"{_SIMULATED}; {_OPEN_LOOP}"]
    zero = [name for name, value in values.items() if value == 0 and "offset" not in name]
    if zero:
        notes.append(
            f"assumed to be 0: {', '.join(zero)}. State a guess with --parameters FIT.json"
        )
    if dark:
        notes.append(
            f"{dark} combinations of the parameters show in no output: fix some under"
            " [model.constants]"
        )
    about = content(chain, plan, criterion, bounds, used) | {
        "kind_of_excitation": "input",
        "condition_number": condition,
        "condition_number_scaled": condition,
        "directions_not_shown": dark,
        "assumed_noise": dict(zip(outputs, noise.tolist(), strict=True)),
        "expected_std": dict(zip(bench.names, std.tolist(), strict=True)),
        "assumed_values": values,
        "gains": None if gains is None else gains.tolist(),
        "speed_coverage": coverage(signature.joints, bounds, qd),
        "notes": notes,
    }
    name = chain.mechanism.name
    experiment = Experiment(
        name="excitation",
        split="fit",
        t=t,
        u=u,
        y=y[0],
        auxiliary=currents,
        at_rest=True,
        source="designed, not measured",
    )
    dataset = Dataset(
        f"{name}_excitation",
        (*bench.channels, *(Channel(current, "auxiliary", "A") for current in currents)),
        (experiment,),
        model=ModelSpec(name),
        description=f"Designed input for {name}; outputs are simulated: a plan, not a recording",
    )
    return Excitation(dataset, commands | currents, {}, tuple(used), about)


_SIMULATED = "outputs in run_1 are simulated at the assumed values, nothing here was measured"
_OPEN_LOOP = (
    "a drive played in open loop moves as the machine does, not as the simulation: begin"
    " with a small --amplitude"
)


def _of_moving_outputs(
    bench: InputDesign, u: np.ndarray
) -> tuple[InputDesign, np.ndarray, np.ndarray]:
    """(bench, outputs, their derivatives) without a sensor that shows nothing here, such as a base
    that stands still.
    """
    chain = bench.chain
    signature = chain.signature
    y, dy = bench.run(u[None])
    moving = {name for k, (name, _) in enumerate(signature.outputs) if np.ptp(y[0, :, k]) > 0}
    if len(moving) == len(signature.outputs):
        return bench, y, dy
    for smaller in _continuous(chain):
        names = dict(smaller.outputs)
        if smaller.inputs == signature.inputs and names.keys() <= moving:
            kept = [k for k, (name, _) in enumerate(signature.outputs) if name in names]
            chain = Chain(chain.mechanism, chain.effects, signature=smaller)
            bench = InputDesign(chain, bench.start, bench.family, bench.bounds, bench.noise[kept])
            return bench, *bench.run(u[None])
    return bench, y, dy


def _inputs_used(signature: Any, family: Family, u: np.ndarray) -> list[dict[str, Any]]:
    """How much of each input's range the design uses."""
    used = []
    for k, (name, unit) in enumerate(signature.inputs):
        high = float(np.abs(u[:, k] - family.center[k]).max())
        limit = float(family.top[k])
        used.append(
            {
                "joint": name,
                "quantity": "input",
                "unit": unit,
                "highest": high,
                "limit": limit,
                "share": high / limit if limit else 0.0,
            }
        )
    return used


def widened(name: str, values: Sequence[float], count: int) -> np.ndarray:
    if len(values) not in (1, count) or min(values) <= 0:
        raise UsageError(
            f"--{name} has {len(values)} numbers for {count} inputs; write 1 or {count}, all"
            " above 0"
        )
    return np.broadcast_to(np.asarray(values, float), (count,)).copy()


def _current(name: str, place: int, count: int) -> str:
    """`tau2` is commanded as `current2_cmd`, `tau` as `current_cmd`. The torques of a robot's
    joints, which have names, are numbered by their place.
    """
    number = ""
    if name.startswith("tau"):
        _, number = stem_and_number(name)
    if not number and count > 1:
        number = str(place + 1)
    return f"current{number}_cmd"
